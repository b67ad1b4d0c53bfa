"""The report of a diagnosis: result.json, figures, a page, and a short summary on the terminal.

The page opens with one paragraph, one figure and one table; all that they rest on stands below.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import RenderableType
from rich.table import Table as Terminal
from rich.text import Text

from calibrate.core.files import write_json, write_text
from calibrate.discrepancy.comparison.next_test import BEFORE_TESTS
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.figures.diagnosis import unit_of
from calibrate.labtests.diagnosis.curves import TESTS
from calibrate.records.base import read, record
from calibrate.records.diagnosis import (
    CrossTestRow,
    DiagnosisRecord,
    ExplanationRow,
    SegmentRow,
)
from calibrate.reports.diagnosis_words import amount, label_of, percent, sentence
from calibrate.reports.effects import members, plain, strength, title
from calibrate.reports.html import Page, Picture, Table, number, pictures_of, render, words

PAGE = "diagnosis.html"
SHOWN = (*(f"where_{test}" for test in TESTS), "probability", "effects", "next_test")  # own places
FIRST = 4  # explanations of the first table, besides none and unknown
STATUS = {
    "found": "● goes with the gap",
    "trivial": "◐ goes with it, but small",
    "absent": "○ absent: it would have shown",
    "inconclusive": "? could not have shown",
}


def write(out: Path, plain_data: dict) -> None:
    """result.json, figures/ and the page, in a folder that exists."""
    write_json(out / "result.json", plain_data)
    found = record(DiagnosisRecord, plain_data)
    pictures = _pictures(found)
    for name, picture in pictures.items():
        write_text(out / "figures" / f"{name}.svg", picture.svg)
    write_text(out / PAGE, _page(found, pictures).html)


def page(path: Path) -> Page:
    """The report of the result.json at `path`; `InputError` where it cannot be read."""
    return of(read(path, DiagnosisRecord))


def of(found: DiagnosisRecord) -> Page:
    """The report of a diagnosis that has been read."""
    return _page(found, _pictures(found))


def _page(found: DiagnosisRecord, pictures: dict[str, Picture]) -> Page:
    shown = {
        "sentence": sentence(found),
        "first": [
            pictures[name] for name in SHOWN if name.startswith("where") and name in pictures
        ],
        "answer": _answer(found),
        "likely": pictures["probability"],
        "each": pictures["effects"],
        "further": [pictures[name] for name in pictures if name not in SHOWN],
        "next": pictures.get("next_test"),
        "predicted": _predicted(found),
        "segments": _segments(found),
        "effects": _effects(found),
        "alike": _alike(found),
        "far": _far(found),
        "offers": _offers(found),
        "across": _across(found),
        "moved": _moved(found),
        "settings": _settings(found),
    }
    return Page(shown["sentence"], render(PAGE, found=found, **shown))


def said(found: DiagnosisRecord) -> Iterator[RenderableType]:
    """The paragraph and, where a cause could be named, the likeliest explanations."""
    yield Text(sentence(found))
    if found.which.reason in BEFORE_TESTS:
        return
    columns = ("explanation", "probability", "strength if so")
    table = Terminal(*columns, box=None, pad_edge=False)
    for each in _leading(found):
        table.add_row(title(each.label), percent(each.probability), _if_so(each))
    yield table


# ---------------------------------------------------------------- figures


def _pictures(found: DiagnosisRecord) -> dict[str, Picture]:
    """All figures by the name of their file."""
    captions = {f"where_{test}": _of_test(test) for test in TESTS}
    captions["probability"] = (
        "Probabilities of explanations as bars",
        "How likely each explanation is. The set is to hold the right one in 90 of 100 cases.",
    )
    captions["effects"] = (
        "Strength of each effect over its error",
        "Each effect by itself, added to the calibrated model alone: estimated strength over its "
        "standard error.",
    )
    if found.next_test is not None:
        captions["next_test"] = (
            "Predicted outcome of the proposed test",
            f"{found.next_test.name.capitalize()}: what it would show under each of the leading "
            "explanations, at the places that tell them apart best. Bars: deviation of the mean of "
            "two repeats.",
        )
    return pictures_of("diagnose", found, title, captions=captions)


def _of_test(test: str) -> tuple[str, str]:
    return (
        f"{label_of(test)} and its residuals",
        f"{label_of(test).capitalize()}. Top: measured repeats, the calibrated model, the model "
        "with the best explanation. Bottom: what is left, place by place; shaded parts leave the "
        "band that scatter fills in 95 of 100 laboratories.",
    )


# ---------------------------------------------------------------- tables


def _leading(found: DiagnosisRecord) -> list[ExplanationRow]:
    """The likeliest explanations, none and unknown always among them."""
    every = found.explanations
    first = [e for e in every if e.label not in (NONE, UNKNOWN)][:FIRST]
    return [e for e in every if e in first or e.label in (NONE, UNKNOWN)]


def _answer(found: DiagnosisRecord) -> Table:
    rows = [
        [
            title(e.label) + (" ◀ verdict" if found.names(e.label) else ""),
            percent(e.probability),
            _if_so(e),
            " ".join(plain(name).sentence for group in members(e.label) for name in group),
        ]
        for e in _leading(found)
    ]
    return Table(["explanation", "probability", "strength if so", "what it means"], rows, text=True)


def _if_so(explanation: ExplanationRow) -> str:
    """Fitted strengths of an explanation's best member, named where that is not plain."""
    several = len([n for group in members(explanation.label) for n in group]) > 1
    return "; ".join(
        (f"{plain(name).name} " if several else "") + strength(name, value)
        for name, value in explanation.strengths.items()
    )


