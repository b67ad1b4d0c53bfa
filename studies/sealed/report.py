"""Withheld cases as an HTML page, as JSON, as Markdown, and as tables on the terminal.

The first sentence says how often the right class was named, how often something was named where
nothing was hidden, and what became of effects that the library does not have; then every number
stands beside what was asked of it, missed or met.

    python -m studies.sealed.report FILE --out FOLDER      the page of a withheld.json, made again
"""

import argparse
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from calibrate.core.files import write_json, write_text
from calibrate.records.base import read, record
from calibrate.reports import kinds
from calibrate.reports.html import Page, Picture, render
from studies.sealed import figures as drawn
from studies.sealed import words
from studies.sealed.confusion import confusion_matrix
from studies.sealed.criteria import RIVALS, Standing, criteria, other_code
from studies.sealed.record import WithheldRecord
from studies.sealed.scores import CLOSE, Row, share
from studies.sealed.words import markdown

__all__ = ["markdown", "page", "show", "write"]
PAGE = "withheld.html"
TEMPLATE = Path(__file__).with_name(PAGE)
TITLE = "Withheld cases: what the diagnosis found"
EDGES = (0.5, 1.0, 2.0, 4.0, 6.0, 9.0, 15.0)  # of signal-to-noise, for the figure


def write(out: Path, result: dict, json: Path | None) -> None:
    """withheld.json (and `json`), withheld.md, figures/ and the page, in a folder that exists."""
    write_json(out / "withheld.json", result)
    if json is not None:
        write_json(json, result)
    found = record(WithheldRecord, result)
    pictures = _pictures(found.plain(), found.rows)
    for name, picture in pictures.items():
        write_text(out / "figures" / f"{name}.svg", picture.svg)
    write_text(out / "withheld.md", markdown(result, TITLE))
    write_text(out / PAGE, _page(found, pictures).html)


def page(path: Path) -> Page:
    """The report of the withheld.json at `path`; `InputError` where it cannot be read."""
    found = read(path, WithheldRecord)
    return _page(found, _pictures(found.plain(), found.rows))


def _page(found: WithheldRecord, pictures: Mapping[str, Picture]) -> Page:
    result = found.plain()
    html = render(
        TEMPLATE,
        title=TITLE,
        result=result,
        rows=found.rows,
        pictures=pictures,
        criteria=criteria(result),
        missed=Standing.MISSED,
        RIVALS=RIVALS,
        other=other_code(result),
        words=words,
    )
    return Page(words.sentence(result), html)


def show(result: dict, console: Console) -> None:
    """The sentence, then every criterion, on the terminal."""
    console.print(words.sentence(result), markup=False, highlight=False)
    table = Table(title="asked and found", title_justify="left", box=None, pad_edge=False)
    table.add_column("")
    for column in ("asked", "found", "95 %", "of", ""):
        table.add_column(column, no_wrap=True)
    for criterion in criteria(result):
        cells = [words.asked(criterion), words.found(criterion), words.interval(criterion)]
        mark = words.MARKS[criterion.standing]
        table.add_row(criterion.words, *cells, words.of_cases(criterion), mark)
    console.print(table)
    console.print(words.standing_sentence(result), markup=False, highlight=False)


# ---------------------------------------------------------------- pictures


def _pictures(result: dict, rows: Sequence[Row]) -> dict[str, Picture]:
    """All figures by name; those without cases are left out."""
    found = {}
    if any(row.kind == "single" and row.snr > 0 for row in rows):
        found["accuracy"] = _accuracy(rows)
    if rows:
        found["named"] = Picture(
            drawn.named_svg(confusion_matrix(result, rows)),
            "table of what was named for what was hidden; right answers are framed",
            "What was named (columns) for what was hidden (rows; number of cases). Grey: share of "
            "the row. Framed: right. A right class counts at the hidden effect, a wrong class of "
            "several alike effects at its first member.",
        )
        found["reliability"] = Picture(
            drawn.reliability_svg(result["calibration_error"]["bins"]),
            "share that was right over the probability stated, with counts",
            "Probabilities stated for the verdict, and how often it was right; below, how many "
            "cases stand behind each point.",
        )
    if result["false_alarm"]["n"]:
        found["false_alarms"] = _alarms(result)
    claims = [row for row in rows if row.claimed is not None and row.realised is not None]
    if claims:
        found["shrinkage"] = _shrinkage(claims)
    return found


def _accuracy(rows: Sequence[Row]) -> Picture:
    single = [row for row in rows if row.kind == "single"]
    inside = [[r for r in single if a <= r.snr < b] for a, b in pairwise(EDGES)]
    series = {drawn.OURS: [share(r.verdict == r.truth for r in cases) for cases in inside]}
    for name in RIVALS:
        series[name] = [share(r.rivals.get(name) == r.truth for r in cases) for cases in inside]
    centres = [float(np.sqrt(a * b)) for a, b in pairwise(EDGES)]
    counts = ", ".join(str(len(cases)) for cases in inside)
    return Picture(
        drawn.accuracy_svg(centres, series),
        "share of right classes over signal-to-noise, ours and rivals",
        "Single effects: how often the right class is named, from weak to strong "
        f"({counts} cases). Bars: 95 % Clopper-Pearson.",
    )


def _alarms(result: dict) -> Picture:
    shares = {drawn.OURS: result["false_alarm"]}
    shares |= {name: result["rivals"][name]["false_alarm"] for name in RIVALS}
    bound = 0.10 if other_code(result) else 0.05
    return Picture(
        drawn.alarms_svg(shares, bound),
        "false alarms of this diagnosis and its rivals",
        "How often something is named although nothing is hidden.",
    )


def _shrinkage(claims: Sequence[Row]) -> Picture:
    claimed = [row.claimed or 0.0 for row in claims]
    realised = [row.realised or 0.0 for row in claims]
    errors = [row.realised_error or 0.0 for row in claims]
    return Picture(
        drawn.shrinkage_svg(claimed, realised, errors, CLOSE),
        "claimed against realised shrinkage of the gap",
        "How much of the gap goes with the named effect: claimed, and on fresh specimens of "
        f"the same soil ({len(claims)} cases; bars: standard errors of the latter).",
    )


KIND = kinds.Kind("withheld", "withheld.json", frozenset({"unknown_recall", "rows"}), page)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="a withheld.json")
    parser.add_argument("--out", type=Path, default=Path("results/withheld"))
    given = parser.parse_args()
    made = kinds.page_of(KIND, given.file)
    write_text(given.out / PAGE, made.html)
    print(made.sentence)


if __name__ == "__main__":
    main()
