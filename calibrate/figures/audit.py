"""Figures of an audit of gradients: estimates against the reference, and slopes of curves."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibrate.figures.style import DARK, LIGHT, MIDDLE, pretty
from calibrate.labtests.composite import described
from calibrate.records.audit import AuditSlopes, Slope, SlopesOfCurve
from calibrate.records.base import Observable

MARKS = {
    "regression": ("^", DARK, "-."),
    "fit": ("o", MIDDLE, "-"),
    "response": ("X", DARK, "-"),
    "ensemble": ("P", LIGHT, "--"),
    "pathwise": ("x", "0.5", ":"),
    "blend": ("s", LIGHT, "--"),
    "overdamped": ("*", DARK, "-"),
    "overdamped_blend": ("h", MIDDLE, "--"),
    "virtual_power": ("D", DARK, "--"),
    "virtual_power_blend": ("v", LIGHT, ":"),
}


def audit_figure(found: AuditSlopes) -> Figure:
    """Estimates against the reference, one panel an observable; the band is what passes."""
    shown = found.observables
    size = (5.5 * len(shown), 5)
    figure, axes = plt.subplots(1, len(shown), figsize=size, layout="constrained", squeeze=False)
    for axis, observable in zip(axes[0], shown, strict=True):
        agreement(axis, found, observable)
    return figure


def agreement(axis: Axes, found: AuditSlopes, observable: Observable) -> None:
    """Estimates of one observable's slopes against the reference; the band is what passes."""
    for number, (name, each) in enumerate(found.strategies.items()):
        _estimates(axis, each.of(observable), name, named=number == 0)
    axis.margins(x=0.25)
    _band(axis, found.within[observable])
    known = described(observable)
    axis.set_xlabel(f"reference slope ({known.label}, {known.unit} per unit of ln p)")
    axis.set_ylabel("estimate")
    axis.legend(frameon=False)


def _estimates(axis: Axes, rows: Sequence[Slope], strategy: str, named: bool) -> None:
    """Points with both standard errors, and with the parameters' names if they are to be `named`;
    slopes too small to judge are pale."""
    mark, colour, _ = MARKS[strategy]
    limit = 3 * max((abs(row.reference) for row in rows), default=0.0)
    shown = [row for row in rows if abs(row.estimate) < limit]
    label = f"{strategy} ({len(rows) - len(shown)} off the scale)" if shown != rows else strategy
    for number, row in enumerate(shown):
        axis.errorbar(
            row.reference,
            row.estimate,
            xerr=row.reference_se,
            yerr=min(row.estimate_se, limit),
            fmt=mark,
            color=colour,
            alpha=1.0 if row.judged else 0.35,
            label=label if number == 0 else None,
        )
        if row.judged and named:
            at, shift = (row.reference, row.estimate), (6, -4)
            axis.annotate(pretty(row.parameter), at, shift, textcoords="offset points", fontsize=8)


def _band(axis: Axes, within: float) -> None:
    left, right = axis.get_xlim()
    span = np.linspace(left, right, 101)
    axis.fill_between(span, span * (1 - within), span * (1 + within), color="0.9", zorder=0)
    axis.plot(span, span, color="0.5", lw=0.8)


def curve_slopes_figure(found: AuditSlopes) -> Figure:
    """Slopes of all whole curves in every parameter: the reference's band and the estimates."""
    names = found.parameters_of_curves
    size = (2.1 * len(names), 2.6 * len(found.curves))
    figure, axes = plt.subplots(
        len(found.curves), len(names), figsize=size, layout="constrained", sharex="row",
        sharey="row", squeeze=False,
    )  # fmt: skip
    for (test, curve), row in zip(found.curves.items(), axes, strict=True):
        for name, axis in zip(names, row, strict=True):
            curve_slope(axis, curve, name)
            axis.set_xlabel(abscissa_of(curve), fontsize=8)
        row[0].set_ylabel(f"{test}: {ordinate_of(curve)}")
    for name, axis in zip(names, axes[0], strict=True):
        axis.set_title(pretty(name), fontsize=9)
    axes[0, 0].legend(fontsize=7, frameon=False)
    return figure


def abscissa_of(curve: SlopesOfCurve) -> str:
    """Along what a curve is read, with its unit."""
    return "displacement (mm)" if curve.force_n is None else "force on loading (N)"


def ordinate_of(curve: SlopesOfCurve) -> str:
    """What is differentiated, with its unit."""
    read, unit = ("force", "N") if curve.force_n is None else ("displacement", "mm")
    return f"d {read} / d ln p ({unit})"


def curve_slope(axis: Axes, curve: SlopesOfCurve, parameter: str) -> None:
    """Slope of one test's curve in one parameter."""
    by_name = {str(name): each for name, each in curve.slopes[parameter].items()}
    reference = by_name["reference"]
    slope, error = np.array(reference.slope), np.array(reference.se)
    band = (slope - 2 * error, slope + 2 * error)
    axis.fill_between(curve.points, *band, color=LIGHT, lw=0, label="reference ± 2 s.e.")
    for name, each in by_name.items():
        if name in MARKS:
            _, colour, line = MARKS[name]
            axis.plot(curve.points, each.slope, line, color=colour, lw=1.2, label=name)
    axis.axhline(0, color="0.6", lw=0.6)
