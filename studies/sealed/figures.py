"""Figures of withheld cases: how often right, how sure rightly, what is taken for what.

Each returns one drawing as SVG text for a column that a phone can show.  Marks differ in shape
and fill, maps in lightness alone, so that all survive a greyscale printer.  Bars are 95 %
Clopper-Pearson intervals.
"""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from scipy import stats

from calibrate.figures.style import DARK, LIGHT, MIDDLE
from studies.sealed.confusion import ConfusionMatrix

SIZE = (4.6, 3.9)  # inches; text keeps a readable size at 340 px
OURS = "this diagnosis"
MARKS: tuple[dict[str, Any], ...] = (
    {"marker": "o", "color": DARK, "mfc": DARK, "ls": "-"},
    {"marker": "s", "color": MIDDLE, "mfc": "white", "ls": "--"},
    {"marker": "^", "color": MIDDLE, "mfc": MIDDLE, "ls": ":"},
    {"marker": "D", "color": "0.45", "mfc": "white", "ls": "-."},
    {"marker": "v", "color": "0.65", "mfc": "0.65", "ls": ":"},
)
Share = Mapping[str, float | int | None]  # value, low, high, n


def accuracy_svg(centres: Sequence[float], series: Mapping[str, Sequence[Share]]) -> str:
    """Share of right classes over signal-to-noise: for each of `series` one share a centre."""
    figure, axis = plt.subplots(figsize=SIZE, layout="constrained")
    for place, (name, shares) in enumerate(series.items()):
        shift = 1 + 0.045 * (place - (len(series) - 1) / 2)
        _shares(axis, np.array(centres) * shift, shares, name, place)
    axis.set(xscale="log", ylim=(-0.03, 1.03), ylabel="right class named first")
    axis.set_xlabel("projected signal-to-noise of the hidden effect")
    ticks = [0.5, 1, 2, 4, 6, 10, 15]
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    _open(axis)
    figure.legend(frameon=False, loc="outside upper center", ncols=3, fontsize=8)
    return _svg(figure)


def _shares(axis: Axes, x: np.ndarray, shares: Sequence[Share], name: str, place: int) -> None:
    y, low, high = (_values(shares, key) for key in ("value", "low", "high"))
    style, first = MARKS[place % len(MARKS)], place == 0
    keep = np.isfinite(y)
    reach = np.array([y - low, high - y])[:, keep]
    axis.errorbar(
        x[keep], y[keep], reach, ms=6 if first else 4.5, lw=1.6 if first else 0.9,
        elinewidth=1.4 if first else 0.7, capsize=2.5, zorder=3 if first else 2, label=name,
        **style,
    )  # fmt: skip


def reliability_svg(bins: Sequence[Mapping]) -> str:
    """Share that was right over the probability stated, `bins` with `stated` and `right`; the
    grey band holds 95 % of what a perfect forecaster shows in each bin."""
    figure, (axis, below) = plt.subplots(
        2, 1, figsize=(4.6, 4.6), layout="constrained", height_ratios=(4, 1), sharex=True
    )
    stated = np.array([b["stated"] for b in bins])
    shares = [b["right"] for b in bins]
    count = np.array([share["n"] for share in shares])
    band = stats.binom.interval(0.95, count, stated)
    low, high = (np.clip(end, 0, count) / count for end in band)
    axis.bar(stated, high - low, 0.05, low, color="0.85", label="perfect forecaster, 95 %")
    axis.plot([0, 1], [0, 1], color="0.5", lw=1, label="said as it is")
    y, bottom, top = (_values(shares, key) for key in ("value", "low", "high"))
    axis.errorbar(stated, y, [y - bottom, top - y], fmt="o", color=DARK, capsize=2.5, ms=5.5,
                  label=OURS)  # fmt: skip
    axis.set(xlim=(-0.02, 1.02), ylim=(-0.03, 1.03), ylabel="share that was right")
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    below.bar(stated, count, 0.05, color=LIGHT, edgecolor=DARK, lw=0.6)
    for x, n in zip(stated, count, strict=True):
        below.annotate(str(n), (x, n), (0, 2), textcoords="offset points", ha="center", fontsize=7)
    below.set(xlabel="probability stated for the verdict", ylabel="cases")
    below.set_ylim(0, 1.35 * count.max())
    _open(axis)
    _open(below)
    return _svg(figure)


