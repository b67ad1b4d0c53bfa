"""The one loop: segments of a machine's programme, sampled into a curve.

A programme is a table of segments (numbers, not code), so one compiled loop serves
every apparatus and any parameter values.  Each sample sees to the contact lists, runs
`steps_per_sample` time steps and stores means over them.  A segment ends after its
duration or once its servo force is reached; the loop ends with the last segment.
"""

import abc
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion, kinetic_energy
from jdem.boundaries.walls import BASE, COUNT, MOULD, PLATEN, Walls
from jdem.core.quantity import Real, quantity
from jdem.engine.energy import Ledger
from jdem.engine.list_update import Upkeep, checked, refreshed
from jdem.engine.neighbors import ContactList, Demand, Grid
from jdem.engine.schedule import AbstractSurroundings, Unchanging
from jdem.engine.step import Bed, BedState, Command, step

KEEP, REMOVE, LOWER = 0, 1, 2
FAR = 10.0  # m; where a wall is put that has been taken away


class Segment(eqx.Module):
    """One movement of the machine; SI units, or a stack of segments along axis 0.

    The platen moves at platen_speed * tanh((force_target - F)/servo_width), downward
    positive, so it arrives at the target smoothly; with an infinite target the speed is
    constant.  The mould opens at mould_speed.  The segment ends after `duration` or when
    |F - force_target| < tolerance.  F is what the load cell reads: it follows the force with
    the time constant `lag`; with a lag the segment also ends when F passes the target.
    `platen` and `mould` say what happens to the walls first: KEEP, REMOVE, or LOWER the
    platen onto the highest sphere.
    """

    platen_speed: Real = quantity(0.0)
    force_target: Real = quantity(jnp.inf)
    servo_width: Real = quantity(1.0)
    tolerance: Real = quantity(0.0)
    mould_speed: Real = quantity(0.0)
    damping: Real = quantity(0.0)
    unloaded_damping: Real = quantity(0.0)
    duration: Real = quantity(0.0)
    lag: Real = quantity(0.0)
    platen: Array = eqx.field(default=KEEP, converter=jnp.asarray)
    mould: Array = eqx.field(default=KEEP, converter=jnp.asarray)


class Sample(eqx.Module):
    """Means over one sampling interval; arrays of shape (samples,) once recorded.

    platen_height in m is the value at the interval's middle; forces in N, `reading` being the
    platen force that the load cell reads; kinetic energy in J and time in s at its end;
    segment is -1 in rows that were not reached.
    """

    segment: Array
    time: Array
    platen_height: Array
    platen_force: Array
    base_force: Array
    mould_force: Array
    mould_drag: Array
    reading: Array
    kinetic_energy: Array


class Record(eqx.Module):
    """Everything that a simulation hands back."""

    samples: Sample
    state: BedState
    demand: Demand
    drift: Array  #: m; most that spheres and walls moved between two rebuilds (`upkeep`)
    finished: Array  #: True if the programme ended within the capacity

    def overflow_of(self, grid: Grid) -> Array:
        """True if a list was too small or something may have crossed its skin unseen."""
        return self.demand.exceeds(grid) | (self.drift > grid.skin)

    def explain_overflow(self, grid: Grid) -> str:
        """Which list or skin was too small, and the capacity that would do."""
        demand = self.demand
        have = [grid.pairs, grid.wall_contacts, grid.per_cell, grid.skin]
        need = [int(demand.pairs), int(demand.wall_contacts), int(demand.per_cell), self.drift]
        names = ["pairs", "wall contacts", "spheres per cell", "motion between rebuilds (m)"]
        rows = zip(names, have, need, strict=True)
        return "; ".join(f"{name}: have {h:.4g}, need {n:.4g}" for name, h, n in rows if n > h)


