"""Contacts -> forces -> sums on spheres and boundaries: the first half of a time step.

All pairs are one list and one kernel (`jdem.core.kernel`), and so are all contacts with
boundaries, whatever their kinds.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import Surface
from jdem.boundaries.composite import (
    Boundaries,
    effective_radius,
    nearest,
    owner,
    spin_of,
)
from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.kernel import entrywise
from jdem.core.tangents import resisted
from jdem.core.vector import Vector
from jdem.engine.neighbors import ContactList
from jdem.engine.state import Bed, BedState
from jdem.laws.base import AbstractContactLaw
from jdem.mechanics.contact import Contact, ContactForce


class Loads(eqx.Module):
    """Sums over contacts: on each sphere (rows), and power by channel."""

    rows: Array  #: (N, 8): force 0-2 (N), torque 3-5 (N m), rolling limit 6 (N m), load 7 (N)
    power: Array  #: (4,), W; absorbed by normal spring and dashpot, tangential spring and dashpot
    rolling: Array  #: W; absorbed by the moments of laws that give one


def pair_loads(bed: Bed, rows: Array, pairs: ContactList):
    """Sphere-sphere contacts: loads on the spheres and the list with its new histories."""
    entries = (pairs.first, pairs.second, pairs.alive, pairs.history)
    found = entrywise(_pair_forces, (bed, rows), entries, pairs.used())
    on_first, on_second, power, history = found
    total = jnp.zeros((rows.shape[0], 8), rows.dtype)
    total = total.at[pairs.first].add(on_first).at[pairs.second].add(on_second)
    sums = jnp.sum(power, axis=0)
    loads = Loads(total, sums[:4], jnp.sum(sums[4:]))
    return loads, eqx.tree_at(lambda p: p.history, pairs, history)


def _pair_forces(shared: tuple[Bed, Array], entries):
    """Rows to add to both spheres of each pair, power by channel, and the new histories."""
    bed, rows = shared
    first, second, alive, history = entries
    one, two = jax.lax.optimization_barrier((rows[first], rows[second]))
    return between(bed, *once((one.T, two.T)), alive, history)


def between(bed: Bed, one: Array, two: Array, alive: Array, history):
    """What pairs of spheres do to each other, from the columns (11, pairs) of their rows."""
    contact, levers = _pair_contacts(bed, one, two, alive)
    contact = _bondable(contact, one, two) if bed.particle_law.bonds else contact
    force, history = _law_forces(bed.particle_law, contact, history)
    force = _dragged(bed, contact, force)
    push, twist, power = _assembled(contact, force)
    opposite = None if force.moment is None else -force.moment
    on_first = _row(push, _with(twist * levers[0], force.moment), force, levers[0])
    on_second = _row(-push, _with(twist * levers[1], opposite), force, levers[1])
    return *once((on_first, on_second, power)), history


def wall_loads(bed: Bed, rows: Array, boundaries: Boundaries, contacts: ContactList, loads: Loads):
    """Loads with those of contacts with boundaries added, the list, and loads on boundaries with
    torques about the origin."""
    codes = codes_met(rows, boundaries, contacts)
    entries = (contacts.first, contacts.second, contacts.alive, contacts.history, codes)
    found = entrywise(_wall_forces, (bed, rows, boundaries), entries, contacts.used())
    on_first, felt, absorbed, history = found
    sums = jnp.sum(absorbed, axis=0)
    felt = jnp.stack([jnp.sum(each, axis=0) for each in felt])
    rows = loads.rows.at[contacts.first].add(on_first)
    loads = Loads(rows, loads.power + sums[:4], loads.rolling + jnp.sum(sums[4:]))
    return loads, eqx.tree_at(lambda c: c.history, contacts, history), felt


def _wall_forces(shared: tuple[Bed, Array, Boundaries], entries):
    """Rows to add to each sphere, loads on all boundaries, power by channel, new histories."""
    bed, rows, boundaries = shared
    first, *listed = entries
    one = once(jax.lax.optimization_barrier(rows[first]).T)
    return against(bed, boundaries, one, *listed)


def codes_met(rows: Array, boundaries: Boundaries, contacts: ContactList) -> Array | None:
    """Which face, edge or vertex each listed contact touches, of boundaries that are made of them;
    None where there are none.  No derivative passes."""
    if not any(boundary.faces for boundary in boundaries):
        return None
    rows, boundaries = jax.lax.stop_gradient((rows, boundaries))
    codes = jnp.full(contacts.first.shape, -1, jnp.int32)
    for boundary, listed in zip(boundaries, contacts.faces, strict=True):
        if listed is not None:
            used, most = listed.used()
            shared = (rows, contacts.first, boundary, most)
            found = entrywise(_met, shared, (listed.entry, listed.faces), used)
            codes = codes.at[listed.entry].set(found, mode="drop")
    return codes


def surfaces_met(spheres: Spheres, state: BedState) -> tuple[Array, Surface]:
    """Which boundary each listed contact with one is with, and its surface nearest to the sphere;
    arrays (contacts,)."""
    contacts = state.wall_contacts
    codes = codes_met(spheres.rows(state.motion), state.boundaries, contacts)
    wall = owner(state.boundaries, contacts.second)
    place = state.motion.position.at(contacts.first)
    return wall, nearest(state.boundaries, wall, place, codes)


def boundary_overlaps(spheres: Spheres, state: BedState) -> Array:
    """The deepest overlap with each boundary over the sphere's radius, shape (boundaries,); 0
    where none touches."""
    contacts, (wall, surface) = state.wall_contacts, surfaces_met(spheres, state)
    overlap = 1.0 - surface.distance / spheres.radius[contacts.first]
    touching = jnp.where(contacts.alive > 0, jnp.maximum(overlap, 0.0), 0.0)
    return jnp.zeros(len(state.boundaries)).at[wall].max(touching)


def _met(shared, entries) -> Array:
    """Codes of what some contacts with one boundary touch."""
    (rows, first, boundary, most), (entry, faces) = shared, entries
    places = rows[first[jnp.minimum(entry, first.shape[0] - 1)]].T
    return once(boundary.met(Vector(*places[0:3]), faces, most))


def against(
    bed: Bed, boundaries: Boundaries, one: Array, part: Array, alive: Array, history, codes
):
    """What spheres and boundaries do to each other, from the columns (11, contacts) of rows;
    `codes` are those of `codes_met`."""
    wall = owner(boundaries, part)
    contact, lever = _wall_geometry(bed, one, boundaries, wall, alive, codes)
    force, history = _law_forces(bed.wall_law, contact, history)
    force = _dragged(bed, contact, force)
    push, twist, power = _assembled(contact, force)
    on_first = _row(push, _with(twist * lever, force.moment), force, lever)
    place = Vector(*one[0:3]) - contact.normal * lever
    felt = _felt(contact, once(-push), force.moment, place)
    felt = [jnp.where((wall == k)[:, None], felt, 0.0) for k in range(len(boundaries))]
    return *once((on_first, tuple(felt), power)), history


def _pair_contacts(bed: Bed, one: Array, two: Array, alive: Array):
    """Contacts of listed pairs, and the lever arms from centre to contact (m)."""
    offset = Vector(*one[0:3]) - Vector(*two[0:3])
    distance = smooth.norm(offset)
    normal = offset * smooth.divide(1.0, distance)
    distance, normal = once((distance, normal))
    radius_one, radius_two = one[9], two[9]
    overlap = jnp.where(alive > 0, radius_one + radius_two - distance, -1.0)
    lever_one, lever_two = radius_one - 0.5 * overlap, radius_two - 0.5 * overlap
    spin_one, spin_two = Vector(*one[6:9]), Vector(*two[6:9])
    turning = spin_one * lever_one + spin_two * lever_two
    relative = Vector(*one[3:6]) - Vector(*two[3:6]) - turning.cross(normal)
    relative = once(relative)
    contact = Contact(
        overlap=overlap,
        approach_speed=-relative.dot(normal),
        normal=normal,
        slip=relative.without(normal),
        radius=radius_one * radius_two / (radius_one + radius_two),
        mass=one[10] * two[10] / (one[10] + two[10]),
        friction=bed.friction * alive,
        time_step=bed.time_step * jnp.ones_like(overlap),
        spin=(spin_one - spin_two) * alive,
    )
    return _kept_apart(contact, (lever_one, lever_two))


def _bondable(contact: Contact, one: Array, two: Array) -> Contact:
    """The contact with what a bond needs: the smaller radius, and how the pair turns as one."""
    mean = (Vector(*one[6:9]) + Vector(*two[6:9])) * 0.5
    turning = mean.dot(contact.normal)
    return replace(contact, smaller=jnp.minimum(one[9], two[9]), turning=turning)


def _wall_geometry(bed: Bed, one: Array, boundaries: Boundaries, wall: Array, alive: Array, codes):
    """Contacts of listed spheres with boundaries, which have infinite mass."""
    surface = once(nearest(boundaries, wall, Vector(*one[0:3]), codes))
    overlap = jnp.where(alive > 0, one[9] - surface.distance, -1.0)
    lever = one[9] - overlap
    spin = Vector(*one[6:9])
    relative = Vector(*one[3:6]) - surface.velocity - (spin * lever).cross(surface.normal)
    relative = once(relative)
    contact = Contact(
        overlap=overlap,
        approach_speed=-relative.dot(surface.normal),
        normal=surface.normal,
        slip=relative.without(surface.normal),
        radius=effective_radius(one[9], surface.curvature),
        mass=one[10],
        friction=bed.wall_friction[wall] * alive,
        time_step=bed.time_step * jnp.ones_like(overlap),
        spin=(spin - spin_of(boundaries, wall)) * alive,
    )
    return _kept_apart(contact, lever)


def _kept_apart(contact: Contact, levers):
    """Both, computed once, but for the relative spin: most laws never ask for it."""
    rest, levers = once((eqx.tree_at(_spin, contact, None), levers))
    return eqx.tree_at(_spin, rest, contact.spin, is_leaf=lambda leaf: leaf is None), levers


def _spin(contact: Contact) -> Vector:
    return contact.spin


def _law_forces(law: AbstractContactLaw, contact: Contact, history):
    """The law, vectorised over contacts."""
    return once(jax.vmap(law.force)(contact, history))


def _dragged(bed: Bed, contact: Contact, force: ContactForce) -> ContactForce:
    """The force, whose derivative also feels the dashpots of `Bed.drag`."""
    if bed.drag is None:
        return force
    touching = jnp.where(contact.overlap > 0, 1.0, 0.0)
    constant = touching * bed.drag.contact * contact.mass / contact.time_step
    held, slip = force.tangential, contact.slip
    held = held + Vector(*(resisted(v, constant) for v in (slip.x, slip.y, slip.z)))
    viscous = force.normal.viscous - resisted(contact.approach_speed, constant)
    return eqx.tree_at(_viscous_and_held, force, (viscous, held))


def _viscous_and_held(force: ContactForce):
    return force.normal.viscous, force.tangential


def _assembled(contact: Contact, force: ContactForce):
    """Push on the first body (N), its torque per lever arm (N), and power absorbed by channel (W).

    A law that gives a moment adds a channel; one that gives none costs nothing.
    """
    traction = force.traction()
    push = contact.normal * force.normal.total() + traction
    twist = traction.cross(contact.normal)
    channels = [
        force.normal.hysteretic * contact.approach_speed,
        force.normal.viscous * contact.approach_speed,
        -force.tangential.dot(contact.slip),
        -force.tangential_viscous.dot(contact.slip),
    ]
    if force.moment is not None:  # decided as the law is traced
        channels.append(-force.moment.dot(contact.spin))
    return push, twist, jnp.stack(channels, axis=-1)


def _row(push: Vector, torque: Vector, force: ContactForce, lever: Array) -> Array:
    """What is added to a sphere's row of loads."""
    limit, load = force.rolling_limit * lever, force.normal.frictional_load
    columns = [push.x, push.y, push.z, torque.x, torque.y, torque.z, limit, load]
    return jnp.stack(columns, axis=-1)


def _with(torque: Vector, moment: Vector | None) -> Vector:
    return torque if moment is None else torque + moment


def _felt(contact: Contact, pull: Vector, moment: Vector | None, place: Vector) -> Array:
    """Loads on a boundary pulled at `place` (m): force, torque about the origin, push."""
    torque = _with(place.cross(pull), None if moment is None else -moment)
    columns = [pull.x, pull.y, pull.z, torque.x, torque.y, torque.z, -pull.dot(contact.normal)]
    return jnp.stack(columns, axis=-1)
