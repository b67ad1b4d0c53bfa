"""Both laboratory tests in sequence on one specimen, and what comes out of them.

The unconfined test inherits the specimen that the confined test left.  All machine
movements form one programme for the one loop, so the pair is compiled once.
"""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.core.quantity import cast
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import Altered, Readings, Timetable, recorded
from jdem.engine.bed import Numerics, build_bed, sample_capacity, steps_per_sample
from jdem.engine.loop import AbstractFrozen, Record, Sample, Segment, run, stack, start
from jdem.engine.neighbors import Grid
from jdem.engine.schedule import AbstractSurroundings, Unchanging
from jdem.engine.step import Bed
from jdem.materials.soil import SoilParameters
from jdem.observables import Curve, crushing_force, depression_depth, displacement_at, running_mean
from jdem.packing.settling import Packing, Specimen


class LabTests(eqx.Module):
    """Confined, then unconfined compression.

    seating_force (N) sets the zero of displacement; the crushing force is the maximum,
    smoothed over peak_width (N), of the force averaged over peak_rows samples.
    """

    confined: ConfinedCompression = eqx.field(default_factory=ConfinedCompression)
    unconfined: UnconfinedCompression = eqx.field(default_factory=UnconfinedCompression)
    seating_force: float = eqx.field(static=True, default=2.0)
    peak_width: float = eqx.field(static=True, default=2.0)
    peak_rows: int = eqx.field(static=True, default=5)

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        return (self.confined, self.unconfined)

    @property
    def names(self) -> tuple[str, ...]:
        """Segment names in the order of their numbers."""
        return tuple(name for test in self.apparatus for name in test.names)

    def programme(self):
        return stack([segment for test in self.apparatus for segment in test.segments()])

    def timetable(self) -> Timetable:
        """What the segments are to effects and to nominal time."""
        scales = [jnp.asarray(s, float) for test in self.apparatus for s in test.time_scales]
        speed = jnp.asarray(self.programme().platen_speed, float)
        unconfined = [name in self.unconfined.names for name in self.names]
        resting = [name == "resting" for name in self.names]
        loading = [name not in ("opening", "resting") for name in self.names]
        flags = [jnp.asarray(flag, float) for flag in (loading, unconfined, resting)]
        return Timetable(jnp.stack(scales), speed, *flags)


class Outcome(eqx.Module):
    """Results of one specimen: observables in SI units, curves, and the full record.

    Curves and observables are what the laboratory would have recorded, instruments' errors
    included; the record has the truth.
    """

    depression_depth: Array  #: m
    crushing_force: Array  #: N
    confined: Curve
    unconfined: Curve
    record: Record
    nominal_time: Array  #: s, (samples,); since the load cell was tared, as in the laboratory
    failed: Array  #: True where a list overflowed, a number is not finite or 400 N was not reached


