"""Fits on a response: a function that says at once what runs would give on average.

    r(y) = whitened(p(y), features(response(p(y))))         y: unbounded parameters (`Space`)

It is one function of arrays, of which JAX takes the derivative that Optimistix' solver asks for.
It explores in the place of smaller beds, so that no run is spent on slopes.  Beds that decide
correct it by the ratio of both features (`calibrate.inference.resolutions`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax import Array

from calibrate.core.kept import kept
from calibrate.core.progress import AbstractProgress
from calibrate.inference.evaluation import Calibration, Evaluation, Whitened
from calibrate.inference.fit import SOLVER, row, said
from calibrate.inference.parameters import Acting, Space, to_digits, within
from calibrate.inference.problem import Problem, shrunk_covariance
from calibrate.inference.resolutions import AbstractCoarse
from calibrate.io.soil import with_values
from calibrate.labtests.features import AbstractFeature
from calibrate.response.beds import Beds
from calibrate.response.response import Response
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.run import Run, Runs, Soils
from calibrate.simulation.specimens import Seeds
from jdem.apparatus.base import AbstractApparatus
from jdem.materials.soil import SoilParameters
from jdem.sensitivity.base import Sensitivity

MOST_STEPS = 200  # of the solver
BEYOND = 2e-3  # of a number, by which it may move with what comes after a curve's end
NO_STRENGTHS = np.zeros(0)
DIGITS = 6  # of a point that a response leads to: a last digit that differs moves no simulation


class UnderEffects(eqx.Module):
    """Beds' features where effects act: the response with its machine, whose base coordinates begin
    with ln p over the beds' centre, and which of its strengths are asked for."""

    response: Response
    columns: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, beds: Beds, soil: SoilParameters, strengths: Array) -> Array:
        """Features (m,) of a soil at strengths (e,), in typical ones."""
        return self.response(*self.point(beds, soil, strengths))[: len(beds.units)]

    def point(self, beds: Beds, soil: SoilParameters, strengths: Array) -> tuple[Array, Array]:
        """Where the response is asked for them."""
        logs = beds.logs(soil)
        delta = jnp.zeros_like(self.response.offset).at[: len(logs)].set(logs)
        return delta, jnp.zeros_like(self.response.lag).at[np.array(self.columns)].set(strengths)


class FeaturesOfBeds(eqx.Module):
    """A problem's features (m,) of free parameters (p,), SI; the others as in `base`.  Behind the
    parameters may stand strengths (e,) of effects, in typical ones; without them none acts."""

    beds: Beds
    base: SoilParameters
    names: tuple[str, ...] = eqx.field(static=True)
    features: tuple[AbstractFeature, ...] = eqx.field(static=True)
    under: UnderEffects | None = None

    @staticmethod
    def of(
        beds: Beds, problem: Problem, space: Space, under: UnderEffects | None = None
    ) -> "FeaturesOfBeds":
        return FeaturesOfBeds(beds, space.base, space.names, problem.features, under)

    def __call__(self, values: Array) -> Array:
        return self.read(self.of_beds(values))

    def of_beds(self, values: Array) -> Array:
        """Features of the beds (l,)."""
        soil, strengths = self.soil(values), values[len(self.names) :]
        if not len(strengths):
            return self.beds.values(soil)
        assert self.under is not None, "strengths, and nothing that knows effects"
        return self.under(self.beds, soil, strengths)

    def soil(self, values: Array) -> SoilParameters:
        """The soil with these parameters."""
        known = values[: len(self.names)]
        return with_values(self.base, dict(zip(self.names, known, strict=True)))

    def read(self, values: Array) -> Array:
        """The same of the beds' features."""
        shown = self.beds.shown(values)
        return jnp.stack([feature.read(*shown) for feature in self.features])


class Residual(eqx.Module):
    """r (m + p,) of unbounded parameters y (p,); log_bounds are those of `Space`."""

    features: FeaturesOfBeds
    whitened: Whitened
    log_bounds: tuple[Any, Any]

    @staticmethod
    def of(beds: Beds, calibration: Calibration) -> "Residual":
        """That of a calibration, whose runs the beds stand for."""
        features = FeaturesOfBeds.of(beds, calibration.problem, calibration.space)
        return Residual(features, calibration.whole, calibration.space.log_bounds())

    def values(self, y: Array) -> Array:
        """Parameters (p,), SI."""
        return within(y, self.log_bounds)

    def __call__(self, y: Array, args: None = None) -> Array:
        values = self.values(y)
        return self.whitened(values, self.features(values))


@dataclass(frozen=True, eq=False)
class Solved:
    """Where a solver ended on a response, with the slopes (m, p) there per unit of ln p."""

    best: Evaluation
    slopes: np.ndarray
    history: tuple[dict, ...]
    stopped: str


