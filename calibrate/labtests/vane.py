"""Vane shear (ASTM D4648): the torque that turns a cross of four blades in the bed.

The vane strength is the peak torque over K, which takes the stress to be uniform on the mantle and
both ends.  Soil with friction gives more of it at depth.  The curve is the way of the blades' rim
(mm) and the force at the rim (N) that has the torque.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Length, Rotation, Speed
from calibrate.core.units import ROTATION, STRESS, TORQUE, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace, ResultChannel
from calibrate.labtests.measured import (
    AbstractMachineRecord,
    Curve,
    Cylinder,
    MachineColumn,
    millimetres,
)
from calibrate.labtests.penetration import DEPTH, PUSHED, TOOL, check_room, roomy
from calibrate.labtests.reading import mean_force
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.vane import AT_END, VaneShear, vane, vane_constant

TURNED = Range(TORQUE, "0.05 mN*m", "500 N*m")
PEAK, RESIDUAL = (
    Observable(f"{source}_mnm", label, "mN m", source, 1e3, within=0.25, symbol=symbol,
               usually=TURNED)
    for source, label, symbol in (
        ("peak_torque", "peak torque of the vane", "T"),
        ("residual_torque", "residual torque of the vane", "Tr"),
    )
)  # fmt: skip
STRENGTH = Observable(
    "vane_strength_kpa", "vane strength", "kPa", "vane_strength", 1e-3, within=0.25, symbol="su",
    usually=Range(STRESS, "0.1 kPa", "2 MPa"),
)  # fmt: skip
RIM = 0.05  # m/s, at which the rim moves
RESTING = 50e3  # Pa on the blades' section, within which the vane counts as without axial force
PEAK_TRAVEL = 2e-4  # m of the rim, over which the peak is averaged
COVERED = 2.0  # heights of the blades, to which ASTM D4648 inserts them at least
THIN = 0.1  # of the vane's width
TURNS = (10.0, 720.0)  # degrees


class VaneRecord(AbstractMachineRecord):
    """Torque (N m) over the vane's angle (rad)."""

    loads = (MachineColumn("torque", lambda test, cylinder: 2 / test.diameter),)
    travels = (MachineColumn("angle", lambda test, cylinder: 1e3 * test.diameter / 2),)
    tool = ("diameter", "height")
    called = "vane"

    def entries(self, tool: Sequence[float]) -> tuple[dict[str, Any], str]:
        width, height = (*tool, tool[0])[:2]
        thickness = min(VaneTest.model_fields["thickness"].default, THIN * width)
        sizes = {"diameter": width, "height": height, "thickness": thickness}
        sizes["depth"] = COVERED * height
        as_high = "blades as high as the vane is wide, " if len(tool) < 2 else ""
        not_said = f"{as_high}the blades' thickness, and a depth of twice their height (ASTM D4648)"
        return {name: millimetres(size) for name, size in sizes.items()}, not_said

    def bed(self, test: Any) -> Cylinder:
        return roomy(test.depth, test.diameter, test.diameter)

    def reached(self, test: Any, cylinder: Cylinder, curves: Sequence[Curve]) -> dict[str, Any]:
        least, most = TURNS
        way = min(float(curve.displacement_mm.max()) for curve in curves)
        angle = math.degrees(1e-3 * way / (test.diameter / 2))
        if angle < least:
            problem = f"the vane is turned by {angle:.3g} degrees only"
            repair = f"export at least {least:g} degrees, or check the unit of angle"
            raise BadValue(problem, repair)
        return {"angle": min(math.floor(100 * angle + 1e-6) / 100, most)}

    def numbers(self, test: Any, cylinder: Cylinder, curve: Curve) -> dict[str, float]:
        """The peak torque, and the one at the end where the peak lies before."""
        rim = test.diameter / 2
        last = 1e3 * rim * math.radians(test.angle)
        way, force = curve.displacement_mm, curve.force_n
        within = way <= last * (1 + 1e-9)
        found = {PEAK.name: 1e3 * rim * float(force[within].max())}
        begun = (1 - AT_END) * last
        if way[within][int(np.argmax(force[within]))] < begun:
            found[RESIDUAL.name] = 1e3 * rim * mean_force(way, force, begun, last)
        return found

    def rate(self, test: Any, speed: float) -> str:
        return f"{math.degrees(speed / (test.diameter / 2)):.4g} deg/s"


class VaneTest(AbstractLabTest):
    """Blades of a diameter, height and thickness (m), lower face at `depth` (m), turned at `rate`
    (rad/s) through `angle` (degrees)."""

    type_name = "vane_shear"
    title = "vane shear"
    observables = (PEAK, RESIDUAL, STRENGTH)
    axes = ("way of the blades' rim (mm)", "force at the rim (N)")
    channels = (
        ResultChannel("angle", "angle_deg", math.degrees(1.0)),
        ResultChannel("torque", "torque_mnm", 1e3),
    )
    shape = "softens"
    in_mould = True
    record = VaneRecord()

    diameter: Annotated[Length, TOOL] = 0.02
    height: Annotated[Length, TOOL] = 0.02
    thickness: Annotated[Length, Range(TOOL.kind, "0.3 mm", "20 mm")] = 1.5e-3
    depth: Annotated[Length, DEPTH] = 0.03
    insertion: Annotated[Speed, PUSHED] = 0.01
    rate: Annotated[Rotation, Range(ROTATION, "0.05 deg/s", "60 deg/s")] = math.radians(1.0)
    angle: float = Field(default=90.0, ge=TURNS[0], le=TURNS[1])

    @model_validator(mode="after")
    def _check_blades(self) -> "VaneTest":
        if self.thickness > 0.3 * self.diameter:
            raise BadValue("the blades are no blades", "give thinner ones", "thickness")
        if self.depth < self.height:
            raise BadValue("the vane is not covered", "give at least its height", "depth")
        return self

    def check_on(self, cylinder: Cylinder) -> None:
        check_room(self.depth, self.diameter, cylinder, "depth")

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        speed = RIM / (self.diameter / 2)
        rows = 2 * int(PEAK_TRAVEL / (RIM * pace.sample_time) / 2) + 1
        return VaneShear(
            vane=vane(self.diameter, self.height, self.thickness),
            constant=vane_constant(self.diameter, self.height),
            simulated_rate=speed,
            nominal_rate=self.rate,
            insertion_rate=pace.free,
            depth=self.depth,
            stroke=math.radians(self.angle),
            servo_width=RESTING * 2 * self.diameter * self.thickness,
            rim=self.diameter / 2,
            peak_rows=rows,
            width=self.diameter,
            name=self.called,
        )
