"""Where a fit looks: features, whitened residual, density and slopes at parameter values.

    r(p) = [ L^-1 (measured - mean over packings) ,  (ln p - ln p0)/prior_sd ],   L L' = Sigma
    ln density(p | measured) = -|r|^2 / 2 - ln det L - sum ln prior_sd - (m + p)/2 ln 2 pi

Values are those of the fitted beds; slopes may come from smaller ones, by pairs of runs, or by
derivatives that JAX took of them or of a response in their place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.inference.parameters import DIGITS, Space, fitting_ensemble, to_digits
from calibrate.inference.problem import Problem, finished_features, shrunk_covariance
from calibrate.inference.resolutions import AbstractCoarse, Correction
from calibrate.inference.traced import FirstOrder
from calibrate.simulation import Campaign, Run
from calibrate.simulation.joint import AbstractCampaign
from jdem.sensitivity.base import AbstractStrategy, AbstractTraced


class Whitened(eqx.Module):
    """What was measured, and what was known beforehand: measured (m,), whitening (m, m), which is
    L^-1; centre (p,) and prior_sd (p,) of ln p.  Arrays of numpy or JAX."""

    measured: Any
    whitening: Any
    centre: Any
    prior_sd: Any

    def __call__(self, values, features):
        """r (m + p,) of parameters (p,) that give these features (m,)."""
        both = (values, features)
        numbers: Any = jnp if any(isinstance(given, Array) for given in both) else np
        data = self.whitening @ (self.measured - features)
        prior = (numbers.log(values) - self.centre) / self.prior_sd
        return numbers.concatenate([data, prior])


REJECTED = 1e3  # residual of a failed evaluation: larger than any honest one
A = TypeVar("A", np.ndarray, Array)


@dataclass(frozen=True)
class Settings:
    """How long and how finely to fit.

    A fit is done when every whitened data residual is below `tolerance`, when its slopes promise
    less than half the tolerance's square, when the solver says so, when `patience` evaluations in
    a row were no better, or after `evaluations`.
    `stopping` are rules of your own in place of these (`calibrate.inference.fit`).
    Slopes come from `strategy` in ln p, by default the ensemble, with parameters that the audit
    could not confirm in groups moved alone; a strategy that differentiates the run itself, as
    `Overdamped`, is for tests in which no specimen stands free (docs/derivatives.md).
    Points are rounded to `digits`, so that a fit that is started again finds its simulations.
    """

    evaluations: int = 24
    patience: int = 6
    tolerance: float = 0.15
    strategy: AbstractStrategy | None = None
    digits: int = DIGITS
    stopping: tuple[Callable[[Any], str], ...] | None = None


@dataclass(frozen=True, eq=False)
class Evaluation:
    """One point that the solver asked for.

    values (p,) are parameters in SI; features (n, m) on each packing; residual (m + p,) is
    whitened, data first, then prior; cost is half its squared norm: minus the log density, but for
    a constant.
    """

    values: np.ndarray
    features: np.ndarray
    residual: np.ndarray
    failures: tuple[str, ...]

    @property
    def cost(self) -> float:
        return 0.5 * float(self.residual @ self.residual)


@dataclass(eq=False)
class Calibration:
    """A problem, a space of parameters, and the packings on which both are evaluated.

    relative_scatter (m, m) is the covariance of one packing's features over their mean,
    from `scatter_packings` packings.  With `coarse`, slopes are those of its smaller beds, or of
    the response that takes their place, times the ratio of both features
    (`calibrate.inference.resolutions`).
    """

    problem: Problem
    space: Space
    campaign: AbstractCampaign
    seeds: Sequence[int]
    relative_scatter: np.ndarray
    scatter_packings: int
    settings: Settings = field(default_factory=Settings)
    coarse: AbstractCoarse | None = None

    def __post_init__(self):
        self.covariance = self.problem.covariance(self.relative_scatter, len(self.seeds))
        self.forward_runs = 0.0  # asked for so far, on each packing
        self.strategy = self.settings.strategy or fitting_ensemble(self.space)
        self._first: FirstOrder | None = None
        self.whole = Whitened(
            self.problem.measured,
            np.linalg.inv(np.linalg.cholesky(self.covariance)),
            np.log(self.space.start()),
            self.space.prior_sd(),
        )

    def probed(self, points: np.ndarray, what: str) -> np.ndarray:
        """Features (k, n, m) at points (k, n, p) of ln p, one for each packing of those that slopes
        are taken on."""
        values = to_digits(np.exp(self.space.inside(points)))
        soils = [[self.space.soil(point) for point in row] for row in values]
        rows = self._probes.each(soils, self.seeds, what)
        return np.array([self.problem.simulated(row) for row in rows])

    def evaluate(self, values: np.ndarray, what: str) -> Evaluation:
        """Features and whitened residual at parameter values (p,)."""
        self.forward_runs += 1
        return self._evaluated(self.campaign, values, 1.0, what)

    def estimate(self, values: np.ndarray, correction: Correction, what: str) -> Evaluation:
        """The same from the beds that slopes are taken on, times a ratio known from elsewhere."""
        if self.coarse is None:
            return self.evaluate(values, what)
        return self._evaluated(self.coarse.campaign, values, correction.ratio, what)

    def _evaluated(
        self, work: AbstractCampaign, values: np.ndarray, ratio: np.ndarray | float, what: str
    ) -> Evaluation:
        runs = work.runs([self.space.soil(values)], self.seeds, what)[0]
        features = self.problem.simulated(runs) * ratio
        residual = self.residual(values, features.mean(axis=0))
        if not np.all(np.isfinite(residual)):
            residual = np.full_like(residual, REJECTED)
        failures = tuple(run.failure for run in runs if run.failure)
        return Evaluation(values, features, residual, failures)

    @property
    def _probes(self) -> AbstractCampaign:
        """The simulations that slopes are taken from."""
        return self.campaign if self.coarse is None else self.coarse.campaign

    def slopes(self, values: np.ndarray, what: str) -> np.ndarray:
        """Slopes (m, p) of the mean features per unit of ln p."""
        found = self._measured(self.strategy, values, what)
        if not np.all(np.isfinite(found)) and isinstance(self.strategy, AbstractTraced):
            self._say("some derivatives are not believed: these slopes come from pairs of runs")
            paired = self._measured(fitting_ensemble(self.space), values, what)
            found = np.where(np.isfinite(found), found, paired)
        slopes = found * self.correction(values, what).ratio[:, None]
        if not np.all(np.isfinite(slopes)):
            self._say("too many probes failed: slopes that are not known are set to zero")
        return np.nan_to_num(slopes)

    def _measured(self, strategy: AbstractStrategy, values: np.ndarray, what: str) -> np.ndarray:
        """Slopes (m, p) by one strategy on the beds that slopes are taken on; NaN: not known."""
        known = (
            None if self.coarse is None else self.coarse.slopes(self.problem, self.space, values)
        )
        if known is not None:
            return known
        packings, cost = len(self.seeds), 1.0 if self.coarse is None else self.coarse.cost
        self.forward_runs += cost * (strategy.runs(len(values), packings) - 1)  # centre: known
        if isinstance(strategy, AbstractTraced):
            if not isinstance(self._probes, Campaign):  # tests on several specimens
                return np.full((len(self.problem.measured), len(values)), np.nan)
            if self._first is None:  # once: it compiles
                self._first = FirstOrder(self._probes, self.space, strategy)
            return np.asarray(self._first.slopes(self.problem, values, self.seeds, what).slopes)

        def response(points: Array) -> Array:
            return jnp.asarray(self.probed(np.asarray(points), what))

        return np.asarray(strategy(response, jnp.log(values), packings).slopes)

    def _say(self, sentence: str) -> None:
        self.campaign.progress.say(f"  {sentence}")

    def correction(self, values: np.ndarray, what: str) -> Correction:
        """Ratio of the fitted beds' features to those of the beds that slopes are taken on."""
        if self.coarse is None:
            return Correction.none(len(self.problem.measured))
        soil = self.space.soil(values)
        large = self.problem.simulated(self.campaign.runs([soil], self.seeds, what)[0])
        return Correction.of(large, self.coarse.features(self.problem, soil, self.seeds, what))

    def whitened(self, slopes: np.ndarray) -> np.ndarray:
        return self.whole.whitening @ slopes

    def jacobian(self, slopes: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Of the residual with respect to y, from slopes per ln p."""
        prior = np.diag(1 / self.space.prior_sd())
        return np.concatenate([-self.whitened(slopes), prior]) * self.space.log_slope(y)

    def residual(self, values: A, features: A) -> A:
        """What the fit makes small: measured minus simulated, and the prior, whitened.

        It is pure: nothing is simulated, and nothing is kept.  Given arrays of JAX, as those of a
        function that stands in for the simulation, it returns one that JAX can differentiate.

        Args:
            values: free parameters, SI, in the order of `space.names`; shape (p,).
            features: means over packings that these parameters give, in the order of
                `problem.features` and in their units (mm or N); shape (m,).

        Returns:
            Deviations without unit, the data's first, then the prior's; shape (m + p,).  They are
            independent and of variance 1 where model and prior are right.
        """
        return self.whole(values, features)

    def log_density(self, values: A, features: A) -> A:
        """Log prior plus log likelihood: both normal, the prior in ln p.

        For a sampler, or for a fit on a response that stands in for the simulation.  As a function
        of the values it is the posterior's density per unit of ln p (not of p), but for the
        evidence.  The bounds of the fit are no part of it: `space.bounds()`.

        Args:
            values: free parameters, SI, in the order of `space.names`; shape (p,).
            features: means over packings that these parameters give (mm or N); shape (m,).

        Returns:
            A number; nats.
        """
        residual = self.residual(values, features)
        scale = np.log(self.whole.prior_sd).sum() - np.log(np.diag(self.whole.whitening)).sum()
        return -0.5 * (residual @ residual) - scale - 0.5 * len(residual) * np.log(2 * np.pi)


def packing_scatter(problem: Problem, runs: Sequence[Run]) -> np.ndarray:
    """Covariance (m, m) of one packing's features over their mean, from runs on several."""
    features = finished_features(problem, runs)
    return shrunk_covariance(features / features.mean(axis=0))


def compared(problem: Problem, covariance: np.ndarray, best: Evaluation) -> dict[str, dict]:
    """Each feature as result.json holds it: measured, simulated, deviation of their difference,
    its test, and whether it is a target."""
    rows = zip(
        problem.features,
        problem.measured,
        best.features.mean(axis=0),
        np.sqrt(np.diag(covariance)),
        strict=True,
    )
    return {
        f.name: {
            "measured": float(m),
            "simulated": float(s),
            "sd": float(sd),
            "test": f.test,
            "target": f.is_target,
        }
        for f, m, s, sd in rows
    }
