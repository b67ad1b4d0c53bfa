"""Calibrate by designed experiments, the paper's way, and lay gradients beside them."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import RenderableType

from calibrate.designs.comparison import Designed, design
from calibrate.records.study import StudyRecord
from calibrate.reports import study as report
from calibrate.simulation.session import Session
from calibrate.verbs import options
from calibrate.verbs.base import AbstractRecordedResult, verb


@dataclass(frozen=True, eq=False, repr=False)
class DoeResult(AbstractRecordedResult[StudyRecord]):
    """A study by designed experiments: screening, response surfaces, optimum, gradients beside.

    Attributes:
        study: designs, surfaces and the comparison.
        folder: where result.json, study.html, study.png and a run sheet for each design are.
    """

    verb, kind = "doe", StudyRecord
    files = ("result.json", "study.html", "run sheets")
    study: Designed
    folder: Path
    content: dict

    @property
    def optimum(self) -> dict[str, float]:
        """Parameters (SI) at which the last surfaces meet the targets best."""
        return self.content["optimum"]

    def words(self) -> Iterator[RenderableType]:
        yield from report.words(self.study)


@verb
def doe(
    lab: options.LabFile = None,
    *,
    values: options.Changes = None,
    preset: options.PresetName = "quick",
    seed: options.Seed = 0,
    out: options.Out = "results/doe",
    dask: options.Dask = None,
    batch: options.Batch = None,
) -> DoeResult:
    """Calibrates by Plackett-Burman, central composite and Box-Behnken designs.

    Args:
        lab: a lab file's path, or what `load_lab` returned, with at least one target; None: the
            bundled soil.
        values: parameters in place of the lab file's, by name, in SI units or with a unit.
        preset: "quick", "standard" or "fine": how many spheres and packings.
        seed: choice of packings, from 0.
        out: folder for results; a second call goes on where the first one stopped.
        dask: address of a Dask cluster that simulates; None: this machine.
        batch: specimens to simulate at once on an accelerator; None: on processor cores.

    Returns:
        Designs, surfaces, the optimum and what gradients say beside; result.json, study.html and
        run sheets in `out`.

    Raises:
        InputError: the lab has no target, or an argument is wrong.

    Example:
        >>> study = calibrate.doe(preset="quick")
        >>> study.optimum
    """
    folder = Path(out)
    session = Session.open(lab, preset, folder, dask, batch=batch).on_soil()
    base = session.soil(values)
    done = design(session.lab, session.preset, base, seed, session.campaign(folder))
    found = DoeResult(done, folder, report.write(session, done))
    found.save_figures()
    return found
