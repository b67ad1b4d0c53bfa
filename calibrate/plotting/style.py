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
    """Writes the figure and forgets it."""
    figure.savefig(path, dpi=130)
    plt.close(figure)
