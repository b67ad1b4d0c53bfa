"""The slopes of a descent, and how each evaluation updates them.

Slopes (m, p) are those of the mean features per unit of ln p.  They are measured at the start, or
taken from a fit of smaller beds that ended there; later evaluations correct them along the step
that was taken (Broyden 1965, Math. Comp. 19, 577), a rejected one too: where a response is curved,
its chord tells how far to go.

    S' = S + (change of the features - S step) step' / |step|^2,     step in ln p

They are measured anew where two evaluations in a row are rejected, unless they were measured at
that very point.
"""

import abc
from dataclasses import dataclass

import numpy as np

from calibrate.inference.evaluation import Calibration, Evaluation

SMALLEST_STEP = 1e-4  # square of ln p; shorter steps are noise and correct little


@dataclass(frozen=True, eq=False)
class LastStep:
    """An evaluation, its number, and the best one before it; `rejected_before`: the evaluation
    before was no better either."""

    calibration: Calibration
    number: int
    now: Evaluation
    before: Evaluation | None
    rejected_before: bool

    @property
    def first(self) -> bool:
        """Whether nothing succeeded before."""
        return self.before is None or bool(self.before.failures)

    @property
    def better(self) -> bool:
        return self.before is None or self.now.cost < self.before.cost


class AbstractSlopes(abc.ABC):
    """Slopes (m, p) of the mean features per unit of ln p, in `values`, as far as they are known.

    `trusted`: a run that fails is laid to the length of the step, not to them.  The solver then
    shortens the step; otherwise it begins anew at the best point.
    """

    values: np.ndarray
    trusted: bool

    @abc.abstractmethod
    def updated(self, last: LastStep) -> "AbstractSlopes":
        """The slopes at the best point after an evaluation; this may simulate."""


@dataclass(frozen=True, eq=False)
class MeasuredSlopes(AbstractSlopes):
    """As the calibration's strategy measured them `at` a point; None: not yet, and all are zero."""

    values: np.ndarray
    at: Evaluation | None
    trusted = True

    @staticmethod
    def unknown(calibration: Calibration) -> "MeasuredSlopes":
        """Before the first evaluation."""
        shape = (len(calibration.problem.measured), len(calibration.space.names))
        return MeasuredSlopes(np.zeros(shape), None)

    @staticmethod
    def measured(last: LastStep, at: Evaluation) -> "MeasuredSlopes":
        what = f"slopes at evaluation {last.number}"
        return MeasuredSlopes(last.calibration.slopes(at.values, what), at)

    def updated(self, last: LastStep) -> AbstractSlopes:
        if last.now.failures and (last.first or not last.better):
            return self
        if last.first:
            return MeasuredSlopes.measured(last, last.now)
        return _corrected(self.values, self.at, last)


@dataclass(frozen=True, eq=False)
class CorrectedSlopes(AbstractSlopes):
    """Corrected by secants since they were measured `at` a point; None: they never were."""

    values: np.ndarray
    at: Evaluation | None
    trusted = False

    def updated(self, last: LastStep) -> AbstractSlopes:
        return _corrected(self.values, self.at, last)


@dataclass(frozen=True, eq=False)
class SlopesOfSmallerBeds(AbstractSlopes):
    """Those with which a fit of smaller beds ended, where this one begins: the first evaluation
    scales them by the ratio of both sizes' features."""

    values: np.ndarray
    trusted = False

    def updated(self, last: LastStep) -> AbstractSlopes:
        if last.now.failures:
            return MeasuredSlopes.unknown(last.calibration)
        ratio = last.calibration.correction(last.now.values, "both resolutions").ratio
        return CorrectedSlopes(self.values * ratio[:, None], None)


def _corrected(values: np.ndarray, at: Evaluation | None, last: LastStep) -> AbstractSlopes:
    """Slopes corrected along the last step, or measured anew at its beginning if it and the one
    before went wrong and they were not measured just there."""
    before, now = last.before, last.now
    assert before is not None
    wrong = not last.better and (now.failures or last.rejected_before)
    if wrong and at is not before:
        return MeasuredSlopes.measured(last, before)
    return CorrectedSlopes(secant(values, before, now), at)


def secant(slopes: np.ndarray, before: Evaluation, after: Evaluation) -> np.ndarray:
    """Slopes (m, p) per ln p, corrected to give what changed from one point to the next; as they
    are where one of both failed."""
    step = np.log(after.values / before.values)
    change = after.features.mean(axis=0) - before.features.mean(axis=0)
    missed = change - slopes @ step
    if not np.all(np.isfinite(missed)):
        return slopes
    return slopes + np.outer(missed, step) / max(float(step @ step), SMALLEST_STEP)
