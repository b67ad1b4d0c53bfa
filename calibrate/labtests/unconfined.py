"""Unconfined compression: the mould is taken away, the specimen rests, and is crushed.

The crushing force F is the largest force, averaged over a short travel of the platen.  The failure
strain is the displacement there, from 2 N on, over the specimen's height.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from calibrate.core.tables import Duration, Speed
from calibrate.core.units import STRAIN, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace, Shown
from calibrate.labtests.features import (
    SHORT_OF,
    AbstractFeature,
    ForceAtDisplacement,
    SecantModulus,
    StrainAtPeak,
    WorkToPeak,
    zero_of,
)
from calibrate.labtests.measured import Curve, Cylinder
from calibrate.labtests.protocol import LOAD, PLATEN, WAIT
from calibrate.labtests.reading import Zero, loading
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.observables import CrushingForce

FORCE = Observable(
    "crushing_force_n",
    "crushing force",
    "N",
    "crushing_force",
    1.0,
    within=0.25,
    drawn=True,
    symbol="F",
    usually=LOAD,
)
FAILURE_STRAIN = Observable(
    "failure_strain_percent",
    "failure strain",
    "%",
    "failure_strain",
    100.0,
    within=0.25,
    symbol="ε",
    usually=Range(STRAIN, "0.1 %", "50 %"),
    feature=lambda size: StrainAtPeak(
        "failure strain", "%", "unconfined", 1e3 * size.height, 0.5e3 * PEAK_WINDOW
    ),
)
SECANT_MODULUS = Observable(
    "secant_modulus_kpa",
    "secant modulus E50",
    "kPa",
    "secant_modulus",
    1e-3,
    within=0.25,
    symbol="E50",
    feature=lambda size: SecantModulus(
        "secant modulus", "kPa", "unconfined", 0.5, 1e6 * size.area, 1e3 * size.height
    ),
)
WORK = Observable(
    "work_to_failure_j",
    "work to failure",
    "J",
    "work_to_failure",
    1.0,
    within=0.25,
    symbol="W",
    feature=lambda size: WorkToPeak("work to failure", "J", "unconfined"),
)
CRUSHING = (0.005, 0.01, 0.02, 0.04, 0.06, 0.08, 0.10)  # of height, force read on crushing
END = 0.1  # share of the travel over which a force at the end is averaged
RISES = 0.01  # share of the force by which it is higher there than just before
CRUSHED_TO = 0.15  # strain
PEAK_WINDOW = 2.5e-4  # m; travel over which the crushing force is averaged


def still_rises(displacement_mm: np.ndarray, force_n: np.ndarray) -> bool:
    """Whether the force is largest at the end of a curve, and rising there."""
    if len(force_n) < 3 or np.ptp(displacement_mm) <= 0:
        return False
    left = (displacement_mm.max() - displacement_mm) / np.ptp(displacement_mm)
    last, before = force_n[left <= END], force_n[(left > END) & (left <= 2 * END)]
    if not len(before) or force_n.max() > last.max():
        return False
    return bool(last.mean() > (1 + RISES) * before.mean() and before.mean() > 0)


class UnconfinedTest(AbstractLabTest):
    """Crushing without mould: platen speed in m/s, rest before it in s."""

    type_name = "unconfined"
    title = "unconfined compression"
    observables = (FORCE,)
    further = (FAILURE_STRAIN, SECANT_MODULUS, WORK)
    plain = True
    shape = "softens"

    rate: Annotated[Speed, PLATEN] = 1e-5
    rest: Annotated[Duration, WAIT] = 1.0
    lubricated: bool = False
    at_once: bool = False

    @property
    def frees(self) -> bool:
        return True

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        rows = 2 * int(PEAK_WINDOW / (pace.free * pace.sample_time) / 2) + 1
        if self.protocol:
            return self.follow(self.protocol, cylinder, pace, (CrushingForce(rows=rows),))
        return UnconfinedCompression(
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            nominal_rest=self.rest,
            stroke=CRUSHED_TO * cylinder.height,
            peak_rows=rows,
            name=self.called,
        )

    def doubt(self, observable: Observable, shown: Shown) -> str:
        if not still_rises(*shown.curve.T):
            return ""
        travel = float(np.ptp(shown.curve[:, 0]))
        return (
            f"the force still rises at the end of the travel, {travel:.3g} mm: there is no "
            f"{observable.label}, the number is where the curve stops; a slender specimen "
            "(twice as high as wide) breaks, a flat one is only compressed"
        )

    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        if self.protocol:
            return super().features(cylinder, curves)
        zero = Zero(zero_of(curves))
        reach = min(
            curve.displacement_mm.max() - zero.of(*loading(curve.displacement_mm, curve.force_n))
            for curve in curves
        )
        places = [share * 1e3 * cylinder.height for share in CRUSHING]
        last = "crushing" if self.called == self.type_name else f"crushing, {self.called}"
        return [
            ForceAtDisplacement(f"force at {place:g} mm, {last}", "N", self.called, place, zero)
            for place in places
            if (1 - SHORT_OF) * place <= reach
        ]
