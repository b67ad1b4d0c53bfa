"""Repose angle by a lifted cylinder: how steep the heap is that soil leaves.

The angle is that of the mass profile, which no single sphere decides; the angles of height over
base and of the highest spheres stand beside it, because papers measure one or the other on a
picture.  Cohesive soil may stand as it stood in the cylinder, and then has no angle.
"""

from typing import Annotated

import numpy as np

from calibrate.core.tables import Length, Speed
from calibrate.core.units import ANGLE, LENGTH, SPEED, STRAIN, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace, Shown
from calibrate.labtests.measured import Cylinder
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.repose import LiftedCylinder, tube

SLOPES = Range(ANGLE, "3 deg", "89 deg")
DEGREES = 180 / np.pi
REPOSE, BY_HEIGHT, BY_TOP = (
    Observable(f"{source}_deg", label, "deg", source, DEGREES, within=0.25, symbol=symbol,
               usually=SLOPES)
    for source, label, symbol in (
        ("repose_angle", "repose angle", "θ"),
        ("repose_angle_by_height", "repose angle, height over base", "θh"),
        ("repose_angle_by_top", "repose angle, highest spheres", "θt"),
    )
)  # fmt: skip
HEAP = Observable(
    "heap_height_mm", "height of the heap", "mm", "heap_height", 1e3, within=0.15,
    usually=Range(STRAIN, "1 %", "150 %"),
)  # fmt: skip
STANDS = 0.85  # of the specimen's height, from which on the soil stands
CLEAR = 1.1  # of the soil's height, to which the cylinder is lifted


class ReposeTest(AbstractLabTest):
    """A cylinder lifted at `rate` (m/s) by `lift` (m), a little more than the soil's height unless
    given."""

    type_name = "repose_angle"
    title = "repose angle"
    observables = (REPOSE, BY_HEIGHT, BY_TOP, HEAP)
    axes = ("lift of the cylinder (mm)", "force on the cylinder (N)")
    in_mould = True

    rate: Annotated[Speed, Range(SPEED, "0.5 mm/s", "0.5 m/s")] = 0.01
    lift: Annotated[Length | None, Range(LENGTH, "5 mm", "1 m")] = None

    def doubt(self, observable: Observable, shown: Shown) -> str:
        left = 1e-3 * shown.numbers[HEAP.source] / shown.cylinder.height
        if observable.source == HEAP.source or left < STANDS:
            return ""
        return (
            f"the heap is still {100 * left:.0f} % as high as the specimen was: the soil stands, "
            "and has no angle of repose"
        )

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        return LiftedCylinder(
            tube=tube(cylinder.diameter, cylinder.height),
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            stroke=CLEAR * cylinder.height if self.lift is None else self.lift,
            name=self.called,
        )
