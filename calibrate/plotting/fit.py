"""Figures of a calibration: curves with their scatter, a fit at a glance, an audit, one contact.

Packings that were not fitted are dashed.
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from calibrate.audit import OBSERVABLES, WITHIN, Audit
from calibrate.campaign import Run
from calibrate.measurements import Lab
from calibrate.plotting.style import DARK, LIGHT, MIDDLE
from calibrate.workflow import Calibrated

RATIOS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)


def simulation_figure(runs: Sequence[Run], lab: Lab, path: Path) -> None:
    """Both tests' curves, one line a packing, beside measured curves and targets."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    _confined(left, runs, lab, DARK, "-", "packings")
    _unconfined(right, runs, lab, DARK, "-", "packings")
    _finish(figure, (left, right), path)


def fit_figure(done: Calibrated, path: Path) -> None:
    """Curves of fitted and fresh packings, observables against targets, parameters."""
    figure, axes = plt.subplots(2, 2, figsize=(10.5, 8), layout="constrained")
    for axis, draw in ((axes[0, 0], _confined), (axes[0, 1], _unconfined)):
        draw(axis, done.fitted_runs, done.lab, DARK, "-", "fitted packings")
        draw(axis, done.fresh_runs, done.lab, MIDDLE, "--", "fresh packings")
    _observables(axes[1, 0], done)
    _parameters(axes[1, 1], done)
    _finish(figure, axes.ravel()[:3], path)


MARKS = {
    "regression": ("^", DARK),
    "ensemble": ("o", MIDDLE),
    "pathwise": ("x", "0.5"),
    "blend": ("s", LIGHT),
}
UNITS = {"depression_depth_mm": "depression depth, mm", "crushing_force_n": "crushing force, N"}


def audit_figure(found: Audit, path: Path) -> None:
    """Estimates against the reference, one panel an observable; the band is what passes."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for axis, observable in zip(axes, OBSERVABLES, strict=True):
        for name in found.estimates:
            rows = [row for row in found.rows(name) if row["observable"] == observable]
            _estimates(axis, rows, name)
        axis.margins(x=0.25)
        _band(axis, WITHIN[observable])
        axis.set(
            xlabel=f"reference slope ({UNITS[observable]} per unit of ln p)",
            ylabel="estimate",
        )
        axis.legend(frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _estimates(axis: Axes, rows: list[dict], strategy: str) -> None:
    """Points with both standard errors; slopes too small to judge are pale."""
    mark, colour = MARKS[strategy]
    limit = 3 * max(abs(row["reference"]) for row in rows)
    shown = [row for row in rows if abs(row["estimate"]) < limit]
    label = f"{strategy} ({len(rows) - len(shown)} off the scale)" if shown != rows else strategy
    for number, row in enumerate(shown):
        axis.errorbar(
            row["reference"],
            row["estimate"],
            xerr=row["reference_se"],
            yerr=min(row["estimate_se"], limit),
            fmt=mark,
            color=colour,
            alpha=1.0 if row["judged"] else 0.35,
            label=label if number == 0 else None,
        )
        if row["judged"]:
            axis.annotate(row["parameter"].replace("_", " "), (row["reference"], row["estimate"]))


def curve_slopes_figure(found: Audit, path: Path) -> None:
    """Slopes of both whole curves in every parameter: the reference's band and the estimates."""
    shape = (len(found.points.slices()), len(found.names))
    figure, axes = plt.subplots(
        *shape, figsize=(2.1 * shape[1], 5.2), layout="constrained", sharex="row", sharey="row"
    )
    abscissas = (found.points.loading_n, found.points.crushing_mm)
    for row, (rows, abscissa) in enumerate(
        zip(found.points.slices().values(), abscissas, strict=True)
    ):
        for p, name in enumerate(found.names):
            _curve_slope(axes[row, p], found, rows, p, abscissa)
            if row == 0:
                axes[row, p].set_title(_pretty(name), fontsize=9)
    for axis, label in zip(axes[:, 0], CURVE_SLOPES, strict=True):
        axis.set_ylabel(label)
    for row, label in enumerate(("force on loading (N)", "displacement (mm)")):
        for axis in axes[row]:
            axis.set_xlabel(label, fontsize=8)
    axes[0, 0].legend(fontsize=7, frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)


CURVE_SLOPES = ("d displacement / d ln p (mm)", "d force / d ln p (N)")


def _curve_slope(axis: Axes, found: Audit, rows: slice, p: int, abscissa: np.ndarray) -> None:
    slope, error = (
        np.asarray(part[rows, p])
        for part in (found.reference.slopes, found.reference.standard_error)
    )
    axis.fill_between(
        abscissa,
        slope - 2 * error,
        slope + 2 * error,
        color=LIGHT,
        lw=0,
        label="reference ± 2 s.e.",
    )
    for name, each in found.estimates.items():
        if len(each.slopes) >= rows.stop:
            axis.plot(abscissa, each.slopes[rows, p], color=MARKS[name][1], lw=1.2, label=name)
    axis.axhline(0, color="0.6", lw=0.6)


