"""Both laboratory tests in sequence on one specimen, and what comes out of them.

The unconfined test inherits the specimen that the confined test left.  All machine
movements form one programme for the one loop, so the pair is compiled once.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.bed import Numerics, build_bed, sample_capacity, steps_per_sample
from jdem.dynamics import Bed
from jdem.experiments.base import AbstractApparatus
from jdem.experiments.confined import ConfinedCompression
from jdem.experiments.unconfined import UnconfinedCompression
from jdem.neighbors import Grid
from jdem.observables import Curve, crushing_force, depression_depth, displacement_at, running_mean
from jdem.packing import Packing, Specimen
from jdem.quantity import cast
from jdem.simulate import Record, Sample, run, stack, start
from jdem.soil import SoilParameters


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


class Outcome(eqx.Module):
    """Results of one specimen: observables in SI units, curves, and the full record."""

    depression_depth: Array  #: m
    crushing_force: Array  #: N
    confined: Curve
    unconfined: Curve
    record: Record
    failed: Array  #: True where a list overflowed, a number is not finite or 400 N was not reached


class VirtualLab(eqx.Module):
    """Tests, numerics and all array sizes: what is fixed while soils and packings vary.

    Build it with `VirtualLab.of`; one compilation of `run` then serves every packing of
    the specimen and every soil.
    """

    tests: LabTests
    numerics: Numerics
    grid: Grid = eqx.field(static=True)
    capacity: int = eqx.field(static=True)

    @staticmethod
    def of(specimen: Specimen, tests: LabTests, numerics: Numerics) -> "VirtualLab":
        grid = specimen.grid(numerics)
        capacity = sample_capacity(tests.programme(), numerics)
        return VirtualLab(tests, numerics, grid, capacity)

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
        return VirtualLab.of(specimen, tests, numerics)

    def time_step(self, packing: Packing, soil: SoilParameters) -> Array:
        """Stable time step, s."""
        return jnp.asarray(self._bed(packing, soil, None).time_step)

    def run(
        self, packing: Packing, soil: SoilParameters, time_step: Array | None = None
    ) -> "Outcome":
        """Runs both tests on a packing; to be jitted and differentiated through `soil`.

        With `time_step` (s) given, no step is derived from the soil's stiffness.
        """
        dtype = self.numerics.dtype
        bed = self._bed(packing, soil, time_step)
        position = cast(packing.position, jnp.dtype(dtype))
        state = start(bed, position, packing.height, packing.mould_radius)
        programme = cast(self.tests.programme(), jnp.dtype(dtype))
        steps = steps_per_sample(bed, self.numerics)
        record = run(bed, state, programme, steps, self.capacity)
        return outcome(self.tests, bed, record)

    def _bed(self, packing: Packing, soil: SoilParameters, time_step) -> Bed:
        return build_bed(packing.spheres, soil, self.grid, self.numerics, time_step)


def outcome(tests: LabTests, bed: Bed, record: Record) -> Outcome:
    """Observables and curves of a finished record."""
    samples = record.samples
    loading = _curve(samples, tests.names.index("loading"), bed)
    crushing = _curve(samples, tests.names.index("crushing"), bed)
    depth = depression_depth(loading, tests.confined.force_low, tests.confined.force_high)
    force = crushing_force(running_mean(crushing, tests.peak_rows), tests.peak_width)
    highest = jnp.max(loading.force * loading.valid)
    short = highest < tests.confined.force_high
    bad = ~(jnp.isfinite(depth) & jnp.isfinite(force))
    return Outcome(
        depression_depth=depth,
        crushing_force=force,
        confined=_whole(tests, samples, loading),
        unconfined=crushing,
        record=record,
        failed=record.overflow_of(bed.grid) | ~record.finished | short | bad,
    )


def _curve(samples: Sample, segment: int, bed: Bed) -> Curve:
    """One segment's curve; displacement counts from the segment's first platen height."""
    valid = (samples.segment == segment).astype(samples.time.dtype)
    first = samples.platen_height[jnp.argmax(valid)]
    return Curve((first - samples.platen_height) * valid, samples.platen_force * valid, valid)


def _whole(tests: LabTests, samples: Sample, loading: Curve) -> Curve:
    """Loading, holding and unloading; displacement counts from the seating force."""
    last = tests.names.index("unloading")
    valid = ((samples.segment >= 0) & (samples.segment <= last)).astype(samples.time.dtype)
    zero = displacement_at(loading, tests.seating_force)
    travel = samples.platen_height[0] - samples.platen_height - zero
    return Curve(travel * valid, samples.platen_force * valid, valid)
