"""Pictures of laboratory data and of beds: the preview of a converted export, a bed's forces.

Colours differ in lightness as well as hue, so figures survive greyscale.
"""

import textwrap
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib import font_manager
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from calibrate.machine.convert import Export
from calibrate.machine.specimens import Specimen
from calibrate.view.contacts import Contacts
from calibrate.view.frames import Frame
from jdem.simulate import FAR

DARK, MIDDLE, PALE = "#20344f", "#c4622d", "0.72"
MOST_PANELS = 12
COLUMNS = 3
TEXT_WIDTH = 128  # characters of a line below the panels
MOST_LINES = 40
LOAD_COLOURS = "YlGnBu"
CUT = "cut along the axis; lines: contacts near it, dark in compression, orange in tension"
SHOWN = ("loading", "resting", "crushing")  # movements whose ends are drawn
CHINESE = ("Noto Sans CJK SC", "WenQuanYi Zen Hei", "Microsoft YaHei", "SimHei", "PingFang SC")


def preview_figure(export: Export, path: Path) -> None:
    """Each specimen as recorded and as kept, with what was assumed written underneath."""
    shown = export.specimens[:MOST_PANELS]
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    lines = _assumptions(export)
    text_height = 0.4 + 0.165 * len(lines)
    figure = plt.figure(figsize=(10.5, 3.4 * rows + text_height), layout="constrained")
    heights = [3.4] * rows + [text_height]
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=heights)
    for place, specimen in enumerate(shown):
        axis = figure.add_subplot(grid[place // columns, place % columns])
        _specimen(axis, specimen)
        if place == 0:
            axis.legend(fontsize=7, frameon=False)
    below = figure.add_subplot(grid[rows, :])
    below.set_axis_off()
    below.text(0, 1, "\n".join(lines), fontsize=8, va="top", family=_fonts())
    _save(figure, path)


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
    axis.plot(specimen.displacement_mm, specimen.force_n, color=DARK, lw=1.2, label="kept")
    axis.axvline(0, color="0.5", lw=0.8, ls=":", label="contact")
    if specimen.unloading_mm is not None:
        axis.axvline(specimen.unloading_mm, color="0.5", lw=0.8, ls="--", label="unloading")
    if specimen.clipped:
        last = (specimen.displacement_mm[-1], specimen.force_n[-1])
        axis.plot(*last, "v", color=MIDDLE, ms=8, label="limit of the load cell")
    faults = sum(finding.fault for finding in specimen.findings)
    title = f"{_drawable(specimen.label[:34])}: {specimen.test}"
    title += f", {faults} warning(s)" if faults else ""
    axis.set_title(title, fontsize=9, family=_fonts())
    axis.set(xlabel="displacement (mm)", ylabel="force (N)")


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
    lines = [
        _drawable(line)
        for text in texts
        for line in textwrap.wrap(text, TEXT_WIDTH, subsequent_indent="     ")
    ]
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], "... the rest stands in the lab file"]
    return lines


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=130)
    plt.close(figure)


def bed_figure(frames: list[Frame], contacts: list[Contacts], path: Path) -> None:
    """The bed at the end of loading, of the rest, and of crushing, cut through its axis."""
    ends = {frame.movement: number for number, frame in enumerate(frames)}
    shown = [ends[name] for name in SHOWN if name in ends]
    figure, axes = plt.subplots(1, len(shown), figsize=(10.5, 5), layout="constrained")
    top = _load_scale([contacts[number] for number in shown], frames[0])
    window = _window(frames)
    for axis, number in zip(np.atleast_1d(axes), shown, strict=True):
        _bed(axis, frames[number], contacts[number], top, window)
    _load_bar(figure, axes, top)
    figure.supxlabel(CUT, fontsize=8)
    _save(figure, path)


