"""Figures of a diagnosis: where the gap lies, which explanation is likely, what would settle it.

All are drawn from a record.  Measured is thin and grey, the calibrated model without an effect
dark and dashed with open squares, with the best explanation orange and solid with dots: shapes
tell them apart where colours do not.
"""

import textwrap
from collections.abc import Callable, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibrate.plotting.style import DARK, LIGHT, MIDDLE, above
from calibrate.records.base import Test
from calibrate.records.diagnosis import DiagnosisRecord, Effect, FeatureRow

SIZE = (4.9, 6.0)  # inches, of the first page's panels
BARS = (4.9, 3.6)
GREY = "0.62"
BASE = {"color": DARK, "ls": "--", "marker": "s", "mfc": "white", "ms": 4.5, "lw": 1.3}
BEST = {"color": MIDDLE, "ls": "-", "marker": "o", "ms": 3.5, "lw": 1.3}
AXES: dict[Test, str] = {
    "confined": "displacement, from half the largest force on loading (mm)",
    "unconfined": "displacement, from the seating force (mm)",
}
MARKS = {"found": "●", "trivial": "◐", "absent": "○", "inconclusive": "?"}
Words = Callable[[str], str]


def where_figure(found: DiagnosisRecord, test: Test, words: Words) -> Figure:
    """One test's curves, and below them what is left of them in units of its own scatter.

    words turns the name of an explanation into plain words.
    """
    figure, (top, below) = plt.subplots(
        2, 1, figsize=SIZE, layout="constrained", height_ratios=(3, 2)
    )
    rows = [row for row in found.features if row.test == test]
    label = f"with {' and '.join(words(name) for name in found.best)}" if found.best else ""
    if found.targets_only:
        _targets(top, rows)
    else:
        _curves(top, found, test, rows, label)
    _residuals(below, found, test, rows)
    above(top)
    return figure


def _curves(axis: Axes, found: DiagnosisRecord, test: Test, rows, label: str) -> None:
    for number, curves in enumerate(c for c in found.specimens if test in c):
        points = (curves[test].displacement_mm, curves[test].force_n)
        axis.plot(*points, color=GREY, lw=0.7, label="measured" if number == 0 else None)
    for segment in _flagged(found, test):
        mine = [row for row in rows if row.segment == segment]
        axis.plot(*_places(mine, "measured"), color=LIGHT, lw=9, alpha=0.6, zorder=0,
                  solid_capstyle="round")  # fmt: skip
    if rows:
        axis.plot(*_places(rows, "base"), **BASE, label="calibrated model")
        if label:
            axis.plot(*_places(rows, "best"), **BEST, label=label)
    axis.set(xlabel=AXES[test], ylabel="force (N)", title=f"{test} compression")
    axis.title.set_position((0.5, 1.1))
    ends = [x for row in ("measured", "base") for x in _places(rows, row)[0]]
    if ends:
        room = 0.06 * (max(ends) - min(ends))
        axis.set_xlim(min(ends) - room, max(ends) + room)


def _places(rows: Sequence[FeatureRow], column: str) -> tuple[list[float], list[float]]:
    """Displacement (mm) and force (N) of features along a test, in its order."""
    value = {row.kind: getattr(row, column) for row in rows}
    points = []
    up = sorted((r for r in rows if r.kind == "loading"), key=lambda r: r.abscissa)
    points += [(getattr(r, column), r.abscissa) for r in up]
    if up and {"largest force", "travel at the top"} <= set(value):
        points.append((points[-1][0] + value["travel at the top"], value["largest force"]))
    down = sorted((r for r in rows if r.kind == "unloading"), key=lambda r: -r.abscissa)
    points += [(getattr(r, column), r.abscissa) for r in down]
    crushed = sorted((r for r in rows if r.kind == "crushing"), key=lambda r: r.abscissa)
    points += [(r.abscissa, getattr(r, column)) for r in crushed]
    return [x for x, _ in points], [f for _, f in points]


def _flagged(found: DiagnosisRecord, test: Test) -> list[str]:
    return list(dict.fromkeys(s.segment for s in found.where if s.test == test and s.outside_band))


