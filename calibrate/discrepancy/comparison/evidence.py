"""How well each explanation predicts the data: evidences under stated priors.

Explanations: no gap, each effect, each pair, a discrepancy of no particular cause
("unknown").  Base parameters are integrated out under their prior; an effect's strength has a
normal prior, cut at zero where the effect is one-sided, of scale 0.3, 1 or 3 typical strengths
(equal weights).  With A = G'G and b = G'r of the projected effects:

    ln B = b' C b/2 - ln|1 + s^2 A|/2 + ln P(e > 0 | data)/P(e > 0 | prior)     C = (A + 1/s^2)^-1

exact for a linear description; at the best fit of an emulator it is Laplace's approximation with
its Gauss-Newton Hessian.  The scale of the noise is integrated by Gauss-Hermite quadrature.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtr, owens_t

from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.comparison.projection import Projected
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.unspecified_gap import (
    Factors,
    log_bayes_factor,
    projected,
    rough,
    spectrum,
)

SCALES = (0.3, 1.0, 3.0)  # of the prior of a strength, in typical strengths
NODES = 3  # of the quadrature over the scale of the noise


@dataclass(frozen=True, eq=False)
class Evidence:
    """ln evidence over that of no gap: singles (k,), pairs (q,) with their indices (q, 2),
    and unknown."""

    singles: np.ndarray
    pairs: np.ndarray
    pair_index: np.ndarray
    unknown: float

    def by_key(self) -> dict[tuple[int, ...], float]:
        """That of effects and pairs by their indices."""
        pairs = zip(map(tuple, self.pair_index.tolist()), self.pairs.tolist(), strict=True)
        return {(k,): value for k, value in enumerate(self.singles.tolist())} | dict(pairs)


def evidence(
    base: Refit, one_sided: np.ndarray, noise: Noise, inflation: float, kernel: Factors
) -> Evidence:
    """Evidences of all explanations, linearised at the fit without effects; kernel: factors of
    smooth discrepancies, not projected (the rough one needs none)."""
    index = np.array(np.triu_indices(len(one_sided), 1)).T
    spectra, total = None, []
    scales = _scales(noise.ln_scale_sd)
    for scale, log_weight in scales:
        design = base.projected(inflation * scale**2 * base.covariance)
        spectra = spectra or [
            *spectrum(projected(kernel, design.operator), design.residual),
            rough(design.residual),
        ]
        smooth = log_bayes_factor(spectra, scale / scales[0][0])
        alone, together = singles(design, one_sided), pairs(design, one_sided, index)
        terms = np.concatenate([[0.0], alone, together, [smooth]])
        total.append(log_weight + log_base(design) + terms)
    found = np.logaddexp.reduce(np.array(total), axis=0)
    found = found[1:] - found[0]
    count = len(one_sided)
    return Evidence(found[:count], found[count:-1], index, float(found[-1]))


def at_a_fit(fit: Refit, one_sided: np.ndarray, noise: Noise, inflation: float) -> float:
    """ln evidence of none, one or two chosen effects, linearised at their own best fit and with the
    noise there."""
    on, total = list(fit.chosen), []
    for scale, log_weight in _scales(noise.ln_scale_sd):
        design = fit.projected(inflation * scale**2 * fit.covariance, on)
        gain = 0.0
        if len(on) == 1:
            gain = float(singles(design, one_sided[on])[0])
        elif len(on) == 2:
            gain = float(pairs(design, one_sided[on], np.array([[0, 1]]))[0])
        total.append(log_weight + log_base(design) + gain)
    return float(np.logaddexp.reduce(total))


def log_base(design: Projected) -> float:
    """ln evidence of no gap, up to a constant."""
    return float(-0.5 * (design.residual @ design.residual + design.log_determinant))


def singles(design: Projected, one_sided: np.ndarray) -> np.ndarray:
    """ln Bayes factor (k,) of each effect alone against none."""
    information = (design.effects**2).sum(axis=0)
    pull = design.effects.T @ design.residual
    terms = []
    for scale in SCALES:
        precision = information + 1 / scale**2
        value = 0.5 * pull**2 / precision - 0.5 * np.log1p(scale**2 * information)
        positive = log_ndtr(pull / np.sqrt(precision)) + np.log(2)
        terms.append(value + np.where(one_sided, positive, 0.0))
    return np.logaddexp.reduce(terms, axis=0) - np.log(len(SCALES))


def pairs(design: Projected, one_sided: np.ndarray, index: np.ndarray) -> np.ndarray:
    """ln Bayes factor (q,) of pairs of effects (q, 2) against none."""
    if not len(index):
        return np.zeros(0)
    gram, pull = design.effects.T @ design.effects, design.effects.T @ design.residual
    i, j = index.T
    terms = []
    for scale in SCALES:
        a, b, c = gram[i, i] + 1 / scale**2, gram[j, j] + 1 / scale**2, gram[i, j]
        determinant = a * b - c**2
        first = (b * pull[i] - c * pull[j]) / determinant
        second = (a * pull[j] - c * pull[i]) / determinant
        value = 0.5 * (pull[i] * first + pull[j] * second)
        value = value - 0.5 * np.log(determinant * scale**4)
        h, k = first / np.sqrt(b / determinant), second / np.sqrt(a / determinant)
        terms.append(value + _log_admissible(h, k, -c / np.sqrt(a * b), one_sided[index]))
    return np.logaddexp.reduce(terms, axis=0) - np.log(len(SCALES))


def _log_admissible(h, k, correlation, one_sided) -> np.ndarray:
    """ln of posterior over prior probability that the one-sided strengths are positive."""
    first, second = one_sided.T
    both = np.log(np.maximum(bivariate_normal(h, k, correlation), 1e-30)) + np.log(4)
    single = np.where(first, log_ndtr(h), log_ndtr(k)) + np.log(2)
    return np.where(first & second, both, np.where(first | second, single, 0.0))


def bivariate_normal(h: np.ndarray, k: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """P(X < h, Y < k) of standard normals with a correlation, by Owen's T (Owen 1956)."""
    h, k = np.where(h == 0, 1e-12, h), np.where(k == 0, 1e-12, k)
    root = np.sqrt(np.maximum(1 - correlation**2, 1e-15))
    opposite = np.where(h * k < 0, 0.5, 0.0)
    value = 0.5 * (ndtr(h) + ndtr(k)) - opposite
    value = value - owens_t(h, (k / h - correlation) / root)
    return np.clip(value - owens_t(k, (h / k - correlation) / root), 0.0, 1.0)


def _scales(ln_sd: float) -> list[tuple[float, float]]:
    """Scales of the noise and their log weights."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    return [
        (float(np.exp(ln_sd * node)), float(np.log(weight / weights.sum())))
        for node, weight in zip(nodes, weights, strict=True)
    ]
