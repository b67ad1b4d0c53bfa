"""What a lag of the load cell does to the features of compression in the mould, in closed form.

    L = v tau       v: the platen's speed, tau the lag (`low_pass` has the filter)

The machine reverses by its reading, so the force overshoots, and readings lie L behind both ways:
between 20 and 320 N the unloading branch moves as a whole, by about -(2 - p) L where p of the
overshoot stays.  In mm that is nearly the same for all soils, which an emulator of warped features
cannot know; so a library's emulator learns what is left once this has been taken off, and it is put
back on whatever is predicted.  What is taken off a simulated row is the shift of the
features that an emulator of rows without a lag predicts for it: to find a curve from its lagged
readings would be a deconvolution.

The curve is laid through the features: straight between them; beyond the largest force straight on;
unloading from a larger force as from the largest one, larger alike in force and displacement.

Everything is done for all rows at once, and holds for complex numbers: an imaginary part that is
small beyond rounding carries a derivative through exactly (Squire and Trapp 1998,
doi 10.1137/S003614459631241X), since no two such parts ever multiply to anything.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.low_pass import (
    path_at,
    reading_at_knots,
)
from calibrate.labtests.diagnosis.base import REFERENCE, Feature

LAG = "acquisition_lag"
BEYOND = 2.5  # largest forces up to which a curve goes on
LAST = 5  # features of loading that make the slope by which it does
AFTER = 60.0  # lengths for which the reading is followed after unloading
SHORT, LONG = 0.2, 200.0  # mm; ways that a platen may go
APART = 1e-9  # mm; least distance of two points of a curve
SMALL = 0.01  # s; step of the lag for a slope where there is none
TINY = 1e-30  # imaginary parts of derivatives


@dataclass(frozen=True, eq=False)
class LoadCellLag:
    """Which of the features are read off the two branches in the mould, and the platen's speed
    (mm/s) there."""

    features: Sequence[Feature]
    speed: float

    def shift(self, values: np.ndarray, lag: np.ndarray) -> np.ndarray:
        """What lags (n,), s, add to features (n, m) that are read without any."""
        moved = np.zeros_like(values)
        late = np.flatnonzero(np.real(lag) > 0)
        if len(late) and self._has_branches:
            moved[late[:, None], self._branches] = self._moved(
                values[late], self.speed * lag[late, None]
            )
        return moved

    def read(self, values, slopes, lag: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features (m,) and slopes (m, q) of these as they are read with a lag, and the shift's
        slope (m,) per second; not where values do not say a curve."""
        if not lag:
            shifted = self.shift(values[None], np.array([SMALL]))[0]
            return values, slopes, shifted / SMALL
        every = values + 1j * TINY * np.column_stack([slopes, np.zeros_like(values)]).T
        lags = np.full(len(every), complex(lag))
        lags[-1] += 1j * TINY
        shift = self.shift(every, lags)
        slope = np.imag(shift) / TINY
        return values + np.real(shift[-1]), slopes + slope[:-1].T, slope[-1]

    @cached_property
    def _up(self) -> np.ndarray:
        return _rows(self.features, "loading")

    @cached_property
    def _down(self) -> np.ndarray:
        """By falling force."""
        return _rows(self.features, "unloading")[::-1]

    @cached_property
    def _branches(self) -> np.ndarray:
        return np.concatenate([self._up, self._down])

    @property
    def _has_branches(self) -> bool:
        return len(self._up) > LAST and len(self._down) > 1

    @cached_property
    def _forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Forces (N) of features on loading, rising, and on unloading, falling."""
        both = (self._up, self._down)
        up, down = (np.array([self.features[i].abscissa for i in rows]) for rows in both)
        return up, down

    @property
    def _top(self) -> float:
        """The largest force, N."""
        return self.features[self._up[0]].scale

    def _moved(self, values: np.ndarray, length: np.ndarray) -> np.ndarray:
        """What lags of `length` (n, 1), mm, add to both branches' features (n, b); nothing to what
        is no curve of a soil, as fits may try."""
        moved = np.zeros((len(values), len(self._branches)), values.dtype)
        way, back = self._curve(values)
        gone = np.real(way[:, -1] - way[:, 0])
        a_curve = (gone > SHORT) & (gone < LONG) & (np.real(back[:, -1]) < LONG)
        some = np.flatnonzero(a_curve & (np.real(length[:, 0]) < LONG))
        if len(some):
            way, back = way[some], back[some]
            late, reached = self._late(way, back, length[some])
            moved[some] = np.where(reached, late - self._prompt(way, back), 0.0)
        return moved

    def _curve(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement of loading (n, k) at `_loaded` forces, and the way back (n, j) from the
        largest force to `_released` shares of it."""
        up = self._forces[0]
        loading = np.maximum.accumulate(values[:, self._up], axis=1)
        first = 2 * loading[:, 0] - loading @ _between(2 * up[0], up)
        slope = (loading[:, -1] - loading[:, -LAST]) / (up[-1] - up[-LAST])
        at_top = loading[:, -1] + slope * (self._top - up[-1])
        end = at_top + slope * (BEYOND - 1) * self._top
        way = np.column_stack([first, loading, at_top, end])
        way = way + APART * np.arange(way.shape[1])
        falling = np.column_stack([np.zeros(len(values)), at_top[:, None] - values[:, self._down]])
        back = np.maximum.accumulate(falling, axis=1)
        share = self._released
        last = (back[:, -1] - back[:, -2]) * share[-2] / (share[-3] - share[-2])
        back = np.column_stack([back, back[:, -1] + last])
        return way, back + APART * np.arange(back.shape[1])

    @cached_property
    def _loaded(self) -> np.ndarray:
        """Forces (k,) of a curve's points on loading, N."""
        return np.array([0.0, *self._forces[0], self._top, BEYOND * self._top])

    @cached_property
    def _released(self) -> np.ndarray:
        """Shares (j,) of the force at reversal of a curve's points on unloading."""
        return np.array([self._top, *self._forces[1], 0.0]) / self._top

    def _prompt(self, way: np.ndarray, back: np.ndarray) -> np.ndarray:
        """Both branches' features (n, b) without a lag."""
        zero = way @ _between(REFERENCE * self._top, self._loaded)
        turn = way @ _between(self._top, self._loaded)
        returned = turn[:, None] - back[:, 1:-1]
        return np.column_stack([way[:, 1:-2], returned]) - zero[:, None]

    def _late(
        self, way: np.ndarray, back: np.ndarray, length: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Both branches' features (n, b) with lags of `length` (n, 1), mm, and whether (n, 1) the
        readings reach the largest force at all."""
        up, down = self._forces
        force = np.broadcast_to(self._loaded, way.shape)
        reading = reading_at_knots(way, force, length, 0.0)
        reached = np.real(reading[:, -1:]) > self._top
        levels = np.array([*up, REFERENCE * self._top, self._top])
        read, rise = path_at(levels, way, force, reading, length)
        reversal = self._top + length * rise[:, -1:]  # the force is L dR/dx ahead of its reading
        over = reversal / self._top
        home = np.column_stack([over * back, over * back[:, -1:] + AFTER * length + APART])
        falling = -reversal * np.append(self._released, 0.0)  # upside down, so that it rises
        reading = reading_at_knots(home, falling, length, -self._top)
        returned, _ = path_at(-down, home, falling, reading, length)
        late = np.column_stack([read[:, :-2], read[:, -1:] - returned]) - read[:, -2:-1]
        return late, reached


def _rows(features: Sequence[Feature], kind: str) -> np.ndarray:
    """The features of a kind by rising force."""
    found = [i for i, feature in enumerate(features) if feature.kind == kind]
    return np.array(sorted(found, key=lambda i: features[i].abscissa), int)


def _between(level: float, levels: np.ndarray) -> np.ndarray:
    """Weights (k,) by which values at rising levels (k,) make the value at `level`."""
    return np.array([np.interp(level, levels, one) for one in np.eye(len(levels))])
