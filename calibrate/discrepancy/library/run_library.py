"""The library of runs: points, the features of their curves, fitted kernels, one reference curve.

A row is one simulated specimen.  What the errors of its machine add to it is kept apart from what
the emulator interpolates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibrate.discrepancy.library.cross_validation import (
    EmulatorErrors,
    Repeats,
    cross_validate,
)
from calibrate.discrepancy.library.design import SHAPE, SHAPE_COLUMNS, Design, RunPoints
from calibrate.discrepancy.library.emulator import (
    MOST_ROWS,
    Basis,
    FeatureEmulator,
    fit_emulator,
)
from calibrate.discrepancy.library.kernel import Column
from calibrate.io.lab import Lab
from calibrate.labtests.diagnosis.base import Curves, Feature, UsualSizes
from calibrate.labtests.diagnosis.curves import TESTS, declare, declare_targets, feature_values
from calibrate.response.machine import DENSITY, MACHINE, TOLD, Machine, overloads, shifts
from calibrate.response.mould import Filling
from calibrate.response.process import Kernel
from calibrate.simulation import Run
from jdem.effects.seating import SeatingGap
from jdem.physics import PHYSICS

ROWS_FOR_MACHINES = 700  # from which the emulator is estimated that says what machines add
SLENDERNESS, STRESS = (SHAPE_COLUMNS[SHAPE.index(name)] for name in ("slenderness", "stress"))
# Usual strain and stress (Pa) of the peak, by which crushing features are declared.
PEAK_STRAIN, PEAK_STRESS = 0.04, 250.0 / (np.pi / 4 * 0.05**2)


@dataclass(frozen=True)
class Cylinder:
    """Specimen, and forces of its depression depth: m, m, N, N."""

    diameter: float
    height: float
    force_low: float
    force_high: float

    @staticmethod
    def of(lab: Lab) -> "Cylinder":
        test, cylinder = lab.pair().compression, lab.specimens()[0].cylinder
        return Cylinder(cylinder.diameter, cylinder.height, test.force_low, test.force_high)

    def shape_over(self, other: "Cylinder") -> np.ndarray:
        """Logarithms (2,) of height over diameter and of the largest stress over another's: the
        settings `design.SHAPE`."""
        slender = self.height / self.diameter / (other.height / other.diameter)
        stress = self.force_high / self.diameter**2 / (other.force_high / other.diameter**2)
        return np.log([slender, stress])

    def shaped(self, shape: np.ndarray) -> "Cylinder":
        """The cylinder of this diameter whose shape over this one is given."""
        slender, stress = np.exp(shape)
        return Cylinder(
            self.diameter, self.height * slender, self.force_low * stress, self.force_high * stress
        )

    def usual_sizes(self) -> UsualSizes:
        """The sizes by which features are declared."""
        area = np.pi / 4 * self.diameter**2
        return UsualSizes(self.force_high, 1e3 * PEAK_STRAIN * self.height, PEAK_STRESS * area)

    def features(self) -> tuple[Feature, ...]:
        """The features of its curves, then the scalar targets."""
        return (*declare(self.usual_sizes()), *declare_targets())


@dataclass(frozen=True, eq=False)
class Rows:
    """Simulations: base coordinates (n, p), strengths in SI (n, k), packing (n,), from 0 on,
    values of all features (n, m)."""

    base: np.ndarray
    strengths: np.ndarray
    packing: np.ndarray
    values: np.ndarray

    @staticmethod
    def of(cylinder: Cylinder, points: RunPoints, runs: Sequence[Run | None]) -> "Rows":
        """The rows of runs (None: not simulated) on specimens shaped as their base coordinates say,
        without failed and incomplete ones."""
        values = features_of(cylinder, points.base[:, SHAPE_COLUMNS], runs)
        good = np.asarray(np.isfinite(values).all(axis=1))
        return Rows(points.base, points.strengths, points.packing, values).some(good)

    def some(self, kept: np.ndarray) -> "Rows":
        """Those of a mask (n,)."""
        return Rows(*(part[kept] for part in vars(self).values()))

    def joined(self, more: "Rows", first: int) -> "Rows":
        """With more behind these, their packings numbered from `first` on."""
        more = replace(more, packing=first + more.packing)
        parts = zip(vars(self).values(), vars(more).values(), strict=True)
        return Rows(*map(np.concatenate, parts))


@dataclass(frozen=True, eq=False)
class OtherLaw:
    """Rows without effects that follow other conventions than a library, and how they differ: along
    axes (e, m) that none of its components holds, with deviations (e,) and kernels, and by a column
    of the kernel for each component, these last.  widening: factors (c + e,) on the variances of
    values that the emulator states under the conventions."""

    rows: Rows
    axes: np.ndarray
    deviation: np.ndarray
    kernels: tuple[Kernel, ...]
    columns: tuple[Column, ...]
    widening: np.ndarray


@dataclass(frozen=True, eq=False)
class RunLibrary:
    """Simulated rows, a reference specimen's curves, the platen's speeds (mm/s) in both tests, and
    repeats, where a soil's number stands for the packing.  Once fitted: kernels, the emulator's
    errors, and machine_shift (n, m): what the errors of the machine that are told in closed form
    add to the rows.  Beside the rows lie, by name, those of other conventions; once joined, `law`
    (n,) is 1 for these and 0 for the library's own, and `basis` holds the components of both."""

    design: Design
    cylinder: Cylinder
    physics: int
    rows: Rows
    reference: Curves
    kernels: tuple[Kernel, ...] = ()
    emulator_errors: EmulatorErrors | None = None
    machine_shift: np.ndarray | None = None
    told: tuple[str, ...] = TOLD
    filling: Filling | None = None
    speed: float = 8.0
    crushing_speed: float = 0.01
    repeats: Rows | None = None
    other_laws: Mapping[str, OtherLaw] = field(default_factory=dict)
    law: np.ndarray | None = None
    basis: Basis | None = None

    @property
    def speeds(self) -> dict[str, float]:
        """The platen's speeds (mm/s) by test, as the machine's clock has them."""
        return dict(zip(TESTS, (self.speed, self.crushing_speed), strict=True))

    @property
    def features(self) -> tuple[Feature, ...]:
        """Curve features, then the scalar targets."""
        return self.cylinder.features()

    def scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """Points as the emulator takes them: over their spread, over limits, some of these
        `squared`; with the conventions of rows behind their strengths, where they differ."""
        x, s = self.rows.base / self.design.spread(), self.rows.strengths / limits(self.design)
        s = np.where(self.squared, s * np.abs(s), s)
        return x, s if self.law is None else np.column_stack([s, self.law])

    @property
    def squared(self) -> np.ndarray:
        """The strengths (k,) whose squares the emulator takes, their sign kept: equations tell what
        goes with the strength itself."""
        told = self.told if self.machine_shift is not None else ()
        return np.isin(self.design.effect_names, [name for name in told if name in MACHINE])

    @property
    def always(self) -> tuple[float, ...]:
        """The strengths (`FeatureEmulator.always`) of whoever asks: of joined conventions."""
        return () if self.law is None else (1.0,)

    @property
    def of_soils(self) -> np.ndarray:
        """Values (n, m) less what the machine adds."""
        values, shift = self.rows.values, self.machine_shift
        return values if shift is None else values - shift

    def machine(self, force: float = 1.0) -> Machine:
        """What its errors do to the features; those that no row has are not told.  force: by what a
        lab's forces are larger than the library's."""
        known = tuple(name for name in self.told if name in self.design.effect_names)
        return Machine(
            self.features, self.speed, self.crushing_speed, known, self.filling,
            1e3 * self.cylinder.height, SeatingGap().closing_force / force,
        )  # fmt: skip

    @property
    def _of_machine(self) -> np.ndarray:
        """The columns (e,) of strengths that are told in closed form."""
        return np.array([self.design.effect_names.index(n) for n in self.machine().told], int)

    def emulator(self, most_rows: int = MOST_ROWS, again: bool = False) -> FeatureEmulator:
        """That of all features as a machine without errors reads them (`fit_emulator`)."""
        points, kernels = self.scaled(), self.kernels or None
        return fit_emulator(
            *points, self.rows.packing, self.of_soils, self.scale(), kernels, self.basis,
            most_rows=most_rows, always=self.always, again=again,
        )  # fmt: skip

    def grown(self, design: Design, runs: Sequence[Run | None]) -> "RunLibrary":
        """The library with the runs of a larger design's further packings; not fitted."""
        as_large = replace(design, shaped=self.design.shaped, refined=self.design.refined)
        return self._with(as_large, design.rows(self.design.packings), runs)

    def with_shapes(self, design: Design, runs: Sequence[Run | None]) -> "RunLibrary":
        """The library with the runs of a design's rows of other shapes; not fitted."""
        as_shaped = replace(design, refined=self.design.refined)
        return self._with(as_shaped, design.shaped_rows(), runs)

    def refined(self, design: Design, runs: Sequence[Run | None]) -> "RunLibrary":
        """The library with the runs of more effects that are sampled again; not fitted."""
        return self._with(design, design.refined_rows(self.design.refined), runs)

    def _with(self, design: Design, points: RunPoints, runs: Sequence[Run | None]) -> "RunLibrary":
        rows = Rows.of(self.cylinder, points, runs)
        return replace(self.joined(rows, 0), design=design, kernels=(), emulator_errors=None)

    def joined(self, rows: "Rows", first: int | None = None) -> "RunLibrary":
        """The library with further runs behind its own, their packings numbered from `first` (after
        its own) on; kernels stay, what the machine adds has to be estimated again."""
        first = int(self.rows.packing.max()) + 1 if first is None else first
        law = None if self.law is None else np.append(self.law, np.ones(len(rows.base)))
        return replace(self, rows=self.rows.joined(rows, first), law=law, machine_shift=None)

    def machine_shifts(self, emulator: FeatureEmulator) -> np.ndarray:
        """What the machine adds to the rows (n, m), by an emulator of features without that."""
        (x, s), of_machine = self.scaled(), self._of_machine
        strengths = self.rows.strengths[:, of_machine]
        s = s.copy()
        s[:, of_machine] = 0.0
        on = np.flatnonzero(strengths.any(axis=1))
        added = np.zeros_like(self.rows.values)
        if len(on):
            s, shape = s[on, : self.rows.strengths.shape[1]], self.rows.base[on][:, SHAPE_COLUMNS]
            over = overloads(self.machine(), strengths[on], shape)
            pressed, each = x[on].copy(), self.design.spread()[STRESS]
            pressed[:, STRESS] += over / each
            asked = emulator.along(x[on], s, STRESS)[0]
            known, by_stress = emulator.along(pressed, s, STRESS)
            given = known, strengths[on], shape, by_stress / each
            added[on] = known + shifts(self.machine(), *given) - asked
        return added

    def _with_good_machines(self) -> "RunLibrary":
        """The rows whose machine has no errors that are told in closed form."""
        on = np.asarray(~self.rows.strengths[:, self._of_machine].any(axis=1))
        return replace(self, rows=self.rows.some(on), machine_shift=None, kernels=())

    def scale(self) -> np.ndarray:
        """By what the emulator warps features, shape (m,)."""
        return np.array([_scale(feature) for feature in self.features])

    def fitted(self) -> "RunLibrary":
        """The library with its kernels and their errors by cross-validation; takes minutes."""
        library = self._with_machine_shift()
        emulator = library.emulator()
        kernels = tuple(c.kernel for c in emulator.components)
        rows = library.rows.packing, library.of_soils
        errors = cross_validate(emulator, *rows, library._soils_repeated())
        return replace(library, kernels=kernels, emulator_errors=errors)

    def _with_machine_shift(self) -> "RunLibrary":
        """The rows with what their machines add: first by an emulator of those with good machines,
        then by one of all."""
        plain = replace(self, machine_shift=None, kernels=(), told=TOLD, filling=None)
        if not self.rows.strengths[:, plain._of_machine].any():
            return plain
        emulator = plain._with_good_machines().emulator(ROWS_FOR_MACHINES)
        plain = replace(plain, filling=plain._filling(emulator))
        kernels = tuple(c.kernel for c in emulator.components)
        shifted = replace(plain, machine_shift=plain.machine_shifts(emulator), kernels=kernels)
        shift = plain.machine_shifts(shifted.emulator())
        return replace(plain, machine_shift=shift)

    def _filling(self, emulator: FeatureEmulator) -> Filling | None:
        """What fuller moulds do, by the rows with nothing else at work."""
        if DENSITY not in self.design.effect_names:
            return None
        growth = self.rows.strengths[:, self.design.effect_names.index(DENSITY)]
        on = (growth > 0) & ((self.rows.strengths != 0).sum(axis=1) == 1)
        slender, none = np.exp(self.rows.base[on, SLENDERNESS]), np.zeros(len(self.design.limits))
        x = self.scaled()[0][on]
        before = emulator.along(x, np.tile(none, (len(x), 1)), STRESS)[0]
        known = self.rows.values[on], growth[on], 1e3 * self.cylinder.height * slender
        return Filling.of(self.features, before, *known)

    def _soils_repeated(self) -> Repeats | None:
        """Soils with two specimens or more that have all features; None where there are none."""
        if self.repeats is None:
            return None
        soils, count = np.unique(self.repeats.packing, return_counts=True)
        each = [self.repeats.packing == soil for soil in soils[count > 1]]
        scaled = self.repeats.base / self.design.spread()
        found = Repeats(
            np.array([scaled[of_soil][0] for of_soil in each]),
            [self.repeats.values[of_soil] for of_soil in each],
        )
        return found if each else None


