"""Calibration: Levenberg-Marquardt on whitened residuals, over averages of packings.

    r(y) = [ L^-1 (measured - mean over packings) ,  (ln p - ln p0)/prior_sd ],   L L' = Sigma

The solver is Optimistix', stepped by hand: each step it asks for the residual at one
point, and gets the simulated residual and its slopes there as an affine function.  So a
fit can be watched, its best iterate kept, and, because every simulation is cached,
killed at any moment and started again with the same end.

Slopes are measured at the start; later evaluations correct them along the step that was
taken (Broyden 1965, Math. Comp. 19, 577), a rejected one too; they are measured anew
where two in a row are rejected.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from calibrate.core.errors import CalibrationError
from calibrate.inference.identifiability import Identifiability, assess
from calibrate.inference.parameters import Space, fitting_ensemble
from calibrate.inference.problem import Problem, shrunk_covariance
from calibrate.inference.resolutions import Coarse, Correction
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from jdem.sensitivity.base import AbstractStrategy


@dataclass(frozen=True)
class Settings:
    """How long and how finely to fit.

    A fit is done when every whitened data residual is below `tolerance`, when the solver
    says so, when `patience` evaluations in a row were no better, or after `evaluations`.
    Slopes come from `strategy` in ln p, by default what the audit passes: the ensemble, with
    parameters that it could not confirm in groups moved alone (docs/gradients.md).
    """

    evaluations: int = 24
    patience: int = 6
    tolerance: float = 0.15
    strategy: AbstractStrategy | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One point that the solver asked for.

    values (p,) are parameters in SI; features (n, m) on each packing; residual is
    whitened, data first, then prior; cost is half its squared norm.
    """

    values: np.ndarray
    features: np.ndarray
    residual: np.ndarray
    failures: tuple[str, ...]

    @property
    def cost(self) -> float:
        return 0.5 * float(self.residual @ self.residual)


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


