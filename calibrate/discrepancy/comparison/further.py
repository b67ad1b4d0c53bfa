"""A further test, and what an explanation predicts for it from the data at hand.

    y | h ~ f(delta, e) + t((S/n + J C J' + W W'), FREEDOM)

(delta, e) is the best fit of explanation h to the data at hand, C its covariance there (Laplace's),
J the slopes of the further test, S the scatter of one specimen, n repeats, W directions in which
simulations may be wrong.  The multivariate t has heavy tails, so that a test that nothing foresees
decides less than a normal density would say (Lange, Little and Taylor 1989).

What has no name yet ("unknown") is still there in a further test of soil: it predicts what the base
fit leaves of the same features now, give or take half of that, and nothing for a machine by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import gammaln
from scipy.stats import f as fisher

from calibrate.discrepancy.comparison.linear import Emulator, Linearised
from calibrate.discrepancy.comparison.refit import STRENGTH_SD, Refit

FREEDOM = 5.0
CHANGES = 0.5  # share of an unknown gap by which it may differ in a further test


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """A response that is linear: mean (m,), slopes (m, p) and (m, k)."""

    mean: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray

    def __call__(self, delta: np.ndarray, strengths: np.ndarray):
        values = self.mean + self.base_slopes @ delta + self.effect_slopes @ strengths
        return values, self.base_slopes, self.effect_slopes

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        return np.zeros((len(self.mean), 0))


@dataclass(frozen=True, eq=False)
class FurtherTest:
    """A feasible test: its name, cost (h of a technician), fresh specimens, labels of its features,
    response, covariance of one specimen (m, m), repeats; `rows` are those of the data at hand that
    it shows again (none: a test without soil); `entries` of its table in a lab file."""

    name: str
    cost: float
    labels: tuple[str, ...]
    response: Emulator
    specimen: np.ndarray
    repeats: int
    specimens: int = 0
    rows: np.ndarray | None = None
    entries: Mapping[str, str | bool] = field(default_factory=dict)

    @property
    def noise(self) -> np.ndarray:
        """Covariance (m, m) of the mean of its repeats."""
        return self.specimen / self.repeats


@dataclass(frozen=True, eq=False)
class Prediction:
    """Location (m,) and scale matrix (m, m) of a further test under one explanation."""

    mean: np.ndarray
    covariance: np.ndarray

    @cached_property
    def _lower(self) -> np.ndarray:
        return np.linalg.cholesky(self.covariance + 1e-12 * np.diag(np.diag(self.covariance)))

    def log_density(self, found: np.ndarray) -> np.ndarray:
        """ln density (...) of outcomes (..., m)."""
        m, away = len(self.mean), self.distance(found)
        half = 0.5 * (FREEDOM + m)
        front = gammaln(half) - gammaln(0.5 * FREEDOM) - 0.5 * m * np.log(FREEDOM * np.pi)
        level = front - np.log(np.diag(self._lower)).sum()
        return level - half * np.log1p(away / FREEDOM)

    def distance(self, found: np.ndarray) -> np.ndarray:
        """Squared distance (...) of outcomes (..., m), in deviations."""
        left = np.atleast_2d(found) - self.mean
        white = solve_triangular(self._lower, left.T, lower=True)
        return (white**2).sum(axis=0).reshape(np.shape(found)[:-1])

    def p_value(self, found: np.ndarray) -> float:
        """Chance of an outcome (m,) as far away as this one."""
        m = len(self.mean)
        return float(fisher.sf(self.distance(found) / m, m, FREEDOM))

    def drawn(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Outcomes (count, m)."""
        normal = rng.standard_normal((count, len(self.mean))) @ self._lower.T
        heavy = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, count))
        return self.mean + heavy[:, None] * normal


def fit_covariance(d: Linearised, fit: Refit) -> np.ndarray:
    """Covariance (p + q, p + q) of a fit's shift and chosen strengths (Laplace)."""
    columns = np.hstack([fit.base_slopes, fit.effect_slopes[:, list(fit.chosen)]])
    prior = np.concatenate([d.prior_sd, np.full(len(fit.chosen), STRENGTH_SD)])
    normal = columns.T @ np.linalg.solve(fit.covariance, columns)
    return np.linalg.inv(normal + np.diag(prior**-2.0))


def predicted(test: FurtherTest, d: Linearised, fit: Refit) -> Prediction:
    """What an explanation, by its fit to the data at hand, predicts for a further test."""
    values, base, effects = test.response(fit.delta, fit.strengths)
    slopes = np.hstack([base, effects[:, list(fit.chosen)]])
    wrong = test.response.wrong(fit.delta, fit.strengths)
    spread = slopes @ fit_covariance(d, fit) @ slopes.T + wrong @ wrong.T
    return Prediction(values, test.noise + spread)


def predicted_by_unknown(
    test: FurtherTest, d: Linearised, base: Refit, measured: np.ndarray
) -> Prediction:
    """What a cause of no name predicts; measured (m,): means of the data at hand."""
    plain = predicted(test, d, base)
    if test.rows is None:
        return plain
    left = np.where(test.rows < 0, 0.0, (measured - base.values)[test.rows])
    return Prediction(plain.mean + left, plain.covariance + CHANGES**2 * np.outer(left, left))


def stacked(tests: Sequence[FurtherTest]) -> FurtherTest:
    """Several further tests as one, whose outcomes share the soil and the effects."""
    rows = [np.full(len(t.labels), -1) if t.rows is None else t.rows for t in tests]
    return FurtherTest(
        " and ".join(t.name for t in tests), sum(t.cost for t in tests),
        tuple(label for t in tests for label in t.labels), _Stacked([t.response for t in tests]),
        np.asarray(block_diag(*(t.noise for t in tests))), 1, sum(t.specimens for t in tests),
        np.concatenate(rows),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Stacked:
    """Responses one below the other."""

    parts: Sequence[Emulator]

    def __call__(self, delta, strengths):
        found = zip(*(part(delta, strengths) for part in self.parts), strict=True)
        values, base, effects = (np.concatenate(rows) for rows in found)
        return values, base, effects

    def wrong(self, delta, strengths):
        return np.asarray(block_diag(*(part.wrong(delta, strengths) for part in self.parts)))
