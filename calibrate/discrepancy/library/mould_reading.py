"""How a machine reads the curve of a soil that is pressed in the mould, laid through its features.

A platen turns within some way, at nearly the same force: unloading is counted from there.
The features are those of a soil that was pressed to `over` times the largest force that is asked
for (`machine`), and are read at the forces that the machine shows.  The curve is straight between
them; beyond the largest force straight on; unloading from a larger force as from the largest one,
larger alike in force and displacement.  The test lasts seconds, in which a load cell does not
drift.

    L = v tau       v: the platen's speed, tau the lag (`reading` has the filter)

With a lag the force overshoots, and readings lie L behind both ways: between 20 and 320 N the
unloading branch moves as a whole, by L to 2 L, the less the more of the overshoot stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.reading import (
    MachineErrors,
    at_least,
    between,
    by_force,
    path_at,
    reading_at_knots,
)
from calibrate.labtests.diagnosis.base import REFERENCE, Feature

BEYOND = 2.5  # largest forces up to which a curve goes on
LAST = 5  # features of loading that make the slope by which it does
AFTER = 60.0  # lengths for which the reading is followed after unloading
SHORT, LONG = 0.2, 200.0  # mm; ways that a platen may go
APART = 1e-9  # mm; least distance of two points of a curve


@dataclass(frozen=True, eq=False)
class MouldReading:
    """Which of the features are read off the two branches in the mould, and the platen's speed
    (mm/s) there."""

    features: Sequence[Feature]
    speed: float

    @cached_property
    def rows(self) -> np.ndarray:
        """The features (b,) that a machine moves: loading by rising force, unloading by falling;
        none where branches have too few."""
        enough = len(self._up) > LAST and len(self._down) > 1
        return np.concatenate([self._up, self._down])[: None if enough else 0]

    def moved(
        self, values: np.ndarray, errors: MachineErrors, over: np.ndarray | float = 1.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """What errors, in the features' own forces, add to the features `rows` (n, b), given all
        (n, m) without any of a soil that is pressed to `over` (n, 1) times the largest force;
        nothing to what is no curve of a soil, as fits may try.  And (n, 2) the force at which the
        machine turns and the largest that its cell reads, over the largest force, less 1."""
        moved = np.zeros((len(values), len(self.rows)), np.result_type(values, errors.compliance))
        turned = np.zeros_like(moved, shape=(len(values), 2))
        if not len(self.rows):
            return moved, turned
        way, back = self._curve(values)
        gone = np.real(way[:, -1] - way[:, 0])
        a_curve = (gone > SHORT) & (gone < LONG) & (np.real(back[:, -1]) < LONG)
        length = self.speed * errors.lag
        late = np.real(length[:, 0]) > APART
        for read, rows in (
            (self._prompt, a_curve & ~late),
            (self._late, a_curve & late & (np.real(length[:, 0]) < LONG)),
        ):
            some = np.flatnonzero(rows)
            if len(some):
                its = MachineErrors(*(part[some] for part in errors))
                own = way[some], back[some]
                shown = (each / np.broadcast_to(over, length.shape)[some] for each in self._shown)
                read_now, turn, reached = read(*own, its, length[some], *shown)
                moved[some] = np.where(reached, read_now - self._laid(*own), 0.0)
                turned[some] = np.where(reached, turn, 0.0)
        return moved, turned

    def deeper(self, errors: MachineErrors, over: np.ndarray) -> np.ndarray:
        """What errors add to the depression depth (n, 1): what the machine yields from half the
        largest force to that."""
        half, all_of_it = (share * self._top / over for share in (REFERENCE, 1.0))
        return errors.travel(errors.reading(all_of_it)) - errors.travel(errors.reading(half))

    @cached_property
    def _up(self) -> np.ndarray:
        return by_force(self.features, "loading")

    @cached_property
    def _down(self) -> np.ndarray:
        """By falling force."""
        return by_force(self.features, "unloading")[::-1]

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

    @cached_property
    def _shown(self) -> tuple[np.ndarray, np.ndarray]:
        """Forces that are read on loading: the features', that of their zero, the largest; and
        those on unloading, the features'."""
        up, down = self._forces
        return np.array([*up, REFERENCE * self._top, self._top]), down

    @cached_property
    def _at_double(self) -> np.ndarray:
        """Weights of loading's features for the displacement at twice the least force."""
        return _between(2 * self._forces[0][0], self._forces[0])

    @cached_property
    def _travel(self) -> list[int]:
        """The feature, if there is one, that tells how far a platen goes on while it turns."""
        return [i for i, f in enumerate(self.features) if f.kind == "travel at the top"]

    @cached_property
    def _zero(self) -> int:
        """Which of loading's points is that from which displacements count."""
        return int(np.searchsorted(self._forces[0], REFERENCE * self._top))

    def _curve(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement of loading (n, k) at `_loaded` forces, and the way back (n, j) from the
        largest force to `_released` shares of it."""
        up = self._forces[0]
        loading = np.insert(values[:, self._up], self._zero, 0.0, axis=1)
        loading = np.maximum.accumulate(loading, axis=1)
        first = 2 * loading[:, 0] - np.delete(loading, self._zero, axis=1) @ self._at_double
        slope = (loading[:, -1] - loading[:, -LAST]) / (up[-1] - up[-LAST])
        at_top = loading[:, -1] + slope * (self._top - up[-1])
        end = at_top + slope * (BEYOND - 1) * self._top
        way = np.column_stack([first, loading, at_top, end])
        way = way + APART * np.arange(way.shape[1])
        turn = loading[:, -1] + values[:, self._travel[0]] if self._travel else at_top
        falling = np.column_stack([np.zeros(len(values)), turn[:, None] - values[:, self._down]])
        back = np.maximum.accumulate(falling, axis=1)
        share = self._released
        last = (back[:, -1] - back[:, -2]) * share[-2] / (share[-3] - share[-2])
        back = np.column_stack([back, back[:, -1] + last])
        return way, back + APART * np.arange(back.shape[1])

    @cached_property
    def _loaded(self) -> np.ndarray:
        """Forces (k,) of a curve's points on loading, N."""
        up = np.insert(self._forces[0], self._zero, REFERENCE * self._top)
        return np.array([0.0, *up, self._top, BEYOND * self._top])

    @cached_property
    def _released(self) -> np.ndarray:
        """Shares (j,) of the force at reversal of a curve's points on unloading."""
        return np.array([self._top, *self._forces[1], 0.0]) / self._top

    def _laid(self, way: np.ndarray, back: np.ndarray) -> np.ndarray:
        """Both branches' features (n, b) of the curve itself."""
        pressed, returned = way[:, 1:-2], way[:, -2:-1] - back[:, 1:-1]
        own = np.delete(pressed, self._zero, axis=1)
        return np.column_stack([own, returned]) - pressed[:, self._zero, None]

    def _prompt(
        self, way: np.ndarray, back: np.ndarray, errors: MachineErrors, length: np.ndarray,
        up: np.ndarray, down: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Both branches' features (n, b) without a lag, how the machine turns (n, 2), and whether
        (n, 1) the largest force is reached; up (n, q), down (n, j): forces that are shown."""
        force = errors.reading(up)
        read = between(force, np.broadcast_to(self._loaded, way.shape), way)
        reached = _possible(force[:, -1:], errors) & (np.real(force[:, -1:]) < BEYOND * self._top)
        over = np.where(reached, force[:, -1:], self._top) / self._top
        left = errors.reading(down)
        falling = -over * self._top * self._released  # upside down, so that it rises
        home = between(-left, falling, over * back)
        turn = np.zeros_like(over) * np.zeros(2)
        return self._as_shown(read, force, home, left, errors), turn, reached

    def _late(
        self, way: np.ndarray, back: np.ndarray, errors: MachineErrors, length: np.ndarray,
        up: np.ndarray, down: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """The same with lags of `length` (n, 1), mm."""
        force = np.broadcast_to(self._loaded, way.shape)
        reading = reading_at_knots(way, force, length, 0.0)
        levels, left = errors.reading(up), errors.reading(down)
        reached = _possible(levels[:, -1:], errors)
        reached &= np.real(reading[:, -1:]) > np.real(levels[:, -1:])
        read, rise = path_at(levels, way, force, reading, length)
        pressed = levels + length * rise  # the force is L dR/dx ahead of its reading
        reversal = pressed[:, -1:]
        over = reversal / self._top
        home = np.column_stack([over * back, over * back[:, -1:] + AFTER * length + APART])
        falling = -reversal * np.append(self._released, 0.0)  # upside down, so that it rises
        reading = reading_at_knots(home, falling, length, -levels[:, -1])
        returned, rise = path_at(-left, home, falling, reading, length)
        turn = np.hstack([over, self._largest(levels[:, -1:], reversal, home, length)]) - 1
        shown = self._as_shown(read, pressed, returned, left - length * rise, errors)
        return shown, turn, reached

    def _largest(self, reading, reversal, home, length) -> np.ndarray:
        """The largest reading (n, 1) over the largest force.  Behind the force, it goes on rising
        until that has fallen to it: where a force falls by c, from D above its reading,

            R = R_turn + D - L c ln(1 + D/(L c))
        """
        falls = reversal * (1 - self._released[1]) / at_least(home[:, 1:2], APART) * length
        behind = at_least(reversal - reading, 0.0)
        return (reading + behind - falls * np.log(1 + behind / falls)) / self._top

    def _as_shown(self, read, pressed, home, left, errors: MachineErrors) -> np.ndarray:
        """Features (n, b) from where the platen is on loading (n, q) and how far it is back
        (n, j), and the forces there: displacements with what the machine yields, from its zero."""
        loading = read + errors.travel(pressed)
        returned = read[:, -1:] - home + errors.travel(left)
        return np.column_stack([loading[:, :-2], returned]) - loading[:, -2:-1]


def _possible(reversal: np.ndarray, errors: MachineErrors) -> np.ndarray:
    """Whether (n, 1) a machine presses at all before it turns at a force (n, 1)."""
    return (np.real(reversal) > 0) & (np.real(errors.gain) > -1)


def _between(level: float, levels: np.ndarray) -> np.ndarray:
    """Weights (k,) by which values at rising levels (k,) make the value at `level`."""
    return np.array([np.interp(level, levels, one) for one in np.eye(len(levels))])
