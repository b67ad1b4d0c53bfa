"""Confined compression: the platen comes down in the mould to a force, and returns.

Depression depth H is the displacement between two forces on loading, 200 N and 400 N in Chen et
al. 2023, Sustainability 15, 15079.
"""

from collections.abc import Sequence
from typing import Annotated

from pydantic import model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Force, Speed
from calibrate.labtests.base import STROKE, AbstractLabTest, Observable, Pace
from calibrate.labtests.features import (
    AbstractFeature,
    DisplacementOnLoading,
    DisplacementOnUnloading,
    zero_of,
)
from calibrate.labtests.measured import Curve, Cylinder
from calibrate.labtests.protocol import LOAD, LOW_LOAD, PLATEN
from calibrate.labtests.reading import Zero
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.confined import ConfinedCompression
from jdem.observables import DepressionDepth

DEPTH = Observable(
    "depression_depth_mm",
    "depression depth",
    "mm",
    "depression_depth",
    1e3,
    within=0.15,
    symbol="H",
)
LOADING = (0.125, 0.25, 0.5, 0.75, 1.0)  # of force_high, displacement read on loading
UNLOADING = (0.5, 0.1)  # of force_high, displacement read on unloading
REACHED = 0.98  # of force_high is what a measured curve has to reach


class ConfinedTest(AbstractLabTest):
    """Loading in the mould: platen speed in m/s, the two forces of the depression depth in N.

    `pressed_at` is for a simulation that stands for a laboratory: the speed at which its platen
    really moved, where its clock runs as if it had moved at `rate`.
    """

    type_name = "confined"
    title = "confined compression"
    observables = (DEPTH,)
    plain = True
    shape = "stiffens"

    rate: Annotated[Speed, PLATEN] = 8e-3
    pressed_at: Annotated[Speed | None, PLATEN] = None
    force_low: Annotated[Force, LOW_LOAD] = 200.0
    force_high: Annotated[Force, LOAD] = 400.0
    greased: bool = True
    fresh_grease: bool = False

    @property
    def speed(self) -> float:
        """m/s, of the platen as it really moved."""
        return self.rate if self.pressed_at is None else self.pressed_at

    @model_validator(mode="after")
    def _check_order(self) -> "ConfinedTest":
        if self.force_low >= self.force_high:
            problem = f"{self.force_high:g} N is not above force_low, {self.force_low:g} N"
            raise BadValue(problem, 'give a higher force such as "400 N"', "force_high")
        return self

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        if self.protocol:
            depth = DepressionDepth(force_low=self.force_low, force_high=self.force_high)
            return self.follow(self.protocol, cylinder, pace, (depth,))
        return ConfinedCompression(
            simulated_rate=pace.in_mould,
            nominal_rate=self.rate,
            force_low=self.force_low,
            force_high=self.force_high,
            stroke=STROKE * cylinder.height,
            name=self.called,
        )

    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        if self.protocol:
            return super().features(cylinder, curves)
        zero, top = zero_of(curves), min(float(curve.force_n.max()) for curve in curves)
        places = [min(share * self.force_high, top) for share in LOADING]
        found: list[AbstractFeature] = [
            DisplacementOnLoading(*self._read_at(force, "loading"), Zero(zero))
            for force in places
            if force > zero
        ]
        if all(curve.force_n[-1] < UNLOADING[-1] * self.force_high for curve in curves):
            found += [
                DisplacementOnUnloading(*self._read_at(load, "unloading"), Zero(zero))
                for load in (share * self.force_high for share in UNLOADING)
            ]
        return found

    def refusal(self, curve: Curve) -> BadValue | None:
        if self.protocol:
            return None
        if curve.force_n.max() >= REACHED * self.force_high:
            return self.cyclic(curve)
        return BadValue(
            f"the largest force is {curve.force_n.max():.4g} N, below {self.called}.force_high",
            f"give a curve that reaches {self.force_high:g} N, or lower force_high",
        )

    def guides(self) -> tuple[float, ...]:
        return self.force_low, self.force_high

    def _read_at(self, force: float, branch: str) -> tuple[str, str, str, float]:
        name = f"displacement at {force:.4g} N, {branch}"
        if self.called != self.type_name:
            name += f", {self.called}"
        return name, "mm", self.called, force
