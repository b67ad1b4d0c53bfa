"""Designed experiments beside gradients: the same simulator, packings and targets.

    slopes       of each design's surface at its centre against the gradient there
    optima       where each method ends, what that gives on fresh packings, what it cost
    enhanced     surfaces fitted to values and gradient together, and how many points that saves

Slopes are per unit of ln p.  Those of a screening design are effects over the distance of its
levels: in a Plackett-Burman design of 12 runs they carry a third of every interaction of two
other factors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy import stats

from calibrate.core.errors import BadValue, InputError
from calibrate.designs.factors import Factor
from calibrate.designs.study import (
    SIGNIFICANT,
    Experiment,
    Study,
    StudySetup,
    Surfaces,
    study,
    verified,
)
from calibrate.designs.surface import fit_surface, fit_with_gradients
from calibrate.designs.terms import quadratic
from calibrate.inference.audit import CurvePoints, simulated_response
from calibrate.inference.evaluation import Calibration, packing_scatter
from calibrate.inference.fit import descend
from calibrate.inference.parameters import Space, ensemble, not_held, space
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab
from calibrate.labtests.composite import names_of
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset
from calibrate.simulation.specimens import Seeds
from jdem.materials.soil import SoilParameters
from jdem.sensitivity.base import Sensitivity
from jdem.sensitivity.ensemble import Ensemble

PAIRS = 2  # antithetic for each group and packing, so that errors have degrees of freedom
LEVEL = 0.95
DRAWS = 40  # random subsets of a design, for each size


@dataclass(frozen=True)
class SlopePair:
    """One factor's slope by a surface and by the gradient, per unit of ln p (mm or N)."""

    design: str
    factor: str
    observable: str
    surface: float
    surface_se: float
    surface_df: int
    gradient: float
    gradient_se: float
    gradient_df: int
    matters: bool  # by the surface's own t test

    @property
    def reach(self) -> float:
        """Half-width of the joint 95 % interval of the difference (Welch and Satterthwaite)."""
        parts = np.array([self.surface_se, self.gradient_se]) ** 2
        df = np.array([self.surface_df, self.gradient_df])
        joint = parts.sum() ** 2 / np.sum(parts**2 / df) if parts.sum() > 0 else df.min()
        return float(stats.t.ppf((1 + LEVEL) / 2, joint) * np.sqrt(parts.sum()))

    @property
    def agree(self) -> bool:
        return abs(self.surface - self.gradient) <= self.reach

    def why(self) -> str:
        """What may part two slopes that do not agree."""
        if self.agree:
            return ""
        if self.design == "screening":
            return "interactions of other factors are aliased with it, and its levels lie far apart"
        return "curvature beyond the second order within the design"


@dataclass(frozen=True, eq=False)
class MethodResult:
    """Where a method ended: parameters, all observables (packings, observables), what it cost."""

    method: str
    values: dict[str, float]
    fitted: np.ndarray
    fresh: np.ndarray
    simulations: int
    stopped: str


