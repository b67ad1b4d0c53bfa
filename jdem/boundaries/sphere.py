"""A rigid sphere, the soil outside: an indenter.

distance = |u| - radius                  u = r - reference, the sphere's centre
velocity = speed axis + growth u/|u| + spin axis x (radius u/|u|)
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
from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.vector import Vector


class Sphere(AbstractBoundary):
    """An indenter; radius in m."""

    reference: Vector
    rates: Rates
    axis: Axis = eqx.field(static=True)
    radius: Array

    @staticmethod
    def at(reference: Vector, axis: Axis, size: Real) -> "Sphere":
        dtype = reference.x.dtype
        return Sphere(reference, Rates.zero(dtype), axis, jnp.asarray(size, dtype))

    def surface(self, position: Vector) -> Surface:
        offset = position - self.reference
        length = smooth.norm(offset)
        normal = offset * smooth.divide(1.0, length)
        sliding = turned(self.axis, normal) * (self.radius * self.rates.spin)
        return Surface(
            distance=length - self.radius,
            normal=normal,
            velocity=times(self.axis, self.rates.speed) + normal * self.rates.growth + sliding,
            curvature=1 / self.radius,
        )

    def distance(self, position: Vector) -> Array:
        return smooth.norm(position - self.reference) - self.radius

    def moved(self, time_step: Real) -> "Sphere":
        radius = self.radius + self.rates.growth * time_step
        centre = self.reference + times(self.axis, self.rates.speed * time_step)
        return self._as(centre, radius)

    def removed(self) -> "Sphere":
        away = times(self.axis, jnp.full_like(self.radius, -FAR))
        return self._as(across(self.axis, self.reference) + away, self.radius)

    def touching(self, position: Vector, radius: Array) -> "Sphere":
        """Along its axis, up to the first sphere that it meets; where it is if it meets none."""
        offset = across(self.axis, position - self.reference)
        square = (radius + self.radius) ** 2 - offset.dot(offset)
        met = square > 0
        ahead = along(self.axis, position) - jnp.sqrt(jnp.where(met, square, 1.0))
        first = jnp.min(jnp.where(met, ahead, jnp.inf))
        height = jnp.where(jnp.any(met), first, along(self.axis, self.reference))
        return self._as(across(self.axis, self.reference) + times(self.axis, height), self.radius)

    def outline(self) -> list[Array]:
        turn = jnp.linspace(0.0, 2 * jnp.pi, 61)
        place = (self.reference.x + self.radius * jnp.cos(turn), self.radius * jnp.sin(turn))
        return [jnp.stack([place[0], self.reference.z + place[1]], axis=1)]

    def travelled(self, since: Self) -> Array:
        shift = self.reference - since.reference
        return smooth.norm(shift) + jnp.abs(self.radius - since.radius)

    @property
    def size(self) -> Array:
        return self.radius

    def _as(self, centre: Vector, radius: Array) -> "Sphere":
        return eqx.tree_at(lambda b: (b.reference, b.radius), self, (centre, radius))
