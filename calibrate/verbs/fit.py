"""Calibrate the parameters that the data can fix; say which those are."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.console import RenderableType
from rich.table import Table

from calibrate.core.errors import COMMAND_LINE, CalibrationError, InputError
from calibrate.core.files import write_json, write_text
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.calibration import Calibrated, Explored, calibrate, explore, fit_json
from calibrate.inference.estimate import estimate_json, estimated
from calibrate.inference.on_response import OnResponse
from calibrate.inference.parameters import checked_free, ranges_of
from calibrate.inference.prediction import prediction_json, prediction_sentences
from calibrate.inference.resolutions import Coarse
from calibrate.inference.verified import parts, predicted
from calibrate.io.choices import unit_of
from calibrate.io.lab import Lab
from calibrate.labtests.composite import label
from calibrate.records.fit import FitRecord
from calibrate.reports.terminal import history_table, observables_table, warned_of_observables
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import check_some_sound, measured_json
from calibrate.verbs import options
from calibrate.verbs.base import (
    AbstractRecordedResult,
    AbstractResult,
    line,
    listed,
    verb,
)
from jdem.materials.soil import SoilParameters


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(AbstractRecordedResult[FitRecord]):
    """Fitted parameters of one soil, how well the data fix them, and the check on fresh packings.

    Attributes:
        lab: the soil that was fitted.
        folder: where result.json, history.csv and fit.png are.
    """

    verb, kind = "fit", FitRecord
    files = ("result.json", "history.csv")
    lab: Lab
    folder: Path
    content: dict

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by name, SI; those that were not free at their starting values."""
        return self.content["parameters"]

    @property
    def free(self) -> list[str]:
        """Names of the parameters that were fitted."""
        return self.content["free"]

    @property
    def interval_95(self) -> dict[str, tuple[float, float]]:
        """95 % intervals of the free parameters, SI."""
        return self.record.identifiability.interval_95

    @property
    def observables(self) -> dict[str, float]:
        """Means over the packings of the fit, in the unit that the name ends with (mm, N or %)."""
        return self.content["observables"]

    @property
    def fresh_observables(self) -> dict[str, float]:
        """The same over packings that took no part in the fit."""
        return self.content["fresh_packings"]["observables"]

    @property
    def met(self) -> bool:
        """Whether the packings of the fit meet what was measured; fresh ones are not asked."""
        return self.content["met"]

    @property
    def warnings(self) -> list[str]:
        """What to know before the numbers are used, one sentence each."""
        return self.record.all_warnings()

    def words(self) -> Iterator[RenderableType]:
        found = self.content
        groups = {
            **{f"set '{name}'": group for name, group in found["named_sets"].items()},
            "fitted packings": found,
            "fresh packings": found["fresh_packings"],
        }
        yield observables_table(self.lab, groups)
        both = {name: (self.record.start(name), self.parameters[name]) for name in self.free}
        yield parameters_table(both, self.interval_95)
        yield from map(line, [*self._verification(), *self._conclusions()])
        for name, row in ((found.get("verified") or {}).get("observables") or {}).items():
            yield from map(line, prediction_sentences(label(name), row))
        yield from warned_of_observables(found)

    def _verification(self) -> Iterator[str]:
        """How far fresh packings' means are from what was measured, and a publication's error."""
        fresh = self.record.fresh_packings
        count = len([packing for packing in self.record.packings.fresh if not packing.failure])
        for name, target in self.record.measured.targets.items():
            mean, error = fresh.observables[name], fresh.spread[name] / max(count, 1) ** 0.5
            said = (
                f"{label(name)} on {count} fresh packings: {mean:.4g} ± {error:.2g} (standard "
                f"error), {100 * (mean / target.mean - 1):+.1f} % of what was measured"
            )
            if target.published_error is not None:
                off = 100 * target.published_error
                said += f"; the publication's own simulation: {off:.1f} % off"
            yield said

    def _conclusions(self) -> Iterator[str]:
        """What the data fixed, what they left open, how the fit ended, and what it warns of."""
        found = self.record
        yield (
            f"stopped: {found.stopped}; {len(found.history)} evaluations, "
            f"{found.simulations} simulations in this start"
        )
        held = [name for name in ranges_of(self.lab) if name not in self.free]
        yield "held at their starting values: " + ", ".join(held)
        for direction in found.identifiability.directions:
            weights = " ".join(f"{w:+.2f} {name}" for name, w in direction.weights.items())
            word = VERDICTS[direction.verdict]
            yield f"{word} (signal/noise {direction.signal_to_noise:.1f}): {weights}"
        yield from (f"warning: {sentence}" for sentence in self.warnings)


