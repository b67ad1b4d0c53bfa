"""Vane shear: a cross of four blades pushed into the bed and turned.

    s_u = T / K        K = pi D^2 H/2 (1 + D/(3 H))        uniform stress on mantle and both ends

(ASTM D4648.)  T is the torque about the vane's axis.  In soil with friction the vane measures
c + sigma tan(phi), so that it rises with depth.  Blades as thick as half a sphere are touched on
one side at a time.

The insertion leaves the vane pressed on by the soil, with more force than it weighs; so a servo
lets it rest at no axial force before it turns.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.apparatus.base import (
    RESPONSE,
    TORQUE,
    AbstractApparatus,
    Channel,
    Movement,
    Reading,
    Readings,
    Tool,
    curve_of,
    machine_segment,
)
from jdem.boundaries.base import DOWN, UP
from jdem.boundaries.composite import PLATEN
from jdem.boundaries.mesh import Mesh
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import CELL, LOWER, REMOVE, Segment
from jdem.observables import crushing_force, running_mean

REST = 0.05  # s, simulated, without the platen
SETTLING = 0.03  # s, simulated, at no axial force
AT_END = 1 / 3  # of the rotation, over which the residual torque is a mean
PEAK_WIDTH = 0.02  # of the peak, over which it is rounded


class VaneShear(AbstractApparatus):
    """Inserts the `vane` by `depth` (m) at insertion_rate (m/s), and turns it through `stroke`
    (rad) at simulated_rate (rad/s).

    constant (m3) is K.  The vane rests within servo_width (N) of no axial force; resting_damping
    (1/s) acts before the insertion.  The peak is that of the torque averaged over peak_rows
    samples; `width` (m) is the vane's, 0 if not known.  The curve is the angle (rad) and the torque
    (N m), or with a `rim` (m) the way of a point at that radius and the force there that has the
    torque.
    """

    vane: Tool
    constant: Real = quantity()
    simulated_rate: Real = quantity(5.0)
    nominal_rate: Real = quantity(math.radians(1.0))
    insertion_rate: Real = quantity(0.05)
    depth: Real = quantity(0.03)
    stroke: Real = quantity(math.pi / 2)
    rest: Real = quantity(REST)
    resting_damping: Real = quantity(500.0)
    servo_width: Real = quantity(5.0)
    response: Real = quantity(RESPONSE)
    rim: Real = quantity(1.0)
    peak_rows: int = eqx.field(static=True, default=7)
    width: float = eqx.field(static=True, default=0.0)
    name: str = eqx.field(static=True, default="vane_shear")

    def movements(self) -> list[Movement]:
        scale = self.simulated_rate / self.nominal_rate
        return [
            Movement("resting", self._resting(), testing=False, resting=True),
            Movement("inserting", self._inserting(), testing=False),
            Movement("settling", self._settling(), testing=False),
            Movement("turning", self._turning(), scale),
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        turning = movement == 3
        time = jnp.zeros_like(readings.force) if readings.time is None else readings.time
        angle = replace(readings, travel=self.simulated_rate * time)
        curve = curve_of(angle, turning)
        smooth = running_mean(curve, self.peak_rows)
        highest = jnp.max(jnp.where(curve.valid > 0, smooth.force, -jnp.inf))
        peak = crushing_force(smooth, PEAK_WIDTH * jnp.abs(highest) + 1e-12)
        last = jnp.max(curve.displacement * curve.valid)
        late = curve.valid * (curve.displacement >= (1 - AT_END) * last)
        found = {
            "peak_torque": peak,
            "residual_torque": jnp.sum(curve.force * late) / jnp.sum(late),
            "vane_strength": peak / self.constant,
        }
        at_rim = replace(
            curve, displacement=curve.displacement * self.rim, force=curve.force / self.rim
        )
        turned = {"angle": curve.displacement, "torque": curve.force}
        return Reading(at_rim, found, jnp.isfinite(peak), turned)

    @property
    def observables(self) -> tuple[str, ...]:
        return ("peak_torque", "residual_torque", "vane_strength")

    @property
    def tools(self) -> tuple[Tool, ...]:
        return (self.vane,)

    @property
    def force(self) -> Channel:
        return Channel("torque", TORQUE, (CELL,), UP)

    def sheared(self, observables: dict[str, Array], diameter: Real) -> tuple[Real, Real]:
        return self.simulated_rate, observables["vane_strength"]

    def at_rate(self, factor: float) -> "VaneShear":
        faster = replace(
            self,
            simulated_rate=self.simulated_rate * factor,
            insertion_rate=self.insertion_rate * factor,
        )
        return faster.sampled(1 / factor)

    def sampled(self, ratio: float) -> "VaneShear":
        """With the peak averaged over `ratio` times as many rows (an odd number)."""
        return replace(self, peak_rows=2 * int(self.peak_rows * ratio / 2) + 1)

    def _resting(self) -> Segment:
        away = {PLATEN: REMOVE, CELL: REMOVE}
        return machine_segment(1, placed=away, damping=self.resting_damping, duration=self.rest)

    def _inserting(self) -> Segment:
        return machine_segment(
            1,
            speed={CELL: self.insertion_rate},
            placed={CELL: LOWER},
            servo=CELL,
            duration=self.depth / self.insertion_rate,
        )

    def _settling(self) -> Segment:
        return machine_segment(
            1,
            speed={CELL: self.insertion_rate},
            servo=CELL,
            force_target=0.0,
            servo_width=self.servo_width,
            response=self.response,
            duration=SETTLING,
        )

    def _turning(self) -> Segment:
        return machine_segment(
            1,
            spin={CELL: self.simulated_rate},
            servo=CELL,
            duration=self.stroke / self.simulated_rate,
        )


def vane_constant(diameter: float, height: float) -> float:
    """K, m3."""
    return math.pi * diameter**2 * height / 2 * (1 + diameter / (3 * height))


def vane(diameter: float, height: float, thickness: float) -> Tool:
    """A cross of blades without a shaft, m; its reference point is the middle of its lower face."""
    mesh = Mesh.from_triangles(_cross(diameter / 2, height, thickness / 2), axis=DOWN, name="vane")
    area = 4 * diameter * height + 4 * diameter * thickness
    return Tool("vane", mesh, area)


def _cross(reach: float, height: float, half: float) -> np.ndarray:
    """Triangles (faces, 3, 3) of a prism whose section is a cross, outward, from z = 0 up."""
    r, t = reach, half
    outline = [(t, t), (t, r), (-t, r), (-t, t), (-r, t), (-r, -t),
               (-t, -t), (-t, -r), (t, -r), (t, -t), (r, -t), (r, t)]  # fmt: skip
    faces = []
    for (x0, y0), (x1, y1) in zip(outline, outline[1:] + outline[:1], strict=True):
        low, high = [(x0, y0, 0.0), (x1, y1, 0.0)], [(x0, y0, height), (x1, y1, height)]
        faces += [(low[0], low[1], high[1]), (low[0], high[1], high[0])]
    inner = [(t, t), (-t, t), (-t, -t), (t, -t)]
    arms = [
        [outline[k] for k in row]
        for row in ((0, 1, 2, 3), (3, 4, 5, 6), (6, 7, 8, 9), (9, 10, 11, 0))
    ]
    for quad in (inner, *arms):
        top = [(x, y, height) for x, y in quad]
        bottom = [(x, y, 0.0) for x, y in reversed(quad)]
        faces += [(side[0], side[k], side[k + 1]) for side in (top, bottom) for k in (1, 2)]
    return np.array(faces)
