"""The derivative of one stretch of a run: from one equilibrium to the next.

Over a stretch of time t spheres move by t v and turn by t w.  The derivative of their motion
keeps all forces in balance,

    K dx = -df                    K: stiffness of the bed, df: change of forces at fixed places

where forces are those of the contact law after the whole stretch in one step, with histories at
its beginning.  A bed's K has directions without stiffness, and friction may give it some of the
wrong sign.  So each contact and each sphere also resists the rate of change of derivatives,

    df -> df - (b k t) du - (m c) dv              u: relative motion in the contact, per time

which is implicit in time and therefore needs no short steps.  Errors do not add up, because it is
the whole force that is balanced after every stretch, not its change.

The linear system is that of `jdem.engine.stiffness`.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jdem.bodies.spheres import Motion
from jdem.boundaries.composite import Boundaries, about_references, strain_rate
from jdem.core import smooth
from jdem.core.fusion import fenced
from jdem.core.vector import Vector
from jdem.engine.loads import pair_loads, wall_loads
from jdem.engine.neighbors import ContactList
from jdem.engine.state import Bed
from jdem.engine.stiffness import System, drag_of, smallest_width, solved


class Stretch(eqx.Module):
    """Values of one stretch: how long (s), how spheres moved (m/s, rad/s) on average, its lists."""

    time: Array
    velocity: Vector
    spin: Vector
    pairs: ContactList
    walls: ContactList


class Carried(eqx.Module):
    """What derivatives are carried in; `rate` (N, 6) is zero and has those of velocities and spins
    as its derivative.  loads (boundaries, 7) as in `BedState`."""

    position: Vector
    rate: Array
    pairs: object
    walls: object
    loads: Array


def followed(
    bed: Bed, boundaries: Boundaries, carried: Carried, reached: Carried, stretch: Stretch
) -> Carried:
    """`reached`, with the derivatives that follow from those of all else."""
    moving, static = eqx.partition((bed, boundaries, carried), eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten(moving)
    values, shape = jax.tree.flatten(reached)

    @jax.custom_jvp
    def joined(still, values, leaves):
        return values

    def rule(primals, tangents):
        (stretch, values, leaves), moved = primals, tangents[2]
        known = [isinstance(leaf, SymbolicZero) for leaf in moved]
        slopes = [leaf for leaf, zero in zip(moved, known, strict=True) if not zero]

        def whole(some):
            rest = iter(some)
            both = [a if zero else next(rest) for a, zero in zip(leaves, known, strict=True)]
            return eqx.combine(jax.tree.unflatten(structure, both), static)

        free = [leaf for leaf, zero in zip(leaves, known, strict=True) if not zero]
        found = _derivative(whole, free, slopes, stretch)
        return values, jax.tree.leaves(found)

    joined.defjvp(rule, symbolic_zeros=True)
    found = joined(*jax.lax.stop_gradient((stretch, values)), leaves)
    return jax.tree.unflatten(shape, found)


def _derivative(whole, free: list, slopes: list, stretch: Stretch) -> Carried:
    """Derivatives of `Carried` from those of some leaves of bed, boundaries and `Carried`."""
    rates = _rows(stretch.velocity, stretch.spin)

    def balance(rates: Array, some: list):
        bed, boundaries, carried = whole(some)
        with fenced():
            return _balance(_dragged(bed, stretch), boundaries, carried, rates, stretch)

    def solving(limit, left, guess):
        bed, boundaries, carried = whole(free)
        motion, lists = _motion(carried, rates, stretch), _lists(carried, stretch)
        with fenced():
            system = System.of(_dragged(bed, stretch), boundaries, motion, lists, limit)
        return solved(system, -left, guess)

    def again(number, found):
        """First at given rates, and with what is out of balance then the rates; then with these."""
        rate, *_ = found
        pushed = jax.jvp(balance, (rates, free), (rate, slopes), has_aux=True)
        _, (left, histories, felt), limit = pushed
        rate = jax.lax.cond(number == 0, solving, lambda *_: rate, limit, left, before.rate)
        return rate, histories, felt

    before = jax.jvp(lambda some: whole(some)[2], (free,), (slopes,))[1]
    begun = (jnp.zeros_like(before.rate), (before.pairs, before.walls), before.loads)
    rate, (pairs, walls), felt = jax.lax.fori_loop(0, 2, again, begun)
    moved = Vector.from_rows(rate[:, :3]) * stretch.time
    return Carried(before.position + moved, rate, pairs, walls, felt)


def _rows(velocity: Vector, spin: Vector) -> Array:
    return jnp.concatenate([velocity.stack(), spin.stack()], axis=-1)


def _dragged(bed: Bed, stretch: Stretch) -> Bed:
    """The bed with steps as long as the stretch; its contacts' drag grows with their square."""
    steps = stretch.time / jax.lax.stop_gradient(bed.time_step)
    drag = drag_of(bed)
    drag = replace(drag, contact=drag.contact * steps * steps)
    return replace(bed, time_step=stretch.time, drag=jax.lax.stop_gradient(drag))


def _balance(bed: Bed, boundaries: Boundaries, carried: Carried, rates: Array, stretch: Stretch):
    """Forces (N) and torques (N m) out of balance (N, 6), histories, loads on boundaries; and,
    not to be differentiated, limits (N m) of rolling torques."""
    motion, (pairs, walls) = _motion(carried, rates, stretch), _lists(carried, stretch)
    rows = bed.spheres.rows(motion)
    loads, pairs = pair_loads(bed, rows, pairs)
    loads, walls, felt = wall_loads(bed, rows, boundaries, walls, loads)
    free = _resisted(bed, loads.rows, motion, strain_rate(boundaries, bed.follows))
    felt = about_references(boundaries, felt)
    return (free, (pairs.history, walls.history), felt), loads.rows[:, 6]


def _motion(carried: Carried, rates: Array, stretch: Stretch) -> Motion:
    """At the end of a stretch, with the mean rates over it."""
    velocity, spin = Vector.from_rows(rates[:, :3]), Vector.from_rows(rates[:, 3:])
    return Motion(carried.position + velocity * stretch.time, velocity, spin)


def _lists(carried: Carried, stretch: Stretch) -> tuple[ContactList, ContactList]:
    """Contacts with their histories as the stretch begins."""
    pairs = eqx.tree_at(lambda p: p.history, stretch.pairs, carried.pairs)
    return pairs, eqx.tree_at(lambda p: p.history, stretch.walls, carried.walls)


def _resisted(bed: Bed, loads: Array, motion: Motion, stretching) -> Array:
    """Force and torque on each sphere, with rolling resistance and the background's drag."""
    v, w, mass, inertia = motion.velocity, motion.spin, bed.spheres.mass, bed.spheres.inertia
    against = drag_of(bed).background * mass
    affine = Vector(v.x, v.y, v.z - stretching * motion.position.z)
    force = Vector.from_rows(loads[:, 0:3]) - affine * against
    brake = loads[:, 6] / (smooth.norm(w) + smallest_width(bed)) + drag_of(bed).background * inertia
    return _rows(force, Vector.from_rows(loads[:, 3:6]) - w * brake)
