"""Which parameters to free beside those that were chosen, where their best fit misses, and from
where to begin.

Around a point p1 with simulated features y1, in logarithms (strength goes with powers of surface
energy and plasticity ratio, stiffness with one of the shear modulus):

    ln y(p) = ln y1 + e (ln p - ln p1),                  e = d ln y / d ln p
    cost(S) = min over the parameters of S, within their bounds and FARTHEST from p1, of
              |L^-1 (ln measured - ln y(p))|^2 / 2 + |(ln p - ln p0) / prior_sd|^2 / 2

Slopes of the free parameters are those of the fit where it ended; of all others those that the
screening measured at the start, in proportion.  A parameter is added where it lowers the cost by
more than GAIN, the price of one number (Akaike 1974, IEEE Trans. Automatic Control 19, 716).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from calibrate.inference.evaluation import Calibration, Evaluation, compared
from calibrate.inference.fit import Descent, Fit
from calibrate.inference.misfit import misses
from calibrate.inference.on_response import Solved
from calibrate.inference.parameters import Space, to_digits
from calibrate.io.lab import Lab

ROUNDS = 3  # after the first
MOST = 3  # parameters that a round adds
GAIN = 1.0  # of the cost, for one parameter
WORTH = 3.0  # of the cost, for a round where no number is missed by itself
FARTHEST = np.log(4.0)  # of a step in ln p
RIM = 0.02  # of a range in ln p, next to either bound: there the solver's steps vanish


@dataclass(frozen=True, eq=False)
class Screened:
    """Slopes (m, p) per ln p of every candidate at the start, and the features (m,) there."""

    space: Space
    slopes: np.ndarray
    features: np.ndarray

    def at(self, features: np.ndarray) -> np.ndarray:
        """Slopes (m, p) where the features are others: in proportion to each."""
        both = (features > 0) & (self.features > 0)
        ratio = np.where(both, features / np.where(both, self.features, 1.0), 1.0)
        return self.slopes * ratio[:, None]


@dataclass(frozen=True, eq=False)
class Advice:
    """Names to free, the added ones last, the values (p,) that the slopes promise, and the cost
    there; `cost` is what the free ones alone would come to."""

    names: tuple[str, ...]
    values: np.ndarray
    cost: float
    promised: float

    @property
    def gain(self) -> float:
        return self.cost - self.promised


@dataclass(frozen=True, eq=False)
class Outlook:
    """The model above around one point in ln p (p,): whitened residual (m,) and slopes (m, p).

    Free parameters whose slopes promise what their fit did not find are `held` at the point."""

    space: Space
    residual: np.ndarray
    slopes: np.ndarray
    point: np.ndarray
    held: tuple[str, ...] = ()

    @staticmethod
    def of(calibration: Calibration, screened: Screened, at: Evaluation, slopes) -> "Outlook":
        """Around an evaluation, with the slopes (m, k) of the free parameters where the fit knows
        them (None: the screening's)."""
        problem, every = calibration.problem, screened.space
        simulated, measured = at.features.mean(axis=0), problem.measured
        columns = screened.at(simulated)
        point = np.log(every.start())
        for k, name in enumerate(calibration.space.names):
            column = every.names.index(name)
            point[column] = np.log(at.values[k])
            if slopes is not None:
                columns[:, column] = slopes[:, k]
        deviation = np.sqrt(np.diag(calibration.covariance))
        size = np.where(measured != 0, measured, deviation)
        logs = (simulated > 0) & (measured > 0)
        ratio = np.where(logs, measured / np.where(logs, simulated, 1.0), 1.0)
        off = np.where(logs, np.log(ratio), (measured - simulated) / size)
        whitening = np.linalg.inv(np.linalg.cholesky(calibration.covariance / np.outer(size, size)))
        relative = columns / np.where(logs, simulated, size)[:, None]
        found = Outlook(every, whitening @ off, whitening @ relative, point)
        names = calibration.space.names
        if slopes is None or found.best(())[1] - found.best(names)[1] < GAIN:
            return found
        return replace(found, held=names)

    def best(self, free: Sequence[str]) -> tuple[np.ndarray, float]:
        """Values (p,) of all candidates where the free ones are best, and the cost there."""
        chosen = [self.space.names.index(name) for name in free if name not in self.held]
        prior, centre = self.space.prior_sd(), np.log(self.space.start())
        off = (centre - self.point) / prior
        matrix = np.concatenate([self.slopes[:, chosen], np.diag(1 / prior)[:, chosen]])
        target = np.concatenate([self.residual, off])
        if not chosen:
            return np.exp(self.space.inside(self.point)), 0.5 * float(target @ target)
        low, high = (self.space.inside(self.point + way) for way in (-FARTHEST, FARTHEST))
        least = np.minimum(low - self.point, -1e-9)[chosen]
        most = np.maximum(high - self.point, 1e-9)[chosen]
        step = np.zeros(len(self.point))
        step[chosen] = lsq_linear(matrix, target, (least, most)).x
        missing = target - matrix @ step[chosen]
        return np.exp(self.space.inside(self.point + step)), 0.5 * float(missing @ missing)

    def more(self, free: Sequence[str]) -> Advice:
        """The free ones and those that lower the cost most, one after the other."""
        names = list(free)
        values, cost = self.best(names)
        alone = cost
        while len(names) < len(free) + MOST:
            rest = [name for name in self.space.names if name not in names]
            if not rest:
                break
            trials = {name: self.best([*names, name]) for name in rest}
            best = min(trials, key=lambda name: trials[name][1])
            if cost - trials[best][1] < GAIN:
                break
            values, cost = trials[best]
            names.append(best)
        kept = [self.space.names.index(name) for name in names]
        return Advice(tuple(names), values[kept], alone, cost)


@dataclass(frozen=True, eq=False)
class Round:
    """One choice of free parameters and where its fit went, or ended."""

    calibration: Calibration
    descent: Descent | Fit | Solved

    @property
    def names(self) -> tuple[str, ...]:
        return self.calibration.space.names

    @property
    def best(self) -> Evaluation | None:
        """The best evaluation; None where none succeeded."""
        best = self.descent.best
        return None if best is None or best.failures else best

    @property
    def cost(self) -> float:
        return np.inf if self.best is None else self.best.cost

    def compared(self, best: Evaluation) -> dict[str, dict]:
        return compared(self.calibration.problem, self.calibration.covariance, best)

    def as_json(self) -> dict:
        """Plain numbers for the record of a fit."""
        missed = [] if self.best is None else map(str, misses(self.compared(self.best)))
        return {"free": list(self.names), "cost": self.cost, "missed": list(missed)}


def advice(last: Round, screened: Screened) -> Advice | None:
    """What to free beside what was; None where that would not help, or nothing is missed."""
    best = last.best
    if best is None:
        return None
    outlook = Outlook.of(last.calibration, screened, best, last.descent.slopes)
    found = outlook.more(last.names)
    enough = GAIN if misses(last.compared(best)) else WORTH
    return found if found.names != last.names and found.gain >= enough else None


def widened(
    first: Round,
    screened: Screened,
    calibration_of: Callable[[tuple[str, ...]], Calibration],
    descend: Callable[[Calibration, np.ndarray], Descent | Solved],
) -> list[Round]:
    """The first round and those that free more, until nothing is missed or nothing helps; each
    descends from where it begins."""
    rounds = [first]
    while len(rounds) <= ROUNDS:
        last = rounds[-1]
        found = advice(last, screened)
        if found is None or (len(rounds) > 1 and last.cost > rounds[-2].cost - GAIN):
            break
        added = ", ".join(found.names[len(last.names) :])
        calibration = calibration_of(found.names)
        calibration.campaign.progress.say(
            f"the best fit of {', '.join(last.names)} does not meet the data (cost "
            f"{last.cost:.3g}): freeing {added} too"
        )
        start = _start(calibration, last, screened, found)
        rounds.append(Round(calibration, descend(calibration, start)))
    return rounds


def chosen(rounds: Sequence[Round]) -> Round:
    """The round that counts: the first that no later one beats by the price of a parameter."""
    kept = rounds[0]
    for later in rounds[1:]:
        if later.cost < kept.cost - GAIN:
            kept = later
    return kept


def _start(calibration: Calibration, last: Round, screened: Screened, found: Advice) -> np.ndarray:
    """Where to begin: what the slopes promise from where the last round ended, the same from the
    lab file's start, or where it ended, whichever simulates best."""
    space = calibration.space
    ended = space.start()
    if last.best is not None:
        ended[: len(last.names)] = last.best.values
    places = [found.values, ended]
    origin = calibration.evaluate(to_digits(space.start()), "the start")
    if not origin.failures:
        values, _ = Outlook.of(calibration, screened, origin, None).best(found.names)
        places.append(values[[screened.space.names.index(name) for name in found.names]])
    inner = [to_digits(_off_the_rim(space, values)) for values in places]
    tried = [calibration.evaluate(values, "where to begin") for values in inner]
    return min(tried, key=lambda each: np.inf if each.failures else each.cost).values


def _off_the_rim(space: Space, values: np.ndarray) -> np.ndarray:
    low, high = space.log_bounds()
    rim = RIM * (high - low)
    return np.exp(np.clip(np.log(values), low + rim, high - rim))


def advised(last: Round, screened: Screened, lab: Lab, by_user: bool, tried: Sequence[str]) -> str:
    """One sentence of what would help a fit that missed: parameters to free and the command, else
    bounds, else that nothing in the model does.  `tried` were free in vain."""
    best = last.best
    assert best is not None
    outlook = Outlook.of(last.calibration, screened, best, last.descent.slopes)
    found = outlook.more(last.names)
    if by_user and found.names != last.names:
        added = ", ".join(found.names[len(last.names) :])
        return (
            f"by the slopes at the start, freeing {added} too would help (objective "
            f"{found.promised:.3g} for {found.cost:.3g}): calibrate fit {lab.file} --free "
            f"{','.join(found.names)}"
        )
    in_vain = f"; freeing {', '.join(tried)} too was tried in vain" if tried else ""
    bound = last.calibration.space.at_bound(best.values)
    if bound:
        return (
            f"{', '.join(bound)} stopped at a bound{in_vain}: if a value beyond is believable, "
            "give its low or high in [parameters] of the lab file and fit again"
        )
    return (
        "no parameter that can be fitted brings the simulation nearer to all numbers at once"
        f"{in_vain}: they contradict each other for this model, or the soil is far from the start; "
        "check units, specimen and test in the lab file, give another start (--set NAME=VALUE), or "
        "ask what the model leaves out (calibrate diagnose)"
    )
