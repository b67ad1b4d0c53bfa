"""What to measure next: a table for the terminal, a picture, and a lab file for the answer."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table as Terminal

from calibrate.core.files import write_json, write_text
from calibrate.discrepancy.comparison.naming import BEYOND, FEW, FEWEST, MUTE
from calibrate.discrepancy.comparison.next_test import BEFORE_TESTS, Proposal, why_stop
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.verdict import proposed
from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.discrepancy.library.further_tests import ANSWER, answer_file
from calibrate.figures import diagnosis as plots
from calibrate.figures.style import svg
from calibrate.records.base import record
from calibrate.records.diagnosis import DiagnosisRecord, NextTestRecord, content
from calibrate.reports.diagnosis_words import ENOUGH, beginnings, percent, verdict
from calibrate.reports.effects import title
from calibrate.reports.html import number

WHY = {
    "sure": "Nothing more need be measured: this is as good as certain.",
    UNKNOWN: "Next: look at the places where the gap shows for what acts there; no test on the "
    "list names what the library does not hold.",
    "nothing helps": "No test on the list would tell more than these data do.",
    MUTE: "Next: record force and displacement of both tests, on at least three specimens each.",
    FEW: f"Next: record at least {FEWEST} specimens of each test, and ask again.",
    BEYOND: f"Next: add runs there, and ask again: calibrate next LAB.toml --simulate {ENOUGH}.",
    "": "",
}
LEAST_NATS = 0.005
LEGEND = (
    "Hours of a technician and fresh specimens are a guess; nats say how far the outcome is "
    "expected to narrow down the explanations; chance: that the right one is then the first."
)


def write(
    out: Path, diagnosis: Diagnosis, origin: dict, path: Path | None, console: Console
) -> None:
    """next.json (and `--json`), figures/next_test.svg and a lab file for the answer; what the
    diagnosis says, and the table."""
    comparison = diagnosis.comparison
    stop = why_stop(comparison, diagnosis.proposals)
    found = {
        "verdict": comparison.verdict, "reason": comparison.reason, "stop": stop,
        "probability_by_class": comparison.by_class,
        "tests": [proposed(proposal, stop) for proposal in diagnosis.proposals],
    }  # fmt: skip
    for place in (out / "next.json", path):
        if place is not None:
            write_json(place, found)
    said = record(DiagnosisRecord, content(diagnosis, origin))
    words = " ".join(filter(None, (verdict(said), beginnings(said))))
    console.print(words, markup=False, highlight=False)
    if comparison.reason not in BEFORE_TESTS:
        _leading(comparison.by_class, console)
    if diagnosis.proposals:
        best = diagnosis.proposals[0]
        write_text(out / ANSWER, answer_file(diagnosis.lab, best))
        write_text(out / "figures" / "next_test.svg", _picture(best, stop))
        console.print(_table(diagnosis.proposals))
        console.print(LEGEND)
        if not stop:
            more = "Next: more specimens, or" if comparison.verdict == NONE else "Next:"
            console.print(f"{more} {best.name}. Record it as {out / ANSWER} shows.")
    if stop:
        console.print(WHY[stop])


def _leading(by_class: Mapping[str, float], console: Console) -> None:
    order = sorted(by_class, key=lambda name: -by_class[name])
    shown = [f"{title(name)} {percent(by_class[name])}" for name in order[:4]]
    console.print("So far: " + ", ".join(shown) + ".")


def _table(proposals: Sequence[Proposal]) -> Terminal:
    table = Terminal("further test", "hours", "fresh", "nats", "chance")
    for one in proposals:
        table.add_row(
            one.name, number(one.cost, 2), str(one.specimens), nats(one.gain),
            percent(one.chance),
        )  # fmt: skip
    table.add_row("these data alone", "", "", "", percent(proposals[0].chance_now))
    return table


def nats(gain: float) -> str:
    """A gain; what is only rounding counts as none."""
    return number(gain, 2) if gain >= LEAST_NATS else "0"


def _picture(proposal: Proposal, stop: str) -> str:
    found = record(NextTestRecord, {**proposed(proposal, stop), "all": []})
    units = {label: "mm" if _is_length(label) else "N" for label in proposal.labels}
    return svg(plots.next_figure(found, units, title))


def _is_length(label: str) -> bool:
    return label.endswith(", mm") or label.startswith(("displacement", "travel"))
