"""How far specimens scatter: the covariance of one specimen's features, and of their mean.

    S(a) = A (S_packing + S_extra) A + S_sensor          A = diag(a of the feature's test)
    Sigma = S(a) * shared/(n n') + S_packing / n_mean + slope errors + W W'

S_packing comes from simulated specimens, as factors and a diagonal or shrunk towards its
diagonal, whichever predicts held-out specimens best.  From repeats come the amplitudes a, one
for each test (restricted likelihood with a log-normal prior about 1), and then, along each
principal direction of a test's S by itself, a factor on the variance:

    (PRIOR_FREEDOM + sum of squares of repeats over S)/(PRIOR_FREEDOM + their freedom)

the posterior scale of a variance under its conjugate prior, a scaled inverse chi-square about 1
(Gelman et al., Bayesian data analysis, section 2.6): a mean that one slipping specimen has pulled
is no gap.  W are the directions in which the description may be wrong.  How far amplitude and
factors may go: docs/decisions/2026-11-26-scatter-and-misfit.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.projection import leading_modes
from calibrate.discrepancy.comparison.repeats import Measured, Scatter, products
from calibrate.labtests.diagnosis.curves import tests_of

PRIOR_SD_LN_AMPLITUDE = 0.25
FOLDS = 5
SMALLEST_UNIQUENESS = 1e-3  # share of a feature's variance that no factor explains, at least
SMALLEST = 1e-9  # variance along a direction, of a correlation matrix
CARRYING = 0.98  # of the scatter's variance: the modes from which the amplitude is judged
PRIOR_FREEDOM = 4.0  # of the variance along one direction
GRID = np.linspace(-1.6, 1.6, 161)  # of ln a


@dataclass(frozen=True)
class Shape:
    """How a covariance is regularised: `factors` kept, or `weight` of the diagonal."""

    factors: int = 0
    weight: float = 0.0

    def of(self, samples: np.ndarray) -> np.ndarray:
        """Covariance (m, m) of centred samples (n, m)."""
        freedom = max(len(samples) - 1, 1)
        deviation = np.sqrt((samples**2).sum(axis=0) / freedom)
        safe = np.where(deviation > 0, deviation, 1.0)
        correlation = (samples / safe).T @ (samples / safe) / freedom
        np.fill_diagonal(correlation, 1.0)
        kept = self._factors(correlation) if self.factors else self._shrunk(correlation)
        return kept * np.outer(deviation, deviation)

    def _shrunk(self, correlation: np.ndarray) -> np.ndarray:
        off = (1 - self.weight) * correlation
        np.fill_diagonal(off, 1.0)
        return off

    def _factors(self, correlation: np.ndarray) -> np.ndarray:
        values, vectors = np.linalg.eigh(correlation)
        loadings = vectors[:, -self.factors :] * np.sqrt(np.maximum(values[-self.factors :], 0))
        common = loadings @ loadings.T
        unique = np.maximum(1 - np.diag(common), SMALLEST_UNIQUENESS)
        return common + np.diag(unique)


SHAPES = tuple(Shape(factors=q) for q in (1, 2, 3, 4, 5, 6, 8, 10, 13, 16)) + tuple(
    Shape(weight=w) for w in (0.001, 0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 1.0)
)


@dataclass(frozen=True, eq=False)
class Noise:
    """Covariance of one specimen (m, m), the amplitudes by test with the deviations of
    their logarithms, and the covariance (m, m) of measured minus simulated mean."""

    specimen: np.ndarray
    mean: np.ndarray
    amplitudes: dict[str, float]
    ln_amplitude_sd: dict[str, float]

    @property
    def ln_scale_sd(self) -> float:
        """Deviation of the logarithm of the noise as a whole (mean over tests)."""
        deviations = list(self.ln_amplitude_sd.values())
        return float(np.sqrt(np.mean(np.square(deviations))))


def best_shape(samples: np.ndarray, shapes: Sequence[Shape] = SHAPES) -> Shape:
    """The shape that predicts held-out specimens, centred (n, m), best (cross-validated normal
    likelihood); features that never vary are ignored."""
    varying = samples[:, samples.std(axis=0) > 0]
    if varying.shape[1] < 2:
        return Shape(weight=0.0)
    scaled = varying / varying.std(axis=0)
    fold = np.arange(len(scaled)) % FOLDS
    scores = [
        sum(_log_likelihood(s, scaled[fold != f], scaled[fold == f]) for f in range(FOLDS))
        for s in shapes
    ]
    return shapes[int(np.argmax(scores))]


def packing_covariance(description: Linearised, shape: Shape | None = None) -> np.ndarray:
    """Regularised covariance (m, m) of simulated specimens."""
    samples = description.packing_residuals - description.packing_residuals.mean(axis=0)
    return (shape or best_shape(samples)).of(samples)


def estimate(
    description: Linearised, measured: Measured, packing: np.ndarray, delta_variance: np.ndarray
) -> Noise:
    """The noise of a measured sample, or of many of one plan.

    packing: regularised covariance (..., m, m) of simulated specimens; delta_variance (p,):
    expected squares of the base parameters' shifts, through which errors of slopes act.
    """
    tests = tests_of(description.features)
    scattering, amplitude = packing + description.extra, np.ones(packing.shape[:-1])
    amplitudes, spread = {}, {}
    for test in dict.fromkeys(tests):
        mine = np.flatnonzero(tests == test)
        fixed = description.sensor[np.ix_(mine, mine)]
        found = _amplitudes(scattering[..., mine[:, None], mine], fixed, measured.scatter.get(test))
        amplitudes[test], spread[test] = found
        amplitude[..., mine] = np.asarray(found[0])[..., None]
    wide = products(amplitude) * scattering + description.sensor
    specimen = _as_repeats_scatter(wide, tests, measured)
    model = packing / description.mean_specimens + slope_error(description, packing, delta_variance)
    mean = specimen * measured.weights() + model + description.own_error
    return Noise(specimen, mean, amplitudes, spread)


def _as_repeats_scatter(specimen: np.ndarray, tests: np.ndarray, measured: Measured) -> np.ndarray:
    """The covariance (..., m, m) of a specimen with the variances along each test's principal
    directions as its repeats show them."""
    change = np.zeros(specimen.shape) + np.eye(len(tests))
    for test, scatter in measured.scatter.items():
        mine = np.flatnonzero(tests == test)
        block = specimen[..., mine[:, None], mine]
        deviation = np.sqrt(np.diagonal(block, axis1=-2, axis2=-1))
        values, axes = np.linalg.eigh(block / products(deviation))
        standard = scatter.products / products(deviation)
        along = np.einsum("...ij,...ik,...kj->...j", axes, standard, axes)
        observed = along / np.maximum(values, SMALLEST)
        factor = (PRIOR_FREEDOM + observed) / (PRIOR_FREEDOM + scatter.freedom)
        turned = (axes * np.sqrt(factor)[..., None, :]) @ np.swapaxes(axes, -1, -2)
        change[..., mine[:, None], mine] = deviation[..., None] * turned / deviation[..., None, :]
    return change @ specimen @ np.swapaxes(change, -1, -2)


def _amplitudes(scattering: np.ndarray, fixed: np.ndarray, scatter: Scatter | None) -> tuple:
    """`amplitude_of` each of many samples (..., m_t, m_t), shapes (...)."""
    if scattering.ndim == 2:
        return amplitude_of(scattering, fixed, scatter)
    each = (None if scatter is None else Scatter(p, scatter.freedom) for p in
            (scattering if scatter is None else scatter.products))  # fmt: skip
    found = [amplitude_of(one, fixed, own) for one, own in zip(scattering, each, strict=True)]
    return tuple(np.array(part) for part in zip(*found, strict=True))


def amplitude_of(
    scattering: np.ndarray, fixed: np.ndarray, scatter: Scatter | None
) -> tuple[float, float]:
    """Amplitude a of S = a^2 C + F from repeats, and the deviation of ln a: its posterior mean on a
    grid, by the restricted likelihood of the scatter of repeats within the leading modes of C."""
    log_posterior = -0.5 * (GRID / PRIOR_SD_LN_AMPLITUDE) ** 2
    if scatter is not None:
        lead = leading_modes(scattering, CARRYING)[1]
        common, rest = lead.T @ scattering @ lead, lead.T @ fixed @ lead
        ratio, basis = linalg.eigh(common, rest + 1e-9 * np.trace(common) * np.eye(len(rest)))
        basis = lead @ basis
        observed = np.einsum("ij,ik,kj->j", basis, scatter.products, basis)
        variance = np.exp(2 * GRID)[:, None] * np.maximum(ratio, 0) + 1
        log_posterior = log_posterior - 0.5 * (
            scatter.freedom * np.log(variance) + observed / variance
        ).sum(axis=1)
    weight = np.exp(log_posterior - log_posterior.max())
    weight /= weight.sum()
    mean = float(weight @ GRID)
    return float(np.exp(mean)), float(np.sqrt(weight @ (GRID - mean) ** 2))


def slope_error(
    description: Linearised, packing: np.ndarray, delta_variance: np.ndarray
) -> np.ndarray:
    """Covariance (m, m) of the simulated mean from errors of slopes, correlated as packings are."""
    deviation = np.sqrt(np.maximum(np.diagonal(packing, axis1=-2, axis2=-1), 1e-300))
    correlation = packing / products(deviation)
    errors = description.base_errors
    return np.einsum("ip,p,jp->ij", errors, delta_variance, errors) * correlation


def _log_likelihood(shape: Shape, observed: np.ndarray, held_out: np.ndarray) -> float:
    middle = observed.mean(axis=0)
    try:
        lower = np.linalg.cholesky(shape.of(observed - middle))
    except np.linalg.LinAlgError:
        return -np.inf
    white = linalg.solve_triangular(lower, (held_out - middle).T, lower=True)
    return float(-0.5 * (white**2).sum() - len(held_out) * np.log(np.diag(lower)).sum())
