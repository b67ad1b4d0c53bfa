"""Predict a test that took no part: curves and numbers of the soils of a posterior, with bands."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import RenderableType
from rich.table import Table

from calibrate.core.files import write_json
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.draws import SoilDraws, read_draws
from calibrate.inference.prediction import (
    SHARE,
    Prediction,
    by_response,
    by_runs,
    prediction_json,
    prediction_sentences,
)
from calibrate.io.lab import Lab
from calibrate.labtests.composite import label
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import Seeds, measured_json
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb
from jdem.materials.soil import SoilParameters

if TYPE_CHECKING:
    from calibrate.io.lab import LabLike

DRAWS = 200  # soils of which the library is asked
PACKINGS = 2  # of its own, on which each soil is simulated


@dataclass(frozen=True, eq=False, repr=False)
class PredictionResult(AbstractDrawnResult):
    """What tests would show of a soil that is known as well as a posterior says.

    Attributes:
        lab: the tests.
        folder: where prediction.json and prediction.png are.
    """

    verb = "predict"
    files = ("prediction.json",)
    lab: Lab
    folder: Path
    content: dict

    @property
    def observables(self) -> dict[str, dict]:
        """By name, in the unit that the name ends with: `middle`, the ends of 90 % of single
        specimens (`specimen`) and of means over many (`mean`), and `sd` by cause."""
        return self.content["observables"]

    @property
    def curves(self) -> dict[str, dict]:
        """By test: points of the curve, and the same of each."""
        return self.content["curves"]

    @property
    def warnings(self) -> list[str]:
        """What to know before the numbers are used, one sentence each."""
        return self.content["warnings"]

    @property
    def drawn(self) -> tuple[dict]:
        """The content."""
        return (self.content,)

    def words(self) -> Iterator[RenderableType]:
        found, share = self.content, f"{100 * SHARE:.0f} %"
        runs = f"{found['simulations']} simulations" if found["simulations"] else "no simulation"
        yield line(f"predicted from {found['soils']} soils by {found['by']}: {runs}")
        table = Table("", "expected", f"{share} of specimens", f"{share} of means over many")
        for name, row in self.observables.items():
            ends = (f"{row[k][0]:.4g} to {row[k][1]:.4g}" for k in ("specimen", "mean"))
            table.add_row(label(name), f"{row['middle']:.4g}", *ends)
        yield table
        for name, row in self.observables.items():
            yield from map(line, prediction_sentences(label(name), row))
        yield from (line(f"warning: {sentence}") for sentence in self.warnings)


@verb
def predict(
    draws: Annotated[
        str | Path,
        typer.Argument(metavar="[FOLDER]", help="Folder of calibrate posterior."),
        options.Typed(Path),
    ] = "results/posterior",
    *,
    test: Annotated[
        "LabLike",
        typer.Option("--test", metavar="LAB.toml", help="Lab file of the tests to predict."),
        options.Typed(Path | None),
    ] = None,
    soils: Annotated[
        int,
        typer.Option("--soils", min=2, max=100, help="Soils to simulate where runs are needed."),
    ] = 6,
    runs_alone: Annotated[
        bool, typer.Option("--runs-alone", help="Simulate, and leave the library out.")
    ] = False,
    preset: options.PresetName = "standard",
    seed: options.Seed = 0,
    out: options.Out = "results/prediction",
    dask: options.Dask = None,
) -> PredictionResult:
    """Predicts tests that took no part in a fit, from soils that a posterior holds possible.

    Tests that the bundled library of runs knows are answered at once.  Others are simulated, of
    some soils on two packings each.  Numbers that the lab file gives as measured are compared.

    Args:
        draws: the folder of `calibrate posterior`.
        test: a lab file's path, or what `load_lab` returned; None: the bundled soil's tests.
        soils: how many soils are simulated, where the library does not know the tests.
        runs_alone: simulates in any case.
        preset: "standard" or "fine"; "quick" too, where tests are simulated.
        seed: choice of packings and of random numbers, from 0.
        out: folder for results; a second call goes on where the first one stopped.
        dask: address of a Dask cluster that simulates; None: this machine.

    Returns:
        Expected numbers and curves with bands: of the parameters, of packings, and of the library;
        prediction.json and prediction.png in `out`.

    Raises:
        InputError: there are no draws, or the lab file or an argument is wrong.
        CalibrationError: fewer than two soils could be simulated.

    Example:
        >>> known = calibrate.posterior(no_runs=True)
        >>> calibrate.predict(known.folder, test="other_test.toml").observables
    """
    session = Session.open(test, preset, Path(out), dask)
    known = read_draws(draws)
    base = known.base_in(session.lab)
    work = session.on_soil().campaign(session.out)
    found, why = None, "--runs-alone was given"
    if not runs_alone:
        found, why = _by_library(session, known, base, work, seed)
    if found is None:
        session.progress.say(f"the library of runs does not predict this: {why}")
        drawn = [known.in_soil(base, n) for n in _some(known, soils)]
        packings = Seeds.of(seed, PACKINGS * len(drawn), 0).fitted
        found = by_runs(work, drawn, packings)
    targets = measured_json(session.lab)["targets"]
    content = {
        **origin_of(session),
        "spheres": session.preset.spheres,
        "draws": str(draws),
        "of_soil": known.tree.attrs["soil"],
        **prediction_json(found, targets),
        "measured": measured_json(session.lab),
        "without_library": why,
        "warnings": list(_warnings(session, known)),
    }
    result = PredictionResult(session.lab, session.out, content)
    write_json(session.out / "prediction.json", content)
    result.save_figures()
    return result


def _some(known: SoilDraws, count: int) -> list[int]:
    """Numbers of so many draws, evenly spaced through all chains."""
    step = max(1, len(known.values) // count)
    return list(range(step // 2, len(known.values), step))[:count]


def _by_library(
    session: Session, known: SoilDraws, base: SoilParameters, work: AbstractCampaign, seed: int
) -> tuple[Prediction | None, str]:
    """The prediction by the bundled library, or why there is none."""
    response, why = served(session.lab, session.preset, known.names, base, work)
    if response is None:
        return None, why
    points = CurvePoints.of(work)
    unknown = [n for n in points.observables if n not in response.observables]
    if unknown:
        return None, f"it does not have the number {', '.join(unknown)}"
    smaller = replace(session.preset, spheres=session.preset.spheres // 2)
    fewer, _ = served(session.lab, smaller, known.names, base, work)
    drawn = [known.in_soil(base, n) for n in _some(known, DRAWS)]
    return by_response(response, fewer, drawn, points, seed, known.wider), ""


def _warnings(session: Session, known: SoilDraws) -> Iterator[str]:
    if not known.tree.attrs.get("simulated", 1):
        yield "the posterior was not corrected by simulations (--no-runs)"
    if known.tree.attrs["preset"] != session.preset.name:
        yield (
            f"the posterior is of the preset {known.tree.attrs['preset']}, and sphere size changes "
            "what a soil shows"
        )
    mine, theirs = session.lab.name, known.tree.attrs["soil"]
    if mine != theirs:
        yield f"the lab file is of the soil '{mine}', and the draws are of '{theirs}'"
