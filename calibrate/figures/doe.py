"""Figures of designed experiments: effects, response surfaces, residuals, slopes and ends beside
those of gradients.

Each drawing function fills one axis; the `..._figure` functions lay them out and write a file.
Factors are drawn in their natural units; `response` is the label of the response with its unit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibrate.designs.comparison import MethodResult, SlopePair
from calibrate.designs.diagnostics import BoxCox, Diagnostics
from calibrate.designs.factors import Factor
from calibrate.designs.screening import Effect, Screening
from calibrate.designs.surface import Surface
from calibrate.figures.style import DARK, LIGHT, MAP, MIDDLE, above
from calibrate.labtests.composite import label as label_of
from calibrate.records.base import Target
from calibrate.records.study import StudyRecord

GRID = 61  # points along each side of a surface
NAMED = 0.12  # of the largest effect: smaller ones lie too close together to be named
NAMED_SLOPE = 0.15  # of the largest slope
MARKERS = "sDo"  # of designs, in the order in which they appear
APART = 10.0  # points between names of factors


# ---------------------------------------------------------------- screening


def pareto(axis: Axes, found: Screening, response: str) -> None:
    """Bars of |effect|, the largest on top, with Lenth's margins; dummies are hollow."""
    effects = sorted(found.effects, key=lambda effect: abs(effect.effect))
    for place, effect in enumerate(effects):
        colour = DARK if effect.effect >= 0 else MIDDLE
        fill: dict[str, Any] = {"color": colour}
        if effect.dummy:
            fill = {"facecolor": "white", "edgecolor": colour, "hatch": "///"}
        axis.barh(place, abs(effect.effect), height=0.7, **fill)
    longest = abs(effects[-1].effect)
    for place, effect in enumerate(effects):
        text = f" {effect.contribution:.1f} %"
        box = {"fc": "white", "ec": "none", "pad": 0.3}
        axis.text(abs(effect.effect), place, text, va="center", fontsize=7, bbox=box)
    margins = [(found.margin, "--", "one at a time")]
    margins += [(found.simultaneous_margin, ":", "all at once")]
    shown = [margin for margin in margins if margin[0] < 3 * longest]
    for margin, line, name in shown:
        label = f"5 % by Lenth, {name}"
        axis.axvline(margin, color="0.3", lw=1, ls=line, label=label, zorder=0)
    axis.set_xlim(0, 1.15 * max([longest] + [margin for margin, _, _ in shown]))
    axis.barh(0, 0, color=DARK, label="raises the response")
    axis.barh(0, 0, color=MIDDLE, label="lowers it")
    axis.set_yticks(range(len(effects)), [_pretty(effect.name) for effect in effects])
    axis.set(xlabel=f"|effect| on {response}", title="Pareto chart, share of variation")
    axis.legend(fontsize=7, loc="lower right")


def half_normal(axis: Axes, found: Screening, response: str) -> None:
    """|effect| against half-normal quantiles; the line is what Lenth's noise alone would give.

    Squares are significant at 5 % one at a time; dummies are hollow.
    """
    largest = max(abs(effect.effect) for effect in found.effects)
    for effect in found.effects:
        large = abs(effect.effect) > found.margin
        _half_normal_point(axis, effect, large, abs(effect.effect) > NAMED * largest)
    quantiles = [0.0, max(effect.half_normal for effect in found.effects)]
    noise = [quantile * found.pseudo_se for quantile in quantiles]
    axis.plot(quantiles, noise, color="0.4", lw=1, label="noise alone (Lenth)")
    axis.set_xlim(0, 1.25 * quantiles[1])
    axis.set_ylim(bottom=0)
    axis.margins(y=0.08)
    label = f"|effect| on {response}"
    axis.set(xlabel="half-normal quantile", ylabel=label, title="half-normal plot")
    axis.legend(fontsize=7, loc="upper left")


