"""One pair of equal spheres: quasi-static overlap paths and head-on collisions.

The smallest apparatus: it needs a contact law and no bed, so a law can be drawn,
compared with another code's and tested in a fraction of a second.
"""

from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.laws.base import AbstractContactLaw
from jdem.mechanics.contact import Contact


class SpherePair(eqx.Module):
    """Two equal spheres; radius in m, density in kg/m3."""

    radius: Array = quantity()
    density: Real = quantity(2650.0)

    def effective_radius(self) -> Array:
        return self.radius / 2

    def effective_mass(self) -> Array:
        return self.density * 4 / 3 * jnp.pi * self.radius**3 / 2

    def contact(self, overlap, approach_speed, time_step=0.0) -> Contact:
        """The pair in contact along x, without slip or friction."""
        zero = jnp.zeros_like(overlap)
        one = jnp.ones_like(overlap)
        return Contact(
            overlap=overlap,
            approach_speed=approach_speed,
            normal=Vector(one, zero, zero),
            slip=Vector(zero, zero, zero),
            radius=self.effective_radius() * one,
            mass=self.effective_mass() * one,
            friction=zero,
            time_step=time_step * one,
            spin=Vector(zero, zero, zero),
        )


def overlap_path(turning_points, points_per_leg: int) -> Array:
    """A path of overlaps from 0 through turning points, evenly spaced on each leg.

    Args:
        turning_points: overlaps, m; below zero the spheres are apart.
        points_per_leg: how many overlaps from one turning point to the next.

    Returns:
        Overlaps (points,), m.

    Example:
        >>> path = jdem.overlap_path([20e-6, 2e-6, 32e-6], points_per_leg=100)
    """
    corners = [0.0, *turning_points]
    share = jnp.arange(1, points_per_leg + 1) / points_per_leg
    legs = [a + (b - a) * share for a, b in pairwise(corners)]
    return jnp.concatenate(legs)


def drive_overlap(law: AbstractContactLaw, pair: SpherePair, overlaps: Array) -> Array:
    """The normal force of one contact along a quasi-static path, its history carried along.

    Args:
        law: the contact law between the spheres.
        pair: both spheres.
        overlaps: overlaps along the path (points,), m.

    Returns:
        Normal force (points,), N; attraction is negative.

    Example:
        >>> law = jdem.particle_law(jdem.SoilParameters(), 5e-3, jdem.Smoothing.sharp())
        >>> path = jdem.overlap_path([20e-6, 2e-6, 32e-6], points_per_leg=100)
        >>> force = jdem.drive_overlap(law, jdem.SpherePair(2.5e-3), path)
    """

    def advance(history, overlap):
        force, history = law.force(pair.contact(overlap, jnp.zeros_like(overlap)), history)
        return history, force.normal.total()

    return jax.lax.scan(advance, law.memory((), overlaps.dtype), overlaps)[1]


def collide(
    law: AbstractContactLaw, pair: SpherePair, speed: float, time_step: float, steps: int
) -> Array:
    """Rebound speed over impact speed of a head-on collision.

    `speed` is the relative impact speed (m/s); the rebound is read when the pair has
    separated, so `steps` must outlast the contact.
    """

    def advance(carry, _):
        overlap, rate, history, rebound = carry
        force, history = law.force(pair.contact(overlap, rate, time_step), history)
        rate = rate - force.normal.total() / pair.effective_mass() * time_step
        overlap = overlap + rate * time_step
        rebound = jnp.where(overlap > 0, -rate, rebound)
        return (overlap, rate, history, rebound), None

    rate = jnp.asarray(speed, dtype=pair.radius.dtype)
    start = (rate * time_step, rate, law.memory((), rate.dtype), 0.0 * rate)
    final = jax.lax.scan(advance, start, None, length=steps)[0]
    return final[3] / rate
