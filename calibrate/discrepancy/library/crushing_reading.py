"""How a machine reads the curve of a soil that is crushed, laid through its features.

    touch (F = 0), seating (displacement 0), the features' points, straight on beyond the last

Displacement counts from where the machine shows the seating force, and time from the first touch.
At the peak the force changes by what the machine shows more at its place: a curve that is tilted a
little is highest nearly where it was (the envelope theorem).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.library.reading import MachineErrors, at_least, between
from calibrate.labtests.diagnosis.base import Feature

BEYOND = 1.5  # of the last displacement, up to which a curve goes on
LARGEST = 1e5  # N, mm; beyond it is no soil, as fits may try
CRUSHING, PEAK_FORCE, PEAK_DISPLACEMENT = "crushing", "peak force", "peak displacement"


@dataclass(frozen=True, eq=False)
class CrushingReading:
    """Which of the features are read off a crushing test, and the platen's speed (mm/s) there."""

    features: Sequence[Feature]
    speed: float

    @cached_property
    def rows(self) -> np.ndarray:
        """The features (c,) that a machine moves: by displacement, peak force, displacement there;
        none where the curve has too few."""
        along = [i for i, f in enumerate(self.features) if f.kind == CRUSHING]
        along.sort(key=lambda i: self.features[i].abscissa)
        peak = [
            i for kind in (PEAK_FORCE, PEAK_DISPLACEMENT)
            for i, f in enumerate(self.features) if f.kind == kind
        ]  # fmt: skip
        return np.array([*along, *peak] if len(along) > 1 and len(peak) == 2 else [], int)

    def moved(self, values: np.ndarray, errors: MachineErrors, slender: np.ndarray) -> np.ndarray:
        """What errors add to the features `rows` (n, c), given all (n, m) without any, of specimens
        that are `slender` (n, 1) times as slender as the features' own."""
        own = values[:, self.rows]
        moved = np.zeros(own.shape, np.result_type(values, errors.compliance, slender))
        some = np.flatnonzero((np.abs(np.real(own)) < LARGEST).all(axis=1))
        if len(self.rows) and len(some):
            errors = MachineErrors(*(part[some] for part in errors))
            moved[some] = self._moved(own[some], errors, slender[some])
        return moved

    def _moved(self, own: np.ndarray, errors: MachineErrors, slender: np.ndarray) -> np.ndarray:
        force, peak, at_peak = own[:, :-2], own[:, -2:-1], own[:, -1:]
        levels = slender * self._displacements
        way, pressed = self._curve(levels, force)
        first = way[:, :1]

        def shown(way: np.ndarray, force: np.ndarray) -> np.ndarray:
            """More than the force, N."""
            time = (way - first) / self.speed
            return errors.gain * force + errors.offset + errors.drift * time

        travel, reading = way + errors.travel(pressed), pressed + shown(way, pressed)
        zero = self._seated(travel, reading)
        read = between(levels, travel - zero, reading)
        later = errors.travel(peak) - zero
        return np.hstack([read - force, shown(at_peak, peak), later])

    @cached_property
    def _displacements(self) -> np.ndarray:
        """Of the features (k,), mm."""
        return np.array([self.features[i].abscissa for i in self.rows[:-2]])

    @property
    def _seating(self) -> float:
        """The force (N) from which displacement counts."""
        return self.features[self.rows[0]].zero.force or 0.0

    def _curve(self, levels: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and force (n, k + 3) of the curve's points."""
        none, seated = np.zeros_like(force[:, :1]), np.zeros_like(force[:, :1]) + self._seating
        touch = -levels[:, :1] * seated / at_least(force[:, :1] - seated, seated)
        falls = (force[:, -1:] - force[:, -2:-1]) / (levels[:, -1:] - levels[:, -2:-1])
        end = BEYOND * levels[:, -1:]
        way = np.hstack([touch, none, levels, end])
        last = force[:, -1:] + falls * (end - levels[:, -1:])
        return way, np.hstack([none, seated, force, last])

    def _seated(self, travel: np.ndarray, reading: np.ndarray) -> np.ndarray:
        """Displacement (n, 1) where the machine first shows the seating force; that of the first
        point where it does from the beginning, or never."""
        above = np.real(reading) >= self._seating
        at = np.argmax(above, axis=1)[:, None]
        before = np.maximum(at - 1, 0)
        row = np.arange(len(at))[:, None]
        (x, x_end), (r, r_end) = ((of[row, before], of[row, at]) for of in (travel, reading))
        rise = np.where(at > 0, r_end - r, 1.0)
        return np.where(at > 0, x + (self._seating - r) / rise * (x_end - x), x)
