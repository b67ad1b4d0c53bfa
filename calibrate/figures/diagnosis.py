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
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from calibrate.figures.style import DARK, LIGHT, MIDDLE, marked
from calibrate.labtests.diagnosis.curves import TEST_FEATURES
from calibrate.records.base import Test
from calibrate.records.diagnosis import DiagnosisRecord, EffectRow, FeatureRow, NextTestRecord

SIZE = (4.9, 6.0)  # inches, of the first page's panels
BARS = (4.9, 3.6)
GREY = "0.62"
BASE = {"color": DARK, "ls": "--", "marker": "s", "mfc": "white", "ms": 4.5, "lw": 1.3}
BEST = {"color": MIDDLE, "ls": "-", "marker": "o", "ms": 3.5, "lw": 1.3}
TICKS = (5.0, 20.0, 100.0, 1e3, 1e4)  # of compressed scales
FURTHER = 1.5  # times the largest force that is compared; a record beyond it is cut
MARKS = 5  # numbers on an axis of differences, at most
LOCATIONS = 8  # of a further test that are drawn
STYLES = (("o", DARK), ("s", MIDDLE), ("^", "0.5"), ("D", LIGHT))
STATUS = {  # in words
    "found": "significant",
    "trivial": "significant, small",
    "absent": "would have shown",
    "inconclusive": "could not have shown",
}
Words = Callable[[str], str]


def where_figure(found: DiagnosisRecord, test: Test, words: Words) -> Figure:
    """One test's curves, and below them what is left of them in units of its own scatter.

    words turns the name of an explanation into plain words.
    """
    rows = [row for row in found.features if row.test == test]
    if rows and all(row.kind == "target" for row in rows):
        figure, axis = plt.subplots(figsize=BARS, layout="constrained")
        _targets(axis, rows)
    else:
        figure, axes = plt.subplots(2, figsize=SIZE, layout="constrained", height_ratios=(3, 2))
        names = " and ".join(words(name) for name in found.best)
        label = f"model with “{names}”" if _explained(found) else ""
        _curves(axes[0], found, test, rows, _wrapped(label, 42))
        _residuals(axes[1], found, test, rows)
    _legend(figure)
    return figure


def confined_figure(found: DiagnosisRecord, words: Words) -> Figure | None:
    """Curves of confined compression, and what is left of them, place by place."""
    return _where_measured(found, "confined", words)


def unconfined_figure(found: DiagnosisRecord, words: Words) -> Figure | None:
    """Curves of unconfined compression, and what is left of them, place by place."""
    return _where_measured(found, "unconfined", words)


def _where_measured(found: DiagnosisRecord, test: Test, words: Words) -> Figure | None:
    measured = any(row.test == test for row in found.features)
    return where_figure(found, test, words) if measured else None


def _explained(found: DiagnosisRecord) -> bool:
    """Whether there is an explanation to be drawn."""
    return bool(found.best) and found.which.verdict != "none"


def _legend(figure: Figure) -> None:
    """One legend above all axes of a figure, where it hides nothing."""
    named = marked(figure.axes)
    style = {"loc": "outside upper center", "ncols": 2, "frameon": False, "fontsize": 7}
    figure.legend(named.values(), named, **style)


def _curves(axis: Axes, found: DiagnosisRecord, test: Test, rows, label: str) -> None:
    for number, curves in enumerate(c for c in found.specimens if test in c):
        points = (curves[test].displacement_mm, curves[test].force_n)
        axis.plot(*points, color=GREY, lw=0.7, label="measured" if number == 0 else None)
    for segment in _flagged(found, test):
        mine = [row for row in rows if row.segment == segment]
        axis.plot(*_locations(mine, "measured"), color=LIGHT, lw=9, alpha=0.6, zorder=0,
                  solid_capstyle="round")  # fmt: skip
    if rows:
        axis.plot(*_locations(rows, "base"), **BASE, label="calibrated model")
        if label:
            axis.plot(*_locations(rows, "best"), **BEST, label=label)
    axis.set(xlabel=TEST_FEATURES[test].axis, ylabel="force (N)")
    axis.set_title(f"{test} compression", fontsize=9)
    ends = [x for row in ("measured", "base") for x in _locations(rows, row)[0]]
    if ends:
        room = 0.06 * (max(ends) - min(ends))
        axis.set_xlim(min(ends) - room, max(ends) + room)
        highest = max(f for row in ("measured", "base") for f in _locations(rows, row)[1])
        if axis.get_ylim()[1] > FURTHER * highest:  # a record that was pressed further
            axis.set_ylim(top=1.06 * highest)


