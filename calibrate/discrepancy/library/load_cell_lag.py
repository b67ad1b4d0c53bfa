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
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.low_pass import filtered_evenly
from calibrate.labtests.diagnosis.base import REFERENCE, Feature

LAG = "acquisition_lag"
STEP = 0.02  # mm of path between points
BEYOND = 2.5  # largest forces up to which a curve goes on
LAST = 5  # features of loading that make the slope by which it does
AFTER = 6.0  # lengths for which the reading is followed after unloading
SHORT, LONG = 10 * STEP, 200.0  # mm; ways that a platen may go
SMALL = 0.01  # s; step of the lag for finite differences


@dataclass(frozen=True, eq=False)
class LoadCellLag:
    """Which of the features are read off the two branches in the mould, and the platen's speed
    (mm/s) there."""

    features: Sequence[Feature]
    speed: float

    def shift(self, values: np.ndarray, lag: np.ndarray) -> np.ndarray:
        """What lags (n,), s, add to features (n, m) that are read without any."""
        moved = np.zeros_like(values)
        for row in np.flatnonzero(lag > 0) if self._has_branches else ():
            moved[row, self._branches] = self._moved(values[row], self.speed * lag[row])
        return moved

    def read(self, values, slopes, lag: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Features (m,) and slopes (m, q) of these as they are read with a lag, and the shift's
        slope (m,) per second; not where values do not say a curve."""
        if not lag:
            shifted = self.shift(values[None], np.array([SMALL]))[0]
            return values, slopes, shifted / SMALL
        size = np.maximum(np.abs(slopes[self._branches]).max(axis=0), 1e-300) / STEP
        beside = values + (slopes / size).T
        every = self.shift(np.vstack([values, beside, values]), np.full(len(beside) + 2, lag))
        every[-1] = self.shift(values[None], np.array([lag + SMALL]))[0]
        turned = slopes + (every[1:-1] - every[0]).T * size
        return values + every[0], turned, (every[-1] - every[0]) / SMALL

    @cached_property
    def _up(self) -> np.ndarray:
        return _rows(self.features, "loading")

    @cached_property
    def _down(self) -> np.ndarray:
        """By falling force."""
        return _rows(self.features, "unloading")[::-1]

    @property
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

    def _moved(self, values: np.ndarray, length: float) -> np.ndarray:
        """What a lag of `length` (mm) adds to both branches' features, one row; nothing to what is
        no curve of a soil, as fits may try."""
        branches = self._branch(values)
        way, _, _, back, _ = branches
        if not (SHORT < way[-1] - way[0] < LONG and back[-1] < LONG and length < LONG):
            return np.zeros(len(self._branches))
        return self._filtered(*branches, length) - self._filtered(*branches, 0.0)

    def _branch(self, values: np.ndarray):
        """Displacement and force of loading from no force to beyond the largest one, where the
        largest one is, and the way back from there at shares of it."""
        top = self.features[self._up[0]].scale
        up, down = self._forces
        loading = np.maximum.accumulate(values[self._up])
        first = 2 * loading[0] - np.interp(2 * up[0], up, loading)
        slope = (loading[-1] - loading[-LAST]) / (up[-1] - up[-LAST])
        at_top = loading[-1] + slope * (top - up[-1])
        end = at_top + slope * (BEYOND - 1) * top
        way = np.concatenate([[first], loading, [at_top, end]])
        way += 1e-9 * np.arange(len(way))
        force = np.concatenate([[0.0], up, [top, BEYOND * top]])
        back = np.maximum.accumulate(np.concatenate([[0.0], at_top - values[self._down]]))
        share = np.concatenate([[top], down]) / top
        released = back[-1] + (back[-1] - back[-2]) * share[-1] / (share[-2] - share[-1])
        back = np.append(back, released) + 1e-9 * np.arange(len(back) + 1)
        return way, force, top, back, np.append(share, 0.0)

    def _filtered(self, way, force, top, back, share, length: float) -> np.ndarray:
        """Both branches' features, with a lag of `length` (mm)."""
        up, down = self._forces
        path = np.arange(way[0], way[-1], STEP)
        reading = np.maximum.accumulate(
            filtered_evenly(np.interp(path, way, force), STEP, length, 0.0)
        )
        turn = float(np.interp(top, reading, path))
        over = max(float(np.interp(turn, way, force)) / top, 1.0)
        read = np.interp([*up, REFERENCE * top], reading, path)
        home = np.arange(0.0, over * back[-1] + AFTER * length, STEP)
        falling = filtered_evenly(
            over * top * np.interp(home / over, back, share), STEP, length, top
        )
        highest = int(falling.argmax())
        falling = np.minimum.accumulate(falling[highest:])[::-1]
        returned = np.interp(down, falling, home[highest:][::-1])
        return np.concatenate([read[:-1], turn - returned]) - read[-1]


def _rows(features: Sequence[Feature], kind: str) -> np.ndarray:
    """The features of a kind by rising force."""
    found = [i for i, feature in enumerate(features) if feature.kind == kind]
    return np.array(sorted(found, key=lambda i: features[i].abscissa), int)
