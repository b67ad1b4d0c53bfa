"""The linear system of one stretch: what a bed's contacts answer to a change of its motion.

    A w = forces and torques on all spheres        w: velocities and spins

A is that of the contact law over a whole stretch, with drag (`jdem.engine.equilibrium`), and
it is not symmetric, because friction goes with the load.  It is solved for all derivatives at once
by conjugate residuals (GCR: Eisenstat, Elman and Schultz 1983, SIAM J. Numer. Anal. 20, 345): what
is left never grows, and where the system is almost singular, rates stay small.  The preconditioner
is each sphere's own stiffness, and the whole bed's against low polynomials of the place: without
these, what is left out of balance is long waves, and they are what a platen feels.

Forces are multiplied, and motions divided, by one over the root of each sphere's own stiffness s,
so that what is left of both counts as energy, f2/s: a small force may move a loose sphere far.

A motion turns the contact's normal and a spin does not.  That is one per cent of the stiffness,
and a system without it has the wrong sign wherever a contact slides.
"""

from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion
from jdem.boundaries.composite import Boundaries
from jdem.core import smooth
from jdem.core.kernel import entrywise
from jdem.core.vector import Vector
from jdem.engine.loads import against, between, codes_met
from jdem.engine.neighbors import ContactList
from jdem.engine.state import Bed, TangentDrag

ITERATIONS = 60  # of the solver, at most
TOLERANCE = 0.03  # of the forces out of balance that the solver leaves
RIDGE = 1e-6  # of their mean stiffness, against waves that few spheres cannot tell apart
STILL = 1e-9  # rad/s


class System(eqx.Module):
    """The linear system of one stretch: what contacts and spheres answer to rates.

    Of pairs (K, 10, 9): force on the first, torques on both and the first's rolling limit, from
    relative velocity and both spins; `levers` (K,) is the second's limit over the first's.  Of wall
    contacts (K, 7, 6): force, torque and limit, from velocity and spin.  Of spheres: the brake's
    share of the limit (N, 3), its resistance (N, 3, 3), drag (N, 6), stiffness against velocity and
    spin (N, 3, 3) of each alone, and `scale` (N, 6), one over the root of its mean.
    """

    pairs: tuple[Array, Array]
    walls: Array
    of_pairs: Array
    of_walls: Array
    levers: Array
    brake: Array
    braked: Array
    drag: Array
    own: tuple[Array, Array]
    scale: Array
    waves: Array

    @staticmethod
    def of(
        bed: Bed,
        boundaries: Boundaries,
        motion: Motion,
        lists: tuple[ContactList, ContactList],
        limit: Array,
    ) -> "System":
        """Of a bed whose steps are as long as the stretch, with histories at its beginning and
        limits (N m) of the spheres' rolling torques."""
        (pairs, walls), rows = lists, bed.spheres.rows(motion)
        brake, braked = _braking(limit, motion.spin, smallest_width(bed))
        mass, inertia = bed.spheres.mass, bed.spheres.inertia
        drag = drag_of(bed).background * jnp.stack([mass] * 3 + [inertia] * 3, axis=-1)
        first, second = rows[pairs.first], rows[pairs.second]
        listed = (first, second, pairs.alive, pairs.history)
        of_pairs = entrywise(_pair_stiffness, bed, listed, pairs.used())
        codes = codes_met(rows, boundaries, walls)
        listed = (rows[walls.first], walls.second, walls.alive, walls.history, codes)
        of_walls = entrywise(_wall_stiffness, (bed, boundaries), listed, walls.used())
        pushing = [(pairs.first, of_pairs[:, 0:3, 0:3]), (pairs.second, of_pairs[:, 0:3, 0:3])]
        turning = [(pairs.first, of_pairs[:, 3:6, 3:6]), (pairs.second, of_pairs[:, 6:9, 6:9])]
        pushing = [*pushing, (walls.first, of_walls[:, 0:3, 0:3])]
        turning = [*turning, (walls.first, of_walls[:, 3:6, 3:6])]
        own = (_own(drag[:, :3], pushing), _own(drag[:, 3:], turning) + braked)
        scale = _scale(own)
        return System(
            pairs=(pairs.first, pairs.second),
            walls=walls.first,
            of_pairs=of_pairs,
            of_walls=of_walls,
            levers=second[:, 9] / first[:, 9],
            brake=brake,
            braked=braked,
            drag=drag,
            own=own,
            scale=scale,
            waves=_waves(motion.position) / scale[:, :, None],
        )

    def answer(self, rates: Array) -> Array:
        """Scaled forces and torques (N, 6, derivatives) of scaled velocities and spins."""
        first, second = self.pairs
        rates = rates * self.scale[:, :, None]
        one, two = _pair_answer(self.of_pairs, self.levers, rates[first], rates[second])
        total = jnp.zeros((rates.shape[0], 7, rates.shape[2]), rates.dtype)
        total = total.at[first].add(one).at[second].add(two)
        total = total.at[self.walls].add(_times(self.of_walls, rates[self.walls]))
        turned = jnp.einsum("nij,njt->nit", self.braked, rates[:, 3:])
        torque = total[:, 3:6] + self.brake[:, :, None] * total[:, 6:7] + turned
        found = jnp.concatenate([total[:, :3], torque], axis=1) - self.drag[:, :, None] * rates
        return found * self.scale[:, :, None]

    def alone(self) -> list[Array]:
        """Inverses (N, 3, 3) of what each sphere alone answers to its velocity and to its spin."""
        scales = (self.scale[:, :1], self.scale[:, 3:4])
        parts = zip(self.own, scales, strict=True)
        return [_inverse(part * scale[:, :, None] ** 2) for part, scale in parts]


