"""Unconfined compression: the mould is taken away, the specimen rests, and is crushed.

The crushing force F is the largest force, averaged over a short travel of the platen.
"""

from collections.abc import Sequence

from calibrate.core.tables import Duration, Speed
from calibrate.labtests.base import AbstractLabTest, Observable, Pace
from calibrate.labtests.features import (
    SHORT_OF,
    AbstractFeature,
    ForceAtDisplacement,
    seat,
    zero_of,
)
from calibrate.labtests.measured import Curve, Cylinder
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
)
CRUSHING = (0.005, 0.01, 0.02, 0.04, 0.06, 0.08, 0.10)  # of height, force read on crushing
STRAIN = 0.15  # to which a specimen is crushed
PEAK_WINDOW = 2.5e-4  # m; travel over which the crushing force is averaged


class UnconfinedTest(AbstractLabTest):
    """Crushing without mould: platen speed in m/s, rest before it in s."""

    type_name = "unconfined"
    title = "unconfined compression"
    observables = (FORCE,)
    plain = True
    shape = "softens"
    words = (
        *("unconfined", "uniaxial compressive strength", "ucs", "einaxial", "unbehindert"),
        *("no confinad", "inconfinad", "compresion simple", "non confine", "无侧限", "crush"),
    )

    rate: Speed = 1e-5
    rest: Duration = 1.0
    lubricated: bool = False
    at_once: bool = False

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        rows = 2 * int(PEAK_WINDOW / (pace.free * pace.sample_time) / 2) + 1
        if self.protocol:
            return self.follow(self.protocol, cylinder, pace, (CrushingForce(rows=rows),))
        return UnconfinedCompression(
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            nominal_rest=self.rest,
            stroke=STRAIN * cylinder.height,
            peak_rows=rows,
            name=self.called,
        )

    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        if self.protocol:
            return super().features(cylinder, curves)
        zero = zero_of(curves)
        reach = min(
            curve.displacement_mm.max() - seat(curve.displacement_mm, curve.force_n, zero)
            for curve in curves
        )
        places = [share * 1e3 * cylinder.height for share in CRUSHING]
        last = "crushing" if self.called == self.type_name else f"crushing, {self.called}"
        return [
            ForceAtDisplacement(f"force at {place:g} mm, {last}", "N", self.called, place, zero)
            for place in places
            if (1 - SHORT_OF) * place <= reach
        ]
