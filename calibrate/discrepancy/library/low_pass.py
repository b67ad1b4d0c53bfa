"""A force that is recorded through a first-order low-pass filter along the platen's path.

    dR/dx = (F - R)/L      L = v tau       x: the platen's path, v its speed, tau the time constant

All functions are exact where F is straight between points: with b = L dF/dx of an interval and t
from its beginning,

    R(x + t) = F(x + t) - b + (R(x) - F(x) + b) exp(-t/L)
"""

import numpy as np

STEPS = 12  # of Newton's method


def filtered(path: np.ndarray, force: np.ndarray, length: float) -> np.ndarray:
    """Readings (n,) of forces (n,) at any points of a path (n,), from R = F at the first."""
    reading = np.array(force, float)
    steps, rises = np.diff(path), np.diff(force)
    for i, (step, rise) in enumerate(zip(steps, rises, strict=True)):
        if step == 0:
            reading[i + 1] = reading[i]
            continue
        behind = length * rise / step  # how far R lags where F rises evenly
        left = (reading[i] - force[i] + behind) * np.exp(-step / length)
        reading[i + 1] = force[i + 1] - behind + left
    return reading


def reading_at_knots(
    path: np.ndarray, force: np.ndarray, length: np.ndarray, first: float
) -> np.ndarray:
    """Readings (n, k) of n forces (n, k) at points of their paths (n, k), from R = `first`;
    length (n, 1).  Complex numbers carry derivatives."""
    steps = np.diff(path, axis=1)
    behind = length * np.diff(force, axis=1) / steps
    kept = np.exp(-steps / length)
    reading = np.zeros(path.shape, np.result_type(path, force, length))
    reading[:, 0] = first
    for i in range(steps.shape[1]):
        left = (reading[:, i] - force[:, i] + behind[:, i]) * kept[:, i]
        reading[:, i + 1] = force[:, i + 1] - behind[:, i] + left
    return reading


def path_at(
    levels: np.ndarray, path: np.ndarray, force: np.ndarray, reading: np.ndarray,
    length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Where on their paths (n, k) readings (n, k), as `reading_at_knots` gives them, reach levels
    (q,) for good, and their slopes dR/dx there, both (n, q).  Readings rise at last.

    Newton's method in the interval of each level: R bends one way in it, so from the end on the
    outer side of that bend no step goes too far.
    """
    below = (np.real(reading)[:, :, None] < levels).sum(axis=1)
    at = np.clip(below - 1, 0, path.shape[1] - 2)

    def ends(of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.take_along_axis(of, at, axis=1), np.take_along_axis(of, at + 1, axis=1)

    (x, x_end), (f, f_end), (r, _) = ends(path), ends(force), ends(reading)
    slope = (f_end - f) / (x_end - x)
    behind = length * slope
    bend = r - f + behind
    far = np.where(np.real(bend) > 0, x_end - x, 0.0)
    for _ in range(STEPS):
        fading = bend * np.exp(-far / length)
        rise = slope - fading / length
        far = far - (f + slope * far - behind + fading - levels) / rise
    return x + far, slope - bend * np.exp(-far / length) / length
