"""The whole calibration of a lab file, from packings to a fit and its check on fresh packings.

packings -> scatter -> screening -> free parameters -> fit -> fresh packings

Where a preset explores with smaller beds, these are fitted first, to targets corrected by the
ratio of both sizes at the start (`calibrate.inference.resolutions`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.inference.evaluation import (
    Calibration,
    Settings,
    finished_features,
    packing_scatter,
)
from calibrate.inference.fit import Descent, Fit, descend, fit
from calibrate.inference.identifiability import choose_free
from calibrate.inference.parameters import FACTORS, Space, ensemble, space
from calibrate.inference.problem import Problem, pose
from calibrate.inference.resolutions import Coarse, Correction, corrected, disagreement, pooled
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset
from calibrate.simulation.specimens import (
    Seeds,
    mean_observables,
    measured_json,
    packing_json,
    quality_json,
    rates_json,
    soil_json,
    spread_observables,
)
from jdem.materials.soil import SoilParameters

CANDIDATES = (*FACTORS, "shear_modulus")
# Where large beds are dear: a residual of 0.3 deviations is a third of what packings leave open.
THRIFTY = Settings(evaluations=10, patience=3, tolerance=0.3)
EXPLORING = Settings(evaluations=12, patience=4, tolerance=0.3)  # small beds are cheap


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A fit with everything around it that a report shows."""

    lab: Lab
    problem: Problem
    result: Fit
    soil: SoilParameters
    space: Space
    screening: dict
    fitted_runs: list[Run]
    fresh_runs: list[Run]
    scatter: np.ndarray
    simulations: int
    named: dict[str, dict]
    strategy: str
    seeds: Seeds
    rates: dict
    resolutions: dict


def calibrate(
    lab: Lab,
    preset: Preset,
    free: tuple[str, ...] | None,
    changes: dict[str, float],
    seed: int,
    work: AbstractCampaign,
    coarse: Coarse | None = None,
) -> Calibrated:
    """The whole calibration of a lab file; resumes from what `work.folder` holds.

    `coarse` are the same tests on the smaller beds that it explores with.
    """
    problem, seeds = pose(lab), Seeds.of(seed, preset.packings, preset.fresh)
    base = with_values(base_soil(lab), changes)
    scatter, scattered = scatter_of_packings(problem, base, seeds, work, coarse)
    screening: dict = {}
    free = free or tuple(name for name, choice in lab.parameters.items() if choice.free) or None
    if free is None:
        screening = screen(lab, problem, base, scatter, scattered, seeds, work, coarse)
        free = tuple(screening["free"])
        work.progress.say("free parameters: " + ", ".join(free))
    free_space = space(lab, free, base)
    settings = Settings() if coarse is None else THRIFTY
    calibration = Calibration(
        problem, free_space, work, seeds.fitted, scatter, scattered, settings, coarse
    )
    first = calibration.correction(free_space.start(), "both resolutions at the start")
    walked = explored(calibration, first)
    result = _after(walked, fit_from(calibration, walked), coarse.cost if coarse else 1.0)
    soil = free_space.soil(result.best.values)
    fitted = work.runs([soil], seeds.fitted, "fitted packings")[0]
    fresh = work.runs([soil], seeds.fresh, "fresh packings")[0]
    named = _named_sets(lab, base, seeds.fitted, work)
    return Calibrated(
        lab=lab,
        problem=problem,
        result=result,
        soil=soil,
        space=free_space,
        screening=screening,
        fitted_runs=fitted,
        fresh_runs=fresh,
        scatter=scatter,
        simulations=work.simulated + (coarse.campaign.simulated if coarse else 0),
        named=named,
        strategy=calibration.strategy.describe(),
        seeds=seeds,
        rates=rates_json(work),
        resolutions=resolutions_json(calibration, first, result, preset),
    )


def scatter_of_packings(
    problem: Problem,
    soil: SoilParameters,
    seeds: Seeds,
    work: AbstractCampaign,
    coarse: Coarse | None,
) -> tuple[np.ndarray, int]:
    """Covariance (m, m) of one packing's features over their mean, and from how many packings.

    With smaller beds, few large ones are run, those that the fit needs in any case."""

    def runs(campaign: AbstractCampaign, packings: Sequence[int]) -> list[Run]:
        return campaign.runs([soil], packings, "scatter of packings")[0]

    if coarse is None:
        alone = packing_scatter(problem, lambda packings: runs(work, packings), seeds.scatter)
        return alone, len(seeds.scatter)
    large = finished_features(problem, runs(work, seeds.fitted))
    small = finished_features(problem, runs(coarse.campaign, seeds.scatter))
    covariance, freedom = pooled(large, small, coarse)
    return covariance, freedom + 1


def explored(calibration: Calibration, correction: Correction) -> Descent | None:
    """The fit of smaller beds to corrected targets; None where there are none, or none succeeds."""
    coarse = calibration.coarse
    if coarse is None:
        return None
    coarse.campaign.progress.say(f"exploring with {coarse.spheres} spheres")
    small = replace(
        calibration,
        problem=corrected(calibration.problem, correction),
        campaign=coarse.campaign,
        coarse=None,
        settings=EXPLORING,
    )
    found = descend(small)
    return None if found.best is None or found.best.failures else found


def fit_from(calibration: Calibration, walked: Descent | None) -> Fit:
    """The fit from where smaller beds ended, with their slopes; None: from the start."""
    if walked is None or walked.best is None:
        return fit(calibration)
    return fit(calibration, walked.best.values, walked.slopes)


