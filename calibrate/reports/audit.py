"""The report of an audit of gradients."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt

from calibrate.figures import audit as drawing
from calibrate.figures.style import panel_svg, svg
from calibrate.labtests.composite import described
from calibrate.records.audit import AuditRecord, Slope, StrategyRecord
from calibrate.records.base import Observable, read
from calibrate.reports.html import (
    Page,
    Picture,
    Table,
    number,
    pictures_of,
    quantity,
    render,
    words,
)


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
        "within": {_name(name): f"{100 * share:.0f} %" for name, share in found.within.items()},
        "agreement": [_agreement(found, name) for name in found.observables],
        "strategies": [_strategy(found, name) for name in found.strategies],
        "curves": [
            *(_curves(found, name) for name in found.parameters_of_curves),
            *pictures_of("audit", found, skipped=2).values(),
        ],
        "values": Table(
            ["parameter", "value"],
            [[words(n), quantity(n, v)] for n, v in found.parameters.items()],
        ),
        "settings": {"spheres": str(found.spheres), "packings": ", ".join(map(str, found.seeds))},
    }
    return Page(content["sentence"], render("audit.html", found=found, **content))


def sentence(found: AuditRecord) -> str:
    """How many slopes pass, by strategy."""
    parts = [f"{words(name)}: {passed(each)}" for name, each in found.strategies.items()]
    listed = "; ".join(parts)
    where = f"on {found.packings} packings of {found.spheres} spheres"
    return f"{listed[:1].upper()}{listed[1:]}, {where}."


def passed(each: StrategyRecord) -> str:
    """How many slopes of a strategy pass."""
    judged = each.judged()
    right = sum(row.passed is True for row in judged)
    return f"{right} of {len(judged)} slopes that can be judged pass"


def _name(observable: Observable) -> str:
    return described(observable).label


def _strategy(found: AuditRecord, name: str) -> Strategy:
    each = found.strategies[name]
    cost = f"{each.forward_runs:.3g} forward runs a packing"
    text = f"{each.described}. {passed(each)}; it costs {cost}."
    tables = [_table(each, observable) for observable in found.observables]
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
    known = described(observable)
    caption = f"Slopes of the {known.label} per unit of ln p ({known.unit}), ± s.e."
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
        f"Estimated slopes of the {_name(observable)} against the reference; within the band: "
        f"{', '.join(lines)}.",
        "Bars: standard errors. Pale: not judged. Band: what passes.",
    )


def _curves(found: AuditRecord, parameter: str) -> Picture:
    """Slopes of all tests' curves in one parameter."""
    count = len(found.curves)
    size = (4.6, 2.4 * count)
    figure, rows = plt.subplots(count, 1, figsize=size, layout="constrained", squeeze=False)
    axes = rows[:, 0]
    for axis, (test, curve) in zip(axes, found.curves.items(), strict=True):
        drawing.curve_slope(axis, curve, parameter)
        label = drawing.ordinate_of(curve)
        axis.set(xlabel=f"{drawing.abscissa_of(curve)}, {test}", ylabel=label)
    axes[0].set_title(words(parameter))
    axes[0].legend(fontsize=8, frameon=False)
    name = words(parameter)
    return Picture(
        svg(figure),
        f"Slopes of all curves in {name}: the reference's band of two standard errors, and the "
        "strategies' lines.",
        f"Slopes in {name}. Band: reference ± 2 s.e.",
    )
