"""The report of an audit of gradients."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt

from calibrate.figures import audit as drawing
from calibrate.figures.style import panel_svg, svg
from calibrate.records.audit import AuditRecord, Slope, StrategyRecord
from calibrate.records.base import TESTS, Observable, read
from calibrate.reports.html import Page, Picture, Table, number, quantity, render, words

NAMES: dict[Observable, str] = {
    "depression_depth_mm": "depression depth",
    "crushing_force_n": "crushing force",
}
UNITS: dict[Observable, str] = {"depression_depth_mm": "mm", "crushing_force_n": "N"}


@dataclass(frozen=True)
class Strategy:
    """One strategy as the page shows it."""

    name: str
    sentence: str
    tables: list[Table]


def page(path: Path) -> Page:
    """The report of the audit.json at `path`; `InputError` where it cannot be read."""
    found = read(path, AuditRecord)
    content = {
        "sentence": sentence(found),
        "within": {NAMES[name]: f"{100 * share:.0f} %" for name, share in found.within.items()},
        "agreement": [_agreement(found, name) for name in NAMES],
        "strategies": [_strategy(name, each) for name, each in found.strategies.items()],
        "curves": [_curves(found, name) for name in found.curves.confined.slopes],
        "values": Table(
            ["parameter", "value"],
            [[words(n), quantity(n, v)] for n, v in found.parameters.items()],
        ),
        "settings": _settings(found),
    }
    return Page(content["sentence"], render("audit.html", found=found, **content))


def sentence(found: AuditRecord) -> str:
    """How many slopes pass, by strategy."""
    parts = [f"{words(name)}: {_passed(each)}" for name, each in found.strategies.items()]
    listed = "; ".join(parts)
    where = f"on {found.packings} packings of {found.spheres} spheres"
    return f"{listed[:1].upper()}{listed[1:]}, {where}."


def _passed(each: StrategyRecord) -> str:
    judged = each.judged()
    passed = sum(row.passed is True for row in judged)
    return f"{passed} of {len(judged)} slopes that can be judged pass"


def _strategy(name: str, each: StrategyRecord) -> Strategy:
    cost = f"{each.forward_runs:.3g} forward runs a packing"
    text = f"{each.described}. {_passed(each)}; it costs {cost}."
    tables = [_table(each, observable) for observable in NAMES]
    return Strategy(words(name), text, tables)


def _table(each: StrategyRecord, observable: Observable) -> Table:
    rows = [
        [
            words(row.parameter),
            f"{number(row.estimate, 3)} ± {number(row.estimate_se, 2)}",
            f"{number(row.reference, 3)} ± {number(row.reference_se, 2)}",
            _verdict(row),
        ]
        for row in each.of(observable)
    ]
    columns = ["parameter", "estimate", "reference", "verdict"]
    caption = f"Slopes of the {NAMES[observable]} per unit of ln p ({UNITS[observable]}), ± s.e."
    return Table(columns, rows, caption)


def _verdict(row: Slope) -> str:
    if not row.judged:
        return "not judged"
    return "● passed" if row.passed else "○ failed"


def _agreement(found: AuditRecord, observable: Observable) -> Picture:
    lines = [
        f"{words(name)} {sum(row.passed is True for row in each.of(observable) if row.judged)} of "
        f"{sum(row.judged for row in each.of(observable))}"
        for name, each in found.strategies.items()
    ]
    return Picture(
        panel_svg(lambda axis: drawing.agreement(axis, found, observable)),
        f"Estimated slopes of the {NAMES[observable]} against the reference; within the band: "
        f"{', '.join(lines)}.",
        "Bars: standard errors. Pale: not judged. Band: what passes.",
    )


def _curves(found: AuditRecord, parameter: str) -> Picture:
    """Slopes of both tests' curves in one parameter."""
    figure, axes = plt.subplots(2, 1, figsize=(4.6, 4.8), layout="constrained")
    for axis, test in zip(axes, TESTS, strict=True):
        drawing.curve_slope(axis, found, test, parameter)
        axis.set(xlabel=drawing.ABSCISSAS[test], ylabel=drawing.CURVE_SLOPES[test])
    axes[0].set_title(words(parameter))
    axes[0].legend(fontsize=8, frameon=False)
    name = words(parameter)
    return Picture(
        svg(figure),
        f"Slopes of both curves in {name}: the reference's band of two standard errors, and the "
        "strategies' lines.",
        f"Slopes in {name}. Band: reference ± 2 s.e.",
    )


def _settings(found: AuditRecord) -> dict[str, str]:
    return {"spheres": str(found.spheres), "packings": ", ".join(map(str, found.seeds))}
