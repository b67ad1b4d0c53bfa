"""One time step of a bed between its boundaries, in the order of physics.

    contacts -> forces -> sums on spheres and boundaries -> motion -> boundaries

Semi-implicit Euler: velocities first, positions with the new velocities.  Background
damping acts on the motion relative to the affine motion that the platen imposes, and
rolling resistance is applied implicitly: it can stop a spin, never reverse it.  Spheres
that carry next to no load are damped more: they rattle between their neighbours, which
leaves the specimen's force unchanged and makes its derivatives chaotic (docs/derivatives.md).
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries.composite import (
    Boundaries,
    about_references,
    driven,
    moved,
    power,
    strain_rate,
)
from jdem.core import smooth
from jdem.core.fusion import fenced
from jdem.core.kernel import entrywise, together
from jdem.core.quantity import Real
from jdem.core.vector import Vector
from jdem.engine.energy import Ledger
from jdem.engine.loads import pair_loads, wall_loads
from jdem.engine.state import GRAVITY, Bed, BedState, Command

LOADED = 100.0  # own weights; sum of contact loads at which half of the extra damping is gone

Motions = Callable[[Bed, Motion, Real, Array, Command], tuple[Motion, Array]]


def step(bed: Bed, state: BedState, command: Command, motions: Motions | None = None) -> BedState:
    """The state one time step later; `motions` can stand in for `next_motion`."""
    with fenced():
        return _step(bed, state, command, motions or next_motion)


def _step(bed: Bed, state: BedState, command: Command, motions: Motions) -> BedState:
    driving = partial(_driven, bed.follows)
    boundaries, stretching = together(driving, state.boundaries, command.rates)
    rows = jax.lax.optimization_barrier(bed.spheres.rows(state.motion))
    loads, pairs = pair_loads(bed, rows, state.pairs)
    loads, contacts, felt = wall_loads(bed, rows, boundaries, state.wall_contacts, loads)
    on_bodies = bed.spheres.collected(loads.rows, state.motion)
    motion, absorbed = motions(bed, state.motion, stretching, on_bodies, command)
    gravity = -bed.gravity * jnp.sum(bed.spheres.mass * state.motion.velocity.z)
    powers = (loads.power, loads.rolling, gravity)
    before = (state.energy, state.time)
    boundaries, felt, energy, time = together(
        _booked, before, boundaries, felt, powers, absorbed, bed.time_step
    )
    return BedState(
        motion=motion,
        boundaries=boundaries,
        pairs=pairs,
        wall_contacts=contacts,
        loads=felt,
        energy=energy,
        time=time,
        reading=state.reading,
    )


def _driven(follows: int | None, boundaries: Boundaries, rates: Array):
    """Boundaries at the machine's rates, and the stretching (1/s) that damping follows."""
    boundaries = driven(boundaries, rates)
    return boundaries, strain_rate(boundaries, follows)


def _booked(before, boundaries: Boundaries, felt: Array, powers, absorbed: Array, time_step: Real):
    """Boundaries one step later, loads about their references, the ledger, and the time (s)."""
    (energy, time), (contacts, rolling, gravity) = before, powers
    felt = about_references(boundaries, felt)
    work = Ledger.of_step(
        contacts=contacts,
        rolling=rolling,
        boundaries=power(boundaries, felt),
        absorbed=absorbed,
        gravity=gravity,
        time_step=time_step,
    )
    return moved(boundaries, time_step), felt, energy + work, time + time_step


def next_motion(
    bed: Bed,
    motion: Motion,
    stretching: Real,
    loads: Array,
    command: Command,
):
    """Motion one step later, and energies of the step as `_absorbed` lists them.

    `stretching` (1/s) is the rate of the affine motion along z that damping leaves alone.
    """
    damping = (command.damping, command.unloaded_damping)
    shared = (bed.time_step, bed.gravity, bed.roll_width, stretching, damping)
    moved, absorbed = entrywise(_moved, shared, (bed.spheres, motion, loads))
    return moved, jnp.sum(absorbed, axis=0)


def _moved(shared, entries):
    """Each sphere's motion one step later, and what `_absorbed` says of it."""
    dt, gravity, roll_width, stretching, (background, unloaded) = shared
    spheres, motion, loads = entries
    push = Vector.from_rows(loads[:, 0:3]) / spheres.mass
    impulse = Vector(push.x, push.y, push.z - gravity) * dt
    free = motion.velocity + impulse
    affine = stretching * motion.position.z
    share = loads[:, 7] / (LOADED * GRAVITY * spheres.mass)
    damping = background + unloaded / (1 + share * share)
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
