"""Say where model and curves differ, which effect is left out, how far the gap shrinks."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import RenderableType

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.diagnosis import Diagnosis, diagnosed
from calibrate.discrepancy.infill import InfillPlan, with_infill_runs
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.run_library import RunLibrary
from calibrate.discrepancy.library.store import bundled_library, load
from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
from calibrate.io.lab import load_lab
from calibrate.records.diagnosis import DiagnosisRecord, content
from calibrate.reports import diagnosis as report
from calibrate.reports.effects import title
from calibrate.simulation.session import Session, origin_of
from calibrate.verbs import options
from calibrate.verbs.base import AbstractRecordedResult, verb

RUNS = "simulated"  # folder of runs about the lab's explanations, in the output folder
NO_PRESET = "none: a library of runs stands for simulations"
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(AbstractRecordedResult[DiagnosisRecord]):
    """Where model and curves differ, which effect is left out, how far the gap shrinks with it.

    Attributes:
        folder: where result.json, diagnosis.html and figures are.
    """

    verb, kind = "diagnose", DiagnosisRecord
    files, pictures = ("result.json", "diagnosis.html"), "figures/{}.svg"
    folder: Path
    content: dict

    @property
    def verdict(self) -> str:
        """The cause that is named; "none", or "unknown" for one that the library lacks."""
        return self.record.which.verdict

    @property
    def reason(self) -> str:
        """Why the likeliest cause is not named; "" where it is."""
        return self.record.which.reason

    @property
    def probability(self) -> dict[str, float]:
        """Of each explanation, effects that look alike taken together."""
        return self.record.which.probability_by_class

    def words(self) -> Iterator[RenderableType]:
        yield from report.said(self.record)

    @property
    def drawn(self) -> tuple[DiagnosisRecord, Callable[[str], str]]:
        """The record, and names of explanations in words."""
        return self.record, title


@verb
def diagnose(
    lab: options.LabWithCurves,
    *,
    library: options.LibraryFile = None,
    discrepancy: options.DiscrepancyFile = None,
    simulate: options.InfillPackings = 0,
    batch: options.Batch = None,
    further: options.FurtherLabs = (),
    seed: options.StatisticsSeed = 0,
    out: options.Folder = "results/diagnose",
) -> DiagnosisResult:
    """Says where model and curves differ, which effect is left out, how far the gap shrinks.

    A library of simulations answers, so that nothing is simulated unless `simulate` asks for it.

    Args:
        lab: a lab file's path, or what `load_lab` returned: curves of both tests.
        library: file of a library of runs; None: the bundled one.
        discrepancy: what `calibrate discrepancy` wrote; None: the model is taken as it is.
        simulate: number of packings on which the leading explanations are simulated as well.
        batch: specimens to simulate at once on an accelerator; None: on processor cores.
        further: lab files of further tests on the same soil.
        seed: of simulated statistics.
        out: folder for results.

    Returns:
        Verdict, probabilities, places, what to test next; result.json, diagnosis.html and figures
        in `out`.

    Raises:
        InputError: the lab has other tests than the library, or an argument is wrong.

    Example:
        >>> found = calibrate.diagnose("my_soil.toml")
        >>> found.verdict, found.probability
    """
    folder = Path(out)
    session = Session.open(lab, "quick", folder, batch=batch)
    found, used = found_by_library(session, further, simulate, library, discrepancy, seed)
    origin = {**origin_of(session), "preset": NO_PRESET, "settings": used}
    plain_data = content(found, origin)
    report.write(folder, plain_data)
    return DiagnosisResult(folder, plain_data)


def found_by_library(
    session: Session, further: str | Path | Sequence[str | Path], simulate: int,
    library: str | Path | None, discrepancy: str | Path | None, seed: int,
) -> tuple[Diagnosis, dict[str, str | int]]:  # fmt: skip
    """The diagnosis of a session's lab, and which library answered."""
    session.lab.pair()  # refuses other tests than those of a library
    source = bundled_library() if library is None else Path(library)
    simulated, say = load(source), for_terminal().say
    say(f"library of {len(simulated.rows.values)} runs: preparing its emulator")
    emulated = EmulatedLibrary.of(simulated)
    estimated = None if discrepancy is None else load_discrepancy(Path(discrepancy), emulated)
    if simulate:
        plan = InfillPlan(simulate, session.out / RUNS, for_terminal(), session.place)
        emulated = with_infill_runs(session.lab, emulated, seed, plan, estimated, say)
    paths = [further] if isinstance(further, str | Path) else further
    labs = [load_lab(path) for path in paths]
    found = diagnosed(session.lab, emulated, seed, discrepancy=estimated, say=say, further=labs)
    return found, library_used(source.name, simulated, emulated.library, seed)


def library_used(
    name: str, library: RunLibrary, used: RunLibrary, seed: int
) -> dict[str, str | int]:
    """Which library answers, how many simulations it holds, and how many infill runs were added for
    this lab."""
    return {
        "library": name,
        "seed": seed,
        "simulations": len(library.rows.values),
        "simulated_about_this_lab": len(used.rows.values) - len(library.rows.values),
        "packings": len(set(library.rows.packing.tolist())),
    }
