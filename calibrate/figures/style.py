"""What all figures share: colours that differ in lightness as well as in hue, and no display where
none was chosen.

Figures survive a greyscale printer; colour maps run from dark to light.  A figure becomes a
file (`save`) or, for a page, SVG text of one panel that a phone can show (`panel_svg`).
"""

import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib

if matplotlib.get_backend(auto_select=False) is None:  # a notebook has chosen one
    matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibrate.core.files import whole, write_text
from calibrate.labtests.composite import BY_NAME

DARK, MIDDLE, LIGHT = "#20344f", "#c4622d", "#9fb7c9"
MAP = "cividis"
PANEL = (4.6, 3.9)  # inches; text keeps a readable size at 340 px


def save(figure: Figure, path: Path) -> None:
    """Writes the figure whole or not at all, and forgets it."""
    try:
        if path.suffix == ".svg":
            write_text(path, svg(figure))
        else:
            with whole(path) as part:
                figure.savefig(part, dpi=130, format=path.suffix.lstrip("."))
    finally:
        plt.close(figure)


def closed(figure: Figure) -> Figure:
    """The figure, which pyplot forgets: a notebook shows it once, where it is asked for."""
    plt.close(figure)
    return figure


def panel_svg(
    draw: Callable[[Any], None],
    size: tuple[float, float] = PANEL,
    projection: str | None = None,
) -> str:
    """What `draw` puts on one axis, as SVG text."""
    figure = plt.figure(figsize=size, layout="constrained")
    draw(figure.add_subplot(projection=projection))
    return svg(figure)


def svg(figure: Figure) -> str:
    """The drawing as text, the same bytes every time; the figure is closed."""
    text = io.StringIO()
    with plt.rc_context({"svg.hashsalt": "calibrate"}):
        figure.savefig(text, format="svg", metadata={"Date": None}, dpi=150)
    plt.close(figure)
    return text.getvalue()


def above(axis: Axes) -> None:
    """A legend above the axis, where it hides nothing."""
    if axis.get_legend_handles_labels()[0]:
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "ncols": 3}
        axis.legend(frameon=False, fontsize=7, columnspacing=1.2, handlelength=1.6, **place)


def marked(axes: Iterable[Axes]) -> dict[str, Any]:
    """What is drawn in any of some axes and has a name, by it."""
    pairs = (axis.get_legend_handles_labels() for axis in axes)
    return {name: handle for pair in pairs for handle, name in zip(*pair, strict=True)}


def pretty(name: str) -> str:
    """A parameter or observable as words."""
    test, dot, plain = name.rpartition(".")
    known = BY_NAME.get(plain)
    return f"{test}{dot}{known.short if known else plain}".replace("_", " ")
