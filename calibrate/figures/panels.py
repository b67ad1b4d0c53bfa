"""Panels of simulations and calibrations: each function fills one axis.

Everything is drawn from records, so a figure can be made again from a result's file.  Packings
that were not fitted are dashed, with diamonds; measured curves are dotted, and begin where the
platen touches.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from calibrate.figures.style import DARK, LIGHT, MIDDLE, pretty
from calibrate.labtests.composite import described
from calibrate.labtests.features import SEATED, SEATING
from calibrate.labtests.reading import loading
from calibrate.records.base import Curve, Measured, Target, Test
from calibrate.records.fit import FitRecord

BANDED = 6  # curves of one group from which on their mean and band are drawn in place of each
RATIOS = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)


@dataclass(frozen=True)
class Look:
    """How one group of packings is drawn, and what it is called."""

    label: str
    colour: str
    line: str
    marker: str


PACKINGS = Look("packings", DARK, "-", "o")
FITTED = Look("fitted packings", DARK, "-", "o")
FRESH = Look("fresh packings", MIDDLE, "--", "D")
Group = tuple[Look, Sequence[Curve]]


def fit_groups(found: FitRecord, test: Test) -> list[Group]:
    """Curves of one test on the packings of a fit and on fresh ones."""
    both = ((FITTED, found.packings.fitted), (FRESH, found.packings.fresh))
    return [
        (look, [p.curves[test] for p in packings if test in p.curves]) for look, packings in both
    ]


def compression(axis: Axes, test: Test, groups: Sequence[Group], measured: Measured) -> None:
    """One test's curves, one line a packing, with what was measured."""
    for look, curves in groups:
        if len(curves) >= BANDED:
            _band(axis, curves, look)
            continue
        for number, curve in enumerate(curves):
            name = look.label if number == 0 else None
            points = (curve.displacement_mm, curve.force_n)
            axis.plot(*points, look.line, color=look.colour, lw=1, label=name)
    shown = measured.tests[test]
    for number, curve in enumerate(c for c in measured.curves if c.test == test):
        name, way = "measured" if number == 0 else None, np.asarray(curve.displacement_mm)
        way = from_seating(way, curve.force_n) if shown.seated else way
        axis.plot(way, curve.force_n, ":", color="0.35", lw=1.5, label=name)
    for force in shown.guides_n:
        axis.axhline(force, color="0.7", lw=0.7)
    for name in shown.drawn:
        if name in measured.targets:
            _target_force(axis, measured.targets[name], name)
    axis.set(xlabel=shown.axes[0], ylabel=shown.axes[1], title=shown.title)


def from_seating(displacement_mm: ArrayLike, force_n: ArrayLike) -> np.ndarray:
    """Displacement (mm) of a record, counted from where it first carries the seating force, as
    simulated curves begin; as recorded where it begins beyond, or never carries it."""
    way, force = np.asarray(displacement_mm, float), np.asarray(force_n, float)
    if not force[0] <= SEATING <= force.max():
        return way
    return way - SEATED.of(*loading(way, force))


def _band(axis: Axes, curves: Sequence[Curve], look: Look) -> None:
    """Mean of several curves, and one standard deviation across its course.

    Curves are averaged at equal shares of the way that the platen went, so that they may turn back.
    """
    courses = np.array([_resampled(curve) for curve in curves])
    mean, spread = courses.mean(axis=0), courses.std(axis=0, ddof=1)
    size = np.ptp(mean, axis=0)
    along = np.gradient(_smooth(mean), axis=0) / size
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    reach = np.linalg.norm(across * _smooth(spread) / size, axis=1, keepdims=True)
    edges = [mean + sign * reach * across * size for sign in (1, -1)]
    outline = np.concatenate([edges[0], edges[1][::-1]])
    axis.fill(*outline.T, color=look.colour, alpha=0.2, lw=0, label=f"{look.label}: ± scatter")
    axis.plot(*mean.T, look.line, color=look.colour, lw=1.6, label=f"{look.label}: mean")


def _resampled(curve: Curve, points: int = 200) -> np.ndarray:
    """The curve (points, 2) at equal shares of the way that the platen went, there and back."""
    course = np.stack([curve.displacement_mm, curve.force_n], axis=1)
    passed = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(course[:, 0])))])
    wanted = np.linspace(0, passed[-1], points)
    return np.stack([np.interp(wanted, passed, column) for column in course.T], axis=1)


def _smooth(rows: np.ndarray, reach: int = 6) -> np.ndarray:
    """Means over neighbouring rows, shorter at the ends."""
    places = range(len(rows))
    return np.array([rows[max(0, k - reach) : k + reach + 1].mean(axis=0) for k in places])


def _target_force(axis: Axes, target: Target, name: str) -> None:
    ends = (target.mean - target.scatter, target.mean + target.scatter)
    label = f"measured {described(name).label} ± scatter"
    axis.axhspan(*ends, color=LIGHT, alpha=0.5, lw=0, label=label)


