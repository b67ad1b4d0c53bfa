"""The linear system of one stretch: what a bed's contacts answer to a change of its motion.

    A w = forces and torques on all spheres        w: velocities and spins

A is that of the contact law over a whole stretch, with drag (`jdem.engine.equilibrium`), and
it is not symmetric, because friction goes with the load.  It is solved for all derivatives at once
by BiCGStab (van der Vorst 1992, SIAM J. Sci. Stat. Comput. 13, 631).  The preconditioner is each
sphere's own stiffness, and the whole bed's against low polynomials of the place: without these,
what is left out of balance is long waves, and they are what a platen feels.
"""

from functools import partial
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion
from jdem.boundaries.composite import Boundaries, nearest
from jdem.core import smooth
from jdem.core.kernel import entrywise
from jdem.core.vector import Vector
from jdem.engine.loads import against, between, pair_loads, wall_loads
from jdem.engine.neighbors import ContactList
from jdem.engine.state import Bed, TangentDrag

ITERATIONS = 40  # of the solver, at most
TOLERANCE = 0.03  # of the forces out of balance that the solver leaves
RIDGE = 1e-6  # of their mean stiffness, against waves that few spheres cannot tell apart
STILL = 1e-9  # rad/s


class System(eqx.Module):
    """The linear system of one stretch: what contacts and spheres answer to rates.

    Of pairs and wall contacts: stiffness (K, 3, 3) against the relative velocity, that of the
    rolling limit (K, 3), normal (K, 3) and radii (K, 2).  Of spheres: the brake's share of the
    limit (N, 3), its resistance (N, 3, 3), drag (N, 6).  `size` (m) makes spins velocities.
    """

    pairs: tuple[Array, Array]
    walls: Array
    of_pairs: tuple[Array, Array, Array, Array]
    of_walls: tuple[Array, Array, Array, Array]
    brake: Array
    braked: Array
    drag: Array
    size: Array
    waves: Array

    @staticmethod
    def of(
        bed: Bed, boundaries: Boundaries, motion: Motion, pairs: ContactList, walls: ContactList
    ) -> "System":
        """Of a bed whose steps are as long as the stretch, with histories at its beginning."""
        rows = bed.spheres.rows(motion)
        loads, _ = pair_loads(bed, rows, pairs)
        loads, _, _ = wall_loads(bed, rows, boundaries, walls, loads)
        brake, braked = _braking(loads.rows[:, 6], motion.spin, smallest_width(bed))
        mass, inertia = bed.spheres.mass, bed.spheres.inertia
        first, second = rows[pairs.first], rows[pairs.second]
        listed = (first, second, pairs.alive, pairs.history)
        of_walls = (rows[walls.first], walls.second, walls.alive, walls.history)
        return System(
            pairs=(pairs.first, pairs.second),
            walls=walls.first,
            of_pairs=entrywise(_pair_stiffness, bed, listed, pairs.used()),
            of_walls=entrywise(_wall_stiffness, (bed, boundaries), of_walls, walls.used()),
            brake=brake,
            braked=braked,
            drag=drag_of(bed).background * jnp.stack([mass] * 3 + [inertia] * 3, axis=-1),
            size=jnp.mean(bed.spheres.radius),
            waves=_waves(motion.position),
        )

    def answer(self, rates: Array) -> Array:
        """Forces, and torques over `size` (N, 6, derivatives), that go with velocities, and spins
        times `size`."""
        first, second = self.pairs
        rates = rates.at[:, 3:].divide(self.size)
        one, two = _pair_answer(self.of_pairs, rates[first], rates[second])
        total = jnp.zeros((rates.shape[0], 7, rates.shape[2]), rates.dtype)
        total = total.at[first].add(one).at[second].add(two)
        total = total.at[self.walls].add(_wall_answer(self.of_walls, rates[self.walls]))
        turned = jnp.einsum("nij,njt->nit", self.braked, rates[:, 3:])
        torque = total[:, 3:6] + self.brake[:, :, None] * total[:, 6:7] + turned
        found = jnp.concatenate([total[:, :3], torque], axis=1) - self.drag[:, :, None] * rates
        return found.at[:, 3:].divide(self.size)

    def own(self) -> tuple[Array, Array]:
        """Inverses (N, 3, 3) of what each sphere alone answers to its velocity and spin."""
        first, second = self.pairs
        count = self.drag.shape[0]
        pushing, turning = jnp.zeros((2, count, 3, 3), self.drag.dtype)
        stiffness, _, normal, radii = self.of_pairs
        turned = _turned(stiffness, normal)
        pushing = pushing.at[first].add(stiffness).at[second].add(stiffness)
        turning = turning.at[first].add(turned * radii[:, :1, None] ** 2)
        turning = turning.at[second].add(turned * radii[:, 1:, None] ** 2)
        stiffness, _, normal, radii = self.of_walls
        pushing = pushing.at[self.walls].add(stiffness)
        turned = _turned(stiffness, normal) * radii[:, :1, None] ** 2
        turning = turning.at[self.walls].add(turned) + self.braked
        eye = jnp.eye(3)
        pushing = pushing - self.drag[:, :3, None] * eye
        turning = (turning - self.drag[:, 3:, None] * eye) / self.size**2
        return _inverse(pushing), _inverse(turning)


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


