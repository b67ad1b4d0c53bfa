"""Laboratory tests in sequence on one specimen, and what comes out of them.

Each test inherits the specimen that the one before it left.  All movements of the machine form
one programme for the one loop, so the sequence is compiled once.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import (
    AbstractApparatus,
    Movement,
    Reading,
    Readings,
    Tool,
    around,
    numbered,
)
from jdem.boundaries.composite import CELL_SURFACES, Boundaries, cell
from jdem.core.quantity import cast, check_precision
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import Altered, Timetable, recorded
from jdem.engine.bed import Numerics, build_bed, sample_capacity, steps_per_sample
from jdem.engine.loop import AbstractDerivative, Record, Sample, begun, run
from jdem.engine.neighbors import Grid
from jdem.engine.schedule import AbstractSurroundings, Joining, Unchanging
from jdem.engine.segment import Segment, stack
from jdem.engine.step import Bed
from jdem.materials.soil import SoilParameters
from jdem.observables import Curve
from jdem.packing.specimen import Packing, Specimen


class TestSequence(eqx.Module):
    """Tests one after the other on one specimen; their names differ."""

    __test__ = False  # for pytest

    apparatus: tuple[AbstractApparatus, ...]

    def __check_init__(self):
        names = [test.name for test in self.apparatus]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"tests are called {names}; give at least one, and each its own name")

    def __getitem__(self, name: str) -> AbstractApparatus:
        """The test of this name."""
        return self.apparatus[[test.name for test in self.apparatus].index(name)]

    def movements(self) -> list[Movement]:
        """All movements in the order of their numbers; segments have the tools of all tests."""
        made = []
        for number, test in enumerate(self.apparatus):
            others = self.around(number)
            for each in test.movements():
                made.append(replace(each, segment=numbered(each.segment, *others)))
        return made

    @property
    def tools(self) -> tuple[Tool, ...]:
        """Those of all tests, in the order of their numbers behind the cell's boundaries."""
        return tuple(tool for test in self.apparatus for tool in test.tools)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """Whose friction the cell's boundaries and the tools have."""
        return (*CELL_SURFACES, *(tool.surface for tool in self.tools))

    def around(self, number: int) -> tuple[int, int]:
        """How many tools stand ahead of test `number`'s own and behind them."""
        return around([len(test.tools) for test in self.apparatus], number)

    @property
    def names(self) -> tuple[str, ...]:
        """What the movements are called."""
        return tuple(movement.name for movement in self.movements())

    def programme(self) -> Segment:
        return stack([movement.segment for movement in self.movements()])

    def first_movement(self, number: int) -> int:
        """Number of the first movement of test `number`."""
        return sum(len(test.movements()) for test in self.apparatus[:number])

    @property
    def joining(self) -> int:
        """Number of the movement as which bonds form, of a soil that has some: the first without
        the mould, or the first of the last test where tests keep it or bring tools.  What comes
        before prepares the specimen."""
        last = self.first_movement(len(self.apparatus) - 1)
        free = [number for number, each in enumerate(self.movements()) if each.free]
        return last if self.apparatus[-1].tools or not free else free[0]

    def timetable(self) -> Timetable:
        """What the movements are to effects and to nominal time."""
        movements = self.movements()
        tests = [k for k, test in enumerate(self.apparatus) for _ in test.movements()]
        return Timetable(
            time_scale=jnp.stack([jnp.asarray(m.time_scale, float) for m in movements]),
            platen_speed=jnp.asarray(self.programme().platen_speed, float),
            testing=jnp.asarray([m.testing for m in movements], float),
            free=jnp.asarray([m.free for m in movements], float),
            resting=jnp.asarray([m.resting for m in movements], float),
            test=jnp.asarray(tests, jnp.int32),
        )

    def at_rate(self, factor: float) -> "TestSequence":
        """The same tests simulated `factor` times as fast."""
        return TestSequence(tuple(test.at_rate(factor) for test in self.apparatus))

    def sampled(self, ratio: float) -> "TestSequence":
        """The same tests where samples are `ratio` times as dense."""
        return TestSequence(tuple(test.sampled(ratio) for test in self.apparatus))


INTACT_BONDS = "intact_bonds"  # the channel that each test has of a soil with bonds: their number


