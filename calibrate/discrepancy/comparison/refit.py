"""The best fit with chosen effects switched on: base parameters and strengths together.

    min |Sigma^-1/2 (y - f(delta, e))|^2 + |delta/sd|^2 + |e/s|^2

over the base parameters' shift delta and at most two strengths, which stay positive where the
effect is one-sided.  One step of Gauss and Newton, which ends a linear problem, then L-BFGS-B
(Byrd, Lu, Nocedal and Zhu 1995, SIAM J. Sci. Comput. 16, 1190) in coordinates in which the
linearised problem is round, as Gauss and Newton's steps creep along bent valleys.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.projection import Projected, project

STRENGTH_SD = 3.0  # typical strengths; keeps invisible effects from running away
ROUNDS = 20  # most, each in coordinates of its own
STEPS = 80  # most in a round
HALVINGS = 4
SAME = 0.1  # typical strengths, or prior deviations, by which fits in one minimum may differ
DONE = 1e-2  # fall of the objective that is not worth another round
FLAT = 1e-4  # fall in a step that ends a round
REACH = 5.0  # standard deviations about a point, beside its misfit, within which its bottom lies
ABSURD = 1e30  # objective where the description is not finite


@dataclass(frozen=True, eq=False)
class Refit:
    """A fit: delta (p,), strengths (k,), simulated values (m,), slopes there, objective, the
    residual (m,) that the linearisation there is fitted to, the covariance (m, m) that weighs it,
    and the prior deviations (p,) of delta."""

    chosen: tuple[int, ...]
    delta: np.ndarray
    strengths: np.ndarray
    values: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray
    objective: float
    working: np.ndarray
    covariance: np.ndarray
    prior_sd: np.ndarray

    def projected(
        self, covariance: np.ndarray, effects: slice | Sequence[int] = slice(None)
    ) -> Projected:
        """The linearisation here with some effects, projected off the base parameters."""
        slopes = self.effect_slopes[:, effects]
        return project(self.working, self.base_slopes, self.prior_sd, slopes, covariance)


Start = tuple[np.ndarray, np.ndarray]  #: delta (p,) and strengths (k,)


def start_at(
    description: Linearised, delta: np.ndarray | None = None, effect: int = 0, strength: float = 0.0
) -> Start:
    """A start at a shift of the base parameters with one effect on."""
    strengths = np.zeros(len(description.effects))
    if strength:
        strengths[effect] = strength
    return np.zeros(len(description.prior_sd)) if delta is None else delta, strengths


def local_minima(
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
        if not any(_near(fit, other, description.prior_sd) for other in found):
            found.append(fit)
    return found


def _near(fit: Refit, other: Refit, prior_sd: np.ndarray) -> bool:
    apart = np.abs(fit.strengths - other.strengths).max(initial=0.0)
    return bool(max(apart, np.abs((fit.delta - other.delta) / prior_sd).max()) < SAME)


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
    point = problem.shortened(point, *problem.step(point))
    if description.emulator is None:
        return point
    for _ in range(ROUNDS):
        before, point = point.objective, problem.descended(point)
        if before - point.objective < DONE:
            break
    return point


def weighed(
    description: Linearised, measured: np.ndarray, covariance: np.ndarray, fit: Refit
) -> Refit:
    """The fit where it is, its objective that of another covariance (m, m)."""
    found = fit.values, fit.base_slopes, fit.effect_slopes
    problem = _Problem(description, measured, covariance, fit.chosen)
    return problem.judged(fit.delta, fit.strengths, *found)


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
        """The point at a shift and strengths; its objective is not finite where the description is
        not."""
        with np.errstate(over="ignore", invalid="ignore"):
            return self.judged(delta, strengths, *self.description.at(delta, strengths))

    def judged(self, delta, strengths, values, base, effects) -> Refit:
        """A point with its objective, given values (m,) and slopes (m, p), (m, k) there."""
        d, on = self.description, list(self.chosen)
        residual = self.measured - values
        objective = (
            residual @ self.inverse @ residual
            + ((delta / d.prior_sd) ** 2).sum()
            + ((strengths[on] / STRENGTH_SD) ** 2).sum()
        )
        working = residual + base @ delta + effects[:, on] @ strengths[on]
        return Refit(
            self.chosen, delta, strengths, values, base, effects, float(objective), working,
            self.covariance, d.prior_sd,
        )  # fmt: skip

    def step(self, point: Refit) -> tuple[np.ndarray, np.ndarray]:
        """Full Gauss-Newton step: new delta (p,) and strengths (k,), from normal equations with
        the base parameters eliminated."""
        d, on, p = self.description, list(self.chosen), len(point.delta)
        normal, pull = self._normal(point), self._columns(point).T @ self.inverse @ point.working
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

    def descended(self, point: Refit) -> Refit:
        """The bottom that L-BFGS-B reaches from a point."""
        d, on, p = self.description, list(self.chosen), len(point.delta)
        round_ = _Round.about(self._normal(point), p)
        origin = np.concatenate([point.delta, point.strengths[on]])
        first = round_.into(origin)
        known = {first.tobytes(): point}

        def there(location: np.ndarray) -> Refit:
            if (key := location.tobytes()) not in known:
                both, strengths = round_.back(location), np.zeros_like(point.strengths)
                strengths[on] = both[p:]
                known[key] = self.at(both[:p], strengths)
            return known[key]

        def objective(location: np.ndarray) -> tuple[float, np.ndarray]:
            trial = there(location)
            with np.errstate(over="ignore", invalid="ignore"):
                slope = self._slope(trial)
            good = np.isfinite(trial.objective) and np.isfinite(slope).all()
            return (trial.objective, round_.turned(slope)) if good else (ABSURD, 0.0 * location)

        reach = REACH + np.sqrt(point.objective)
        bounds = np.column_stack([first - reach, first + reach])
        bounds[p:, 0] = np.where(d.one_sided[on], np.maximum(bounds[p:, 0], 0.0), bounds[p:, 0])
        done = minimize(
            objective, first, jac=True, method="L-BFGS-B", bounds=bounds,
            options={"maxiter": STEPS, "ftol": FLAT / max(point.objective, 1.0)},
        )  # fmt: skip
        found = there(done.x)
        return found if found.objective < point.objective else point

    def _columns(self, point: Refit) -> np.ndarray:
        """Slopes (m, p + q) of what is fitted."""
        return np.hstack([point.base_slopes, point.effect_slopes[:, list(self.chosen)]])

    def _prior(self) -> np.ndarray:
        sd = self.description.prior_sd
        return np.concatenate([sd, np.full(len(self.chosen), STRENGTH_SD)])

    def _normal(self, point: Refit) -> np.ndarray:
        """Matrix (p + q, p + q) of the normal equations at a point."""
        columns = self._columns(point)
        return columns.T @ self.inverse @ columns + np.diag(self._prior() ** -2.0)

    def _slope(self, point: Refit) -> np.ndarray:
        """Of the objective, shape (p + q,)."""
        residual = self.measured - point.values
        both = np.concatenate([point.delta, point.strengths[list(self.chosen)]])
        pulled = self._columns(point).T @ (self.inverse @ residual)
        return 2 * (both / self._prior() ** 2 - pulled)


@dataclass(frozen=True, eq=False)
class _Round:
    """Coordinates in which a quadratic form with blocks A, B is round but for what strengths share,
    and strengths keep their signs: delta + A^-1 B e by the Cholesky factor of A, e by the roots of
    the Schur complement's diagonal."""

    lower: np.ndarray
    mixed: np.ndarray
    scale: np.ndarray

    @staticmethod
    def about(normal: np.ndarray, p: int) -> "_Round":
        """For the form (p + q, p + q) whose last q coordinates are strengths."""
        lower = np.linalg.cholesky(normal[:p, :p])
        mixed = np.linalg.solve(normal[:p, :p], normal[:p, p:])
        left = normal[p:, p:] - normal[p:, :p] @ mixed
        return _Round(lower, mixed, np.sqrt(np.diag(left)))

    def into(self, both: np.ndarray) -> np.ndarray:
        p = len(self.lower)
        shift = both[:p] + self.mixed @ both[p:]
        return np.concatenate([self.lower.T @ shift, self.scale * both[p:]])

    def back(self, location: np.ndarray) -> np.ndarray:
        p = len(self.lower)
        strengths = location[p:] / self.scale
        shift = solve_triangular(self.lower.T, location[:p], lower=False)
        return np.concatenate([shift - self.mixed @ strengths, strengths])

    def turned(self, slope: np.ndarray) -> np.ndarray:
        """The slope with respect to these coordinates."""
        p = len(self.lower)
        along = (slope[p:] - self.mixed.T @ slope[:p]) / self.scale
        return np.concatenate([solve_triangular(self.lower, slope[:p], lower=True), along])
