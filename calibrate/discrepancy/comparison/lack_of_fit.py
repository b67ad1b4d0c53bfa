"""Is there any gap beyond scatter, and is there any left once an effect is in?

Three statistics of a projected residual: its length (any gap), its largest admissible score
(a gap like a candidate effect), and its largest kernel score (a smooth gap).  The smallest of their
three p-values counts, judged by simulation.  This repeats everything that is estimated, covariance
and amplitudes too, and so holds its rate although few specimens tell the covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import best_shape, estimate
from calibrate.discrepancy.comparison.projection import Projected, admissible, lengths, project
from calibrate.discrepancy.comparison.unspecified_gap import (
    Factors,
    kernel_factors,
    kernel_scores,
    projected,
)

DRAWS = 400
TRUE_SNR = (2.0, 12.0)  # of the effect that is true where what is left after it is simulated


@dataclass(frozen=True, eq=False)
class NullDistribution:
    """Simulated statistics (n, q), and the smallest of their p-values in each draw (n,)."""

    draws: np.ndarray
    smallest: np.ndarray

    def p_value(self, observed: np.ndarray) -> float:
        """p-value of the smallest of the p-values of the observed statistics (q,)."""
        count = len(self.draws)
        mine = (((self.draws >= observed).sum(axis=0) + 1) / (count + 1)).min()
        return float(((self.smallest <= mine).sum() + 1) / (count + 1))


@dataclass(frozen=True, eq=False)
class NullDistributions:
    """Simulated statistics without any gap (`before`) and after the best effect where one is true
    (`after`); inflation: mean square of the scores without a gap, 1 for a known covariance."""

    before: NullDistribution
    after: NullDistribution
    inflation: float


def null_distribution(draws: np.ndarray) -> NullDistribution:
    """The table of simulated statistics (n, q)."""
    ranks = (draws[None, :, :] >= draws[:, None, :]).sum(axis=1) / len(draws)
    return NullDistribution(draws, ranks.min(axis=1))


def statistics(
    residual: np.ndarray, effects: np.ndarray, one_sided: np.ndarray, kernel: Factors
) -> np.ndarray:
    """The three statistics (..., 3) of a projected residual (..., m): effects (..., m, k), kernels'
    factors."""
    score = admissible(_scores(residual, effects), one_sided)
    return _together(residual, score, kernel)


def _scores(residual: np.ndarray, effects: np.ndarray) -> np.ndarray:
    """z (..., k) of projected effects."""
    return np.vecmat(residual, effects) / lengths(effects)


def _together(residual: np.ndarray, score: np.ndarray, kernel: Factors) -> np.ndarray:
    smooth = kernel_scores(kernel, residual).max(axis=-1)
    largest = score.max(axis=-1, initial=0.0)
    return np.stack([np.vecdot(residual, residual), largest, smooth], axis=-1)


def statistics_after(
    design: Projected, chosen: np.ndarray, one_sided: np.ndarray, kernel: Factors
) -> np.ndarray:
    """The same after the best strengths of the chosen effects (..., q) have been taken off."""
    basis, _ = np.linalg.qr(np.take_along_axis(design.effects, chosen[..., None, :], axis=-1))
    others = _off(design.effects, basis)
    left = _off(design.residual[..., None], basis)[..., 0]
    visible = lengths(others) > 1e-6 * np.maximum(lengths(design.effects), 1e-9)
    np.put_along_axis(visible, chosen, False, axis=-1)
    score = np.where(visible, admissible(_scores(left, others), one_sided), 0.0)
    return _together(left, score, [_off(factor, basis) for factor in kernel])


def simulate(generator: SampleGenerator, seed: int, draws: int = DRAWS) -> NullDistributions:
    """The null distributions for a description and a plan of measurement."""
    rng, d = np.random.default_rng(seed), generator.description
    residuals = d.packing_residuals - d.packing_residuals.mean(axis=0)
    shape, snr = best_shape(residuals), generator.snr(d.effect_slopes)
    plain, changed = [], []

    def drawn(gap: np.ndarray | None) -> Draw:
        return generator.specimens(rng, gap=gap), shape.of(generator.simulated(rng))

    for _ in range(draws):
        plain.append(drawn(None))
        if d.effects:
            changed.append(drawn(_gap_of_an_effect(d, snr, rng)))
    design, kernel = _analysed(generator, plain)
    before = after = statistics(design.residual, design.effects, d.one_sided, kernel)
    inflation = _mean_square(design)
    if changed:
        design, kernel = _analysed(generator, changed)
        score = admissible(_scores(design.residual, design.effects), d.one_sided)
        best = np.argmax(score, axis=-1, keepdims=True)
        after = statistics_after(design, best, d.one_sided, kernel)
    return NullDistributions(null_distribution(before), null_distribution(after), inflation)


Draw = tuple[np.ndarray, np.ndarray]  #: specimens (s, m), covariance (m, m) of simulated ones


def _analysed(generator: SampleGenerator, draws: Sequence[Draw]) -> tuple[Projected, Factors]:
    """Projected designs and kernels of all draws, with everything estimated anew."""
    d = generator.description
    specimens, packing = map(np.array, zip(*draws, strict=True))
    measured = generator.sample(specimens)
    noise = estimate(d, measured, packing, d.prior_sd**2)
    residual = measured.mean - d.mean
    design = project(residual, d.base_slopes, d.prior_sd, d.effect_slopes, noise.mean)
    return design, projected(kernel_factors(d.features, noise.specimen), design.operator)


def _gap_of_an_effect(d: Linearised, unit: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The gap (m,) of one effect at a signal-to-noise drawn from `TRUE_SNR`; unit (k,): that of
    typical strengths."""
    k = int(rng.integers(len(d.effects)))
    sign = 1.0 if d.effects[k].one_sided else rng.choice([-1.0, 1.0])
    return sign * rng.uniform(*TRUE_SNR) * d.effect_slopes[:, k] / unit[k]


def _mean_square(design: Projected) -> float:
    """Mean square of the scores, or of the residual where there are no effects."""
    if not design.effects.shape[-1]:
        return float(np.mean(design.residual**2))
    return float(np.mean(_scores(design.residual, design.effects) ** 2))


def _off(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """`values` (..., m, n) without their part in the span of `basis` (..., m, q)."""
    return values - basis @ (np.swapaxes(basis, -1, -2) @ values)
