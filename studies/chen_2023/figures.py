"""Two comparisons for reports: points against a line of agreement, and bars side by side.

Each returns one drawing as SVG text, sized for a column that a phone can show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

from calibrate.figures.style import DARK, LIGHT, MIDDLE, PANEL, svg


@dataclass(frozen=True, eq=False)
class Agreement:
    """Points x (n,) and y (n,) in one unit that should agree, y ± y_reach (n,).

    `repeats` (k, 2) are single runs behind a mean; `named` gives words to some points by their
    place, and marks them as those that do not agree.
    """

    x: np.ndarray
    y: np.ndarray
    y_reach: np.ndarray
    xlabel: str
    ylabel: str
    repeats: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    named: Mapping[int, str] = field(default_factory=dict)


def agreement_svg(picture: Agreement) -> str:
    """Points with their reach and the line on which both are equal."""
    figure, axis = plt.subplots(figsize=PANEL, layout="constrained")
    both = np.concatenate([picture.x, picture.y, picture.repeats.ravel()])
    room = 0.05 * np.ptp(both)
    ends = [both.min() - room, both.max() + room]
    axis.plot(ends, ends, color="0.6", lw=1, zorder=0, label="equal")
    if len(picture.repeats):
        label = "single runs at the centre"
        axis.plot(*picture.repeats.T, "|", color=LIGHT, ms=11, mew=2, label=label)
    off = np.isin(np.arange(len(picture.x)), list(picture.named))
    for chosen, mark, colour, label in (
        (~off, "o", DARK, "agree within rounding"),
        (off, "D", MIDDLE, "do not agree"),
    ):
        if np.any(chosen):
            points = (picture.x[chosen], picture.y[chosen], picture.y_reach[chosen])
            axis.errorbar(*points, fmt=mark, color=colour, ms=5.5, elinewidth=1, label=label)
    for place, words in picture.named.items():
        at = (picture.x[place], picture.y[place])
        axis.annotate(words, at, (-6, 12), textcoords="offset points", ha="right")
    axis.set(xlabel=picture.xlabel, ylabel=picture.ylabel, xlim=ends, ylim=ends)
    axis.set_aspect("equal")
    axis.xaxis.set_major_locator(MaxNLocator(6))
    axis.yaxis.set_major_locator(MaxNLocator(6))
    axis.legend(frameon=False, loc="upper left")
    return svg(figure)


def bars_svg(
    names: Sequence[str], series: Mapping[str, np.ndarray], xlabel: str, line: float | None = None
) -> str:
    """Horizontal bars: for each name one of each series (at most two); `line` is a threshold."""
    figure, axis = plt.subplots(figsize=PANEL, layout="constrained")
    rows = np.arange(len(names))[::-1]
    styles = ((0.2, DARK, ""), (-0.2, LIGHT, "////"))
    for (label, values), (shift, colour, hatch) in zip(series.items(), styles, strict=False):
        axis.barh(
            rows + shift, values, 0.36, color=colour, hatch=hatch, edgecolor="white", label=label
        )
    if line is not None:
        axis.axvline(line, color="0.35", lw=1, ls="--")
    axis.set_yticks(rows, [name.replace("_", " ") for name in names])
    axis.tick_params(axis="y", length=0)
    axis.spines[["top", "right"]].set_visible(False)
    axis.set_xlabel(xlabel)
    figure.legend(frameon=False, loc="outside upper center", ncols=len(series))
    return svg(figure)
