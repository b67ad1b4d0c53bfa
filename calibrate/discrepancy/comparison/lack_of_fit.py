"""Is there any gap beyond scatter, and is there any left once an effect is in?

Three statistics of a projected residual: its length (any gap), its largest admissible score
(a gap like a candidate effect), and its largest kernel score (a smooth gap).  The
smallest of their three p-values counts, judged by simulation, so that asking three
questions costs no false alarms.  The simulation repeats everything that is estimated: it
draws specimens, simulated ones too, re-estimates covariance and amplitudes, projects.
Therefore it holds its rate although the covariance is known from few specimens only.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.noise import Shape, best_shape, estimate
from calibrate.discrepancy.comparison.projection import Projected, admissible, lengths, project
from calibrate.discrepancy.comparison.repeats import Measured
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
    """Simulated statistics without any gap (`before`) and after the best effect where one is
    true (`after`); inflation: mean square of the scores without any gap (1 for a known
    covariance)."""

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
    """The three statistics of a projected residual (m,): effects (m, k), kernels' factors."""
    z = effects.T @ residual / lengths(effects)
    largest = admissible(z, one_sided).max(initial=0.0)
    return np.array([residual @ residual, largest, kernel_scores(kernel, residual).max()])


def statistics_after(
    design: Projected, chosen: list[int], one_sided: np.ndarray, kernel: Factors
) -> np.ndarray:
    """The same after the best strengths of the chosen effects have been taken off."""
    basis, _ = np.linalg.qr(design.effects[:, chosen])
    rest = np.array([k for k in range(design.effects.shape[1]) if k not in chosen], int)
    others = _off(design.effects[:, rest], basis)
    left = _off(design.residual, basis)
    visible = lengths(others) > 1e-6 * np.maximum(lengths(design.effects[:, rest]), 1e-9)
    without = [_off(factor, basis) for factor in kernel]
    return statistics(left, others[:, visible], one_sided[rest][visible], without)


def simulate(generator: SampleGenerator, seed: int, draws: int = DRAWS) -> NullDistributions:
    """The null distributions for a description and a plan of measurement."""
    rng = np.random.default_rng(seed)
    d = generator.description
    residuals = d.packing_residuals - d.packing_residuals.mean(axis=0)
    shape = best_shape(residuals)
    before, after, squares = [], [], []
    for _ in range(draws):
        design, kernel = _analysed(generator, shape, rng, generator.measured(rng))
        before.append(statistics(design.residual, design.effects, d.one_sided, kernel))
        squares.append(_mean_square(design))
        if d.effects:
            design, kernel = _analysed(generator, shape, rng, _with_an_effect(generator, rng))
            z = design.effects.T @ design.residual / lengths(design.effects)
            best = int(np.argmax(admissible(z, d.one_sided)))
            after.append(statistics_after(design, [best], d.one_sided, kernel))
    return NullDistributions(
        null_distribution(np.array(before)),
        null_distribution(np.array(after or before)),
        float(np.mean(squares)),
    )


def _analysed(
    generator: SampleGenerator, shape: Shape, rng: np.random.Generator, measured: Measured
):
    """Projected design and kernels of one draw, with everything estimated anew."""
    d = generator.description
    noise = estimate(d, measured, shape.of(generator.simulated(rng)), d.prior_sd**2)
    residual = measured.mean - d.mean
    design = project(residual, d.base_slopes, d.prior_sd, d.effect_slopes, noise.mean)
    return design, projected(kernel_factors(d.features, noise.specimen), design.operator)


def _with_an_effect(generator: SampleGenerator, rng: np.random.Generator) -> Measured:
    """Data with one effect at a signal-to-noise drawn from `TRUE_SNR`."""
    d = generator.description
    k = int(rng.integers(len(d.effects)))
    sign = 1.0 if d.effects[k].one_sided else rng.choice([-1.0, 1.0])
    snr = rng.uniform(*TRUE_SNR)
    gap = sign * snr * d.effect_slopes[:, k] / generator.snr(d.effect_slopes[:, [k]])[0]
    return generator.measured(rng, gap=gap)


def _mean_square(design: Projected) -> float:
    """Mean square of the scores, or of the residual where there are no effects."""
    if not design.effects.shape[1]:
        return float(np.mean(design.residual**2))
    return float(np.mean((design.effects.T @ design.residual / lengths(design.effects)) ** 2))


def _off(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """`values` (m, n) or (m,) without their part in the span of `basis` (m, q)."""
    return values - basis @ (basis.T @ values)