SCALES = {"largest force": 100.0, "peak displacement": 1.0}  # by kind, else by unit
SCALE_OF_UNIT = {"mm": 0.2, "N": 20.0}


def _scale(feature: Feature) -> float:
    """Size of a feature below which differences count, and above which ratios do."""
    return SCALES.get(feature.kind, SCALE_OF_UNIT[feature.unit])


def limits(design: Design) -> np.ndarray:
    """Largest strength of each effect, SI, shape (k,)."""
    return np.array([max(abs(low), abs(high)) for low, high in design.limits.values()])


def curves_of(run: Run) -> Curves:
    """A run's curves as features read them."""
    return {test: tuple(curve.T) for test, curve in run.curves.items()}


def features_of(cylinder: Cylinder, shapes: np.ndarray, runs: Sequence[Run | None]) -> np.ndarray:
    """Values (n, m) of the features of runs on specimens of shapes (n, 2) over a cylinder; NaN for
    what is missing."""
    values = np.full((len(runs), len(cylinder.features())), np.nan)
    for row, (shape, run) in enumerate(zip(shapes, runs, strict=True)):
        if run is not None and not run.failure:
            features = cylinder.shaped(shape).features()
            values[row] = feature_values(features, curves_of(run), run.observables)
    return values


def collect(design: Design, lab: Lab, runs: Sequence[Run | None], reference: Run) -> RunLibrary:
    """The library of a design's runs (None: not simulated), without failed and incomplete ones and
    without repeats."""
    cylinder = Cylinder.of(lab)
    return RunLibrary(
        design, cylinder, PHYSICS, Rows.of(cylinder, design.rows(), runs), curves_of(reference),
        speed=1e3 * lab.pair().compression.rate, crushing_speed=1e3 * lab.pair().crushing.rate,
    )  # fmt: skip