def _half_normal_point(axis: Axes, effect: Effect, large: bool, named: bool) -> None:
    face = "white" if effect.dummy else (DARK if effect.effect >= 0 else MIDDLE)
    point = (effect.half_normal, abs(effect.effect))
    axis.plot(*point, "s" if large else "o", mfc=face, mec=DARK, ms=6)
    if named and not effect.dummy:
        axis.annotate(_pretty(effect.name), point, (6, -3), textcoords="offset points", fontsize=7)


# ---------------------------------------------------------------- surfaces


@dataclass(frozen=True, eq=False)
class View:
    """Which part of a surface is drawn, and where.

    `pair` are the two factors that vary, as far as the points of the fit do; the others are held
    at their centres.
    """

    surface: Surface
    factors: Sequence[Factor]
    response: str
    pair: tuple[int, int] = (0, 1)

    @property
    def span(self) -> float:
        """To which both factors go on either side, coded."""
        return float(np.abs(self.surface.X[:, list(self.pair)]).max())

    def grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coordinates of both factors and the predictions, all (g, g)."""
        line = np.linspace(-self.span, self.span, GRID)
        X = np.zeros((GRID, GRID, len(self.factors)))
        X[..., self.pair[0]], X[..., self.pair[1]] = np.meshgrid(line, line)
        height = self.surface(X.reshape(-1, len(self.factors))).reshape(GRID, GRID)
        across, up = (_drawn(self.factors[j], X[..., j]) for j in self.pair)
        return across, up, height

    def points(self) -> list[np.ndarray]:
        """Coordinates of both factors at the points of the fit."""
        return [_drawn(self.factors[j], self.surface.X[:, j]) for j in self.pair]

    def label(self, axis: Any) -> None:
        """Names and units; a logarithmic axis gets its own ticks (3D axes know no log scale)."""
        names = [_axis_label(self.factors[j]) for j in self.pair]
        axis.set(xlabel=names[0], ylabel=names[1])
        ticks = np.linspace(-self.span, self.span, 5)
        for j, set_ticks in zip(self.pair, (axis.set_xticks, axis.set_yticks), strict=True):
            factor = self.factors[j]
            if factor.log:
                size, _ = _shown_in(factor)
                shown = [f"{v / size:.3g}" for v in factor.natural(ticks)]
                set_ticks(_drawn(factor, ticks), shown)

    def title(self) -> str:
        """The response, and at which values the other factors are held."""
        others = [factor for j, factor in enumerate(self.factors) if j not in self.pair]
        values = ", ".join(_value(factor, factor.centre) for factor in others)
        return f"{self.response} at {values}" if values else self.response


def contour(axis: Axes, view: View) -> None:
    """Contours over two factors; dots are points of the design, the others at any level."""
    across, up, height = view.grid()
    filled = axis.contourf(across, up, height, 14, cmap=MAP, alpha=0.75)
    filled.set_rasterized(True)
    lines = axis.contour(across, up, height, filled.levels, colors="black", linewidths=0.5)
    axis.clabel(lines, fontsize=7)
    axis.plot(*view.points(), "o", mfc="white", mec="black", ms=4, clip_on=False)
    view.label(axis)
    axis.set_xlim(across.min(), across.max())
    axis.set_ylim(up.min(), up.max())
    axis.set_title(view.title(), fontsize=9)


def relief(axis: Any, view: View) -> None:
    """The surface in three dimensions, on an axis with `projection="3d"`."""
    across, up, height = view.grid()
    thin = {"rstride": 2, "cstride": 2, "lw": 0.1, "edgecolor": "0.2", "rasterized": True}
    axis.plot_surface(across, up, height, cmap=MAP, **thin)
    axis.view_init(elev=26, azim=-128)
    view.label(axis)
    axis.set_zlabel(view.response, labelpad=8)
    axis.xaxis.labelpad = axis.yaxis.labelpad = 8
    for each in (axis.xaxis, axis.yaxis, axis.zaxis):
        each.label.set_size(8)
    axis.tick_params(labelsize=7)
    axis.set_box_aspect(None, zoom=0.84)


def _drawn(factor: Factor, coded: np.ndarray) -> np.ndarray:
    """Where coded values lie on an axis: at the natural value, or at its logarithm."""
    natural = factor.natural(coded)
    return np.log10(natural) if factor.log else natural


# ---------------------------------------------------------------- residuals


def normal_plot(axis: Axes, found: Diagnostics) -> None:
    """Studentised residuals against normal quantiles; the line is the normal distribution."""
    axis.plot(found.normal_quantile, found.studentised, "o", color=DARK, ms=5)
    reach = np.nanmax(np.abs(found.normal_quantile))
    axis.plot([-reach, reach], [-reach, reach], color="0.5", lw=1)
    label = "externally studentised residual"
    axis.set(xlabel="normal quantile", ylabel=label, title="normal plot")


def residuals_against_predicted(axis: Axes, found: Diagnostics, response: str) -> None:
    """Studentised residuals against predictions, with the limit for outliers."""
    axis.plot(found.predicted, found.studentised, "o", color=DARK, ms=5)
    axis.axhline(0, color="0.6", lw=0.8)
    limit = found.outlier_limit
    axis.axhline(limit, color=MIDDLE, ls="--", lw=1, label=f"outlier at 5 % (±{limit:.2f})")
    axis.axhline(-limit, color=MIDDLE, ls="--", lw=1)
    worst = np.nanmax([limit, *np.abs(found.studentised)])
    if np.isfinite(worst):
        axis.set_ylim(-1.15 * worst, 1.3 * worst)
    label = "externally studentised residual"
    axis.set(xlabel=f"predicted {response}", ylabel=label, title="residuals against predictions")
    axis.legend(fontsize=7, loc="upper right")


def cooks_distances(axis: Axes, found: Diagnostics) -> None:
    """Cook's distance of each run, in the order of the data."""
    runs = np.arange(1, len(found.cooks_distance) + 1)
    axis.vlines(runs, 0, found.cooks_distance, color=LIGHT, lw=2)
    axis.plot(runs, found.cooks_distance, "o", color=DARK, ms=5)
    highest = float(np.nanmax(found.cooks_distance))
    if highest > 0.5:
        axis.axhline(1, color=MIDDLE, ls="--", lw=1, label="influential")
        axis.legend(fontsize=7)
        highest = max(highest, 1.0)
    if highest > 0:
        axis.set_ylim(0, 1.15 * highest)
    axis.set(xlabel="run, as listed", ylabel="Cook's distance", title="influence")


