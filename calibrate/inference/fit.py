"""Calibration: Levenberg-Marquardt on whitened residuals, over averages of packings.

The solver is Optimistix', stepped by hand: each step it asks for the residual at one
point, and gets the simulated residual and its slopes there as an affine function.  So a
fit can be watched, its best iterate kept, and, because every simulation is cached,
killed at any moment and started again with the same end.

Slopes are measured at the start, or taken from a fit of smaller beds that ended there; later
evaluations correct them along the step that was taken (Broyden 1965, Math. Comp. 19, 577), a
rejected one too: where a response is curved, its chord tells how far to go.  They are measured
anew where two in a row are rejected, unless they were measured at that very point.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from calibrate.core.errors import CalibrationError
from calibrate.inference.evaluation import Calibration, Evaluation
from calibrate.inference.identifiability import Identifiability, assess, by_profiles
from calibrate.inference.parameters import to_digits


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


PROFILE_STEPS = (-2.0, -1.0, 0.0, 1.0, 2.0)


def fit(
    calibration: Calibration, start: np.ndarray | None = None, slopes: np.ndarray | None = None
) -> Fit:
    """Fits from `start` (p,), by default the base soil's values, and says what the data fix.

    slopes (m, p) per ln p are those of smaller beds at the start, if they are known.
    """
    return finished(calibration, descend(calibration, start, slopes))


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the solver went: best evaluation, one row for each evaluation, why it stopped, and the
    slopes (m, p) per ln p as it knew them in the end."""

    best: Evaluation | None
    history: list[dict]
    stopped: str
    slopes: np.ndarray


def descend(
    calibration: Calibration, start: np.ndarray | None = None, slopes: np.ndarray | None = None
) -> Descent:
    """The solver's walk from `start` (p,) alone; slopes as in `fit`."""
    space, settings = calibration.space, calibration.settings
    first = space.start() if start is None else np.asarray(start, float)
    walk = _Walk(calibration, space.to_unbounded(first), slopes)
    stopped = f"after {settings.evaluations} evaluations"
    for _ in range(settings.evaluations):
        reason = walk.advance()
        if reason:
            stopped = reason
            break
    return Descent(walk.best, walk.history, stopped, walk.slopes)


class _Walk:
    """The solver's state between evaluations, and the best evaluation so far."""

    def __init__(self, calibration: Calibration, y: np.ndarray, slopes: np.ndarray | None = None):
        self._calibration, self._given = calibration, slopes
        self._solver = optx.LevenbergMarquardt(rtol=1e-6, atol=1e-6)
        self.best: Evaluation | None = None
        self.slopes = np.zeros((len(calibration.problem.measured), len(y)))
        self._corrected = False
        self._measured_at: Evaluation | None = None
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
        values = to_digits(calibration.space.from_unbounded(y))
        evaluation = calibration.evaluate(values, f"evaluation {number}")
        before, better = self.best, self.best is None or evaluation.cost < self.best.cost
        if better:
            self.best = evaluation
        self.history.append(_row(calibration, number, evaluation, better))
        calibration.campaign.progress.say(_line(calibration, self.history[-1]))
        if better and _close_enough(calibration, evaluation):
            return "every target is met within the tolerance"
        if before is None and self._given is not None and not evaluation.failures:
            ratio = calibration.correction(evaluation.values, "both resolutions").ratio
            self.slopes, self._corrected = self._given * ratio[:, None], True
        elif before is None or before.failures:
            self._measure(evaluation)
        elif better:
            self.slopes = secant(self.slopes, before, evaluation)
            self._corrected = True
        elif self._corrected or not evaluation.failures:
            self._learn(before, evaluation)
            evaluation, y = before, calibration.space.to_unbounded(before.values)
            self._begin(y)
        return self._step(evaluation, y)

    def _learn(self, before: Evaluation, rejected: Evaluation) -> None:
        """Slopes at `before` once a step from there was rejected: corrected along that step, or
        measured anew if two steps in a row went wrong and they were not measured just there."""
        wrong = rejected.failures or self._rejected_before()
        if wrong and self._measured_at is not before:
            self._measure(before)
        elif not rejected.failures:
            self.slopes = secant(self.slopes, before, rejected)
            self._corrected = True

    def _rejected_before(self) -> bool:
        """Whether the evaluation before the last was no better either."""
        return self.history[-2]["status"] != "better"

    def _measure(self, evaluation: Evaluation) -> None:
        if not evaluation.failures:
            what = f"slopes at evaluation {len(self.history)}"
            self.slopes = self._calibration.slopes(evaluation.values, what)
            self._corrected, self._measured_at = False, evaluation

    def _step(self, evaluation: Evaluation, y: np.ndarray) -> str:
        jacobian = self._calibration.jacobian(self.slopes, y)
        if evaluation is self.best and _nothing_left(self._calibration, evaluation, jacobian):
            return "no step would lower the cost by more than the tolerance"
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


def _nothing_left(calibration: Calibration, best: Evaluation, jacobian: np.ndarray) -> bool:
    """Whether the slopes promise less than one residual of the size of the tolerance is worth.

    A target that the prior holds off is never met; this ends the fit all the same."""
    if best.failures:
        return False
    step, *_ = np.linalg.lstsq(jacobian, best.residual, rcond=None)
    gain = 0.5 * float(np.sum((jacobian @ step) ** 2))
    return gain < 0.5 * calibration.settings.tolerance**2


def finished(calibration: Calibration, descent: Descent) -> Fit:
    """The fit that ends where the walk was best, and what the data fix there."""
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
    identifiability = by_profiles(identifiability, profiles, best.cost)
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
