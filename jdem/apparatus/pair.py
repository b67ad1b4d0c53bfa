"""One contact: quasi-static paths of overlap, of place and rotation, and head-on collisions.

The smallest apparatus: it needs a contact law and no bed, so a law can be drawn,
compared with another code's and tested in a fraction of a second.
"""

from itertools import pairwise
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.laws.base import AbstractContactLaw
from jdem.mechanics.contact import Contact, ContactForce

SLOW = 1e6  # s between two points of a path: no dashpot acts


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


# ------------------------------------------------------------------ along any path


class Encounter(eqx.Module):
    """A sphere that is moved, and the sphere or plane (z = 0) that stands still.

    radius and held (m) are those of the moved and of the still sphere, density in kg/m3.
    """

    radius: Real = quantity()
    held: Real = quantity()
    friction: Real = quantity()
    density: Real = quantity(2650.0)
    wall: bool = eqx.field(static=True, default=False)

    def bodies(self) -> tuple[Array, Array]:
        """Effective radius (m) and effective mass (kg)."""
        radius, held = jnp.asarray(self.radius), jnp.asarray(self.held)
        mass, other = (4 / 3 * jnp.pi * self.density * r**3 for r in (radius, held))
        if self.wall:
            return radius, mass
        return radius * held / (radius + held), mass * other / (mass + other)

    def smaller(self) -> Array:
        """Radius of the smaller body, m."""
        return jnp.minimum(self.radius, self.radius if self.wall else self.held)

    def line(self, place: Vector) -> tuple[Vector, Array, tuple[Array, Array]]:
        """Normal towards the moved sphere, overlap (m), and both lever arms (m), for its centre as
        seen from the still sphere's centre or from the plane."""
        if self.wall:
            zero = jnp.zeros_like(place.z)
            overlap = self.radius - place.z
            return Vector(zero, zero, zero + 1), overlap, (self.radius - overlap, zero)
        distance = smooth.norm(place)
        overlap = self.radius + self.held - distance
        levers = (self.radius - overlap / 2, self.held - overlap / 2)
        return place * smooth.divide(1.0, distance), overlap, levers


class Path(NamedTuple):
    """Where the moved sphere's centre is, and how far both have turned: each (points, 3).

    Places in m as in `Encounter.line`; turns in rad, the integral of the spins.
    """

    places: Array
    turns: Array
    held_turns: Array


class Along(NamedTuple):
    """What one contact does along a path; vectors (points, 3), on the moved sphere."""

    overlap: Array  #: m
    normal_force: Array  #: N; attraction is negative
    traction: Array  #: N; tangential force
    force: Array  #: N; both
    torque: Array  #: N m; about the moved sphere's centre
    moment: Array  #: N m; the part of the torque that no force makes
    held_torque: Array  #: N m; on the still sphere, about its centre


def drive_path(law: AbstractContactLaw, encounter: Encounter, path: Path, steps: int) -> Along:
    """Forces of one contact along a path, quasi-statically, its history carried along.

    Args:
        law: the contact law.
        encounter: the two bodies.
        path: places and turns; bodies go straight from point to point.
        steps: how many steps from one point to the next.

    Returns:
        Forces at every point of the path.
    """
    corners = jnp.concatenate(path, axis=1)
    starts = jnp.concatenate([corners[:1], corners[:-1]])
    changes = jnp.repeat((corners - starts) / steps, steps, axis=0)
    share = jnp.tile(jnp.arange(1, steps + 1.0), len(corners))
    rows = jnp.repeat(starts, steps, axis=0) + changes * share[:, None]

    def advance(history, ends):
        contact, levers = _on_the_way(encounter, *ends)
        force, history = law.force(contact, history)
        return history, _along(contact, force, levers)

    found = jax.lax.scan(advance, law.memory((), corners.dtype), (rows, changes))[1]
    return jax.tree.map(lambda leaf: leaf[steps - 1 :: steps], found)


def _on_the_way(encounter: Encounter, row: Array, change: Array):
    """The contact at one row (place, turns, held turns) after `change`, and lever arms (m)."""
    place, _, _ = _vectors(row)
    moved, turned, held_turned = (each / SLOW for each in _vectors(change))
    normal, overlap, levers = encounter.line(place)
    radius, mass = encounter.bodies()
    spins = turned * levers[0] + held_turned * levers[1]
    relative = moved - spins.cross(normal)
    contact = Contact(
        overlap=overlap,
        approach_speed=-relative.dot(normal),
        normal=normal,
        slip=relative.without(normal),
        radius=radius,
        mass=mass,
        friction=jnp.asarray(encounter.friction),
        time_step=jnp.full_like(overlap, SLOW),
        spin=turned - held_turned,
        smaller=encounter.smaller(),
        turning=(turned + held_turned).dot(normal) / 2,
    )
    return contact, levers


def _vectors(row: Array) -> list[Vector]:
    return [Vector.from_rows(row[k : k + 3]) for k in (0, 3, 6)]


def _along(contact: Contact, force: ContactForce, levers) -> Along:
    traction, total = force.traction(), force.normal.total()
    moment = Vector.zeros((), total.dtype) if force.moment is None else force.moment
    twist = traction.cross(contact.normal)
    vectors = (
        traction,
        contact.normal * total + traction,
        twist * levers[0] + moment,
        moment,
        twist * levers[1] - moment,
    )
    return Along(contact.overlap, total, *(vector.stack() for vector in vectors))