def _segments(found: DiagnosisRecord) -> Table:
    rows = [
        [
            f"{label_of(s.test)}, {s.segment}",
            amount(s.gap, s.unit),
            number(s.z, 2),
            "● outside" if s.outside_band else "inside",
            _share(s),
            percent(s.share_by_chance),
        ]
        for s in found.where
    ]
    columns = ["segment", "measured − model", "in standard errors", "95 % band",
               "share of the misfit (90 %)", "by chance"]  # fmt: skip
    return Table(columns, rows)


def _share(segment: SegmentRow) -> str:
    if segment.share_interval is None:
        return percent(segment.share)
    low, high = (percent(end) for end in segment.share_interval)
    return f"{percent(segment.share)} ({low} to {high})"


def _effects(found: DiagnosisRecord) -> Table:
    rows = [
        [
            plain(e.name).name,
            STATUS[e.status],
            number(e.z, 2),
            strength(e.name, e.strength, e.standard_error),
            percent(e.visibility),
            e.name,
        ]
        for e in found.which.effects
    ]
    columns = ["effect", "status", "score", "strength by itself", "left after calibration", "name"]
    return Table(columns, rows, text=True)


def _alike(found: DiagnosisRecord) -> list[str]:
    """Sentences on what these data cannot tell apart, or see."""
    lines = [
        ", ".join(plain(name).name for name in group)
        + ": alike in what calibration leaves of them."
        for group in found.which.alike
    ]
    lines += [
        f"{plain(name).name}: calibration imitates it almost wholly, so these data cannot show it."
        for name in found.which.absorbed_by_calibration
    ]
    return lines or ["None: every two effects differ enough at a signal-to-noise of 6."]


def _far(found: DiagnosisRecord) -> Table | None:
    far = found.how_far
    if far is None:
        return None
    ends = "" if far.interval is None else " ({} to {})".format(*map(percent, far.interval))
    rows = [
        ["model's distance from a fresh specimen, before", f"{number(far.before, 3)} scatters"],
        ["after", f"{number(far.after, 3)} scatters"],
        ["floor: the mean of all specimens", f"{number(far.floor, 3)} scatter"],
        ["share of the gap removed", f"{percent(far.shrinkage)}{ends}"],
        ["on specimens left out of the fit", percent(far.shrinkage_left_out)],
        *(
            [f"ceiling: any change of the {name}", percent(value)]
            for name, value in far.ceiling.items()
        ),
    ]
    return Table(["", " and ".join(plain(name).name for name in found.best)], rows)


def _offers(found: DiagnosisRecord) -> Table | None:
    test = found.next_test
    if test is None:
        return None
    rows = [
        [
            o.name, f"{number(o.cost, 2)} h", str(o.specimens), number(o.gain_nats, 2),
            percent(o.chance), number(o.separation, 2),
        ]
        for o in test.all
    ]  # fmt: skip
    now = number(test.separation_now, 2)
    rows.append(["these data alone", "", "", "", percent(test.chance_now), now])
    columns = ["further test", "time, a guess", "fresh specimens", "tells (nats)",
               "chance to name the cause", "separation (2.8 settles)"]  # fmt: skip
    return Table(columns, rows)


def _predicted(found: DiagnosisRecord) -> Table | None:
    """What the proposed test would show under each leading explanation."""
    test = found.next_test
    if test is None:
        return None
    rows = [
        [
            label.removesuffix(", mm").removesuffix(", N"),
            *(f"{number(values[i], 3)} {unit_of(label)}" for values in test.predicted.values()),
            f"{number(test.deviation[i], 2)} {unit_of(label)}",
        ]
        for i, label in enumerate(test.labels)
    ]
    columns = [test.name, *map(title, test.predicted), "deviation, two repeats"]
    return Table(columns, rows)


def _across(found: DiagnosisRecord) -> Table | None:
    if not found.across_tests:
        return None
    rows = [
        [
            f"{label_of(a.predicted)} from the {_others(a.predicted)}",
            f"{number(a.factor, 3)} ± {number(a.factor_se, 2)}{_no_factor(a)}",
            percent(a.p_value),
        ]
        for a in found.across_tests
    ]
    return Table(["predicted", "measured over predicted", "chance of such a misfit"], rows)


def _no_factor(row: CrossTestRow) -> str:
    """A word on a factor that is none."""
    if row.factor < 0:
        return ": no factor, the measured curve does not run as the predicted one"
    if row.factor < 2 * row.factor_se:
        return ": not told from none"
    return ""


def _others(test: str) -> str:
    """The tests but one, in words."""
    return " and the ".join(label_of(other) for other in TESTS if other != test)


def _moved(found: DiagnosisRecord) -> Table:
    order = sorted(found.base_parameters, key=lambda p: -abs(p.moved))
    rows = [[words(p.name), number(p.moved, 2), number(p.prior_sd, 2)] for p in order]
    return Table(["base parameter", "moved, prior deviations", "prior deviation of ln p"], rows)


def _settings(found: DiagnosisRecord) -> dict[str, str]:
    used, repeats = found.settings, []
    for test in TESTS:
        repeats.append(f"{used.repeats.get(test, 0)} of the {label_of(test)}")
    scatter = [f"{number(a, 3)} ({label_of(test)})" for test, a in found.amplitudes.items()]
    return {
        "specimens": _listed(repeats),
        "library of runs": f"{used.library}: {used.simulations} runs of {used.packings} packings",
        "seed": str(used.seed),
        "scatter of repeats over that of simulated specimens": _listed(scatter),
        "chance of such a misfit without a gap": percent(found.which.p_gap),
        "the same after the best explanation": percent(found.which.p_left_after_best),
    }


def _listed(parts: Sequence[str]) -> str:
    return ", ".join(parts) or "–"
