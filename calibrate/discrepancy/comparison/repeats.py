"""What was measured: the mean over repeats of every feature, and how the repeats scatter.

Specimens are the sample, not points.  A specimen may have gone through one test or both;
features of different tests then share as many specimens as went through both.

Specimens far from the others count for less:

    w_i = min(1, (nu + q)/(nu + d_i^2/s^2))     s^2 = max(1, median(d_i^2)/q)

d_i^2 is n/(n - 1) times the squared distance of specimen i from the weighted mean of all n, in
units of what simulated specimens scatter by, in the q directions of a test that carry this
scatter: the weights of a multivariate Student's t (Lange, Little and Taylor 1989, J. Am. Stat.
Assoc. 84, 881), found by repetition from the median.  Where all repeats scatter more than
simulated ones, s says so, and none is odd.  A bed whose surface is loose begins to carry
millimetres later than others; its mean with three good ones would look like a gap.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.projection import leading_modes
from calibrate.labtests.diagnosis.base import BEFORE, TARGET, Curves, Feature
from calibrate.labtests.diagnosis.curves import TESTS, tests_of

FREEDOM = 4.0  # nu
CARRYING = 0.98  # of the scatter's variance
FEWEST = 3  # specimens among which an outlier can be detected
ROUNDS = 10


@dataclass(frozen=True, eq=False)
class Scatter:
    """Sum of squares and products (m_t, m_t) of one test's repeats about their mean, with its
    degrees of freedom."""

    products: np.ndarray
    freedom: int


@dataclass(frozen=True, eq=False)
class Measured:
    """Features of a soil: mean (m,), in how many specimens two features were both measured, shared
    (m, m) (with weights, as many as would make a mean as sure), and the scatter of repeats by test
    where known; single specimens (s, m), NaN where not measured, and how much each counts, weight
    (s,); no rows for targets.  With further axes before these it holds many samples of one plan."""

    features: tuple[Feature, ...]
    mean: np.ndarray
    shared: np.ndarray
    scatter: dict[str, Scatter]
    specimens: np.ndarray
    weight: np.ndarray

    @property
    def counts(self) -> np.ndarray:
        """Number of repeats behind each mean, shape (m,)."""
        return np.diagonal(self.shared, axis1=-2, axis2=-1)

    @property
    def plan(self) -> np.ndarray:
        """Which specimen has which feature, shape (s, m)."""
        return plan_of(self.specimens)

    def weights(self) -> np.ndarray:
        """Covariance of the mean over the covariance of a specimen, shape (m, m)."""
        return self.shared / products(self.counts)

    def without(self, specimen: int) -> "Measured":
        """The same with one specimen left out; features left unmeasured keep their mean."""
        rest, weight = (np.delete(a, specimen, axis=0) for a in (self.specimens, self.weight))
        return from_vectors(self.features, rest, weight)


def products(values: np.ndarray) -> np.ndarray:
    """Products (..., m, m) of values (..., m) with each other."""
    return values[..., :, None] * values[..., None, :]


def plan_of(specimens: np.ndarray) -> np.ndarray:
    """Which specimen (s, m) has which feature, of vectors (..., s, m), NaN where one has not."""
    return np.isfinite(specimens[(0,) * (specimens.ndim - 2)])


def from_vectors(
    features: Sequence[Feature], specimens: np.ndarray, weight: np.ndarray | None = None
) -> Measured:
    """The sample of feature vectors (..., s, m); NaN where a specimen lacks a feature; weight
    (..., s): how much each counts, 1 if not given.  ValueError if a feature was never measured."""
    observed = plan_of(specimens)
    missing = [f.name for i, f in enumerate(features) if not observed[:, i].any()]
    if missing:
        raise ValueError(f"never measured: {missing[0]}; drop it with measured_features")
    weight = np.ones(specimens.shape[:-1]) if weight is None else weight
    heavy = weight[..., None] * observed
    total, squares = heavy.sum(axis=-2), np.swapaxes(heavy, -1, -2) @ heavy
    counts = total**2 / np.diagonal(squares, axis1=-2, axis2=-1)
    mean = np.where(observed, heavy * specimens, 0.0).sum(axis=-2) / total
    tests = tests_of(features)
    scatter = {
        test: found
        for test in TESTS
        if (found := _scatter(specimens[..., tests == test], weight)) is not None
    }
    shared = squares * products(counts / total)
    return Measured(tuple(features), mean, shared, scatter, specimens, weight)


def from_targets(
    features: Sequence[Feature], values: Mapping[str, tuple[float, float, int]]
) -> Measured:
    """Scalar targets alone: (mean, standard deviation of one, repeats) by feature's name."""
    rows = [values[feature.name] for feature in features]
    counts = np.array([row[2] for row in rows], float)
    scatter = {
        feature.test: Scatter(np.array([[(n - 1) * sd**2]]), int(n) - 1)
        for feature, (_, sd, n) in zip(features, rows, strict=True)
        if n > 1
    }
    mean = np.array([row[0] for row in rows], float)
    none = np.empty((0, len(rows)))
    return Measured(tuple(features), mean, np.diag(counts), scatter, none, np.empty(0))


