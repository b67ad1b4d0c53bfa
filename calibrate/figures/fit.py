"""Figures of a simulation, of a fit at a glance, of one contact."""

import textwrap
from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from calibrate.figures.panels import (
    PACKINGS,
    Look,
    compression,
    fit_groups,
    observables,
    parameters,
    read_numbers,
)
from calibrate.figures.style import DARK, pretty
from calibrate.records.base import Curve, Measured
from calibrate.records.fit import FitRecord
from calibrate.simulation import Run

FAILED = Look("failed packings", "0.6", "--", "x")


def simulation_figure(runs: Sequence[Run], measured: Measured) -> Figure:
    """All tests' curves, one line a packing, beside measured curves and targets."""
    count = len(measured.tests)
    size = (5.0 * count, 4.2)
    figure, rows = plt.subplots(1, count, figsize=size, layout="constrained", squeeze=False)
    axes = rows[0]
    for axis, test in zip(axes, measured.tests, strict=True):
        groups = [
            (look, [Curve.of(r.curves[test]) for r in runs if wanted(r) and len(r.curves[test])])
            for look, wanted in ((PACKINGS, lambda r: not r.failure), (FAILED, lambda r: r.failure))
        ]
        compression(axis, test, groups, measured)
        if not any(curves for _, curves in groups):
            axis.set(xlim=(0, None), ylim=(0, None))
            place = {"transform": axis.transAxes, "ha": "center", "va": "center"}
            axis.text(0.5, 0.5, "no simulated curve: no run came so far", color="0.4", **place)
    return _finished(figure, axes)


LINE = 130  # characters of a line of warnings, at the width of two panels
MOST_LINES = 12


def fit_figure(found: FitRecord) -> Figure:
    """Curves of fitted and fresh packings, observables against targets (where there are none, the
    numbers read from curves), parameters; below, what the fit warned of."""
    tests = list(found.measured.tests)
    columns = max(len(tests), 2)
    size = (5.25 * columns, 8)
    figure, axes = plt.subplots(2, columns, figsize=size, layout="constrained")
    for axis, test in zip(axes[0], tests, strict=False):
        compression(axis, test, fit_groups(found, test), found.measured)
    (observables if found.measured.targets else read_numbers)(axes[1, 0], found)
    parameters(axes[1, 1], found)
    _warn(figure, found.all_warnings(), columns)
    for axis in (*axes[0, len(tests) :], *axes[1, 2:]):
        axis.set_axis_off()
    return _finished(figure, (*axes[0, : len(tests)], axes[1, 0]))


def _warn(figure, sentences: Sequence[str], columns: int) -> None:
    """Sentences at the foot of the figure, numbers that were missed first."""
    width = LINE * columns // 2
    lines = [line for each in sentences for line in textwrap.wrap(f"Warning: {each}.", width)]
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 1], "More warnings are in result.json and in the report."]
    if lines:
        figure.supxlabel("\n".join(lines).replace("$", r"\$"), fontsize=8, x=0.02, ha="left")


def contact_figure(
    overlap_m: np.ndarray, force_n: np.ndarray, sliding: tuple[np.ndarray, np.ndarray] | None = None
) -> Figure:
    """Normal force against overlap of one contact; for a path, tangential force against shift."""
    count = 1 if sliding is None else 2
    size = (5.5 * count, 4.2)
    figure, axes = plt.subplots(1, count, figsize=size, layout="constrained", squeeze=False)
    axes[0, 0].plot(1e6 * overlap_m, force_n, color=DARK)
    axes[0, 0].set(xlabel="overlap (µm)", ylabel="normal force (N)")
    if sliding is not None:
        axes[0, 1].plot(1e6 * sliding[0], sliding[1], color=DARK)
        axes[0, 1].set(xlabel="shift x (µm)", ylabel="tangential force (N)")
    for axis in axes[0]:
        axis.axhline(0, color="0.6", linewidth=0.8)
    return figure


def export_figure(values: Mapping[str, float], intervals: Mapping[str, tuple]) -> Figure:
    """Parameters over their exported values, with 95 % intervals; hollow: not fitted."""
    names = [name for name, value in values.items() if value]
    size = (5.5, 1.2 + 0.24 * len(names))
    figure, axis = plt.subplots(figsize=size, layout="constrained")
    for row, name in enumerate(reversed(names)):
        low, high = (end / values[name] for end in intervals.get(name, (values[name],) * 2))
        axis.plot([low, high], [row, row], color=DARK, lw=2)
        axis.plot(1, row, "o", color=DARK, mfc=DARK if name in intervals else "white")
    axis.set_yticks(range(len(names)), [pretty(name) for name in reversed(names)], fontsize=8)
    axis.set_xlabel("over the exported value\nbars: 95 % interval; hollow: not fitted")
    return figure


def _finished(figure: Figure, axes) -> Figure:
    for axis in axes:
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize=8, frameon=False)
    return figure