def _locations(rows: Sequence[FeatureRow], column: str) -> tuple[list[float], list[float]]:
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
    order = list(dict.fromkeys(row.segment for row in rows))
    first = {name: -1 if name == "before contact" else i for i, name in enumerate(order)}
    rows = sorted(rows, key=lambda row: first[row.segment])
    error, band = (np.array([getattr(r, name) for r in rows]) for name in ("error", "band"))
    edge = float(np.median(band / error)) if len(rows) else 1.0
    axis.axhspan(-edge, edge, color="0.9", lw=0, zorder=0, label="95 % band, all places at once")
    axis.axhline(0, color="0.5", lw=0.8)
    drawn: list[float] = []
    for name, style in (("base", BASE), ("best", BEST))[: 2 if _explained(found) else 1]:
        value = np.array([(r.measured - getattr(r, name)) / r.error for r in rows])
        axis.plot(value, **{**style, "lw": 0.8})
        drawn += value.tolist()
    _segments(axis, rows, _flagged(found, test))
    axis.set_ylabel("measured − model\n(standard errors)")
    axis.set_xlim(-0.5, len(rows) - 0.5)
    _compressed(axis.yaxis, drawn, 2 * edge)


def _compressed(axis: XAxis | YAxis, values: Sequence[float], linear: float) -> None:
    """A scale that is linear near zero and logarithmic beyond, where values reach far."""
    low, high = min([*values, 0.0]), max([*values, 0.0])
    if max(-low, high) <= 3 * linear:
        return
    ends = 1.5 * min(low, -linear), 1.5 * max(high, linear)
    marks = [0.0, *(sign * mark for mark in TICKS for sign in (-1, 1))]
    marks = sorted(mark for mark in marks if ends[0] <= mark <= ends[1])
    if axis.axis_name == "y":
        axis.axes.set_yscale("symlog", linthresh=linear)
        axis.axes.set_ylim(*ends)
    else:
        axis.axes.set_xscale("symlog", linthresh=linear)
        axis.axes.set_xlim(*ends)
    axis.set_ticks(marks, [f"{mark:g}" for mark in marks])


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
    shown = [names[s] for s in starts]
    axis.set_xticklabels(shown, rotation=60, ha="right", rotation_mode="anchor", fontsize=7.5)
    axis.tick_params(axis="x", length=0)
    for text, start in zip(axis.get_xticklabels(), starts, strict=True):
        text.set_fontweight("bold" if names[start] in flagged else "normal")


def _targets(axis: Axes, rows: Sequence[FeatureRow]) -> None:
    """Numbers without curves: measured with the scatter of one specimen, and the model."""
    for x, row in enumerate(rows):
        measured, model = ("measured ± one specimen", "calibrated model") if not x else (None,) * 2
        bar = {"fmt": "D", "color": "0.35", "capsize": 4}
        axis.errorbar(x - 0.1, row.measured, row.scatter, **bar, label=measured)
        axis.plot(x + 0.1, row.base, **{**BASE, "ls": ""}, label=model)
    names = [row.name.rsplit("_", 1)[0].replace("_", " ") for row in rows]
    axis.set_xticks(range(len(rows)), names)
    axis.set_xlim(-0.6, len(rows) - 0.4)
    axis.set_ylabel(", ".join(dict.fromkeys(row.unit for row in rows)))
    axis.margins(y=0.3)


def probability_figure(found: DiagnosisRecord, words: Words, most: int = 6) -> Figure:
    """Probabilities of classes, likeliest first, none and unknown always among them."""
    every = found.explanations
    shown = [e for i, e in enumerate(every) if i < most or e.label in ("none", "unknown")]
    rest = sum(e.probability for e in every) - sum(e.probability for e in shown)
    names = [_wrapped(words(e.label), 38) for e in shown] + ["all others together"]
    lines = np.array([1.4 + name.count("\n") for name in names])
    rows = lines.sum() - np.cumsum(lines) + lines / 2
    figure, axis = plt.subplots(figsize=(BARS[0], 0.9 + 0.17 * lines.sum()), layout="constrained")
    for row, e in zip(rows, shown, strict=False):
        verdict, member = found.names(e.label), e.label in found.which.likely_set
        colour = MIDDLE if verdict else DARK if member else LIGHT
        axis.barh(row, e.probability, 1.0, color=colour, hatch="///" * verdict, edgecolor="white")
        axis.text(e.probability + 0.015, row, _percent(e.probability), va="center", fontsize=8)
    axis.barh(rows[-1], rest, 1.0, color=LIGHT, edgecolor="white")
    axis.text(rest + 0.015, rows[-1], _percent(rest), va="center", fontsize=8)
    axis.set_yticks(rows, names, fontsize=7)
    axis.set(xlim=(0, 1.17), xticks=np.linspace(0, 1, 6), xlabel="probability")
    of_verdict = "no cause is named" if found.which.reason else "hatched: the verdict"
    axis.set_title(f"{of_verdict}; dark: in the 90 % set", fontsize=8)
    axis.tick_params(axis="y", length=0)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def effects_figure(found: DiagnosisRecord, words: Words) -> Figure:
    """Every effect by itself: one-step strength over its standard error."""
    effects = found.which.effects
    size = (BARS[0], min(1.2 + 0.2 * len(effects), BARS[1]))
    figure, axis = plt.subplots(figsize=size, layout="constrained")
    rows = np.arange(len(effects))[::-1]
    axis.axvspan(-1.96, 1.96, color="0.9", lw=0, label="not significant at 5 %")
    for row, effect in zip(rows, effects, strict=True):
        axis.plot([0, effect.z], [row, row], color="0.7", lw=1, zorder=1)
        axis.plot(effect.z, row, **_mark(effect), label=STATUS[effect.status])
    axis.axvline(0, color="0.5", lw=0.8)
    axis.set_yticks(rows, [words(effect.name) for effect in effects], fontsize=8)
    axis.set_ylim(-0.7, len(effects) - 0.3)
    axis.set_xlabel("strength / its standard error")
    axis.tick_params(axis="y", length=0)
    _compressed(axis.xaxis, [effect.z for effect in effects], 4.0)
    _legend(figure)
    return figure