@dataclass(eq=False)
class Calibration:
    """A problem, a space of parameters, and the packings on which both are evaluated.

    relative_scatter (m, m) is the covariance of one packing's features over their mean,
    from `scatter_packings` packings.  With `coarse`, slopes are those of its smaller beds, times
    the ratio of both sizes' features (`calibrate.inference.resolutions`).
    """

    problem: Problem
    space: Space
    campaign: AbstractCampaign
    seeds: Sequence[int]
    relative_scatter: np.ndarray
    scatter_packings: int
    settings: Settings = field(default_factory=Settings)
    coarse: Coarse | None = None

    def __post_init__(self):
        self.covariance = self.problem.covariance(self.relative_scatter, len(self.seeds))
        self.forward_runs = 0.0  # asked for so far, on each packing
        self.strategy = self.settings.strategy or fitting_ensemble(self.space)
        self._whitening = np.linalg.inv(np.linalg.cholesky(self.covariance))
        self._centre = np.log(self.space.start())

    def probed(self, points: np.ndarray, what: str) -> np.ndarray:
        """Features (k, n, m) at points (k, n, p) of ln p, one for each packing of those that slopes
        are taken on."""
        soils = [
            [self.space.soil(np.exp(point)) for point in row] for row in self.space.inside(points)
        ]
        campaign = self.campaign if self.coarse is None else self.coarse.campaign
        rows = campaign.each(soils, self.seeds, what)
        return np.array([self.problem.simulated(row) for row in rows])

    def evaluate(self, values: np.ndarray, what: str) -> Evaluation:
        """Features and whitened residual at parameter values (p,)."""
        runs = self.campaign.runs([self.space.soil(values)], self.seeds, what)[0]
        self.forward_runs += 1
        failures = tuple(run.failure for run in runs if run.failure)
        return self._evaluated(values, self.problem.simulated(runs), failures)

    def estimate(self, values: np.ndarray, correction: Correction, what: str) -> Evaluation:
        """The same from the beds that slopes are taken on, times a ratio known from elsewhere."""
        if self.coarse is None:
            return self.evaluate(values, what)
        runs = self.coarse.campaign.runs([self.space.soil(values)], self.seeds, what)[0]
        failures = tuple(run.failure for run in runs if run.failure)
        return self._evaluated(values, self.problem.simulated(runs) * correction.ratio, failures)

    def _evaluated(
        self, values: np.ndarray, features: np.ndarray, failures: tuple[str, ...]
    ) -> Evaluation:
        residual = self._residual(features.mean(axis=0), np.log(values))
        if not np.all(np.isfinite(residual)):
            residual = np.full_like(residual, _REJECTED)
        return Evaluation(values, features, residual, failures)

    def slopes(self, values: np.ndarray, what: str) -> np.ndarray:
        """Slopes (m, p) of the mean features per unit of ln p."""

        def response(points: Array) -> Array:
            return jnp.asarray(self.probed(np.asarray(points), what))

        strategy, packings = self.strategy, len(self.seeds)
        found = strategy(response, jnp.log(values), packings)
        cost = 1.0 if self.coarse is None else self.coarse.cost
        self.forward_runs += cost * (strategy.runs(len(values), packings) - 1)  # centre: known
        slopes = np.asarray(found.slopes) * self.correction(values, what).ratio[:, None]
        if not np.all(np.isfinite(slopes)):
            self.campaign.progress.say(
                "  too many probes failed: slopes that are not known are set to zero"
            )
        return np.nan_to_num(slopes)

    def correction(self, values: np.ndarray, what: str) -> Correction:
        """Ratio of the fitted beds' features to those of the beds that slopes are taken on."""
        if self.coarse is None:
            return Correction.none(len(self.problem.measured))
        soil = self.space.soil(values)
        large = self.problem.simulated(self.campaign.runs([soil], self.seeds, what)[0])
        return Correction.of(large, self.coarse.features(self.problem, soil, self.seeds, what))

    def whitened(self, slopes: np.ndarray) -> np.ndarray:
        return self._whitening @ slopes

    def jacobian(self, slopes: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Of the residual with respect to y, from slopes per ln p."""
        prior = np.diag(1 / self.space.prior_sd())
        return np.concatenate([-self.whitened(slopes), prior]) * self.space.log_slope(y)

    def _residual(self, mean: np.ndarray, log_values: np.ndarray) -> np.ndarray:
        data = self._whitening @ (self.problem.measured - mean)
        prior = (log_values - self._centre) / self.space.prior_sd()
        return np.concatenate([data, prior])


PROFILE_STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)
_REJECTED = 1e3  # residual of a failed evaluation: larger than any honest one


def fit(calibration: Calibration, start: np.ndarray | None = None) -> Fit:
    """Fits from `start` (p,), by default the base soil's values, and says what the data fix."""
    return _finished(calibration, descend(calibration, start))


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the solver went: best evaluation, one row for each evaluation, why it stopped."""

    best: Evaluation | None
    history: list[dict]
    stopped: str


def descend(calibration: Calibration, start: np.ndarray | None = None) -> Descent:
    """The solver's walk from `start` (p,) alone."""
    space, settings = calibration.space, calibration.settings
    first = space.start() if start is None else np.asarray(start, float)
    walk = _Walk(calibration, space.to_unbounded(first))
    stopped = f"after {settings.evaluations} evaluations"
    for _ in range(settings.evaluations):
        reason = walk.advance()
        if reason:
            stopped = reason
            break
    return Descent(walk.best, walk.history, stopped)


class _Walk:
    """The solver's state between evaluations, and the best evaluation so far."""

    def __init__(self, calibration: Calibration, y: np.ndarray):
        self._calibration = calibration
        self._solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
        self.best: Evaluation | None = None
        self.slopes = np.zeros((len(calibration.problem.measured), len(y)))
        self._corrected = False
        self.history: list[dict] = []
        self._begin(y)

    def _begin(self, y: np.ndarray) -> None:
        """The solver anew, from the unbounded point y."""
        self.y = jnp.asarray(y)
        rows = len(self._calibration.problem.measured) + len(y)
        blank = (jnp.zeros(rows), jnp.zeros((rows, len(y))), self.y)
        struct = eqx.filter_eval_shape(lambda: jnp.zeros(rows))
        self._state = self._solver.init(_affine, self.y, blank, {}, struct, None, frozenset())

    def advance(self) -> str:
        """One evaluation and one solver step; a reason to stop, or nothing."""
        calibration, number = self._calibration, len(self.history) + 1
        y = np.asarray(self._state.y_eval)
        values = calibration.space.from_unbounded(y)
        evaluation = calibration.evaluate(values, f"evaluation {number}")
        before, better = self.best, self.best is None or evaluation.cost < self.best.cost
        if better:
            self.best = evaluation
        self.history.append(_row(calibration, number, evaluation, better))
        calibration.campaign.progress.say(_line(calibration, self.history[-1]))
        if better and _close_enough(calibration, evaluation):
            return "every target is met within the tolerance"
        if before is None or before.failures:
            self._measure(evaluation)
        elif better:
            self.slopes = secant(self.slopes, before, evaluation)
            self._corrected = True
        elif self._corrected:
            if evaluation.failures or self._rejected_before():
                self._measure(before)
            else:
                self.slopes = secant(self.slopes, before, evaluation)
            evaluation, y = before, calibration.space.to_unbounded(before.values)
            self._begin(y)
        return self._step(evaluation, y)

    def _rejected_before(self) -> bool:
        """Whether the evaluation before the last was no better either."""
        return self.history[-2]["status"] != "better"

    def _measure(self, evaluation: Evaluation) -> None:
        if not evaluation.failures:
            what = f"slopes at evaluation {len(self.history)}"
            self.slopes = self._calibration.slopes(evaluation.values, what)
            self._corrected = False

    def _step(self, evaluation: Evaluation, y: np.ndarray) -> str:
        jacobian = self._calibration.jacobian(self.slopes, y)
        local = (jnp.asarray(evaluation.residual), jnp.asarray(jacobian), jnp.asarray(y))
        self.y, self._state, _ = self._solver.step(
            _affine, self.y, local, {}, self._state, frozenset()
        )
        last = [row["status"] for row in self.history[-self._calibration.settings.patience :]]
        if len(last) == self._calibration.settings.patience and "better" not in last:
            return f"no better point in {len(last)} evaluations"
        done, _ = self._solver.terminate(_affine, self.y, local, {}, self._state, frozenset())
        return "the solver's step became small" if bool(done) else ""


def secant(slopes: np.ndarray, before: Evaluation, after: Evaluation) -> np.ndarray:
    """Slopes (m, p) per ln p, corrected to give what changed from one point to the next."""
    step = np.log(after.values / before.values)
    change = after.features.mean(axis=0) - before.features.mean(axis=0)
    missed = change - slopes @ step
    if not np.all(np.isfinite(missed)):
        return slopes
    return slopes + np.outer(missed, step) / max(float(step @ step), _SMALLEST_STEP)


_SMALLEST_STEP = 1e-4  # square of ln p; shorter steps are noise and correct little


def _affine(y: Array, local: tuple[Array, Array, Array]) -> tuple[Array, None]:
    """The residual near the point of evaluation: exact there, in value and slope."""
    residual, jacobian, point = local
    return residual + jacobian @ (y - point), None


def _close_enough(calibration: Calibration, evaluation: Evaluation) -> bool:
    data = evaluation.residual[: len(calibration.problem.measured)]
    return bool(np.max(np.abs(data)) < calibration.settings.tolerance)


def _finished(calibration: Calibration, descent: Descent) -> Fit:
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
    )
    profiles = _profiles(calibration, identifiability)
    covariance = calibration.covariance
    return Fit(
        best,
        descent.history,
        identifiability,
        profiles,
        slopes,
        covariance,
        descent.stopped,
    )


