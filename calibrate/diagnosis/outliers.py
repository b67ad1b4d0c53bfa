"""Specimens far from the others count for less.

    w_i = min(1, (nu + q)/(nu + d_i^2 n/(n - 1)))

d_i is the distance of specimen i from the weighted mean of all n, in units of what simulated
specimens scatter by, in the q directions that carry this scatter: the weights of a
multivariate Student's t (Lange, Little and Taylor 1989, J. Am. Stat. Assoc. 84, 881), found by
repetition from the median.  A bed whose surface is loose begins to carry millimetres later than
others; its mean with three good ones would look like a gap.
"""

import numpy as np

from calibrate.diagnosis.linear import Linearised
from calibrate.diagnosis.repeats import Measured, from_vectors

FREEDOM = 4.0  # nu
CARRYING = 0.98  # of the scatter's variance
FEWEST = 3  # specimens among which one can be told to be odd
ROUNDS = 10


def scatter_of(d: Linearised) -> np.ndarray:
    """Covariance (m, m) of one simulated specimen, as simulated."""
    residuals = d.packing_residuals - d.packing_residuals.mean(axis=0)
    return residuals.T @ residuals / (len(residuals) - 1) + d.extra + d.sensor


def robust(measured: Measured, scatter: np.ndarray) -> Measured:
    """The sample with a weight for each specimen, by a covariance (m, m) of one."""
    rows = measured.specimens
    if len(rows) < FEWEST:
        return measured
    return from_vectors(measured.features, rows, weights(rows, scatter))


def weights(rows: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """Weights (n,) of specimens (n, m), NaN where not measured."""
    deviation = np.sqrt(np.maximum(np.diag(scatter), 1e-300))
    values, axes = np.linalg.eigh(scatter / np.outer(deviation, deviation))
    kept = int(np.searchsorted(np.cumsum(values[::-1]), CARRYING * values.sum())) + 1
    axes, values = axes[:, ::-1][:, :kept], values[::-1][:kept]
    standard, known = rows / deviation, np.isfinite(rows)
    share, count = known.mean(axis=1), len(rows)
    middle, found = np.nanmedian(standard, axis=0), np.ones(count)
    for _ in range(ROUNDS):
        away = np.where(known, standard - middle, 0.0) @ axes
        squared = (away**2 / values).sum(axis=1) * count / (count - 1)
        found = np.minimum((FREEDOM + share * len(values)) / (FREEDOM + squared), 1.0)
        heavy = found[:, None] * known
        middle = np.where(known, heavy * standard, 0.0).sum(axis=0) / heavy.sum(axis=0)
    return found
