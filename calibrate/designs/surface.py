"""Polynomial response surfaces by least squares.

    y = b0 + sum_j b_j t_j(x) + noise

The t_j are the terms of `calibrate.designs.terms`, the fit is that of statsmodels.  A `Surface`
predicts with confidence and prediction intervals and gives slopes with their covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from statsmodels.regression.linear_model import OLS, WLS

from calibrate.core.errors import BadValue
from calibrate.designs.terms import Terms, matrix


@dataclass(frozen=True, eq=False)
class Prediction:
    """Means (n,) with the standard errors of a mean and of new runs, in y's unit.

    `mean_interval` (confidence) and `run_interval` (prediction, for the mean of `runs` new runs)
    are (n, 2) and hold with probability `level`, by Student's t with `df` degrees of freedom;
    NaN where the model leaves no degree of freedom.
    """

    mean: np.ndarray
    mean_se: np.ndarray
    run_se: np.ndarray
    mean_interval: np.ndarray
    run_interval: np.ndarray
    df: int
    level: float
    runs: int = 1


@dataclass(frozen=True, eq=False)
class Slopes:
    """Gradient (p,) at one point, per coded unit, with covariance (p, p) on `df` degrees."""

    values: np.ndarray
    covariance: np.ndarray
    df: int

    @property
    def se(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.95) -> np.ndarray:
        """Two-sided intervals (p, 2), one factor at a time."""
        reach = _t_quantile(level, self.df) * self.se
        return np.column_stack([self.values - reach, self.values + reach])


@dataclass(frozen=True, eq=False)
class Surface:
    """A fitted polynomial.

    names (p,) of the factors; terms (m,) without the intercept; points (n, p) and responses
    (n,) that were fitted.  `fit` is statsmodels' `RegressionResults`; it has `slope_rows`
    further rows where slopes were fitted too.
    """

    names: tuple[str, ...]
    terms: Terms
    X: np.ndarray
    y: np.ndarray
    fit: Any
    slope_rows: int = 0

    @property
    def coefficients(self) -> np.ndarray:
        """Intercept, then one for each term: (1 + m,)."""
        return np.asarray(self.fit.params)

    @property
    def covariance(self) -> np.ndarray:
        """Of the coefficients, (1 + m, 1 + m)."""
        return np.asarray(self.fit.cov_params())

    @property
    def df(self) -> int:
        """Degrees of freedom that remain for the residual."""
        return int(self.fit.df_resid)

    @property
    def variance(self) -> float:
        """Residual variance of one run of weight 1; NaN without degrees of freedom."""
        return float(self.fit.scale) if self.df > 0 else np.nan

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(term.label(self.names) for term in self.terms)

    @property
    def weighted(self) -> bool:
        return self.fit.model.weights.ndim > 0 and np.ptp(self.fit.model.weights) > 0

    def __call__(self, X: np.ndarray) -> np.ndarray:
        """Predicted means (n,) at points (n, p)."""
        return matrix(self.terms, np.atleast_2d(X)) @ self.coefficients

    def predict(self, X: np.ndarray, level: float = 0.95, runs: int = 1) -> Prediction:
        """Means at points (n, p) with intervals of probability `level` for `runs` new runs."""
        rows = matrix(self.terms, np.atleast_2d(X))
        mean, t = rows @ self.coefficients, _t_quantile(level, self.df)
        variance = np.einsum("ij,jk,ik->i", rows, self._scaled_covariance(), rows)
        mean_se, run_se = np.sqrt(variance), np.sqrt(variance + self.variance / runs)
        intervals = _around(mean, t * mean_se), _around(mean, t * run_se)
        return Prediction(mean, mean_se, run_se, *intervals, self.df, level, runs)

    def leverage(self, x: np.ndarray) -> float:
        """Variance of the predicted mean at x (p,) over that of a run."""
        row = matrix(self.terms, np.asarray(x, float)[None])[0]
        return float(row @ np.asarray(self.fit.normalized_cov_params) @ row)

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """Slopes (n, p) of the predicted mean at points (n, p), per coded unit."""
        return np.einsum("npm,m->np", self._slope_rows(np.atleast_2d(X)), self.coefficients[1:])

    def slopes(self, x: np.ndarray) -> Slopes:
        """The gradient at one point (p,) with its covariance."""
        rows = self._slope_rows(np.asarray(x, float)[None])[0]
        return Slopes(
            rows @ self.coefficients[1:],
            rows @ self._scaled_covariance()[1:, 1:] @ rows.T,
            self.df,
        )

    def _slope_rows(self, X: np.ndarray) -> np.ndarray:
        """Derivatives (n, p, m) of each term."""
        if not self.terms:
            return np.zeros((*X.shape, 0))
        return np.stack([term.slopes(X) for term in self.terms], axis=-1)

    def _scaled_covariance(self) -> np.ndarray:
        return np.asarray(self.fit.normalized_cov_params) * self.variance


def fit_surface(
    X: np.ndarray,
    y: np.ndarray,
    terms: Terms,
    names: Sequence[str] = (),
    weights: np.ndarray | None = None,
) -> Surface:
    """Least squares of responses y (n,) at points X (n, p), coded or natural.

    `weights` (n,) are inverse variances up to a factor.  `BadValue` if a number is not finite
    or the points cannot tell the terms apart.
    """
    X, y = np.asarray(X, float), np.asarray(y, float)
    if X.ndim != 2 or y.shape != X.shape[:1]:
        problem = f"points of shape {X.shape} and responses of shape {y.shape}"
        raise BadValue(problem, "give one response for each point", "y")
    if not (np.all(np.isfinite(X)) and np.all(np.isfinite(y))):
        raise BadValue("a point or response is not a finite number", "leave that run out", "y")
    rows = matrix(terms, X)
    check_estimable(rows, terms)
    given: Any = weights
    model = OLS(y, rows) if given is None else WLS(y, rows, weights=given)
    names = tuple(names) or default_names(X.shape[1])
    return Surface(names, tuple(terms), X, y, model.fit())


def default_names(factors: int) -> tuple[str, ...]:
    """A, B, C, ... without I, which stands for the intercept."""
    return tuple("ABCDEFGHJKLMNOPQRSTUVWXYZ"[:factors])


def check_estimable(rows: np.ndarray, terms: Terms) -> None:
    """`BadValue` if the rows of a model matrix do not fix every coefficient."""
    scale = np.linalg.norm(rows, axis=0)
    rank = np.linalg.matrix_rank(rows / np.where(scale > 0, scale, 1.0))
    if rank < rows.shape[1]:
        problem = f"{len(rows)} points fix only {rank} of {rows.shape[1]} coefficients"
        raise BadValue(problem, "leave terms out or add points", "terms")
    if np.linalg.matrix_rank(rows) < rows.shape[1]:
        problem = "the terms are too unlike in size for double precision"
        raise BadValue(problem, "fit in coded units", "terms")


def _t_quantile(level: float, df: int) -> float:
    return float(stats.t.ppf((1 + level) / 2, df)) if df > 0 else np.nan


def _around(mean: np.ndarray, reach: np.ndarray) -> np.ndarray:
    return np.column_stack([mean - reach, mean + reach])
