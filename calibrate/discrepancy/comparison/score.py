"""The score test: for each effect, one number from one fit and one slope.

With the projected residual r and the projected effect g (`projection`):

    z = g'r/|g|   one-step strength = g'r/|g|^2   predicted drop of chi2 = z^2
    visibility = |g projected|/|g whitened|     confusability = cosine of projected effects

Rao (1948), Neyman (1959); in structural equation modelling the modification index with
its expected parameter change (Saris, Satorra and van der Veld 2009).
"""

from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.projection import Projected


@dataclass(frozen=True, eq=False)
class Scores:
    """By effect (k,): z, one-step strength and its standard error (in typical strengths),
    signal-to-noise at typical strength, visibility; confusability (k, k)."""

    z: np.ndarray
    strength: np.ndarray
    strength_se: np.ndarray
    typical_snr: np.ndarray
    visibility: np.ndarray
    confusability: np.ndarray


def scores(design: Projected, effect_slopes: np.ndarray, covariance: np.ndarray) -> Scores:
    """Scores of all effects; effect_slopes (m, k) and covariance (m, m) as projected."""
    length = lengths(design.effects)
    whitened = np.sqrt(
        np.einsum("ik,ik->k", effect_slopes, np.linalg.solve(covariance, effect_slopes))
    )
    product = design.effects.T @ design.residual
    return Scores(
        z=product / length,
        strength=product / length**2,
        strength_se=1 / length,
        typical_snr=length,
        visibility=length / np.maximum(whitened, 1e-300),
        confusability=confusability(design.effects),
    )


def lengths(effects: np.ndarray) -> np.ndarray:
    """Lengths (k,) of projected effects; an invisible effect gets a tiny one, not zero."""
    return np.maximum(np.linalg.norm(effects, axis=0), 1e-12)


def confusability(effects: np.ndarray) -> np.ndarray:
    """Cosines (k, k) between projected effects."""
    unit = effects / lengths(effects)
    return np.clip(unit.T @ unit, -1.0, 1.0)


def admissible(z: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """What counts of a score: itself where strength is positive, else its absolute value."""
    return np.where(one_sided, z, np.abs(z))
