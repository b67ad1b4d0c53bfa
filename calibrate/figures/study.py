"""Panels of a study by designed experiments beside gradients: each function fills one axis."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from calibrate.designs.comparison import Ending, SlopePair
from calibrate.figures.style import DARK, LIGHT, MIDDLE, above, pretty
from calibrate.records.base import Target

NAMED = 0.15  # of the largest slope: smaller ones lie too close together to be named
MARKERS = "sDo"  # of designs, in the order in which they appear


def slopes(axis: Axes, pairs: Sequence[SlopePair], label: str) -> None:
    """Slopes of surfaces against gradients with 95 % intervals; `label` names the response.

    Filled: matters at 5 %.  Where the joint intervals disagree a point is orange and crossed.
    """
    named: set[str] = set()
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
        if pair.factor not in named and abs(pair.gradient) > NAMED * largest:
            named.add(pair.factor)
            at = (pair.gradient, pair.surface)
            axis.annotate(pretty(pair.factor), at, (5, 4), textcoords="offset points", fontsize=8)
    low, high = axis.get_xlim()
    axis.plot([low, high], [low, high], color="0.5", lw=0.8, zorder=0)
    axis.axhline(0, color="0.85", lw=0.6, zorder=0)
    axis.axvline(0, color="0.85", lw=0.6, zorder=0)
    axis.set(xlabel=f"gradient: d {label} / d ln p", ylabel="slope of the design's surface")
    axis.legend(frameon=False, fontsize=8)


def endings(axis: Axes, found: Sequence[Ending], target: Target, column: int, label: str) -> None:
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
