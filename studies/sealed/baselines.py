"""What is usually done instead, to be measured against on the same cases.

    majority     always the commonest answer of generated cases
    template     the residual's direction against raw signatures, points as independent
    bic          refit of each effect, independent noise of one unknown scale in each test, BIC
    classifier   multinomial logistic regression on whitened residuals of generated cases

All see the same measured mean and the same description.  None of them can say "unknown",
except the classifier, which is trained on such cases.

Cases are generated from the description (`generated.SampleGenerator`): of twelve, four have no gap,
five a single effect (signal-to-noise 0.5-2, 2-6 and 6-15), one has a pair, and two have gaps that
no candidate effect explains: half of these are an effect that is excluded with its class, the other
half smooth random ones.  These are about the shares of withheld sets.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp

from calibrate.discrepancy.comparison.compare import Prepared
from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.projection import admissible, fitted_shift
from calibrate.discrepancy.comparison.refit import refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.unspecified_gap import kernel_factors
from calibrate.labtests.diagnosis.curves import tests_of

RIDGE = 1.0  # of the classifier's weights
STRATA = ((0.5, 2.0), (2.0, 6.0), (6.0, 15.0))  # of generated cases' signal-to-noise
KINDS = (NONE, "single", UNKNOWN, NONE, "single", "pair", NONE, "single", UNKNOWN, NONE,
         "single", "single")  # of generated cases, in turn  # fmt: skip


def majority(labels: Sequence[str]) -> str:
    """The commonest label."""
    names, counts = np.unique(np.array(labels), return_counts=True)
    return str(names[int(np.argmax(counts))])


def template_scores(description: Linearised, measured: Measured) -> np.ndarray:
    """Match (k,) of the fitted base model's residual with each raw signature, in units of the
    independent scatter of points."""
    variance = _point_variance(description, measured)
    fit = refit(description, measured.mean, np.diag(variance))
    residual = (measured.mean - fit.values) / np.sqrt(variance)
    shapes = fit.effect_slopes / np.sqrt(variance)[:, None]
    match = shapes.T @ residual / np.maximum(np.linalg.norm(shapes, axis=0), 1e-12)
    return admissible(match, description.one_sided)


def template(description: Linearised, measured: Measured, least: float) -> str:
    """The best match, or none where it is below `least` (to be set by null cases)."""
    match = template_scores(description, measured)
    best = int(np.argmax(match))
    return description.effect_names[best] if match[best] > least else NONE


def bic(description: Linearised, measured: Measured) -> str:
    """The effect whose refit has the lowest BIC, or none."""
    criteria = {
        key: _criterion(description, measured, key)
        for key in [(), *((k,) for k in range(len(description.effects)))]
    }
    best = min(criteria, key=lambda key: criteria[key])
    return description.effect_names[best[0]] if best else NONE


@dataclass(frozen=True, eq=False)
class Classifier:
    """Multinomial logistic regression: labels, scaling and weights (m + 1, labels)."""

    labels: tuple[str, ...]
    centre: np.ndarray
    scale: np.ndarray
    weights: np.ndarray

    def probability(self, inputs: np.ndarray) -> np.ndarray:
        """Probabilities (labels,) for inputs (m,)."""
        score = _with_one((inputs - self.centre) / self.scale) @ self.weights
        return np.exp(score - logsumexp(score))

    def best(self, inputs: np.ndarray) -> str:
        """The likeliest label."""
        return self.labels[int(np.argmax(self.probability(inputs)))]


def train(inputs: np.ndarray, labels: Sequence[str]) -> Classifier:
    """Fits the classifier to inputs (n, m) with labels, by penalised likelihood."""
    names = tuple(sorted(set(labels)))
    target = np.array([[label == name for name in names] for label in labels], float)
    centre, scale = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-9)
    design = _with_one((inputs - centre) / scale)

    def loss(flat: np.ndarray):
        weights = flat.reshape(design.shape[1], len(names))
        score = design @ weights
        log_p = score - logsumexp(score, axis=1, keepdims=True)
        value = -(target * log_p).sum() + 0.5 * RIDGE * (weights[:-1] ** 2).sum()
        slope = design.T @ (np.exp(log_p) - target)
        slope[:-1] += RIDGE * weights[:-1]
        return value, slope.ravel()

    start = np.zeros(design.shape[1] * len(names))
    found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
    return Classifier(names, centre, scale, found.x.reshape(design.shape[1], len(names)))


def classifier_inputs(
    description: Linearised, measured: Measured, covariance: np.ndarray
) -> np.ndarray:
    """Residual (m,) of the linear base fit, whitened by the covariance of the mean."""
    residual = measured.mean - description.mean
    shift, _ = fitted_shift(residual, description.base_slopes, description.prior_sd, covariance)
    lower = np.linalg.cholesky(covariance)
    return np.linalg.solve(lower, residual - description.base_slopes @ shift)


def _point_variance(description: Linearised, measured: Measured) -> np.ndarray:
    """Variance (m,) of each mean from its own repeats, or from packings without repeats."""
    variance = description.packing_residuals.var(axis=0, ddof=1)
    tests = tests_of(description.features)
    for test, scatter in measured.scatter.items():
        variance[tests == test] = np.diag(scatter.products) / scatter.freedom
    floor = 1e-3 * description.packing_residuals.var(axis=0, ddof=1)
    return np.maximum(variance, floor + 1e-300) / measured.counts


def _criterion(description: Linearised, measured: Measured, key: tuple[int, ...]) -> float:
    """BIC with one unknown factor for each test on the variances of points."""
    tests = tests_of(description.features)
    variance = _point_variance(description, measured)
    fit = refit(description, measured.mean, np.diag(variance), key)
    residual = (measured.mean - fit.values) / np.sqrt(variance)
    n = len(residual)
    total = 0.0
    for test in dict.fromkeys(tests):
        mine = residual[tests == test]
        total += len(mine) * np.log(np.mean(mine**2))
    return float(total + (len(description.prior_sd) + len(key)) * np.log(n))


def _with_one(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, np.ones((*values.shape[:-1], 1))], axis=-1)


@dataclass(frozen=True, eq=False)
class GeneratedCase:
    """A generated sample, what is true of it, and the effects that are no candidates."""

    measured: Measured
    truth: tuple[str, ...]
    excluded_effects: tuple[str, ...]
    snr: float


def generated_case(prepared: Prepared, rng: np.random.Generator, kind: str) -> GeneratedCase:
    """One case of a kind."""
    generator, names = prepared.generator, prepared.description.effect_names
    snr = float(rng.uniform(*STRATA[rng.integers(len(STRATA))]))
    strengths = np.zeros(len(names))
    if kind == NONE or not names:
        return GeneratedCase(generator.sample(generator.specimens(rng)), (NONE,), (), 0.0)
    if kind == UNKNOWN and rng.random() < 0.5:
        drawn = generator.specimens(rng, gap=smooth_gap(generator, rng, snr))
        return GeneratedCase(generator.sample(drawn), (UNKNOWN,), (), snr)
    count = 2 if kind == "pair" and len(names) > 1 else 1
    chosen = [int(k) for k in rng.permutation(len(names))[:count]]
    for k in chosen:
        strengths[k] = _signed(prepared, rng, k, snr)
    measured = generator.sample(generator.specimens(rng, strengths))
    if kind == UNKNOWN:
        return GeneratedCase(measured, (UNKNOWN,), prepared.classes.of(names[chosen[0]]), snr)
    return GeneratedCase(measured, tuple(names[k] for k in chosen), (), snr)


def strength_of(generator: SampleGenerator, effect: int, snr: float) -> float:
    """Strength of an effect that has this signal-to-noise."""
    return float(snr / generator.snr(generator.description.effect_slopes[:, [effect]])[0])


def smooth_gap(generator: SampleGenerator, rng: np.random.Generator, snr: float) -> np.ndarray:
    """A smooth gap (m,) of no particular cause, at a signal-to-noise."""
    every = kernel_factors(generator.description.features, generator.specimen)
    factor = every[rng.integers(len(every))]
    gap = factor @ rng.standard_normal(factor.shape[1])
    return gap * snr / generator.snr(gap[:, None])[0]


def _signed(prepared: Prepared, rng: np.random.Generator, k: int, snr: float) -> float:
    """A strength with this signal-to-noise, of either sign where both are possible."""
    strength = strength_of(prepared.generator, k, snr)
    one_sided = prepared.description.effects[k].one_sided
    return strength if one_sided or rng.random() < 0.5 else -strength
