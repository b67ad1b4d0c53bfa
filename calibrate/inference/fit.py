"""Calibration: Levenberg-Marquardt on whitened residuals, over averages of packings.

A descent is a frozen state and a function `step` from one state to the next:

    evaluate -> rules -> update slopes (`calibrate.inference.slopes`) -> solver -> rules

The solver is Optimistix', stepped by hand: each step it asks for the residual at one point, and
gets the simulated residual and its slopes there as an affine function.  So a fit can be watched,
its best iterate kept, and, because every simulation is cached, killed at any moment and started
again with the same end.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from calibrate.core.errors import CalibrationError
from calibrate.inference.evaluation import Calibration, Evaluation, Settings, compared
from calibrate.inference.identifiability import Identifiability, assess, by_profiles
from calibrate.inference.misfit import misses
from calibrate.inference.parameters import to_digits
from calibrate.inference.slopes import AbstractSlopes, LastStep, MeasuredSlopes

SOLVER = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
PROFILE_STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)


# ---------------------------------------------------------------- a descent, step by step


@dataclass(frozen=True, eq=False)
class Descent:
    """Where a descent stands, or where it ended.

    `best` is its best evaluation and `history` has one row for each.  `at` is the evaluation from
    which the solver goes on: the last one, or again the best.  `jacobian` (m + p, p) is the
    residual's there, with respect to the unbounded y of `Space`; None until `estimate`, the slopes,
    took in the last evaluation.  `solver` is Optimistix' own state, which holds the point to
    evaluate next, and `y` (p,) the last point that the solver accepted.  `stopped` says why the
    descent ended; "" while it goes on.
    """

    calibration: Calibration
    estimate: AbstractSlopes
    solver: Any
    y: Array
    best: Evaluation | None = None
    at: Evaluation | None = None
    jacobian: np.ndarray | None = None
    history: tuple[dict, ...] = ()
    stopped: str = ""

    @property
    def slopes(self) -> np.ndarray:
        """Slopes (m, p) per ln p as it knows them."""
        return self.estimate.values

    def no_better_in(self, count: int) -> bool:
        """Whether none of the last evaluations, as many as `count`, was better."""
        last = [row["status"] for row in self.history[-count:]]
        return len(last) == count and "better" not in last


def descend(
    calibration: Calibration, start: np.ndarray | None = None, slopes: AbstractSlopes | None = None
) -> Descent:
    """The solver's way from `start` (p,) to where a rule stops it; arguments as in `fit`."""
    descent = begun(calibration, start, slopes)
    while not descent.stopped:
        descent = step(descent)
    return descent


def begun(
    calibration: Calibration, start: np.ndarray | None = None, slopes: AbstractSlopes | None = None
) -> Descent:
    """Before the first evaluation."""
    space = calibration.space
    y = space.to_unbounded(space.start() if start is None else np.asarray(start, float))
    estimate = MeasuredSlopes.unknown(calibration) if slopes is None else slopes
    return Descent(calibration, estimate, *_at_rest(calibration, y))


def step(descent: Descent) -> Descent:
    """One evaluation and, unless it already ends the descent, the update of the slopes and where
    the solver goes next."""
    seen = _ruled(_evaluated(descent))
    return seen if seen.stopped else _ruled(_moved(seen, descent.best))


def _evaluated(descent: Descent) -> Descent:
    """After the evaluation that the solver asks for."""
    calibration, number = descent.calibration, len(descent.history) + 1
    asked = calibration.space.from_unbounded(np.asarray(descent.solver.y_eval))
    values = to_digits(asked, calibration.settings.digits)
    now = calibration.evaluate(values, f"evaluation {number}")
    best = now if descent.best is None or now.cost < descent.best.cost else descent.best
    found = row(calibration, number, now, now is best)
    calibration.campaign.progress.say(said(calibration, found))
    return replace(descent, best=best, at=now, jacobian=None, history=(*descent.history, found))


def _moved(seen: Descent, before: Evaluation | None) -> Descent:
    """After slopes and solver took in the last evaluation.  From one that was rejected the solver
    begins anew at the best point, with better slopes; if it failed and the slopes are trusted, the
    solver shortens its step instead."""
    calibration, now = seen.calibration, seen.at
    assert now is not None
    last = LastStep(calibration, len(seen.history), now, before, seen.no_better_in(2))
    estimate, at, solver, y = seen.estimate.updated(last), now, seen.solver, seen.y
    if before and not (last.first or last.better or (now.failures and seen.estimate.trusted)):
        at = before
        solver, y = _at_rest(calibration, calibration.space.to_unbounded(before.values))
    jacobian = calibration.jacobian(estimate.values, np.asarray(solver.y_eval))
    local = (jnp.asarray(at.residual), jnp.asarray(jacobian), solver.y_eval)
    y, solver = _solver_step(y, local, solver)
    return replace(seen, estimate=estimate, at=at, jacobian=jacobian, solver=solver, y=y)


