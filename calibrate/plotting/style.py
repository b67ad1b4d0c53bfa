"""What all figures share: no display, and colours that differ in lightness as well as in hue.

Figures survive a greyscale printer; colour maps run from dark to light.
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

DARK, MIDDLE, LIGHT = "#20344f", "#c4622d", "#9fb7c9"
MAP = "cividis"


def save(figure: Figure, path: Path) -> None:
    """Writes the figure whole or not at all, and forgets it."""
    part = path.with_name(f".{path.name}.part")
    try:
        figure.savefig(part, dpi=130, format=path.suffix.lstrip("."))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
        plt.close(figure)
