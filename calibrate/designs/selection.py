"""Which terms a surface needs: backward elimination that respects hierarchy.

A term goes only if no remaining term contains it, so that the model stays invariant under a
change of a factor's origin.  Candidates go one at a time, the least significant (or the one
whose loss lowers AICc most) first.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import Term, removable


@dataclass(frozen=True)
class Step:
    """A term that was left out: its p value then, and AICc of the model without it."""

    dropped: str
    p: float
    aicc: float
    residual_df: int


def aicc(surface: Surface) -> float:
    """Akaike's criterion corrected for few runs (Hurvich and Tsai 1989), up to a constant.

    The variance counts as a parameter; infinite where too few runs are left for it.
    """
    n, k = len(surface.y), len(surface.terms) + 2
    if n - k - 1 <= 0:
        return np.inf
    return float(n * np.log(surface.fit.ssr / n) + 2 * k + 2 * k * (k + 1) / (n - k - 1))


def select_backward(
    surface: Surface,
    by: Literal["p", "aicc"] = "p",
    alpha: float = 0.05,
    keep: tuple[Term, ...] = (),
) -> tuple[Surface, tuple[Step, ...]]:
    """The reduced surface and the terms that went, in order.

    By "p" terms go while the largest p value of those that may go exceeds `alpha`; by "aicc"
    while AICc falls.  `keep` stays in any case.  `BadValue` for a saturated model.
    """
    if surface.df < 1:
        raise BadValue("no residual degree of freedom", "start from fewer terms", "terms")
    steps: list[Step] = []
    while True:
        candidates = [term for term in removable(surface.terms) if term not in keep]
        chosen = _by_p(surface, candidates, alpha) if by == "p" else _by_aicc(surface, candidates)
        if chosen is None:
            return surface, tuple(steps)
        p = _p_values(surface)[chosen]
        surface = without(surface, chosen)
        label = chosen.label(surface.names)
        steps.append(Step(label, p, aicc(surface), surface.df))


def without(surface: Surface, term: Term) -> Surface:
    """The same runs fitted without one term; `BadValue` for a fit of slopes."""
    if surface.slope_rows:
        raise BadValue("this surface was fitted with slopes", "fit the values alone", "surface")
    terms = tuple(other for other in surface.terms if other != term)
    weights = surface.fit.model.weights if surface.weighted else None
    return fit_surface(surface.X, surface.y, terms, surface.names, weights)


def _p_values(surface: Surface) -> dict[Term, float]:
    return dict(zip(surface.terms, np.asarray(surface.fit.pvalues)[1:].tolist(), strict=True))


def _by_p(surface: Surface, candidates: list[Term], alpha: float) -> Term | None:
    p = _p_values(surface)
    worst = max(candidates, key=lambda term: p[term], default=None)
    return worst if worst is not None and p[worst] > alpha else None


def _by_aicc(surface: Surface, candidates: list[Term]) -> Term | None:
    scores = {term: aicc(without(surface, term)) for term in candidates}
    best = min(scores, key=lambda term: scores[term], default=None)
    return best if best is not None and scores[best] < aicc(surface) else None
