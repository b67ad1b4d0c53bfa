"""What the verbs do, from a lab file to a result: simulate, and fit.

    lab file -> packings -> scatter -> screening -> free parameters -> fit -> fresh packings

Each function returns plain data (the contract's JSON keys) and what a plot needs; the
command line only reads options and writes files.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from calibrate.campaign import Campaign, Run
from calibrate.fit import Calibration, Fit, Settings, fit, packing_scatter
from calibrate.identifiability import choose_free
from calibrate.measurements import Lab
from calibrate.parameters import FACTORS, Space, base_soil, ensemble, space, with_values
from calibrate.presets import Preset, specimen, virtual_lab
from calibrate.problem import Problem, pose
from calibrate.progress import AbstractProgress
from jdem.soil import SoilParameters

SCATTER_PACKINGS = 8  # from which one packing's scatter is estimated
FRESH_PACKINGS = 3  # on which a fit is checked
CANDIDATES = (*FACTORS, "shear_modulus")


@dataclass(frozen=True)
class Seeds:
    """Packings that are fitted, packings held back, and all that scatter is taken from."""

    fitted: tuple[int, ...]
    fresh: tuple[int, ...]
    scatter: tuple[int, ...]

    @staticmethod
    def of(seed: int, fitted: int) -> "Seeds":
        every = tuple(
            range(100 * seed, 100 * seed + max(SCATTER_PACKINGS, fitted + FRESH_PACKINGS))
        )
        return Seeds(every[:fitted], every[fitted : fitted + FRESH_PACKINGS], every)


def campaign(
    lab: Lab,
    preset: Preset,
    folder: Path,
    progress: AbstractProgress,
    preparation: SoilParameters | None = None,
) -> Campaign:
    """The lab's virtual tests at a preset, with results kept in `folder`.

    Beds settle with `preparation`, or by default with a slippery, cohesionless soil.
    """
    laboratory, cylinder = virtual_lab(lab, preset), specimen(lab, preset)
    return Campaign(laboratory, cylinder, folder, progress, preparation=preparation)


def simulate(
    lab: Lab, preset: Preset, settings: dict[str, float], seed: int, work: Campaign
) -> tuple[dict, list[Run]]:
    """Both tests on the preset's packings; the contract's JSON and the runs."""
    soil = with_values(base_soil(lab), settings)
    seeds = Seeds.of(seed, preset.packings).fitted
    runs = work.runs([soil], seeds, "simulating")[0]
    result = {
        **simulation_json(runs),
        "rates": rates_json(work),
        "parameters": soil_json(soil),
        "seeds": list(seeds),
    }
    return result, runs


def simulation_json(runs: Sequence[Run]) -> dict:
    """Means and scatter over packings, the first packing's curves, quality and speed."""
    seconds = sum(run.quality["runtime_s"] for run in runs)
    work = sum(run.quality["steps"] * run.quality["spheres"] for run in runs)
    return {
        "observables": mean_observables(runs),
        "spread": spread_observables(runs),
        "curves": curves_json(runs[0]),
        "packings": [{**run.observables(), "failure": run.failure} for run in runs],
        "quality": quality_json(runs),
        "failures": [run.failure for run in runs if run.failure],
        "runtime_s": seconds,
        "particle_steps_per_s": work / seconds,
    }


def quality_json(runs: Sequence[Run]) -> dict:
    """The worst of each check over packings, and whether any list stayed too small."""
    worst = {
        name: float(np.max([run.quality[name] for run in runs]))
        for name in runs[0].quality
        if name not in ("runtime_s", "steps", "overflow")
    }
    return {**worst, "overflow": any(run.quality["overflow"] > 0 for run in runs)}


def rates_json(work: Campaign) -> dict:
    """Nominal and simulated platen speeds (mm/s) of both tests, and their ratio."""
    tests = work.lab.tests
    return {
        name: {
            "nominal_mm_s": 1e3 * float(test.nominal_rate),
            "simulated_mm_s": 1e3 * float(test.simulated_rate),
            "scaled_by": float(test.simulated_rate / test.nominal_rate),
        }
        for name, test in (("confined", tests.confined), ("unconfined", tests.unconfined))
    }


def curves_json(run: Run) -> dict:
    """A run's curves as lists."""
    return {
        name: {"displacement_mm": curve[:, 0].tolist(), "force_n": curve[:, 1].tolist()}
        for name, curve in (("confined", run.confined), ("unconfined", run.unconfined))
    }


