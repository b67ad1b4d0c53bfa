"""What a testing machine adds to the features of a soil's curves, in closed form.

An emulator of warped features would have to learn these for every soil, though they need only the
soil's own curve.  So the curve is laid through the features that the emulator gives, is read as the
machine reads it (`mould`, `reading`), and what has changed is added.

A machine turns by what it shows.  Where its load cell errs, the soil is pressed to another force,

    F_turn/F_asked = (1 - b/F_asked)/(1 + g)

and what is crushed then is stronger or weaker for it.  The largest stress is a coordinate of the
emulator: so it is asked for the soil at the stress that this machine reaches (`overload`).

A library's rows are the other way round: what the machine adds is taken off before the emulator
sees them.  To find a curve from its readings would be a deconvolution; so what is taken off a row
is what the emulator's own curve of its soil gives.  The emulator learns what is left: with the
square of a machine's error, for it is small where that is weak; with that of a fuller mould itself,
of which only the beginning of the curve is told (`mould.Filling`).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from calibrate.labtests.diagnosis.curves import TARGETS, TESTS
from calibrate.response.mould import APART, Filling, MouldReading
from calibrate.response.reading import (
    LARGEST,
    Features,
    MachineErrors,
    crushing_moved,
    crushing_rows,
)
from jdem.core.quantity import Real, as_quantity, quantity
from jdem.effects.composite import EFFECTS
from jdem.effects.seating import SeatingGap

LAG, DENSITY = "acquisition_lag", "specimen_density"
MACHINE = (  # in the order of `MachineErrors`
    "load_frame_compliance", "seating_gap", "load_cell_gain", "load_cell_offset",
    "load_cell_drift", LAG,
)  # fmt: skip
TOLD = (*MACHINE, DENSITY)
MILLIMETRES = ("m", "m/N")  # units of strengths that are told in mm
TOP, DEPTH, STRENGTH = "largest force", *TARGETS
CRUSHED = TESTS[1]
LEAST_FORCE = 1e-3  # N; of smaller ones no power is told
POWERS = (-2.0, 3.0)  # of the force that a soil was pressed with, by which it may be stronger
OVERLOADS = (0.3, 3.0)  # times the force that is asked for; others are no test
SMALL = 0.01  # s; below the least lag what a lag does goes straight to what this one does


def _in_rows(parts: list[tuple[np.ndarray, Array]], count: int) -> Array:
    """Values of some rows, each (q,) for those of numbers (q,), among (count,), others 0."""
    place, length = np.zeros(count, int), 1
    for rows, values in parts:
        place[rows] = length + np.arange(len(rows))
        length += len(values)
    return jnp.hstack([0.0, *(values for _, values in parts)])[place]


class Machine(eqx.Module):
    """A machine at the library's size: the features that it reads, the platen's speeds (mm/s) in
    the mould and in crushing, those of `TOLD` that are told in closed form, the force (N) by which
    a seating gap closes, what fills a mould, and the height (mm) of specimens."""

    features: Features = eqx.field(static=True, converter=tuple)
    speed: Real = quantity()
    crushing_speed: Real = quantity()
    told: tuple[str, ...] = eqx.field(static=True, default=MACHINE)
    filling: Filling | None = eqx.field(static=True, default=None)
    height: Real = quantity(100.0)
    closing_force: Real = eqx.field(
        converter=as_quantity, default_factory=lambda: SeatingGap().closing_force
    )

    def overload(self, strengths: Array, shape: Array) -> Array:
        """Logarithm of the force at which a machine with errors (e,), SI, turns over the one that
        it is asked for, with a specimen of a shape (2,) over the library's; 0 where that is no
        test."""
        errors, asked = self._errors(strengths), self.features[0].scale * jnp.exp(shape[1])
        over = (1 - errors.offset / asked) / jnp.where(errors.gain > -1, 1 + errors.gain, 1.0)
        low, high = OVERLOADS
        return jnp.log(jnp.where((over > low) & (over < high), over, 1.0))

    def shift(self, values: Array, strengths: Array, shape: Array, by_stress: Array) -> Array:
        """What errors of strengths (e,), SI, in the order of `told`, add to features (m,) that are
        read without any where the machine turns (`overload`), of a specimen whose shape (2,) over
        the library's is given; by_stress (m,): slopes with the logarithm of the largest stress,
        which a lag exceeds.

        The turn of a curve bends within a few readings, so the slope at no lag says little of a
        real one: there it is that of the straight line to what SMALL does."""
        errors, over = self._errors(strengths), jnp.exp(self.overload(strengths, shape))
        slender, stress = jnp.exp(shape)
        filled = jnp.zeros_like(values)
        if self.filling is not None and DENSITY in self.told:
            growth, height = strengths[self.told.index(DENSITY)], self.height * slender
            filled = self.filling.moved(self.features, values, growth, height)
        known, mould = values + filled, MouldReading(self.features, self.speed)
        in_mould, none = errors.in_forces_of(stress * over), self.speed * errors.lag <= APART
        late = (
            in_mould._replace(lag=jnp.where(none, SMALL, errors.lag)) if LAG in self.told else None
        )
        moved, turns = mould.moved(known, in_mould, over, late)

        def added(moved: Array, turn: Array) -> Array:
            stronger = self._stronger(known, by_stress, turn[0])
            top, depth, strength = self._scalars
            parts = [(mould.rows, moved)]
            if len(rows := crushing_rows(self.features)):
                broken = known + stronger
                crushing = crushing_moved(
                    self.features, self.crushing_speed, broken, errors, slender
                )
                parts += [(rows, crushing), (strength, crushing[-2:-1])]
            largest = jnp.where(jnp.abs(known) < LARGEST, known, 0.0)[top]
            parts.append((top, errors.gain * largest + errors.offset + turn[1] * largest))
            if len(depth):
                parts.append((depth, mould.deeper(in_mould, over)[None]))
            return _in_rows(parts, len(values)) + filled + stronger

        found = jax.vmap(added)(moved, turns)
        if late is None:
            return found[0]
        return jnp.where(none, found[0] + (found[1] - found[0]) * errors.lag / SMALL, found[1])

    def _stronger(self, values: Array, by_stress: Array, turn: Array) -> Array:
        """What crushing features (m,) change as a soil was pressed to 1 + turn times the force: as
        a power of it, whose own slopes are left out."""
        some = self._crushed & (jnp.abs(values) > LEAST_FORCE) & (jnp.abs(values) < LARGEST)
        safe = jnp.where(some, values, 1.0)
        power = jax.lax.stop_gradient(jnp.clip(by_stress / safe, *POWERS))
        return jnp.where(some, safe * ((1 + turn) ** power - 1), 0.0)

    @property
    def _crushed(self) -> np.ndarray:
        """Mask (m,) of forces as the soil is crushed."""
        return np.array([f.test == CRUSHED and f.unit == "N" for f in self.features])

    @property
    def _scalars(self) -> tuple[np.ndarray, ...]:
        """The features of these kinds or names, if there are any: TOP, DEPTH, STRENGTH."""
        named = [(f.kind, f.name) for f in self.features]
        return tuple(
            np.array([i for i, names in enumerate(named) if wanted in names], int)
            for wanted in (TOP, DEPTH, STRENGTH)
        )

    def _errors(self, strengths: Array) -> MachineErrors:
        """Strengths (e,) in mm, N and s; those that are not told here are none."""
        of = {
            name: strengths[i] * (1e3 if EFFECTS[name].about.unit in MILLIMETRES else 1.0)
            for i, name in enumerate(self.told)
        }
        none = jnp.zeros(())
        parts = [of.get(name, none) for name in MACHINE]
        return MachineErrors(*parts, closing_force=self.closing_force)


@eqx.filter_jit
def overloads(machine: Machine, strengths, shape) -> Array:
    """`Machine.overload` (n,) of rows (n, e), (n, 2)."""
    return jax.vmap(machine.overload)(strengths, shape)


@eqx.filter_jit
def shifts(machine: Machine, values, strengths, shape, by_stress) -> Array:
    """`Machine.shift` (n, m) of rows (n, m), (n, e), (n, 2), (n, m)."""
    return jax.vmap(machine.shift)(values, strengths, shape, by_stress)