def _turned(stiffness: Array, normal: Array) -> Array:
    """-[n] K [n] (K, 3, 3): torque on a sphere of radius 1 that turns, [n] w = n x w."""
    x, y, z = normal.T
    none = jnp.zeros_like(x)
    cross = jnp.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1).reshape(-1, 3, 3)
    return -jnp.einsum("kij,kjl,klm->kim", cross, stiffness, cross)


def _pair_stiffness(bed: Bed, entries):
    one, two, alive, history = entries
    one, two = one.T, two.T

    def pushed(one):
        on_first, *_ = between(bed, one, two, alive, history)
        return on_first[:, 0:3], on_first[:, 6]

    offset = Vector(*one[0:3]) - Vector(*two[0:3])
    normal = offset * smooth.divide(1.0, smooth.norm(offset))
    return (*_slopes(pushed, one, bed.time_step), normal.stack(), jnp.stack([one[9], two[9]], -1))


def _wall_stiffness(shared, entries):
    (bed, boundaries), (one, wall, alive, history) = shared, entries
    one = one.T

    def pushed(one):
        on_first, *_ = against(bed, boundaries, one, wall, alive, history)
        return on_first[:, 0:3], on_first[:, 6]

    normal = nearest(boundaries, wall, Vector(*one[0:3])).normal
    return (*_slopes(pushed, one, bed.time_step), normal.stack(), jnp.stack([one[9], one[9]], -1))


def _slopes(pushed, one: Array, time):
    """Derivatives of a force (K, 3) and a limit (K,) in the first sphere's velocity."""
    axes = [one * 0.0 for _ in range(3)]
    axes = [axis.at[k].add(time).at[3 + k].add(1.0) for k, axis in enumerate(axes)]
    found = [jax.jvp(pushed, (one,), (axis,))[1] for axis in axes]
    forces, limits = zip(*found, strict=True)
    return jnp.stack(forces, axis=-1), jnp.stack(limits, axis=-1)


def _pair_answer(coefficients, one: Array, two: Array):
    """What pairs add to both of their spheres (K, 7, derivatives)."""
    stiffness, limit, normal, radii = coefficients
    n, r, s = Vector.from_rows(normal[:, None, :]), radii[:, :1], radii[:, 1:]
    turning = _vector(one, 3) * r + _vector(two, 3) * s
    moved = _vector(one, 0) - _vector(two, 0) - turning.cross(n)
    push, rolling = _times(stiffness, moved), _dot(limit, moved)
    twist = push.cross(n)
    return _columns(push, twist * r, rolling), _columns(-push, twist * s, rolling * (s / r))


