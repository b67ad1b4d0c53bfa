"""Say what to measure next: what each test would tell, what it costs, what it would show."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.console import RenderableType

from calibrate.core.errors import COMMAND_LINE, InputError
from calibrate.core.files import write_json
from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.io.lab import Lab
from calibrate.records.base import record
from calibrate.records.diagnosis import DiagnosisRecord, NextTestRecord
from calibrate.records.diagnosis import content as diagnosis_content
from calibrate.reports import next_test as report
from calibrate.reports.effects import title
from calibrate.simulation.session import Session, made_by
from calibrate.verbs import options
from calibrate.verbs.base import AbstractDrawnResult, AbstractResult, line, verb
from calibrate.verbs.diagnose import NO_PRESET, found_by_library

if TYPE_CHECKING:
    from calibrate.inference.curve_points import CurvePoints
    from calibrate.inference.draws import SoilDraws
    from calibrate.inference.on_response import OnResponse
    from calibrate.io.lab import LabLike

READ = {"numbers": "their numbers", "curves": "whole curves"}
HARDLY = 0.9  # of a standard deviation: what a test that leaves more hardly tells
DRAWS = 200  # soils of a posterior that further tests are asked of


@dataclass(frozen=True, eq=False, repr=False)
class NextTestResult(AbstractDrawnResult):
    """Further tests in the order of what they would tell.

    Attributes:
        diagnosis: what they are to narrow down.
        folder: where next.json, a lab file for the answer and a figure are.
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


@dataclass(frozen=True, eq=False, repr=False)
class NarrowingResult(AbstractResult):
    """Further tests in the order of how far they would narrow what a posterior leaves open.

    Attributes:
        lab: the laboratory.
        folder: where narrowing.json is.
    """

    files = ("narrowing.json",)
    lab: Lab
    folder: Path
    content: dict

    @property
    def tests(self) -> list[dict]:
        """All tests that the library knows, the one that narrows most first; `left` is the share
        of each standard deviation that a test leaves, on average over what it may show."""
        return self.content["tests"]

    def words(self) -> Iterator[RenderableType]:
        yield line(
            "what further tests would leave of today's standard deviations, on average over what "
            f"they may show ({self.content['soils']} soils of the posterior):"
        )
        for test in self.tests:
            known = sorted(test["left"].items(), key=lambda each: each[1])
            said = [f"{100 * share:.0f} % of {name}" for name, share in known if share < HARDLY]
            rest = f"at least {100 * HARDLY:.0f} % of " + ("the others" if said else "everything")
            count = "one specimen" if test["specimens"] == 1 else f"{test['specimens']} specimens"
            yield line(
                f"- {test['name']}, {READ[test['read']]}, {count}: " + "; ".join([*said, rest])
            )
        for name, why in self.content["not_known"].items():
            yield line(f"the library of runs does not know what {name} would show: {why}")


