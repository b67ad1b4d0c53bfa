"""Repose angle: a tube full of soil is lifted, and the heap that is left has a slope.

    h(rho) = solid volume of a ring / (solid fraction x area of the ring)       mass profile
    angle = atan of the least-squares slope of h where it is 20 to 80 % of its height in the middle

Three angles are given, because the definition is worth more than the physics: of the mass profile,
which no single sphere decides; of height over base, atan(h/R); of the highest sphere in each piece
of a ring, which single spheres at the toe pull down.  Spheres that do not hang together with the
heap are left out.  What stands as it stood in the tube has no angle of repose: compare the heap's
height with that of the bed.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import (
    FORCE,
    PLACE,
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
from jdem.boundaries.composite import MOULD, PLATEN
from jdem.boundaries.revolved import Revolved
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import CELL, HOME, REMOVE, Segment
from jdem.engine.state import Bed, BedState

REST = 0.05  # s, simulated, in the tube without a lid
CALM = 0.2  # s, simulated, after the tube is up
SOLID = 0.6  # solid fraction that a heap is reckoned with
SPREADS = 4.0  # times the tube's diameter, as wide as a heap may be
RINGS = 40  # each as wide as a sphere
SECTORS = 8  # in which highest spheres are looked for
NEAR = 1.02  # of the sum of radii, within which spheres hang together
FLANK = (0.2, 0.8)  # of the height in the middle, between which the slope is taken
FARTHEST = 0.99  # share of the heap's spheres that lie within its base


class LiftedCylinder(AbstractApparatus):
    """Lifts the `tube` through `stroke` (m) at simulated_rate (m/s), then lets the heap rest.

    resting_damping (1/s) acts before the lift; the base has the platen's friction.  The observables
    are angles in rad, and the heap's height (m).
    """

    tube: Tool
    simulated_rate: Real = quantity(0.05)
    nominal_rate: Real = quantity(0.01)
    stroke: Real = quantity(0.06)
    rest: Real = quantity(REST)
    calm: Real = quantity(CALM)
    resting_damping: Real = quantity(500.0)
    name: str = eqx.field(static=True, default="repose_angle")

    def movements(self) -> list[Movement]:
        scale = self.simulated_rate / self.nominal_rate
        lift = {"speed": {CELL: self.simulated_rate}}
        return [
            Movement("standing", self._standing(), testing=False, resting=True),
            Movement("lifting", self._passing(self.stroke / self.simulated_rate, **lift), scale),
            Movement("coming to rest", self._passing(self.calm), testing=False, free=True),
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        lifted = curve_of(readings, movement == 1)
        return Reading(lifted, {}, jnp.sum(lifted.valid) > 0)

    def at_end(self, bed: Bed, state: BedState) -> dict[str, Array]:
        return Heap.of(bed, state).measured()

    @property
    def observables(self) -> tuple[str, ...]:
        return ("repose_angle", "repose_angle_by_height", "repose_angle_by_top", "heap_height")

    @property
    def no_number(self) -> str:
        return (
            "the heap has no flank between a fifth and four fifths of its height: the soil stands "
            "as it stood in the tube, or its spheres are too large"
        )

    @property
    def tools(self) -> tuple[Tool, ...]:
        return (self.tube,)

    @property
    def spreads(self) -> float:
        return SPREADS

    @property
    def travel(self) -> Channel:
        return Channel("travel", PLACE, (CELL,), UP)

    @property
    def force(self) -> Channel:
        return Channel("drag", FORCE, (CELL,), DOWN)

    def at_rate(self, factor: float) -> "LiftedCylinder":
        return replace(self, simulated_rate=self.simulated_rate * factor)

    def _standing(self) -> Segment:
        placed = {PLATEN: REMOVE, MOULD: REMOVE, CELL: HOME}
        return machine_segment(
            1, placed=placed, damping=self.resting_damping, duration=self.rest, servo=CELL
        )

    def _passing(self, duration: Real, speed: dict[int, Real] | None = None) -> Segment:
        return machine_segment(1, speed=speed, duration=duration, servo=CELL)


def tube(diameter: float, height: float) -> Tool:
    """A tube on the base, twice as high as the soil in it, m."""
    line = [(diameter / 2, 0.0), (diameter / 2, 2 * height)]
    made = Revolved.of(line, point(0.0, 0.0, 0.0, float), UP)
    return Tool("tube", made, math.pi * diameter * height, "mould")


# ---------------------------------------------------------------- the heap


class Heap(eqx.Module):
    """Spheres of a heap: distance from its axis (m), angle about it (rad), height of the centre and
    radius (m), all of shape (N,), and `inside`, 1 for those that hang together with it."""

    off_axis: Array
    around: Array
    height: Array
    radius: Array
    inside: Array

    @staticmethod
    def of(bed: Bed, state: BedState) -> "Heap":
        """The heap about the sphere nearest to the axis; its own axis is the mean of its places."""
        position, radius = bed.spheres.positions(state.motion), bed.spheres.radius
        first, second = state.pairs.first, state.pairs.second
        apart = jnp.sqrt(jnp.sum((position.stack()[first] - position.stack()[second]) ** 2, -1))
        touch = (state.pairs.alive > 0) & (apart < NEAR * (radius[first] + radius[second]))
        inside = _hanging_together(jnp.hypot(position.x, position.y), first, second, touch)
        count = jnp.sum(inside)
        middle = [jnp.sum(inside * part) / count for part in (position.x, position.y)]
        x, y = position.x - middle[0], position.y - middle[1]
        return Heap(jnp.hypot(x, y), jnp.arctan2(y, x), position.z, radius, inside)

    def measured(self) -> dict[str, Array]:
        """Angles (rad) and the height (m)."""
        width = 2 * jnp.mean(self.radius)
        ring = jnp.clip((self.off_axis / width).astype(jnp.int32), 0, RINGS - 1)
        rings = jnp.arange(RINGS)
        middle = (rings + 0.5) * width
        solid = 4 / 3 * jnp.pi * self.radius**3 * self.inside
        area = jnp.pi * width**2 * (2 * rings + 1)
        profile = jnp.zeros(RINGS).at[ring].add(solid) / (SOLID * area)
        tops = self.inside * (self.height + self.radius)
        sector = ((self.around / (2 * jnp.pi) + 0.5) * SECTORS).astype(jnp.int32) % SECTORS
        highest = jnp.zeros((SECTORS, RINGS)).at[sector, ring].max(tops)
        within = jnp.where(self.inside > 0, self.off_axis, jnp.nan)
        whole = jnp.max(tops)
        return {
            "repose_angle": _slope(middle, profile, jnp.mean(profile[:2])),
            "repose_angle_by_height": jnp.arctan(whole / jnp.nanquantile(within, FARTHEST)),
            "repose_angle_by_top": _slope(jnp.tile(middle, SECTORS), highest.ravel(), whole),
            "heap_height": whole,
        }


def _slope(place: Array, height: Array, whole: Array) -> Array:
    """Angle (rad) of the least-squares line through the flank of a profile (points,); NaN where
    fewer than two points are on it."""
    chosen = jnp.where((height > FLANK[0] * whole) & (height < FLANK[1] * whole), 1.0, 0.0)
    count = jnp.where(jnp.sum(chosen) < 2, jnp.nan, jnp.sum(chosen))
    x, y = (part - jnp.sum(chosen * part) / count for part in (place, height))
    return jnp.arctan(-jnp.sum(chosen * x * y) / jnp.sum(chosen * x * x))


def _hanging_together(off_axis: Array, first: Array, second: Array, touch: Array) -> Array:
    """1 for spheres that contacts connect with the one nearest to the axis, shape (N,)."""
    begun = jnp.zeros_like(off_axis).at[jnp.argmin(off_axis)].set(1.0)
    held = jnp.where(touch, 1.0, 0.0)

    def spread(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        reached, _ = carry
        wider = reached.at[first].max(held * reached[second]).at[second].max(held * reached[first])
        return wider, jnp.sum(wider) > jnp.sum(reached)

    return jax.lax.while_loop(lambda carry: carry[1], spread, (begun, jnp.asarray(True)))[0]
