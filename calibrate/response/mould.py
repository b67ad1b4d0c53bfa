"""How a machine reads the curve of a soil that is pressed in the mould, laid through its features,
and what a fuller mould does to the beginning of that curve.

A platen turns within some way, at nearly the same force: unloading is counted from there.
The features are those of a soil that was pressed to `over` times the largest force that is asked
for (`machine`), and are read at the forces that the machine shows.  The curve is straight between
them; beyond the largest force straight on; unloading from a larger force as from the largest one,
larger alike in force and displacement.  The test lasts seconds, in which a load cell does not
drift.

    L = v tau       v: the platen's speed, tau the lag (`reading` has the filter)

With a lag the force overshoots, and readings lie L behind both ways: between 20 and 320 N the
unloading branch moves as a whole, by L to 2 L, the less the more of the overshoot stays.

Spheres that have grown by e in volume press on the mould before the platen moves.  So the curve
begins where the soil's own one is pressed by a share k of that growth over its height h, and joins
it from there on:

    d_shown(F) = max(d(F), d(0) + k e h)        e > 0; rounded over r k e h

An elastic bed that swells by e between walls that hold it presses with K e, one that is pressed by
the platen alone with M per strain, so k is about K/M = (1 + nu)/(3 - 3 nu), 0.6 to 0.8.  Looser
moulds have no such beginning.  An emulator of smooth functions spreads the corner over forces that
do not feel it.  k and r are estimated from a library's own rows; what remains it learns.
"""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.optimize import least_squares

from calibrate.labtests.diagnosis.base import REFERENCE
from calibrate.response.reading import (
    Features,
    MachineErrors,
    at_least,
    between,
    by_force,
    path_at,
    reading_at_knots,
)
from jdem.core.quantity import Real

BEYOND = 2.5  # largest forces up to which a curve goes on
LAST = 5  # features of loading that make the slope by which it does
AFTER = 60.0  # lengths for which the reading is followed after unloading
SHORT, LONG = 0.2, 200.0  # mm; ways that a platen may go
APART = 1e-9  # mm; least distance of two points of a curve, and least length of a lag
FEWEST = 20  # rows with a fuller mould, of which two numbers are estimated
START = (0.7, 0.3)  # share and roundness, from which they are
BOUNDS = ((0.2, 0.02), (1.5, 2.0))
SCALE = 0.1  # mm; errors beyond count less (`soft_l1`)


