"""The calibration problem: what was measured, what a run gives for it, and their scatter.

Scalar targets and whole curves are both reduced to features of a specimen: a target is one
feature, a curve is read where its test says (`calibrate.labtests`).  The specimen is the
sample, not the point, so features of one specimen are correlated, and their covariance is that
of packings and repeats:

    Sigma = S_packing (1/n_packings + a/n_repeats)          for curves
    Sigma = S_packing / n_packings + scatter^2 / repeats    for scalar targets

A laboratory's specimens scatter at least as packings do: a >= 1 is how much larger the variance is
that the records of a test show.  Where a platen begins to touch is known to ZERO_KNOWN only, which
all records of a test share:

    Sigma + ZERO_KNOWN^2 s s'        s: slope of features with the zero of their displacement
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calibrate.core.errors import CalibrationError, InputError
from calibrate.io.lab import Lab
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.composite import described
from calibrate.labtests.features import SEATING, AbstractFeature, ScalarTarget, zero_of
from calibrate.labtests.measured import Curve
from calibrate.simulation import Run

# mm, of the zero of displacement; rms over records of simulated soils that hide nothing
# (verification/results/posterior.md).
ZERO_KNOWN = 0.08
UNHEARD = 1e3  # times a number: a deviation with which it counts for nothing


@dataclass(frozen=True, eq=False)
class Problem:
    """Features with their measured means (m,) and, per feature, how they were measured.

    target_variance (m,) is the variance of a target's measured mean; repeats (m,) counts the curves
    behind a curve feature and is 0 for a target; scatter (m,) is the relative standard deviation of
    one specimen's feature, NaN where there are no repeats; seating (m,) is a feature's slope with
    the zero of its test's displacement, per mm.
    """

    features: tuple[AbstractFeature, ...]
    measured: np.ndarray
    target_variance: np.ndarray
    repeats: np.ndarray
    scatter: np.ndarray = field(default_factory=lambda: np.full(1, np.nan))
    seating: np.ndarray = field(default_factory=lambda: np.zeros(1))

    def simulated(self, runs: list[Run]) -> np.ndarray:
        """Features of each run, shape (packings, m); NaN where a run failed."""
        return np.array([self._of_run(run) for run in runs])

    def _of_run(self, run: Run) -> list[float]:
        if run.failure:
            return [np.nan] * len(self.features)
        return [feature.of(run.observables, run.curves) for feature in self.features]

    def covariance(self, relative_scatter: np.ndarray, packings: int) -> np.ndarray:
        """Covariance (m, m) of measured minus simulated mean.

        relative_scatter is the covariance of one packing's features over their mean.
        """
        scatter = relative_scatter * np.outer(self.measured, self.measured)
        of_curve = self.repeats > 0
        both = np.outer(of_curve, of_curve)
        more = np.sqrt(self.wider(np.diag(relative_scatter)))
        of_repeats = np.outer(more, more) / np.maximum(self.repeats, 1)
        weight = 1 / packings + np.where(both, of_repeats, 0.0)
        same = np.equal.outer(*[[feature.test for feature in self.features]] * 2)
        touch = ZERO_KNOWN * np.broadcast_to(self.seating, self.measured.shape)
        return scatter * weight + np.diag(self.target_variance) + same * np.outer(touch, touch)

    def wider(self, variance: np.ndarray) -> np.ndarray:
        """By how much (m,) the variance of a laboratory's specimens is larger than that of
        packings, relatively `variance` (m,): of a target, or of all features of a test's curves; at
        least 1."""
        found = np.ones(len(self.features))
        shown = np.broadcast_to(self.scatter, found.shape) ** 2
        known = np.isfinite(shown) & (variance > 0)
        for group in set(self.groups):
            mine = known & np.array([each == group for each in self.groups])
            if mine.any():
                found[mine] = max(1.0, float(shown[mine].sum() / variance[mine].sum()))
        return found

    @property
    def groups(self) -> tuple[str, ...]:
        """What a feature is read of: the name of a target, or of the test that has curves."""
        return tuple(f.name if f.is_target else f.test for f in self.features)

    def without(self, unknown: np.ndarray) -> "Problem":
        """The same in which features `unknown` (m,) have no say, as they count for nothing."""
        wide = (UNHEARD * self.measured) ** 2
        return replace(self, target_variance=np.where(unknown, wide, self.target_variance))


def finished_features(problem: Problem, runs: Sequence[Run]) -> np.ndarray:
    """Features (n, m) of the runs that did not fail; refused where most of them failed."""
    failures = [run.failure for run in runs if run.failure]
    if len(failures) > len(runs) // 2:
        repair = "start from another, by [parameters] of the lab file or --set"
        raise CalibrationError(f"the starting soil cannot be simulated: {failures[0]}; {repair}")
    return problem.simulated([run for run in runs if not run.failure])


@dataclass(frozen=True, eq=False)
class Row:
    """A feature and how it was measured, as `Problem` has them."""

    feature: AbstractFeature
    measured: float
    target_variance: float = 0.0
    repeats: int = 0
    scatter: float = np.nan
    seating: float = 0.0


def pose(lab: Lab) -> Problem:
    """The problem that a lab file states: its targets and its curves, of tests with soil.

    What a machine does without soil has no slope in any parameter, and no packing scatters it.
    """
    lab = lab.on_soil()
    rows = [_target(lab, name) for name in lab.targets]
    rows += [row for test in lab.tests for row in _of_curves(lab, test)]
    columns = {
        name: np.array([getattr(row, name) for row in rows])
        for name in ("measured", "target_variance", "repeats", "scatter", "seating")
    }
    return Problem(features=tuple(row.feature for row in rows), **columns)


def begun_late(lab: Lab) -> list[str]:
    """One sentence for each test of which a record begins at a preload."""
    found = []
    for test in lab.on_soil().tests:
        curves = _compared(lab, test)
        if curves and not test.protocol and (zero := zero_of(curves)) > SEATING:
            latest = max(curves, key=lambda curve: curve.force_n[0])
            found.append(
                f"{latest.file} begins at a load of {zero:.4g} N: displacements of {test.called} "
                "count from there, in measurement and simulation; what lies below is not compared"
            )
    return found


def shrunk_covariance(samples: np.ndarray) -> np.ndarray:
    """Covariance (m, m) of samples (n, m), shrunk towards its diagonal.

    Weight of the diagonal: estimated variance of the correlations over their sum of
    squares (Schafer and Strimmer 2005, target D); one sample gives zeros.
    """
    count = len(samples)
    if count < 2:
        return np.zeros((samples.shape[1],) * 2)
    centred = samples - samples.mean(axis=0)
    deviation = np.maximum(centred.std(axis=0, ddof=1), 1e-300)
    standard = centred / deviation
    products = np.einsum("ni,nj->nij", standard, standard)
    correlation = products.sum(axis=0) / (count - 1)
    spread = ((products - products.mean(axis=0)) ** 2).sum(axis=0) * count / (count - 1) ** 3
    off = ~np.eye(samples.shape[1], dtype=bool)
    total = (correlation[off] ** 2).sum()
    weight = np.clip(spread[off].sum() / total, 0.0, 1.0) if total > 0 else 1.0
    correlation = np.where(off, (1 - weight) * correlation, 1.0)
    return correlation * np.outer(deviation, deviation)


def _target(lab: Lab, name: str) -> Row:
    target, known = lab.targets[name], described(name)
    test = name.rpartition(".")[0]
    variance = target.scatter**2 / target.repeats
    scatter = target.scatter / abs(target.mean) if target.repeats > 1 and target.mean else np.nan
    return Row(ScalarTarget(name, known.unit, test), target.mean, variance, 0, scatter)


def _of_curves(lab: Lab, test: AbstractLabTest) -> Iterator[Row]:
    """The features of one test's curves, with their means over the curves."""
    curves = _compared(lab, test)
    if not curves:
        return
    for curve in curves:
        refusal = test.refusal(curve)
        if refusal:
            raise refusal.at(lab.file, f"curves.{curve.file}")
    features = test.features(lab.cylinder_of(test.called), curves)
    if not features:
        raise InputError(
            lab.file,
            f"curves.{curves[0].file}",
            f"nothing can be read: the records of {test.called} begin at {zero_of(curves):.4g} N "
            "or are too short",
            "give records that begin at contact and reach 0.5 % of the height, or leave them out",
        )
    for feature in features:
        values = [_measured(feature, curve) for curve in curves]
        if not np.all(np.isfinite(values)):
            place = int(np.argmin(np.isfinite(values)))
            raise InputError(
                lab.file,
                f"curves.{curves[place].file}",
                f"it has no '{feature.name}' as the first curve has",
                "give curves of one protocol to one test, others to a test of their own",
            )
        mean = float(np.mean(values))
        spread = float(np.std(values, ddof=1) / abs(mean)) if len(values) > 1 and mean else np.nan
        ends = [feature.begun_later(by) for by in (-ZERO_KNOWN, ZERO_KNOWN)]
        early, late = ([_measured(end, curve) for curve in curves] for end in ends)
        slope = float(np.mean(np.subtract(late, early))) / (2 * ZERO_KNOWN)
        yield Row(feature, mean, 0.0, len(values), spread, slope)


def _compared(lab: Lab, test: AbstractLabTest) -> list[Curve]:
    return [curve for curve in lab.curves if curve.test == test.called and curve.compared]


def _measured(feature: AbstractFeature, curve: Curve) -> float:
    return feature.of({}, {curve.test: np.stack([curve.displacement_mm, curve.force_n], axis=1)})