def named_svg(table: ConfusionMatrix) -> str:
    """What was named for what was hidden: shares of each row in grey, counts as numbers; right
    answers are framed, and cells without cases stay empty."""
    rows, columns = len(table.rows), len(table.columns)
    figure, axis = plt.subplots(figsize=(8.2, 0.36 * rows + 2.2), layout="constrained")
    total = table.counts.sum(axis=1, keepdims=True)
    share = table.counts / np.maximum(total, 1)
    axis.imshow(share, cmap="Greys", vmin=0, vmax=1.15, aspect="auto")
    for r, c in zip(*np.nonzero(table.counts), strict=True):
        colour = "white" if share[r, c] > 0.5 else "black"
        axis.text(c, r, str(table.counts[r, c]), ha="center", va="center", color=colour, fontsize=9)
    for r, c in zip(*np.nonzero(table.right), strict=True):
        frame = Rectangle((c - 0.5, r - 0.5), 1, 1, fill=False, ec=MIDDLE, lw=1.8, clip_on=False)
        axis.add_patch(frame)
    labels = [f"{name} ({n})" for name, n in zip(table.rows, total[:, 0], strict=True)]
    axis.set_yticks(range(rows), labels)
    axis.set_xticks(range(columns), table.columns, rotation=45, ha="left", rotation_mode="anchor")
    axis.xaxis.tick_top()
    axis.set_xticks(np.arange(columns + 1) - 0.5, minor=True)
    axis.set_yticks(np.arange(rows + 1) - 0.5, minor=True)
    axis.grid(which="minor", color="0.85", lw=0.6)
    axis.tick_params(which="both", length=0)
    axis.set_ylabel("hidden (cases)")
    axis.set_xlabel("named")
    axis.xaxis.set_label_position("top")
    return _svg(figure)


def shrinkage_svg(
    claimed: Sequence[float], realised: Sequence[float], errors: Sequence[float], close: float
) -> str:
    """Share of the gap that goes: claimed against realised on fresh specimens, with the standard
    errors of these; the band is `close` (a share) about equality.  Points beyond the axes stand at
    their edge, hollow."""
    figure, axis = plt.subplots(figsize=SIZE, layout="constrained")
    x, y = np.array(claimed, float), np.array(realised, float)
    ends = np.array([-0.25, 1.1])
    axis.fill_between(ends, ends - close, ends + close, color="0.88", lw=0,
                      label=f"within {100 * close:.0f} points")  # fmt: skip
    axis.plot(ends, ends, color="0.5", lw=1, label="equal")
    axis.errorbar(x, np.clip(y, *ends), errors, fmt="none", ecolor="0.6", lw=0.8, zorder=1)
    beyond = (x < ends[0]) | (x > ends[1]) | (y < ends[0]) | (y > ends[1])
    near = np.abs(x - y) <= close
    for chosen, mark, colour, label in (
        (near, "o", DARK, "within"), (~near, "D", MIDDLE, "not within"),
    ):  # fmt: skip
        for hollow in (False, True):
            points = chosen & (beyond == hollow)
            fill, words = ("white", None) if hollow else (colour, label)
            axis.plot(np.clip(x[points], *ends), np.clip(y[points], *ends), mark, color=colour,
                      mfc=fill, ms=5, label=words, clip_on=False)  # fmt: skip
    axis.set(xlim=ends, ylim=ends, xlabel="shrinkage claimed (share of the gap)",
             ylabel="shrinkage on fresh specimens (share)")  # fmt: skip
    axis.set_aspect("equal")
    _open(axis)
    figure.legend(frameon=False, loc="outside upper center", ncols=4, fontsize=8)
    return _svg(figure)


def alarms_svg(shares: Mapping[str, Share], bound: float) -> str:
    """Something is named although nothing is hidden: a share for each diagnosis, and the bound."""
    figure, axis = plt.subplots(figsize=(4.6, 2.6), layout="constrained")
    place = np.arange(len(shares))[::-1]
    y, low, high = (_values(list(shares.values()), key) for key in ("value", "low", "high"))
    colours = [DARK, *[LIGHT] * (len(shares) - 1)]
    axis.barh(place, y, 0.6, color=colours, edgecolor=DARK, lw=0.6)
    axis.errorbar(y, place, xerr=[y - low, high - y], fmt="none", ecolor="0.2", lw=1, capsize=2.5)
    axis.axvline(bound, color=MIDDLE, lw=1.2, ls="--", label=f"asked: at most {100 * bound:.0f} %")
    axis.set_yticks(place, list(shares))
    axis.set(xlim=(0, 1.02), xlabel="false alarms (share of cases with nothing hidden)")
    axis.tick_params(axis="y", length=0)
    _open(axis)
    figure.legend(frameon=False, loc="outside upper center", fontsize=8)
    return _svg(figure)


def _values(shares: Sequence[Share], key: str) -> np.ndarray:
    return np.array([np.nan if share[key] is None else share[key] for share in shares], float)


def _open(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)


def _svg(figure: Figure) -> str:
    """The drawing as text, the same bytes every time; the figure is closed."""
    text = io.StringIO()
    with plt.rc_context({"svg.hashsalt": "calibrate"}):
        figure.savefig(text, format="svg", metadata={"Date": None})
    plt.close(figure)
    return text.getvalue()
