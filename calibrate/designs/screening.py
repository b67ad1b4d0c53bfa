"""Which factors matter: effects of a two-level screening design.

An effect is the mean response at a factor's high level minus that at its low level.  With N
two-level runs in orthogonal columns its sum of squares is N effect^2/4; the contribution is its
share of the total.  Significance is judged twice: by t against the residual (dummy columns and
replicated centre points), and by Lenth's pseudo standard error (Technometrics 31, 1989), which
needs no residual.  Curvature, centre points against the rest, has a line of its own.

The least-squares main effects b1 of a design with columns X1 take up a share of every
interaction that is really there (Box and Draper), which is the design's alias structure:

    E[b1] = beta1 + A beta2,   A = (X1' X1)^-1 X1' X2

with X2 the columns of two-factor interactions.  In a regular fraction the shares are 0 and
+-1; in a Plackett-Burman design of 12 runs each interaction is spread in thirds.
"""

import itertools
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

    `pseudo_se` is Lenth's standard error of an effect on `lenth_df` degrees of freedom;
    |effect| beyond `margin` is significant at 5 % one at a time, beyond `simultaneous_margin`
    among all of them.  curvature is the mean of centre points minus that of the others, with
    its p; NaN without centre points.
    """

    effects: tuple[Effect, ...]
    pseudo_se: float
    lenth_df: float
    margin: float
    simultaneous_margin: float
    residual_sum_of_squares: float
    residual_df: int
    total_sum_of_squares: float
    total_df: int
    curvature: float
    curvature_p: float

    def __getitem__(self, name: str) -> Effect:
        for effect in self.effects:
            if effect.name == name:
                return effect
        raise KeyError(name)

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
    lenth = lenth_margins(effects)
    rows = zip(names, effects, squares, t, p, quantiles, strict=True)
    return Screening(
        effects=tuple(
            Effect(
                name,
                float(e),
                float(s),
                float(100 * s / total),
                float(tt),
                float(pp),
                int(fitted.df_resid),
                float(q),
                number >= factors,
            )
            for number, (name, e, s, tt, pp, q) in enumerate(rows)
        ),
        pseudo_se=lenth[0],
        lenth_df=len(effects) / 3,
        margin=lenth[1],
        simultaneous_margin=lenth[2],
        residual_sum_of_squares=float(fitted.ssr) if fitted.df_resid > 0 else 0.0,
        residual_df=int(fitted.df_resid),
        total_sum_of_squares=total,
        total_df=len(y) - 1,
        curvature=float(y[~corner].mean() - y[corner].mean()) if np.any(~corner) else np.nan,
        curvature_p=_curvature_p(fitted, corner),
    )


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


def _curvature_p(fitted: Any, corner: np.ndarray) -> float:
    return float(fitted.pvalues[1]) if np.any(~corner) and fitted.df_resid > 0 else np.nan


SAME = 1e-9  # a share that is none


@dataclass(frozen=True)
class Alias:
    """What the estimate of `effect` takes up besides it: (share, interaction) pairs."""

    effect: str
    others: tuple[tuple[float, str], ...]

    def __str__(self) -> str:
        if not self.others:
            return f"[{self.effect}] = {self.effect}"
        shares = " ".join(_signed(share, name) for share, name in self.others)
        return f"[{self.effect}] = {self.effect} {shares}"


def aliases(design: Design) -> tuple[Alias, ...]:
    """For each factor and dummy the interactions in it; then the groups of like interactions
    that are no main effect's alias.  Computed from the runs away from the centre.
    """
    corner = ~design.centre
    main = np.hstack([design.coded, design.dummies])[corner]
    pairs = list(itertools.combinations(range(len(design.factors)), 2))
    products = [main[:, a] * main[:, b] for a, b in pairs]
    names = [f"{design.names[a]}*{design.names[b]}" for a, b in pairs]
    interactions = np.array(products).reshape(len(pairs), len(main)).T
    base = np.column_stack([np.ones(len(main)), main])
    shares = np.linalg.lstsq(base, interactions)[0][1:]
    columns = design.names + design.dummy_names
    found = [Alias(name, _nonzero(row, names)) for name, row in zip(columns, shares, strict=True)]
    clear = np.flatnonzero(np.all(np.abs(shares) < 1 - SAME, axis=0))
    return tuple(found) + _alike(interactions[:, clear], [names[j] for j in clear])


def _alike(interactions: np.ndarray, names: list[str]) -> tuple[Alias, ...]:
    """Groups of interactions with the same column up to its sign, each group once."""
    if not names:
        return ()
    gram = interactions.T @ interactions
    norms = np.sqrt(np.diag(gram))
    cosine = gram / np.outer(norms, norms)
    first = np.argmax(np.abs(cosine) > 1 - SAME, axis=0)
    groups = [
        Alias(
            names[leader],
            tuple(
                (float(np.sign(cosine[leader, other])), names[other])
                for other in range(leader + 1, len(names))
                if first[other] == leader
            ),
        )
        for leader in sorted(set(first.tolist()))
    ]
    return tuple(group for group in groups if group.others)


def _nonzero(row: np.ndarray, names: list[str]) -> tuple[tuple[float, str], ...]:
    return tuple((float(s), name) for s, name in zip(row, names, strict=True) if abs(s) > SAME)


def _signed(share: float, name: str) -> str:
    size = "" if abs(abs(share) - 1) < SAME else f"{abs(share):.3g} "
    return f"{'-' if share < 0 else '+'} {size}{name}"