@dataclass(frozen=True)
class MouldReading:
    """Which of the features are read off the two branches in the mould, and the platen's speed
    (mm/s) there."""

    features: Features
    speed: Real

    @cached_property
    def rows(self) -> np.ndarray:
        """The features (b,) that a machine moves: loading by rising force, unloading by falling;
        none where branches have too few."""
        enough = len(self._up) > LAST and len(self._down) > 1
        return np.concatenate([self._up, self._down])[: None if enough else 0]

    def moved(
        self, values: Array, errors: MachineErrors, over: Array, late: MachineErrors | None
    ) -> tuple[Array, Array]:
        """What errors, in the features' own forces, add to the features `rows`, given all (m,)
        without any of a soil that is pressed to `over` times the largest force; nothing to what is
        no curve of a soil, as fits may try.  And the force at which the machine turns and the
        largest that its cell reads, over the largest force, less 1.  Shapes (n, b), (n, 2): without
        a lag, and with that of `late`, which is not 0, unless it is None."""
        count = 1 if late is None else 2
        if not len(self.rows):
            return jnp.zeros((count, 0)), jnp.zeros((count, 2))
        way, back = self._curve(values)
        gone = way[-1] - way[0]
        possible = (gone > SHORT) & (gone < LONG) & (back[-1] < LONG)
        way = jnp.where(possible, way, jnp.arange(float(len(way))))
        back = jnp.where(possible, back, jnp.arange(float(len(back))))
        up, down = (jnp.asarray(each) / over for each in self._shown)
        found = [(possible, *self._prompt(way, back, errors, up, down))]
        if late is not None:
            length = self.speed * late.lag
            slow = length < LONG
            length = jnp.where(slow, length, 1.0)
            found.append((possible & slow, *self._late(way, back, late, length, up, down)))
        laid = self._laid(way, back)
        moved, turns = zip(
            *(
                (jnp.where(good & reached, shown - laid, 0.0), jnp.where(good & reached, turn, 0.0))
                for good, shown, turn, reached in found
            ),
            strict=True,
        )
        return jnp.stack(moved), jnp.stack(turns)

    def deeper(self, errors: MachineErrors, over: Array) -> Array:
        """What errors add to the depression depth: what the machine yields from half the largest
        force to that."""
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
    def _travel(self) -> list[int]:
        """The feature, if there is one, that tells how far a platen goes on while it turns."""
        return [i for i, f in enumerate(self.features) if f.kind == "travel at the top"]

    @cached_property
    def _zero(self) -> int:
        """Which of loading's points is that from which displacements count."""
        return int(np.searchsorted(self._forces[0], REFERENCE * self._top))

    def _curve(self, values: Array) -> tuple[Array, Array]:
        """Displacement of loading (k,) at `_loaded` forces, and the way back (j,) from the largest
        force to `_released` shares of it."""
        up = self._forces[0]
        zero = self._zero
        known = values[self._up]
        loading = _rising(jnp.hstack([known[:zero], 0.0, known[zero:]]))
        at_double = np.insert(_between(2 * up[0], up), zero, 0.0)
        first = 2 * loading[0] - loading @ at_double
        slope = (loading[-1] - loading[-LAST]) / (up[-1] - up[-LAST])
        at_top = loading[-1] + slope * (self._top - up[-1])
        end = at_top + slope * (BEYOND - 1) * self._top
        way = jnp.hstack([first, loading, at_top, end])
        way = way + APART * np.arange(len(way))
        turn = loading[-1] + values[self._travel[0]] if self._travel else at_top
        back = _rising(jnp.hstack([0.0, turn - values[self._down]]))
        share = self._released
        last = (back[-1] - back[-2]) * share[-2] / (share[-3] - share[-2])
        back = jnp.append(back, back[-1] + last)
        return way, back + APART * np.arange(len(back))

    @cached_property
    def _loaded(self) -> np.ndarray:
        """Forces (k,) of a curve's points on loading, N."""
        up = np.insert(self._forces[0], self._zero, REFERENCE * self._top)
        return np.array([0.0, *up, self._top, BEYOND * self._top])

    @cached_property
    def _released(self) -> np.ndarray:
        """Shares (j,) of the force at reversal of a curve's points on unloading."""
        return np.array([self._top, *self._forces[1], 0.0]) / self._top

    def _laid(self, way: Array, back: Array) -> Array:
        """Both branches' features (b,) of the curve itself."""
        pressed, returned = way[1:-2], way[-2] - back[1:-1]
        zero = self._zero
        return jnp.hstack([pressed[:zero], pressed[zero + 1 :], returned]) - pressed[zero]

    def _prompt(
        self, way: Array, back: Array, errors: MachineErrors, up: Array, down: Array
    ) -> tuple[Array, Array, Array]:
        """Both branches' features (b,) without a lag, how the machine turns (2,), and whether the
        largest force is reached; up (q,), down (j,): forces that are shown."""
        force, left = errors.reading(up), errors.reading(down)
        read = between(force, jnp.asarray(self._loaded), way)
        reached = _possible(force[-1], errors) & (force[-1] < BEYOND * self._top)
        over = jnp.where(reached, force[-1], self._top) / self._top
        falling = -over * self._top * self._released  # upside down, so that it rises
        home = between(-left, falling, over * back)
        return self._as_shown(read, force, home, left, errors), jnp.zeros(2), reached

    def _late(
        self, way: Array, back: Array, errors: MachineErrors, length: Array, up: Array, down: Array
    ) -> tuple[Array, Array, Array]:
        """The same with a lag of a `length`, mm."""
        force = jnp.asarray(self._loaded)
        reading = reading_at_knots(way, force, length, 0.0)
        levels, left = errors.reading(up), errors.reading(down)
        reached = _possible(levels[-1], errors) & (reading[-1] > levels[-1])
        read, rise = path_at(levels, way, force, reading, length)
        pressed = levels + length * rise  # the force is L dR/dx ahead of its reading
        reversal = pressed[-1]
        over = reversal / self._top
        home = jnp.append(over * back, over * back[-1] + AFTER * length + APART)
        falling = -reversal * np.append(self._released, 0.0)  # upside down, so that it rises
        reading = reading_at_knots(home, falling, length, -levels[-1])
        returned, rise = path_at(-left, home, falling, reading, length)
        turn = jnp.hstack([over, self._largest(levels[-1], reversal, home, length)]) - 1
        return self._as_shown(read, pressed, returned, left - length * rise, errors), turn, reached

    def _largest(self, reading, reversal, home, length) -> Array:
        """The largest reading over the largest force.  Behind the force, it goes on rising until
        that has fallen to it: where a force falls by c, from D above its reading,

            R = R_turn + D - L c ln(1 + D/(L c))
        """
        falls = reversal * (1 - self._released[1]) / at_least(home[1], APART) * length
        behind = at_least(reversal - reading, 0.0)
        return (reading + behind - falls * jnp.log(1 + behind / falls)) / self._top

    def _as_shown(self, read, pressed, home, left, errors: MachineErrors) -> Array:
        """Features (b,) from where the platen is on loading (q,) and how far it is back (j,), and
        the forces there: displacements with what the machine yields, from its zero."""
        loading = read + errors.travel(pressed)
        returned = read[-1] - home + errors.travel(left)
        return jnp.hstack([loading[:-2], returned]) - loading[-2]


