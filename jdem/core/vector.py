"""Three Cartesian components kept as three separate arrays.

A law written for one contact sees `Vector` of three scalars; vectorised over a
bed each component is one contiguous row, which is the layout that a CPU (and a
GPU) vectorises best.  Only what contact mechanics needs is here.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array


class Vector(eqx.Module):
    """A vector (or a batch of vectors, component by component) in Cartesian axes."""

    x: Array
    y: Array
    z: Array

    def __add__(self, other: "Vector") -> "Vector":
        return Vector(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: "Vector") -> "Vector":
        return Vector(self.x - other.x, self.y - other.y, self.z - other.z)

    def __neg__(self) -> "Vector":
        return Vector(-self.x, -self.y, -self.z)

    def __mul__(self, scale) -> "Vector":
        return Vector(self.x * scale, self.y * scale, self.z * scale)

    __rmul__ = __mul__

    def __truediv__(self, scale) -> "Vector":
        return self * (1 / scale)

    def dot(self, other: "Vector") -> Array:
        return self.x * other.x + self.y * other.y + self.z * other.z

    def cross(self, other: "Vector") -> "Vector":
        return Vector(
            self.y * other.z - self.z * other.y,
            self.z * other.x - self.x * other.z,
            self.x * other.y - self.y * other.x,
        )

    def without(self, normal: "Vector") -> "Vector":
        """The part perpendicular to the unit vector `normal`."""
        return self - normal * self.dot(normal)

    def at(self, index) -> "Vector":
        """Entries `index` of every component (a gather)."""
        return Vector(self.x[index], self.y[index], self.z[index])

    def stack(self) -> Array:
        """Components as the last axis, shape (..., 3)."""
        return jnp.stack([self.x, self.y, self.z], axis=-1)

    @staticmethod
    def from_rows(rows: Array) -> "Vector":
        """The inverse of `stack`."""
        return Vector(rows[..., 0], rows[..., 1], rows[..., 2])

    @staticmethod
    def zeros(shape, dtype) -> "Vector":
        zero = jnp.zeros(shape, dtype)
        return Vector(zero, zero, zero)
