"""Spheres: what they are (radius, mass) and how they move (position, velocity, spin)."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.quantity import quantity
from jdem.core.vector import Vector


class Spheres(eqx.Module):
    """Sizes and masses of N spheres; radius in m, mass in kg, both of shape (N,)."""

    radius: Array = quantity()
    mass: Array = quantity()

    @property
    def count(self) -> int:
        return self.radius.shape[0]

    @property
    def inertia(self) -> Array:
        """Moment of inertia 2/5 m r^2, kg m2."""
        return 0.4 * self.mass * self.radius**2


class Motion(eqx.Module):
    """Position (m), velocity (m/s) and spin (rad/s) of N spheres."""

    position: Vector
    velocity: Vector
    spin: Vector

    @staticmethod
    def at_rest(position: Vector) -> "Motion":
        zero = Vector.zeros(position.x.shape, position.x.dtype)
        return Motion(position, zero, zero)

    def rows(self, spheres: Spheres) -> Array:
        """Everything a contact needs of its bodies as rows of eleven, for one gather.

        Columns: position 0-2, velocity 3-5, spin 6-8, radius 9, mass 10.
        """
        p, v, w = self.position, self.velocity, self.spin
        columns = [p.x, p.y, p.z, v.x, v.y, v.z, w.x, w.y, w.z, spheres.radius, spheres.mass]
        return jnp.stack(columns, axis=-1)


def kinetic_energy(spheres: Spheres, motion: Motion) -> Array:
    """Translational and rotational kinetic energy, J."""
    linear = spheres.mass * motion.velocity.dot(motion.velocity)
    angular = spheres.inertia * motion.spin.dot(motion.spin)
    return 0.5 * jnp.sum(linear + angular)
