"""When to rebuild the contact lists: before anything can have crossed their skin.

    motion = the two largest motions of spheres since the rebuild + the boundaries' motion

Lists are complete while motion < skin. They are rebuilt before an interval in which motion
could exceed it if everything went on as in the last interval, with as much again in
reserve.  Where spheres suddenly are too fast for that, as when a brittle specimen bursts, an
interval is cut into pieces with a look at the lists before each (`lasting`).  The largest
motion that did occur is kept, so that a surprise is reported.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.composite import Boundaries
from jdem.core import smooth
from jdem.core.vector import Vector
from jdem.engine.neighbors import Demand, rebuild
from jdem.engine.step import Bed, BedState

RESERVE = 0.25  # of the skin, kept for motion that sets in within an interval
GUARD = 1.5  # times the present speeds is what spheres may reach before the next look


class ListUpdate(eqx.Module):
    """Where everything was at the last rebuild (m), and what the lists demanded so far.

    latest is the motion within the last interval, largest the most since any rebuild (m).
    """

    position: Vector
    boundaries: Boundaries
    latest: Array
    largest: Array
    demand: Demand

    @staticmethod
    def begin(bed: Bed, state: BedState) -> "ListUpdate":
        """Makes sure that the first interval starts with a rebuild."""
        zero = jnp.zeros_like(state.time)
        position = _positions(bed, state)
        return ListUpdate(position, state.boundaries, zero + jnp.inf, zero, Demand.none())


def refreshed(bed: Bed, state: BedState, update: ListUpdate) -> tuple[BedState, ListUpdate, Array]:
    """The state with lists that will last an interval, and the motion that they have seen."""
    motion, position = _motion(bed, state, update), bed.spheres.positions(state.motion)
    reserve = jnp.maximum(2 * update.latest, RESERVE * bed.grid.skin)
    due = motion + reserve > bed.grid.skin

    def renew(state: BedState):
        lists = (state.pairs, state.wall_contacts)
        return rebuild(bed.grid, bed.spheres, state.boundaries, position, *lists)

    def keep(state: BedState):
        return state.pairs, state.wall_contacts, Demand.none()

    pairs, contacts, demand = jax.lax.cond(due, renew, keep, state)
    origin = jax.tree.map(
        lambda now, then: jnp.where(due, now, then),
        (position, state.boundaries),
        (update.position, update.boundaries),
    )
    state = eqx.tree_at(lambda s: (s.pairs, s.wall_contacts), state, (pairs, contacts))
    demand = update.demand.including(demand)
    position, boundaries = jax.lax.stop_gradient(origin)
    update = ListUpdate(position, boundaries, update.latest, update.largest, demand)
    return state, update, jnp.where(due, 0.0, motion)


def lasting(bed: Bed, state: BedState, motion: Array, wanted: Array) -> Array:
    """How many of the wanted steps the lists last, where `motion` (m) is used up: at least one."""
    rows, time_step = jax.lax.stop_gradient((bed.spheres.rows(state.motion), bed.time_step))
    speeds = smooth.norm(Vector.from_rows(rows[:, 3:6]))
    way = GUARD * _sum_of_two_largest(speeds) * time_step  # m in a step
    left = bed.grid.skin - motion
    some = jnp.where(left > way, jnp.minimum(left / jnp.where(way > 0, way, 1.0), wanted), 1)
    return jnp.where(way * wanted < left, wanted, some.astype(wanted.dtype))


def checked(bed: Bed, state: BedState, update: ListUpdate, before: Array) -> ListUpdate:
    """After an interval that began with the motion `before` (m)."""
    motion = _motion(bed, state, update)
    largest = jnp.maximum(update.largest, motion)
    return ListUpdate(update.position, update.boundaries, motion - before, largest, update.demand)


def _positions(bed: Bed, state: BedState) -> Vector:
    return jax.lax.stop_gradient(bed.spheres.positions(state.motion))


def _motion(bed: Bed, state: BedState, update: ListUpdate) -> Array:
    """Motion since the last rebuild, m; no derivative passes through it."""
    spheres = _sum_of_two_largest(smooth.norm(_positions(bed, state) - update.position))
    both = zip(state.boundaries, update.boundaries, strict=True)
    travelled = sum(now.travelled(then) for now, then in both)
    return spheres + jax.lax.stop_gradient(travelled)


def _sum_of_two_largest(lengths: Array) -> Array:
    """Of lengths (N,); XLA's `top_k` sorts them all, at every interval."""
    farthest = jnp.argmax(lengths)
    return lengths[farthest] + jnp.max(lengths.at[farthest].set(0.0))