def _mark(effect: EffectRow) -> dict:
    """How an effect's status is drawn."""
    colour, fill, shape = {
        "found": (MIDDLE, MIDDLE, "o"),
        "trivial": (MIDDLE, "white", "o"),
        "absent": (DARK, "white", "s"),
        "inconclusive": ("0.5", "0.5", "x"),
    }[effect.status]
    return {"color": colour, "mfc": fill, "marker": shape, "ms": 6, "ls": "", "zorder": 3}


def proposed_figure(found: DiagnosisRecord, words: Words) -> Figure | None:
    """What the proposed test would show under each of the leading explanations."""
    return next_figure(found.next_test, words)


def unit_of(label: str) -> str:
    """The unit of what a further test shows."""
    return "mm" if label.endswith("mm") or label.startswith(("displacement", "travel")) else "N"


def next_figure(proposal: NextTestRecord | None, words: Words) -> Figure | None:
    """What the proposed test would show under each leading explanation, less their mean, at
    the locations that tell them apart best."""
    if proposal is None:
        return None
    units = {label: unit_of(label) for label in proposal.labels}
    values = np.array(list(proposal.predicted.values()))
    away, deviation = values - values.mean(axis=0), np.array(proposal.deviation)
    locations = np.sort(np.argsort(-np.ptp(away, axis=0) / deviation)[:LOCATIONS])
    groups = [[i for i in locations if units[proposal.labels[i]] == unit] for unit in ("mm", "N")]
    groups = [group for group in groups if group]
    size = (BARS[0], 1.4 + 0.32 * len(locations) + 0.4 * len(groups))
    figure = plt.figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(groups), height_ratios=[len(g) + 1 for g in groups], squeeze=False)
    for axis, group in zip(axes[:, 0], groups, strict=True):
        _predictions(axis, list(map(words, proposal.predicted)), away[:, group], deviation[group])
        labels = [proposal.labels[i].removesuffix(", mm").removesuffix(", N") for i in group]
        axis.set_yticks(-np.arange(len(group)), [_wrapped(x, 32) for x in labels], fontsize=7)
        unit = units[proposal.labels[group[0]]]
        axis.set_xlabel(f"difference from their mean ({unit})")
    _legend(figure)
    return figure


def _predictions(axis: Axes, names: Sequence[str], away: np.ndarray, deviation: np.ndarray) -> None:
    """Predicted values (explanations, locations) as one row of points a location."""
    rows = -np.arange(away.shape[1])
    for number, name in enumerate(names):
        mark, colour = STYLES[number % len(STYLES)]
        style = {"fmt": mark, "color": colour, "ms": 4.5, "capsize": 2, "elinewidth": 1}
        shift = 0.14 * (number - (len(names) - 1) / 2)
        label = _wrapped(name, 40)
        axis.errorbar(away[number], rows - shift, xerr=deviation, label=label, **style)
    axis.axvline(0, color="0.7", lw=0.8, zorder=0)
    axis.xaxis.set_major_locator(MaxNLocator(MARKS))


def _percent(value: float) -> str:
    return "> 99 %" if value > 0.995 else f"{100 * value:.0f} %" if value >= 0.01 else "< 1 %"


def _wrapped(text: str, width: int = 30) -> str:
    return "\n".join(textwrap.wrap(text, width))
