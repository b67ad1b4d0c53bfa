"""The one loop: segments of a machine's programme, sampled into a curve.

One compiled loop serves every programme (`jdem.engine.segment`) and any parameter values,
for one set of boundaries.  Each sample runs `steps_per_sample` time steps, in one piece or as
many as the contact lists ask for, and stores means over them.  A segment ends after its
duration or once its servo force is reached; the loop ends with the last segment.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.bodies.spheres import Motion, kinetic_energy
from jdem.boundaries.composite import BASE, LOADS, MOULD, PLATEN, Boundaries, cell, part_count
from jdem.core.fusion import fenced
from jdem.core.kernel import together
from jdem.engine.energy import Ledger
from jdem.engine.list_update import ListUpdate, checked, lasting, refreshed
from jdem.engine.neighbors import ContactList, Demand, Grid, no_faces
from jdem.engine.schedule import AbstractSurroundings, Unchanging
from jdem.engine.segment import Segment, command_of, ended, placed, read, row_of
from jdem.engine.state import Bed, BedState, Command
from jdem.engine.step import step


class Sample(eqx.Module):
    """Means over one sampling interval; axis 0 counts samples once recorded.

    reference (boundaries, 3) in m, the reference points, is the value at the interval's middle;
    loads (boundaries, 7) as in `BedState`; `reading` is what the load cell reads; kinetic energy
    in J, time in s and the number of whole bonds between spheres at its end, the last one None of
    laws without; segment is -1 in rows that were not reached.  Properties are those of the testing
    cell: height in m, forces in N.
    """

    segment: Array
    time: Array
    reference: Array
    loads: Array
    reading: Array
    kinetic_energy: Array
    bonds: Array | None = None

    @property
    def platen_height(self) -> Array:
        return self.reference[..., PLATEN, 2]

    @property
    def platen_force(self) -> Array:
        return self.loads[..., PLATEN, 6]

    @property
    def base_force(self) -> Array:
        return self.loads[..., BASE, 6]

    @property
    def mould_force(self) -> Array:
        """Radial, N."""
        return self.loads[..., MOULD, 6]

    @property
    def mould_drag(self) -> Array:
        """Axial, upward, N."""
        return self.loads[..., MOULD, 2]


def _overflow(grid: Grid, demand: Demand, drift: Array) -> Array:
    return demand.exceeds(grid) | (drift > grid.skin)


class Record(eqx.Module):
    """Everything that a simulation hands back."""

    samples: Sample
    state: BedState
    demand: Demand
    drift: Array  #: m; most that spheres and walls moved between two rebuilds (`list_update`)
    finished: Array  #: True if the programme ended within the capacity

    def overflow_of(self, grid: Grid) -> Array:
        """True if a list was too small or something may have crossed its skin unseen."""
        return _overflow(grid, self.demand, self.drift)

    def explain_overflow(self, grid: Grid) -> str:
        """Which list or skin was too small, and what would have done until the run ended."""
        demand = self.demand
        rows = [
            ("pairs", grid.pairs, int(demand.pairs)),
            ("wall contacts", grid.wall_contacts, int(demand.wall_contacts)),
            ("spheres per cell", grid.per_cell, int(demand.per_cell)),
            ("faces per contact", grid.faces, int(demand.faces)),
            ("motion between rebuilds (m)", grid.skin, self.drift),
        ]
        return "; ".join(f"{name}: have {h:.4g}, need {n:.4g}" for name, h, n in rows if n > h)


def start(bed: Bed, position, platen_height, mould_radius) -> BedState:
    """A bed at rest in the testing cell, without any contact history."""
    return begun(bed, position, cell(platen_height, mould_radius, position.x.dtype))


def begun(bed: Bed, position, boundaries: Boundaries) -> BedState:
    """A bed at rest between any boundaries, without any contact history."""
    dtype, count = position.x.dtype, len(boundaries)
    zero = jnp.zeros((), dtype)
    spheres, parts = bed.spheres.count, part_count(boundaries)
    walls = ContactList.empty(bed.grid.wall_contacts, dtype, bed.wall_law, spheres * parts)
    return BedState(
        motion=Motion.at_rest(position),
        boundaries=boundaries,
        pairs=ContactList.empty(bed.grid.pairs, dtype, bed.particle_law, spheres**2),
        wall_contacts=replace(walls, faces=no_faces(bed.grid, boundaries)),
        loads=jnp.zeros((count, LOADS), dtype),
        energy=Ledger.zeros(count, dtype),
        time=zero,
        reading=zero,
    )


class Interval(eqx.Module):
    """One sampling interval that has passed: the bed as it was, the state after, its segment and
    that one's number, what a derivative `watched`, and whether (and with what) another begins."""

    bed: Bed
    after: BedState
    segment: Segment
    number: Array
    watched: Any
    ends: Array
    following: Segment