@verb
def next_test(
    lab: options.LabWithCurves,
    *,
    posterior: Annotated[
        str | Path | None,
        typer.Option("--posterior", help="Folder of calibrate posterior: what narrows it?"),
        options.Typed(Path | None),
    ] = None,
    prediction: Annotated[
        "LabLike",
        typer.Option("--prediction", metavar="LAB.toml", help="Tests whose prediction counts."),
        options.Typed(Path | None),
    ] = None,
    library: options.LibraryFile = None,
    discrepancy: options.DiscrepancyFile = None,
    simulate: options.InfillPackings = 0,
    further: options.FurtherLabs = (),
    seed: options.StatisticsSeed = 0,
    out: options.Folder = "results/next",
) -> NextTestResult | NarrowingResult:
    """Says what to measure next: what each test would tell, what it costs, what it would show.

    Args:
        lab: a lab file's path, or what `load_lab` returned: curves of both tests, unless a
            posterior is given.
        posterior: a folder of `posterior`; the tests are then weighed by how far they would narrow
            its parameters, and not by what they would tell of a gap.
        prediction: a lab file; its tests' numbers stand beside the parameters.
        library: file of a library of runs; None: the bundled one.
        discrepancy: what `calibrate discrepancy` wrote; None: the model is taken as it is.
        simulate: number of packings on which the leading explanations are simulated first.
        further: lab files of further tests that were made already.
        seed: of simulated statistics.
        out: folder for results.

    Returns:
        Tests with gain, cost and chance; next.json, a lab file for the answer and a figure in
        `out`.  With a posterior: what each test would leave open, in narrowing.json.

    Raises:
        InputError: the lab has other tests than the library, or an argument is wrong.

    Example:
        >>> found = calibrate.next_test("my_soil.toml")
        >>> [test["name"] for test in found.tests]
    """
    folder = Path(out)
    other = {"--simulate": simulate, "--further": further, "--library": library,
             "--discrepancy": discrepancy}  # fmt: skip
    if posterior is not None and any(other.values()):
        given = next(name for name, value in other.items() if value)
        raise InputError(COMMAND_LINE, given, "--posterior asks the bundled library alone",
                         "leave one of them out")  # fmt: skip
    if posterior is None and prediction is not None:
        problem = "only a posterior's tests are weighed by a prediction"
        raise InputError(COMMAND_LINE, "--prediction", problem, "give --posterior too")
    if posterior is not None:
        return _narrowing(lab, posterior, prediction, folder)
    session = Session.open(lab, "quick", folder)
    found, used = found_by_library(session, further, simulate, library, discrepancy, seed)
    origin = {"soil": session.lab.name, "preset": NO_PRESET, **made_by(), "settings": used}
    plain_data = report.content(found)
    report.write(folder, found, plain_data)
    proposed = NextTestResult(found, folder, plain_data, origin)
    proposed.save_figures()
    return proposed


def _narrowing(
    lab: "LabLike", posterior: str | Path, prediction: "LabLike", folder: Path
) -> NarrowingResult:
    """What further tests would leave of what a posterior leaves open."""
    # numpyro and Optimistix take a second, which weighing tests by a gap does without
    from calibrate.inference.draws import read_draws
    from calibrate.inference.narrowing import REPEATS, Told, left, menu, relative_scatter, row
    from calibrate.inference.prediction import shown

    known = read_draws(posterior)
    session = Session.open(lab, str(known.tree.attrs["preset"]), folder)
    step = max(1, len(known.values) // DRAWS)
    numbers = range(0, len(known.values), step)
    quantities = {n: np.log(known.values[::step, k]) for k, n in enumerate(known.names)}
    if prediction is not None:
        wanted = Session.open(prediction, session.preset.name, folder)
        asked, points, why = _asked(wanted, known)
        if asked is None:
            raise InputError(wanted.lab.file, "", f"the library does not predict it: {why}",
                             "leave --prediction out")  # fmt: skip
        base = known.base_in(wanted.lab)
        soils = [known.in_soil(base, n) for n in numbers]
        values = np.array([shown(asked.campaign.beds, points, soil) for soil in soils])
        quantities |= {f"predicted {n}": values[:, k] for k, n in enumerate(points.observables)}
    scatter, tests, unknown = relative_scatter(session.lab), [], {}
    columns = np.column_stack(list(quantities.values()))
    for test in menu(session.lab):
        there = Session.open(test.lab, session.preset.name, folder)
        response, points, why = _asked(there, known)
        if response is None:
            unknown[test.name] = why
            continue
        base = known.base_in(there.lab)
        soils = [known.in_soil(base, n) for n in numbers]
        told = Told.by(response, soils, points, test.read, scatter)
        tests += [row(test, n, list(quantities), left(columns, told, n)) for n in REPEATS]
    tests.sort(key=lambda each: np.mean(np.log([max(s, 1e-3) for s in each["left"].values()])))
    content = {
        "soil": session.lab.name, "preset": session.preset.name, **made_by(),
        "posterior": str(posterior), "soils": len(numbers), "quantities": list(quantities),
        "tests": tests, "not_known": unknown,
    }  # fmt: skip
    write_json(folder / "narrowing.json", content)
    return NarrowingResult(session.lab, folder, content)


def _asked(session: Session, known: "SoilDraws") -> "tuple[OnResponse | None, CurvePoints, str]":
    """The library in the place of a session's tests, what they show, and why there is none."""
    from calibrate.discrepancy.library.stand_in import served
    from calibrate.inference.curve_points import CurvePoints

    work = session.on_soil().campaign(session.out)
    base = known.base_in(session.lab)
    response, why = served(session.lab, session.preset, known.names, base, work)
    return response, CurvePoints.of(work), why
