"""A tool pushed down into a bed at constant speed: cone penetration and plate sinkage.

    cone index   CI = mean force over a range of depths / area of the base
    pressure     p = F / area of the plate                       p = k z^n (Bekker)

The platen is taken away, the bed comes to rest, the tool is lowered until it touches, and pushed.
Depth counts from where the force first reaches `seating_force`, less `datum`: a cone's depth is
that of its base (ASABE S313.3, EP542), so its datum is its length.  Nothing damps the bed while the
tool moves but its contacts: background damping would hold the soil that the tool pushes aside.

Standards drive tools far too slowly to be simulated.  What has to stay small is the inertial number
I = v/D d sqrt(rho/p), D the tool's width: halve the rate once and look at the change.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
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
from jdem.boundaries.revolved import Revolved
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import CELL, FOLLOW, LOWER, PLATEN, REMOVE
from jdem.observables import AbstractGauge, Curve, displacement_at

SHAFT = 0.2  # m; length of a cone's shaft, which no test uses up
REST = 0.05  # s, simulated, without the platen
SHORT = 0.02  # of a range of depths, which may be missing at its end


class Penetration(AbstractApparatus):
    """Pushes a tool through `stroke` (m) at simulated_rate (m/s).

    The first of `parts` is what is lowered and whose force is the curve's; the others go with it
    and are recorded as channels by name.  datum (m) is taken off the depth; seating_force in N;
    resting_damping (1/s) acts in `rest` (s), before the tool comes.  gauges are the observables,
    the first a pressure: with the tool's `width` (m), 0 if not known, it gives the inertial number.
    """

    parts: tuple[Tool, ...]
    gauges: tuple[AbstractGauge, ...] = ()
    simulated_rate: Real = quantity(0.05)
    nominal_rate: Real = quantity(0.03)
    stroke: Real = quantity(0.03)
    datum: Real = quantity(0.0)
    rest: Real = quantity(REST)
    resting_damping: Real = quantity(500.0)
    seating_force: float = eqx.field(static=True, default=0.0)
    width: float = eqx.field(static=True, default=0.0)
    name: str = eqx.field(static=True, default="penetration")

    def movements(self) -> list[Movement]:
        scale = self.simulated_rate / self.nominal_rate
        return [
            Movement("resting", self._resting(), testing=False, resting=True),
            Movement("pushing", self._pushing(), scale),
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        pushed = curve_of(readings, movement == 1)
        zero = displacement_at(pushed, self.seating_force) if self.seating_force else 0.0
        depth = (pushed.displacement - zero - self.datum) * pushed.valid
        curve = replace(pushed, displacement=depth)
        found = {gauge.name: gauge.of(curve, movement) for gauge in self.gauges}
        further = {name: rows * pushed.valid for name, rows in readings.channels.items()}
        return Reading(curve, found, jnp.sum(pushed.valid) > 0, further)

    @property
    def observables(self) -> tuple[str, ...]:
        return tuple(gauge.name for gauge in self.gauges)

    @property
    def tools(self) -> tuple[Tool, ...]:
        return self.parts

    @property
    def travel(self) -> Channel:
        return Channel("travel", PLACE, (CELL,), DOWN)

    @property
    def force(self) -> Channel:
        return Channel("force", FORCE, (CELL,), UP)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The upward force (N) on each further part, called like it."""
        rest = enumerate(self.parts[1:], start=CELL + 1)
        return tuple(Channel(part.name, FORCE, (number,), UP) for number, part in rest)

    def sheared(self, observables: dict[str, Array], diameter: Real) -> tuple[Real, Real] | None:
        if not (self.width and self.gauges):
            return None
        return self.simulated_rate / self.width, observables[self.gauges[0].name]

    def at_rate(self, factor: float) -> "Penetration":
        gauges = tuple(gauge.sampled(1 / factor) for gauge in self.gauges)
        return replace(self, simulated_rate=self.simulated_rate * factor, gauges=gauges)

    def sampled(self, ratio: float) -> "Penetration":
        return replace(self, gauges=tuple(gauge.sampled(ratio) for gauge in self.gauges))

    def _numbers(self) -> range:
        return range(CELL, CELL + len(self.parts))

    def _resting(self):
        away = dict.fromkeys((PLATEN, *self._numbers()), REMOVE)
        return machine_segment(
            len(self.parts), placed=away, damping=self.resting_damping, duration=self.rest
        )

    def _pushing(self):
        placed = dict.fromkeys(self._numbers(), FOLLOW) | {CELL: LOWER}
        return machine_segment(
            len(self.parts),
            speed=dict.fromkeys(self._numbers(), self.simulated_rate),
            placed=placed,
            servo=CELL,
            duration=self.stroke / self.simulated_rate,
        )


