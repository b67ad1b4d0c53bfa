"""The mould and the platens: three walls, their places and speeds.

A wall answers one question for one point: how far away, in which direction, and how
fast does its surface move.  Axis of the cylinder is z; the base stands at z = 0.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.vector import Vector

BASE, PLATEN, MOULD = 0, 1, 2
COUNT = 3


class Walls(eqx.Module):
    """Places (m) and speeds (m/s) of the walls; upward and outward are positive."""

    platen_height: Array
    platen_speed: Real
    mould_radius: Array
    mould_speed: Real

    def axial_strain_rate(self) -> Real:
        """Rate at which the platen stretches the specimen, 1/s (negative in compression)."""
        return self.platen_speed / self.platen_height

    def moved(self, time_step) -> "Walls":
        """The walls one time step later, at the same speeds."""
        return Walls(
            self.platen_height + self.platen_speed * time_step,
            self.platen_speed,
            self.mould_radius + self.mould_speed * time_step,
            self.mould_speed,
        )


class Surface(eqx.Module):
    """The nearest wall surface as seen from one point."""

    distance: Array  #: m; from the point to the wall
    normal: Vector  #: unit vector from the wall to the point
    velocity: Vector  #: m/s; of the wall's surface


def surface(walls: Walls, wall: Array, position: Vector) -> Surface:
    """Wall number `wall` (BASE, PLATEN or MOULD) as seen from `position`."""
    radial = Vector(position.x, position.y, jnp.zeros_like(position.x))
    off_axis = smooth.norm(radial)
    outward = Vector(
        smooth.divide(position.x, off_axis), smooth.divide(position.y, off_axis), radial.z
    )
    is_base, is_mould = wall == BASE, wall == MOULD
    plane_distance = jnp.where(is_base, position.z, walls.platen_height - position.z)
    plane_normal = jnp.where(is_base, 1.0, -1.0).astype(position.z.dtype)
    plane_speed = jnp.where(is_base, 0.0, walls.platen_speed)
    return Surface(
        distance=jnp.where(is_mould, walls.mould_radius - off_axis, plane_distance),
        normal=Vector(
            jnp.where(is_mould, -outward.x, 0.0),
            jnp.where(is_mould, -outward.y, 0.0),
            jnp.where(is_mould, 0.0, plane_normal),
        ),
        velocity=Vector(
            jnp.where(is_mould, outward.x * walls.mould_speed, 0.0),
            jnp.where(is_mould, outward.y * walls.mould_speed, 0.0),
            jnp.where(is_mould, 0.0, plane_speed),
        ),
    )


def distances(walls: Walls, position: Vector) -> Array:
    """Distance (m) of every point to every wall, shape (N, COUNT)."""
    off_axis = smooth.norm(Vector(position.x, position.y, 0.0 * position.x))
    to_platen = walls.platen_height - position.z
    return jnp.stack([position.z, to_platen, walls.mould_radius - off_axis], axis=-1)
