"""Overdamped tangents."""

import equinox as eqx
import jax
from jax import Array

from jdem.core.quantity import Real, quantity
from jdem.engine.loop import AbstractDerivative
from jdem.engine.state import Bed, BedState, Command
from jdem.engine.step import next_motion, step


class OverdampedMotion(AbstractDerivative):
    damping: Real = quantity(1e4)
    cut: bool = eqx.field(static=True, default=True)
    first: int = eqx.field(static=True, default=0)

    def seen(self, force: Array) -> Array:
        return jax.lax.stop_gradient(force) if self.cut else force

    def step(self, bed: Bed, state: BedState, command: Command) -> BedState:
        share = jax.lax.stop_gradient(1 / (1 + self.damping * bed.time_step))

        def motions(*given):
            return next_motion(*given, share)

        return step(bed, state, command, motions)