class VirtualLab(eqx.Module):
    """Tests, numerics and all array sizes: what is fixed while soils and packings vary.

    Build it with `VirtualLab.of`; one compilation of `run` then serves every packing of
    the specimen, every soil, and every strength of its effects.
    """

    tests: LabTests
    numerics: Numerics
    grid: Grid = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    effects: tuple[AbstractEffect, ...] = ()
    frozen: AbstractFrozen | None = None

    @staticmethod
    def of(
        specimen: Specimen,
        tests: LabTests,
        numerics: Numerics,
        effects: Sequence[AbstractEffect] = (),
    ) -> "VirtualLab":
        reach = max((e.reach(2 * specimen.max_radius()) for e in effects), default=0.0)
        grid = specimen.grid(numerics, reach=reach)
        capacity = sample_capacity(tests.programme(), numerics)
        return VirtualLab(tests, numerics, grid, capacity, tuple(effects))

    def roomier(self, specimen: Specimen) -> "VirtualLab":
        """The same laboratory with larger lists, rebuilt and sampled three times as often."""
        numerics = replace(
            self.numerics,
            sample_time=self.numerics.sample_time / 3,
            pairs_per_sphere=1.5 * self.numerics.pairs_per_sphere,
            wall_layer=1.5 * self.numerics.wall_layer,
            per_cell=self.numerics.per_cell + 4,
        )
        tests = replace(self.tests, peak_rows=3 * self.tests.peak_rows)
        larger = VirtualLab.of(specimen, tests, numerics, self.effects)
        return replace(larger, frozen=self.frozen)

    def time_step(self, packing: Packing, soil: SoilParameters) -> Array:
        """Stable time step, s."""
        return jnp.asarray(self._bed(self._filled(packing), soil, None).time_step)

    def run(
        self, packing: Packing, soil: SoilParameters, time_step: Array | None = None
    ) -> "Outcome":
        """Runs both tests on a packing; to be jitted and differentiated through `soil`.

        With `time_step` (s) given, no step is derived from the soil's stiffness.
        """
        dtype = jnp.dtype(self.numerics.dtype)
        packing = self._filled(packing)
        bed = self._bed(packing, soil, time_step)
        steps = steps_per_sample(bed, self.numerics)
        around = self._surroundings(packing, soil)
        bed = around.bed(bed, jnp.asarray(0), around.begin(dtype))
        position = cast(packing.position, dtype)
        state = start(bed, position, packing.height, packing.mould_radius)
        programme = cast(self._programme(), dtype)
        record = run(bed, state, programme, steps, self.capacity, around, self.frozen)
        return outcome(self.tests, bed, record, cast(self.effects, dtype))

    def _filled(self, packing: Packing) -> Packing:
        """The specimen that the effects put into the machine."""
        for effect in self.effects:
            packing = effect.packing(packing)
        return packing

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
            reference_rate=self.tests.confined.nominal_rate / packing.height,
        )

    def _bed(self, packing: Packing, soil: SoilParameters, time_step) -> Bed:
        return build_bed(packing.spheres, soil, self.grid, self.numerics, time_step)


def outcome(
    tests: LabTests, bed: Bed, record: Record, effects: Sequence[AbstractEffect] = ()
) -> Outcome:
    """Observables and curves of a finished record, as the instruments show them."""
    samples = record.samples
    time = nominal_time(tests, samples)
    readings = Readings(-samples.platen_height, samples.reading)
    readings = recorded(effects, readings, samples.platen_force, time)
    loading = _curve(readings, samples.segment == tests.names.index("loading"))
    crushing = _curve(readings, samples.segment == tests.names.index("crushing"))
    thresholds = (tests.confined.force_low, tests.confined.force_high)
    depth = depression_depth(loading, *cast(thresholds, readings.force.dtype))
    force = crushing_force(running_mean(crushing, tests.peak_rows), tests.peak_width)
    highest = jnp.max(loading.force * loading.valid)
    short = highest < tests.confined.force_high
    bad = ~(jnp.isfinite(depth) & jnp.isfinite(force))
    return Outcome(
        depression_depth=depth,
        crushing_force=force,
        confined=_whole(tests, readings, samples.segment, loading),
        unconfined=crushing,
        record=record,
        nominal_time=time,
        failed=record.overflow_of(bed.grid) | ~record.finished | short | bad,
    )


def nominal_time(tests: LabTests, samples: Sample) -> Array:
    """Laboratory's time (s) at each sample since the load cell was tared for its test."""
    timetable, segment = tests.timetable(), jnp.maximum(samples.segment, 0)
    interval = jnp.diff(samples.time, prepend=0.0) * timetable.time_scale[segment]
    passed = jnp.where(samples.segment >= 0, interval * timetable.loading[segment], 0.0)
    unconfined = timetable.unconfined[segment]
    totals = [jnp.cumsum(passed * (unconfined == test)) for test in (0, 1)]
    return jnp.where(unconfined == 1, totals[1], totals[0]).astype(samples.time.dtype)


def _curve(readings: Readings, chosen: Array) -> Curve:
    """The chosen samples' curve; displacement counts from the first of them."""
    valid = chosen.astype(readings.force.dtype)
    first = readings.travel[jnp.argmax(valid)]
    return Curve((readings.travel - first) * valid, readings.force * valid, valid)


def _whole(tests: LabTests, readings: Readings, segment: Array, loading: Curve) -> Curve:
    """Loading, holding and unloading; displacement counts from the seating force."""
    last = tests.names.index("unloading")
    valid = ((segment >= 0) & (segment <= last)).astype(readings.force.dtype)
    zero = displacement_at(loading, tests.seating_force)
    travel = readings.travel - readings.travel[0] - zero
    return Curve(travel * valid, readings.force * valid, valid)
