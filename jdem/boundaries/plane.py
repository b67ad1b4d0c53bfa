"""A plane without end; its axis is the normal that points into the soil.

distance = axis . (r - reference)        velocity = speed axis + spin axis x (r - reference)
"""

from typing import Self

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.base import (
    FAR,
    AbstractBoundary,
    Axis,
    Rates,
    Surface,
    across,
    along,
    times,
    turned,
)
from jdem.core.quantity import Real
from jdem.core.vector import Vector


class Plane(AbstractBoundary):
    """A base or a platen; it has no size, so growth moves nothing."""

    reference: Vector
    rates: Rates
    axis: Axis = eqx.field(static=True)

    @staticmethod
    def at(reference: Vector, axis: Axis, size: Real = 0.0) -> "Plane":
        return Plane(reference, Rates.zero(reference.x.dtype), axis)

    def surface(self, position: Vector) -> Surface:
        offset = position - self.reference
        sliding = turned(self.axis, offset) * self.rates.spin
        one = jnp.ones_like(self.rates.speed)
        return Surface(
            distance=along(self.axis, offset),
            normal=times(self.axis, one),
            velocity=times(self.axis, self.rates.speed) + sliding,
        )

    def distance(self, position: Vector) -> Array:
        return along(self.axis, position - self.reference)

    def moved(self, time_step: Real) -> "Plane":
        return self._at(self.reference + times(self.axis, self.rates.speed * time_step))

    def removed(self) -> "Plane":
        return self._at_height(jnp.asarray(-FAR, self.rates.speed.dtype))

    def touching(self, position: Vector, radius: Array) -> "Plane":
        return self._at_height(-jnp.max(radius - along(self.axis, position)))

    def travelled(self, since: Self) -> Array:
        return jnp.abs(along(self.axis, self.reference - since.reference))

    @property
    def size(self) -> Array:
        return jnp.full_like(self.rates.growth, jnp.inf)

    def driven(self, rates: Rates) -> "Plane":
        rates = Rates(rates.speed, rates.spin, jnp.zeros_like(rates.growth))
        return eqx.tree_at(lambda b: b.rates, self, rates)

    def _at_height(self, height: Array) -> "Plane":
        """Its reference point moved along the axis to `height` (m)."""
        return self._at(across(self.axis, self.reference) + times(self.axis, height))

    def _at(self, reference: Vector) -> "Plane":
        return eqx.tree_at(lambda b: b.reference, self, reference)
