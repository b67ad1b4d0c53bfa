"""A further test, and what an explanation predicts for it from the data at hand.

    y | h ~ f(delta, e) + W u + r/2 + t(S/n + (J, W) C (J, W)' + r r'/4, FREEDOM)

(delta, e) is the best fit of explanation h to the data at hand, W directions in which simulations
may be wrong, u what the data say of these errors, C the covariance of delta, e and u there
(Laplace's), J the slopes of the further test, S the scatter of one specimen, n repeats, r what is
left of the data at hand.  Heavy tails let a test that nothing foresees decide less (Lange, Little
and Taylor 1989).

What an explanation leaves is partly scatter, which goes, and partly what the simulator is wrong by:
half of it is expected again in a test of the same soil, give or take half.  A cause of no name
("unknown") predicts all that base fit and errors leave of the same features, give or take half of
that, and nothing for a machine by itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.special import fdtrc, gammaln

from calibrate.discrepancy.comparison.linear import Emulator, Linearised
from calibrate.discrepancy.comparison.refit import STRENGTH_SD, Refit

FREEDOM = 5.0
ALL = 1.0  # of what a cause of no name leaves
STAYS = 0.5  # share of what any other explanation leaves that is expected again in a further test
CHANGES = 0.5  # share of it by which this may differ


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """A response that is linear: mean (m,), slopes (m, p) and (m, k); shares (k,) of what each
    effect does by which it may differ, as a whole and in each feature by itself."""

    mean: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray
    as_a_whole: np.ndarray | float = 0.0
    by_feature: np.ndarray | float = 0.0

    def __call__(self, delta: np.ndarray, strengths: np.ndarray):
        values = self.mean + self.base_slopes @ delta + self.effect_slopes @ strengths
        return values, self.base_slopes, self.effect_slopes

    def of_rows(self, keep: np.ndarray) -> "LinearResponse":
        """The response of some of the features."""
        return replace(
            self, mean=self.mean[keep], base_slopes=self.base_slopes[keep],
            effect_slopes=self.effect_slopes[keep],
        )  # fmt: skip

    def wrong(self, delta: np.ndarray, strengths: np.ndarray) -> np.ndarray:
        return np.zeros((len(self.mean), 0))

    def scatter(self, strengths: np.ndarray) -> np.ndarray:
        done = self.effect_slopes * strengths
        whole, apart = done * self.as_a_whole, done * self.by_feature
        return whole @ whole.T + np.diag((apart**2).sum(axis=1))


class Response(Emulator, Protocol):
    """What a further test shows; `scatter` is the covariance (m, m) of the mean of its repeats by
    what effects do otherwise than their formulas say."""

    def scatter(self, strengths: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class FurtherTest:
    """A feasible test: its name, cost (h of a technician), labels of its features, response,
    covariance of one specimen (m, m), repeats, fresh specimens; `rows` of the data at hand that it
    shows again (none: a test without soil); `entries` of its table in a lab file."""

    name: str
    cost: float
    labels: tuple[str, ...]
    response: Response
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
        return float(fdtrc(m, FREEDOM, self.distance(found) / m))

    def drawn(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Outcomes (count, m)."""
        normal = rng.standard_normal((count, len(self.mean))) @ self._lower.T
        heavy = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, count))
        return self.mean + heavy[:, None] * normal


@dataclass(frozen=True, eq=False)
class LaplacePosterior:
    """What the data at hand say of a fit: covariance (p + q + r, p + q + r) of its shift, chosen
    strengths and the emulator's errors along their directions, and these errors' mean (r,)."""

    covariance: np.ndarray
    errors: np.ndarray


def laplace_posterior(d: Linearised, fit: Refit, measured: np.ndarray) -> LaplacePosterior:
    """Laplace's approximation at a fit to measured means (m,)."""
    wrong = d.wrong_at(fit.delta, fit.strengths)
    chosen = list(fit.chosen)
    columns = np.hstack([fit.base_slopes, fit.effect_slopes[:, chosen], wrong])
    strengths, errors = np.full(len(chosen), STRENGTH_SD), np.ones(wrong.shape[1])
    prior = np.concatenate([d.prior_sd, strengths, errors]) ** 2
    moved = len(prior) - len(errors)
    spread = columns[:, :moved] * prior[:moved]
    whole = fit.covariance + spread @ columns[:, :moved].T  # fit.covariance holds the errors'
    told = np.outer(prior, prior) * (columns.T @ np.linalg.solve(whole, columns))
    left = np.linalg.solve(fit.covariance, measured - fit.values)
    return LaplacePosterior(np.diag(prior) - (told + told.T) / 2, wrong.T @ left)


def predicted(
    test: FurtherTest, d: Linearised, fit: Refit, measured: np.ndarray, stays: float = STAYS
) -> Prediction:
    """What an explanation, by its fit to the data at hand, predicts for a further test; measured
    (m,): means of these data; stays: share of what the fit leaves of them that comes again.  Where
    the emulator errs for a soil it errs in the same way when the test is made again."""
    values, base, effects = test.response(fit.delta, fit.strengths)
    of_data = laplace_posterior(d, fit, measured)
    wrong = widened(test.response.wrong(fit.delta, fit.strengths), len(of_data.errors))
    slopes = np.hstack([base, effects[:, list(fit.chosen)], wrong])
    left = unexplained(test, d, fit, measured, of_data)
    spread = slopes @ of_data.covariance @ slopes.T + CHANGES**2 * np.outer(left, left)
    noise = test.noise + test.response.scatter(fit.strengths)
    return Prediction(values + wrong @ of_data.errors + stays * left, noise + spread)


def unexplained(
    test: FurtherTest, d: Linearised, fit: Refit, measured: np.ndarray, of_data: LaplacePosterior
) -> np.ndarray:
    """What a fit and the emulator's errors leave of a further test's features (m,) in the data at
    hand; nothing of those that these do not show."""
    if test.rows is None:
        return np.zeros(len(test.labels))
    left = measured - fit.values - d.wrong_at(fit.delta, fit.strengths) @ of_data.errors
    return np.where(test.rows < 0, 0.0, left[test.rows])


def widened(wrong: np.ndarray, count: int) -> np.ndarray:
    """Directions (m, count) of errors; none (m, 0) of what is no emulator's are zeros."""
    return wrong if wrong.shape[1] else np.zeros((len(wrong), count))


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

    parts: Sequence[Response]

    def __call__(self, delta, strengths):
        found = zip(*(part(delta, strengths) for part in self.parts), strict=True)
        values, base, effects = (np.concatenate(rows) for rows in found)
        return values, base, effects

    def wrong(self, delta, strengths):
        found = [part.wrong(delta, strengths) for part in self.parts]
        return np.vstack([widened(each, max(w.shape[1] for w in found)) for each in found])

    def scatter(self, strengths):
        return np.asarray(block_diag(*(part.scatter(strengths) for part in self.parts)))
