"""The whole calibration of a lab file, from packings to a fit and its check on fresh packings.

packings -> scatter -> screening -> free parameters -> fit -> fresh packings
                                         ^---- more ------v  where it misses the data

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
from calibrate.inference.fit import Descent, Fit, descend, finished, fit
from calibrate.inference.identifiability import choose_free, strongest
from calibrate.inference.misfit import misses, warnings
from calibrate.inference.parameters import FACTORS, Space, ensemble, space, to_digits
from calibrate.inference.problem import Problem, begun_late, pose
from calibrate.inference.resolutions import Coarse, Correction, corrected, disagreement, pooled
from calibrate.inference.widening import Round, Screened, advised, compared, widened
from calibrate.inference.widening import chosen as chosen_of
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
from calibrate.simulation.specimens import coarse as coarse_sentence
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
    rounds: list[dict]
    help: str


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
    bench = Bench(lab, problem, base, seeds, work, scatter, scattered, coarse)
    free = free or tuple(name for name, choice in lab.parameters.items() if choice.free) or None
    screened = bench.screened() if free is None else None
    screening = {} if screened is None else screening_json(bench, screened)
    if free is None:
        free = tuple(screening["free"])
        work.progress.say("free parameters: " + ", ".join(free))
    calibration = bench.calibration(free)
    first = calibration.correction(calibration.space.start(), "both resolutions at the start")
    rounds = bench.rounds(calibration, first, screened)
    calibration, result = bench.settled(rounds)
    reached = Round(calibration, Descent(result.best, result.history, "", result.slopes))
    helped = bench.help(reached, screened, rounds)
    soil = calibration.space.soil(result.best.values)
    fitted = work.runs([soil], seeds.fitted, "fitted packings")[0]
    fresh = work.runs([soil], seeds.fresh, "fresh packings")[0]
    named = _named_sets(lab, base, seeds.fitted, work)
    return Calibrated(
        lab=lab,
        problem=problem,
        result=result,
        soil=soil,
        space=calibration.space,
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
        rounds=[each.as_json() for each in rounds],
        help=helped,
    )


@dataclass(frozen=True, eq=False)
class Bench:
    """Everything that a fit needs but its free parameters."""

    lab: Lab
    problem: Problem
    base: SoilParameters
    seeds: Seeds
    work: AbstractCampaign
    scatter: np.ndarray
    scattered: int
    coarse: Coarse | None

    def calibration(self, names: tuple[str, ...]) -> Calibration:
        """With these parameters free."""
        settings = Settings() if self.coarse is None else THRIFTY
        return self._calibration(space(self.lab, names, self.base), settings)

    def _calibration(self, free: Space, settings: Settings) -> Calibration:
        return Calibration(
            self.problem,
            free,
            self.work,
            self.seeds.fitted,
            self.scatter,
            self.scattered,
            settings,
            self.coarse,
        )

    def screened(self) -> Screened:
        """Slopes of all features in every parameter that the lab file does not hold."""
        held = {name for name, choice in self.lab.parameters.items() if choice.free is False}
        every = space(self.lab, tuple(n for n in CANDIDATES if n not in held), self.base)
        calibration = self._calibration(every, Settings(strategy=ensemble(every)))
        slopes = calibration.slopes(every.start(), "sensitivity of every parameter")
        at_start = calibration.evaluate(to_digits(every.start()), "the start")
        return Screened(every, slopes, at_start.features.mean(axis=0))

    def rounds(
        self, calibration: Calibration, correction: Correction, screened: Screened | None
    ) -> list[Round]:
        """Fits of the first choice and, where the program chose and misses, of wider ones; with
        smaller beds where there are any."""

        def level(chosen: Calibration) -> Calibration:
            return chosen if self.coarse is None else exploring(chosen, correction)

        start = level(calibration)
        first = Round(start, descend(start))
        if screened is None:
            return [first]
        return widened(first, screened, lambda names: level(self.calibration(names)))

    def settled(self, rounds: Sequence[Round]) -> tuple[Calibration, Fit]:
        """The fit of the round that counts, on the beds that decide, all evaluations before it."""
        kept = chosen_of(rounds)
        if self.coarse is None:
            before = [each.descent for each in rounds]
            result = finished(kept.calibration, kept.descent)
            return kept.calibration, replace(result, history=joined(before))
        calibration = self.calibration(kept.names)
        result = fit_from(calibration, kept.descent if kept.best is not None else None)
        before = [each.descent for each in rounds if each.best is not None]
        return calibration, _after(before, result, self.coarse.cost)

    def help(self, reached: Round, screened: Screened | None, rounds: Sequence[Round]) -> str:
        """What would bring a fit that missed its data nearer to them; "" where it met them."""
        best = reached.best
        if best is None or not misses(reached.compared(best)):
            return ""
        tried = [name for name in rounds[-1].names if name not in reached.names]
        known = self.screened() if screened is None else screened
        return advised(reached, known, self.lab, screened is None, tried)


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
    if calibration.coarse is None:
        return None
    found = descend(exploring(calibration, correction))
    return None if found.best is None or found.best.failures else found


def exploring(calibration: Calibration, correction: Correction) -> Calibration:
    """The same with smaller beds, to targets corrected for them."""
    coarse = calibration.coarse
    assert coarse is not None
    coarse.campaign.progress.say(f"exploring with {coarse.spheres} spheres")
    return replace(
        calibration,
        problem=corrected(calibration.problem, correction),
        campaign=coarse.campaign,
        coarse=None,
        settings=EXPLORING,
    )


def fit_from(calibration: Calibration, walked: Descent | None) -> Fit:
    """The fit from where smaller beds ended, with their slopes; None: from the start."""
    if walked is None or walked.best is None:
        return fit(calibration)
    return fit(calibration, walked.best.values, walked.slopes)


def joined(walks: Sequence[Descent]) -> list[dict]:
    """Rows of one walk after the other, evaluations and forward runs counted on; parameters that
    were not free yet stand at their start."""
    rows: list[dict] = []
    for walk in walks:
        shift = {k: rows[-1][k] if rows else 0 for k in ("evaluation", "forward_runs")}
        rows += [{**row, **{k: row[k] + n for k, n in shift.items()}} for row in walk.history]
    return rows


def _after(walks: Sequence[Descent], result: Fit, cost: float = 1.0) -> Fit:
    """The fit with the evaluations of smaller beds before its own."""
    before = [
        {**row, "status": "explored", "forward_runs": cost * row["forward_runs"]}
        for row in joined(walks)
    ]
    own = Descent(result.best, result.history, result.stopped, result.slopes)
    earlier = Descent(None, before, "", result.slopes)
    return replace(result, history=joined([earlier, own] if before else [own]))


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


def screening_json(bench: Bench, screened: Screened) -> dict:
    """Slopes of all features in all candidates, and the parameters that the data can fix."""
    names = screened.space.names
    whitened = bench.calibration(names).whitened(screened.slopes)
    rank = len(bench.problem.measured)
    prior = screened.space.prior_sd()
    found = choose_free(names, whitened, prior, rank) or [strongest(names, whitened, prior)]
    features = [feature.name for feature in bench.problem.features]
    return {
        "free": [name for name, _ in found],
        "signal_to_noise": dict(found),
        "slopes_per_ln": {
            feature: dict(zip(names, row.tolist(), strict=True))
            for feature, row in zip(features, screened.slopes, strict=True)
        },
    }


def fit_json(done: Calibrated) -> dict:
    """The contract's keys for `fit`, and what was checked on fresh packings."""
    best = done.result.best
    features = compared(done.problem, done.result.covariance, best)
    met = not misses(features)
    result = {
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
        "features": features,
        "met": met,
        "packing_scatter": dict(
            zip(features, np.sqrt(np.diag(done.scatter)).tolist(), strict=True)
        ),
        "simulations": done.simulations,
        "resolutions": done.resolutions,
        "stopped": done.result.stopped,
        "strategy": done.strategy,
        "profiles": done.result.profiles,
        "identifiability": done.result.identifiability.as_json(met),
        "screening": done.screening,
        "rounds": done.rounds,
        "history": _complete(done),
        "named_sets": done.named,
        "at_bound": done.space.at_bound(best.values),
        "notes": begun_late(done.lab),
        "help": done.help,
    }
    across = coarse_sentence(result["quality"])
    return {**result, "warnings": warnings(result, [across] if across else [])}


def _complete(done: Calibrated) -> list[dict]:
    """The history with a value for every parameter that was ever free, at its start before."""
    base = soil_json(done.space.base)
    names = dict.fromkeys(n for each in done.rounds for n in each["free"])
    known = {name: base[name] for name in names}
    return [{**row, "parameters": {**known, **row["parameters"]}} for row in done.result.history]


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