def start(bed: Bed, position, platen_height, mould_radius) -> BedState:
    """A bed at rest between its walls, without any contact history."""
    dtype = position.x.dtype
    zero = jnp.zeros((), dtype)
    return BedState(
        motion=Motion.at_rest(position),
        walls=Walls(
            jnp.asarray(platen_height, dtype), zero, jnp.asarray(mould_radius, dtype), zero
        ),
        pairs=ContactList.empty(bed.grid.pairs, dtype, bed.particle_law),
        wall_contacts=ContactList.empty(bed.grid.wall_contacts, dtype, bed.wall_law),
        wall_force=jnp.zeros(COUNT, dtype),
        mould_drag=zero,
        energy=Ledger.zeros(dtype),
        time=zero,
        reading=zero,
    )


Stepper = Callable[[Bed, BedState, Command], BedState]


class AbstractFrozen(eqx.Module):
    """How derivatives pass from segment number `first` on; values stay what they are."""

    first: eqx.AbstractVar[int]

    @abc.abstractmethod
    def begun(self, state: BedState) -> BedState:
        """The state as that segment begins."""

    @abc.abstractmethod
    def step(self, bed: Bed, state: BedState, command: Command) -> BedState:
        """The state one time step later."""


class _Progress(eqx.Module):
    state: BedState
    segment: Array
    begun: Array
    sample: Array
    samples: Sample
    upkeep: Upkeep
    memory: Any


def run(
    bed: Bed,
    state: BedState,
    programme: Segment,
    steps_per_sample: Array,
    capacity: int,
    surroundings: AbstractSurroundings | None = None,
    frozen: AbstractFrozen | None = None,
) -> Record:
    """Runs a programme (stack of segments) from `state`; at most `capacity` samples.

    `surroundings` (the base model's if not given) may change the bed as the programme runs.
    Rows of `samples` beyond the end keep segment -1.  Differentiable in forward mode; `frozen`
    changes how, and no value.
    """
    around = Unchanging() if surroundings is None else surroundings
    count = jnp.shape(programme.platen_speed)[0]
    prepared = _prepared(bed, state, _row(programme, 0))
    none = jnp.zeros((), jnp.int32)
    samples = _empty_samples(capacity, state.time.dtype)
    upkeep, memory = Upkeep.begin(prepared), around.begin(state.time.dtype)
    progress = _Progress(prepared, none, state.time, none, samples, upkeep, memory)

    def advanced(step: Stepper, progress: _Progress):
        number, memory, before = progress.segment, progress.memory, progress.state
        segment, present = _row(programme, number), around.bed(bed, number, memory)

        def shown(reading):
            return around.shown(reading, memory)

        state, upkeep, motion = refreshed(bed, before, progress.upkeep)
        state, sample = _sampled(present, state, segment, steps_per_sample, shown, step)
        sample = eqx.tree_at(lambda s: s.segment, sample, number)
        readings = [shown(force) for force in (before.reading, sample.reading, state.reading)]
        elapsed = (sample.time - progress.begun, sample.time - before.time)
        ended = _ended(segment, readings, elapsed)
        upkeep = checked(state, upkeep, motion)
        following = _row(programme, jnp.minimum(number + 1, count - 1))
        changes = (ended > 0) & (number + 1 < count)
        walls = _prepared(bed, state, following).walls
        walls = jax.tree.map(lambda a, b: jnp.where(changes, a, b), walls, state.walls)
        return _Progress(
            eqx.tree_at(lambda s: s.walls, state, walls),
            number + ended,
            jnp.where(ended, state.time, progress.begun),
            progress.sample + 1,
            jax.tree.map(lambda a, b: a.at[progress.sample].set(b), progress.samples, sample),
            upkeep,
            around.later(memory, number, before, state),
        )

    frozen_step = step if frozen is None else frozen.step
    if frozen is not None:
        progress = _until(frozen.first, capacity, partial(advanced, step), progress)
        progress = eqx.tree_at(lambda p: p.state, progress, frozen.begun(progress.state))
    final = _until(count, capacity, partial(advanced, frozen_step), progress)
    upkeep, finished = final.upkeep, final.segment >= count
    return Record(final.samples, final.state, upkeep.demand, upkeep.largest, finished)


