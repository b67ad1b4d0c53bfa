"""Polynomial response surfaces by least squares.

    y = b0 + sum_j b_j t_j(x) + noise

The t_j are the terms of `calibrate.designs.terms`, the fit is that of statsmodels.  A `Surface`
predicts and gives slopes with their covariance.

Which terms it needs is told by backward elimination that respects hierarchy: a term goes only if no
remaining term contains it, so that the model stays invariant under a change of a factor's origin,
and candidates go one at a time, the least significant first.

Slopes of the response may be fitted with its values:

    y_i = t(x_i) b + noise of variance s0^2,    dy_i/dx_j = dt/dx_j(x_i) b + noise of s_j^2

Each point then gives 1 + p equations instead of one, so a quadratic needs about 1/(1 + p) of
the runs.  The rows are weighted by their variances, of which only the ratios matter: the residuals
set the scale.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from statsmodels.regression.linear_model import OLS, WLS

from calibrate.core.errors import BadValue
from calibrate.designs.terms import Term, Terms, matrix, removable


@dataclass(frozen=True, eq=False)
class Slopes:
    """Gradient (p,) at one point, per coded unit, with covariance (p, p) on `df` degrees."""

    values: np.ndarray
    covariance: np.ndarray
    df: int

    @property
    def se(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


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

    def __call__(self, X: np.ndarray) -> np.ndarray:
        """Predicted means (n,) at points (n, p)."""
        return matrix(self.terms, np.atleast_2d(X)) @ self.coefficients

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


def fit_surface(X: np.ndarray, y: np.ndarray, terms: Terms, names: Sequence[str] = ()) -> Surface:
    """Least squares of responses y (n,) at points X (n, p), coded or natural; `BadValue` if a
    number is not finite or the points cannot tell the terms apart."""
    X, y = np.asarray(X, float), np.asarray(y, float)
    if X.ndim != 2 or y.shape != X.shape[:1]:
        problem = f"points of shape {X.shape} and responses of shape {y.shape}"
        raise BadValue(problem, "give one response for each point", "y")
    if not (np.all(np.isfinite(X)) and np.all(np.isfinite(y))):
        raise BadValue("a point or response is not a finite number", "leave that run out", "y")
    rows = matrix(terms, X)
    check_estimable(rows, terms)
    names = tuple(names) or default_names(X.shape[1])
    return Surface(names, tuple(terms), X, y, OLS(y, rows).fit())


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


# ---------------------------------------------------------------- which terms

ALPHA = 0.05  # p value up to which a term stays


def select_backward(surface: Surface) -> Surface:
    """The surface without terms whose p value exceeds `ALPHA`; `BadValue` for a saturated model."""
    if surface.df < 1:
        raise BadValue("no residual degree of freedom", "start from fewer terms", "terms")
    while True:
        p = dict(zip(surface.terms, np.asarray(surface.fit.pvalues)[1:].tolist(), strict=True))
        worst = max(removable(surface.terms), key=lambda term: p[term], default=None)
        if worst is None or p[worst] <= ALPHA:
            return surface
        surface = without(surface, worst)


def without(surface: Surface, term: Term) -> Surface:
    """The same runs fitted without one term; `BadValue` for a fit of slopes."""
    if surface.slope_rows:
        raise BadValue("this surface was fitted with slopes", "fit the values alone", "surface")
    terms = tuple(other for other in surface.terms if other != term)
    return fit_surface(surface.X, surface.y, terms, surface.names)


# ---------------------------------------------------------------- with slopes


def fit_with_gradients(
    X: np.ndarray,
    y: np.ndarray,
    gradients: np.ndarray,
    terms: Terms,
    sd: tuple[float, Sequence[float]],
) -> Surface:
    """Fits responses y (n,) and slopes (n, p) at points X (n, p), all per coded unit.

    A slope that is NaN was not measured.  `sd` are standard deviations of a response and of its
    slope along each factor (p,).  Intervals suppose that all these errors are independent.
    """
    X, y, gradients = (np.asarray(values, float) for values in (X, y, gradients))
    if gradients.shape != X.shape or y.shape != X.shape[:1]:
        problem = f"slopes of shape {gradients.shape} at points of shape {X.shape}"
        raise BadValue(problem, "give one slope for each factor at each point", "gradients")
    if not np.all(np.isfinite(y)):
        raise BadValue("a response is not a finite number", "leave that run out", "y")
    rows, targets, group = _stacked(X, y, gradients, terms)
    check_estimable(rows, terms)
    variances = np.array([sd[0], *sd[1]]) ** 2
    given: Any = (variances[0] / variances)[group]
    fitted = WLS(targets, rows, weights=given).fit()
    names = default_names(X.shape[1])
    return Surface(names, tuple(terms), X, y, fitted, slope_rows=len(targets) - len(y))


def _stacked(
    X: np.ndarray, y: np.ndarray, gradients: np.ndarray, terms: Terms
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, targets and the group (0: value, j: slope along factor j) of every equation."""
    rows, targets, group = [matrix(terms, X)], [y], [np.zeros(len(y), int)]
    slopes = np.stack([term.slopes(X) for term in terms], axis=-1)  # (n, p, m)
    for factor in range(X.shape[1]):
        known = np.isfinite(gradients[:, factor])
        part = slopes[known, factor]
        rows.append(np.column_stack([np.zeros(len(part)), part]))
        targets.append(gradients[known, factor])
        group.append(np.full(len(part), factor + 1))
    return np.vstack(rows), np.concatenate(targets), np.concatenate(group)
