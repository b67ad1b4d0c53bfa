"""Draws the sketches of the pages.

    python docs/site/overview.py

docs/images/overview.png is the way from a soil specimen to parameters of a DEM code; its curves are
no results.  docs/images/eepa.png is one contact, by the law itself, with its points named.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle
from PIL import Image

from calibrate.simulation.single_contact import Spheres, drive, law_of

IMAGES = Path(__file__).parents[1] / "images"
TARGET = IMAGES / "overview.png"
INK, SOIL, STEEL, LIGHT = "#1b1b1b", "#c9b18c", "#8a8f96", "#f3f0ea"
MEASURED = {"color": INK, "lw": 2.2}
SIMULATED = {"color": "#b4551f", "lw": 2.0, "ls": (0, (4, 2))}
SMALL, USUAL, LARGE = 9.5, 10.5, 12.5

plt.rcParams["font.family"] = "DejaVu Sans"


def box(ax: Axes, x: float, width: float, y: float, height: float) -> None:
    shape = FancyBboxPatch(
        (x, y), width, height, boxstyle="round,pad=0,rounding_size=0.12",
        fc="white", ec="#555555", lw=1.1, zorder=1,
    )  # fmt: skip
    ax.add_patch(shape)


def head(ax: Axes, x: float, y: float, number: str, words: str) -> None:
    ax.text(x, y, number, fontsize=LARGE, weight="bold", color=INK, va="top")
    ax.text(x + 0.28, y, words, fontsize=LARGE, weight="bold", color=INK, va="top")


def arrow(ax: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    style = {"arrowstyle": "-|>,head_length=0.6,head_width=0.35", "lw": 2.6, "color": INK}
    ax.annotate("", xy=end, xytext=start, arrowprops=style, zorder=5)


def soil(ax: Axes, x: float, y: float, width: float, height: float, spheres: bool = False) -> None:
    ax.add_patch(Rectangle((x, y), width, height, fc=SOIL, ec=INK, lw=1.0, zorder=3))
    if not spheres:
        dots = np.random.default_rng(1).uniform(0.06, 0.94, (60, 2))
        ax.scatter(x + dots[:, 0] * width, y + dots[:, 1] * height, s=1.2, c="#6b5636", zorder=4)
        return
    ax.patches[-1].set_facecolor(LIGHT)
    rng, placed = np.random.default_rng(3), []
    for _ in range(60000):
        radius = rng.choice([0.08, 0.066, 0.05], p=[0.2, 0.3, 0.5])
        centre = np.array([
            rng.uniform(x + radius, x + width - radius),
            rng.uniform(y + radius, y + height - radius),
        ])  # fmt: skip
        if all(np.hypot(*(centre - other)) > 0.96 * (radius + size) for other, size in placed):
            placed.append((centre, radius))
    for centre, radius in placed:
        ax.add_patch(Circle(centre, radius, fc=SOIL, ec=INK, lw=0.5, zorder=4))


def platens(ax: Axes, x: float, y: float, width: float, height: float, wide: float = 0.0) -> None:
    """A base below and a platen above soil, with the machine's arrow."""
    base = Rectangle((x - 0.22, y - 0.14), width + 0.44, 0.14, fc=STEEL, ec=INK, lw=1.0, zorder=3)
    top = Rectangle(
        (x - wide, y + height), width + 2 * wide, 0.12, fc=STEEL, ec=INK, lw=1.0, zorder=3
    )
    ax.add_patch(base)
    ax.add_patch(top)
    centre = x + width / 2
    arrow(ax, (centre, y + height + 0.62), (centre, y + height + 0.13))


def mould(ax: Axes, x: float, y: float, width: float, height: float) -> None:
    for left in (x - 0.12, x + width):
        ax.add_patch(Rectangle((left, y), 0.12, height + 0.22, fc=STEEL, ec=INK, lw=1.0, zorder=3))


def curves(ax: Axes, x: float, y: float, width: float, height: float, way, force, words, style):
    """One small diagram of force over displacement."""
    ax.plot([x, x, x + width], [y + height, y, y], color=INK, lw=1.0, zorder=3)
    for (a, b), look in zip(zip(way, force, strict=True), style, strict=True):
        ax.plot(x + np.asarray(a) * width, y + np.asarray(b) * height, zorder=4, **look)
    ax.text(x + width / 2, y - 0.08, "displacement", fontsize=SMALL, ha="center", va="top")
    ax.text(x - 0.07, y + height / 2, "force", fontsize=SMALL, ha="right", va="center", rotation=90)
    ax.text(x + 0.06, y + height + 0.02, words, fontsize=SMALL, va="bottom")