def measured_features(
    features: Sequence[Feature], specimens: Sequence[Curves], values: np.ndarray
) -> tuple[Feature, ...]:
    """Those features, of values (s, m), that every specimen with a curve of their test has."""
    has_test = np.array([[f.test in curves for f in features] for curves in specimens])
    complete = np.isfinite(values) | ~has_test
    return tuple(f for i, f in enumerate(features) if complete[:, i].all() and has_test[:, i].any())


def _scatter(values: np.ndarray, weight: np.ndarray) -> Scatter | None:
    """Weighted scatter of the complete rows (..., s, m_t); None for fewer than two."""
    complete = plan_of(values).all(axis=1)
    rows, heavy = values[..., complete, :], weight[..., complete]
    if complete.sum() < 2 or not values.size:
        return None
    middle = np.vecmat(heavy, rows) / heavy.sum(axis=-1, keepdims=True)
    centred = rows - middle[..., None, :]
    weighted = heavy[..., None] * centred
    return Scatter(np.swapaxes(centred, -1, -2) @ weighted, int(complete.sum()) - 1)


def scatter_of(d: Linearised) -> np.ndarray:
    """Covariance (m, m) of one simulated specimen, as simulated."""
    residuals = d.packing_residuals - d.packing_residuals.mean(axis=0)
    return residuals.T @ residuals / (len(residuals) - 1) + d.extra + d.sensor


def robust(measured: Measured, scatter: np.ndarray) -> Measured:
    """The sample with a weight for each specimen, the smaller one of its tests, by a covariance
    (m, m) of one; forces before contact, which are taken off, and targets do not speak."""
    rows, plan, tests = measured.specimens, measured.plan, tests_of(measured.features)
    found = np.ones(rows.shape[:-1])
    curves = np.array([feature.kind not in (BEFORE, TARGET) for feature in measured.features])
    for test in TESTS:
        mine = np.flatnonzero(curves & (tests == test))
        through = np.flatnonzero(plan[:, mine].any(axis=1))
        if len(through) >= FEWEST:
            own = weights(rows[..., through[:, None], mine], scatter[np.ix_(mine, mine)])
            found[..., through] = np.minimum(found[..., through], own)
    return from_vectors(measured.features, rows, found) if (found < 1).any() else measured


def weights(rows: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """Weights (..., n) of one test's specimens (..., n, m), NaN where not measured."""
    deviation = np.sqrt(np.maximum(np.diag(scatter), 1e-300))
    values, axes = leading_modes(scatter / np.outer(deviation, deviation), CARRYING)
    standard, observed = rows / deviation, plan_of(rows)
    freedom, count = observed.mean(axis=1) * len(values), rows.shape[-2]
    middle = _medians(standard) if observed.all() else np.nanmedian(standard, axis=-2)
    found = np.ones(rows.shape[:-1])
    for _ in range(ROUNDS):
        away = np.where(observed, standard - middle[..., None, :], 0.0) @ axes
        squared = (away**2 / values).sum(axis=-1) * count / (count - 1)
        wide = np.maximum(_medians((squared / freedom)[..., None]), 1.0)
        found = np.minimum((FREEDOM + freedom) / (FREEDOM + squared / wide), 1.0)
        heavy = found[..., None] * observed
        middle = np.where(observed, heavy * standard, 0.0).sum(axis=-2) / heavy.sum(axis=-2)
    return found


def _medians(values: np.ndarray) -> np.ndarray:
    """Of columns (..., n, m): NumPy's own take ten times as long for a few numbers."""
    ordered, count = np.sort(values, axis=-2), values.shape[-2]
    return 0.5 * (ordered[..., (count - 1) // 2, :] + ordered[..., count // 2, :])
