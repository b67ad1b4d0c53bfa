"""Figures of a study by designed experiments beside gradients."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from calibrate.doe.comparison import Comparison, Ending, SlopePair
from calibrate.doe.study import OBSERVABLES
from calibrate.measurements import Target
from calibrate.plotting.style import DARK, LIGHT, MIDDLE, save

LABELS = {
    "depression_depth_mm": "depression depth (mm)",
    "crushing_force_n": "crushing force (N)",
}
NAMED = 0.15  # of the largest slope: smaller ones lie too close together to be named
MARKERS = {"screening": "s", "depth": "D", "force": "o"}


def slopes_figure(found: Comparison, path: Path) -> None:
    """Slopes of surfaces against gradients with 95 % intervals, one panel a response."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for axis, observable in zip(axes, OBSERVABLES, strict=True):
        _slopes(axis, [pair for pair in found.slopes if pair.observable == observable])
        axis.set(
            xlabel=f"gradient: d {LABELS[observable]} / d ln p",
            ylabel="slope of the design's surface",
        )
    save(figure, path)


def _slopes(axis: Axes, pairs: Sequence[SlopePair]) -> None:
    designs, named = set(), set()
    largest = max(abs(pair.gradient) for pair in pairs)
    for pair in pairs:
        first = pair.design not in designs
        designs.add(pair.design)
        axis.errorbar(
            pair.gradient,
            pair.surface,
            xerr=1.96 * pair.gradient_se,
            yerr=1.96 * pair.surface_se,
            fmt=MARKERS[pair.design],
            color=DARK if pair.agree else MIDDLE,
            mfc="white" if not pair.matters else None,
            lw=0.8,
            label=pair.design if first else None,
        )
        if pair.factor not in named and abs(pair.gradient) > NAMED * largest:
            named.add(pair.factor)
            words = pair.factor.replace("_", " ")
            axis.annotate(
                words, (pair.gradient, pair.surface), (5, 4), textcoords="offset points", fontsize=8
            )
    low, high = axis.get_xlim()
    axis.plot([low, high], [low, high], color="0.5", lw=0.8, zorder=0)
    axis.axhline(0, color="0.85", lw=0.6, zorder=0)
    axis.axvline(0, color="0.85", lw=0.6, zorder=0)
    axis.set_title("filled: matters at 5 %; orange: 95 % intervals disagree", fontsize=9)
    axis.legend(frameon=False, fontsize=8)


def endings_figure(endings: Sequence[Ending], targets: dict[str, Target], path: Path) -> None:
    """Both responses at each method's end, packing by packing, with the targets' scatter."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for m, (axis, observable) in enumerate(zip(axes, OBSERVABLES, strict=True)):
        wanted = targets[observable]
        low, high = wanted.mean - wanted.scatter, wanted.mean + wanted.scatter
        axis.axhspan(low, high, color=LIGHT, alpha=0.5, lw=0, label="measured ± scatter")
        for place, ending in enumerate(endings):
            for shift, values, colour, mark, label in (
                (-0.1, ending.fitted[:, m], DARK, "o", "packings of the fit"),
                (0.1, ending.fresh[:, m], MIDDLE, "D", "fresh packings"),
            ):
                first = label if place == 0 else None
                axis.plot(np.full(len(values), place + shift), values, mark, color=colour, ms=5)
                axis.hlines(
                    np.nanmean(values),
                    place + shift - 0.07,
                    place + shift + 0.07,
                    colour,
                    lw=2,
                    label=first,
                )
        axis.set_xticks(range(len(endings)), [ending.method for ending in endings])
        axis.set_xlim(-0.5, len(endings) - 0.5)
        axis.set_ylabel(LABELS[observable])
    axes[0].legend(frameon=False, fontsize=8)
    save(figure, path)
