"""Where the gap lies.  Residuals of the best base fit, by test and by segment.

    r = y - f(delta)      Cov r = V Sigma^-1 ... = (I - H) V (I - H)',  V = Sigma + B P B'

H is the operator of the base fit.  Bands are simultaneous over all features (sup-t by simulation).
A segment's share of the misfit is its part of the squared length of the residual whitened by the
symmetric root of V's correlation (ZCA-cor: Kessy, Lewin and Strimmer 2018), the whitening that
stays closest to the features.  One test is predicted from the other by base parameters fitted to
this one, with prior, and carried over by B cov(delta) B'.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg
from scipy.special import chdtrc

from calibrate.discrepancy.comparison.generated import normal, root_of
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.labtests.diagnosis.curves import segments_of, tests_of

LEVEL = 0.95
SIMULATED = 2000


@dataclass(frozen=True)
class SegmentResidual:
    """A segment's mean residual, measured minus simulated, in its unit and over its standard
    error (z); whether it leaves the simultaneous band; its share of the misfit with an
    interval (90 %), and the share it would have by chance."""

    test: str
    segment: str
    gap: float
    unit: str
    z: float
    outside_band: bool
    share: float
    share_interval: tuple[float, float]
    share_by_chance: float

    @property
    def holds(self) -> bool:
        """Whether the interval holds its share: a small one lies below all that chance adds."""
        low, high = self.share_interval
        return low <= self.share <= high


@dataclass(frozen=True)
class CrossTest:
    """One test predicted from the other: p-value of a perfect prediction, and the factor by which
    the measured values of its commonest unit are larger than predicted, with its standard error."""

    predicted: str
    p_value: float
    factor: float
    factor_se: float


@dataclass(frozen=True, eq=False)
class Localisation:
    """Residual (m,) with standard error and half-width of the simultaneous band (m,), by
    segment, and across tests."""

    residual: np.ndarray
    deviation: np.ndarray
    band: np.ndarray
    segments: tuple[SegmentResidual, ...]
    across: tuple[CrossTest, ...]


def localise(
    description: Linearised, measured: Measured, noise: Noise, base: Refit, seed: int
) -> Localisation:
    """Locates the gap of a sample, given its base fit."""
    rng = np.random.default_rng(seed)
    prior = np.diag(description.prior_sd**2)
    marginal = noise.mean + base.base_slopes @ prior @ base.base_slopes.T
    keep = _residual_maker(base.base_slopes, description.prior_sd, noise.mean)
    covariance = keep @ marginal @ keep.T
    residual = measured.mean - base.values
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    critical = sup_t(covariance, freedom_of(measured), rng)
    return Localisation(
        residual,
        deviation,
        critical * deviation,
        _segments(description, base.working, residual, covariance, marginal, critical, rng),
        _across(tests_of(description.features), measured, marginal, base),
    )


def sup_t(covariance: np.ndarray, freedom: int, rng: np.random.Generator) -> float:
    """Critical value of the largest of |t| over all features, by simulation."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    correlation = covariance / np.outer(deviation, deviation)
    draws = normal(rng, root_of(correlation), SIMULATED)
    scale = np.sqrt(freedom / rng.chisquare(freedom, SIMULATED))
    return float(np.quantile(np.abs(draws).max(axis=1) * scale, LEVEL))


def freedom_of(measured: Measured, carrying: int = 5) -> int:
    """Degrees of freedom behind the scale of the noise: those of the repeats times the few modes
    that carry their scatter; 4 without repeats."""
    found = [s.freedom * min(carrying, len(s.products)) for s in measured.scatter.values()]
    return max(min(found), 1) if found else 4


def _across(tests: np.ndarray, measured: Measured, marginal: np.ndarray, base: Refit):
    """Each test predicted from the other."""
    found = []
    for name in dict.fromkeys(tests):
        mine, other = np.flatnonzero(tests == name), np.flatnonzero(tests != name)
        if len(other):
            found.append(_predicted(name, mine, other, marginal, base, measured))
    return tuple(found)


def _predicted(name, mine, other, marginal, base: Refit, measured: Measured) -> CrossTest:
    carry = np.linalg.solve(marginal[np.ix_(other, other)], marginal[np.ix_(other, mine)]).T
    expected = carry @ base.working[other]
    difference = base.working[mine] - expected
    covariance = marginal[np.ix_(mine, mine)] - carry @ marginal[np.ix_(other, mine)]
    alike = _of_the_commonest_unit([measured.features[i].unit for i in mine])
    prediction = (measured.mean[mine] - difference)[alike]
    weighted = np.linalg.solve(covariance[np.ix_(alike, alike)], prediction)
    information = float(prediction @ weighted)
    chi2 = float(difference @ np.linalg.solve(covariance, difference))
    return CrossTest(
        predicted=name,
        p_value=float(chdtrc(len(mine), chi2)),
        factor=1 + float(weighted @ difference[alike]) / information,
        factor_se=information**-0.5,
    )


def _of_the_commonest_unit(units: Sequence[str]) -> np.ndarray:
    """Indices of features of the commonest unit: force and displacement have no common factor."""
    names, counts = np.unique(units, return_counts=True)
    return np.flatnonzero(np.array(units) == names[counts.argmax()])


def _segments(description, working, residual, covariance, marginal, critical, rng):
    white, shares = _shares_by_feature(working, marginal)
    drawn = white + rng.standard_normal((SIMULATED, len(white)))
    drawn = drawn**2 / (drawn**2).sum(axis=1, keepdims=True)
    found = []
    for test, segment, index in segments_of(description.features):
        for unit in dict.fromkeys(description.features[i].unit for i in index):
            rows = np.array([i for i in index if description.features[i].unit == unit])
            gap = float(residual[rows].mean())
            error = np.sqrt(covariance[np.ix_(rows, rows)].mean())
            low, high = np.quantile(drawn[:, rows].sum(axis=1), [0.05, 0.95])
            edge = critical * np.sqrt(np.diag(covariance)[rows])
            found.append(
                SegmentResidual(
                    test=test,
                    segment=segment,
                    gap=gap,
                    unit=unit,
                    z=float(gap / max(error, 1e-300)),
                    outside_band=bool((np.abs(residual[rows]) > edge).any()),
                    share=float(shares[rows].sum()),
                    share_interval=(float(low), float(high)),
                    share_by_chance=len(rows) / len(residual),
                )
            )
    return tuple(found)


def _shares_by_feature(residual: np.ndarray, marginal: np.ndarray):
    """ZCA-cor whitened residual (m,), and each feature's share of its squared length."""
    deviation = np.sqrt(np.diag(marginal))
    values, vectors = np.linalg.eigh(marginal / np.outer(deviation, deviation))
    root = (vectors / np.sqrt(np.maximum(values, 1e-10))) @ vectors.T
    white = root @ (residual / deviation)
    return white, white**2 / max(float(white @ white), 1e-300)


def _residual_maker(base_slopes, prior_sd, covariance) -> np.ndarray:
    """I - H of the base fit, shape (m, m)."""
    weighted = linalg.solve(covariance, base_slopes, assume_a="pos")
    spread = np.linalg.inv(base_slopes.T @ weighted + np.diag(1 / prior_sd**2))
    return np.eye(len(covariance)) - base_slopes @ spread @ weighted.T
