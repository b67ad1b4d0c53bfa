"""Features of confined compression to a largest force and back.

Displacements (mm) are read at shares of the largest force on loading and on unloading, and count
from the one at half of it on loading, as a laboratory is free to choose its zero.
"""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from calibrate.labtests.diagnosis.base import (
    REFERENCE,
    TOE,
    AbstractTestFeatures,
    Feature,
    UsualSizes,
    Values,
    Variation,
)
from calibrate.labtests.reading import Zero, displacement_on_rise, falling, rising

NAME = "confined"
UPPER = "upper half"  # named by its forces, which are those of the lab file
# Shares of the largest force at which displacement is read, by segment.
ON_LOADING = {
    TOE: (0.0125, 0.025, 0.05),
    "loading": (0.075, 0.1, 0.15, 0.2, 0.275, 0.35, 0.425),
    UPPER: (0.575, 0.65, 0.725, 0.8, 0.875, 0.95, 0.99),
}
ON_UNLOADING = {
    "reversal": (0.98, 0.95, 0.9),
    "unloading": (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05),
}
NEAR_TOP = 0.99  # share of the largest force beyond which travel at the top counts
LATE_START = 0.08  # share of the largest force; a loading that begins above it is read from there
BEYOND = 0.01  # share of the largest force by which a tared loading may end too early
FIRST = 3  # readings whose median is the force at which a record begins
FEW = 20  # readings on loading; of fewer, as of load steps, nothing is read below the first
GOES_ON = 1.25  # times the largest force: a curve pressed further has no unloading to compare
SEGMENTS = {  # in words
    TOE: "first touch of the confined test",
    "loading": "lower half of loading in the confined test",
    "reversal": "reversal at the top of the confined test",
    "unloading": "unloading of the confined test",
    "before contact": "reading before contact in the confined test",
}
VARIATIONS = (
    Variation("confined test in a freshly greased mould", 3.0, entries=("fresh_grease",)),
    Variation("confined test at a tenth of the speed", 2.0, faster=0.1),
)


class ConfinedFeatures(AbstractTestFeatures):
    """Kinds "loading", "unloading" (abscissa in N), "largest force", "travel at the top"."""

    name = NAME
    label = "confined test"
    axis = "displacement, 0 at half load (mm)"
    segments = SEGMENTS
    target = "depression_depth_mm"
    branches = ("loading", "unloading")
    tared = ("loading",)
    read_at_forces = True
    variations = VARIATIONS
    switches: ClassVar = {"fresh_grease": "wall_friction"}

    def with_rate(self, faster: float) -> dict[str, float]:
        return {"acquisition_lag": faster}  # it moves curves by speed times lag

    def declare(self, usual: UsualSizes) -> tuple[Feature, ...]:
        high = usual.force_high
        up = [
            _at(segment, "loading", share, high, 0.6 * share)
            for segment, shares in ON_LOADING.items()
            for share in shares
        ]
        top = [
            _of_the_turn("largest force", "N", high, 0.61),
            _of_the_turn("travel at the top", "mm", high, 0.62),
        ]
        down = [
            _at(segment, "unloading", share, high, 1.0 - 0.36 * share)
            for segment, shares in ON_UNLOADING.items()
            for share in shares
        ]
        return (*up, *top, *down)

    def read(
        self, features: Sequence[Feature], displacement: np.ndarray, force: np.ndarray
    ) -> Values:
        scale, turn = features[0].scale, self.last_of_rise(displacement, force)
        goes_on = force.max() > GOES_ON * scale
        returns = turn < len(displacement) - 1 and not goes_on
        rise = rising(displacement[: turn + 1], force[: turn + 1])
        fall = falling(displacement[turn:], force[turn:])
        starts_late = rise[1][0] > LATE_START * scale or turn < FEW
        zero = features[0].zero.of(*rise)
        top = displacement[turn] - displacement_on_rise(*rise, NEAR_TOP * scale)
        values = {
            ("largest force", 0.0): float(rise[1][-1]) if returns else np.nan,
            ("travel at the top", 0.0): float(top) if returns else np.nan,
        }
        branches = (("loading", rise, starts_late, False), ("unloading", fall, True, goes_on))
        for kind, branch, ends, lacks in branches:
            forces = np.array([f.abscissa for f in features if f.kind == kind])
            read = displacement_on_rise(*branch, forces) - zero
            missing = lacks | (ends & (forces < branch[1][0]))
            for force_n, value in zip(forces, np.where(missing, np.nan, read), strict=True):
                values[kind, float(force_n)] = float(value)
        return values

    def beyond(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        top = force.max()
        return np.array([
            f.test == NAME and f.kind == "loading" and f.abscissa > top + BEYOND * f.scale
            for f in features
        ])  # fmt: skip

    def before_start(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        begins = float(np.median(force[:FIRST]))
        return np.array([
            f.test == NAME and (f.segment == TOE or (f.kind == "loading" and f.abscissa < begins))
            for f in features
        ])  # fmt: skip

    def in_words(self, segment: str) -> str:
        if segment in SEGMENTS:
            return SEGMENTS[segment]
        return f"upper half of loading, {segment}, in the confined test"

    def last_of_rise(self, displacement: np.ndarray, force: np.ndarray) -> int:
        return int(np.argmax(displacement))

    def stretched_by(self, usual: UsualSizes) -> tuple[str, str]:
        return f"displacement at {NEAR_TOP * usual.force_high:g} N, loading", ""


def upper_half(high: float) -> str:
    """The upper half of loading by its forces (N)."""
    return f"{REFERENCE * high:.0f}-{high:.0f} N"


def _at(segment: str, kind: str, share: float, high: float, position: float) -> Feature:
    segment = upper_half(high) if segment == UPPER else segment
    name = f"displacement at {share * high:g} N, {kind}"
    return Feature(name, NAME, segment, kind, share * high, "mm", position, high, _zero(high))


def _of_the_turn(kind: str, unit: str, high: float, position: float) -> Feature:
    name, zero = f"{kind}, {NAME}", _zero(high)
    return Feature(name, NAME, "reversal", kind, 0.0, unit, position, high, zero)


def _zero(high: float) -> Zero:
    return Zero(REFERENCE * high)
