"""Overdamped derivatives: forward mode, from one equilibrium of the bed to the next.

The derivative of a bed that is loaded slowly is that of a sequence of equilibria, K dx = -df.
Pathwise tangents obey the equation of motion instead, m dv' = -K dx - df: where a contact softens
they grow with exp(t sqrt(k/m)), and at some hundred spheres nothing else is left of them.  Here
no derivative passes through the time steps.  After every `STRIDE` of them derivatives follow from
those before and from how spheres moved meanwhile (`jdem.engine.equilibrium`).

The machine moves as it did: derivatives are those at given travels.  Where it turns, at a force
G, the travel depends on the parameters, and all goes on along its path as far as that takes:

    d out/dp at given force = d out/dp - d out/dG dG/dp

with d out/dG from the values, over the last part of the movement (RISE of the force).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.boundaries.composite import Boundaries
from jdem.core import smooth
from jdem.core.quantity import Real, quantity
from jdem.core.tangents import with_derivative_of
from jdem.core.vector import Vector
from jdem.effects.base import AbstractEffect
from jdem.engine.equilibrium import Carried, Stretch, followed
from jdem.engine.loop import AbstractDerivative, Interval, Sample
from jdem.engine.neighbors import inherited
from jdem.engine.segment import placed, served
from jdem.engine.state import Bed, BedState, TangentDrag
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.sensitivity.base import AbstractTraced, Traced, stands_free

STRIDE = 36  # time steps from one equilibrium to the next
WINDOW = 0.25  # in ln(force); between two neighbouring rows a curve's slope is mostly roughness
RISE = 0.2  # share of the force over which a path's direction is taken


class Mark(eqx.Module):
    """Values of a moment: what derivatives are carried in, boundaries and the reading."""

    carried: Carried
    boundaries: Boundaries
    reading: Array


class Memory(eqx.Module):
    """Where derivatives stand: the last equilibrium, what has passed since, and two moments of the
    movement under way, the older of which is at least RISE of the force ago if there is such."""

    carried: Carried
    boundaries: Boundaries
    keys: tuple[Array, Array]  #: of the lists of pairs and of wall contacts
    time: Array
    turned: Vector  #: rad/s, sum of spins over the steps since
    steps: Array
    sample: Array
    balanced: Array  #: (samples,); those that end with an equilibrium
    marks: tuple[Mark, Mark]


class OverdampedMotion(AbstractDerivative):
    """Derivatives from equilibrium to equilibrium, of a machine that ends the movements `turning`
    at given forces, as it sees them under some effects, and all others after given travels.

    From movement number `last` on, if that is given, nothing is followed: derivatives are 0."""

    drag: TangentDrag
    effects: tuple[AbstractEffect, ...] = ()
    turning: tuple[int, ...] = eqx.field(static=True, kw_only=True)
    first: int = eqx.field(static=True, default=0, kw_only=True)
    last: int | None = eqx.field(static=True, default=None, kw_only=True)

    @property
    def window(self) -> float:
        return WINDOW

    def held(self, tree):
        return jax.lax.stop_gradient(tree)

    def seen(self, force: Array) -> Array:
        return jax.lax.stop_gradient(force)

    def watched(self, state: BedState):
        return state.motion.spin, jnp.ones((), jnp.int32)

    def memory(self, bed: Bed, state: BedState, capacity: int) -> Memory:
        carried, mark = _carried(state), _marked(state)
        return Memory(
            carried=carried,
            boundaries=state.boundaries,
            keys=_keys(state),
            time=jax.lax.stop_gradient(state.time),
            turned=jax.tree.map(jnp.zeros_like, state.motion.spin),
            steps=jnp.zeros((), jnp.int32),
            sample=jnp.zeros((), jnp.int32),
            balanced=jnp.zeros(capacity, bool),
            marks=(mark, mark),
        )

    def followed(self, memory: Memory, interval: Interval, sample: Sample):
        following = partial(self._followed, interval)
        if self.last is None:
            return following(memory, sample)
        beyond = interval.number >= self.last
        return jax.lax.cond(beyond, _left, following, memory, sample)

    def _followed(self, interval: Interval, memory: Memory, sample: Sample):
        spins, steps = interval.watched
        memory = _relisted(memory, interval.after)
        memory = replace(
            memory,
            turned=jax.tree.map(jnp.add, memory.turned, spins),
            steps=memory.steps + steps,
            sample=memory.sample + 1,
        )
        due = (memory.steps >= STRIDE) | interval.ends
        balanced = memory.balanced.at[memory.sample - 1].set(due)
        memory = replace(memory, balanced=balanced)
        memory = jax.lax.cond(due, partial(self._balanced, interval), lambda m: m, memory)
        sample = _sampled(memory, interval, sample)
        return jax.lax.cond(interval.ends, partial(_begun, interval), lambda m: m, memory), sample

    def recorded(self, memory: Memory, samples: Sample, state: BedState):
        """Derivatives of samples between two equilibria lie between those there."""
        rows = jnp.arange(memory.balanced.shape[0])
        before = jax.lax.cummax(jnp.where(memory.balanced, rows, 0))
        after = jnp.where(memory.balanced, rows, rows.shape[0] - 1)
        after = jax.lax.cummin(after, reverse=True)
        share = (rows - before) / jnp.maximum(after - before, 1)
        share = jnp.where(samples.segment[before] == samples.segment[rows], share, 1.0)

        def between(leaf: Array) -> Array:
            part = share.reshape(-1, *(1 for _ in leaf.shape[1:])).astype(leaf.dtype)
            return with_derivative_of(leaf, leaf[before] + part * (leaf[after] - leaf[before]))

        parts = (samples.reference, samples.loads, samples.reading)
        reference, loads, reading = map(between, parts)
        samples = replace(samples, reference=reference, loads=loads, reading=reading)
        return samples, _joined(state, memory)

    def _balanced(self, interval: Interval, memory: Memory) -> Memory:
        """The memory at the equilibrium after an interval."""
        after, bed = interval.after, replace(interval.bed, drag=self.drag)
        reached, time = _marked(after), after.time - memory.time
        stretch = Stretch(
            time=time,
            velocity=(reached.carried.position - memory.carried.position) * (1 / time),
            spin=memory.turned * (1 / memory.steps),
            pairs=after.pairs,
            walls=after.wall_contacts,
        )
        boundaries = with_derivative_of(reached.boundaries, memory.boundaries)
        carried = followed(bed, boundaries, memory.carried, reached.carried, stretch)
        memory = replace(
            memory,
            carried=carried,
            boundaries=boundaries,
            time=jax.lax.stop_gradient(after.time),
            turned=jax.tree.map(jnp.zeros_like, memory.turned),
            steps=jnp.zeros_like(memory.steps),
            marks=_marks(memory.marks, reached),
        )
        turns = jnp.any(jnp.asarray([interval.number == k for k in self.turning], bool))
        turned = partial(_turned, self.effects, interval)
        return jax.lax.cond(turns & interval.ends, turned, lambda m: m, memory)


def _parts(state: BedState):
    """What derivatives are carried in, of a state."""
    histories = (state.pairs.history, state.wall_contacts.history)
    return state.motion.position, *histories, state.loads, state.boundaries


def _joined(state: BedState, memory: Memory) -> BedState:
    """The state, with the derivatives of the last equilibrium."""
    carried = memory.carried
    found = (carried.position, carried.pairs, carried.walls, carried.loads, memory.boundaries)
    return eqx.tree_at(_parts, state, with_derivative_of(_parts(state), found))


def _carried(state: BedState) -> Carried:
    zero = jnp.zeros((state.motion.position.x.shape[0], 6), state.time.dtype)
    histories = (state.pairs.history, state.wall_contacts.history)
    return Carried(state.motion.position, zero, *histories, state.loads)


def _marked(state: BedState) -> Mark:
    return jax.lax.stop_gradient(Mark(_carried(state), state.boundaries, state.reading))


def _marks(marks: tuple[Mark, Mark], now: Mark) -> tuple[Mark, Mark]:
    """The older one of two moments, and the present one if the force has changed enough."""
    size = jnp.maximum(jnp.abs(now.reading), jnp.abs(marks[1].reading))
    passed = jnp.abs(now.reading - marks[1].reading) > RISE * size
    older = jax.tree.map(lambda a, b: jnp.where(passed, b, a), *marks)
    return older, jax.tree.map(lambda a, b: jnp.where(passed, b, a), marks[1], now)


def _seen(effects: Sequence[AbstractEffect], force: Array) -> Array:
    """What the servo sees of a force (N or N m) just after the load cell was tared."""
    errors = [effect.servo_error(force, jnp.zeros_like(force)) for effect in effects]
    return force + sum(errors)


def _turned(effects: Sequence[AbstractEffect], interval: Interval, memory: Memory) -> Memory:
    """Derivatives at the force where a movement ended, from those at its travel."""
    now, then = _marked(interval.after), memory.marks[0]
    force = served(memory.boundaries, memory.carried.loads, interval.segment)
    force = _seen(effects, force)
    rise = jax.lax.stop_gradient(_seen(effects, now.reading) - _seen(effects, then.reading))
    share = smooth.divide(jax.lax.stop_gradient(force) - force, rise)  # 0, with a derivative

    def along(value, present, earlier):
        return value + share * (present - earlier)

    carried = jax.tree.map(along, memory.carried, now.carried, then.carried)
    boundaries = jax.tree.map(along, memory.boundaries, now.boundaries, then.boundaries)
    return replace(memory, carried=carried, boundaries=boundaries)


def _begun(interval: Interval, memory: Memory) -> Memory:
    """The memory as the next movement begins."""
    position, radius = memory.carried.position, interval.bed.spheres.radius
    boundaries = placed(memory.boundaries, interval.following, position, radius)
    now = replace(_marked(interval.after), boundaries=jax.lax.stop_gradient(boundaries))
    return replace(memory, boundaries=boundaries, marks=(now, now))


def _left(memory: Memory, sample: Sample):
    """Both without a derivative."""
    return jax.lax.stop_gradient((memory, sample))


def _sampled(memory: Memory, interval: Interval, sample: Sample) -> Sample:
    """The sample, with the derivatives of the last equilibrium."""
    loads = with_derivative_of(sample.loads, memory.carried.loads)
    places = jnp.stack([boundary.reference.stack() for boundary in memory.boundaries])
    force = served(memory.boundaries, loads, interval.segment)
    return replace(
        sample,
        loads=loads,
        reference=with_derivative_of(sample.reference, places),
        reading=with_derivative_of(sample.reading, force),
    )


def _keys(state: BedState) -> tuple[Array, Array]:
    return state.pairs.key, state.wall_contacts.key


def _relisted(memory: Memory, after: BedState) -> Memory:
    """The memory in the order of the present lists."""
    keys, lists = _keys(after), (after.pairs, after.wall_contacts)

    def renewed(memory: Memory) -> Memory:
        def inherit(carried: Carried) -> Carried:
            before = zip(lists, memory.keys, (carried.pairs, carried.walls), strict=True)
            old = [replace(one, key=key, history=history) for one, key, history in before]
            pairs, walls = (inherited(key, one) for key, one in zip(keys, old, strict=True))
            return replace(carried, pairs=pairs, walls=walls)

        marks = tuple(replace(mark, carried=inherit(mark.carried)) for mark in memory.marks)
        return replace(memory, carried=inherit(memory.carried), keys=keys, marks=marks)

    same = [jnp.all(a == b) for a, b in zip(memory.keys, keys, strict=True)]
    return jax.lax.cond(same[0] & same[1], lambda m: m, renewed, memory)


class Overdamped(AbstractTraced):
    """Forward mode from equilibrium to equilibrium; background (1/s) and contact (-) are the drag.

    Not believed are slopes of a test in which the specimen stands free, and all of a test in which
    one parameter's growth or imbalance (`jdem.sensitivity.base`) is above most_growth or
    most_imbalance: what makes one grow acts on all.  `cost` is that of one tangent over that of
    values, 500 spheres (docs/decisions/2026-11-25-derivatives.md).
    """

    background: Real = quantity(500.0)
    contact: Real = quantity(0.4)
    cost: float = eqx.field(static=True, default=0.5)
    most_growth: float = eqx.field(static=True, default=1.0)
    most_imbalance: float = eqx.field(static=True, default=0.01)

    def laboratory(self, lab: VirtualLab) -> VirtualLab:
        with jax.ensure_compile_time_eval():
            programme, free = lab.tests.programme(), np.flatnonzero(lab.tests.timetable().free)
        reached = np.isfinite(programme.force_target) & (np.asarray(programme.tolerance) > 0)
        turning = tuple(np.flatnonzero(reached).tolist())
        drag = TangentDrag(self.background, self.contact)
        last = int(free[0]) if len(free) else None
        derivative = OverdampedMotion(drag, lab.effects, turning=turning, last=last)
        return replace(lab, derivative=derivative)

    def refusals(self, lab: VirtualLab, found: Traced) -> list[list[str]]:
        sizes = zip(np.asarray(found.growth), np.asarray(found.imbalance), strict=True)
        free = np.logical_or.accumulate(stands_free(lab))  # nothing is followed from there on
        return [
            [self._refusal(float(np.max(grown)), float(np.max(unbalanced)), bool(never))]
            * len(grown)
            for (grown, unbalanced), never in zip(sizes, free, strict=True)
        ]

    def _refusal(self, growth: float, imbalance: float, free: bool) -> str:
        """Why slopes of a test are not believed, from the largest ones; "" if they are."""
        if free:
            return "the specimen stands free: contacts snap, and a derivative does not see when"
        if not (np.isfinite(growth) and np.isfinite(imbalance)):
            return "the derivative is not finite"
        if growth > self.most_growth:
            return f"the derivative of the force grew to {growth:.3g} times the force"
        if imbalance > self.most_imbalance:
            return f"its forces are out of balance by {imbalance:.3g} times the force"
        return ""

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + self.cost * parameters

    def describe(self) -> str:
        return (
            "overdamped: forward mode from one equilibrium of the bed to the next, "
            "at the forces where the machine turned"
        )