def _possible(reversal: Array, errors: MachineErrors) -> Array:
    """Whether a machine presses at all before it turns at a force."""
    return (reversal > 0) & (errors.gain > -1)


def _rising(values: Array) -> Array:
    """Values (k,), each as large as the largest before it."""
    before = np.tri(len(values), dtype=bool)
    return values[jnp.argmax(jnp.where(before, values, -jnp.inf), axis=1)]


def _between(level: float, levels: np.ndarray) -> np.ndarray:
    """Weights (k,) by which values at rising levels (k,) make the value at `level`."""
    return np.array([np.interp(level, levels, one) for one in np.eye(len(levels))])


@dataclass(frozen=True)
class Filling:
    """Share k and roundness r."""

    share: float
    roundness: float

    def moved(self, features: Features, values: Array, growth: Array, height: Array) -> Array:
        """What a growth adds to features (m,) of a soil in a specimen of a height (mm)."""
        up, down = (by_force(features, kind) for kind in ("loading", "unloading"))
        if len(up) < 2:
            return jnp.zeros_like(values)
        pressed = self.share * at_least(growth, 0.0) * height
        begins = _touch(features, up, values) + pressed
        width = self.roundness * pressed
        at_zero = _larger(0.0, begins, width)  # displacements count from half load
        kind = np.zeros(len(features), int)
        kind[up], kind[down] = 1, 2
        moved = jnp.where(kind == 1, _larger(values, begins, width) - values, 0.0)
        return jnp.where((pressed > 0) & (kind > 0), moved - at_zero, 0.0)

    @staticmethod
    def of(
        features: Features, before: np.ndarray, after: np.ndarray, growth: np.ndarray,
        height: np.ndarray,
    ) -> "Filling | None":  # fmt: skip
        """The one that is likeliest, given features (n, m) of soils and those of the same with
        growths (n,) in specimens of heights (n,), mm; None where these are few."""
        up = by_force(features, "loading")
        if len(growth) < FEWEST or len(up) < 2:
            return None

        @jax.jit
        def left(at: Array) -> Array:
            filling = Filling(at[0], at[1])  # pyright: ignore[reportArgumentType]
            moved = jax.vmap(lambda *of: filling.moved(features, *of))(before, growth, height)
            return ((jnp.asarray(after - before) - moved)[:, up] / SCALE).ravel()

        return Filling(*least_squares(left, START, bounds=BOUNDS, loss="soft_l1").x.tolist())


def _larger(a, b, width):
    """The larger of both, rounded; where they are equal by half the width more."""
    return 0.5 * (a + b + jnp.sqrt((a - b) ** 2 + width**2 + 1e-12))


def _touch(features: Features, up: np.ndarray, values: Array) -> Array:
    """Displacement at no force: straight on from the two features of least force."""
    first, second = up[:2]
    low, high = features[first].abscissa, features[second].abscissa
    return values[first] - (values[second] - values[first]) / (high - low) * low
