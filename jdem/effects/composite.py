"""All effects of the library, and what several of them do together to a sequence of tests.

A new effect is one file beside this one and one line in EFFECTS.  Laws are wrapped in the
order of the effects; errors of instruments add up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import Readings
from jdem.bodies.spheres import Spheres
from jdem.core.quantity import Real, as_quantity, cast, quantity
from jdem.core.smooth import Smoothing
from jdem.effects.base import FADING_STRAIN, About, AbstractEffect, Stage
from jdem.effects.capillary import CapillaryTension
from jdem.effects.cementation import Cementation
from jdem.effects.compliance import LoadFrameCompliance
from jdem.effects.density import SpecimenDensity
from jdem.effects.drift import LoadCellDrift
from jdem.effects.gain import LoadCellGain
from jdem.effects.lag import AcquisitionLag
from jdem.effects.offset import LoadCellOffset
from jdem.effects.platen_friction import PlatenFriction
from jdem.effects.rate import RateDependence
from jdem.effects.seating import SeatingGap
from jdem.effects.second_test import SecondTestFactor
from jdem.effects.wall_friction import WallFriction
from jdem.engine.bed import friction_of_walls, stable_time_step
from jdem.engine.schedule import AbstractSurroundings
from jdem.engine.step import Bed, BedState
from jdem.materials.soil import SoilParameters, particle_law, wall_law

TOUCH = 1.0  # N; below it errors fade for the servo: it returns until the platen is free

EFFECTS: dict[str, type[AbstractEffect]] = {
    "load_frame_compliance": LoadFrameCompliance,
    "seating_gap": SeatingGap,
    "load_cell_gain": LoadCellGain,
    "load_cell_offset": LoadCellOffset,
    "load_cell_drift": LoadCellDrift,
    "acquisition_lag": AcquisitionLag,
    "wall_friction": WallFriction,
    "platen_friction": PlatenFriction,
    "second_test_factor": SecondTestFactor,
    "capillary_tension": CapillaryTension,
    "cementation": Cementation,
    "rate_dependence": RateDependence,
    "specimen_density": SpecimenDensity,
}


def with_strengths(
    effects: Sequence[AbstractEffect], strengths: Sequence[Real] | Array
) -> tuple[AbstractEffect, ...]:
    """The effects with other strengths, one for each; traced values are fine."""
    return tuple(
        eqx.tree_at(lambda e: e.strength, effect, as_quantity(strength))
        for effect, strength in zip(effects, strengths, strict=True)
    )


def as_table(entries: Mapping[str, About]) -> str:
    """What is known about effects or settings, as a table in Markdown; all are off at 0."""
    head = "| name | strength | unit | typical | in the mould | free | alike | source |"
    rows = [head, "|" + " --- |" * 8]
    for name, about in entries.items():
        sides = ">= 0: " if about.one_sided else ""
        typical = f"{sides}{about.typical[0]:.2g} to {about.typical[1]:.2g}"
        alike = ", ".join(about.confounders)
        cells = [name, about.quantity, about.unit, typical, about.in_mould, about.free]
        rows.append("| " + " | ".join([*cells, alike, about.source]) + " |")
    return "\n".join(rows)


class Timetable(eqx.Module):
    """What the segments of the tests are to effects; arrays (segments,).

    time_scale is nominal over simulated time (-); platen_speed (m/s, simulated) the machine's,
    0 where it stands; testing is 1 in segments in which a test runs and time counts; free and
    resting as in `Stage`; test is the number of the test.
    """

    time_scale: Array
    platen_speed: Array
    testing: Array
    free: Array
    resting: Array
    test: Array


class Clock(eqx.Module):
    """Nominal time (s) since the load cell was tared, and the rate of the first test over the
    rate that the soil feels (-)."""

    time: Array
    slowness: Array


class Altered(AbstractSurroundings):
    """The surroundings of the tests under some effects.

    soil and smoothing are the base model's; mean_diameter (m) the spheres'; reference_rate
    (1/s) the nominal axial strain rate of the first test.
    """

    effects: tuple[AbstractEffect, ...]
    soil: SoilParameters
    smoothing: Smoothing
    timetable: Timetable
    mean_diameter: Array = quantity()
    reference_rate: Real = quantity()

    def begin(self, dtype) -> Clock:
        return Clock(jnp.zeros((), dtype), jnp.ones((), dtype))

    def bed(self, bed: Bed, segment: Array, memory: Clock) -> Bed:
        soil, between, walls = self._laws(self.stage(segment, memory))
        present = (between, walls, soil.static_friction, friction_of_walls(soil, bed.surfaces))
        present = cast(present, jnp.asarray(bed.time_step).dtype)
        return eqx.tree_at(
            lambda b: (b.particle_law, b.wall_law, b.friction, b.wall_friction), bed, present
        )

    def time_step(self, spheres: Spheres, safety: float) -> Array:
        """Time step (s) that is stable before the tests and in the last of them, where bonds have
        grown and the soil has changed."""
        off, on = jnp.zeros(()), jnp.ones(())
        stages = (Stage(off, off, off), Stage(on, on, off))
        laws = [self._laws(stage)[1:] for stage in stages]
        first, last = (stable_time_step(spheres, *pair, safety) for pair in laws)
        return jnp.minimum(first, last)

    def _laws(self, stage: Stage):
        """Soil, law between spheres, law at walls."""
        soil = self.soil
        for effect in self.effects:
            soil = effect.soil(soil, stage)
        between = particle_law(soil, self.mean_diameter, self.smoothing)
        for effect in self.effects:
            between = effect.law(between, stage)
        return soil, between, wall_law(soil, self.mean_diameter, self.smoothing)

    def shown(self, reading: Array, memory: Clock) -> Array:
        touching = jnp.clip(reading / TOUCH, 0.0, 1.0)
        shown = reading
        for effect in self.effects:
            error = effect.servo_error(reading, memory.time)
            shown = shown + (touching * error).astype(reading.dtype)
        return shown

    def later(self, memory: Clock, segment: Array, before: BedState, after: BedState) -> Clock:
        time_scale = self.timetable.time_scale[segment]
        elapsed = after.time - before.time
        interval = elapsed * time_scale
        # At the machine's own speed: a servo that slows down before its target is the simulation's
        # way to turn, and a soil that softened by it would never let it arrive.
        strain = self.timetable.platen_speed[segment] * elapsed / before.platen_height
        clock = Clock(
            (memory.time + interval) * self.timetable.testing[segment],
            _slowed(memory.slowness, strain, self.reference_rate * interval),
        )
        return cast(clock, after.time.dtype)

    def stage(self, segment: Array, memory: Clock) -> Stage:
        """Where the tests stand in this segment."""
        return Stage(
            free=self.timetable.free[segment],
            resting=self.timetable.resting[segment],
            log_rate=-jnp.log10(memory.slowness),
        )


def _slowed(slowness: Array, strain: Array, reference: Array) -> Array:
    """The slowness w = v_c/v after an interval, v following dv/dt = v (v_machine - v)/A.

    w' = w exp(-x) + (r/A) (1 - exp(-x))/x, x = strain/A: exact for a steady machine; r is the
    strain of the interval at the first test's nominal rate.
    """
    share = strain / FADING_STRAIN
    moving = share > 1e-6
    safe = jnp.where(moving, share, 1.0)
    mean = jnp.where(moving, -jnp.expm1(-safe) / safe, 1.0)
    return slowness * jnp.exp(-share) + reference / FADING_STRAIN * mean


def recorded(
    effects: Sequence[AbstractEffect], readings: Readings, force: Array, time: Array
) -> Readings:
    """Readings with all errors of the instruments, from the true force (N) and the nominal
    time (s) since the load cell was tared."""
    travel, shown = readings.travel, readings.force
    for effect in effects:
        travel = travel + effect.travel_error(force)
        shown = shown + effect.force_error(readings.force, time)
    return replace(readings, travel=travel, force=shown)
