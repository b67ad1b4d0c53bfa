"""What of a residual, and of an effect, no change of the base parameters could mimic.

Whitened residual and slopes, with the prior of the base parameters as further rows:

    r = (W r, 0)   J = (W B, P^-1/2)   g = (W g, 0)      W' W = Sigma^-1

An orthonormal basis Q2 of the complement of J gives the projected residual Q2' r and effects
Q2' g; without any effect the projected residual is standard normal in m dimensions, whatever
the base parameters are.  This is Neyman's C(alpha) construction (Neyman 1959), or
Basseville and Nikiforov's nuisance rejection.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg


@dataclass(frozen=True, eq=False)
class Projected:
    """operator (m, m): from a change of features to its projection; residual (m,); effects
    (m, k); log_determinant of the marginal covariance Sigma + B P B'."""

    operator: np.ndarray
    residual: np.ndarray
    effects: np.ndarray
    log_determinant: float


def project(
    residual: np.ndarray,
    base_slopes: np.ndarray,
    prior_sd: np.ndarray,
    effect_slopes: np.ndarray,
    covariance: np.ndarray,
) -> Projected:
    """Projects features off the base parameters.

    residual (m,): measured minus simulated, plus B delta if the slopes are taken at a shift
    delta of the base parameters; effect_slopes (m, k) per typical strength.
    """
    m, p = base_slopes.shape
    lower = np.linalg.cholesky(covariance)
    whitening = linalg.solve_triangular(lower, np.eye(m), lower=True)
    stacked = np.vstack([whitening @ base_slopes, np.diag(1 / prior_sd)])
    full, upper = np.linalg.qr(stacked, mode="complete")
    operator = full[:, p:].T[:, :m] @ whitening
    log_determinant = 2 * float(
        np.log(np.diag(lower)).sum()
        + np.log(np.abs(np.diag(upper[:p]))).sum()
        + np.log(prior_sd).sum()
    )
    return Projected(operator, operator @ residual, operator @ effect_slopes, log_determinant)


def fitted_shift(
    residual: np.ndarray, base_slopes: np.ndarray, prior_sd: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Best shift (p,) of the base parameters in ln p and its covariance (p, p)."""
    weighted = linalg.solve(covariance, base_slopes, assume_a="pos")
    spread = np.linalg.inv(base_slopes.T @ weighted + np.diag(1 / prior_sd**2))
    return spread @ (weighted.T @ residual), spread
