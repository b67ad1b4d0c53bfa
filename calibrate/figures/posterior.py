"""Figures of a posterior: parameters before and after the tests, and what soils of it predict."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullLocator

from calibrate.figures.panels import compression, from_seating
from calibrate.figures.style import DARK, LIGHT, MIDDLE, marked, pretty
from calibrate.io.labfile import PARAMETER_UNITS
from calibrate.labtests.base import AXES
from calibrate.records.base import Curve, Measured

PAIRED = 4  # parameters that are shown in pairs, at most
POINTS = 400  # of a cloud
BINS = 24
SHOWN = {"Pa": (1e-6, "MPa"), "J/m^2": (1.0, "J/m²"), "": (1.0, "-")}  # units on axes


def posterior_figure(
    posterior: Mapping[str, np.ndarray],
    prior: Mapping[str, np.ndarray],
    curves: Mapping[str, Sequence[Curve]],
    measured: Measured,
) -> Figure:
    """Pairs of the parameters that the tests narrow most, prior in grey and posterior in black;
    above, curves that soils of the posterior show on average over packings, with what was
    measured.

    posterior and prior are draws (n,) by parameter, SI; curves are by test.
    """
    names = narrowed(posterior, prior)
    count = max(len(names), 2)
    figure = plt.figure(figsize=(2.7 * count, 3.4 + 2.4 * count), layout="constrained")
    parts = figure.subfigures(2, 1, height_ratios=[3.4, 2.4 * count], squeeze=False)
    above, below = parts[:, 0]
    tests = above.subplots(1, len(measured.tests), squeeze=False)[0]
    for axis, test in zip(tests, measured.tests, strict=True):
        for number, curve in enumerate(curves.get(test, [])):
            name = "soils of the posterior, means over packings" if number == 0 else None
            points = (curve.displacement_mm, curve.force_n)
            axis.plot(*points, color=LIGHT, lw=0.7, alpha=0.7, label=name)
        compression(axis, test, [], measured)
        axis.set(xlim=(0, None), ylim=(0, None))
    axes = below.subplots(len(names), len(names), squeeze=False)
    for row, name in enumerate(names):
        for column, other in enumerate(names):
            axis = axes[row, column]
            if column > row:
                axis.set_axis_off()
                continue
            if column == row:
                _alone(axis, prior[name], posterior[name], name)
            else:
                _pair(axis, prior, posterior, other, name)
            _labelled(axis, name, other, row == len(names) - 1, column == 0 and row > 0)
    known = marked((axes[0, 0], *tests))
    below.legend(known.values(), known, loc="upper right", frameon=False, fontsize=9)
    return figure


def narrowed(posterior: Mapping[str, np.ndarray], prior: Mapping[str, np.ndarray]) -> list[str]:
    """The parameters that the tests tell most of, alone or with others, in their usual order: those
    that weigh in the directions that became narrowest."""
    names = list(posterior)
    spread = np.array([np.log(prior[name]).std() for name in names])
    logs = np.stack([np.log(posterior[name]) for name in names], axis=1) / spread
    width, axes = np.linalg.eigh(np.atleast_2d(np.cov(logs.T)))
    told = (axes**2 * np.maximum(-np.log(np.maximum(width, 1e-12)), 0.0)).sum(axis=1)
    chosen = np.argsort(-told)[:PAIRED]
    return [name for i, name in enumerate(names) if i in chosen]


def _scaled(name: str, values: np.ndarray) -> np.ndarray:
    return SHOWN.get(PARAMETER_UNITS[name], (1.0, ""))[0] * values


def _alone(axis: Axes, prior: np.ndarray, posterior: np.ndarray, name: str) -> None:
    """Both distributions of one parameter, as shares of draws in bins of equal width in ln p."""
    before, after = _scaled(name, prior), _scaled(name, posterior)
    bins = np.geomspace(*_ends(before), BINS + 1)
    shares = [np.histogram(values, bins)[0] / len(values) for values in (before, after)]
    axis.stairs(shares[0], bins, fill=True, color="0.8", label="before the tests (prior)")
    axis.stairs(shares[1], bins, color=DARK, lw=1.6, label="after the tests (posterior)")
    for end in np.quantile(after, [0.05, 0.95]):
        axis.axvline(end, color=MIDDLE, ls="--", lw=1, label="90 % of draws between these")
    axis.set(xscale="log", yticks=[], xlim=_ends(before))


def _ends(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _pair(axis: Axes, prior, posterior, across: str, up: str) -> None:
    """Draws of two parameters."""
    for draws, look in ((prior, {"color": "0.8", "s": 5}), (posterior, {"color": DARK, "s": 4})):
        step = max(1, len(draws[across]) // POINTS)
        both = (_scaled(name, draws[name][::step]) for name in (across, up))
        axis.scatter(*both, lw=0, **look)
    limits = {"xlim": _ends(_scaled(across, prior[across])), "ylim": _ends(_scaled(up, prior[up]))}
    axis.set(xscale="log", yscale="log", **limits)


def _labelled(axis: Axes, row: str, column: str, below: bool, left: bool) -> None:
    """Names with units at the outer axes, few ticks on all."""
    wanted = [(below, column, axis.set_xlabel, axis.xaxis, axis.get_xlim())]
    if row != column:
        wanted += [(left, row, axis.set_ylabel, axis.yaxis, axis.get_ylim())]
    for named, name, set_label, ticks, (low, high) in wanted:
        if named:
            unit = SHOWN.get(PARAMETER_UNITS[name], (1.0, PARAMETER_UNITS[name]))[1]
            set_label(f"{pretty(name)} ({unit})", fontsize=8)
        places = np.geomspace(low, high, 5)[1::2]
        ticks.set_major_locator(FixedLocator([float(f"{place:.2g}") for place in places]))
        ticks.set_minor_locator(NullLocator())
        ticks.set_major_formatter(FormatStrFormatter("%g"))
        ticks.set_tick_params(labelsize=7)


# ---------------------------------------------------------------- predicted tests

SIZE = (4.9, 4.1)  # inches, of one panel


def prediction_figure(content: dict) -> Figure:
    """Curves that tests would show: the expected one, the band of means over many specimens and
    that of single specimens, with measured curves beside them where there are any."""
    tests = content["curves"]
    size = (SIZE[0] * len(tests), SIZE[1])
    figure, axes = plt.subplots(1, len(tests), figsize=size, layout="constrained", squeeze=False)
    for axis, (test, curve) in zip(axes[0], tests.items(), strict=True):
        _panel(axis, curve, content["share"])
        for each in content["measured"]["curves"]:
            if each["test"] == test:
                way, force = _placed(curve, each)
                axis.plot(way, force, "-", color=MIDDLE, lw=1, label="measured")
        along, up = content["measured"].get("tests", {}).get(test, {}).get("axes", AXES)
        axis.set(xlabel=along, ylabel=up, title=test)
        axis.set_xlim(left=0)
        axis.set_ylim(bottom=0)
    entries = marked(axes[0])
    place = {"loc": "outside lower center", "ncols": len(entries)}
    figure.legend(entries.values(), entries.keys(), frameon=False, **place)
    return figure


def _panel(axis: Axes, curve: dict, share: float) -> None:
    """One test: force over displacement, read along one of the two."""
    part = f"{100 * share:.0f} %"
    along_force = "force_n" in curve
    at = np.array(curve["force_n" if along_force else "displacement_mm"])
    fill = axis.fill_betweenx if along_force else axis.fill_between
    fill(at, *curve["specimen"], color=LIGHT, alpha=0.45, lw=0, label=f"{part} of specimens")
    fill(at, *curve["mean"], color=DARK, alpha=0.35, lw=0, label=f"{part} of means")
    middle = np.array(curve["middle"])
    x, y = (middle, at) if along_force else (at, middle)
    axis.plot(x, y, color=DARK, lw=1.4, label="expected")


def _placed(curve: dict, measured: dict) -> tuple[np.ndarray, np.ndarray]:
    """A measured curve (mm, N), moved: where a laboratory's displacement begins is arbitrary.
    Where force is what a test is read along, it meets the expected curve at its first point, else
    it begins where the platen touches."""
    way, force = (np.array(measured[name]) for name in ("displacement_mm", "force_n"))
    if "force_n" not in curve:
        return from_seating(way, force), force
    rising = np.maximum.accumulate(force[: force.argmax() + 1])
    begins = np.interp(curve["force_n"][0], rising, way[: len(rising)])
    return way + (curve["middle"][0] - begins), force
