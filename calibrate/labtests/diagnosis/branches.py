"""Reading a noisy curve: monotone branches, and forces averaged over a window.

Noise is averaged, not followed: branches go through the closest rising or falling curve (isotonic
regression), forces through a straight line over a short window.
"""

import numpy as np
from scipy.optimize import isotonic_regression

FEWEST = 4  # points that make a straight line


def rising(displacement: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and force of the blocks of the closest rising curve."""
    fit = isotonic_regression(force)
    edges, levels = fit.blocks, fit.x[fit.blocks[:-1]]
    sums = np.add.reduceat(displacement, edges[:-1])
    return sums / np.diff(edges), levels


def falling(displacement: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for a falling curve, in the order of rising force."""
    return rising(displacement[::-1], force[::-1])


def displacement_at(branch, force: float, strict: bool = False) -> float:
    """Displacement at a force; the end of the branch beyond its largest force.

    strict: NaN below the smallest force (an unloading that stopped early).
    """
    displacement, levels = branch
    if strict and force < levels[0]:
        return np.nan
    return float(np.interp(force, levels, displacement))


def rising_displacement_at(
    displacement: np.ndarray, force: np.ndarray, top: int, level: float
) -> float:
    """Displacement at a force on the rising part of a curve that ends at the point `top`."""
    return float(np.interp(level, isotonic_regression(force[: top + 1]).x, displacement[: top + 1]))


def averaged(travel, force, locations, half_width) -> np.ndarray:
    """Force at `locations` from a straight line through the points within `half_width`.

    Where fewer than four points lie there: straight between the neighbours.
    """
    offset = travel[None, :] - locations[:, None]
    weight = (np.abs(offset) <= half_width).astype(float)
    count = weight.sum(axis=1)
    enough = count >= FEWEST
    safe = np.where(enough, count, 1.0)
    middle = (weight * offset).sum(axis=1) / safe
    level = weight @ force / safe
    spread = (weight * offset**2).sum(axis=1) / safe - middle**2
    joint = (weight * offset) @ force / safe - middle * level
    slope = joint / np.where(spread > 0, spread, 1.0)
    order = np.argsort(travel, kind="stable")
    between = np.interp(locations, travel[order], force[order])
    return np.where(enough & (spread > 0), level - slope * middle, between)