def _band(axis: Axes, within: float) -> None:
    left, right = axis.get_xlim()
    span = np.linspace(left, right, 101)
    axis.fill_between(span, span * (1 - within), span * (1 + within), color="0.9", zorder=0)
    axis.plot(span, span, color="0.5", lw=0.8)


def contact_figure(overlap_m: np.ndarray, force_n: np.ndarray, path: Path) -> None:
    """Normal force against overlap of one contact."""
    figure, axis = plt.subplots(figsize=(5.5, 4.2), layout="constrained")
    axis.plot(1e6 * overlap_m, force_n, color=DARK)
    axis.axhline(0, color="0.6", linewidth=0.8)
    axis.set(xlabel="overlap (µm)", ylabel="normal force (N)")
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _confined(axis: Axes, runs, lab: Lab, colour: str, line: str, label: str) -> None:
    for number, run in enumerate(runs):
        name = label if number == 0 else None
        axis.plot(run.confined[:, 0], run.confined[:, 1], line, color=colour, lw=1, label=name)
    _measured(axis, lab, "confined", colour)
    if line == "-":
        for force in (lab.confined.force_low, lab.confined.force_high):
            axis.axhline(force, color="0.7", lw=0.7)
    axis.set(xlabel="displacement (mm)", ylabel="force (N)", title="confined compression")


def _unconfined(axis: Axes, runs, lab: Lab, colour: str, line: str, label: str) -> None:
    for number, run in enumerate(runs):
        name = label if number == 0 else None
        axis.plot(run.unconfined[:, 0], run.unconfined[:, 1], line, color=colour, lw=1, label=name)
    _measured(axis, lab, "unconfined", colour)
    target = lab.targets.get("crushing_force_n")
    if target is not None and line == "-":
        axis.axhspan(
            target.mean - target.scatter,
            target.mean + target.scatter,
            color=LIGHT,
            alpha=0.5,
            lw=0,
            label="measured crushing force ± scatter",
        )
    axis.set(xlabel="displacement (mm)", ylabel="force (N)", title="unconfined compression")


def _measured(axis: Axes, lab: Lab, test: str, colour: str) -> None:
    if colour != DARK:
        return
    for number, curve in enumerate(c for c in lab.curves if c.test == test):
        name = "measured" if number == 0 else None
        axis.plot(curve.displacement_mm, curve.force_n, ":", color="0.35", lw=1.5, label=name)


def _observables(axis: Axes, done: Calibrated) -> None:
    """Each observable over its target: packings as points, means as bars, the target's scatter."""
    for place, (name, target) in enumerate(done.lab.targets.items()):
        axis.errorbar(
            place, 1.0, yerr=target.scatter / target.mean, color="0.5", lw=8, alpha=0.4, zorder=0
        )
        for shift, runs, colour, marker, label in (
            (-0.12, done.fitted_runs, DARK, "o", "fitted packings"),
            (0.12, done.fresh_runs, MIDDLE, "D", "fresh packings"),
        ):
            values = np.array([run.observables()[name] for run in runs]) / target.mean
            first = label if place == 0 else "_"
            axis.plot(np.full(len(values), place + shift), values, marker, color=colour, ms=5)
            axis.hlines(
                values.mean(), place + shift - 0.08, place + shift + 0.08, colour, lw=2, label=first
            )
    axis.axhline(1, color="0.6", lw=0.8)
    axis.set_xticks(range(len(done.lab.targets)), [_pretty(n) for n in done.lab.targets])
    axis.set_xlim(-0.6, len(done.lab.targets) - 0.4)
    axis.set(ylabel="simulated / measured", title="observables (bars: means; grey: repeats)")


def _parameters(axis: Axes, done: Calibrated) -> None:
    """Free parameters over their start, 95 % intervals, priors behind."""
    found = done.result.identifiability
    first = done.result.history[0]["parameters"]
    for row, name in enumerate(found.names):
        start, value = first[name], found.values[row]
        low, high = found.interval[row] / start
        axis.plot([low, high], [row, row], color=DARK, lw=3)
        axis.plot(value / start, row, "o", color=MIDDLE, ms=8)
        axis.annotate(f"{value:.4g}", (value / start, row), (0, 9), textcoords="offset points")
    axis.axvline(1, color="0.6", lw=0.8)
    axis.set_xscale("log")
    axis.set_xticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axis.minorticks_off()
    reach = 1.15 * max(np.max(np.abs(np.log(found.interval.T / list(first.values())))), 0.35)
    axis.set_xlim(np.exp(-reach), np.exp(reach))
    axis.set_yticks(range(len(found.names)), [_pretty(name) for name in found.names])
    axis.set_ylim(-0.6, len(found.names) - 0.4)
    axis.set(xlabel="value / starting value (95 % interval)", title="free parameters (SI)")


def _pretty(name: str) -> str:
    return name.removesuffix("_mm").removesuffix("_n").replace("_", " ")


def _finish(figure, axes, path: Path) -> None:
    for axis in axes:
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=130)
    plt.close(figure)