def solved(
    campaign: "ResponseCampaign", calibration: Calibration, start: np.ndarray | None = None
) -> Solved:
    """The best fit on a response from `start` (p,), by default the base soil's values."""
    space = calibration.space
    begin = space.start() if start is None else np.asarray(start, float)
    residual = Residual.of(campaign.beds, calibration)
    y, steps, good = _solution(residual, jnp.asarray(space.to_unbounded(begin)))
    points = [to_digits(begin), to_digits(space.from_unbounded(np.asarray(y)), DIGITS)]
    first, last = (calibration.evaluate(values, "on the library of runs") for values in points)
    better = last.cost < first.cost
    history = row(calibration, 1, first, True), row(calibration, 2, last, better)
    for each in history:
        calibration.campaign.progress.say(said(calibration, each))
    best = last if better else first
    stopped = f"{int(steps)} steps of the solver" + ("" if good else ", which did not converge")
    return Solved(best, slopes_of(residual.features, best.values), history, stopped)


@kept
def _solution(residual: Residual, y: Array) -> tuple[Array, Array, Array]:
    found = optx.least_squares(residual, SOLVER, y, max_steps=MOST_STEPS, throw=False)
    return found.value, found.stats["num_steps"], found.result == optx.RESULTS.successful


def slopes_of(features: FeaturesOfBeds, values: np.ndarray) -> np.ndarray:
    """Slopes (m, p) of features per unit of ln p at parameters (p,)."""
    return np.asarray(_slopes(features, jnp.log(jnp.asarray(values))))


@kept
def _slopes(features: FeaturesOfBeds, logs: Array) -> Array:
    return jax.jacfwd(lambda logs: features(jnp.exp(logs)))(logs)


# ---------------------------------------------------------------- in the place of smaller beds


@dataclass(frozen=True, eq=False)
class ResponseCampaign:
    """A response in the place of a campaign: every packing shows the mean over packings.

    `beyond` names the parameters of a soil that lie beyond what the response knows; there its runs
    fail.
    """

    beds: Beds
    beyond: Callable[[SoilParameters], tuple[str, ...]]
    folder: Path
    progress: AbstractProgress
    apparatus: tuple[AbstractApparatus, ...]
    simulated: ClassVar[int] = 0

    def runs(self, soils: Soils, seeds: Sequence[int], what: str) -> Runs:
        return [[self._run(soil)] * len(seeds) for soil in soils]

    def each(self, soils: Sequence[Soils], seeds: Sequence[int], what: str) -> Runs:
        return [[self._run(soil) for soil in row] for row in soils]

    def _run(self, soil: SoilParameters) -> Run:
        observables, curves = _shown(self.beds, soil)
        far = ", ".join(self.beyond(soil))
        return Run(
            {name: float(value) for name, value in observables.items()},
            {test: np.asarray(curve) for test, curve in curves.items()},
            {},
            f"{far} beyond the library's runs" if far else "",
        )


@kept
def _shown(beds: Beds, soil: SoilParameters):
    return beds.shown(beds.values(soil))


@dataclass(frozen=True, eq=False)
class Reach:
    """Where a response knows soils: ln p of its parameters `names` from low to high, each (q,);
    sd (q,): distances in ln p over which what it shows, and its errors, change."""

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    sd: np.ndarray


