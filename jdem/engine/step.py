"""One time step of a bed between its walls, in the order of physics.

    contacts -> forces -> sums on spheres and walls -> motion -> walls

Semi-implicit Euler: velocities first, positions with the new velocities.  Background
damping acts on the motion relative to the affine motion that the platen imposes, and
rolling resistance is applied implicitly: it can stop a spin, never reverse it.  Spheres
that carry next to no load are damped more: they rattle between their neighbours, which
leaves the specimen's force unchanged and makes its derivatives chaotic (docs/gradients.md).
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries import walls as wall_module
from jdem.boundaries.walls import Walls
from jdem.core import smooth
from jdem.core.fusion import boundaries, once
from jdem.core.kernel import entrywise
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.engine.energy import Ledger
from jdem.engine.neighbors import ContactList, Grid
from jdem.laws.base import AbstractContactLaw
from jdem.mechanics.contact import Contact, ContactForce

GRAVITY = 9.81  # m/s2
LOADED = 100.0  # own weights; sum of contact loads at which half of the extra damping is gone


class Bed(eqx.Module):
    """What does not change while a bed is tested: spheres, laws, numerics.

    friction (-) between spheres; wall_friction (-) of base, platen and mould, shape (3,);
    time_step in s; roll_width (rad/s) is the spin at which half of the rolling torque acts.
    """

    spheres: Spheres
    particle_law: AbstractContactLaw
    wall_law: AbstractContactLaw
    friction: Real = quantity()
    wall_friction: Array = quantity()
    time_step: Real = quantity()
    roll_width: Real = quantity()
    gravity: Real = quantity(GRAVITY)
    grid: Grid = eqx.field(static=True, kw_only=True)


class BedState(eqx.Module):
    """What changes: motion, walls, contacts with their histories, forces, energy, time."""

    motion: Motion
    walls: Walls
    pairs: ContactList
    wall_contacts: ContactList
    wall_force: Array  #: N, shape (3,); axial push on base and platen, radial on the mould
    mould_drag: Array  #: N; axial force on the mould
    energy: Ledger
    time: Array
    reading: Array  #: N; the platen force that the load cell reads


class Command(eqx.Module):
    """What the machine does during one step: wall speeds (m/s), background damping (1/s).

    unloaded_damping is added where a sphere carries less than LOADED of its own weights.
    """

    platen_speed: Array
    mould_speed: Real
    damping: Real
    unloaded_damping: Real


class Loads(eqx.Module):
    """Sums over contacts: on each sphere (rows), on the walls, and power by channel."""

    rows: Array  #: (N, 8): force 0-2 (N), torque 3-5 (N m), rolling limit 6 (N m), load 7 (N)
    power: Array  #: (4,), W; absorbed by normal spring and dashpot, tangential spring and dashpot
    rolling: Array  #: W; absorbed by the moments of laws that give one


Motions = Callable[[Bed, Motion, Walls, Array, Command], tuple[Motion, Array]]


def step(bed: Bed, state: BedState, command: Command, motions: Motions | None = None) -> BedState:
    """The state one time step later; `motions` can stand in for `next_motion`."""
    with boundaries():
        return _step(bed, state, command, motions or next_motion)


def _step(bed: Bed, state: BedState, command: Command, motions: Motions) -> BedState:
    walls = Walls(
        state.walls.platen_height,
        command.platen_speed,
        state.walls.mould_radius,
        command.mould_speed,
    )
    rows = jax.lax.optimization_barrier(state.motion.rows(bed.spheres))
    loads, pairs = _pair_loads(bed, rows, state.pairs)
    loads, contacts, on_walls = _wall_loads(bed, rows, walls, state.wall_contacts, loads)
    motion, absorbed = motions(bed, state.motion, walls, loads.rows, command)
    power = Ledger.of_step(
        contacts=loads.power,
        rolling=loads.rolling,
        walls=on_walls,
        absorbed=absorbed,
        gravity=-bed.gravity * jnp.sum(bed.spheres.mass * state.motion.velocity.z),
        walls_moving=walls,
        time_step=bed.time_step,
    )
    return BedState(
        motion=motion,
        walls=walls.moved(bed.time_step),
        pairs=pairs,
        wall_contacts=contacts,
        wall_force=on_walls[:3],
        mould_drag=on_walls[3],
        energy=state.energy + power,
        time=state.time + bed.time_step,
        reading=state.reading,
    )


def _pair_loads(bed: Bed, rows: Array, pairs: ContactList):
    """Sphere-sphere contacts: loads on the spheres and the list with its new histories."""
    entries = (pairs.first, pairs.second, pairs.alive, pairs.history)
    on_first, on_second, power, history = entrywise(_pair_forces, (bed, rows), entries)
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
    one, two = once((one.T, two.T))
    contact, levers = _pair_contacts(bed, one, two, alive)
    force, history = _law_forces(bed.particle_law, contact, history)
    return *once(_assembled(contact, force, levers)), history


def _wall_loads(bed: Bed, rows: Array, walls: Walls, contacts: ContactList, loads: Loads):
    """Loads with those of sphere-wall contacts added, the list, and what the walls feel."""
    entries = (contacts.first, contacts.second, contacts.alive, contacts.history)
    on_first, absorbed, history = entrywise(_wall_forces, (bed, rows, walls), entries)
    sums = jnp.sum(absorbed, axis=0)
    rows = loads.rows.at[contacts.first].add(on_first)
    loads = Loads(rows, loads.power + sums[4:8], loads.rolling + jnp.sum(sums[8:]))
    return loads, eqx.tree_at(lambda c: c.history, contacts, history), sums[:4]


def _wall_forces(shared: tuple[Bed, Array, Walls], entries):
    """Rows to add to each sphere, pushes on the walls beside power by channel, new histories."""
    bed, rows, walls = shared
    first, wall, alive, history = entries
    one = once(jax.lax.optimization_barrier(rows[first]).T)
    contact, levers = _wall_geometry(bed, one, walls, wall, alive)
    force, history = _law_forces(bed.wall_law, contact, history)
    on_first, on_wall, power = once(_assembled(contact, force, levers))
    pushes = _pushes(contact.normal, on_wall, wall)
    return on_first, jnp.concatenate([pushes, power], axis=1), history


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


def _wall_geometry(bed: Bed, one: Array, walls: Walls, wall: Array, alive: Array):
    """Contacts of listed spheres with walls; a wall has infinite radius and mass."""
    surface = once(wall_module.surface(walls, wall, Vector(*one[0:3])))
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
        radius=one[9],
        mass=one[10],
        friction=bed.wall_friction[wall] * alive,
        time_step=bed.time_step * jnp.ones_like(overlap),
        spin=spin * alive,
    )
    return _kept_apart(contact, (lever, lever))


def _kept_apart(contact: Contact, levers):
    """Both, computed once, but for the relative spin: most laws never ask for it."""
    rest, levers = once((eqx.tree_at(_spin, contact, None), levers))
    return eqx.tree_at(_spin, rest, contact.spin, is_leaf=lambda leaf: leaf is None), levers


def _spin(contact: Contact) -> Vector:
    return contact.spin


def _law_forces(law: AbstractContactLaw, contact: Contact, history):
    """The law, vectorised over contacts."""
    return once(jax.vmap(law.force)(contact, history))


def _assembled(contact: Contact, force: ContactForce, levers):
    """Rows to add to the first and to the second body, and power absorbed by channel.

    A law that gives a moment adds a channel; one that gives none costs nothing.
    """
    traction = force.traction()
    push = contact.normal * force.normal.total() + traction
    twist = traction.cross(contact.normal)
    torques = [twist * levers[0], twist * levers[1]]
    channels = [
        force.normal.hysteretic * contact.approach_speed,
        force.normal.viscous * contact.approach_speed,
        -force.tangential.dot(contact.slip),
        -force.tangential_viscous.dot(contact.slip),
    ]
    if force.moment is not None:  # decided as the law is traced
        torques = [torques[0] + force.moment, torques[1] - force.moment]
        channels.append(-force.moment.dot(contact.spin))
    load, rolling = force.normal.frictional_load, force.rolling_limit
    return (
        _row(push, torques[0], rolling * levers[0], load),
        _row(-push, torques[1], rolling * levers[1], load),
        jnp.stack(channels, axis=-1),
    )


def _row(push: Vector, torque: Vector, limit: Array, load: Array) -> Array:
    columns = [push.x, push.y, push.z, torque.x, torque.y, torque.z, limit, load]
    return jnp.stack(columns, axis=-1)


def _pushes(normal: Vector, on_wall: Array, wall: Array) -> Array:
    """Force on the walls (N): base down, platen up, mould outward, mould upward."""
    radial = on_wall[:, 0] * normal.x + on_wall[:, 1] * normal.y
    base = jnp.where(wall == wall_module.BASE, -on_wall[:, 2], 0.0)
    platen = jnp.where(wall == wall_module.PLATEN, on_wall[:, 2], 0.0)
    is_mould = wall == wall_module.MOULD
    mould = jnp.where(is_mould, -radial, 0.0)
    drag = jnp.where(is_mould, on_wall[:, 2], 0.0)
    return jnp.stack([base, platen, mould, drag], axis=-1)


def next_motion(bed: Bed, motion: Motion, walls: Walls, loads: Array, command: Command):
    """Motion one step later, and energies of the step as `_absorbed` lists them."""
    shared = (bed.time_step, bed.gravity, bed.roll_width, walls, command)
    moved, absorbed = entrywise(_moved, shared, (bed.spheres, motion, loads))
    return moved, jnp.sum(absorbed, axis=0)


def _moved(shared, entries):
    """Each sphere's motion one step later, and what `_absorbed` says of it."""
    dt, gravity, roll_width, walls, command = shared
    spheres, motion, loads = entries
    push = Vector.from_rows(loads[:, 0:3]) / spheres.mass
    impulse = Vector(push.x, push.y, push.z - gravity) * dt
    free = motion.velocity + impulse
    affine = walls.axial_strain_rate() * motion.position.z
    share = loads[:, 7] / (LOADED * GRAVITY * spheres.mass)
    damping = command.damping + command.unloaded_damping / (1 + share * share)
    keep = 1 / (1 + damping * dt)
    velocity = Vector(free.x * keep, free.y * keep, affine + (free.z - affine) * keep)

    kick = Vector.from_rows(loads[:, 3:6]) * (dt / spheres.inertia)
    free_spin = (motion.spin + kick) * keep
    spin = _braked(free_spin, loads[:, 6] * dt / spheres.inertia, roll_width)

    moved = Motion(motion.position + velocity * dt, velocity, spin)
    absorbed = _absorbed(spheres, motion, moved, (impulse, kick), (free, free_spin))
    return moved, absorbed


