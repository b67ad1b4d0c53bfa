"""Confined compression: the platen comes down in the mould to a force, holds, and returns.

The nominal rate is the laboratory's (8 mm/s in the paper); the simulated rate is faster
and explicit, and has to be shown to be quasi-static (inertial number, halved rate).
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import (
    RESPONSE,
    AbstractApparatus,
    Damping,
    Movement,
    Reading,
    Readings,
    curve_of,
)
from jdem.core.quantity import Real, cast, quantity
from jdem.engine.segment import KEEP, LOWER, Segment, cell_segment
from jdem.observables import Curve, depression_depth, displacement_at

OVERSHOOT = 2.0  # servo widths


class ConfinedCompression(AbstractApparatus):
    """Loads to force_high (N) at simulated_rate (m/s), holds for `hold` (s), unloads.

    The platen slows down within servo_width (N) of its target and stops when the force is within
    `tolerance` (N) of it; its drive follows the servo in `response` (s).  On loading the target
    lies OVERSHOOT widths beyond force_high, so that force_high is passed at full speed and no
    creep of the bed at standstill is counted as depression; stroke (m) is the farthest it may go.
    The curve's displacement counts from seating_force (N).  `further` movements may follow.
    """

    simulated_rate: Real = quantity(0.1)
    nominal_rate: Real = quantity(8e-3)
    force_low: Real = quantity(200.0)
    force_high: Real = quantity(400.0)
    servo_width: Real = quantity(1.5)
    response: Real = quantity(RESPONSE)
    tolerance: Real = quantity(0.75)
    stroke: Real = quantity(0.025)
    hold: Real = quantity(0.0)
    damping: Damping = eqx.field(default_factory=Damping)
    seating_force: float = eqx.field(static=True, default=2.0)
    name: str = eqx.field(static=True, default="confined")
    further: tuple[Movement, ...] = ()

    def movements(self) -> list[Movement]:
        scale, longest = self.simulated_rate / self.nominal_rate, self.stroke / self.simulated_rate
        return [
            Movement("loading", self._towards(self._beyond_force_high(), longest, LOWER), scale),
            Movement("holding", self._holding(), scale),
            Movement("unloading", self._towards(0.0, longest, KEEP), scale),
            *self.further,
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        loading = curve_of(readings, movement == 0)
        thresholds = cast((self.force_low, self.force_high), readings.force.dtype)
        highest = jnp.max(loading.force * loading.valid)
        return Reading(
            curve=self._whole(readings, movement, loading),
            observables={"depression_depth": depression_depth(loading, *thresholds)},
            complete=highest >= self.force_high,
        )

    @property
    def observables(self) -> tuple[str, ...]:
        return ("depression_depth",)

    @property
    def required_force(self) -> Real:
        return self.force_high

    @property
    def reference_force(self) -> Real:
        return self.force_low

    def at_rate(self, factor: float) -> "ConfinedCompression":
        return replace(self, simulated_rate=self.simulated_rate * factor)

    def _whole(self, readings: Readings, movement: Array, loading: Curve) -> Curve:
        """All movements; displacement counts from the seating force."""
        valid = ((movement >= 0) & (movement < len(self.names))).astype(readings.force.dtype)
        zero = displacement_at(loading, self.seating_force)
        travel = readings.travel - readings.travel[jnp.argmax(valid)] - zero
        return Curve(travel * valid, readings.force * valid, valid, readings.window)

    def _beyond_force_high(self) -> Real:
        return self.force_high + OVERSHOOT * self.servo_width

    def _towards(self, force, duration, platen) -> Segment:
        return cell_segment(
            platen_speed=self.simulated_rate,
            force_target=force,
            servo_width=self.servo_width,
            response=self.response,
            tolerance=self.tolerance,
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=duration,
            platen=platen,
        )

    def _holding(self) -> Segment:
        return Segment(
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=self.hold,
        )
