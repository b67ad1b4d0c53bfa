"""Curves as a machine reads them: its errors, values between points, and a first-order low-pass
filter along the platen's path.

    dR/dx = (F - R)/L      L = v tau       x: the platen's path, v its speed, tau the time constant

The filter is exact where F is straight between points: with b = L dF/dx of an interval and t from
its beginning,

    R(x + t) = F(x + t) - b + (R(x) - F(x) + b) exp(-t/L)

Arrays hold one row for each specimen; complex numbers carry derivatives (`machine`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calibrate.labtests.diagnosis.base import Feature

STEPS = 13  # of Newton's method, before the last; a reading that only tends to a level needs more
ROUND_OFF = 1e-12  # mm; a step below which nothing changes


class MachineErrors(NamedTuple):
    """Each (n, 1): compliance (mm/N), seating gap (mm), gain, offset (N), drift (N/s), lag (s),
    and the force (N) by which a gap closes."""

    compliance: np.ndarray
    gap: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    drift: np.ndarray
    lag: np.ndarray
    closing_force: np.ndarray

    def in_forces_of(self, unit: np.ndarray) -> "MachineErrors":
        """The same where forces are counted in other units (n, 1) than newtons."""
        return self._replace(
            compliance=self.compliance * unit, offset=self.offset / unit, drift=self.drift / unit,
            closing_force=self.closing_force / unit,
        )  # fmt: skip

    def travel(self, force: np.ndarray) -> np.ndarray:
        """What the machine adds to displacements (mm) at forces (n, k)."""
        pressed = at_least(force, 0.0)
        return self.compliance * force - self.gap * np.expm1(-pressed / self.closing_force)

    def reading(self, shown: np.ndarray) -> np.ndarray:
        """The load cell's own reading (n, k) where the machine shows forces (n, k) at once; none
        where it would have to pull."""
        sensitive = np.where(np.real(self.gain) > -1, 1 + self.gain, 1.0)  # else it reads nothing
        return at_least((shown - self.offset) / sensitive, 0.0)


def at_least(values: np.ndarray, least: np.ndarray | float) -> np.ndarray:
    """The larger of both by real parts."""
    return np.where(np.real(values) > np.real(least), values, least)


def between(levels: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, k) known at rising points (n, k), at levels (n, q): straight between the points
    and beyond the last ones."""
    below = (np.real(known)[:, :, None] <= np.real(levels)[:, None, :]).sum(axis=1)
    at = np.clip(below - 1, 0, known.shape[1] - 2)
    row = np.arange(len(at))[:, None]
    (x, x_end), (y, y_end) = ((of[row, at], of[row, at + 1]) for of in (known, values))
    return y + (levels - x) / (x_end - x) * (y_end - y)


def by_force(features: Sequence[Feature], kind: str) -> np.ndarray:
    """The features of a kind by rising force."""
    found = [i for i, feature in enumerate(features) if feature.kind == kind]
    return np.array(sorted(found, key=lambda i: features[i].abscissa), int)


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
    path: np.ndarray, force: np.ndarray, length: np.ndarray, first: np.ndarray | float
) -> np.ndarray:
    """Readings (n, k) of n forces (n, k) at points of their paths (n, k), from R = `first`;
    length (n, 1).  Complex numbers carry derivatives."""
    steps = np.diff(path, axis=1)
    behind = length * np.diff(force, axis=1) / steps
    kept = np.exp(-steps / length)
    gained = force[:, 1:] - behind + kept * (behind - force[:, :-1])
    reading = np.zeros((path.shape[1], len(path)), np.result_type(path, force, length))
    reading[0] = first
    for i, (more, share) in enumerate(zip(gained.T, kept.T, strict=True)):
        reading[i + 1] = more + share * reading[i]
    return reading.T


def path_at(
    levels: np.ndarray, path: np.ndarray, force: np.ndarray, reading: np.ndarray,
    length: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Where on their paths (n, k) readings (n, k), as `reading_at_knots` gives them, reach levels
    (n, q) for good, and their slopes dR/dx there, both (n, q).  Readings rise at last.

    Newton's method in the interval of each level: R bends one way in it, so from the end on the
    outer side of that bend no step goes too far.
    """
    below = (np.real(reading)[:, :, None] < np.real(levels)[:, None, :]).sum(axis=1)
    at = np.clip(below - 1, 0, path.shape[1] - 2)

    row = np.arange(len(at))[:, None]
    (x, x_end), (f, f_end) = ((of[row, at], of[row, at + 1]) for of in (path, force))
    r = reading[row, at]
    slope = (f_end - f) / (x_end - x)
    behind = length * slope
    bend = r - f + behind
    far = np.where(np.real(bend) > 0, np.real(x_end - x), 0.0)
    missing = f - behind - levels
    of_line = missing, slope, bend, length
    real = tuple(np.real(part) for part in of_line)
    for _ in range(STEPS):
        step = _newton_step(far, *real)
        far = far - step
        if np.abs(step).max() < ROUND_OFF:
            break
    far = far - _newton_step(far, *of_line)  # in which what is imaginary follows
    return x + far, slope - bend * np.exp(-far / length) / length


def _newton_step(far, missing, slope, bend, length) -> np.ndarray:
    """Towards the root of missing + slope far + bend exp(-far/length)."""
    fading = bend * np.exp(-far / length)
    return (missing + slope * far + fading) / (slope - fading / length)