def box_cox_profile(axis: Axes, found: BoxCox) -> None:
    """ln of the residual sum of squares over the power, with its 95 % interval."""
    low, high = found.interval
    axis.plot(found.powers, found.log_residual, color=DARK)
    axis.axhline(found.limit, color="0.5", lw=0.8, ls="--")
    axis.axvspan(low, high, color=LIGHT, alpha=0.35, lw=0, label=f"95 %: {low:.2f} to {high:.2f}")
    axis.axvline(found.best, color=MIDDLE, lw=1.2, label=f"best {found.best:.2f}")
    axis.axvline(1, color="0.2", lw=1, ls=":", label="1: leave the response as it is")
    axis.set(xlabel="power of the response", ylabel="ln(residual sum of squares)", title="Box-Cox")
    axis.legend(fontsize=7)


# ---------------------------------------------------------------- beside gradients


def slopes(axis: Axes, pairs: Sequence[SlopePair], label: str) -> None:
    """Slopes of surfaces against gradients with 95 % intervals; `label` names the response.

    Filled: matters at 5 %.  Where the joint intervals disagree a point is orange and crossed.
    """
    named: dict[str, tuple[float, float]] = {}
    order = list(dict.fromkeys(pair.design for pair in pairs))
    drawn: set[str] = set()
    largest = max(abs(pair.gradient) for pair in pairs)
    for pair in pairs:
        axis.errorbar(
            pair.gradient,
            pair.surface,
            xerr=1.96 * pair.gradient_se,
            yerr=1.96 * pair.surface_se,
            fmt=MARKERS[order.index(pair.design) % len(MARKERS)],
            color=DARK if pair.agree else MIDDLE,
            mfc=None if pair.matters else "white",
            lw=0.8,
            label=None if pair.design in drawn else pair.design,
        )
        drawn.add(pair.design)
        if not pair.agree:
            axis.plot(pair.gradient, pair.surface, "x", color="black", ms=9)
        if pair.factor not in named and abs(pair.gradient) > NAMED_SLOPE * largest:
            named[pair.factor] = (pair.gradient, pair.surface)
    low, high = axis.get_xlim()
    axis.plot([low, high], [low, high], color="0.5", lw=0.8, zorder=0)
    axis.axhline(0, color="0.85", lw=0.6, zorder=0)
    axis.axvline(0, color="0.85", lw=0.6, zorder=0)
    axis.set(xlabel=f"gradient: d {label} / d ln p", ylabel="slope of the design's surface")
    axis.set_xlim(low, high)
    _name(axis, named)
    above(axis)


