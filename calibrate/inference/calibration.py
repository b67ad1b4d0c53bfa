"""The whole calibration of a lab file, from packings to a fit and its check on fresh packings.

packings -> scatter -> screening -> free parameters -> fit -> fresh packings
                                         ^---- more ------v  where it misses the data

Where a preset explores with smaller beds, these are fitted first, to targets corrected by the
ratio of both sizes at the start (`calibrate.inference.resolutions`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.core.errors import CalibrationError
from calibrate.inference.evaluation import (
    Calibration,
    Evaluation,
    Settings,
    compared,
    packing_scatter,
)
from calibrate.inference.fit import Descent, Fit, descend, finished, fit, joined
from calibrate.inference.identifiability import choose_free, strongest
from calibrate.inference.misfit import misses, warnings
from calibrate.inference.on_response import DIGITS, Solved
from calibrate.inference.parameters import ensemble, not_held, space, stated_free, to_digits
from calibrate.inference.problem import Problem, begun_late, pose
from calibrate.inference.resolutions import AbstractCoarse, Correction, corrected, disagreement
from calibrate.inference.slopes import SlopesOfSmallerBeds
from calibrate.inference.widening import Round, Screened, advised, chosen, widened
from calibrate.io.lab import Lab
from calibrate.io.soil import with_values
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset
from calibrate.simulation.specimens import (
    Seeds,
    checked_json,
    rates_json,
    reservations,
    soil_json,
    summary_json,
)
from jdem.materials.soil import SoilParameters
from jdem.sensitivity.base import AbstractStrategy

# Where large beds are dear: a residual of 0.3 deviations is a third of what packings leave open.
THRIFTY = Settings(evaluations=10, patience=3, tolerance=0.3)
EXPLORING = Settings(evaluations=12, patience=4, tolerance=0.3)  # small beds are cheap


def calibrate(
    lab: Lab,
    preset: Preset,
    free: tuple[str, ...] | None,
    base: SoilParameters,
    seed: int,
    work: AbstractCampaign,
    coarse: AbstractCoarse | None = None,
) -> "Calibrated":
    """The whole calibration of a lab file; resumes from what `work.folder` holds.

    Args:
        lab: what was measured, and how.
        preset: how many packings, and how many of them are held back.
        free: names of the parameters to fit; None: the lab file's choice, or what the data fix.
        base: where it starts; parameters that are not free stay there.
        seed: choice of packings, from 0.
        work: simulates the lab's tests.
        coarse: what it explores with, smaller beds or a response; None: nothing.

    Returns:
        The fit, and everything that result.json says of it (`fit_json`).

    Raises:
        CalibrationError: nothing could be simulated.
    """
    explored = explore(lab, preset, free, base, seed, work, coarse)
    setup, rounds = explored.setup, explored.rounds
    calibration, result = setup.settled(rounds)
    helped = setup.help(Round(calibration, result), explored.screened, rounds)
    soil = calibration.space.soil(result.best.values)
    return Calibrated(
        setup=setup,
        calibration=calibration,
        result=result,
        rounds=rounds,
        screening=explored.screening,
        first=explored.first,
        fitted_runs=work.runs([soil], setup.seeds.fitted, "fitted packings")[0],
        fresh_runs=work.runs([soil], setup.seeds.fresh, "fresh packings")[0],
        named_runs=setup.named_runs(),
        help=helped,
    )


@dataclass(frozen=True, eq=False)
class Explored:
    """Before the beds that decide: screening, ratio of features at the start, rounds of fits."""

    setup: "FitSetup"
    screened: Screened | None
    screening: dict
    first: Correction
    rounds: list[Round]


def explore(
    lab: Lab,
    preset: Preset,
    free: tuple[str, ...] | None,
    base: SoilParameters,
    seed: int,
    work: AbstractCampaign,
    coarse: AbstractCoarse | None = None,
) -> Explored:
    """The first half of `calibrate`, whose arguments it takes: which parameters, and from where."""
    problem, seeds = pose(lab), Seeds.of(seed, preset.packings, preset.fresh)
    free = free or stated_free(lab)
    space(lab, free or not_held(lab), base)  # refuses a start beyond its bounds, before any run
    scatter, scattered = scatter_of_packings(problem, base, seeds, work, coarse)
    setup = FitSetup(lab, problem, base, seeds, work, scatter, scattered, coarse)
    screened = setup.screened() if free is None else None
    screening = {} if screened is None else screening_json(setup, screened)
    if free is None:
        free = tuple(screening["free"])
        work.progress.say("free parameters: " + _chosen(screening["alike"]))
    calibration = setup.calibration(free)
    first = setup.at_start(calibration)
    return Explored(setup, screened, screening, first, setup.rounds(calibration, first, screened))


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A fit with everything around it: what it was made from, the rounds that led to it, the ratio
    of both sizes of beds at the start, runs at the fitted values and of the lab file's named
    parameter sets, and one sentence of what would help where it missed."""

    setup: "FitSetup"
    calibration: Calibration
    result: Fit
    rounds: list[Round]
    screening: dict
    first: Correction
    fitted_runs: list[Run]
    fresh_runs: list[Run]
    named_runs: dict[str, list[Run]]
    help: str

    @property
    def met(self) -> bool:
        """Whether the fitted packings meet what was measured."""
        return not misses(compared(self.setup.problem, self.result.covariance, self.result.best))


