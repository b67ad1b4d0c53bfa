"""Pictures of laboratory data and of beds: the preview of a converted export, a bed's forces.

Colours differ in lightness as well as hue, so figures survive greyscale.
"""

import textwrap
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibrate.figures.style import DARK, MIDDLE, marked
from calibrate.instrument_import.convert import Export
from calibrate.instrument_import.specimens import Specimen
from calibrate.instrument_import.strengths import Strengths
from calibrate.labtests.composite import TYPES

PALE = "0.72"
MOST_PANELS = 12
COLUMNS = 3
TEXT_WIDTH = 128  # characters of a line below the panels
MOST_LINES = 40
CHINESE = ("Noto Sans CJK SC", "WenQuanYi Zen Hei", "Microsoft YaHei", "SimHei", "PingFang SC")


def preview_figure(export: Export) -> Figure:
    """Each specimen as recorded and as kept, with what was assumed written underneath."""
    shown = export.specimens[:MOST_PANELS]
    columns = max(min(COLUMNS, len(shown)), 1)
    rows = max(-(-len(shown) // columns), 1)
    lines = _assumptions(export)
    text_height = 0.4 + 0.165 * len(lines)
    figure = plt.figure(figsize=(10.5, 3.4 * rows + text_height), layout="constrained")
    heights = [3.4] * rows + [text_height]
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=heights)
    for place, specimen in enumerate(shown):
        axis = figure.add_subplot(grid[place // columns, place % columns])
        _specimen(axis, specimen)
    if named := marked(figure.axes):
        figure.axes[0].legend(named.values(), named, fontsize=7, frameon=False)
    if export.strengths is not None:
        _strengths(figure.add_subplot(grid[0, 0]), export.strengths)
    below = figure.add_subplot(grid[rows, :])
    below.set_axis_off()
    below.text(0, 1, "\n".join(lines), fontsize=8, va="top", family=_fonts())
    return figure


def _fonts() -> list[str]:
    """The usual font, and those installed here that hold Chinese."""
    installed = set(font_manager.get_font_names())
    return ["DejaVu Sans", *(name for name in CHINESE if name in installed)]


def _drawable(text: str) -> str:
    """`text` with what no installed font can draw replaced, and no formulas in it."""
    fonts = [font_manager.get_font(font_manager.findfont(name)) for name in _fonts()]
    letters = (c if any(f.get_char_index(ord(c)) for f in fonts) else "?" for c in text)
    return "".join(letters).replace("$", r"\$")


def _specimen(axis: Axes, specimen: Specimen) -> None:
    """The record in grey, shifted to the curve's zeros, the kept curve over it."""
    raw = specimen.raw
    axis.plot(
        raw.displacement_mm - specimen.contact_mm,
        raw.force_n - specimen.zero_n,
        color=PALE,
        lw=3,
        label="recorded",
    )
    mark = "o-" if specimen.points else "-"
    kept = (specimen.displacement_mm, specimen.force_n)
    axis.plot(*kept, mark, ms=4, color=DARK, lw=1.2, label="kept")
    zero = "zero" if specimen.points else "contact"
    axis.axvline(0, color="0.5", lw=0.8, ls=":", label=zero)
    if specimen.unloading_mm is not None:
        axis.axvline(specimen.unloading_mm, color="0.5", lw=0.8, ls="--", label="unloading")
    if specimen.clipped:
        last = (specimen.displacement_mm[-1], specimen.force_n[-1])
        axis.plot(*last, "v", color=MIDDLE, ms=8, label="limit of the load cell")
    faults = sum(finding.fault for finding in specimen.findings)
    title = f"{_drawable(specimen.label[:34])}: {specimen.test}"
    title += f", {faults} warning(s)" if faults else ""
    axis.set_title(title, fontsize=9, family=_fonts())
    along, up = TYPES[specimen.test].axes
    axis.set(xlabel=along, ylabel=up)


def _strengths(axis: Axes, strengths: Strengths) -> None:
    """The crushing forces, one dot a specimen, and their mean."""
    numbers = range(1, len(strengths.force_n) + 1)
    axis.plot(numbers, strengths.force_n, "o", color=DARK, ms=5)
    axis.axhline(strengths.force_n.mean(), color="0.5", lw=0.8, ls="--")
    axis.set_title(f"{strengths.test}: {len(strengths.force_n)} strengths", fontsize=9)
    axis.set(xlabel="specimen", ylabel="crushing force (N)", ylim=(0, None))


def _assumptions(export: Export) -> list[str]:
    """The text under the panels, wrapped: how the file was read, then each specimen."""
    texts = [f"{Path(export.file).name}: {export.layout}"]
    texts += [f"WARNING: {sentence}" for sentence in export.skipped]
    for specimen in export.specimens:
        texts.append(f"{specimen.label} ({specimen.place})")
        texts += [
            f"  {'WARNING: ' if finding.fault else '- '}{finding.text}"
            for finding in specimen.findings
        ]
    if export.strengths is not None:
        texts += [export.strengths.place, *(f"  - {note}" for note in export.strengths.notes)]
    lines = [
        _drawable(line)
        for text in texts
        for line in textwrap.wrap(text, TEXT_WIDTH, subsequent_indent="     ")
    ]
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], "... the rest stands in the lab file"]
    return lines