def bed_animation(frames: list[Frame], contacts: list[Contacts], path: Path) -> None:
    """The same cut at every moment, as an animated GIF."""
    figure, axis = plt.subplots(figsize=(4.6, 6.4), layout="constrained")
    top, window = _load_scale(contacts, frames[0]), _window(frames)
    _load_bar(figure, axis, top)
    figure.supxlabel(CUT.replace("; ", ";\n"), fontsize=6)

    def draw(number: int):
        axis.clear()
        _bed(axis, frames[number], contacts[number], top, window)
        return []

    moving = FuncAnimation(figure, draw, frames=len(frames))
    moving.save(path, writer=PillowWriter(fps=6), dpi=80)
    plt.close(figure)


def _bed(axis: Axes, frame: Frame, touching: Contacts, top: float, window) -> None:
    """Spheres cut by the plane y = 0, coloured by load; contacts near it as lines, whose
    widths grow with their force."""
    position = 1e3 * np.asarray(frame.state.motion.position.stack())
    radius = 1e3 * np.asarray(frame.bed.spheres.radius)
    load = touching.load(len(radius))
    near = np.abs(position[:, 1]) < radius
    cut = np.sqrt(np.maximum(radius**2 - position[:, 1] ** 2, 0.0))
    rows = zip(position[near][:, 0], position[near][:, 2], cut[near], strict=True)
    discs = [Circle((x, z), r) for x, z, r in rows]
    spheres = PatchCollection(discs, cmap=LOAD_COLOURS, norm=Normalize(0, top), ec="0.35", lw=0.4)
    spheres.set_array(load[near])
    axis.add_collection(spheres)
    middle = 0.5 * (touching.start + touching.end)
    close = np.abs(1e3 * middle[:, 1]) < radius.mean()
    ends = 1e3 * np.stack([touching.start, touching.end], axis=1)[close][:, :, [0, 2]]
    force = touching.normal_force[close]
    widths = 4 * np.abs(force) / max(top / 2, 1e-12)
    colours = np.where(force >= 0, DARK, MIDDLE)
    axis.add_collection(LineCollection(list(ends), linewidths=widths, colors=colours.tolist()))
    _walls(axis, frame)
    axis.set(xlim=window[0], ylim=window[1], aspect="equal", xlabel="x (mm)")
    axis.set(ylabel="z (mm)", title=f"{frame.movement}, {frame.platen_force:.0f} N")


def _walls(axis: Axes, frame: Frame) -> None:
    """Base, platen and mould where they stand; walls that were taken away are not drawn."""
    walls = frame.state.walls
    radius, height = 1e3 * float(walls.mould_radius), 1e3 * float(walls.platen_height)
    width = 1e3 * float(np.abs(np.asarray(frame.state.motion.position.x)).max()) + 8
    axis.plot([-width, width], [0, 0], color="0.2", lw=2)
    if height < 1e3 * FAR / 2:
        axis.plot([-width, width], [height, height], color="0.2", lw=2)
    if radius < 1e3 * FAR / 2:
        for side in (-radius, radius):
            axis.plot([side, side], [0, 1.2 * max(height, 1.0)], color="0.5", lw=1.5)


def _load_scale(contacts: list[Contacts], frame: Frame) -> float:
    """The load (N) at the top of the colours: nearly the largest of all spheres."""
    loads = [touching.load(frame.bed.spheres.count) for touching in contacts]
    return max(float(np.quantile(np.concatenate(loads), 0.995)), 1e-9)


def _window(frames: list[Frame]):
    """Limits of x and z (mm) that hold the bed at all moments."""
    position = np.concatenate([np.asarray(f.state.motion.position.stack()) for f in frames])
    reach = 1e3 * float(np.quantile(np.abs(position[:, 0]), 0.995)) + 10
    return (-reach, reach), (-4, 1e3 * float(position[:, 2].max()) + 12)


def _load_bar(figure: Figure, axes, top: float) -> None:
    scale = ScalarMappable(Normalize(0, top), LOAD_COLOURS)
    label = "load of a sphere: sum of its contact forces (N)"
    figure.colorbar(scale, ax=axes, label=label, shrink=0.7)