class AbstractDerivative(eqx.Module):
    """How derivatives pass, from segment number `first` on; values stay what they are.

    They pass through `step`, or from one sampling interval to the next: then `held` keeps them
    out of the steps, and `memory` carries them.
    """

    first: eqx.AbstractVar[int]

    @property
    def window(self) -> float:
        """Width in ln(force), to either side, over which a recorded curve is differentiated."""
        return 0.0

    def programme(self, programme: Segment) -> Segment:
        """The programme, whose rates may have derivatives of their own."""
        return programme

    def begun(self, state: BedState) -> BedState:
        """The state as segment `first` begins."""
        return state

    def seen(self, force: Array) -> Array:
        """The force (N or N m) that the servo acts upon."""
        return force

    def step(self, bed: Bed, state: BedState, command: Command) -> BedState:
        """The state one time step later."""
        return step(bed, state, command)

    def held(self, tree: Any) -> Any:
        """What an interval's steps are computed from."""
        return tree

    def watched(self, state: BedState) -> Any:
        """What is summed up over an interval's steps: a tree of arrays."""
        return ()

    def memory(self, bed: Bed, state: BedState, capacity: int) -> Any:
        """What derivatives are carried in, as segment `first` begins: a tree of arrays."""
        return ()

    def followed(self, memory: Any, interval: Interval, sample: Sample) -> tuple[Any, Sample]:
        """The memory after an interval, and its sample."""
        return memory, sample

    def recorded(self, memory: Any, samples: Sample, state: BedState) -> tuple[Sample, BedState]:
        """All samples and the state, as the programme has ended."""
        return samples, state


class Pathwise(AbstractDerivative):
    """Through every step as it is computed."""

    first: int = eqx.field(static=True, default=0)


class _Progress(eqx.Module):
    state: BedState
    segment: Array
    begun: Array
    sample: Array
    samples: Sample
    update: ListUpdate
    memory: Any
    derivative: Any = ()


def run(
    bed: Bed,
    state: BedState,
    programme: Segment,
    steps_per_sample: Array,
    capacity: int,
    surroundings: AbstractSurroundings | None = None,
    derivative: AbstractDerivative | None = None,
) -> Record:
    """Runs a programme (stack of segments) from `state`; at most `capacity` samples.

    `surroundings` (the base model's if not given) may change the bed as the programme runs.
    Rows of `samples` beyond the end keep segment -1.  Differentiable in forward mode;
    `derivative` changes how (`Pathwise` if not given), and no value.
    """
    around = Unchanging() if surroundings is None else surroundings
    way = Pathwise() if derivative is None else derivative
    programme = way.programme(programme)
    count = jnp.shape(programme.duration)[0]
    prepared = _prepared(bed, state, row_of(programme, 0))
    none = jnp.zeros((), jnp.int32)
    samples = _empty_samples(capacity, bed, state)
    update, memory = ListUpdate.begin(bed, prepared), around.begin(state.time.dtype)
    progress = _Progress(prepared, none, state.time, none, samples, update, memory)

    def advanced(way: AbstractDerivative, progress: _Progress):
        number, memory, before = progress.segment, progress.memory, progress.state
        segment, present = row_of(programme, number), around.bed(bed, number, memory)

        def shown(reading):
            return around.shown(reading, memory)

        beds, before, segment = way.held(((bed, present), before, segment))
        passing = (segment, steps_per_sample, shown, way)
        state, sample, update, watched = _sampled(beds, before, progress.update, *passing)
        sample = eqx.tree_at(lambda s: s.segment, sample, number)
        readings = [shown(force) for force in (before.reading, sample.reading, state.reading)]
        elapsed = (sample.time - progress.begun, sample.time - before.time)
        done = ended(segment, readings, elapsed)
        following = row_of(programme, jnp.minimum(number + 1, count - 1))
        changes = (done > 0) & (number + 1 < count)
        interval = Interval(present, state, segment, number, watched, changes, following)
        derivative, sample = way.followed(progress.derivative, interval, sample)
        changed = _prepared(beds[0], state, following).boundaries
        changed = jax.tree.map(lambda a, b: jnp.where(changes, a, b), changed, state.boundaries)
        return _Progress(
            eqx.tree_at(lambda s: s.boundaries, state, changed),
            number + done,
            jnp.where(done, state.time, progress.begun),
            progress.sample + 1,
            jax.tree.map(lambda a, b: a.at[progress.sample].set(b), progress.samples, sample),
            update,
            around.later(memory, number, before, state),
            derivative,
        )

    if way.first > 0:
        first = partial(advanced, Pathwise())
        progress = _until(way.first, capacity, bed.grid, first, progress)
    state = way.begun(progress.state)
    progress = replace(progress, state=way.held(state), derivative=way.memory(bed, state, capacity))
    final = _until(count, capacity, bed.grid, partial(advanced, way), progress)
    update, finished = final.update, final.segment >= count
    samples, state = way.recorded(final.derivative, final.samples, final.state)
    return Record(samples, state, update.demand, update.largest, finished)


