"""A hollow cylinder without end, the soil inside; its radius may grow.

distance = radius - |u|                  u = (r - reference) across the axis
velocity = speed axis + growth u/|u| + spin radius axis x u/|u|
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
    times,
    turned,
)
from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.vector import Vector


class Cylinder(AbstractBoundary):
    """A mould; radius in m."""

    reference: Vector
    rates: Rates
    axis: Axis = eqx.field(static=True)
    radius: Array

    @staticmethod
    def at(reference: Vector, axis: Axis, size: Real) -> "Cylinder":
        dtype = reference.x.dtype
        return Cylinder(reference, Rates.zero(dtype), axis, jnp.asarray(size, dtype))

    def surface(self, position: Vector) -> Surface:
        radial = across(self.axis, position - self.reference)
        off_axis = smooth.norm(radial)
        parts = [smooth.divide(part, off_axis) for part in (radial.x, radial.y, radial.z)]
        outward = across(self.axis, Vector(*parts))
        sliding = turned(self.axis, outward) * (self.radius * self.rates.spin)
        opening = outward * self.rates.growth
        return Surface(
            distance=self.radius - off_axis,
            normal=-outward,
            velocity=times(self.axis, self.rates.speed) + opening + sliding,
        )

    def distance(self, position: Vector) -> Array:
        return self.radius - self._off_axis(position)

    def moved(self, time_step: Real) -> "Cylinder":
        reference = self.reference + times(self.axis, self.rates.speed * time_step)
        radius = self.radius + self.rates.growth * time_step
        return eqx.tree_at(lambda b: (b.reference, b.radius), self, (reference, radius))

    def removed(self) -> "Cylinder":
        return self._of(jnp.full_like(self.radius, FAR))

    def touching(self, position: Vector, radius: Array) -> "Cylinder":
        return self._of(jnp.max(self._off_axis(position) + radius))

    def travelled(self, since: Self) -> Array:
        return jnp.abs(self.radius - since.radius)

    @property
    def size(self) -> Array:
        return self.radius

    def _off_axis(self, position: Vector) -> Array:
        return smooth.norm(across(self.axis, position - self.reference))

    def _of(self, radius: Array) -> "Cylinder":
        return eqx.tree_at(lambda b: b.radius, self, radius)
