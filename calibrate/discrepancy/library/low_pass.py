"""A force that is recorded through a first-order low-pass filter along the platen's path.

    dR/dx = (F - R)/L      L = v tau       x: the platen's path, v its speed, tau the time constant

Both functions are exact where F is straight between points: with b = L dF/dx of an interval h,

    R(x + h) = F(x + h) - b + (R(x) - F(x) + b) exp(-h/L)
"""

import numpy as np
from scipy.signal import lfilter


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


def filtered_evenly(force: np.ndarray, step: float, length: float, first: float) -> np.ndarray:
    """Readings (n,) of forces (n,) every `step` of the path, from R = `first`, as one recursive
    filter; the forces themselves where there is no lag."""
    if not length:
        return force
    kept = np.exp(-step / length)
    share = length / step * (1 - kept)
    new, old = 1 - share, share - kept
    rest = lfilter([new, old], [1.0, -kept], force[1:], zi=[old * force[0] + kept * first])[0]
    return np.concatenate([[first], rest])