def _own(drag: Array, contacts: list[tuple[Array, Array]]) -> Array:
    """What each sphere alone answers (N, 3, 3): drag (N, 3) and what its contacts add."""
    total = -drag[:, :, None] * jnp.eye(3)
    for spheres, stiffness in contacts:
        total = total.at[spheres].add(stiffness)
    return total


def _scale(own: tuple[Array, Array]) -> Array:
    """One over the root of each sphere's mean stiffness against velocity and spin (N, 6)."""
    means = [jnp.abs(jnp.trace(part, axis1=1, axis2=2)) / 3 for part in own]
    return jnp.repeat(jax.lax.rsqrt(jnp.stack(means, axis=-1)), 3, axis=1)


def _waves(position: Vector) -> Array:
    """Motions of the whole bed (N, 6, modes): low polynomials of the place, along each axis."""
    x, y, z = (_standard(part) for part in (position.x, position.y, position.z))
    one = jnp.ones_like(x)
    shapes = jnp.stack([one, x, y, z, x * z, y * z, z * z, z * z * z], axis=-1)
    modes = jnp.einsum("ns,ij->nijs", shapes, jnp.eye(6)[:, :3])
    return modes.reshape(x.shape[0], 6, -1)


def _standard(part: Array) -> Array:
    """From -1 to 1; zero where there is no extent."""
    low, high = jnp.min(part), jnp.max(part)
    return smooth.divide(2 * part - low - high, high - low)


def _inverse(matrices: Array) -> Array:
    """Of matrices (N, 3, 3), by cofactors."""
    a, b, c = (Vector.from_rows(matrices[:, k]) for k in range(3))
    columns = [b.cross(c), c.cross(a), a.cross(b)]
    return (
        jnp.stack([column.stack() for column in columns], axis=-1)
        / a.dot(columns[0])[:, None, None]
    )


def _pair_stiffness(bed: Bed, entries):
    one, two, alive, history = entries
    one, two = one.T, two.T

    def pushed(one, two):
        on_first, on_second, *_ = between(bed, one, two, alive, history)
        return jnp.concatenate([on_first[:, 0:6], on_second[:, 3:6], on_first[:, 6:7]], axis=1)

    motion, spin = _directions(one, bed.time_step)
    none = jnp.zeros_like(spin)
    firsts, seconds = jnp.concatenate([motion, spin, none]), jnp.concatenate([none, none, spin])
    return _slopes(pushed, (one, two), (firsts, seconds))


def _wall_stiffness(shared, entries):
    (bed, boundaries), (one, *listed) = shared, entries
    one = one.T

    def pushed(one):
        on_first, *_ = against(bed, boundaries, one, *listed)
        return on_first[:, 0:7]

    return _slopes(pushed, (one,), (jnp.concatenate(_directions(one, bed.time_step)),))


def _directions(one: Array, time) -> tuple[Array, Array]:
    """Velocities that move spheres for a time, and spins, along each axis (3, columns, K)."""
    eye = jnp.eye(3, dtype=one.dtype)[:, :, None] * jnp.ones_like(one[0])
    none, rest = jnp.zeros_like(eye), jnp.zeros((3, one.shape[0] - 9, one.shape[1]), one.dtype)
    motion = jnp.concatenate([eye * time, eye, none, rest], axis=1)
    return motion, jnp.concatenate([none, none, eye, rest], axis=1)


def _slopes(pushed, rows: tuple[Array, ...], directions: tuple[Array, ...]) -> Array:
    """Derivatives (K, results, directions) of what `pushed` returns (K, results)."""

    def slope(*along):
        return jax.jvp(pushed, rows, along)[1]

    return jax.vmap(slope, out_axes=-1)(*directions)


def _pair_answer(stiffness: Array, levers: Array, one: Array, two: Array):
    """What pairs add to both of their spheres (K, 7, derivatives)."""
    moved = jnp.concatenate([one[:, :3] - two[:, :3], one[:, 3:], two[:, 3:]], axis=1)
    found = _times(stiffness, moved)
    push, limit = found[:, 0:3], found[:, 9:10]
    on_first = jnp.concatenate([push, found[:, 3:6], limit], axis=1)
    return on_first, jnp.concatenate([-push, found[:, 6:9], limit * levers[:, None, None]], axis=1)


