"""Pictures of a bed: spheres coloured by the forces on them, contacts as lines, cut along the axis.

Still pictures at the ends of movements, and the same cut at every moment as an animation.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from calibrate.core.files import whole
from calibrate.figures.style import DARK, MIDDLE
from calibrate.view.contacts import Contacts
from calibrate.view.frames import Frame
from jdem.boundaries.base import FAR
from jdem.boundaries.composite import MOULD
from jdem.engine.segment import CELL

LOAD_COLOURS = "YlGnBu"
CUT = "cut along the axis; lines: contacts near it, dark in compression, orange in tension"
TOOLS = ("pushing", "turning", "shearing", "lifting")
SHOWN = ("loading", "resting", "crushing", *TOOLS)  # movements whose ends are drawn


def bed_figure(frames: list[Frame], contacts: list[Contacts]) -> Figure:
    """The bed at the end of loading, of the rest, and of crushing or of a tool's way, cut through
    its axis."""
    shown = moments(frames)
    figure, axes = plt.subplots(1, len(shown), figsize=(10.5, 5), layout="constrained")
    top = _load_scale([contacts[number] for number in shown], frames[0])
    window = _window(frames)
    for axis, number in zip(np.atleast_1d(axes), shown, strict=True):
        _bed(axis, frames[number], contacts[number], top, window)
    _load_bar(figure, axes, top)
    figure.supxlabel(CUT, fontsize=8)
    return figure


def moments(frames: list[Frame]) -> list[int]:
    """Numbers of the frames that are drawn: the ends of `SHOWN`, or, where a protocol has none of
    these, of three of its movements, the first and the last among them."""
    ends = {frame.movement: number for number, frame in enumerate(frames)}
    named = [ends[name] for name in SHOWN if name in ends]
    last = list(ends.values())
    return named or sorted({last[0], last[len(last) // 2], last[-1]})


def bed_animation(frames: list[Frame], contacts: list[Contacts], path: Path) -> None:
    """The same cut at every moment, as an animated GIF."""
    figure, axis = plt.subplots(figsize=(4.6, 6.4), layout="constrained")
    top, window = _load_scale(contacts, frames[0]), _window(frames)
    _load_bar(figure, axis, top)
    figure.supxlabel(CUT.replace("; ", ";\n"), fontsize=7)

    def draw(number: int):
        axis.clear()
        _bed(axis, frames[number], contacts[number], top, window)
        return []

    moving = FuncAnimation(figure, draw, frames=len(frames))
    try:
        with whole(path, path.suffix) as part:
            moving.save(part, writer=PillowWriter(fps=6), dpi=100)
    finally:
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
    """Base, platen, mould and tools where they stand; what was taken away is not drawn."""
    radius = 1e3 * float(frame.state.boundaries[MOULD].size)
    height = 1e3 * float(frame.state.platen_height)
    width = 1e3 * float(np.abs(np.asarray(frame.state.motion.position.x)).max()) + 8
    axis.plot([-width, width], [0, 0], color="0.2", lw=2)
    if height < 1e3 * FAR / 2:
        axis.plot([-width, width], [height, height], color="0.2", lw=2)
    if radius < 1e3 * FAR / 2:
        for side in (-radius, radius):
            axis.plot([side, side], [0, 1.2 * max(height, 1.0)], color="0.5", lw=1.5)
    for tool in frame.state.boundaries[CELL:]:
        for place in (1e3 * np.asarray(line) for line in tool.outline()):
            if np.abs(place).max() < 1e3 * FAR / 2:
                axis.plot(*place.T, color="0.2", lw=2)


def _load_scale(contacts: list[Contacts], frame: Frame) -> float:
    """The load (N) at the top of the colours: nearly the largest of all spheres."""
    loads = [touching.load(frame.bed.spheres.count) for touching in contacts]
    return max(float(np.quantile(np.concatenate(loads), 0.995)), 1e-9)


def _window(frames: list[Frame]):
    """Limits of x and z (mm) that hold the bed at all moments, but for spheres that roll away."""
    position = np.concatenate([np.asarray(f.state.motion.position.stack()) for f in frames])
    radius = np.concatenate([np.asarray(f.bed.spheres.radius) for f in frames])
    reach = 1e3 * float(np.quantile(np.abs(position[:, 0]) + radius, 0.998)) + 3
    return (-reach, reach), (-4, 1e3 * float((position[:, 2] + radius).max()) + 6)


def _load_bar(figure: Figure, axes, top: float) -> None:
    scale = ScalarMappable(Normalize(0, top), LOAD_COLOURS)
    label = "load of a sphere: sum of its contact forces (N)"
    figure.colorbar(scale, ax=axes, label=label, shrink=0.7)