def _wall_answer(coefficients, one: Array) -> Array:
    """What wall contacts add to their sphere (K, 7, derivatives)."""
    stiffness, limit, normal, radii = coefficients
    n, r = Vector.from_rows(normal[:, None, :]), radii[:, :1]
    moved = _vector(one, 0) - (_vector(one, 3) * r).cross(n)
    push = _times(stiffness, moved)
    return _columns(push, push.cross(n) * r, _dot(limit, moved))


def _vector(rates: Array, start: int) -> Vector:
    return Vector(*(rates[:, start + k] for k in range(3)))


def _times(matrix: Array, vector: Vector) -> Vector:
    return Vector(*(_dot(matrix[:, k], vector) for k in range(3)))


def _dot(row: Array, vector: Vector) -> Array:
    return row[:, :1] * vector.x + row[:, 1:2] * vector.y + row[:, 2:3] * vector.z


def _columns(push: Vector, twist: Vector, rolling: Array) -> Array:
    return jnp.stack([push.x, push.y, push.z, twist.x, twist.y, twist.z, rolling], axis=1)


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
    """Where the solver stands, column by column (derivatives): rates and what they leave of the
    wanted forces, the best of these so far, and what BiCGStab remembers."""

    number: Array
    rates: Array
    left: Array
    best: Array
    least: Array
    shadow: Array
    answer: Array
    direction: Array
    rho: Array
    alpha: Array
    omega: Array


def _all_solved(system: System, wanted: Array, guess: Array) -> Array:
    """Rates for columns (N, 6, derivatives) of forces and torques, from a guess."""
    wanted = wanted.at[:, 3:].divide(system.size)
    eased, goal = _preconditioner(system), TOLERANCE**2 * _dots(wanted, wanted)

    def unfinished(search: _Search):
        return (search.number < ITERATIONS) & jnp.any(search.least > goal)

    begun = _begun(system, wanted, guess.at[:, 3:].multiply(system.size))
    found = jax.lax.while_loop(unfinished, partial(_improved, system, eased), begun)
    return found.best.at[:, 3:].divide(system.size)


def _begun(system: System, wanted: Array, guess: Array) -> _Search:
    """From the guess, or from rest where that is better."""
    left = wanted - system.answer(guess)
    better = _dots(left, left) < _dots(wanted, wanted)
    rates, left = jnp.where(better, guess, 0.0), jnp.where(better, left, wanted)
    none, one = jnp.zeros_like(left), jnp.ones(wanted.shape[-1], wanted.dtype)
    number = jnp.zeros((), jnp.int32)
    return _Search(number, rates, left, rates, _dots(left, left), left, none, none, one, one, one)


def _improved(system: System, eased, search: _Search) -> _Search:
    """One step of BiCGStab in every column; a denominator of zero stands still."""
    rho = _dots(search.shadow, search.left)
    beta = smooth.divide(rho, search.rho) * smooth.divide(search.alpha, search.omega)
    direction = search.left + beta * (search.direction - search.omega * search.answer)
    way = eased(direction)
    answer = system.answer(way)
    alpha = smooth.divide(rho, _dots(search.shadow, answer))
    half = search.left - alpha * answer
    onward = eased(half)
    step = system.answer(onward)
    omega = smooth.divide(_dots(step, half), _dots(step, step))
    rates, left = search.rates + alpha * way + omega * onward, half - omega * step
    size = _dots(left, left)
    better = size < search.least
    return _Search(
        search.number + 1,
        rates,
        left,
        jnp.where(better, rates, search.best),
        jnp.where(better, size, search.least),
        *(search.shadow, answer, direction, rho, alpha, omega),
    )


def _preconditioner(system: System):
    """What rates roughly go with forces: each sphere's alone, and the whole bed's."""
    pushing, turning = system.own()
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