def _until(
    last: int,
    capacity: int,
    grid: Grid,
    advance: Callable[[_Progress], _Progress],
    progress: _Progress,
) -> _Progress:
    """Sampling intervals one after the other until segment `last` begins, no room is left, or a
    list was too small: what follows would have contacts missing."""

    def unfinished(progress: _Progress):
        overflow = _overflow(grid, progress.update.demand, progress.update.largest)
        return (progress.segment < last) & (progress.sample < capacity) & ~overflow

    return jax.lax.while_loop(unfinished, advance, progress)


def _empty_samples(capacity: int, bed: Bed, state: BedState) -> Sample:
    boundaries, dtype = len(state.boundaries), state.time.dtype
    blank = jnp.zeros(capacity, dtype)
    return Sample(
        segment=jnp.full(capacity, -1, jnp.int32),
        time=blank,
        reference=jnp.zeros((capacity, boundaries, 3), dtype),
        loads=jnp.zeros((capacity, boundaries, LOADS), dtype),
        reading=blank,
        kinetic_energy=blank,
        bonds=blank if bed.particle_law.bonds else None,
    )


def _prepared(bed: Bed, state: BedState, segment: Segment) -> BedState:
    """The state with boundaries placed as the segment begins."""
    position, radius = bed.spheres.positions(state.motion), bed.spheres.radius
    boundaries = placed(state.boundaries, segment, position, radius)
    return eqx.tree_at(lambda s: s.boundaries, state, boundaries)


def _sampled(
    beds: tuple[Bed, Bed],
    state: BedState,
    update: ListUpdate,
    segment: Segment,
    steps: Array,
    shown: Callable[[Array], Array],
    way: AbstractDerivative,
):
    """The state after `steps` time steps, means over them, the lists' update, and what `way`
    watched.

    `beds` are the one that lists are kept for and the one that it is at present.
    """
    listed, bed = beds

    def advance(_, carry):
        state, sums, watched = carry
        with fenced():
            seen = way.seen(shown(state.reading))
            command = together(command_of, segment, seen, state.boundaries, bed.time_step)
            state = read(way.step(bed, state, command), segment, bed.time_step)
            sums = sums + together(_probe, state.boundaries, state.loads, state.reading)
            return state, sums, jax.tree.map(jnp.add, watched, way.watched(state))

    def piece(carry):
        (state, *sums), update, done = carry
        state, update, motion = refreshed(listed, state, update)
        count = lasting(listed, state, motion, steps - done)
        state, *sums = jax.lax.fori_loop(0, count, advance, (state, *sums))
        return (state, *sums), checked(listed, state, update, motion), done + count

    sums = jnp.zeros_like(_probe(state.boundaries, state.loads, state.reading))
    watched = jax.tree.map(jnp.zeros_like, way.watched(state))
    begun = ((state, sums, watched), update, jnp.zeros_like(steps))
    (state, sums, watched), update, _ = jax.lax.while_loop(lambda c: c[2] < steps, piece, begun)
    with fenced():
        means, count = together(jnp.divide, sums, steps), len(state.boundaries)
    places, loads, reading = jnp.split(means, [3 * count, (3 + LOADS) * count])
    sample = Sample(
        segment=jnp.zeros((), jnp.int32),
        time=state.time,
        reference=places.reshape(count, 3),
        loads=loads.reshape(count, LOADS),
        reading=reading[0],
        kinetic_energy=kinetic_energy(bed.spheres, state.motion),
        bonds=_bonds(bed, state) if bed.particle_law.bonds else None,
    )
    return state, sample, update, watched


def _bonds(bed: Bed, state: BedState) -> Array:
    """How many bonds between spheres are whole."""
    return jnp.sum(state.pairs.alive * bed.particle_law.whole_bonds(state.pairs.history))


def _probe(boundaries: Boundaries, loads: Array, reading: Array) -> Array:
    places = jnp.stack([boundary.reference.stack() for boundary in boundaries])
    return jnp.concatenate([places.ravel(), loads.ravel(), reading[None]])