def _until(
    last: int, capacity: int, advance: Callable[[_Progress], _Progress], progress: _Progress
) -> _Progress:
    """Sampling intervals one after the other until segment `last` begins, or no room is left."""

    def unfinished(progress: _Progress):
        return (progress.segment < last) & (progress.sample < capacity)

    return jax.lax.while_loop(unfinished, advance, progress)


def stack(segments: list[Segment]) -> Segment:
    """Several segments as one programme."""
    return jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *segments
    )


def _row(programme: Segment, index) -> Segment:
    return jax.tree.map(lambda leaf: leaf[index], programme)


def _empty_samples(capacity: int, dtype) -> Sample:
    blank = jnp.zeros(capacity, dtype)
    unreached = jnp.full(capacity, -1, jnp.int32)
    return Sample(unreached, *[blank] * 8)


def _prepared(bed: Bed, state: BedState, segment: Segment) -> BedState:
    """Walls taken away or lowered as the segment begins."""
    top = jnp.max(state.motion.position.z + bed.spheres.radius)
    walls = state.walls
    height = jnp.where(segment.platen == LOWER, top, walls.platen_height)
    height = jnp.where(segment.platen == REMOVE, FAR, height)
    radius = jnp.where(segment.mould == REMOVE, FAR, walls.mould_radius)
    zero = jnp.zeros_like(height)
    return eqx.tree_at(lambda s: s.walls, state, Walls(height, zero, radius, zero))


def _ended(segment: Segment, readings: list[Array], elapsed: tuple[Array, Array]) -> Array:
    """1 once the force is reached, or after the duration to the nearest interval.

    `readings` (N) are those before, averaged over, and after the interval; `elapsed` (s) is
    the time since the segment began and the length of the interval.
    """
    before, mean, after = (reading - segment.force_target for reading in readings)
    since, interval = elapsed
    reached = jnp.abs(mean) < segment.tolerance
    passed = (segment.lag > 0) & (before * after < 0)  # a late reading does not slow down
    over = since >= segment.duration - 0.5 * interval
    return (reached | passed | over).astype(jnp.int32)


def _sampled(
    bed: Bed,
    state: BedState,
    segment: Segment,
    steps: Array,
    shown: Callable[[Array], Array],
    step: Stepper,
):
    """The state after `steps` time steps, and means over them."""

    def advance(_, carry):
        state, sums = carry
        state = step(bed, state, _command(segment, shown(state.reading)))
        state = _read(state, segment.lag, bed.time_step)
        return state, sums + _probe(state)

    sums = jnp.zeros(6, state.time.dtype)
    state, sums = jax.lax.fori_loop(0, steps, advance, (state, sums))
    means = sums / steps
    sample = Sample(
        segment=jnp.zeros((), jnp.int32),
        time=state.time,
        platen_height=means[0],
        platen_force=means[1],
        base_force=means[2],
        mould_force=means[3],
        mould_drag=means[4],
        reading=means[5],
        kinetic_energy=kinetic_energy(bed.spheres, state.motion),
    )
    return state, sample


def _read(state: BedState, lag: Real, time_step: Real) -> BedState:
    """The load cell's reading R after a time step: lag dR/dt = F - R, implicitly."""
    force = state.wall_force[PLATEN]
    reading = force + (state.reading - force) * (lag / (lag + time_step))
    return eqx.tree_at(lambda s: s.reading, state, reading)


def _command(segment: Segment, force: Array) -> Command:
    """What the machine does where it sees `force` (N)."""
    unlimited = jnp.isinf(segment.force_target)
    target = jnp.where(unlimited, force, segment.force_target)  # or inf x 0 is a slope: NaN
    share = jnp.where(unlimited, 1.0, jnp.tanh((target - force) / segment.servo_width))
    return Command(
        platen_speed=-segment.platen_speed * share,
        mould_speed=segment.mould_speed,
        damping=segment.damping,
        unloaded_damping=segment.unloaded_damping,
    )


def _probe(state: BedState) -> Array:
    force = state.wall_force
    height, drag = state.walls.platen_height, state.mould_drag
    return jnp.stack([height, force[PLATEN], force[BASE], force[MOULD], drag, state.reading])
