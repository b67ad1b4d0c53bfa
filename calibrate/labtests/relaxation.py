"""Relaxation: the platen goes to a force in the mould and stands still; what force is left?

Rest of the force F(t)/F(0) is what rate-dependent soils lose (Terzaghi's bonds, viscous water).
The base model loses only what its spheres still settle.
"""

from collections.abc import Sequence
from typing import Annotated

from calibrate.core.tables import Duration, Force, Speed
from calibrate.labtests.base import AbstractLabTest, Observable, Pace
from calibrate.labtests.features import (
    AbstractFeature,
    DisplacementOnLoading,
    ForceAtEnd,
    zero_of,
)
from calibrate.labtests.measured import Curve, Cylinder
from calibrate.labtests.protocol import LOAD, PLATEN, WAIT, StepTable
from calibrate.labtests.reading import Zero
from jdem.apparatus.base import AbstractApparatus
from jdem.observables import ForceLeft

FORCE_LEFT = Observable(
    "force_left_n", "force left after the hold", "N", "force_left", 1.0, within=0.25, drawn=True
)
LOADING = (0.25, 0.5, 0.75)  # of the force, displacement read on loading


class RelaxationTest(AbstractLabTest):
    """Loading in the mould at `rate` (m/s) to `force` (N), then a hold of `hold` (s)."""

    type_name = "relaxation"
    title = "relaxation test"
    observables = (FORCE_LEFT,)

    rate: Annotated[Speed, PLATEN] = 8e-3
    force: Annotated[Force, LOAD] = 400.0
    hold: Annotated[Duration, WAIT] = 60.0

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        steps = self.protocol or [
            StepTable(step="load", to=f"{self.force!r} N", rate=f"{self.rate!r} m/s"),
            StepTable.model_validate({"step": "hold", "for": f"{self.hold!r} s"}),
        ]
        held = [number for number, step in enumerate(steps) if step.step == "hold"]
        gauge = ForceLeft(held=held[-1] if held else len(steps) - 1)
        return self.follow(steps, cylinder, pace, (gauge,))

    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        if self.protocol:
            return super().features(cylinder, curves)
        zero = zero_of(curves)
        found: list[AbstractFeature] = [
            DisplacementOnLoading(
                f"displacement at {share * self.force:g} N, {self.called}",
                "mm", self.called, share * self.force, Zero(zero),
            )
            for share in LOADING
            if share * self.force > zero
        ]  # fmt: skip
        return [*found, ForceAtEnd(f"force after the hold, {self.called}", "N", self.called)]
