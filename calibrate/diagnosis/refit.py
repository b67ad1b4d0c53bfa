"""The best fit with chosen effects switched on: base parameters and strengths together.

Gauss-Newton on the description's emulator.  Each step solves

    min |Sigma^-1/2 (y - f - B d - G e)|^2 + |(delta + d)/sd|^2 + |(e0 + e)/s|^2

over the shift d of the base parameters and at most two strengths, which stay positive where
the effect is one-sided; it is halved until the objective falls.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from calibrate.diagnosis.linear import Linearised

STRENGTH_SD = 3.0  # typical strengths; keeps invisible effects from running away
STEPS = 8
HALVINGS = 4
DONE = 1e-3  # fall of the objective that is not worth another step


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit: delta (p,), strengths (k,), simulated values (m,), slopes there, objective, and the
    residual (m,) that the linearisation there is fitted to."""

    chosen: tuple[int, ...]
    delta: np.ndarray
    strengths: np.ndarray
    values: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray
    objective: float
    working: np.ndarray


def refit(
    description: Linearised,
    measured: np.ndarray,
    covariance: np.ndarray,
    chosen: Sequence[int] = (),
    start: np.ndarray | None = None,
) -> Refit:
    """The fit with the chosen effects on and all others at strength 0."""
    delta = np.zeros(len(description.prior_sd)) if start is None else start
    strengths = np.zeros(len(description.effects))
    inverse = np.linalg.inv(covariance)
    point = _point(description, measured, inverse, tuple(chosen), delta, strengths)
    for _ in range(STEPS):
        step = _step(description, inverse, point)
        best = _shortened(description, measured, inverse, point, *step)
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


def _step(description: Linearised, inverse: np.ndarray, point: Refit):
    """Full Gauss-Newton step: new delta (p,) and strengths (k,), from normal equations with
    the base parameters eliminated."""
    on, p = list(point.chosen), len(description.prior_sd)
    columns = np.hstack([point.base_slopes, point.effect_slopes[:, on]])
    weighted = inverse @ columns
    prior = np.concatenate([description.prior_sd, np.full(len(on), STRENGTH_SD)])
    normal = columns.T @ weighted + np.diag(prior**-2.0)
    pull = weighted.T @ point.working
    strengths = np.zeros_like(point.strengths)
    if on:
        eliminated = np.linalg.solve(normal[:p, :p], np.column_stack([normal[:p, p:], pull[:p]]))
        gram = normal[p:, p:] - normal[p:, :p] @ eliminated[:, :-1]
        left = pull[p:] - normal[p:, :p] @ eliminated[:, -1]
        strengths[on] = best_strengths(gram, left, description.one_sided[on])
    rest = pull[:p] - normal[:p, p:] @ strengths[on]
    return np.linalg.solve(normal[:p, :p], rest), strengths


def _shortened(description, measured, inverse, point: Refit, delta, strengths) -> Refit:
    """The step, halved until the objective falls."""
    share = 1.0
    for _ in range(HALVINGS + 1):
        trial = _point(
            description,
            measured,
            inverse,
            point.chosen,
            point.delta + share * (delta - point.delta),
            point.strengths + share * (strengths - point.strengths),
        )
        if trial.objective < point.objective:
            return trial
        share /= 2
    return point


def _point(description, measured, inverse, chosen, delta, strengths) -> Refit:
    values, base, effects = description.at(delta, strengths)
    residual = measured - values
    on = list(chosen)
    objective = (
        residual @ inverse @ residual
        + ((delta / description.prior_sd) ** 2).sum()
        + ((strengths[on] / STRENGTH_SD) ** 2).sum()
    )
    working = residual + base @ delta + effects[:, on] @ strengths[on]
    return Refit(chosen, delta, strengths, values, base, effects, float(objective), working)
