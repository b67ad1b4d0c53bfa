"""The best fit with chosen effects switched on: base parameters and strengths together.

Gauss-Newton on the description's emulator.  Each step solves

    min |Sigma^-1/2 (y - f - B d - G e)|^2 + |(delta + d)/sd|^2 + |(e0 + e)/s|^2

over the shift d of the base parameters and at most two strengths, which stay positive where
the effect is one-sided; it is halved until the objective falls.  Objectives may have several
hollows: the best of a few starts is taken.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from calibrate.diagnosis.linear import Linearised

STRENGTH_SD = 3.0  # typical strengths; keeps invisible effects from running away
STEPS = 32  # most; docs/diagnosis.md says what 8 left undone
HALVINGS = 4
SAME = 0.1  # typical strengths by which fits in one hollow may differ
DONE = 1e-3  # fall of the objective that is not worth another step


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit: delta (p,), strengths (k,), simulated values (m,), slopes there, objective, the
    residual (m,) that the linearisation there is fitted to, and the covariance (m, m) that
    weighs it."""

    chosen: tuple[int, ...]
    delta: np.ndarray
    strengths: np.ndarray
    values: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray
    objective: float
    working: np.ndarray
    covariance: np.ndarray


Start = tuple[np.ndarray, np.ndarray]  #: delta (p,) and strengths (k,)


def start_at(
    description: Linearised, delta: np.ndarray | None = None, effect: int = 0, strength: float = 0.0
) -> Start:
    """A start at a shift of the base parameters with one effect on."""
    strengths = np.zeros(len(description.effects))
    if strength:
        strengths[effect] = strength
    return np.zeros(len(description.prior_sd)) if delta is None else delta, strengths


def hollows(
    description: Linearised,
    measured: np.ndarray,
    covariance: np.ndarray,
    chosen: Sequence[int],
    starts: Iterable[Start],
) -> list[Refit]:
    """The fits from all starts that differ, best first."""
    fits = [refit(description, measured, covariance, chosen, start) for start in starts]
    found: list[Refit] = []
    for fit in sorted(fits, key=lambda fit: fit.objective):
        if not any(np.abs(fit.strengths - other.strengths).max() < SAME for other in found):
            found.append(fit)
    return found


def refit(
    description: Linearised,
    measured: np.ndarray,
    covariance: np.ndarray,
    chosen: Sequence[int] = (),
    start: Start | None = None,
) -> Refit:
    """The fit with the chosen effects on and all others at strength 0."""
    problem = _Problem(description, measured, covariance, tuple(chosen))
    point = problem.at(*(start or start_at(description)))
    for _ in range(STEPS):
        best = problem.shortened(point, *problem.step(point))
        gain = point.objective - best.objective
        point = best if gain > 0 else point
        if gain < DONE or description.emulator is None:
            break
    return point


def best_strengths(gram: np.ndarray, pull: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """Minimiser (q,) of e'Ae/2 - b'e with some e >= 0, by trying every active set."""
    best, lowest = np.zeros(len(pull)), 0.0
    for kept in product((False, True), repeat=len(pull)):
        on = np.flatnonzero(kept)
        if not len(on):
            continue
        trial = np.zeros(len(pull))
        trial[on] = np.linalg.solve(gram[np.ix_(on, on)], pull[on])
        value = 0.5 * trial @ gram @ trial - pull @ trial
        if value < lowest and not (trial[one_sided] < 0).any():
            best, lowest = trial, value
    return best


@dataclass(frozen=True, eq=False)
class _Problem:
    """What one fit minimises: measured (m,), weighed by covariance (m, m), chosen effects on."""

    description: Linearised
    measured: np.ndarray
    covariance: np.ndarray
    chosen: tuple[int, ...]

    @cached_property
    def inverse(self) -> np.ndarray:
        return np.linalg.inv(self.covariance)

    def at(self, delta: np.ndarray, strengths: np.ndarray) -> Refit:
        """The point at a shift and strengths."""
        d, on = self.description, list(self.chosen)
        values, base, effects = d.at(delta, strengths)
        residual = self.measured - values
        objective = (
            residual @ self.inverse @ residual
            + ((delta / d.prior_sd) ** 2).sum()
            + ((strengths[on] / STRENGTH_SD) ** 2).sum()
        )
        working = residual + base @ delta + effects[:, on] @ strengths[on]
        return Refit(
            self.chosen, delta, strengths, values, base, effects, float(objective), working,
            self.covariance,
        )  # fmt: skip

    def step(self, point: Refit) -> tuple[np.ndarray, np.ndarray]:
        """Full Gauss-Newton step: new delta (p,) and strengths (k,), from normal equations with
        the base parameters eliminated."""
        d, on, p = self.description, list(self.chosen), len(point.delta)
        columns = np.hstack([point.base_slopes, point.effect_slopes[:, on]])
        weighted = self.inverse @ columns
        prior = np.concatenate([d.prior_sd, np.full(len(on), STRENGTH_SD)])
        normal = columns.T @ weighted + np.diag(prior**-2.0)
        pull = weighted.T @ point.working
        strengths = np.zeros_like(point.strengths)
        if on:
            mixed = np.linalg.solve(normal[:p, :p], np.column_stack([normal[:p, p:], pull[:p]]))
            gram = normal[p:, p:] - normal[p:, :p] @ mixed[:, :-1]
            left = pull[p:] - normal[p:, :p] @ mixed[:, -1]
            strengths[on] = best_strengths(gram, left, d.one_sided[on])
        rest = pull[:p] - normal[:p, p:] @ strengths[on]
        return np.linalg.solve(normal[:p, :p], rest), strengths

    def shortened(self, point: Refit, delta: np.ndarray, strengths: np.ndarray) -> Refit:
        """The step to a new shift and strengths, halved until the objective falls."""
        share = 1.0
        for _ in range(HALVINGS + 1):
            trial = self.at(
                point.delta + share * (delta - point.delta),
                point.strengths + share * (strengths - point.strengths),
            )
            if trial.objective < point.objective:
                return trial
            share /= 2
        return point
