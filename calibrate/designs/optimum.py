"""Where several responses are best at once: desirability (Derringer and Suich 1980).

Each response has a desirability d from 0 (useless) to 1 (as good as can be), a power of the
relative distance from its limit to its goal; the overall one is their weighted geometric mean
D = (prod d_i^r_i)^(1/sum r_i).  log D is maximised as a smooth problem: with t_i <= log d_i as
further unknowns each side of a goal is one constraint, low + (goal - low) exp(t_i/weight) <= y_i,
so that neither the kink at a goal nor the flat zero outside the limits is met.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from calibrate.core.errors import BadValue
from calibrate.designs.surface import Surface


@dataclass(frozen=True)
class Goal:
    """Desirability of a response: 0 up to `low`, 1 from `best_low` to `best_high`, 0 from `high`.

    Between them it is the relative distance to the power `weight_low` or `weight_high`; an
    infinite `low` or `high` leaves that side at 1.  `importance` is its power in the mean.
    Made by `target`, `maximise` and `minimise`.
    """

    low: float
    best_low: float
    best_high: float
    high: float
    weight_low: float = 1.0
    weight_high: float = 1.0
    importance: float = 1.0

    def __post_init__(self):
        inner = self.low < self.best_low or self.low == -math.inf
        outer = self.best_high < self.high or self.high == math.inf
        if not (inner and outer and self.best_low <= self.best_high):
            problem = f"limits and goals {self.low}, {self.best_low}, {self.best_high}, {self.high}"
            raise BadValue(problem, "give them in rising order", "goal")
        if min(self.weight_low, self.weight_high, self.importance) <= 0:
            raise BadValue("a weight or importance is not positive", "use 1", "goal")

    def __call__(self, y: float) -> float:
        """Desirability of the value y."""
        rise = self._side(y, self.low, self.best_low, self.weight_low)
        fall = self._side(y, self.high, self.best_high, self.weight_high)
        return min(rise, fall)

    @staticmethod
    def _side(y: float, limit: float, best: float, weight: float) -> float:
        if math.isinf(limit):
            return 1.0
        return min(max((y - limit) / (best - limit), 0.0), 1.0) ** weight


def target(low: float, best: float, high: float, weight=1.0, importance=1.0) -> Goal:
    """As near to `best` as can be, useless beyond `low` and `high`."""
    return Goal(low, best, best, high, weight, weight, importance)


def maximise(low: float, enough: float, weight=1.0, importance=1.0) -> Goal:
    """As large as can be: useless below `low`, no better beyond `enough`."""
    return Goal(low, enough, math.inf, math.inf, weight, weight, importance)


def minimise(enough: float, high: float, weight=1.0, importance=1.0) -> Goal:
    """As small as can be: no better below `enough`, useless above `high`."""
    return Goal(-math.inf, -math.inf, enough, high, weight, weight, importance)


@dataclass(frozen=True)
class Region:
    """Where to look, in coded units: `low` to `high` for every factor, within `radius`."""

    low: float = -1.0
    high: float = 1.0
    radius: float = math.inf


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best point (p,) in coded units, with overall and single desirabilities.

    `alternatives` (k, p) are other points of (nearly) the same desirability, farther from what was
    measured: where goals are met along a whole line, the point that predicts with the least error
    is the best.
    """

    x: np.ndarray
    desirability: float
    single: tuple[float, ...]
    alternatives: np.ndarray


SMALLEST_LOG = -12.0  # of a single desirability during the search
TIED = 1e-4  # of D: points that count as equally desirable
APART = 0.05  # coded distance from which points count as different


def optimise(
    surfaces: Sequence[Surface],
    goals: Sequence[Goal],
    region: Region = Region(),
    starts: int = 64,
    seed: int = 0,
) -> Optimum:
    """The most desirable point of `region`, by SLSQP from `starts` Sobol' points and the centre.

    Where nothing is desirable D is 0 and the point is the last one tried.
    """
    if not surfaces or len(surfaces) != len(goals):
        problem = f"{len(surfaces)} surfaces and {len(goals)} goals"
        raise BadValue(problem, "give one goal for each surface", "goals")
    factors = surfaces[0].X.shape[1]
    unit = qmc.Sobol(factors, scramble=True, rng=seed).random_base2(math.ceil(math.log2(starts)))
    begin = region.low + (region.high - region.low) * np.vstack([np.full(factors, 0.5), unit])
    search = _Search(tuple(surfaces), tuple(goals), region)
    found = np.array([search.climb(_into(x, region)) for x in begin])
    overall = np.array([search.overall(x) for x in found])
    tied = found[overall >= overall.max() - TIED]
    # Prediction variances over residual variances, of all responses together.
    error = np.array([sum(surface.leverage(x) for surface in surfaces) for x in tied])
    distinct = _distinct(tied[np.argsort(error)])
    best = distinct[0]
    return Optimum(
        x=best,
        desirability=search.overall(best),
        single=search.single(best),
        alternatives=distinct[1:],
    )