@dataclass(frozen=True, eq=False)
class FitSetup:
    """Everything that a fit needs but its free parameters."""

    lab: Lab
    problem: Problem
    base: SoilParameters
    seeds: Seeds
    work: AbstractCampaign
    scatter: np.ndarray
    scattered: int
    coarse: AbstractCoarse | None

    @property
    def simulations(self) -> int:
        """Of this start, those of smaller beds included."""
        return self.work.simulated + (self.coarse.campaign.simulated if self.coarse else 0)

    def calibration(
        self, names: tuple[str, ...], strategy: AbstractStrategy | None = None
    ) -> Calibration:
        """With these parameters free; `strategy` as in `Settings`."""
        return Calibration(
            problem=self.problem,
            space=space(self.lab, names, self.base),
            campaign=self.work,
            seeds=self.seeds.fitted,
            relative_scatter=self.scatter,
            scatter_packings=self.scattered,
            settings=replace(self._settings, strategy=strategy),
            coarse=self.coarse,
        )

    @property
    def _settings(self) -> Settings:
        if self.coarse is None:
            return Settings()
        return replace(THRIFTY, digits=DIGITS) if self.coarse.near else THRIFTY

    def screened(self) -> Screened:
        """Slopes of all features in every parameter that the lab file does not hold."""
        every = space(self.lab, not_held(self.lab), self.base)
        what, start = "sensitivity of every parameter", to_digits(every.start())
        if self.coarse is not None and self.coarse.near:
            slopes = self.coarse.slopes(self.problem, every, start)
            rows = self.coarse.features(self.problem, self.base, self.seeds.fitted, what)
            assert slopes is not None
            return Screened(every, slopes, rows.mean(axis=0))
        calibration = self.calibration(every.names, ensemble(every))
        slopes = calibration.slopes(every.start(), what)
        return Screened(every, slopes, calibration.evaluate(start, what).features.mean(axis=0))

    def at_start(self, calibration: Calibration) -> Correction:
        """The ratio of what decides to what explores at the start, where exploring needs it."""
        if self.coarse is not None and self.coarse.near:
            return Correction.none(len(self.problem.measured))
        return calibration.correction(calibration.space.start(), "both resolutions at the start")

    def descend(
        self, calibration: Calibration, start: np.ndarray | None = None
    ) -> Descent | Solved:
        """The way of the solver of what explores."""
        solver = None if self.coarse is None else self.coarse.solver
        return descend(calibration, start) if solver is None else solver(calibration, start)

    def rounds(
        self, calibration: Calibration, correction: Correction, screened: Screened | None
    ) -> list[Round]:
        """Fits of the first choice and, where the program chose and misses, of wider ones; with
        smaller beds where there are any."""

        def level(each: Calibration) -> Calibration:
            return each if self.coarse is None else exploring(each, correction)

        start = level(calibration)
        first = Round(start, self.descend(start))
        if screened is None:
            return [first]
        return widened(first, screened, lambda names: level(self.calibration(names)), self.descend)

    def settled(self, rounds: Sequence[Round]) -> tuple[Calibration, Fit]:
        """The fit of the round that counts, on the beds that decide, all evaluations before it."""
        kept = chosen(rounds)
        if self.coarse is not None and self.coarse.near and kept.best is None:
            raise CalibrationError("the soil that fits best lies beyond the library's runs")
        if self.coarse is None:
            assert not isinstance(kept.descent, Solved)
            result = finished(kept.calibration, kept.descent)
            history = joined([each.descent.history for each in rounds])
            return kept.calibration, replace(result, history=history)
        calibration = self.calibration(kept.names)
        result = fit_from(calibration, kept.best, kept.descent.slopes)
        before = joined([each.descent.history for each in rounds if each.best is not None])
        cost = self.coarse.cost
        explored = [
            {**row, "status": "explored", "forward_runs": cost * row["forward_runs"]}
            for row in before
        ]
        return calibration, replace(result, history=joined([explored, result.history]))

    def named_runs(self) -> dict[str, list[Run]]:
        """Runs of the lab file's named parameter sets on the packings of the fit."""
        soils = [with_values(self.base, values) for values in self.lab.named_sets.values()]
        rows = self.work.runs(soils, self.seeds.fitted, "named parameter sets") if soils else []
        return dict(zip(self.lab.named_sets, rows, strict=True))

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
    coarse: AbstractCoarse | None,
) -> tuple[np.ndarray, int]:
    """Covariance (m, m) of one packing's features over their mean, and from how many packings."""
    if coarse is not None:
        return coarse.scatter(problem, soil, seeds, work)
    runs = work.runs([soil], seeds.scatter, "scatter of packings")[0]
    return packing_scatter(problem, runs), len(runs)


