"""What to measure next: a table for the terminal, and a lab file for the answer."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import RenderableType
from rich.table import Table as Terminal
from rich.text import Text

from calibrate.core.files import write_json, write_text
from calibrate.discrepancy.comparison.naming import BEYOND, FEW, FEWEST, MUTE
from calibrate.discrepancy.comparison.next_test import BEFORE_TESTS, Proposal, why_stop
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.verdict import proposed
from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.discrepancy.library.further_tests import ANSWER, answer_file
from calibrate.records.diagnosis import DiagnosisRecord
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


def content(diagnosis: Diagnosis) -> dict:
    """Verdict, probabilities and all further tests as plain data."""
    comparison = diagnosis.comparison
    stop = why_stop(comparison, diagnosis.proposals)
    return {
        "verdict": comparison.verdict, "reason": comparison.reason, "stop": stop,
        "probability_by_class": comparison.by_class,
        "tests": [proposed(proposal, stop) for proposal in diagnosis.proposals],
    }  # fmt: skip


def write(out: Path, diagnosis: Diagnosis, found: dict) -> None:
    """next.json and a lab file for the answer."""
    write_json(out / "next.json", found)
    if diagnosis.proposals:
        write_text(out / ANSWER, answer_file(diagnosis.lab, diagnosis.proposals[0]))


def said(
    out: Path, diagnosis: Diagnosis, found: dict, whole: DiagnosisRecord
) -> Iterator[RenderableType]:
    """What the diagnosis says, and the table of further tests."""
    yield Text(" ".join(filter(None, (verdict(whole), beginnings(whole)))))
    if found["reason"] not in BEFORE_TESTS:
        yield _leading(found["probability_by_class"])
    if diagnosis.proposals:
        yield _table(diagnosis.proposals)
        yield Text(LEGEND)
        if not found["stop"]:
            more = "Next: more specimens, or" if found["verdict"] == NONE else "Next:"
            best = diagnosis.proposals[0].name
            yield Text(f"{more} {best}. Record it as {out / ANSWER} shows.")
    if found["stop"]:
        yield Text(WHY[found["stop"]])


def _leading(by_class: Mapping[str, float]) -> Text:
    order = sorted(by_class, key=lambda name: -by_class[name])
    shown = [f"{title(name)} {percent(by_class[name])}" for name in order[:4]]
    return Text("So far: " + ", ".join(shown) + ".")


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