@dataclass(frozen=True)
class Enhanced:
    """Error of quadratic surfaces at the points that they were not fitted to (root mean square).

    From `points` of the design alone, and with the gradient at its centre; NaN where the
    points do not fix the surface.
    """

    points: int
    values_only: float
    with_gradient: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that is laid side by side."""

    slopes: tuple[SlopePair, ...]
    endings: tuple[MethodResult, ...]
    enhanced: tuple[Enhanced, ...]
    gradient_runs: float  # forward runs a packing of one gradient


def compare(lab: Lab, setup: StudySetup, done: Study, fresh: Sequence[int], scatter) -> Comparison:
    """Gradients at the centres of the designs, and a gradient fit of the same parameters.

    `scatter` are the packings from which the fit takes one packing's scatter.
    """
    at_base = gradient(setup, setup.soil({}), "gradient at the base soil")
    held = done.second.experiment.held
    at_second = gradient(setup, setup.soil(held), "gradient at the centre of the second design")
    slopes = [
        *_screened(setup, done, at_base),
        *_surfaced(setup, done.first, at_base),
        *_surfaced(setup, done.second, at_second),
    ]
    designed = MethodResult(
        "designs", done.values, done.fitted, done.fresh, done.simulations, "after the refinement"
    )
    return Comparison(
        slopes=tuple(slopes),
        endings=(designed, fitted(lab, setup, done, fresh, scatter)),
        enhanced=tuple(enhanced(setup, done.second.experiment, done.goals[-1], at_second)),
        gradient_runs=strategy(setup.space).runs(len(setup.space.names), len(setup.seeds)),
    )


def gradient(setup: StudySetup, soil: SoilParameters, what: str) -> Sensitivity:
    """Slopes (observables + curves, p) at a soil, on the packings of the designs."""
    there = Space(setup.space.names, setup.space.ranges, soil)
    points = CurvePoints.of(setup.work)
    response = simulated_response(there, setup.work, setup.seeds, points)(what)
    point = jnp.log(jnp.asarray(there.start()))
    return strategy(there)(response, point, len(setup.seeds))


def strategy(space: Space) -> Ensemble:
    """That of fits, with more pairs."""
    return ensemble(space, PAIRS)


def _screened(setup: StudySetup, done: Study, found: Sensitivity) -> list[SlopePair]:
    def slope(observable: str, factor: Factor) -> tuple[float, float, int, float]:
        effect, span = done.screens[observable][factor.name], 2 * factor.half_range
        error = abs(effect.effect / effect.t) / span if effect.t else np.nan
        return effect.effect / span, error, effect.df, effect.p

    return _beside(setup, "screening", done.screening.design.factors, slope, found)


def _surfaced(setup: StudySetup, stage: Surfaces, found: Sensitivity) -> list[SlopePair]:
    factors = stage.experiment.design.factors
    at_centre = {name: s.slopes(np.zeros(len(factors))) for name, s in stage.whole.items()}

    def slope(observable: str, factor: Factor) -> tuple[float, float, int, float]:
        slopes, j = at_centre[observable], factors.index(factor)
        value, error = slopes.values[j] / factor.half_range, slopes.se[j] / factor.half_range
        p = float(2 * stats.t.sf(abs(value / error), slopes.df))
        return float(value), float(error), slopes.df, p

    return _beside(setup, stage.experiment.title, factors, slope, found)


def _beside(
    setup: StudySetup,
    design: str,
    factors: Sequence[Factor],
    slope: Callable[[str, Factor], tuple[float, float, int, float]],
    found: Sensitivity,
) -> list[SlopePair]:
    """Slopes of a design beside the gradient's; `slope` says an observable's in a factor, its
    standard error, degrees of freedom and p."""
    names, pairs = setup.space.names, []
    freedom = strategy(setup.space).freedom(len(names), len(setup.seeds))
    for m, observable in enumerate(setup.observables):
        for factor in factors:
            p, (value, error, df, chance) = names.index(factor.name), slope(observable, factor)
            gradient = float(found.slopes[m, p]), float(found.standard_error[m, p]), freedom[p]
            matters = chance < SIGNIFICANT
            pairs.append(
                SlopePair(design, factor.name, observable, value, error, df, *gradient, matters)
            )
    return pairs


def fitted(
    lab: Lab, setup: StudySetup, done: Study, fresh: Sequence[int], scatter: Sequence[int]
) -> MethodResult:
    """The fit of the parameters that the designs ended with, from the base soil."""
    free = tuple(done.values)
    ranges = tuple(setup.space.ranges[setup.space.names.index(name)] for name in free)
    problem, there = pose(lab), Space(free, ranges, setup.space.base)
    runs = setup.work.runs([there.base], scatter, "scatter of packings")[0]
    spread = packing_scatter(problem, runs)
    calibration = Calibration(problem, there, setup.work, setup.seeds, spread, len(scatter))
    walk = descend(calibration)
    if walk.best is None:
        raise BadValue("the gradient fit evaluated nothing", "see the progress lines", "fit")
    soil, what = there.soil(walk.best.values), "the gradient fit's end"
    reached = [row for row in walk.history if row["status"] == "better"][-1]
    return MethodResult(
        method="gradient fit",
        values=dict(zip(free, walk.best.values.tolist(), strict=True)),
        fitted=verified(setup, soil, setup.seeds, what),
        fresh=verified(setup, soil, fresh, what),
        simulations=round(reached["forward_runs"] * len(setup.seeds)),
        stopped=walk.stopped,
    )


def enhanced(
    setup: StudySetup, experiment: Experiment, observable: str, found: Sensitivity
) -> list[Enhanced]:
    """Surfaces of one response from fewer points, with and without the gradient at the centre.

    Random subsets that hold the centre; weights from the replicates' scatter and the
    gradient's standard errors.
    """
    X, y = experiment.design.coded, experiment.means(observable)
    factors = experiment.design.factors
    columns = [setup.space.names.index(factor.name) for factor in factors]
    half = np.array([factor.half_range for factor in factors])
    m = setup.observables.index(observable)
    slope, error = (
        np.asarray(part)[m, columns] * half for part in (found.slopes, found.standard_error)
    )
    sd = _value_sd(experiment.of(observable)), error.tolist()
    rng = np.random.default_rng(0)
    centre = int(np.flatnonzero(experiment.design.centre)[0])
    return [
        _subsets(X, y, slope, sd, centre, size, rng) for size in range(len(factors) + 1, len(X))
    ]


def _value_sd(values: np.ndarray) -> float:
    """Standard error of a point's mean over packings, of values (points, packings), levels of the
    packings apart."""
    rest = values - values.mean(axis=0) - values.mean(axis=1, keepdims=True) + values.mean()
    df = (values.shape[0] - 1) * (values.shape[1] - 1)
    return float(np.sqrt(np.sum(rest**2) / df / values.shape[1]))


def _subsets(X, y, slope, sd, centre: int, size: int, rng) -> Enhanced:
    others = np.delete(np.arange(len(X)), centre)
    errors: list[list[float]] = [[], []]
    for _ in range(DRAWS):
        used = np.append(rng.choice(others, size - 1, replace=False), centre)
        left = np.setdiff1d(np.arange(len(X)), used)
        unknown = np.full((len(used), X.shape[1]), np.nan)
        at_centre = np.vstack([unknown[:-1], slope])  # the last point
        for kind, rows in enumerate((unknown, at_centre)):
            errors[kind].append(_held_out(X, y, used, left, rows, sd))
    return Enhanced(size, *(_pooled(kind) for kind in errors))


def _held_out(X, y, used, left, gradients, sd) -> float:
    """Mean squared error at the points left out; NaN where the others do not fix the surface."""
    terms = quadratic(X.shape[1])
    try:
        if np.all(np.isnan(gradients)):
            surface = fit_surface(X[used], y[used], terms)
        else:
            surface = fit_with_gradients(X[used], y[used], gradients, terms, sd)
    except BadValue:
        return np.nan
    return float(np.mean((surface(X[left]) - y[left]) ** 2))


def _pooled(errors: list[float]) -> float:
    known = [error for error in errors if np.isfinite(error)]
    return float(np.sqrt(np.mean(known))) if len(known) > len(errors) // 2 else np.nan


@dataclass(frozen=True, eq=False)
class Designed:
    """Calibration by designed experiments: a finished study with its comparison, and the packings
    that were used."""

    study: Study
    comparison: Comparison
    seeds: tuple[int, ...]
    fresh: tuple[int, ...]


def design(
    lab: Lab, preset: Preset, base: SoilParameters, seed: int, work: AbstractCampaign
) -> Designed:
    """The whole sequence around the lab file's soil; resumes from what `work.folder` holds.

    Verified on all packings from which the fit takes its scatter and that no design has seen.
    """
    lab = lab.on_soil()
    _check_targets(lab)
    seeds = Seeds.of(seed, preset.packings)
    fresh = tuple(number for number in seeds.scatter if number not in seeds.fitted)
    setup = StudySetup(space(lab, not_held(lab), base), work, seeds.fitted)
    done = study(setup, lab.targets, fresh)
    return Designed(done, compare(lab, setup, done, fresh, seeds.scatter), seeds.fitted, fresh)


def _check_targets(lab: Lab) -> None:
    """Refuses a lab without any scalar target: curves alone are no response of a surface."""
    if not lab.targets:
        known = ", ".join(name for name, _ in names_of(lab.tests).values())
        problem = "no scalar target, and designs are calibrated to targets, not to curves"
        raise InputError(lab.file, "targets", problem, f"give one or more of {known}, or fit")
