"""What was measured: the mean over repeats of every feature, and how the repeats scatter.

Specimens are the sample, not points.  A specimen may have gone through one test or both;
features of different tests then share as many specimens as went through both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.labtests.diagnosis.base import Curves, Feature
from calibrate.labtests.diagnosis.curves import TESTS, feature_values, tests_of


@dataclass(frozen=True, eq=False)
class Scatter:
    """Sum of squares and products (m_t, m_t) of one test's repeats about their mean, with its
    degrees of freedom."""

    products: np.ndarray
    freedom: int


@dataclass(frozen=True, eq=False)
class Measured:
    """Features of a soil: mean (m,), in how many specimens two features were both
    measured, shared (m, m), and the scatter of repeats by test (absent if unknown).

    `specimens` (s, m) keeps the single ones, NaN where not measured, and weight (s,) how much
    each counts; no rows for targets.  With weights, `shared` is of as many specimens as would
    make a mean as sure.  With further axes before these it holds many samples of one plan.
    """

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


def from_curves(features: Sequence[Feature], specimens: Sequence[Curves]) -> Measured:
    """The sample of specimens with one or both curves each."""
    return from_vectors(
        features, np.array([feature_values(features, curves) for curves in specimens])
    )


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
    (..., s): how much each counts, 1 if not given.  Axes before these: many samples of one plan.

    ValueError if a feature was never measured: use `measured_features` first.
    """
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
    features: Sequence[Feature], specimens: Sequence[Curves], values: np.ndarray | None = None
) -> tuple[Feature, ...]:
    """Those features that every specimen with a curve of their test has; values (s, m) of all, if
    they are known already."""
    if values is None:
        values = np.array([feature_values(features, curves) for curves in specimens])
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
