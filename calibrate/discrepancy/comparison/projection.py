"""What of a residual, and of an effect, no change of the base parameters could mimic.

Whitened residual and slopes, with the prior of the base parameters as further rows:

    r = (W r, 0)   J = (W B, P^-1/2)   g = (W g, 0)      W' W = Sigma^-1

An orthonormal basis Q2 of the complement of J gives the projected residual Q2' r and effects
Q2' g; without any effect the projected residual is standard normal in m dimensions, whatever
the base parameters are.  This is Neyman's C(alpha) construction (Neyman 1959), or
Basseville and Nikiforov's nuisance rejection.

The score test follows: for each effect, one number from one fit and one slope.

    z = g'r/|g|   one-step strength = g'r/|g|^2   predicted drop of chi2 = z^2
    visibility = |g projected|/|g whitened|     confusability = cosine of projected effects

Rao (1948), Neyman (1959); in structural equation modelling the modification index with
its expected parameter change (Saris, Satorra and van der Veld 2009).
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg


@dataclass(frozen=True, eq=False)
class Projected:
    """operator (m, m): from a change of features to its projection; residual (m,); effects
    (m, k); log_determinant of the marginal covariance Sigma + B P B'.  Axes before these: many."""

    operator: np.ndarray
    residual: np.ndarray
    effects: np.ndarray
    log_determinant: float | np.ndarray


def project(
    residual: np.ndarray,
    base_slopes: np.ndarray,
    prior_sd: np.ndarray,
    effect_slopes: np.ndarray,
    covariance: np.ndarray,
) -> Projected:
    """Projects features off the base parameters.

    residual (..., m): measured minus simulated, plus B delta if the slopes are taken at a shift
    delta of the base parameters; effect_slopes (m, k) per typical strength; covariance (..., m, m).
    """
    m, p = base_slopes.shape
    lower = np.linalg.cholesky(covariance)
    whitening = linalg.solve_triangular(lower, np.eye(m), lower=True)
    certain = np.broadcast_to(np.diag(1 / prior_sd), (*covariance.shape[:-2], p, p))
    stacked = np.concatenate([whitening @ base_slopes, certain], axis=-2)
    full, upper = np.linalg.qr(stacked, mode="complete")
    operator = np.swapaxes(full[..., p:], -1, -2)[..., :m] @ whitening
    own, of_base = (np.diagonal(part, axis1=-2, axis2=-1) for part in (lower, upper[..., :p, :]))
    log_determinant = 2 * (
        np.log(own).sum(axis=-1) + np.log(np.abs(of_base)).sum(axis=-1) + np.log(prior_sd).sum()
    )
    projected = np.matvec(operator, residual)
    return Projected(operator, projected, operator @ effect_slopes, log_determinant)


def fitted_shift(
    residual: np.ndarray, base_slopes: np.ndarray, prior_sd: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Best shift (p,) of the base parameters in ln p and its covariance (p, p)."""
    weighted = linalg.solve(covariance, base_slopes, assume_a="pos")
    spread = np.linalg.inv(base_slopes.T @ weighted + np.diag(1 / prior_sd**2))
    return spread @ (weighted.T @ residual), spread


@dataclass(frozen=True, eq=False)
class Scores:
    """By effect (k,): z, one-step strength and its standard error (in typical strengths),
    signal-to-noise at typical strength, visibility."""

    z: np.ndarray
    strength: np.ndarray
    strength_se: np.ndarray
    typical_snr: np.ndarray
    visibility: np.ndarray


def scores(design: Projected, effect_slopes: np.ndarray, covariance: np.ndarray) -> Scores:
    """Scores of all effects; effect_slopes (m, k) and covariance (m, m) as projected."""
    length, product = lengths(design.effects), design.effects.T @ design.residual
    return Scores(
        z=product / length,
        strength=product / length**2,
        strength_se=1 / length,
        typical_snr=length,
        visibility=visibility(design.effects, effect_slopes, covariance),
    )


def visibility(effects: np.ndarray, slopes: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """How much (k,) of effects (m, k) is left of their slopes (m, k) by the projection."""
    whitened = np.sqrt(np.einsum("ik,ik->k", slopes, np.linalg.solve(covariance, slopes)))
    return lengths(effects) / np.maximum(whitened, 1e-300)


def leading_modes(covariance: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """The largest eigenvalues (r,) of a covariance (m, m) that make up a share of its variance, and
    their axes (m, r)."""
    values, axes = np.linalg.eigh(covariance)
    carried = np.cumsum(values[::-1]) / max(values.sum(), 1e-300)
    kept = int(np.searchsorted(carried, share)) + 1
    return values[::-1][:kept], axes[:, ::-1][:, :kept]


def lengths(effects: np.ndarray) -> np.ndarray:
    """Lengths (..., k) of projected effects (..., m, k); an invisible one gets a tiny one, not
    zero."""
    return np.maximum(np.linalg.norm(effects, axis=-2), 1e-12)


def confusability(effects: np.ndarray) -> np.ndarray:
    """Cosines (k, k) between projected effects."""
    unit = effects / lengths(effects)
    return np.clip(unit.T @ unit, -1.0, 1.0)


def admissible(z: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """What counts of a score: itself where strength is positive, else its absolute value."""
    return np.where(one_sided, z, np.abs(z))
