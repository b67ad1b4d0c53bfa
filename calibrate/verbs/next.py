"""Say what to measure next: what each test would tell, what it costs, what it would show."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rich.console import RenderableType

from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.records.base import record
from calibrate.records.diagnosis import DiagnosisRecord, NextTestRecord
from calibrate.records.diagnosis import content as diagnosis_content
from calibrate.reports import next_test as report
from calibrate.reports.effects import title
from calibrate.simulation.session import Session, made_by
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, verb
from calibrate.verbs.diagnose import NO_PRESET, found_by_library


@dataclass(frozen=True, eq=False, repr=False)
class NextTestResult(AbstractDrawnResult):
    """Further tests in the order of what they would tell.

    Attributes:
        diagnosis: what they are to narrow down.
        folder: where next.json, a lab file for the answer and a figure are.
        content: everything, with the keys of next.json.
        origin: what made it.
    """

    verb = "next"
    files, pictures = ("next.json",), "figures/{}.svg"
    diagnosis: Diagnosis
    folder: Path
    content: dict
    origin: dict

    @cached_property
    def record(self) -> DiagnosisRecord:
        """The diagnosis with typed entries."""
        return record(DiagnosisRecord, diagnosis_content(self.diagnosis, self.origin))

    @property
    def tests(self) -> list[dict]:
        """All tests that could be made, the one that tells most first."""
        return self.content["tests"]

    @property
    def stop(self) -> str:
        """Why nothing more need be measured; "" where something does."""
        return self.content["stop"]

    def words(self) -> Iterator[RenderableType]:
        yield from report.said(self.folder, self.diagnosis, self.content, self.record)

    @property
    def drawn(self) -> tuple[NextTestRecord | None, Callable[[str], str]]:
        """The best test, if one is proposed, and names of explanations in words."""
        best = [record(NextTestRecord, {**test, "all": []}) for test in self.tests[:1]]
        return (best[0] if best else None), title


@verb
def next_test(
    lab: options.LabWithCurves,
    *,
    library: options.LibraryFile = None,
    discrepancy: options.DiscrepancyFile = None,
    simulate: options.InfillPackings = 0,
    further: options.FurtherLabs = (),
    seed: options.StatisticsSeed = 0,
    out: options.Folder = "results/next",
) -> NextTestResult:
    """Says what to measure next: what each test would tell, what it costs, what it would show.

    Args:
        lab: a lab file's path, or what `load_lab` returned: curves of both tests.
        library: file of a library of runs; None: the bundled one.
        discrepancy: what `calibrate discrepancy` wrote; None: the model is taken as it is.
        simulate: number of packings on which the leading explanations are simulated first.
        further: lab files of further tests that were made already.
        seed: of simulated statistics.
        out: folder for results.

    Returns:
        Tests with gain, cost and chance; next.json, a lab file for the answer and a figure in
        `out`.

    Raises:
        InputError: the lab has other tests than the library, or an argument is wrong.

    Example:
        >>> found = calibrate.next_test("my_soil.toml")
        >>> [test["name"] for test in found.tests]
    """
    folder = Path(out)
    session = Session.open(lab, "quick", folder)
    found, used = found_by_library(session, further, simulate, library, discrepancy, seed)
    origin = {"soil": session.lab.name, "preset": NO_PRESET, **made_by(), "settings": used}
    plain_data = report.content(found)
    report.write(folder, found, plain_data)
    proposed = NextTestResult(found, folder, plain_data, origin)
    proposed.save_figures()
    return proposed