def pressed(bend: float = 1.25, back: float = 0.62) -> tuple[np.ndarray, np.ndarray]:
    """Loading in the mould and back."""
    up, down = np.linspace(0, 1, 50), np.linspace(1, 0, 50)
    way = np.concatenate([0.92 * up, back + (0.92 - back) * down**0.45])
    return way, np.concatenate([0.92 * up**bend, 0.92 * down])


def crushed(peak: float = 0.85, at: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Rise to the peak and softening."""
    way = np.linspace(0, 0.95, 100)
    s = way / at
    rising, falling = 1 - np.clip(1 - s, 0, 1) ** 2.2, 0.42 + 0.58 / (1 + (s - 1) ** 2)
    return way, peak * np.where(s < 1, rising, falling)


def first_row(ax: Axes) -> None:
    """What happens in the laboratory."""
    box(ax, 0.1, 1.9, 3.45, 3.0)
    head(ax, 0.22, 6.33, "1", "Specimen")
    soil(ax, 0.72, 4.1, 0.66, 1.32)
    ax.text(1.05, 3.95, "of soil, for example\n50 by 100 mm", fontsize=SMALL, ha="center", va="top")

    box(ax, 2.5, 3.5, 3.45, 3.0)
    head(ax, 2.62, 6.33, "2", "Laboratory tests")
    soil(ax, 2.98, 4.2, 0.62, 1.05)
    mould(ax, 2.98, 4.2, 0.62, 1.05)
    platens(ax, 2.98, 4.2, 0.62, 1.05)
    ax.text(3.29, 3.98, "confined:\nin a mould", fontsize=SMALL, ha="center", va="top")
    soil(ax, 4.85, 4.2, 0.62, 1.05)
    platens(ax, 4.85, 4.2, 0.62, 1.05, 0.18)
    ax.text(5.16, 3.98, "unconfined:\nfree, to crushing", fontsize=SMALL, ha="center", va="top")

    box(ax, 6.5, 3.4, 3.45, 3.0)
    head(ax, 6.62, 6.33, "3", "Measured curves")
    style = [MEASURED]
    a, b = pressed(), crushed()
    curves(ax, 6.98, 4.05, 1.2, 1.4, [a[0]], [a[1]], "confined", style)
    curves(ax, 8.56, 4.05, 1.2, 1.4, [b[0]], [b[1]], "unconfined", style)
    arrow(ax, (2.03, 4.95), (2.47, 4.95))
    arrow(ax, (6.03, 4.95), (6.47, 4.95))


def second_row(ax: Axes) -> None:
    """What the program does, and what comes out."""
    box(ax, 5.4, 4.5, 0.1, 2.95)
    head(ax, 5.52, 2.93, "4", "The program calibrate")
    soil(ax, 5.85, 0.72, 0.62, 1.05, spheres=True)
    mould(ax, 5.85, 0.72, 0.62, 1.05)
    platens(ax, 5.85, 0.72, 0.62, 1.05)
    ax.text(6.16, 0.5, "the same tests\non spheres", fontsize=SMALL, ha="center", va="top")
    a, b = pressed(), pressed(1.5, 0.7)
    curves(ax, 7.2, 0.75, 1.15, 1.3, [a[0], b[0]], [a[1], b[1]], "", [MEASURED, SIMULATED])
    ax.plot([8.6, 8.85], [1.95, 1.95], **MEASURED)
    ax.text(8.92, 1.95, "measured", fontsize=SMALL, va="center")
    ax.plot([8.6, 8.85], [1.68, 1.68], **SIMULATED)
    ax.text(8.92, 1.68, "simulated", fontsize=SMALL, va="center")
    ax.text(8.56, 1.42, "changes the\nparameters\nuntil both\nagree", fontsize=SMALL, va="top")

    box(ax, 2.55, 2.35, 0.1, 2.95)
    head(ax, 2.67, 2.93, "5", "Parameters")
    rows = ["shear modulus", "surface energy", "static friction", "rolling friction", "..."]
    for place, name in enumerate(rows):
        ax.text(2.72, 2.38 - 0.27 * place, name, fontsize=SMALL, va="center")
        if name != "...":
            y, centre, half = 2.38 - 0.27 * place, 4.45, (0.12, 0.2, 0.3, 0.16)[place]
            ax.plot([centre - half, centre + half], [y, y], color=INK, lw=1.4)
            ax.plot([centre], [y], "o", color=INK, ms=4.5)
    ax.text(2.72, 0.9, "each with its 95 % interval,\nand which of them the\ndata leave open",
            fontsize=SMALL, va="top")  # fmt: skip

    box(ax, 0.1, 1.95, 0.1, 2.95)
    head(ax, 0.22, 2.93, "6", "DEM code")
    tool(ax)
    ax.text(1.07, 1.0, "input for LIGGGHTS\nor YADE; a table\nof names for EDEM", fontsize=SMALL,
            ha="center", va="top")  # fmt: skip
    arrow(ax, (8.0, 3.37), (8.0, 3.08))
    arrow(ax, (5.37, 1.55), (4.93, 1.55))
    arrow(ax, (2.52, 1.55), (2.08, 1.55))


def tool(ax: Axes) -> None:
    """A blade in a bed of spheres."""
    rng = np.random.default_rng(5)
    for x in np.arange(0.28, 1.9, 0.13):
        for level in range(3):
            ax.add_patch(
                Circle(
                    (x + 0.065 * (level % 2), 1.22 + 0.115 * level + rng.uniform(-0.01, 0.01)),
                    0.065, fc=SOIL, ec=INK, lw=0.5, zorder=3,
                )
            )  # fmt: skip
    blade = [(1.0, 1.3), (1.12, 1.27), (1.5, 2.3), (1.32, 2.3)]
    ax.add_patch(Polygon(blade, fc=STEEL, ec=INK, lw=1.0, zorder=4))
    arrow(ax, (1.25, 1.85), (0.72, 1.85))


def main() -> None:
    figure = plt.figure(figsize=(9.2, 6.0), dpi=180)
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, 10.1), ylim=(0, 6.85))
    ax.set_aspect("auto")
    ax.axis("off")
    ax.add_patch(Rectangle((0, 3.22), 10.1, 3.63, fc=LIGHT, zorder=0))
    ax.text(0.12, 6.72, "In your laboratory", fontsize=USUAL, va="top", style="italic")
    first_row(ax)
    second_row(ax)
    saved(figure, TARGET)
    contact_loop()


def saved(figure: Figure, path: Path) -> None:
    """Written with few colours, which keeps the file small."""
    figure.savefig(path)
    with Image.open(path) as drawn:
        drawn.convert("RGB").quantize(64).save(path, optimize=True)


def contact_loop() -> None:
    """One contact of the bundled soil's start: loading, unloading past the largest tension,
    reloading from the adhesive branch, with the points that docs/theory.md names."""
    pair = Spheres(radius=2e-3, young=18.2e6, poisson=0.3)
    law = law_of("eepa", {"surface_energy": 857.9})
    found = drive(pair, law, [1e-4, 2.5e-5, 8e-5], smooth=False)
    way, force = 1e6 * np.array(found["overlap_m"]), np.array(found["normal_force_n"])
    alone = drive(pair, law, [1e-4, 0.0], smooth=False)
    whole, tension = 1e6 * np.array(alone["overlap_m"]), np.array(alone["normal_force_n"])
    figure, ax = plt.subplots(figsize=(6.4, 3.9), dpi=150, layout="constrained")
    ax.plot(whole, tension, color="0.6", lw=1.2, ls="--")
    ax.plot(way, force, color=INK, lw=1.8)
    ax.axhline(0, color="0.6", lw=0.8)
    low = int(np.argmin(way[500:]) + 500)
    after = np.flatnonzero(np.isclose(force[low:], 2e4 * 1e-6 * way[low:], rtol=1e-3)) + low
    places = {
        "O": (0.0, 0.0, -7, 0.12), "A": (100.0, 2.0, 1.5, 0.02), "B": (70.0, 0.0, 2.0, -0.22),
        "C": (whole[np.argmin(tension)], tension.min(), 1.5, -0.18),
        "D": (way[low], force[low], -5.5, -0.12), "E": (way[after[0]], force[after[0]], -5.0, 0.08),
    }  # fmt: skip
    for name, (x, y, right, up) in places.items():
        ax.plot([x], [y], "o", color=SIMULATED["color"], ms=5, zorder=5)
        ax.text(x + right, y + up, name, fontsize=LARGE, weight="bold", color=SIMULATED["color"])
    ax.set(xlabel="overlap (µm)", ylabel="normal force (N)", xlim=(-9, 110), ylim=(-1.9, 2.3))
    saved(figure, IMAGES / "eepa.png")


if __name__ == "__main__":
    main()
