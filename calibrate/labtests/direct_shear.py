"""Direct shear (ASTM D3080): the shear stress that a box of two halves takes under a normal stress.

The stress is the horizontal force on the upper half and the lid over the first area.  The lid's
stress is the one that is stated; the stress ON the plane is given beside it, as friction on the
walls makes another of it.  Several normal stresses are several tests, each on a specimen of its
own; cohesion and friction angle are a line through their peaks.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Length, Speed, Stress, required
from calibrate.core.units import LENGTH, SPEED, STRESS, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace, ResultChannel, Shown
from calibrate.labtests.measured import (
    AbstractMachineRecord,
    Curve,
    Cylinder,
    MachineColumn,
    millimetres,
)
from calibrate.labtests.penetration import whole_steps
from calibrate.labtests.reading import mean_force
from calibrate.labtests.unconfined import still_rises
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.direct_shear import AT_END, DirectShear, round_box

SHEARED = Range(STRESS, "0.5 kPa", "10 MPa")
PEAK, RESIDUAL, ON_PLANE = (
    Observable(f"{source}_kpa", label, "kPa", source, 1e-3, within=0.25, symbol=symbol,
               usually=SHEARED)
    for source, label, symbol in (
        ("peak_shear_stress", "peak shear stress", "τ"),
        ("residual_shear_stress", "residual shear stress", "τr"),
        ("plane_stress", "normal stress on the plane", "σ'"),
    )
)  # fmt: skip
LID = "lid_stress_kpa"
OF_LINES = {  # by the normal stress that a line through peaks goes over: cohesion, friction angle
    over: tuple(
        Observable(f"{name}_on_{which}_{unit.lower()}", f"{name.replace('_', ' ')}, {said}", unit,
                   "", 1.0, within=0.25)
        for name, unit in (("cohesion", "kPa"), ("friction_angle", "deg"))
    )
    for over, which, said in (
        (ON_PLANE.name, "plane", "by the stress on the plane"),
        (LID, "lid", "by the stress of the lid"),
    )
}  # fmt: skip
SLOWER = 0.4  # of the speed at which free specimens are pressed
LIP = 1.5  # of the travel
PEAK_TRAVEL = 1e-4  # m, over which the peak is averaged
WIDTH = 0.15  # of the lid's force, within which its servo slows down
FARTHEST = 0.25  # of the diameter, by which the halves may move
OPENS = 0.2  # of the height, which the gap may take
HALF, CAUGHT = 0.5, 0.4  # of a sphere: how far the halves stand apart; below it spheres are caught
TRAVEL = Range(LENGTH, "1 mm", "60 mm")
ASTM_ACROSS = 10  # grains that a box is wide, in ASTM D3080
WIDE_ACROSS = 60  # of sands without an effect of size: doi 10.3390/civileng3010005
RING = Cylinder(0.0618, 0.02)  # m; of GB/T 50123


def _on_plane(test: Any, cylinder: Cylinder) -> float:
    """N in one kPa of shear stress."""
    return 1e3 * cylinder.area


class ShearRecord(AbstractMachineRecord):
    """Shear force or shear stress over the way of the moved half, under a normal stress."""

    loads = (
        MachineColumn("shear force"),
        MachineColumn("shear stress", _on_plane),
        MachineColumn("force", said="the shear force"),
        MachineColumn("stress", _on_plane, said="the shear stress"),
    )
    travels = (
        MachineColumn("shear displacement"),
        MachineColumn("displacement", said="the shear displacement"),
    )
    beside = ("normal displacement",)
    called = "box"
    condition = "normal_stress"
    conditions = (
        MachineColumn("normal stress", lambda test, cylinder: 1e3),
        MachineColumn("normal force", lambda test, cylinder: 1 / cylinder.area),
    )
    own_bed = True

    def entries(self, tool: Sequence[float]) -> tuple[dict[str, Any], str]:
        return {}, ""

    def bed(self, test: Any) -> Cylinder:
        return RING

    def reached(self, test: Any, cylinder: Cylinder, curves: Sequence[Curve]) -> dict[str, Any]:
        way = 1e-3 * min(float(curve.displacement_mm.max()) for curve in curves)
        travel = whole_steps(min(way, FARTHEST * cylinder.diameter))
        if not TRAVEL.ends[0] <= travel <= TRAVEL.ends[1]:
            problem = f"the halves of the box move by {1e3 * travel:.3g} mm"
            repair = f"export {TRAVEL.low} to {TRAVEL.high}, or check the unit of displacement"
            raise BadValue(problem, repair)
        return {"travel": millimetres(travel)}

    def numbers(self, test: Any, cylinder: Cylinder, curve: Curve) -> dict[str, float]:
        """The peak, and the stress at the end where the peak lies before."""
        last, area = 1e3 * test.travel, cylinder.area
        way, force = curve.displacement_mm, curve.force_n
        within = way <= last * (1 + 1e-9)
        found = {PEAK.name: 1e-3 * float(force[within].max()) / area}
        begun = (1 - AT_END) * last
        if way[within][int(np.argmax(force[within]))] < begun:
            found[RESIDUAL.name] = 1e-3 * mean_force(way, force, begun, last) / area
        return found


class DirectShearTest(AbstractLabTest):
    """Shear under a `normal_stress` (Pa) of the lid at `rate` (m/s) through `travel` (m).

    `gap` (m) is that between the halves, half a sphere unless stated: a laboratory opens its box by
    a large grain, and at a narrower gap the edges of both halves catch spheres.
    """

    type_name = "direct_shear"
    title = "direct shear"
    observables = (PEAK, RESIDUAL, ON_PLANE)
    combined = tuple(each for line in OF_LINES.values() for each in line)
    axes = ("shear displacement (mm)", "shear force (N)")
    channels = (
        ResultChannel("plane_force", "plane_force_n"),
        ResultChannel("lid_force", "lid_force_n"),
        ResultChannel("lid_height", "lid_height_mm", 1e3),
    )
    shape = "softens"
    in_mould = True
    record = ShearRecord()

    normal_stress: Annotated[Stress, SHEARED] = required('normal_stress = "50 kPa"')
    rate: Annotated[Speed, Range(SPEED, "0.001 mm/min", "100 mm/s")] = 1e-3 / 60
    travel: Annotated[Length, TRAVEL] = 6e-3
    gap: Annotated[Length, Range(LENGTH, "0.1 mm", "20 mm")] | None = None

    @model_validator(mode="after")
    def _check_gap(self) -> "DirectShearTest":
        if self.gap is not None and self.gap >= self.travel:
            raise BadValue("the gap is wider than the travel", "give a narrower one", "gap")
        return self

    def check_on(self, cylinder: Cylinder) -> None:
        if self.travel > FARTHEST * cylinder.diameter:
            problem = "the halves move by more than a quarter of their diameter"
            raise BadValue(problem, "give less travel, or a wider specimen", "travel")
        if self.gap is not None and self.gap > OPENS * cylinder.height:
            raise BadValue("the gap is a large part of the height", "give a narrower one", "gap")

    @classmethod
    def together(cls, found: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """Cohesion (kPa) and friction angle (deg): lines through peaks over the normal stress on
        the plane, and over the lid's; empty for fewer than two normal stresses."""
        said = {}
        for stress, (of_cohesion, of_angle) in OF_LINES.items():
            points = np.array([[row[stress], row[PEAK.name]] for row in found.values()])
            if len(np.unique(points[:, 0])) > 1:
                slope, cohesion = np.polyfit(points[:, 0], points[:, 1], 1)
                said[of_cohesion.name] = float(cohesion)
                said[of_angle.name] = float(np.degrees(np.arctan(slope)))
        return said

    def conditions(self) -> dict[str, float]:
        return {LID: 1e-3 * self.normal_stress}

    def opened(self, sphere: float, cylinder: Cylinder) -> float:
        """The gap (m) with spheres of this mean diameter (m)."""
        return min(HALF * sphere, OPENS * cylinder.height) if self.gap is None else self.gap

    def doubt(self, observable: Observable, shown: Shown) -> str:
        said = []
        if shown.across < WIDE_ACROSS and observable in (PEAK, RESIDUAL):
            least = f" (ASTM D3080 asks for {ASTM_ACROSS})" * (shown.across < ASTM_ACROSS)
            said.append(
                f"the box is {shown.across:.1f} spheres wide{least}: below {WIDE_ACROSS} strengths "
                "read high (a friction angle by some 2 degrees at 16 spheres, 6 at eight)"
            )
        sphere = shown.cylinder.diameter / shown.across
        gap = self.opened(sphere, shown.cylinder)
        if gap < CAUGHT * sphere and observable in (PEAK, RESIDUAL):
            repair = "give a finer --preset" if self.gap is None else "leave `gap` out"
            said.append(
                f"the gap of {1e3 * gap:.3g} mm is {gap / sphere:.2f} of a sphere: the edges of "
                f"both halves catch spheres, and strengths read too high; {repair}"
            )
        if observable.source == PEAK.source and still_rises(*shown.curve.T):
            said.append(
                f"the shear force still rises at the end of the travel, {1e3 * self.travel:.3g} "
                "mm: there is no peak, the number is where the curve stops"
            )
        return "; ".join(said)

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        area = math.pi / 4 * cylinder.diameter**2
        gap = self.opened(pace.sphere, cylinder)
        lower, upper = round_box(
            cylinder.diameter, cylinder.height, cylinder.height / 2, gap, LIP * self.travel
        )
        speed = SLOWER * pace.free
        rows = 2 * int(PEAK_TRAVEL / (speed * pace.sample_time) / 2) + 1
        return DirectShear(
            lower=lower,
            upper=upper,
            area=area,
            normal_force=self.normal_stress * area,
            simulated_rate=speed,
            nominal_rate=self.rate,
            stroke=self.travel,
            servo_width=WIDTH * self.normal_stress * area,
            peak_rows=rows,
            name=self.called,
        )