def cone(base_diameter: float, angle: float, shaft_diameter: float = 0.0) -> tuple[Tool, ...]:
    """A cone with its apex down, and its shaft; diameters in m, the full angle in degrees.

    The reference point is the apex.  ASABE S313.3: 30 degrees, 20.27 mm with a shaft of 15.88 mm or
    12.83 mm with one of 9.53 mm.  Without a shaft nothing stands above the base.
    """
    radius, length = base_diameter / 2, cone_length(base_diameter, angle)
    inner = shaft_diameter / 2
    tip = [(0.0, 0.0), (radius, -length), *([(inner, -length)] if inner < radius else [])]
    area = math.pi * radius * math.hypot(radius, length)
    parts = [_tool("tip", tip, area)]
    if shaft_diameter > 0:
        shaft = [(inner, -length), (inner, -length - SHAFT)]
        parts.append(_tool("shaft", shaft, math.pi * shaft_diameter * length))
    return tuple(parts)


def cone_length(base_diameter: float, angle: float) -> float:
    """From apex to base, m; diameter in m, full angle in degrees."""
    return base_diameter / 2 / math.tan(math.radians(angle) / 2)


def plate(diameter: float, thickness: float) -> tuple[Tool, ...]:
    """A round plate, m; its reference point is the middle of its lower face."""
    radius = diameter / 2
    line = [(0.0, 0.0), (radius, 0.0), (radius, -thickness), (0.0, -thickness)]
    return (_tool("plate", line, 2 * math.pi * radius * (radius + thickness)),)


def _tool(name: str, line: Sequence[tuple[float, float]], area: float) -> Tool:
    at = point(0.0, 0.0, 0.0, float)
    return Tool(name, Revolved.of(line, at, DOWN), area)


# ---------------------------------------------------------------- what is read off


class MeanPressure(AbstractGauge):
    """Mean force between two depths (m) over `area` (m2), Pa: the cone index; NaN where the tool
    did not come that far."""

    area: Real = quantity()
    low: Real = quantity(0.0)
    high: Real = quantity(0.03)
    name: str = eqx.field(static=True, default="cone_index")

    def of(self, curve: Curve, movement: Array) -> Array:
        known = curve.filled()
        parts = 0.5 * (known.force[1:] + known.force[:-1]) * jnp.diff(known.displacement)
        work = jnp.concatenate([jnp.zeros_like(parts[:1]), jnp.cumsum(parts)])
        ends = jnp.stack([jnp.asarray(end, work.dtype) for end in (self.low, self.high)])
        from_low, to_high = jnp.interp(ends, known.displacement, work)
        short = self.high - jnp.max(known.displacement) > SHORT * (self.high - self.low)
        mean = (to_high - from_low) / ((self.high - self.low) * self.area)
        return jnp.where(short, jnp.nan, mean)


class PressureAt(AbstractGauge):
    """Force at a depth (m), averaged over `window` (m) around it, over `area` (m2), Pa."""

    area: Real = quantity()
    depth: Real = quantity()
    window: Real = quantity(5e-4)
    name: str = eqx.field(static=True, default="sinkage_pressure")

    def of(self, curve: Curve, movement: Array) -> Array:
        half = 0.5 * self.window
        mean = MeanPressure(area=self.area, low=self.depth - half, high=self.depth + half)
        return mean.of(curve, movement)
