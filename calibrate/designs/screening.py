"""Which factors matter: effects of a two-level screening design.

An effect is the mean response at a factor's high level minus that at its low level.  With N
two-level runs in orthogonal columns its sum of squares is N effect^2/4; the contribution is its
share of the total.  Significance is judged twice: by t against the residual (dummy columns and
replicated centre points), and by Lenth's pseudo standard error (Technometrics 31, 1989), which
needs no residual.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from statsmodels.regression.linear_model import OLS

from calibrate.core.errors import BadValue
from calibrate.designs.design import Design
from calibrate.designs.surface import default_names


@dataclass(frozen=True)
class Effect:
    """One column: effect in the response's unit, sum of squares, contribution (percent).

    t, its p (NaN without residual degrees of freedom) and `df` of that residual;
    `half_normal` is the half-normal quantile at the rank of |effect|.
    """

    name: str
    effect: float
    sum_of_squares: float
    contribution: float
    t: float
    p: float
    df: int
    half_normal: float
    dummy: bool


@dataclass(frozen=True)
class Screening:
    """Effects in the order of the columns, dummies last.

    `pseudo_se` is Lenth's standard error of an effect; |effect| beyond `margin` is significant at
    5 % one at a time, beyond `simultaneous_margin` among all of them.
    """

    effects: tuple[Effect, ...]
    pseudo_se: float
    margin: float
    simultaneous_margin: float
    total_sum_of_squares: float

    def __getitem__(self, name: str) -> Effect:
        return {effect.name: effect for effect in self.effects}[name]

    def ranked(self) -> list[Effect]:
        """Effects of factors (not dummies), the largest first."""
        factors = [effect for effect in self.effects if not effect.dummy]
        return sorted(factors, key=lambda effect: -abs(effect.effect))


def screen(design: Design | np.ndarray, y: np.ndarray, names: Sequence[str] = ()) -> Screening:
    """Effects of every column of a two-level design on responses y (n,).

    `design` is a `Design` or coded columns (n, k) of -1 and +1 (0 at centre points), all of
    them factors.  `BadValue` if the columns are not two-level, balanced and orthogonal, or if a
    response is missing.
    """
    columns, names, factors = _columns(design, names)
    y = np.asarray(y, float)
    if y.shape != (len(columns),) or not np.all(np.isfinite(y)):
        raise BadValue("a response is missing", "give a finite number for every run", "y")
    _check_two_level(columns)
    corner = np.all(np.abs(columns) == 1, axis=1)
    effects = 2 * columns[corner].T @ y[corner] / corner.sum()
    squares = corner.sum() * effects**2 / 4
    total = float(np.sum((y - y.mean()) ** 2))
    fitted = _main_effects(columns[:, :factors], corner, y)
    t, p = _tests(effects, squares, fitted)
    quantiles = half_normal_quantiles(effects)
    rows = zip(names, effects, squares, t, p, quantiles, strict=True)
    found = [
        Effect(
            name, float(effect), float(square), float(100 * square / total), float(t), float(p),
            int(fitted.df_resid), float(quantile), number >= factors,
        )
        for number, (name, effect, square, t, p, quantile) in enumerate(rows)
    ]  # fmt: skip
    return Screening(tuple(found), *lenth_margins(effects), total)


def lenth_margins(effects: np.ndarray) -> tuple[float, float, float]:
    """Lenth's pseudo standard error, margin of error, simultaneous margin, all at 95 %."""
    size = np.abs(effects)
    first = 1.5 * np.median(size)
    small = size[size < 2.5 * first]
    pseudo = 1.5 * float(np.median(small)) if len(small) else 0.0
    df = len(effects) / 3
    simultaneous = (1 + 0.95 ** (1 / len(effects))) / 2
    margin, wide = stats.t.ppf([0.975, simultaneous], df) * pseudo
    return pseudo, float(margin), float(wide)


def half_normal_quantiles(effects: np.ndarray) -> np.ndarray:
    """Quantiles (k,) of |standard normal| at probability (rank - 1/2)/k of each |effect|."""
    ranks = stats.rankdata(np.abs(effects), method="ordinal")
    return stats.norm.ppf(0.5 + 0.5 * (ranks - 0.5) / len(effects))


def _columns(
    design: Design | np.ndarray, names: Sequence[str]
) -> tuple[np.ndarray, tuple[str, ...], int]:
    """All columns, their names, and how many of them are factors."""
    if isinstance(design, Design):
        columns = np.hstack([design.coded, design.dummies])
        return columns, design.names + design.dummy_names, len(design.factors)
    columns = np.asarray(design, float)
    return columns, tuple(names) or default_names(columns.shape[1]), columns.shape[1]


def _check_two_level(columns: np.ndarray) -> None:
    corner = columns[np.all(np.abs(columns) == 1, axis=1)]
    centre = columns[np.all(columns == 0, axis=1)]
    if len(corner) + len(centre) < len(columns) or not len(corner):
        problem = "a run is neither at low and high levels nor at the centre"
        raise BadValue(problem, "give a two-level design in coded units", "design")
    gram = np.column_stack([np.ones(len(corner)), corner])
    if not np.array_equal(gram.T @ gram, len(corner) * np.eye(gram.shape[1])):
        problem = "the columns are not balanced and orthogonal"
        raise BadValue(problem, "fit a linear surface instead", "design")


def _main_effects(factors: np.ndarray, corner: np.ndarray, y: np.ndarray) -> Any:
    """Least squares of the mean, the curvature (where there are centre points), the factors."""
    lead = [np.ones(len(y))] + ([(~corner).astype(float)] if np.any(~corner) else [])
    return OLS(y, np.column_stack([*lead, factors])).fit()


def _tests(effects: np.ndarray, squares: np.ndarray, fitted: Any) -> tuple[np.ndarray, np.ndarray]:
    if fitted.df_resid == 0:
        return np.full(len(effects), np.nan), np.full(len(effects), np.nan)
    t = np.sign(effects) * np.sqrt(squares / fitted.scale)
    return t, 2 * stats.t.sf(np.abs(t), fitted.df_resid)