class Outcome(eqx.Module):
    """Results of one specimen: observables in SI units, curves, and further channels at their rows
    by name, all by test, and the full record.

    Curves and observables are what the laboratory would have recorded, instruments' errors
    included; the record has the truth.
    """

    observables: dict[str, dict[str, Array]]
    curves: dict[str, Curve]
    channels: dict[str, dict[str, Array]]
    record: Record
    nominal_time: Array  #: s, (samples,); since the load cell was tared, as in the laboratory
    failed: Array  #: True where a list overflowed, a number is not finite, or a test fell short


class VirtualLab(eqx.Module):
    """Tests, numerics and all array sizes: what is fixed while soils and packings vary.

    Build it with `VirtualLab.of`; one compilation of `run` then serves every packing of
    the specimen, every soil, and every strength of its effects.
    """

    tests: TestSequence
    numerics: Numerics
    grid: Grid = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    effects: tuple[AbstractEffect, ...] = ()
    derivative: AbstractDerivative | None = None

    @staticmethod
    def of(
        specimen: Specimen,
        tests: TestSequence,
        numerics: Numerics,
        effects: Sequence[AbstractEffect] = (),
        reach: float = 0.0,
    ) -> "VirtualLab":
        """A laboratory for a specimen; `reach` (m) is the gap across which the contact law acts
        (`jdem.engine.bed.reach_of`)."""
        reach = max([reach, *(e.reach(2 * specimen.max_radius()) for e in effects)])
        touched = sum(tool.area for tool in tests.tools)
        spreads = max(test.spreads for test in tests.apparatus)
        grid = specimen.grid(numerics, reach=reach, touched=touched, spreads=spreads)
        capacity = sample_capacity(tests.programme(), numerics)
        return VirtualLab(tests, numerics, grid, capacity, tuple(effects))

    def roomier(self, specimen: Specimen) -> "VirtualLab":
        """The same laboratory with larger lists, rebuilt and sampled three times as often."""
        numerics = replace(
            self.numerics,
            sample_time=self.numerics.sample_time / 3,
            pairs_per_sphere=1.5 * self.grid.pairs / specimen.count,
            wall_layer=1.5 * self.numerics.wall_layer,
            per_cell=self.numerics.per_cell + 4,
        )
        tests, reach = self.tests.sampled(3), self.grid.reach
        larger = VirtualLab.of(specimen, tests, numerics, self.effects, reach)
        return replace(larger, derivative=self.derivative)

    def time_step(self, packing: Packing, soil: SoilParameters) -> Array:
        """Stable time step, s."""
        return jnp.asarray(self._bed(self._filled(packing), soil, None).time_step)

    def run(
        self, packing: Packing, soil: SoilParameters, time_step: Array | None = None
    ) -> "Outcome":
        """Runs all tests on a packing; to be jitted and differentiated through `soil`.

        With `time_step` (s) given, no step is derived from the soil's stiffness.
        """
        dtype = jnp.dtype(self.numerics.dtype)
        packing = self._filled(packing)
        bed = self._bed(packing, soil, time_step)
        steps = steps_per_sample(bed, self.numerics)
        around = self._surroundings(packing, soil)
        bed = around.bed(bed, jnp.asarray(0), around.begin(dtype))
        around = Joining(around, self.tests.joining) if bed.particle_law.bonds else around
        position = cast(packing.position, dtype)
        state = begun(bed, position, self.boundaries(packing, position.x.dtype))
        programme = cast(self._programme(), dtype)
        record = run(bed, state, programme, steps, self.capacity, around, self.derivative)
        window = 0.0 if self.derivative is None else self.derivative.window
        return outcome(self.tests, bed, record, cast(self.effects, dtype), window)

    def _filled(self, packing: Packing) -> Packing:
        """The specimen that the effects put into the machine."""
        for effect in self.effects:
            packing = effect.packing(packing)
        return packing

    def boundaries(self, packing: Packing, dtype) -> Boundaries:
        """The testing cell around the packing, and all tools, which are away."""
        tools = cast([tool.boundary for tool in self.tests.tools], dtype)
        around = cell(packing.height, packing.mould_radius, dtype)
        return (*around, *(boundary.removed() for boundary in tools))

    def _programme(self) -> Segment:
        programme, time_scale = self.tests.programme(), self.tests.timetable().time_scale
        for effect in self.effects:
            programme = effect.programme(programme, time_scale)
        return programme

    def _surroundings(self, packing: Packing, soil: SoilParameters) -> AbstractSurroundings:
        if not self.effects:
            return Unchanging()
        return Altered(
            effects=self.effects,
            soil=soil,
            smoothing=self.numerics.smoothing,
            timetable=self.tests.timetable(),
            mean_diameter=packing.mean_diameter(),
            reference_rate=self.tests.apparatus[0].nominal_rate / packing.height,
        )

    def _bed(self, packing: Packing, soil: SoilParameters, time_step) -> Bed:
        around = self._surroundings(packing, soil)
        if time_step is None and isinstance(around, Altered):
            time_step = around.time_step(packing.spheres, self.numerics.safety)
        surfaces = self.tests.surfaces
        return build_bed(packing.spheres, soil, self.grid, self.numerics, time_step, surfaces)


