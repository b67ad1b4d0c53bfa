"""Gradient-enhanced surfaces: values and slopes of a response in one least-squares fit.

    y_i = t(x_i) b + noise of variance s0^2,    dy_i/dx_j = dt/dx_j(x_i) b + noise of s_j^2

Each point then gives 1 + p equations instead of one, so a quadratic needs about 1/(1 + p) of
the runs.  The rows are weighted by their variances; variances that are not given are estimated
together with the coefficients (iterated almost-unbiased estimator of variance components,
Horn, Horn and Duncan 1975): each group's squared residuals over its redundancy, which is where
the restricted likelihood is largest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from statsmodels.regression.linear_model import WLS

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface, check_estimable, default_names
from calibrate.designs.terms import Terms, matrix


@dataclass(frozen=True, eq=False)
class GradientFit:
    """The surface, and the standard deviations by which its rows were weighted.

    `value_sd` is that of a response, `slope_sd` (p,) that of its slope along each factor, per
    coded unit.  Intervals suppose that all these errors are independent and that the ratios of
    their standard deviations are known: ratios estimated from few points make them too short.
    """

    surface: Surface
    value_sd: float
    slope_sd: np.ndarray


MOST_ROUNDS = 200
SETTLED = 1e-8  # relative change of every variance at which the estimate stops


def fit_with_gradients(
    X: np.ndarray,
    y: np.ndarray,
    gradients: np.ndarray,
    terms: Terms,
    names: Sequence[str] = (),
    sd: tuple[float, Sequence[float]] | None = None,
) -> GradientFit:
    """Fits responses y (n,) and slopes (n, p) at points X (n, p), all per coded unit.

    A slope that is NaN was not measured.  `sd` = (value_sd, slope_sd (p,)) weights the rows;
    only their ratios matter, the residuals set the scale.  Without it both are estimated.
    """
    X, y, gradients = (np.asarray(values, float) for values in (X, y, gradients))
    if gradients.shape != X.shape or y.shape != X.shape[:1]:
        problem = f"slopes of shape {gradients.shape} at points of shape {X.shape}"
        raise BadValue(problem, "give one slope for each factor at each point", "gradients")
    if not np.all(np.isfinite(y)):
        raise BadValue("a response is not a finite number", "leave that run out", "y")
    rows, targets, group = _stacked(X, y, gradients, terms)
    check_estimable(rows, terms)
    if sd is None:
        variances = _variance_components(rows, targets, group)
    else:
        variances = np.array([sd[0], *sd[1]]) ** 2
    given: Any = (variances[0] / variances)[group]
    fitted = WLS(targets, rows, weights=given).fit()
    names = tuple(names) or default_names(X.shape[1])
    surface = Surface(names, tuple(terms), X, y, fitted, slope_rows=len(targets) - len(y))
    spread = np.sqrt(variances / variances[0] * surface.variance)
    return GradientFit(surface, float(spread[0]), spread[1:])


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


def _variance_components(rows: np.ndarray, targets: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Variance of each group of rows (1 + p,), estimated with the coefficients."""
    groups = group.max() + 1
    variances = np.ones(groups)
    for _ in range(MOST_ROUNDS):
        root = 1 / np.sqrt(variances[group])
        q, r = np.linalg.qr(rows * root[:, None])
        residual = targets - rows @ np.linalg.solve(r, q.T @ (targets * root))
        redundancy = np.bincount(group, 1 - np.sum(q**2, axis=1), groups)
        if np.any(redundancy < 0.5):
            problem = "too few values or slopes are left to estimate their noise"
            raise BadValue(problem, "give sd, add points or leave terms out", "sd")
        squares = np.bincount(group, residual**2, groups)
        updated = np.maximum(squares / redundancy, 1e-12 * np.var(targets))
        if np.all(np.abs(updated / variances - 1) < SETTLED):
            return updated
        variances = updated
    return variances