def _after(walked: Descent | None, result: Fit, cost: float = 1.0) -> Fit:
    """The fit with the evaluations of smaller beds before its own."""
    if walked is None:
        return result
    before = [
        {**row, "status": "explored", "forward_runs": cost * row["forward_runs"]}
        for row in walked.history
    ]
    shift = {"evaluation": len(before), "forward_runs": before[-1]["forward_runs"]}
    after = [{**row, **{k: row[k] + n for k, n in shift.items()}} for row in result.history]
    return replace(result, history=[*before, *after])


def resolutions_json(
    calibration: Calibration, first: Correction, result: Fit, preset: Preset
) -> dict:
    """Ratio of both sizes' features at the start and at the best point; empty where there is one
    size.  Says so where they differ by more than their errors."""
    coarse = calibration.coarse
    if coarse is None:
        return {}
    problem = calibration.problem
    last = calibration.correction(result.best.values, "both resolutions at the best point")
    changed = disagreement(problem, first, last)
    if changed:
        calibration.campaign.progress.say(
            f"beds of {coarse.spheres} and {preset.spheres} spheres disagree beyond their errors: "
            f"their ratio is {'; '.join(changed)} at the start and at the end: slopes of the "
            "smaller ones may mislead; fit again from here (--set), or with --preset fine"
        )
    return {
        "explored_spheres": coarse.spheres,
        "simulations": coarse.campaign.simulated,
        "ratio": {
            feature.name: {"start": a, "end": b, "relative_se": se}
            for feature, a, b, se in zip(
                problem.features, first.ratio, last.ratio, last.relative_se, strict=True
            )
        },
        "disagree": changed,
    }


def screen(
    lab: Lab,
    problem: Problem,
    base: SoilParameters,
    scatter: np.ndarray,
    scattered: int,
    seeds: Seeds,
    work: AbstractCampaign,
    coarse: Coarse | None = None,
) -> dict:
    """Slopes of all features in all candidates, and the parameters that the data can fix."""
    held = {name for name, choice in lab.parameters.items() if choice.free is False}
    candidates = tuple(name for name in CANDIDATES if name not in held)
    every = space(lab, candidates, base)
    settings = Settings(strategy=ensemble(every))
    calibration = Calibration(
        problem, every, work, seeds.fitted, scatter, scattered, settings, coarse
    )
    slopes = calibration.slopes(every.start(), "sensitivity of every parameter")
    whitened = calibration.whitened(slopes)
    rank = len(problem.measured)
    chosen = choose_free(candidates, whitened, every.prior_sd(), rank)
    names = [feature.name for feature in problem.features]
    return {
        "free": [name for name, _ in chosen],
        "signal_to_noise": dict(chosen),
        "slopes_per_ln": {
            feature: dict(zip(candidates, row.tolist(), strict=True))
            for feature, row in zip(names, slopes, strict=True)
        },
    }


def fit_json(done: Calibrated) -> dict:
    """The contract's keys for `fit`, and what was checked on fresh packings."""
    features = [feature.name for feature in done.problem.features]
    best = done.result.best
    return {
        "parameters": soil_json(done.soil),
        "free": list(done.space.names),
        "observables": mean_observables(done.fitted_runs),
        "spread": spread_observables(done.fitted_runs),
        "fresh_packings": {
            "observables": mean_observables(done.fresh_runs),
            "spread": spread_observables(done.fresh_runs),
        },
        "targets": {name: target.mean for name, target in done.lab.targets.items()},
        "measured": measured_json(done.lab),
        "seeds": list(done.seeds.fitted),
        "fresh_seeds": list(done.seeds.fresh),
        "packings": {
            "fitted": _packings_json(done.seeds.fitted, done.fitted_runs),
            "fresh": _packings_json(done.seeds.fresh, done.fresh_runs),
        },
        "quality": quality_json(done.fitted_runs),
        "rates": done.rates,
        "features": {
            name: {"measured": float(m), "simulated": float(s), "sd": float(sd)}
            for name, m, s, sd in zip(
                features,
                done.problem.measured,
                best.features.mean(axis=0),
                np.sqrt(np.diag(done.result.covariance)),
                strict=True,
            )
        },
        "packing_scatter": dict(
            zip(features, np.sqrt(np.diag(done.scatter)).tolist(), strict=True)
        ),
        "simulations": done.simulations,
        "resolutions": done.resolutions,
        "stopped": done.result.stopped,
        "strategy": done.strategy,
        "profiles": done.result.profiles,
        "identifiability": done.result.identifiability.as_json(),
        "screening": done.screening,
        "history": done.result.history,
        "named_sets": done.named,
        "at_bound": done.space.at_bound(best.values),
    }


def _packings_json(seeds: Sequence[int], runs: Sequence[Run]) -> list[dict]:
    return [packing_json(seed, run) for seed, run in zip(seeds, runs, strict=True)]


def _named_sets(lab: Lab, base: SoilParameters, seeds, work: AbstractCampaign) -> dict[str, dict]:
    """Observables of the lab file's named parameter sets on the fitted packings."""
    soils = [with_values(base, values) for values in lab.named_sets.values()]
    rows = work.runs(soils, seeds, "named parameter sets") if soils else []
    return {
        name: {"observables": mean_observables(row), "spread": spread_observables(row)}
        for name, row in zip(lab.named_sets, rows, strict=True)
    }