def _residuals(axis: Axes, found: DiagnosisRecord, test: Test, rows: Sequence[FeatureRow]) -> None:
    """Measured minus simulated over its standard error, feature by feature, with the band."""
    x = np.arange(len(rows))
    error, band = (np.array([getattr(r, name) for r in rows]) for name in ("error", "band"))
    edge = float(np.median(band / error)) if len(rows) else 1.0
    axis.axhspan(-edge, edge, color="0.9", lw=0, zorder=0, label="95 % band, all places at once")
    axis.axhline(0, color="0.5", lw=0.8)
    for name, style in (("base", BASE), ("best", BEST)):
        value = np.array([(r.measured - getattr(r, name)) / r.error for r in rows])
        if np.isfinite(value).any():
            axis.plot(x, value, **{**style, "lw": 0.8})
    _segments(axis, rows, _flagged(found, test))
    axis.set_ylabel("measured − model\n(standard errors)")
    axis.set_xlim(-0.7, len(rows) - 0.3)
    axis.legend(frameon=False, fontsize=7, loc="upper right")
    low, high = axis.get_ylim()
    axis.set_ylim(low, high + 0.12 * (high - low))


def _segments(axis: Axes, rows: Sequence[FeatureRow], flagged: Sequence[str]) -> None:
    """Names of segments below the axis; those that leave the band are shaded and bold."""
    names = [row.segment for row in rows]
    starts = [i for i, name in enumerate(names) if i == 0 or names[i - 1] != name]
    ends = [*starts[1:], len(names)]
    for start, end in zip(starts, ends, strict=True):
        on = names[start] in flagged
        if on:
            axis.axvspan(
                start - 0.5,
                end - 0.5,
                fc=LIGHT,
                alpha=0.45,
                hatch="///",
                ec="white",
                lw=0,
                zorder=0.5,
            )
        axis.axvline(end - 0.5, color="0.8", lw=0.6)
    axis.set_xticks([(s + e - 1) / 2 for s, e in zip(starts, ends, strict=True)])
    axis.set_xticklabels([names[s] for s in starts], rotation=30, ha="right", fontsize=8)
    axis.tick_params(axis="x", length=0)
    for text, start in zip(axis.get_xticklabels(), starts, strict=True):
        text.set_fontweight("bold" if names[start] in flagged else "normal")


def _targets(axis: Axes, rows: Sequence[FeatureRow]) -> None:
    """Numbers without curves: measured with the scatter of one specimen, and the model."""
    for place, row in enumerate(rows):
        first = place == 0
        axis.errorbar(place - 0.1, row.measured, row.scatter, fmt="D", color="0.35", capsize=4,
                      label="measured ± one specimen" if first else None)  # fmt: skip
        axis.plot(
            place + 0.1, row.base, **{**BASE, "ls": ""}, label="calibrated model" if first else None
        )
    axis.set_xticks(
        range(len(rows)), [row.name.rsplit("_", 1)[0].replace("_", " ") for row in rows]
    )
    axis.set_xlim(-0.6, len(rows) - 0.4)
    axis.set_ylabel(", ".join(dict.fromkeys(row.unit for row in rows)))
    axis.margins(y=0.3)


