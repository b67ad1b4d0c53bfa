"""The calibration problem: what was measured, what a run gives for it, and their scatter.

Scalar targets and whole curves are both reduced to features of a specimen: a target is
one feature, a curve is displacements at given forces (confined) and forces at given
displacements (unconfined).  The specimen is the sample, not the point, so features of
one specimen are correlated, and their covariance is that of packings and repeats:

    Sigma = S_packing (1/n_packings + 1/n_repeats)          for curves
    Sigma = S_packing / n_packings + scatter^2 / repeats    for scalar targets
"""

from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import InputError
from calibrate.io.lab import Curve, Lab
from calibrate.io.reading import SEATING, displacement_up
from calibrate.simulation import Run

LOADING = (0.125, 0.25, 0.5, 0.75, 1.0)  # of force_high, displacement read on loading
UNLOADING = (0.5, 0.1)  # of force_high, displacement read on unloading
CRUSHING = (0.005, 0.01, 0.02, 0.04, 0.06, 0.08, 0.10)  # of height, force read on crushing


@dataclass(frozen=True)
class Feature:
    """One number of a specimen: its name, unit and where on which test it is read.

    kind is "target" (an observable), "loading", "unloading" (abscissa in N, value in mm)
    or "crushing" (abscissa in mm, value in N).
    """

    name: str
    unit: str
    kind: str
    abscissa: float = 0.0

    def of_run(self, run: Run) -> float:
        """This feature of a simulated specimen."""
        if self.kind == "target":
            return run.observables[self.name]
        curve = run.curves["unconfined" if self.kind == "crushing" else "confined"]
        return self.of_curve(curve[:, 0], curve[:, 1])

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        """This feature of one specimen's curve."""
        if self.kind == "crushing":
            return _force_at(displacement_mm, force_n, self.abscissa)
        turn = int(np.argmax(force_n))
        if self.kind == "loading":
            return displacement_up(displacement_mm[: turn + 1], force_n[: turn + 1], self.abscissa)
        return _displacement_down(displacement_mm, force_n, turn, self.abscissa)


@dataclass(frozen=True, eq=False)
class Problem:
    """Features with their measured means (m,) and, per feature, how they were measured.

    target_variance (m,) is the variance of a target's measured mean; repeats (m,) counts
    the curves behind a curve feature and is 0 for a target.
    """

    features: tuple[Feature, ...]
    measured: np.ndarray
    target_variance: np.ndarray
    repeats: np.ndarray

    def simulated(self, runs: list[Run]) -> np.ndarray:
        """Features of each run, shape (packings, m); NaN where a run failed."""
        return np.array([self._of_run(run) for run in runs])

    def _of_run(self, run: Run) -> list[float]:
        if run.failure:
            return [np.nan] * len(self.features)
        return [feature.of_run(run) for feature in self.features]

    def covariance(self, relative_scatter: np.ndarray, packings: int) -> np.ndarray:
        """Covariance (m, m) of measured minus simulated mean.

        relative_scatter is the covariance of one packing's features over their mean.
        """
        scatter = relative_scatter * np.outer(self.measured, self.measured)
        of_curve = self.repeats > 0
        both = np.outer(of_curve, of_curve)
        weight = 1 / packings + np.where(both, 1 / np.maximum(self.repeats, 1), 0.0)
        return scatter * weight + np.diag(self.target_variance)


def pose(lab: Lab) -> Problem:
    """The problem that a lab file states: its targets and its curves."""
    targets = [_target(lab, name) for name in lab.targets]
    curves = [_curve_feature(lab, feature) for feature in _curve_features(lab)]
    rows = targets + curves
    return Problem(
        features=tuple(row[0] for row in rows),
        measured=np.array([row[1] for row in rows]),
        target_variance=np.array([row[2] for row in rows]),
        repeats=np.array([row[3] for row in rows]),
    )


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


def _target(lab: Lab, name: str):
    target = lab.targets[name]
    unit = "mm" if name.endswith("_mm") else "N"
    variance = target.scatter**2 / target.repeats
    return Feature(name, unit, "target"), target.mean, variance, 0


def _curve_features(lab: Lab) -> list[Feature]:
    """Features of the tests of which the lab has curves."""
    tests = {curve.test for curve in lab.curves}
    high, height_mm = lab.confined.force_high, 1e3 * lab.specimen.height
    features = []
    if "confined" in tests:
        features += [_at("loading", share * high) for share in LOADING]
        if _all_unload(lab):
            features += [_at("unloading", share * high) for share in UNLOADING]
    if "unconfined" in tests:
        reach = min(c.displacement_mm.max() for c in lab.curves if c.test == "unconfined")
        features += [_at("crushing", s * height_mm) for s in CRUSHING if s * height_mm <= reach]
    return features


def _at(kind: str, abscissa: float) -> Feature:
    if kind == "crushing":
        return Feature(f"force at {abscissa:g} mm, crushing", "N", kind, abscissa)
    return Feature(f"displacement at {abscissa:g} N, {kind}", "mm", kind, abscissa)


def _all_unload(lab: Lab) -> bool:
    lowest = UNLOADING[-1] * lab.confined.force_high
    return all(c.force_n[-1] < lowest for c in lab.curves if c.test == "confined")


def _curve_feature(lab: Lab, feature: Feature):
    test = "unconfined" if feature.kind == "crushing" else "confined"
    curves = [curve for curve in lab.curves if curve.test == test]
    values = [_measured(lab, curve, feature) for curve in curves]
    return feature, float(np.mean(values)), 0.0, len(values)


def _measured(lab: Lab, curve: Curve, feature: Feature) -> float:
    if feature.kind != "crushing" and curve.force_n.max() < 0.98 * lab.confined.force_high:
        raise InputError(
            lab.file,
            f"curves.{curve.file}",
            f"the largest force is {curve.force_n.max():.4g} N, below confined.force_high",
            f"give a curve that reaches {lab.confined.force_high:g} N, or lower force_high",
        )
    return feature.of_curve(curve.displacement_mm, curve.force_n)


def _displacement_down(displacement, force, turn, wanted) -> float:
    """Displacement (mm) beyond the loading curve's seating at `wanted` N on unloading."""
    highest = np.maximum.accumulate(force[: turn + 1])
    zero = np.interp(SEATING, highest, displacement[: turn + 1])
    lowest = np.minimum.accumulate(force[turn:])
    return float(np.interp(wanted, lowest[::-1], displacement[turn:][::-1]) - zero)


def _force_at(displacement, force, wanted) -> float:
    """Force (N) at `wanted` mm beyond the seating, averaged over a tenth of that distance."""
    seated = displacement - displacement[int(np.argmax(force >= SEATING))]
    near = np.abs(seated - wanted) <= max(0.05 * wanted, 0.05)
    interpolated = np.interp(wanted, seated, force)
    return float(force[near].mean()) if near.sum() > 2 else float(interpolated)
