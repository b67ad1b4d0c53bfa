"""Say how surely the data fix each parameter: draws of soils that explain what was measured."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import xarray as xr
from rich.console import RenderableType
from rich.table import Table

from calibrate.core.errors import COMMAND_LINE, InputError, suggestion
from calibrate.core.files import write_json
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.calibration import Calibrated, calibrate
from calibrate.inference.draws import FILE, described, inference_data, write_draws
from calibrate.inference.on_response import OnResponse
from calibrate.inference.parameters import Acting
from calibrate.inference.posterior import Question, Shown
from calibrate.inference.sampling import sampled
from calibrate.io.lab import Lab
from calibrate.io.labfile import PARAMETER_UNITS
from calibrate.labtests.composite import label
from calibrate.records.base import Curve, Measured, record
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.session import Session, origin_of
from calibrate.simulation.specimens import Seeds, measured_json
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb


@dataclass(frozen=True, eq=False, repr=False)
class PosteriorResult(AbstractDrawnResult):
    """What is known of one soil's parameters, given its tests.

    Attributes:
        lab: the soil.
        folder: where posterior.json, posterior.nc and posterior.png are.
        content: everything but the draws, with the keys of posterior.json.
        draws: ArviZ' InferenceData, as in posterior.nc.
    """

    verb = "posterior"
    files = ("posterior.json", FILE)
    lab: Lab
    folder: Path
    content: dict
    draws: xr.DataTree

    @property
    def parameters(self) -> dict[str, dict[str, float]]:
        """By name, SI: `median`, `low` and `high` of the 90 % interval, `rhat` and `ess`."""
        return self.content["parameters"]

    @property
    def effects(self) -> dict[str, dict]:
        """Strengths of the effects that were asked for, by name, in their `unit`, with the same
        keys."""
        return self.content.get("effects", {})

    @property
    def warnings(self) -> list[str]:
        """What to know before the numbers are used, one sentence each."""
        return self.content["warnings"]

    @property
    def drawn(self) -> tuple:
        """Draws of posterior and prior by parameter, curves by test, and what was measured."""
        draws = [
            {name: np.ravel(self.draws[group][name]) for name in self.parameters}
            for group in ("posterior", "prior")
        ]
        curves = {
            str(test): [Curve.of(points) for points in np.asarray(every)]
            for test, every in self.draws["curves"].data_vars.items()
        }
        return *draws, curves, record(Measured, measured_json(self.lab))

    def words(self) -> Iterator[RenderableType]:
        title = f"{self.lab.name}: 90 % of draws lie between low and high"
        columns = ("", "median", "low", "high", "unit", "width, of the prior's")
        table = Table(*columns, title=title, title_justify="left")
        units = {**PARAMETER_UNITS, **{name: row["unit"] for name, row in self.effects.items()}}
        for name, row in {**self.parameters, **self.effects}.items():
            numbers = (f"{row[key]:.4g}" for key in ("median", "low", "high"))
            table.add_row(name, *numbers, units[name], f"{100 * row['width']:.0f} %")
        yield table
        yield from map(line, [*self._features(), *self.content["directions"]])
        yield from (line(f"warning: {sentence}") for sentence in self.warnings)

    def _features(self) -> Iterator[str]:
        """Measured numbers beside what soils of the posterior would show."""
        features = self.content["features"]
        for name, row in features.items():
            if row["target"]:
                yield (
                    f"{label(name)}: {row['measured']:.4g} measured; such soils show "
                    f"{row['low']:.4g} to {row['high']:.4g} (90 %)"
                )
        curves = [row for row in features.values() if not row["target"]]
        if curves:
            inside = sum(row["low"] <= row["measured"] <= row["high"] for row in curves)
            yield (
                f"of {len(curves)} numbers read from curves, {inside} lie where 90 % of such soils "
                "show them"
            )


@verb
def posterior(
    lab: options.LabFile = None,
    *,
    values: options.Changes = None,
    conventions: options.Conventions = None,
    preset: options.PresetName = "standard",
    seed: options.Seed = 0,
    prepare_with_soil: options.Preparation = False,
    no_runs: Annotated[
        bool, typer.Option("--no-runs", help="By the library of runs alone; nothing is simulated.")
    ] = False,
    effects: Annotated[
        str | Sequence[str],
        typer.Option(
            "--effect",
            metavar="NAME",
            help="Effect whose strength is unknown too; may be given several times.",
        ),
        options.Typed(list[str] | None),
    ] = (),
    out: options.Out = "results/posterior",
    dask: options.Dask = None,
) -> PosteriorResult:
    """Says how surely the data fix each parameter: draws of soils that explain the measurements.

    It fits as `fit` does, corrects the library of runs by what was simulated on the way, and draws
    soils from the posterior of all parameters that the library varies and the lab file does not
    hold.  Simulations and draws are kept in `out`; a second call goes on where the first one
    stopped, and in the folder of a fit it simulates nothing that the fit did.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        values: centres of priors in place of the lab file's, by name, in SI units or with a unit.
        conventions: whose contact law: "eepa", "liggghts" or "liggghts_history"; None: the lab
            file's.
        preset: "standard" or "fine": how many spheres and packings.
        seed: choice of packings and of random numbers, from 0.
        prepare_with_soil: beds settle with the soil under test, not with a slippery one.
        no_runs: nothing is simulated; the library of runs alone answers.
        effects: effects that may act on the tests, by name (docs/effects.md): their strengths are
            drawn with the parameters.
        out: folder for results.
        dask: address of a Dask cluster that simulates; None: this machine.

    Returns:
        Medians and intervals, what the data fix and leave open, warnings; posterior.json,
        posterior.nc, ArviZ' InferenceData, and posterior.png in `out`.

    Raises:
        InputError: the lab file or an argument is wrong, or the library does not serve.
        CalibrationError: nothing could be simulated, or no soil of the library is within bounds.

    Example:
        >>> known = calibrate.posterior("my_soil.toml", no_runs=True)
        >>> known.parameters["shear_modulus"]["low"], known.parameters["shear_modulus"]["high"]
    """
    session = Session.open(lab, preset, Path(out), dask, conventions)
    base = session.soil(values)
    work = session.campaign(session.out, base if prepare_with_soil else None)
    response, why = served(session.lab, session.preset, None, base, work)
    if response is None:
        problem = f"the library of runs does not serve this laboratory: {why}"
        raise InputError(session.lab.file or COMMAND_LINE, "", problem, "use calibrate fit")
    seeds = Seeds.of(seed, session.preset.packings, session.preset.fresh)
    acting = asked_for([effects] if isinstance(effects, str) else effects or (), response)
    question = Question.of(session.lab, base, response, work, seeds, acting)
    shown, notes = (), []
    if not no_runs:
        done = calibrate(session.lab, session.preset, None, base, seed, work, response)
        shown = tuple(shown_by_fit(question, done, work))
        notes = [] if done.met else ["the fit before it missed the data"]
    content = {"preset": session.preset.name, "spheres": session.preset.spheres}
    found = sampled(question, shown, None if no_runs else work, content, seed, session.out,
                    session.progress)  # fmt: skip
    tree = inference_data(question, found, seed, {**content, "simulated": int(not no_runs)})
    write_draws(tree, session.out)
    said = described(question, found, tree, notes)
    result = {**origin_of(session), "spheres": session.preset.spheres, "simulated": not no_runs,
              "simulations": work.simulated, **said}  # fmt: skip
    write_json(session.out / "posterior.json", result)
    answer = PosteriorResult(session.lab, session.out, result, tree)
    answer.save_figures()
    return answer


def asked_for(names: Sequence[str], response: OnResponse) -> tuple[Acting, ...]:
    """The effects of these names that a response knows; refused where it does not know one."""
    known = {each.name: each for each in response.acting}
    for name in names:
        if name not in known:
            repair = suggestion(name, known) or f"give some of {', '.join(known)}"
            raise InputError(COMMAND_LINE, "--effect", f"no effect '{name}'", repair)
    if len(set(names)) < len(names):
        raise InputError(COMMAND_LINE, "--effect", "one name twice", "name each effect once")
    return tuple(known[name] for name in names)


def shown_by_fit(question: Question, done: Calibrated, work: AbstractCampaign) -> Iterator[Shown]:
    """What the fit's beds that decide showed, at each point that it evaluated with them; the best
    one on fresh packings too."""
    space, seeds = question.space, done.setup.seeds
    start, best = dict(zip(space.names, space.start(), strict=True)), done.result.best.values
    ever: dict[tuple, Sequence[int]] = {}
    for row in done.result.history:
        if row["status"] != "explored":
            values = {**start, **{n: v for n, v in row["parameters"].items() if n in start}}
            ever[tuple(values.values())] = seeds.fitted
    fitted = {**start, **dict(zip(done.calibration.space.names, best.tolist(), strict=True))}
    ever[tuple(fitted[name] for name in space.names)] = (*seeds.fitted, *seeds.fresh)
    low, high = space.log_bounds()
    for point, packings in ever.items():
        values = np.array(point)
        inside = np.all((np.log(values) >= low) & (np.log(values) <= high))
        found = Shown.by(work, question.problem, space, values, packings, "what the fit showed")
        if inside and found is not None:
            yield found