def _name(axis: Axes, named: dict[str, tuple[float, float]]) -> None:
    """Names beside points, towards the middle of the axis, one above the other."""
    middle, lowest = float(np.mean(axis.get_xlim())), -np.inf
    scale = 72.0 / axis.figure.dpi  # points a pixel
    for name, point in sorted(named.items(), key=lambda item: item[1][1]):
        height = scale * float(axis.transData.transform(point)[1])
        lowest = max(height + 4, lowest + APART)
        right = point[0] > middle
        away = {"ha": "right" if right else "left", "textcoords": "offset points", "fontsize": 8}
        axis.annotate(_pretty(name), point, (-7 if right else 7, lowest - height), **away)


def study_figure(found: StudyRecord) -> Figure:
    """Slopes of every response and where each method ended, one column a response."""
    compared, columns = found.compared(), len(found.observables)
    size = (4.8 * columns, 8.0)
    figure, axes = plt.subplots(2, columns, figsize=size, layout="constrained", squeeze=False)
    for column, name in enumerate(found.observables):
        label, above_it, below = label_of(name), axes[0, column], axes[1, column]
        slopes(above_it, [pair for pair in compared.slopes if pair.observable == name], label)
        if name in found.goals:
            endings(below, compared.endings, found.measured.targets[name], column, label)
        else:
            below.set_axis_off()
    return figure


def endings(
    axis: Axes, found: Sequence[MethodResult], target: Target, column: int, label: str
) -> None:
    """One response (`column` of the endings) at each method's end, packing by packing."""
    reach = (target.mean - target.scatter, target.mean + target.scatter)
    axis.axhspan(*reach, color=LIGHT, alpha=0.5, lw=0, label="measured ± scatter")
    for place, ending in enumerate(found):
        for shift, values, colour, mark, name in (
            (-0.1, ending.fitted[:, column], DARK, "o", "packings of the fit"),
            (0.1, ending.fresh[:, column], MIDDLE, "D", "fresh packings"),
        ):
            first = name if place == 0 else None
            at = np.full(len(values), place + shift)
            axis.plot(at, values, mark, color=colour, ms=5, label=first)
            ends = (place + shift - 0.07, place + shift + 0.07)
            axis.hlines(np.nanmean(values), *ends, colour, lw=2)
    axis.set_xticks(range(len(found)), [ending.method for ending in found])
    axis.set_xlim(-0.5, len(found) - 0.5)
    axis.set_ylabel(label)
    above(axis)


def _axis_label(factor: Factor) -> str:
    _, unit = _shown_in(factor)
    return _pretty(factor.name) + (f" ({unit})" if unit else "")


def _value(factor: Factor, value: float) -> str:
    size, unit = _shown_in(factor)
    return f"{_pretty(factor.name)} {value / size:.4g} {unit}".rstrip()


def _shown_in(factor: Factor) -> tuple[float, str]:
    """Size of the unit that figures use, and its name: long numbers of Pa are MPa."""
    if factor.unit == "Pa" and factor.log:
        return 1e6, "MPa"
    return 1.0, factor.unit.replace("^2", "²").replace("^3", "³")


def _pretty(name: str) -> str:
    return name.replace("_", " ")
