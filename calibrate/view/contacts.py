"""The contacts of a bed at one moment: where they are and what they carry.

Forces are those of the contact law at standstill (springs, plasticity, adhesion); dashpots are
left out, so that a picture shows what the bed carries and not how it rattles.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jdem.boundaries.composite import effective_radius
from jdem.core import smooth
from jdem.core.vector import Vector
from jdem.engine.loads import surfaces_met
from jdem.engine.neighbors import ContactList
from jdem.engine.step import Bed, BedState
from jdem.laws.base import AbstractContactLaw
from jdem.mechanics.contact import Contact


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contacts that touch or that a whole bond holds; arrays of shape (contacts,), `start` and
    `end` (contacts, 3).

    `first` is a sphere; `second` a sphere, or -1 - wall for base, platen and mould.  `start`
    and `end` (m) are the centres, or the centre and the point on the wall.  Normal force (N)
    is positive in compression; tangential is its size; overlap (m) is negative where a bond
    spans a gap.  `bond` is 1 where it is whole, 0 where there is none.
    """

    first: np.ndarray
    second: np.ndarray
    start: np.ndarray
    end: np.ndarray
    overlap: np.ndarray
    normal_force: np.ndarray
    tangential_force: np.ndarray
    bond: np.ndarray

    def load(self, spheres: int) -> np.ndarray:
        """Sum of the sizes of normal forces on each sphere (N), shape (spheres,)."""
        size = np.abs(self.normal_force)
        total = np.bincount(self.first, size, spheres)
        between = self.second >= 0
        return total + np.bincount(self.second[between], size[between], spheres)

    def count(self, spheres: int) -> np.ndarray:
        """Contacts of each sphere, shape (spheres,)."""
        both = np.concatenate([self.first, self.second[self.second >= 0]])
        return np.bincount(both, minlength=spheres)


def contacts_of(bed: Bed, state: BedState) -> Contacts:
    """All contacts of spheres with spheres and walls that touch or are bonded."""
    parts = [_between_spheres(bed, state), _with_walls(bed, state)]
    names = Contacts.__dataclass_fields__
    return Contacts(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})


def _between_spheres(bed: Bed, state: BedState) -> Contacts:
    position, radius, mass = state.motion.position, bed.spheres.radius, bed.spheres.mass
    one, two = state.pairs.first, state.pairs.second
    offset = position.at(one) - position.at(two)
    distance = smooth.norm(offset)
    contact = _still(
        overlap=radius[one] + radius[two] - distance,
        normal=offset * smooth.divide(1.0, distance),
        radius=radius[one] * radius[two] / (radius[one] + radius[two]),
        mass=mass[one] * mass[two] / (mass[one] + mass[two]),
        friction=bed.friction * jnp.ones_like(distance),
    )
    if bed.particle_law.bonds:
        contact = replace(contact, smaller=jnp.minimum(radius[one], radius[two]))
    ends = (position.at(one), position.at(two))
    return _touching(bed.particle_law, contact, state.pairs, ends, np.asarray(two))


def _with_walls(bed: Bed, state: BedState) -> Contacts:
    contacts = state.wall_contacts
    wall, seen = surfaces_met(bed.spheres, state)
    one, centre = contacts.first, state.motion.position.at(contacts.first)
    contact = _still(
        overlap=bed.spheres.radius[one] - seen.distance,
        normal=seen.normal,
        radius=effective_radius(bed.spheres.radius[one], seen.curvature),
        mass=bed.spheres.mass[one],
        friction=bed.wall_friction[wall],
    )
    ends = (centre, centre - seen.normal * seen.distance)
    return _touching(bed.wall_law, contact, contacts, ends, -1 - np.asarray(wall))


def _still(overlap, normal: Vector, radius, mass, friction) -> Contact:
    """Contacts at rest: no approach, no slip, no time passing."""
    zero = jnp.zeros_like(overlap)
    slip = Vector(zero, zero, zero)
    return Contact(overlap, zero, normal, slip, radius, mass, friction, zero, slip)


def _touching(
    law: AbstractContactLaw,
    contact: Contact,
    listed: ContactList,
    ends: tuple[Vector, Vector],
    second: np.ndarray,
) -> Contacts:
    """The listed contacts that overlap or have a whole bond, with their forces."""
    force, _ = jax.jit(jax.vmap(law.force))(contact, listed.history)
    bond = np.asarray(listed.alive * law.whole_bonds(listed.history))
    touching = np.asarray((listed.alive > 0) & (contact.overlap > 0)) | (bond > 0)
    traction = force.tangential
    return Contacts(
        first=np.asarray(listed.first)[touching],
        second=second[touching],
        start=np.asarray(ends[0].stack())[touching],
        end=np.asarray(ends[1].stack())[touching],
        overlap=np.asarray(contact.overlap)[touching],
        normal_force=np.asarray(force.normal.hysteretic)[touching],
        tangential_force=np.asarray(smooth.norm(traction))[touching],
        bond=bond[touching].astype(int),
    )