@dataclass(frozen=True, eq=False, repr=False)
class EstimateResult(AbstractResult):
    """Parameters by the library of runs alone: nothing was simulated.

    Attributes:
        lab: the soil.
        folder: where estimate.json is.
    """

    files = ("estimate.json",)
    lab: Lab
    folder: Path
    content: dict

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters by name, SI; those that were not free at their starting values."""
        return self.content["parameters"]

    @property
    def interval_95(self) -> dict[str, list[float]]:
        """95 % intervals of the free parameters, SI."""
        return self.content["identifiability"]["interval_95"]

    @property
    def met(self) -> bool:
        """Whether the library of runs meets what was measured."""
        return self.content["met"]

    def words(self) -> Iterator[RenderableType]:
        start = self.content["start"]
        both = {name: (start[name], self.parameters[name]) for name in self.content["free"]}
        yield line(
            "NOT SIMULATED: an estimate by the bundled library of runs, as specimens of "
            f"{self.content['spheres']} spheres would give it; calibrate fit checks it"
        )
        yield parameters_table(both, self.interval_95)
        for name, row in self.content["features"].items():
            if not row["known"]:
                yield line(f"{name}: beyond the library's curves, so without a say")
                continue
            yield line(
                f"{name}: {row['simulated']:.4g} estimated (the library's own error: "
                f"{row['library_sd']:.2g}), {row['measured']:.4g} measured; their difference is "
                f"known to ± {row['sd']:.2g}"
            )
        yield from (line(f"{name} ended at its bound") for name in self.content["at_bound"])
        if not self.met:
            yield line("warning: the library of runs does not meet the data")


def parameters_table(
    values: Mapping[str, tuple[float, float]], intervals: Mapping[str, Sequence[float]]
) -> Table:
    """Free parameters by name: start, fitted value and interval."""
    columns = ("", "start", "fitted", "95 % interval", "unit")
    table = Table(*columns, title="free parameters", title_justify="left")
    for name, both in values.items():
        low, high = intervals[name]
        cells = [f"{x:.4g}" for x in both]
        table.add_row(name, *cells, f"{low:.4g} to {high:.4g}", unit_of(name))
    return table


VERDICTS = {
    "fixed": "fixed by the data",
    "left open": "LEFT OPEN by the data",
    "seen, but the fit missed": "SEEN BY THE DATA, WHICH THE FIT MISSED",
}


@verb
def fit(
    lab: options.LabFile = None,
    *,
    free: Annotated[
        str | Sequence[str] | None,
        typer.Option("--free", help="Names, comma-separated; default: chosen by data."),
        options.Typed(str | None),
    ] = None,
    values: options.Changes = None,
    conventions: options.Conventions = None,
    tests: options.Tests = None,
    verify: options.Verified = None,
    preset: options.PresetName = "quick",
    seed: options.Seed = 0,
    prepare_with_soil: options.Preparation = False,
    runs_alone: Annotated[
        bool,
        typer.Option("--runs-alone", help="Explore with smaller beds, not with a library."),
    ] = False,
    no_runs: Annotated[
        bool, typer.Option("--no-runs", help="Estimate by the library alone; not simulated.")
    ] = False,
    out: options.Out = "results/fit",
    dask: options.Dask = None,
) -> FitResult | EstimateResult:
    """Fits the parameters that the data can fix, and says which those are.

    Simulations are kept in `out`; a second call with the same arguments goes on where the first
    one stopped.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        free: names of the parameters to fit; None: the lab file's choice, or what the data can fix.
        values: parameters to start from in place of the lab file's, by name, in SI units or with a
            unit ("12 J/m^2").
        conventions: whose contact law: "eepa", "liggghts" or "liggghts_history"; None: the lab
            file's.
        tests: names of the tests to fit; None: all that are not verified.
        verify: names of tests that take no part and are predicted afterwards; None: none.
        preset: "quick", "standard" or "fine": how many spheres and packings.
        seed: choice of packings, from 0.
        prepare_with_soil: beds settle with the soil under test, not with a slippery one.
        runs_alone: explores with smaller beds, not with the bundled library of runs.
        no_runs: estimates the parameters by the library of runs alone, in seconds, as for the
            preset "standard" unless a finer one is given; nothing is simulated.
        out: folder for results.
        dask: address of a Dask cluster that simulates; None: this machine.

    Returns:
        Parameters with intervals, the check on fresh packings, warnings; result.json, history.csv
        and fit.png in `out`.  With `no_runs` an estimate instead, in estimate.json.

    Raises:
        InputError: the lab file or an argument is wrong.
        CalibrationError: nothing could be fitted; its `result` holds what there is.

    Example:
        >>> fitted = calibrate.fit(preset="quick")
        >>> fitted.parameters["shear_modulus"], fitted.interval_95["shear_modulus"]
    """
    if no_runs and runs_alone:
        problem = "one asks for simulations alone, the other for none"
        raise InputError(COMMAND_LINE, "--no-runs, --runs-alone", problem, "give one of them")
    folder = Path(out)
    if no_runs and preset == "quick":
        preset = "standard"  # the library's beds are not as coarse
    whole = Session.open(lab, preset, folder, dask, conventions)
    fitted_on, held_back = parts(whole.lab, listed(tests or ()), listed(verify or ()))
    session = replace(whole, lab=fitted_on)
    base = session.soil(values)
    names = None if free is None else checked_free(listed(free), session.lab)
    preparation = base if prepare_with_soil else None
    work = session.campaign(folder, preparation)
    response, why = None, "--runs-alone was given"
    if not runs_alone:
        response, why = served(session.lab, session.preset, names, base, work)
    given = (session.lab, session.preset, names, base, seed, work)
    if no_runs:
        return _estimate(session, partial(explore, *given), response, why)
    fitted = partial(calibrate, *given)
    done, why = _on_library(fitted, response, why)
    if done is None:
        session.progress.say(f"the library of runs does not explore: {why}")
        done = fitted(_smaller(session, preparation))
    return kept(session, done, why, _verified(session, done, held_back, preparation))


def _verified(
    session: Session, done: Calibrated, held_back: Lab | None, preparation: SoilParameters | None
) -> dict | None:
    """What tests that took no part would show, beside what was measured; None without any."""
    if held_back is None:
        return None
    work = replace(session, lab=held_back).campaign(session.out, preparation)
    found = predicted(done, work, done.setup.seeds.fresh[0], done.setup.seeds.fitted[0])
    return prediction_json(found, measured_json(held_back)["targets"])


def _on_library(
    fitted: Callable[[OnResponse], Calibrated], response: OnResponse | None, why: str
) -> tuple[Calibrated | None, str]:
    """A fit that explores on the library of runs, or why there is none that meets the data; `why`
    the library does not serve."""
    if response is None:
        return None, why
    try:
        done = fitted(response)
    except CalibrationError as failed:
        return None, str(failed)
    return (done, "") if done.met else (None, "the fit that it led to missed the data")


def _estimate(
    session: Session,
    explored: Callable[[OnResponse], Explored],
    response: OnResponse | None,
    why: str,
) -> EstimateResult:
    """The estimate by the library of runs, with estimate.json; refused where it does not serve."""
    if response is None:
        problem = f"the library of runs does not serve: {why}"
        repair = "leave it out: simulations are needed"
        raise InputError(COMMAND_LINE, "--no-runs", problem, repair)
    found = estimate_json(estimated(explored(response), response))
    content = {**origin_of(session), "spheres": session.preset.spheres, **found}
    write_json(session.out / "estimate.json", content)
    return EstimateResult(session.lab, session.out, content)


def _smaller(session: Session, preparation: SoilParameters | None) -> Coarse | None:
    """The smaller beds of the session's preset, if it explores with any."""
    spheres = session.preset.explored
    if spheres is None:
        return None
    beds = session.resized(spheres).campaign(session.out, preparation)
    return Coarse(beds, spheres, session.preset.spheres)


def kept(
    session: Session, done: Calibrated, why: str = "", verified: dict | None = None
) -> FitResult:
    """The result, with result.json, history.csv and a figure in the session's folder; why the
    library of runs did not explore, and what was verified."""
    content = {**origin_of(session), "spheres": session.preset.spheres, **fit_json(done)}
    content |= {"without_library": why, "verified": verified}
    found = FitResult(session.lab, session.out, content)
    write_json(session.out / "result.json", content)
    write_text(session.out / "history.csv", history_table(content["history"]))
    found.save_figures()
    check_some_sound(done.fresh_runs, "fresh packings", found)
    return found
