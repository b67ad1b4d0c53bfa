"""Specimens far from the others count for less.

    w_i = min(1, (nu + q)/(nu + d_i^2/s^2))     s^2 = max(1, median(d_i^2)/q)

d_i^2 is n/(n - 1) times the squared distance of specimen i from the weighted mean of all n, in
units of what simulated specimens scatter by, in the q directions of a test that carry this
scatter: the weights of a multivariate Student's t (Lange, Little and Taylor 1989, J. Am. Stat.
Assoc. 84, 881), found by repetition from the median.  Where all repeats scatter more than
simulated ones, s says so, and none is odd.  A bed whose surface is loose begins to carry
millimetres later than others; its mean with three good ones would look like a gap.
"""

import numpy as np

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.repeats import Measured, from_vectors, plan_of
from calibrate.labtests.diagnosis.base import BEFORE, TARGET
from calibrate.labtests.diagnosis.curves import TESTS, tests_of

FREEDOM = 4.0  # nu
CARRYING = 0.98  # of the scatter's variance
FEWEST = 3  # specimens among which an outlier can be detected
ROUNDS = 10


def scatter_of(d: Linearised) -> np.ndarray:
    """Covariance (m, m) of one simulated specimen, as simulated."""
    residuals = d.packing_residuals - d.packing_residuals.mean(axis=0)
    return residuals.T @ residuals / (len(residuals) - 1) + d.extra + d.sensor


def robust(measured: Measured, scatter: np.ndarray) -> Measured:
    """The sample with a weight for each specimen, the smaller one of its tests, by a covariance
    (m, m) of one; forces before contact do not speak, as they are taken off, nor do targets, whose
    single values are not known."""
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
    values, axes = np.linalg.eigh(scatter / np.outer(deviation, deviation))
    kept = int(np.searchsorted(np.cumsum(values[::-1]), CARRYING * values.sum())) + 1
    axes, values = axes[:, ::-1][:, :kept], values[::-1][:kept]
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