def _at_rest(calibration: Calibration, y: np.ndarray) -> tuple[Any, Array]:
    """The solver's state at the unbounded point y (p,), before its first step, and the point."""
    point = jnp.asarray(y)
    blank = _blank(len(calibration.problem.measured) + len(y), len(y))
    return eqx.tree_at(lambda state: state.y_eval, blank, point), point


@cache
def _blank(rows: int, parameters: int) -> Any:
    """The solver's state before it knows a point.  One for each size: a compiled step belongs to
    the state that it began with."""
    point = jnp.zeros(parameters)
    local = (jnp.zeros(rows), jnp.zeros((rows, parameters)), point)
    struct = eqx.filter_eval_shape(lambda: jnp.zeros(rows))
    return SOLVER.init(_affine, point, local, {}, struct, None, frozenset())


@eqx.filter_jit
def _solver_step(y: Array, local: tuple[Array, Array, Array], solver: Any) -> tuple[Array, Any]:
    """The point that the solver accepts next, and its state; `local` as in `_affine`."""
    y, solver, _ = SOLVER.step(_affine, y, local, {}, solver, frozenset())
    return y, solver


def _affine(y: Array, local: tuple[Array, Array, Array]) -> tuple[Array, None]:
    """The residual near the point of evaluation: exact there, in value and slope."""
    residual, jacobian, point = local
    return residual + jacobian @ (y - point), None


def row(calibration: Calibration, number: int, evaluation: Evaluation, better: bool) -> dict:
    """An evaluation for the history of a fit."""
    names = [feature.name for feature in calibration.problem.features]
    status = "failed" if evaluation.failures else ("better" if better else "rejected")
    return {
        "evaluation": number,
        "status": status,
        "failure": "; ".join(evaluation.failures),
        "forward_runs": calibration.forward_runs,
        "cost": evaluation.cost,
        "parameters": dict(zip(calibration.space.names, evaluation.values.tolist(), strict=True)),
        "features": dict(zip(names, evaluation.features.mean(axis=0).tolist(), strict=True)),
    }


def said(calibration: Calibration, row: dict) -> str:
    """The same as a line for the terminal."""
    parameters = ", ".join(f"{k} {v:.4g}" for k, v in row["parameters"].items())
    features = list(zip(calibration.problem.features, row["features"].values(), strict=True))
    shown = ", ".join(f"{f.name} {v:.4g}" for f, v in features if f.is_target)
    begin = f"  {row['evaluation']:2d} {row['status']:8s} cost {row['cost']:9.4g}"
    return f"{begin}  {parameters}  {shown}"


def joined(histories: Sequence[Sequence[dict]]) -> list[dict]:
    """Rows of one history after the other, evaluations and forward runs counted on."""
    rows: list[dict] = []
    for history in histories:
        shift = {k: rows[-1][k] if rows else 0 for k in ("evaluation", "forward_runs")}
        rows += [{**row, **{k: row[k] + n for k, n in shift.items()}} for row in history]
    return rows


# ---------------------------------------------------------------- when it stops


# Asked after each evaluation, before its slopes are paid for (`jacobian` is None), and after them:
# the first that returns a reason, not "", ends the descent.
Rule = Callable[[Descent], str]


@dataclass(frozen=True)
class TargetsMet:
    """Every whitened data residual of the best point is below the tolerance."""

    tolerance: float

    def __call__(self, descent: Descent) -> str:
        at = descent.at
        if at is None or at is not descent.best:
            return ""
        data = at.residual[: len(descent.calibration.problem.measured)]
        met = np.max(np.abs(data)) < self.tolerance
        return "every target is met within the tolerance" if met else ""


@dataclass(frozen=True)
class AsGoodAsChance:
    """Curves are met as well as their scatter allows, where a response explored: half the squared
    norm of the data residual of the best point is what chance leaves of it (Morozov's discrepancy
    principle; Engl, Hanke and Neubauer 1996, Regularization of Inverse Problems, section 4.3), and
    no number is missed.

    Beyond it a fit follows the luck of its few packings, away from what others show."""

    def __call__(self, descent: Descent) -> str:
        at, calibration = descent.at, descent.calibration
        explored = calibration.coarse is not None and calibration.coarse.near
        if not explored or at is None or at is not descent.best or at.failures:
            return ""
        problem = calibration.problem
        if all(feature.is_target for feature in problem.features):
            return ""
        data = at.residual[: len(problem.measured)]
        reached = data @ data <= len(data) and not misses(
            compared(problem, calibration.covariance, at)
        )
        return "curves are met as well as their scatter allows" if reached else ""


