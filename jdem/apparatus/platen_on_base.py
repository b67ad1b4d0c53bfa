"""The platen on the bare base: pressed to a force and let go again, with no soil between them.

    F(t) = F t/T on loading,  F (2 - t/T) on unloading      travel: 0, platen and base are rigid

What such a test shows is the machine alone, so a laboratory runs it to know what its curves hold
of frame, platens and load cell.  `jdem.laboratory.bare_machine` runs it: it needs no bed.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import AbstractApparatus, Movement, Reading, Readings, curve_of
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import Segment

SIMULATED = 0.01  # s; of each movement


class PlatenOnBase(AbstractApparatus):
    """Loads to `force` (N) within `loading` (s, in the laboratory), and unloads as fast.

    The platen stands, so both rates (m/s) and the stroke (m) are 0.  The observable is the
    deflection (m): displacement where the force turns.
    """

    force: Real = quantity(400.0)
    loading: Real = quantity(60.0)
    simulated_rate: Real = quantity(0.0)
    nominal_rate: Real = quantity(0.0)
    stroke: Real = quantity(0.0)
    name: str = eqx.field(static=True, default="machine")

    def movements(self) -> list[Movement]:
        scale = self.loading / SIMULATED
        targets = (("loading", self.force), ("unloading", 0.0))
        return [
            Movement(name, Segment(force_target=target, duration=SIMULATED), scale)
            for name, target in targets
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        curve = curve_of(readings, (movement >= 0) & (movement < 2))
        rows = jnp.arange(movement.shape[0])
        turn = jnp.max(jnp.where(movement == 0, rows, 0))
        return Reading(curve, {"deflection": curve.displacement[turn]}, jnp.asarray(True))

    @property
    def observables(self) -> tuple[str, ...]:
        return ("deflection",)

    @property
    def required_force(self) -> Real:
        return self.force

    def at_rate(self, factor: float) -> "PlatenOnBase":
        return self