DRAWN = 300  # points of a curve in a fit's result; all of them are in the campaign's cache


def drawn(displacement_mm: np.ndarray, force_n: np.ndarray) -> dict[str, list[float]]:
    """At most `DRAWN` points of a curve, first and last among them, to six digits."""
    count = len(force_n)
    rows = np.unique(np.linspace(0, count - 1, min(count, DRAWN)).round().astype(int))
    columns = {"displacement_mm": displacement_mm[rows], "force_n": force_n[rows]}
    return {name: [float(f"{x:.6g}") for x in column] for name, column in columns.items()}


def packing_json(seed: int, run: Run) -> dict:
    """One simulated specimen with its curves as drawn."""
    curves = {"confined": run.confined, "unconfined": run.unconfined}
    return {
        "seed": seed,
        **run.observables(),
        "failure": run.failure,
        "curves": {name: drawn(*curve.T) for name, curve in curves.items()},
    }


def measured_json(lab: Lab) -> dict:
    """What the laboratory measured: targets with their scatter, curves as drawn."""
    return {
        "targets": {name: asdict(target) for name, target in lab.targets.items()},
        "curves": [
            {
                "test": curve.test,
                "file": curve.file,
                **drawn(curve.displacement_mm, curve.force_n),
            }
            for curve in lab.curves
        ],
        "depth_between_n": [lab.confined.force_low, lab.confined.force_high],
    }


def mean_observables(runs: Sequence[Run]) -> dict[str, float]:
    return _over_packings(runs, np.mean)


def spread_observables(runs: Sequence[Run]) -> dict[str, float]:
    """Standard deviation over packings (one packing's scatter)."""
    return _over_packings(runs, lambda v: np.std(v, ddof=1) if len(v) > 1 else float("nan"))


def soil_json(soil: SoilParameters) -> dict[str, float]:
    """All parameters by name, SI."""
    return {name: float(getattr(soil, name)) for name in SoilParameters.__dataclass_fields__}


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


def calibrate(
    lab: Lab,
    preset: Preset,
    free: tuple[str, ...] | None,
    changes: dict[str, float],
    seed: int,
    work: Campaign,
) -> Calibrated:
    """The whole calibration of a lab file; resumes from what `work.folder` holds."""
    problem, seeds = pose(lab), Seeds.of(seed, preset.packings)
    base = with_values(base_soil(lab), changes)
    scatter = packing_scatter(
        problem, lambda s: work.runs([base], s, "scatter of packings")[0], seeds.scatter
    )
    screening: dict = {}
    free = free or tuple(name for name, choice in lab.parameters.items() if choice.free) or None
    if free is None:
        screening = screen(lab, problem, base, scatter, seeds, work)
        free = tuple(screening["free"])
        work.progress.say("free parameters: " + ", ".join(free))
    free_space = space(lab, free, base)
    calibration = Calibration(
        problem, free_space, work, seeds.fitted, scatter, len(seeds.scatter), Settings()
    )
    result = fit(calibration)
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
        simulations=work.simulated,
        named=named,
        strategy=calibration.strategy.describe(),
        seeds=seeds,
        rates=rates_json(work),
    )


def screen(
    lab: Lab, problem: Problem, base: SoilParameters, scatter, seeds: Seeds, work: Campaign
) -> dict:
    """Slopes of all features in all candidates, and the parameters that the data can fix."""
    held = {name for name, choice in lab.parameters.items() if choice.free is False}
    candidates = tuple(name for name in CANDIDATES if name not in held)
    every = space(lab, candidates, base)
    settings = Settings(strategy=ensemble(every))
    calibration = Calibration(
        problem, every, work, seeds.fitted, scatter, len(seeds.scatter), settings
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


def _named_sets(lab: Lab, base: SoilParameters, seeds, work: Campaign) -> dict[str, dict]:
    """Observables of the lab file's named parameter sets on the fitted packings."""
    soils = [with_values(base, values) for values in lab.named_sets.values()]
    rows = work.runs(soils, seeds, "named parameter sets") if soils else []
    return {
        name: {"observables": mean_observables(row), "spread": spread_observables(row)}
        for name, row in zip(lab.named_sets, rows, strict=True)
    }


def _over_packings(runs: Sequence[Run], statistic) -> dict[str, float]:
    names = runs[0].observables()
    return {n: float(statistic([run.observables()[n] for run in runs])) for n in names}
