"""Features of unconfined compression to failure.

Forces (N) are read at shares of the usual displacement at the peak, averaged over a window;
displacements count from a seating force, as a laboratory is free to choose its zero.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from calibrate.labtests.diagnosis.base import (
    TOE,
    AbstractTestFeatures,
    Feature,
    UsualSizes,
    Values,
    Variation,
)
from calibrate.labtests.reading import Zero, averaged, mean_of, rising

NAME = "unconfined"
# Shares of the displacement at the peak at which force is read, by segment.
ON_CRUSHING = {
    TOE: (0.05, 0.1, 0.15, 0.2),
    "rise": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
    "peak": (0.9, 1.0, 1.1),
    "softening": (1.25, 1.4, 1.6, 1.8, 2.0),
}
SEATING = 0.02  # share of the crushing force at which displacement starts to count
WINDOW = 0.04  # half-width of the averaging window, share of the displacement at the peak
NEAR_PEAK = 0.95  # share of the peak above which the peak's location is averaged
SEGMENTS = {  # in words
    "before contact": "reading before contact in the crushing test",
    TOE: "first touch of the crushing test",
    "rise": "rise of the crushing test",
    "peak": "peak of the crushing test",
    "softening": "softening after the peak of the crushing test",
}
VARIATIONS = (
    Variation("crushing between lubricated platens", 3.0, entries=("lubricated",)),
    Variation("crushing ten times as fast", 2.0, faster=10.0),
    Variation("crushing a sealed specimen at once", 3.0, entries=("at_once",)),
)


class UnconfinedFeatures(AbstractTestFeatures):
    """Kinds "crushing" (abscissa in mm), "peak force", "peak displacement"."""

    name = NAME
    label = "crushing test"
    axis = "displacement, 0 at seating (mm)"
    segments = SEGMENTS
    target = "crushing_force_n"
    branches = ("crushing",)
    tared = None
    read_at_forces = False
    variations = VARIATIONS
    switches: ClassVar = {"lubricated": "platen_friction", "at_once": "second_test_factor"}

    def with_rate(self, faster: float) -> dict[str, float]:
        return {"load_cell_drift": 1 / faster}  # newtons an hour

    def declare(self, usual: UsualSizes) -> tuple[Feature, ...]:
        seat = Zero(SEATING * usual.peak_n)
        forces = [
            _at(segment, share, usual.peak_mm, seat)
            for segment, shares in ON_CRUSHING.items()
            for share in shares
        ]
        peak = [
            _of_the_peak("peak force", "N", usual.peak_mm, seat),
            _of_the_peak("peak displacement", "mm", usual.peak_mm, seat),
        ]
        return (*forces, *peak)

    def read(
        self, features: Sequence[Feature], displacement: np.ndarray, force: np.ndarray
    ) -> Values:
        peak_mm, end = features[0].scale, self.last_of_rise(displacement, force) + 1
        rise = rising(displacement[:end], force[:end])
        travel = displacement - features[0].zero.of(*rise)
        reach = travel.max() * (1 + 1e-9)
        dense = np.linspace(0.0, min(2.0 * peak_mm, reach), 101)
        smooth = averaged(travel, force, dense, WINDOW * peak_mm)
        values = {
            ("peak force", 0.0): float(smooth.max()),
            ("peak displacement", 0.0): float(mean_of(dense, smooth >= NEAR_PEAK * smooth.max())),
        }
        locations = np.array([f.abscissa for f in features if f.kind == "crushing"])
        forces = averaged(travel, force, locations, WINDOW * peak_mm)
        for location, value in zip(locations, forces, strict=True):
            values["crushing", float(location)] = float(value) if location <= reach else np.nan
        return values

    def beyond(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        return np.zeros(len(features), bool)

    def before_start(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        return np.array([f.test == NAME and f.segment == TOE for f in features])

    def last_of_rise(self, displacement: np.ndarray, force: np.ndarray) -> int:
        return int(np.argmax(force))

    def stretched_by(self, usual: UsualSizes) -> tuple[str, str]:
        return f"peak displacement, {NAME}", f"peak force, {NAME}"


def _at(segment: str, share: float, peak_mm: float, seat: Zero) -> Feature:
    at = share * peak_mm
    name = f"force at {at:.3g} mm, crushing"
    return Feature(name, NAME, segment, "crushing", at, "N", share / 2, peak_mm, seat)


def _of_the_peak(kind: str, unit: str, peak_mm: float, seat: Zero) -> Feature:
    return Feature(f"{kind}, {NAME}", NAME, "peak", kind, 0.0, unit, 0.5, peak_mm, seat)