@dataclass(frozen=True, eq=False)
class OnResponse(AbstractCoarse):
    """A response of beds as large as those that decide.  At a soil, `specimens` gives deviations
    (n, l) of single packings from the mean features of its beds, `errors` those (n, l) of its own,
    one deviation each, and `slope_errors` those (n, l, q) of the slopes of features per unit of
    ln p, p being the parameters of the beds; `reach` is where it knows soils.  `acting` are the
    effects that it knows, `under` gives the features of its beds where some act, and `errors_under`
    its own errors (n, l) of these at strengths (e,)."""

    campaign: ResponseCampaign
    specimens: Callable[[SoilParameters], np.ndarray]
    errors: Callable[[SoilParameters], np.ndarray]
    slope_errors: Callable[[SoilParameters], np.ndarray]
    spheres: int
    reach: Reach = field(default_factory=lambda: Reach((), *3 * (np.zeros(0),)))
    acting: tuple[Acting, ...] = ()
    under: Callable[[Sequence[str]], UnderEffects | None] = lambda names: None
    errors_under: Callable[[SoilParameters, UnderEffects, np.ndarray], np.ndarray] | None = None
    near: ClassVar[bool] = True

    @property
    def observables(self) -> tuple[str, ...]:
        """Names of those that it has."""
        return self.campaign.beds.observables

    @property
    def cost(self) -> float:
        """It costs no run."""
        return 0.0

    @property
    def described(self) -> str:
        return "the library of runs"

    def disagreeing(self, changed: Sequence[str]) -> str:
        return (
            f"at the best point the simulations differ from the library of runs beyond their "
            f"errors, and count: {'; '.join(changed)} (ratio 1 was taken at first)"
        )

    @property
    def solver(self) -> Callable[..., Solved]:
        return partial(solved, self.campaign)

    def slopes(self, problem: Problem, space: Space, values: np.ndarray) -> np.ndarray:
        """By JAX."""
        return slopes_of(FeaturesOfBeds.of(self.campaign.beds, problem, space), values)

    def unknown(self, problem: Problem, soil: SoilParameters) -> np.ndarray:
        """Mask (m,) of the features that are read beyond the ends of its curves."""
        beds = self.campaign.beds
        observables, curves = _shown(beds, soil)
        shown = {test: np.asarray(curve) for test, curve in curves.items()}
        other = beds.continued(shown)
        read = [(f.read(observables, shown), f.read(observables, other)) for f in problem.features]
        return np.array([not np.isclose(*both, rtol=BEYOND, atol=0.0) for both in read])

    def heard(self, problem: Problem, soil: SoilParameters) -> Problem:
        return problem.without(self.unknown(problem, soil))

    def scatter(
        self, problem: Problem, soil: SoilParameters, seeds: Seeds, large: AbstractCampaign
    ) -> tuple[np.ndarray, int]:
        """As the library's packings scatter, at this soil and size."""
        means, deviations = _deviating(self._features(problem, soil), self.specimens(soil))
        return shrunk_covariance(deviations / means), len(deviations)

    def error(self, problem: Problem, soil: SoilParameters) -> np.ndarray:
        """Its own deviation of each feature (m,) at a soil."""
        return np.sqrt((self.error_rows(problem, soil)[1] ** 2).sum(axis=0))

    def error_rows(
        self, problem: Problem, soil: SoilParameters, under: UnderEffects | None = None,
        strengths: np.ndarray = NO_STRENGTHS,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Features (m,) at a soil, and at strengths (e,) of effects, and its own deviations of them
        (n, m), independent rows of one deviation each."""
        features = self._features(problem, soil, under)
        if under is None or self.errors_under is None:
            return _deviating(features, self.errors(soil))
        return _deviating(features, self.errors_under(soil, under, strengths), strengths)

    def sensitivity(self, space: Space, read: Callable) -> Sensitivity:
        """Numbers that `read` takes of observables and curves, at the space's base soil, their
        slopes per unit of ln p by JAX and the slopes' own errors; NaN beyond the runs."""
        beds, start = self.campaign.beds, jnp.asarray(space.start())
        values, slopes, by_beds = _read_slopes(beds, space.soil, read, start)
        errors = np.einsum("ml,nlq->nmq", by_beds, self.slope_errors(space.base))
        known = [beds.names.index(name) if name in beds.names else -1 for name in space.names]
        error = np.where(np.array(known) < 0, 0.0, np.sqrt((errors**2).sum(axis=0))[:, known])
        far = bool(self.campaign.beyond(space.base))
        return Sensitivity(values[None], *(jnp.where(far, jnp.nan, x) for x in (slopes, error)))

    def deviations(self, soil: SoilParameters, read: Callable) -> tuple[np.ndarray, np.ndarray]:
        """Of numbers (m,) that `read` takes of observables and curves at a soil: its own errors
        (r, m), independent rows of one deviation each, and the luck (n, m) of single packings."""
        by_beds = np.asarray(_by_beds(self.campaign.beds, read, soil))
        return self.errors(soil) @ by_beds.T, self.specimens(soil) @ by_beds.T

    def _features(
        self, problem: Problem, soil: SoilParameters, under: UnderEffects | None = None
    ) -> FeaturesOfBeds:
        """Those of one soil, of which only strengths may vary."""
        return FeaturesOfBeds(self.campaign.beds, soil, (), problem.features, under)


def _deviating(
    features: FeaturesOfBeds, rows: np.ndarray, strengths: np.ndarray = NO_STRENGTHS
) -> tuple[np.ndarray, np.ndarray]:
    """A problem's features (m,) of one soil, and their deviations (n, m), of rows (n, l) of those
    of the beds."""
    means, slopes = map(np.asarray, _read(features, jnp.asarray(strengths)))
    return means, rows @ slopes.T


@eqx.filter_jit
def _by_beds(beds: Beds, read: Callable, soil: SoilParameters) -> Array:
    """Slopes (m, l) of numbers with the beds' features."""
    return jax.jacfwd(lambda values: read(*beds.shown(values)))(beds.values(soil))


@eqx.filter_jit
def _read_slopes(beds: Beds, soil: Callable, read: Callable, start: Array) -> tuple:
    """Numbers (m,), slopes (m, p) per unit of ln p, and slopes (m, l) with the beds' features."""

    def of_beds(values: Array) -> Array:
        return read(*beds.shown(values))

    def of(logs: Array) -> Array:
        return of_beds(beds.values(soil(jnp.exp(logs))))

    values = beds.values(soil(start))
    return of_beds(values), jax.jacfwd(of)(jnp.log(start)), jax.jacfwd(of_beds)(values)


@kept
def _read(features: FeaturesOfBeds, values: Array) -> tuple[Array, Array]:
    """A problem's features (m,) of a soil, and their slopes (m, l) with those of the beds."""
    known = features.of_beds(values)
    return features.read(known), jax.jacfwd(features.read)(known)
