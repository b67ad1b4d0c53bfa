"""Single spheres: what they are (radius, mass) and how they move (position, velocity, spin)."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.bodies.base import AbstractBodies
from jdem.core.quantity import quantity
from jdem.core.vector import Vector


class Spheres(AbstractBodies):
    """Sizes and masses of N spheres; radius in m, mass in kg, both of shape (N,)."""

    radius: Array = quantity()
    mass: Array = quantity()

    @property
    def members(self) -> int:
        return 1

    @property
    def inertia(self) -> Array:
        """Moment of inertia 2/5 m r^2, kg m2."""
        return 0.4 * self.mass * self.radius**2

    def positions(self, motion: "Motion") -> Vector:
        return motion.position

    def rows(self, motion: "Motion") -> Array:
        p, v, w = motion.position, motion.velocity, motion.spin
        columns = [p.x, p.y, p.z, v.x, v.y, v.z, w.x, w.y, w.z, self.radius, self.mass]
        return jnp.stack(columns, axis=-1)

    def collected(self, loads: Array, motion: "Motion") -> Array:
        return loads


class Motion(eqx.Module):
    """Position (m), velocity (m/s) and spin (rad/s) of N spheres."""

    position: Vector
    velocity: Vector
    spin: Vector

    @staticmethod
    def at_rest(position: Vector) -> "Motion":
        zero = Vector.zeros(position.x.shape, position.x.dtype)
        return Motion(position, zero, zero)


def kinetic_energy(spheres: Spheres, motion: Motion) -> Array:
    """Translational and rotational kinetic energy, J."""
    linear = spheres.mass * motion.velocity.dot(motion.velocity)
    angular = spheres.inertia * motion.spin.dot(motion.spin)
    return 0.5 * jnp.sum(linear + angular)