def _absorbed(spheres: Spheres, before: Motion, after: Motion, increments, free) -> Array:
    """Energy (J) that background damping and rolling took, and `integration`.

    A force's exact work in one step goes with the mean of the velocities before and
    after; power at the start of the step misses half the velocity's change.
    """
    impulse, kick = increments
    free_velocity, free_spin = free
    mean_velocity = (before.velocity + after.velocity) * 0.5
    mean_spin = (before.spin + after.spin) * 0.5
    mass, inertia = spheres.mass, spheres.inertia
    drag = mass * (free_velocity - after.velocity).dot(mean_velocity)
    spin_drag = inertia * (before.spin + kick - free_spin).dot(mean_spin)
    rolling = inertia * (free_spin - after.spin).dot(mean_spin)
    missed = mass * impulse.dot(after.velocity - before.velocity)
    spin_missed = inertia * kick.dot(after.spin - before.spin)
    return jnp.stack([drag + spin_drag, rolling, 0.5 * (missed + spin_missed)], axis=-1)


def _braked(spin: Vector, limit: Array, width: Real) -> Vector:
    """Spin after an implicit step of the rolling torque limit w/(w + width), in rad/s.

    `limit` is the spin that the full torque takes away in this step.  The new rate w
    solves w + limit w/(w + width) = |spin|: it has the old direction and cannot reverse.
    """
    rate = smooth.norm(spin)
    excess = rate - limit - width
    root = jnp.sqrt(excess * excess + 4 * rate * width + _TINY)
    slow = 2 * width / jnp.where(excess > 0, 1.0, root - excess)
    fast = 0.5 * smooth.divide(excess + root, rate)
    return spin * jnp.minimum(jnp.where(excess > 0, fast, slow), 1.0)


_TINY = 1e-30  # rad2/s2; keeps the square root's gradient finite at rest