def _times(matrices: Array, columns: Array) -> Array:
    """Products (K, i, t) of matrices (K, i, j) and columns (K, j, t); few j, taken one by one."""
    products = [matrices[:, :, j, None] * columns[:, None, j, :] for j in range(matrices.shape[-1])]
    return sum(products[1:], products[0])


def drag_of(bed: Bed) -> TangentDrag:
    """The drag of a bed that has one."""
    return cast(TangentDrag, bed.drag)


def smallest_width(bed: Bed) -> Array:
    """Spin (rad/s) at which half of the rolling torque acts; at rest a sharp one would divide."""
    return jnp.maximum(bed.roll_width, STILL)


def _braking(limit: Array, turning: Vector, width):
    """How a torque of resistance L w/(|w| + width) goes with L (N, 3) and with w (N, 3, 3)."""
    spin, rate = turning.stack(), smooth.norm(turning)[:, None]
    share = -spin / (rate + width)
    along = spin / jnp.where(rate > 0, rate, 1.0)
    outer = along[:, :, None] * along[:, None, :] * (rate / (rate + width))[:, :, None]
    return share, -(limit[:, None] / (rate + width))[:, :, None] * (jnp.eye(3) - outer)


@jax.custom_batching.custom_vmap
def solved(system: System, wanted: Array, guess: Array) -> Array:
    """Rates (N, 6) to which `system` answers with the wanted forces and torques (N, 6)."""
    return _all_solved(system, wanted[:, :, None], guess[:, :, None])[:, :, 0]


@solved.def_vmap
def _many_solved(size: int, batched, system: System, wanted: Array, guess: Array):
    """Several at once; the system is the same for all."""
    several = [
        jnp.moveaxis(part, 0, -1) if lanes else jnp.repeat(part[:, :, None], size, axis=-1)
        for part, lanes in zip((wanted, guess), batched[1:], strict=True)
    ]
    return jnp.moveaxis(_all_solved(system, *several), -1, 0), True


class _Search(eqx.Module):
    """Where the solver stands, column by column (derivatives): rates, what they leave of the
    wanted forces, and the directions so far with what the system answers to them, of size 1."""

    number: Array
    rates: Array
    left: Array
    ways: Array
    answers: Array


def _all_solved(system: System, wanted: Array, guess: Array) -> Array:
    """Rates for columns (N, 6, derivatives) of forces and torques, from a guess."""
    scale = system.scale[:, :, None]
    wanted = wanted * scale
    eased, goal = _preconditioner(system), TOLERANCE**2 * _dots(wanted, wanted)

    def unfinished(search: _Search):
        return (search.number < ITERATIONS) & jnp.any(_dots(search.left, search.left) > goal)

    begun = _begun(system, wanted, guess / scale)
    return jax.lax.while_loop(unfinished, partial(_improved, system, eased), begun).rates * scale


def _begun(system: System, wanted: Array, guess: Array) -> _Search:
    """From the guess, or from rest where that is better."""
    left = wanted - system.answer(guess)
    better = _dots(left, left) < _dots(wanted, wanted)
    rates, left = jnp.where(better, guess, 0.0), jnp.where(better, left, wanted)
    none = jnp.zeros((ITERATIONS, *left.shape), left.dtype)
    return _Search(jnp.zeros((), jnp.int32), rates, left, none, none)


def _improved(system: System, eased, search: _Search) -> _Search:
    """One more direction in every column; of size zero, it changes nothing."""

    def apart(k, both):
        way, answer = both
        share = _dots(answer, search.answers[k])
        return way - share * search.ways[k], answer - share * search.answers[k]

    way = eased(search.left)
    way, answer = jax.lax.fori_loop(0, search.number, apart, (way, system.answer(way)))
    size = smooth.divide(1.0, jnp.sqrt(_dots(answer, answer)))
    way, answer = way * size, answer * size
    share = _dots(search.left, answer)
    return _Search(
        search.number + 1,
        search.rates + share * way,
        search.left - share * answer,
        search.ways.at[search.number].set(way),
        search.answers.at[search.number].set(answer),
    )


def _preconditioner(system: System):
    """What rates roughly go with forces: each sphere's alone, and the whole bed's."""
    pushing, turning = system.alone()
    waves = system.waves
    stiffness = jnp.einsum("nis,nit->st", waves, system.answer(waves))
    kept = RIDGE * jnp.trace(stiffness) / stiffness.shape[0]
    flexible = jnp.linalg.inv(stiffness + kept * jnp.eye(stiffness.shape[0]))

    def eased(forces: Array) -> Array:
        both = [(pushing, forces[:, :3]), (turning, forces[:, 3:])]
        own = jnp.concatenate([jnp.einsum("nij,njt->nit", m, f) for m, f in both], axis=1)
        load = jnp.einsum("nis,nit->st", waves, forces)
        return own + jnp.einsum("nis,st->nit", waves, flexible @ load)

    return eased


def _dots(one: Array, two: Array) -> Array:
    return jnp.sum(one * two, axis=(0, 1))