def exploring(calibration: Calibration, correction: Correction) -> Calibration:
    """The same with smaller beds, to targets corrected for them."""
    coarse = calibration.coarse
    assert coarse is not None
    coarse.campaign.progress.say(f"exploring with {coarse.described}")
    return replace(
        calibration,
        problem=coarse.heard(corrected(calibration.problem, correction), calibration.space.base),
        campaign=coarse.campaign,
        coarse=None,
        settings=EXPLORING,
    )


def fit_from(calibration: Calibration, smaller: Evaluation | None, slopes: np.ndarray) -> Fit:
    """The fit from where smaller beds were best, with the slopes (m, p) that they ended with; from
    the start where none of their evaluations succeeded."""
    if smaller is None or smaller.failures:
        return fit(calibration)
    return fit(calibration, smaller.values, SlopesOfSmallerBeds(slopes))


def resolutions_json(calibration: Calibration, first: Correction, result: Fit) -> dict:
    """Ratio of what decides to what explored, feature by feature, at the start and at the best
    point; empty where nothing did.  Says so where both differ by more than their errors."""
    coarse = calibration.coarse
    if coarse is None:
        return {}
    problem = calibration.problem
    last = calibration.correction(result.best.values, "both resolutions at the best point")
    changed = disagreement(problem, first, last)
    if changed:
        calibration.campaign.progress.say(coarse.disagreeing(changed))
    return {
        "explored_with": coarse.described,
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


def screening_json(setup: FitSetup, screened: Screened) -> dict:
    """Slopes of all features in all candidates, and the parameters that the data can fix."""
    names = screened.space.names
    whitened = setup.calibration(names).whitened(screened.slopes)
    rank = len(setup.problem.measured)
    prior = screened.space.prior_sd()
    found = choose_free(names, whitened, prior, rank) or [strongest(names, whitened, prior)]
    features = [feature.name for feature in setup.problem.features]
    return {
        "free": [choice.name for choice in found],
        "signal_to_noise": {choice.name: choice.signal_to_noise for choice in found},
        "alike": {choice.name: list(choice.alike) for choice in found},
        "slopes_per_ln": {
            feature: dict(zip(names, row.tolist(), strict=True))
            for feature, row in zip(features, screened.slopes, strict=True)
        },
    }


def _chosen(alike: Mapping[str, Sequence[str]]) -> str:
    """The names, each with the others that would have served as well."""
    return ", ".join(
        f"{name} (in the place of {' or '.join(others)}, which the data see about as well)"
        if others
        else name
        for name, others in alike.items()
    )


def fit_json(done: Calibrated) -> dict:
    """The contract's keys for `fit`, and what was checked on fresh packings."""
    setup, calibration, found = done.setup, done.calibration, done.result
    lab, names, best = setup.lab, calibration.space.names, found.best
    features = compared(setup.problem, found.covariance, best)
    met, rounds = not misses(features), [each.as_json() for each in done.rounds]
    base = soil_json(setup.base)
    ever = {name: base[name] for each in rounds for name in each["free"]}  # free at some time
    result = {
        "parameters": soil_json(calibration.space.soil(best.values)),
        "free": list(names),
        **checked_json(lab, setup.seeds, done.fitted_runs, done.fresh_runs),
        "targets": {name: target.mean for name, target in lab.targets.items()},
        "rates": rates_json(setup.work),
        "features": features,
        "met": met,
        "packing_scatter": dict(
            zip(features, np.sqrt(np.diag(setup.scatter)).tolist(), strict=True)
        ),
        "simulations": setup.simulations,
        "resolutions": resolutions_json(calibration, done.first, found),
        "stopped": found.stopped,
        "strategy": calibration.strategy.describe(),
        "profiles": found.profiles,
        "identifiability": found.identifiability.as_json(met),
        "screening": done.screening,
        "rounds": rounds,
        "history": [{**row, "parameters": {**ever, **row["parameters"]}} for row in found.history],
        "named_sets": {name: summary_json(runs) for name, runs in done.named_runs.items()},
        "at_bound": calibration.space.at_bound(best.values),
        "notes": begun_late(lab),
        "help": done.help,
    }
    return {**result, "warnings": warnings(result, reservations(result["quality"]))}