_run = eqx.filter_jit(VirtualLab.run)


def simulate(lab: VirtualLab, packing: Packing, soil: SoilParameters | None = None) -> Outcome:
    """Runs all tests of a virtual laboratory on one packing.

    The first call compiles; further packings of the specimen and other soils do not.  Inside a
    function that is itself jitted or differentiated, call `lab.run`.

    Args:
        lab: tests, numerics, effects: `VirtualLab.of(specimen, tests, numerics)`.
        packing: what `prepare` made.
        soil: parameters of the soil, SI; None: the defaults.

    Returns:
        Observables by test (SI), curves by test (m, N), the full record, and whether it failed.

    Raises:
        ValueError: the numerics ask for double precision, and JAX is not switched to it.

    Example:
        >>> found = jdem.simulate(lab, packing, jdem.SoilParameters(surface_energy=12.0))
        >>> found.observables["unconfined"]["crushing_force"]
    """
    check_precision(lab.numerics.dtype)
    return _run(lab, packing, SoilParameters() if soil is None else soil)


def outcome(
    tests: TestSequence,
    bed: Bed,
    record: Record,
    effects: Sequence[AbstractEffect] = (),
    window: float = 0.0,
) -> Outcome:
    """Observables and curves of a finished record, as the instruments show them; `window` as in
    `jdem.observables.Curve`."""
    time = nominal_time(tests, record.samples)
    found = {
        test.name: _read(tests, number, record.samples, effects, time, window)
        for number, test in enumerate(tests.apparatus)
    }
    last = tests.apparatus[-1]
    observables = {name: reading.observables for name, reading in found.items()}
    observables[last.name] |= last.at_end(bed, record.state)
    finite = [jnp.isfinite(value) for value in jax.tree.leaves(observables)]
    complete = [reading.complete for reading in found.values()]
    sound = jnp.all(jnp.stack([*finite, *complete]))
    return Outcome(
        observables=observables,
        curves={name: reading.curve for name, reading in found.items()},
        channels={name: reading.channels for name, reading in found.items()},
        record=record,
        nominal_time=time,
        failed=record.overflow_of(bed.grid) | ~record.finished | ~sound,
    )


def _read(
    tests: TestSequence,
    number: int,
    samples: Sample,
    effects: Sequence[AbstractEffect],
    time: Array,
    window: float,
) -> Reading:
    """What test `number` gives, as the instruments show it."""
    test, ahead = tests.apparatus[number], tests.around(number)[0]
    felt = samples.platen_force if test.force is None else test.force.read(samples, ahead)
    shown = samples.reading if test.force is None else felt
    further = {channel.name: channel.read(samples, ahead) for channel in test.channels}
    travel = test.travel.read(samples, ahead)
    readings = Readings(travel, shown, window, further, samples.time)
    readings = recorded(effects, readings, felt, time)
    found = test.read(readings, samples.segment - tests.first_movement(number))
    if samples.bonds is None:
        return found
    bonds = {INTACT_BONDS: samples.bonds * found.curve.valid}
    return replace(found, channels=found.channels | bonds)


def nominal_time(tests: TestSequence, samples: Sample) -> Array:
    """Laboratory's time (s) at each sample since the load cell was tared for its test."""
    timetable, segment = tests.timetable(), jnp.maximum(samples.segment, 0)
    interval = jnp.diff(samples.time, prepend=0.0) * timetable.time_scale[segment]
    passed = jnp.where(samples.segment >= 0, interval * timetable.testing[segment], 0.0)
    number, time = timetable.test[segment], jnp.zeros_like(passed)
    for test in range(len(tests.apparatus)):
        time = jnp.where(number == test, jnp.cumsum(passed * (number == test)), time)
    return time.astype(samples.time.dtype)