def _profiles(calibration: Calibration, found: Identifiability) -> dict[str, list[dict]]:
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
            evaluation = calibration.estimate(values, correction, f"profile of {name}")
            rows.append(
                {
                    "value": float(values[column]),
                    "linearised": 0.5 * steps**2,
                    "simulated": evaluation.cost,
                    "failure": "; ".join(evaluation.failures),
                }
            )
        profiles[name] = rows
    return profiles


def _row(calibration: Calibration, number: int, evaluation: Evaluation, better: bool) -> dict:
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


def _line(calibration: Calibration, row: dict) -> str:
    parameters = ", ".join(f"{k} {v:.4g}" for k, v in row["parameters"].items())
    features = list(zip(calibration.problem.features, row["features"].values(), strict=True))
    shown = ", ".join(f"{f.name} {v:.4g}" for f, v in features if f.is_target)
    begin = f"  {row['evaluation']:2d} {row['status']:8s} cost {row['cost']:9.4g}"
    return f"{begin}  {parameters}  {shown}"


def packing_scatter(
    problem: Problem, runs: Callable[[Sequence[int]], list[Run]], seeds: Sequence[int]
) -> np.ndarray:
    """Covariance (m, m) of one packing's features over their mean."""
    finished = runs(seeds)
    failures = [run.failure for run in finished if run.failure]
    if len(failures) > len(finished) // 2:
        repair = "start from another, by [parameters] of the lab file or --set"
        raise CalibrationError(f"the starting soil cannot be simulated: {failures[0]}; {repair}")
    features = problem.simulated([run for run in finished if not run.failure])
    return shrunk_covariance(features / features.mean(axis=0))
