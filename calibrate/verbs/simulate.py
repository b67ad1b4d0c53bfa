"""Run the lab's virtual tests on several packings: curves, observables, scatter."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import RenderableType

from calibrate.core.files import write_json
from calibrate.io.lab import Lab
from calibrate.labtests.composite import label
from calibrate.records.base import Measured, record
from calibrate.reports.terminal import (
    course,
    observables_table,
    warned_of_observables,
    warned_of_reservations,
)
from calibrate.simulation import specimens
from calibrate.simulation.run import Run
from calibrate.simulation.session import Session, origin_of
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, line, verb


@dataclass(frozen=True, eq=False, repr=False)
class SimulationResult(AbstractDrawnResult):
    """Simulated tests of one soil on several packings.

    Attributes:
        lab: the soil that was simulated.
        folder: where result.json and curves.png are.
        runs: one run a packing, failed ones among them.
    """

    verb = "simulate"
    files = ("result.json",)
    lab: Lab
    folder: Path
    content: dict
    runs: tuple[Run, ...]

    @property
    def observables(self) -> dict[str, float]:
        """Means over packings by name, in the unit that the name ends with (mm, N or %)."""
        return self.content["observables"]

    @property
    def spread(self) -> dict[str, float]:
        """Standard deviations over packings: the scatter of one specimen."""
        return self.content["spread"]

    @property
    def parameters(self) -> dict[str, float]:
        """The soil's parameters by name, SI."""
        return self.content["parameters"]

    @property
    def curves(self) -> list[dict[str, np.ndarray]]:
        """Of each packing the curves by test: arrays (points, 2) of mm and N."""
        return [run.curves for run in self.runs]

    @property
    def channels(self) -> list[dict[str, dict[str, np.ndarray]]]:
        """Of each packing what tests record beside their curves, by test and name with unit."""
        return [run.channels for run in self.runs]

    @property
    def failures(self) -> list[str]:
        """Why packings failed; empty where none did."""
        return self.content["failures"]

    def words(self) -> Iterator[RenderableType]:
        found = self.content
        if len(self.failures) < len(self.runs):
            yield observables_table(self.lab, {"simulated": found})
        if found.get("together"):
            said = (f"{label(name)} {value:.4g}" for name, value in found["together"].items())
            yield line(f"tests together: {'; '.join(said)}")
        yield from warned_of_observables(found)
        yield from (line(f"failed: {failure}") for failure in self.failures)
        yield line(course(found))
        yield from warned_of_reservations(found)

    @property
    def drawn(self) -> tuple[tuple[Run, ...], Measured]:
        """The runs, and what was measured."""
        return self.runs, record(Measured, specimens.measured_json(self.lab))


@verb
def simulate(
    lab: options.LabFile = None,
    *,
    values: options.Changes = None,
    conventions: options.Conventions = None,
    preset: options.PresetName = "quick",
    seed: options.Seed = 0,
    prepare_with_soil: options.Preparation = False,
    single: Annotated[
        bool, typer.Option("--single/--double", help="Numbers in single precision: faster.")
    ] = False,
    out: options.Out = "results/simulate",
    dask: options.Dask = None,
) -> SimulationResult:
    """Simulates the tests of a lab file on several packings of spheres.

    Simulations are kept in `out`; a second call with the same arguments reads them.

    Args:
        lab: a lab file's path, or what `load_lab` returned; None: the bundled soil.
        values: parameters in place of the lab file's, by name, in SI units or with a unit
            ("12 J/m^2").
        conventions: whose contact law: "eepa", "liggghts" or "liggghts_history"; None: the lab
            file's.
        preset: "quick", "standard" or "fine": how many spheres and packings.
        seed: choice of packings, from 0.
        prepare_with_soil: beds settle with the soil under test, not with a slippery one.
        single: in single precision, which is faster.
        out: folder for results.
        dask: address of a Dask cluster that simulates; None: this machine.

    Returns:
        Observables, curves and scatter, and result.json and curves.png in `out`.

    Raises:
        InputError: the lab file or an argument is wrong.
        CalibrationError: every packing failed; its `result` holds them.

    Example:
        >>> found = calibrate.simulate(values={"surface_energy": 12.0})
        >>> found.observables["depression_depth_mm"]
    """
    folder = Path(out)
    session = Session.open(lab, preset, folder, dask, conventions)
    if single:
        session = session.in_single_precision()
    soil = session.soil(values)
    work = session.campaign(folder, soil if prepare_with_soil else None)
    content, runs = specimens.simulate(session.lab, session.preset, soil, seed, work)
    return kept(session, content, runs)


def kept(session: Session, content: dict, runs: Sequence[Run]) -> SimulationResult:
    """The result, with result.json and a figure in the session's folder."""
    content = {**origin_of(session), **content}
    found = SimulationResult(session.lab, session.out, content, tuple(runs))
    write_json(session.out / "result.json", content)
    found.save_figures()
    specimens.check_some_sound(runs, result=found)
    return found