def observables(axis: Axes, found: FitRecord) -> None:
    """Each observable over its target: packings as points, means as bars, the target's scatter."""
    targets = found.measured.targets
    for place, (name, target) in enumerate(targets.items()):
        reach = target.scatter / target.mean
        label = "measured ± one repeat" if place == 0 else None
        bar = {"color": "0.5", "lw": 8, "alpha": 0.4, "zorder": 0}
        axis.plot([place, place], [1 - reach, 1 + reach], label=label, **bar)
        for shift, packings, look in (
            (-0.12, found.packings.fitted, FITTED),
            (0.12, found.packings.fresh, FRESH),
        ):
            values = np.array([each.observable(name) for each in packings]) / target.mean
            at = np.full(len(values), place + shift)
            first = look.label if place == 0 else None
            axis.plot(at, values, look.marker, color=look.colour, ms=5, label=first)
            ends = (place + shift - 0.08, place + shift + 0.08)
            if np.any(np.isfinite(values)):
                axis.hlines(np.nanmean(values), *ends, look.colour, lw=2)
    axis.axhline(1, color="0.6", lw=0.8)
    axis.set_xticks(range(len(targets)), [pretty(name) for name in targets])
    axis.set_xlim(-0.6, len(targets) - 0.4)
    axis.set(ylabel="simulated / measured", title="observables (bars: means)")


def read_numbers(axis: Axes, found: FitRecord) -> None:
    """Every number that was read from curves over its measured value, with what both scatter."""
    rows = {name: f for name, f in found.features.items() if name not in found.measured.targets}
    for place, feature in enumerate(rows.values()):
        size = abs(feature.measured) or 1.0
        reach = feature.sd / size
        bar = {"color": "0.5", "lw": 6, "alpha": 0.4, "zorder": 0, "solid_capstyle": "butt"}
        label = "measured ± one deviation of the difference" if place == 0 else None
        axis.plot([1 - reach, 1 + reach], [place, place], label=label, **bar)
        label = "mean of the fitted packings" if place == 0 else None
        axis.plot(feature.simulated / size, place, "o", color=DARK, ms=5, label=label)
    axis.axvline(1, color="0.6", lw=0.8)
    axis.set_yticks(range(len(rows)), list(rows), fontsize=7)
    axis.set_ylim(len(rows) - 0.4, -0.6 - 0.12 * len(rows))  # in the curve's order, room on top
    axis.set(xlabel="simulated / measured", title="numbers read from curves")


def parameters(axis: Axes, found: FitRecord) -> None:
    """Free parameters and their 95 % intervals, over their starting values."""
    spans = []
    for row, name in enumerate(found.free):
        start, value = found.start(name), found.parameters[name]
        low, high = (end / start for end in found.identifiability.interval_95[name])
        spans += [low, high, value / start]
        axis.plot([low, high], [row, row], color=DARK, lw=3)
        axis.plot(value / start, row, "o", color=MIDDLE, ms=8)
        at = (value / start, row)
        box = {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.85}
        far = {"textcoords": "offset points", "ha": "center", "fontsize": 8, "bbox": box}
        axis.annotate(f"{value:.4g}", at, (0, 8), **far)
    axis.axvline(1, color="0.6", lw=0.8)
    axis.set_xscale("log")
    axis.set_xticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axis.minorticks_off()
    reach = 1.25 * max(float(np.max(np.abs(np.log(spans)))), 0.35)
    axis.set_xlim(np.exp(-reach), np.exp(reach))
    axis.set_yticks(range(len(found.free)), [pretty(name) for name in found.free])
    axis.set_ylim(-0.6, len(found.free) - 0.1)
    axis.set(xlabel="value / starting value (95 % interval)", title="free parameters (SI)")


def profile(axis: Axes, found: FitRecord, name: str) -> None:
    """The objective along one parameter: simulated points, and what the covariance implies."""
    points = found.profiles[name]
    ratio = np.array([point.value for point in points]) / found.parameters[name]
    axis.plot(ratio, [p.simulated for p in points], "o", color=MIDDLE, label="simulated")
    implied = np.array([p.linearised for p in points])
    if len(np.unique(ratio)) > 2:  # a parabola in ln p
        parabola = np.polynomial.Polynomial.fit(np.log(ratio), implied, 2)
        ratio = np.geomspace(ratio.min(), ratio.max(), 61)
        implied = parabola(np.log(ratio))
    axis.plot(ratio, implied, "-", color=DARK, lw=1.2, label="from the covariance")
    axis.set(xlabel=f"{pretty(name)} / fitted value", ylabel="objective (half of chi²)")
    axis.set_title(f"profile of {pretty(name)}")
    axis.legend(fontsize=8, frameon=False)


def descent(axis: Axes, found: FitRecord) -> None:
    """The objective at every evaluation; hollow where the step was rejected or failed, crosses
    where smaller beds were explored, whose objective is their own."""
    runs = np.array([step.forward_runs for step in found.history])
    cost = np.array([step.cost for step in found.history])
    status = np.array([step.status for step in found.history])
    better, explored = status == "better", status == "explored"
    least = np.minimum.accumulate(cost[~explored])
    axis.plot(runs[~explored], least, drawstyle="steps-post", color=DARK, lw=1.2)
    axis.plot(runs[better], cost[better], "o", color=DARK, label="better")
    if np.any(explored):
        axis.plot(runs[explored], cost[explored], "x", color="0.5", label="smaller beds")
    rest = ~better & ~explored
    if np.any(rest):
        axis.plot(runs[rest], cost[rest], "D", mfc="white", mec=MIDDLE, label="rejected or failed")
    axis.set_yscale("log")
    axis.set(xlabel="forward runs a packing", ylabel="objective (half of chi²)")
    axis.set_title("course of the fit")
    axis.legend(fontsize=8, frameon=False)
