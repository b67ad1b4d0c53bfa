"""Direct shear: a box of two halves, the lower one moved sideways under a lid that keeps its force.

    tau = T/A        T: horizontal force on the upper half and the lid; A: of the unsheared plane
    sigma = N/A      N: on the lid; beside it the vertical force on the lower half, ON the plane

(ASTM D3080.)  A is not corrected for the overlap that shrinks: tau/sigma does not depend on it.
Friction on the upper half takes part of the lid's force, or adds to it where soil dilates against
the walls, so that the plane has another normal stress than the lid: both are recorded.

Spheres cannot leave by the gap: each half has a lip around it, as wide as the halves move.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import (
    FORCE,
    PLACE,
    RESPONSE,
    AbstractApparatus,
    Channel,
    Movement,
    Reading,
    Readings,
    Tool,
    curve_of,
    machine_segment,
)
from jdem.boundaries.base import DOWN, UP, point
from jdem.boundaries.composite import BASE, MOULD, PLATEN
from jdem.boundaries.revolved import Revolved
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import CELL, HOME, KEEP, LOWER, REMOVE, Segment
from jdem.observables import crushing_force, running_mean

SIDEWAYS = (1.0, 0.0, 0.0)  # where the lower half goes
SETTLING = 0.03  # s, simulated, in which the lid's force comes to rest
AT_END = 0.2  # of the travel, over which the residual stress is a mean
BAND = 10.0  # diameters; usual height of a shear band
PEAK_WIDTH = 0.02  # of the lid's force, over which the peak is rounded


class DirectShear(AbstractApparatus):
    """Moves `lower` through `stroke` (m) at simulated_rate (m/s) under a lid of normal_force (N).

    lower and upper are the halves; area (m2) is that of the plane.  The lid (the cell's platen)
    follows its force at lid_speed (m/s) at most, with servo_width (N) and response (s) as in
    `Segment`; resting_damping (1/s) acts while the specimen consolidates.  The peak is taken of
    the force averaged over peak_rows samples, and rounded over `PEAK_WIDTH` of the lid's force:
    of a force that rises to the end it is that much too low.
    """

    lower: tuple[Tool, ...]
    upper: tuple[Tool, ...]
    area: Real = quantity()
    normal_force: Real = quantity()
    simulated_rate: Real = quantity(0.02)
    nominal_rate: Real = quantity(1e-5)
    stroke: Real = quantity(6e-3)
    lid_speed: Real = quantity(0.05)
    servo_width: Real = quantity(15.0)
    response: Real = quantity(RESPONSE)
    consolidating: Real = quantity(0.2)
    resting_damping: Real = quantity(500.0)
    peak_rows: int = eqx.field(static=True, default=9)
    name: str = eqx.field(static=True, default="direct_shear")

    def movements(self) -> list[Movement]:
        scale = self.simulated_rate / self.nominal_rate
        return [
            Movement("consolidating", self._consolidating(), testing=False),
            Movement("settling", self._settling(), testing=False, resting=True),
            Movement("shearing", self._shearing(), scale),
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        curve = curve_of(readings, movement == 2)
        smooth = running_mean(curve, self.peak_rows)
        peak = crushing_force(smooth, PEAK_WIDTH * self.normal_force) / self.area
        late = curve.valid * (curve.displacement >= (1 - AT_END) * jnp.max(curve.displacement))
        channels = {name: rows * curve.valid for name, rows in readings.channels.items()}
        on_plane = replace(curve, force=channels["plane_force"])
        there = jnp.argmax(jnp.where(curve.valid > 0, smooth.force, -jnp.inf))
        found = {
            "peak_shear_stress": peak,
            "residual_shear_stress": jnp.sum(curve.force * late) / jnp.sum(late) / self.area,
            "plane_stress": running_mean(on_plane, self.peak_rows).force[there] / self.area,
        }
        return Reading(curve, found, jnp.isfinite(peak), channels)

    @property
    def observables(self) -> tuple[str, ...]:
        return ("peak_shear_stress", "residual_shear_stress", "plane_stress")

    @property
    def tools(self) -> tuple[Tool, ...]:
        return (*self.lower, *self.upper)

    @property
    def travel(self) -> Channel:
        return Channel("travel", PLACE, (CELL,), SIDEWAYS)

    @property
    def force(self) -> Channel:
        return Channel("shear_force", FORCE, (PLATEN, *self._upper), SIDEWAYS)

    @property
    def channels(self) -> tuple[Channel, ...]:
        return (
            Channel("plane_force", FORCE, tuple(self._lower), DOWN),
            Channel("lid_force", FORCE, (PLATEN,), UP),
            Channel("lid_height", PLACE, (PLATEN,), UP),
        )

    @property
    def required_force(self) -> Real:
        return self.normal_force

    def sheared(self, observables: dict[str, Array], diameter: Real) -> tuple[Real, Real]:
        return self.simulated_rate / (BAND * diameter), observables["plane_stress"]

    def at_rate(self, factor: float) -> "DirectShear":
        return replace(self, simulated_rate=self.simulated_rate * factor).sampled(1 / factor)

    def sampled(self, ratio: float) -> "DirectShear":
        """With the peak averaged over `ratio` times as many rows (an odd number)."""
        return replace(self, peak_rows=2 * int(self.peak_rows * ratio / 2) + 1)

    @property
    def _lower(self) -> range:
        return range(CELL, CELL + len(self.lower))

    @property
    def _upper(self) -> range:
        return range(CELL + len(self.lower), CELL + len(self.tools))

    def _consolidating(self) -> Segment:
        halves = dict.fromkeys((*self._lower, *self._upper), HOME)
        cell = {BASE: REMOVE, MOULD: REMOVE, PLATEN: LOWER}
        width = 0.02 * self.normal_force
        return self._under_lid(halves | cell, self.consolidating, self.resting_damping, width)

    def _settling(self) -> Segment:
        return self._under_lid({PLATEN: KEEP}, SETTLING, self.resting_damping)

    def _shearing(self) -> Segment:
        still = self._under_lid({PLATEN: KEEP}, self.stroke / self.simulated_rate, 0.0)
        moved = still.speed.at[jnp.asarray(self._lower)].set(self.simulated_rate)
        return replace(still, speed=moved)

    def _under_lid(self, placed, duration: Real, damping: Real, tolerance: Real = 0.0) -> Segment:
        """The lid under its force; the movement ends within `tolerance` (N) of it."""
        return machine_segment(
            len(self.tools),
            speed={PLATEN: self.lid_speed},
            placed=placed,
            force_target=self.normal_force,
            servo_width=self.servo_width,
            response=self.response,
            tolerance=tolerance,
            damping=damping,
            duration=duration,
        )


def round_box(
    diameter: float, height: float, plane: float, gap: float, lip: float
) -> tuple[tuple[Tool, ...], tuple[Tool, ...]]:
    """Both halves of a round box, m: the lower one with its floor at z = 0, the middle of the gap
    at the height `plane`, the upper one twice as high as the soil; lips of width `lip`."""
    radius, rim = diameter / 2, diameter / 2 + lip
    below, above, top = plane - gap / 2, plane + gap / 2, 2 * height
    floor = [(0.0, 0.0), (rim, 0.0)]
    lower = [(radius, 0.0), (radius, below), (rim, below)]
    upper = [(rim, above), (radius, above), (radius, top)]
    around = math.pi * diameter
    return (
        (
            _half("lower_wall", lower, around * below, SIDEWAYS),
            _half("floor", floor, math.pi * radius**2, SIDEWAYS, "platen"),
        ),
        (_half("upper_wall", upper, around * height, UP),),
    )


def _half(name: str, line, area: float, axis, surface: str = "mould") -> Tool:
    made = Revolved.of(line, point(0.0, 0.0, 0.0, float), axis, about=UP)
    return Tool(name, made, area, surface)