@dataclass(frozen=True)
class NothingToGain:
    """The slopes promise less than one residual of the size of the tolerance is worth.

    A target that the prior holds off is never met; this ends the fit all the same."""

    tolerance: float

    def __call__(self, descent: Descent) -> str:
        at, jacobian = descent.at, descent.jacobian
        if jacobian is None or at is None or at is not descent.best or at.failures:
            return ""
        move, *_ = np.linalg.lstsq(jacobian, at.residual, rcond=None)
        gain = 0.5 * float(np.sum((jacobian @ move) ** 2))
        little = gain < 0.5 * self.tolerance**2
        return "no step would lower the cost by more than the tolerance" if little else ""


@dataclass(frozen=True)
class NoBetterPoint:
    """So many evaluations in a row were no better, and the slopes took in the last."""

    evaluations: int

    def __call__(self, descent: Descent) -> str:
        if descent.jacobian is None or not descent.no_better_in(self.evaluations):
            return ""
        return f"no better point in {self.evaluations} evaluations"


@dataclass(frozen=True)
class SmallStep:
    """The solver's own: two points that it accepted hardly differ."""

    def __call__(self, descent: Descent) -> str:
        return "the solver's step became small" if bool(descent.solver.terminate) else ""


@dataclass(frozen=True)
class EnoughEvaluations:
    """So many evaluations were made, and the slopes took in the last."""

    evaluations: int

    def __call__(self, descent: Descent) -> str:
        if descent.jacobian is None or len(descent.history) < self.evaluations:
            return ""
        return f"after {self.evaluations} evaluations"


def rules(settings: Settings) -> tuple[Rule, ...]:
    """The user's own rules, or the usual ones with the numbers of the settings."""
    return settings.stopping or (
        TargetsMet(settings.tolerance),
        AsGoodAsChance(),
        NothingToGain(settings.tolerance),
        NoBetterPoint(settings.patience),
        SmallStep(),
        EnoughEvaluations(settings.evaluations),
    )


def _ruled(descent: Descent) -> Descent:
    """The same, stopped for the first reason that a rule has."""
    reasons = (rule(descent) for rule in rules(descent.calibration.settings))
    return replace(descent, stopped=next(filter(None, reasons), ""))


# ---------------------------------------------------------------- the fit at its end


@dataclass(frozen=True, eq=False)
class Fit:
    """Best iterate, everything evaluated on the way, and what the data fix."""

    best: Evaluation
    history: list[dict]
    identifiability: Identifiability
    profiles: dict[str, list[dict]]
    slopes: np.ndarray
    covariance: np.ndarray
    stopped: str


def fit(
    calibration: Calibration, start: np.ndarray | None = None, slopes: AbstractSlopes | None = None
) -> Fit:
    """Fits from `start` (p,), by default the base soil's values, and says what the data fix.

    `slopes` are what is known of them at the start (`calibrate.inference.slopes`), by default
    nothing: they are measured there.
    """
    return finished(calibration, descend(calibration, start, slopes))


def finished(calibration: Calibration, descent: Descent | Fit) -> Fit:
    """The fit that ends where the descent was best, and what the data fix there."""
    best = descent.best
    if best is None or best.failures:
        reasons = "; ".join(best.failures) if best else "nothing was evaluated"
        raise CalibrationError(f"no evaluation succeeded: {reasons}")
    slopes = calibration.slopes(best.values, "slopes at the best point")
    identifiability = assess(
        calibration.space.names,
        best.values,
        calibration.whitened(slopes),
        calibration.space.prior_sd(),
        calibration.scatter_packings - 1,
        calibration.space.bounds(),
    )
    profiles = _profiles(calibration, identifiability, best)
    return Fit(
        best=best,
        history=list(descent.history),
        identifiability=by_profiles(identifiability, profiles, best.cost),
        profiles=profiles,
        slopes=slopes,
        covariance=calibration.covariance,
        stopped=descent.stopped,
    )


def _profiles(
    calibration: Calibration, found: Identifiability, best: Evaluation
) -> dict[str, list[dict]]:
    """Objective along each free parameter, the others where the slopes say is best.

    Points lie at -2, -1, 0, 1 and 2 posterior deviations.  `linearised` is the profile that
    the covariance implies; `simulated` is what simulation gives at the same point.
    """
    sd, covariance = found.sd_log, found.covariance_log
    correction = calibration.correction(found.values, "both resolutions at the best point")
    profiles = {}
    for column, name in enumerate(found.names):
        rows = []
        for steps in PROFILE_STEPS:
            shift = covariance[:, column] / sd[column] * steps
            values = np.exp(calibration.space.inside(np.log(found.values) + shift))
            what = f"profile of {name}"
            evaluation = calibration.estimate(values, correction, what) if steps else best
            rows.append(
                {
                    "value": float(evaluation.values[column]),
                    "linearised": 0.5 * steps**2,
                    "simulated": evaluation.cost,
                    "failure": "; ".join(evaluation.failures),
                }
            )
        profiles[name] = rows
    return profiles