@dataclass(frozen=True, eq=False)
class _Search:
    """The smooth problem in (x, t), x (p,) the point and t (k,) bounds of log desirability."""

    surfaces: tuple[Surface, ...]
    goals: tuple[Goal, ...]
    region: Region

    def single(self, x: np.ndarray) -> tuple[float, ...]:
        return tuple(
            goal(float(surface(x[None])[0]))
            for goal, surface in zip(self.goals, self.surfaces, strict=True)
        )

    def overall(self, x: np.ndarray) -> float:
        powers = np.array([goal.importance for goal in self.goals])
        single = np.array(self.single(x))
        if np.any(single <= 0):
            return 0.0
        return float(np.exp(powers @ np.log(single) / powers.sum()))

    def climb(self, start: np.ndarray) -> np.ndarray:
        """The local optimum (p,) that SLSQP reaches from `start`."""
        p, powers = len(start), np.array([goal.importance for goal in self.goals])
        slope = np.concatenate([np.zeros(p), -powers / powers.sum()])
        first = np.log(np.maximum(self.single(start), math.exp(SMALLEST_LOG)))
        box = [(self.region.low, self.region.high)] * p
        limits: Any = box + [(SMALLEST_LOG, 0.0)] * len(powers)
        options: Any = {"maxiter": 200, "ftol": 1e-12}
        result = optimize.minimize(
            lambda z: slope @ z,
            np.concatenate([start, first]),
            jac=lambda z: slope,
            bounds=limits,
            constraints={"type": "ineq", "fun": self._slack, "jac": self._slack_slope},
            method="SLSQP",
            options=options,
        )
        inside = np.clip(result.x[:p], self.region.low, self.region.high)
        return _into(inside, self.region)

    def _sides(self):
        """(response, limit, distance from limit to goal, weight) of every finite limit."""
        for number, goal in enumerate(self.goals):
            if math.isfinite(goal.low):
                yield number, goal.low, goal.best_low - goal.low, goal.weight_low
            if math.isfinite(goal.high):
                yield number, goal.high, goal.best_high - goal.high, goal.weight_high

    def _slack(self, z: np.ndarray) -> np.ndarray:
        """Relative distance from each limit less what t asks for, and the room to the sphere."""
        p = len(z) - len(self.goals)
        x, t = z[:p], z[p:]
        y = [float(surface(x[None])[0]) for surface in self.surfaces]
        slack = [(y[i] - limit) / span - math.exp(t[i] / w) for i, limit, span, w in self._sides()]
        return np.array(slack + [self.region.radius**2 - x @ x] * self._on_sphere())

    def _slack_slope(self, z: np.ndarray) -> np.ndarray:
        p = len(z) - len(self.goals)
        x, t = z[:p], z[p:]
        rows = []
        for i, _, span, weight in self._sides():
            row = np.zeros(len(z))
            row[:p] = self.surfaces[i].gradient(x[None])[0] / span
            row[p + i] = -math.exp(t[i] / weight) / weight
            rows.append(row)
        if self._on_sphere():
            rows.append(np.concatenate([-2 * x, np.zeros(len(t))]))
        return np.array(rows)

    def _on_sphere(self) -> int:
        return int(math.isfinite(self.region.radius))


def _into(x: np.ndarray, region: Region) -> np.ndarray:
    """x, drawn to the centre onto the sphere where it lies outside."""
    length = float(np.linalg.norm(x))
    return x * min(1.0, region.radius / length) if length else x


def _distinct(points: np.ndarray) -> np.ndarray:
    """Points (k, p) that lie apart from all before them."""
    kept: list[np.ndarray] = []
    for point in points:
        if all(np.linalg.norm(point - other) > APART for other in kept):
            kept.append(point)
    return np.array(kept)