def probability_figure(found: DiagnosisRecord, words: Words, most: int = 7) -> Figure:
    """Probabilities of classes, likeliest first, none and unknown always among them."""
    figure, axis = plt.subplots(figsize=BARS, layout="constrained")
    ends = ("none", "unknown")
    every = found.explanations
    shown = [e for i, e in enumerate(every) if i < most or e.label in ends]
    rest = sum(e.probability for e in every) - sum(e.probability for e in shown)
    names = [words(e.label) for e in shown] + ["all others together"]
    values = [e.probability for e in shown] + [max(rest, 0.0)]
    named = [e.label == found.which.verdict for e in shown] + [False]
    in_set = [e.label in found.which.likely_set for e in shown] + [False]
    rows = np.arange(len(names))[::-1]
    for row, value, verdict, member in zip(rows, values, named, in_set, strict=True):
        axis.barh(row, value, 0.65, color=MIDDLE if verdict else DARK if member else LIGHT,
                  hatch="///" if verdict else "", edgecolor="white")  # fmt: skip
        axis.text(value + 0.015, row, _percent(value), va="center", fontsize=8)
    axis.set_yticks(rows, [_wrapped(name) for name in names], fontsize=8)
    axis.set(xlim=(0, 1.12), xlabel="probability")
    axis.set_title("hatched: the verdict; dark: in the 90 % set", fontsize=8)
    axis.tick_params(axis="y", length=0)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def effects_figure(found: DiagnosisRecord, words: Words) -> Figure:
    """Every effect by itself: one-step strength over its standard error."""
    figure, axis = plt.subplots(figsize=BARS, layout="constrained")
    effects = found.which.effects
    rows = np.arange(len(effects))[::-1]
    axis.axvspan(-1.96, 1.96, color="0.9", lw=0, label="not significant at 5 %")
    for row, effect in zip(rows, effects, strict=True):
        axis.plot([0, effect.z], [row, row], color="0.7", lw=1, zorder=1)
        axis.plot(effect.z, row, **_mark(effect))
    for status in MARKS:
        alike = next((e for e in effects if e.status == status), None)
        if alike is not None:
            axis.plot([], [], **_mark(alike), label=status)
    axis.axvline(0, color="0.5", lw=0.8)
    axis.set_yticks(rows, [words(effect.name) for effect in effects], fontsize=8)
    axis.set_xlabel("strength / its standard error")
    axis.tick_params(axis="y", length=0)
    above(axis)
    return figure


def _mark(effect: Effect) -> dict:
    """How an effect's status is drawn."""
    colour, fill, shape = {
        "found": (MIDDLE, MIDDLE, "o"),
        "trivial": (MIDDLE, "white", "o"),
        "absent": (DARK, "white", "s"),
        "inconclusive": ("0.5", "0.5", "x"),
    }[effect.status]
    return {"color": colour, "mfc": fill, "marker": shape, "ms": 6, "ls": "", "zorder": 3}


def next_figure(found: DiagnosisRecord, words: Words) -> Figure:
    """What the proposed test would show under each leading explanation, with the deviation of
    its mean."""
    assert found.next_test is not None, "draw this where a test is proposed"
    proposal = found.next_test
    figure, axis = plt.subplots(figsize=BARS, layout="constrained")
    labels = proposal.labels
    x, count = np.arange(len(labels)), len(proposal.predicted)
    values = np.array(list(proposal.predicted.values()))
    middle = values.mean(axis=0) if len(labels) > MANY else np.zeros(len(labels))
    styles = (("o", DARK), ("s", MIDDLE), ("^", "0.5"), ("D", LIGHT))
    for place, (name, row) in enumerate(zip(proposal.predicted, values, strict=True)):
        mark, colour = styles[place % len(styles)]
        shift = 0.12 * (place - (count - 1) / 2)
        axis.errorbar(x + shift, row - middle, proposal.deviation, fmt=mark, color=colour, ms=5,
                      capsize=2, elinewidth=1, label=words(name))  # fmt: skip
    axis.axhline(0, color="0.7", lw=0.8, zorder=0)
    _ticks(axis, x, labels)
    what = "difference from their mean" if len(labels) > MANY else "predicted"
    axis.set_ylabel(f"{what} (mm or N, as named)")
    above(axis)
    axis.set_title(proposal.name, fontsize=9, pad=28)
    return figure


MANY = 6  # places beyond which curves are drawn as differences


def _ticks(axis: Axes, x: np.ndarray, labels: Sequence[str]) -> None:
    step = max(1, len(labels) // 9)
    axis.set_xticks(x[::step], [_wrapped(label, 18) for label in labels[::step]])
    axis.tick_params(axis="x", labelsize=7, rotation=30 if len(labels) > 3 else 0)


def _percent(value: float) -> str:
    return f"{100 * value:.0f} %" if value >= 0.01 else "< 1 %"


def _wrapped(text: str, width: int = 30) -> str:
    return "\n".join(textwrap.wrap(text, width))
