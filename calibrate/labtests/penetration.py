"""Tools pushed into the bed: cone penetration (ASABE S313.3, EP542) and plate sinkage.

A cone's index is its mean resistance over a range of depths of its base; a plate's pressure is read
at a sinkage, counted from a seating pressure.  The bed is what the tests before left in its mould,
or stands in it as it was prepared.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Length, Speed
from calibrate.core.units import LENGTH, SPEED, STRESS, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace, ResultChannel
from calibrate.labtests.measured import (
    AbstractMachineRecord,
    Curve,
    Cylinder,
    MachineColumn,
    millimetres,
)
from calibrate.labtests.reading import displacement_on_rise, mean_force
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.penetration import (
    MeanPressure,
    Penetration,
    PressureAt,
    cone,
    cone_length,
    plate,
)

CONE_INDEX = Observable(
    "cone_index_kpa", "cone index", "kPa", "cone_index", 1e-3, within=0.25, symbol="CI",
    usually=Range(STRESS, "1 kPa", "20 MPa"),
)  # fmt: skip
SINKAGE_PRESSURE = Observable(
    "sinkage_pressure_kpa", "pressure at the sinkage", "kPa", "sinkage_pressure", 1e-3,
    within=0.25, symbol="p", usually=Range(STRESS, "0.1 kPa", "20 MPa"),
)  # fmt: skip
TOOL = Range(LENGTH, "2 mm", "300 mm")
DEPTH = Range(LENGTH, "0.5 mm", "1 m")
PUSHED = Range(SPEED, "0.01 mm/s", "1 m/s")
CLEAR = 0.9  # of the bed's height, to which a tool may go: below, the base carries it
NARROW = 0.5  # of the mould's diameter, from which on a tool has no room
SEATED_WITHIN = 0.05  # of the bed's height, in which a plate is seated
BEYOND = 1.05  # of the last depth that is read, to which the tool is pushed
SEATING = 1e3  # Pa; pressure of a plate from which sinkage counts
AROUND = 0.25e-3  # m to either side of a sinkage, over which its pressure is a mean
ROOM = 5.0  # times a tool's width, as wide as a bed is
WIDEST, SLENDEREST = 0.4, 5.0  # m, and height over diameter, of a bed


def check_room(deepest: float, width: float, cylinder: Cylinder, name: str) -> None:
    """Refuse a tool that goes too deep (m) for the bed, or is too wide (m) for it."""
    if deepest > CLEAR * cylinder.height:
        went, high = 1e3 * deepest, 1e3 * cylinder.height
        problem = f"the tool goes {went:.0f} mm deep into a bed of {high:.0f} mm"
        repair = f"stay above {100 * CLEAR:.0f} % of the height, or give a higher specimen"
        raise BadValue(problem, repair, name)
    if width >= NARROW * cylinder.diameter:
        wide, mould = 1e3 * width, 1e3 * cylinder.diameter
        problem = f"a tool {wide:.0f} mm wide has no room in a mould of {mould:.0f} mm"
        repair = "give a narrower tool or a wider specimen, at least five times the tool"
        raise BadValue(problem, repair, "diameter")


def roomy(deepest: float, width: float, below: float) -> Cylinder:
    """A bed for a tool of a width (m) that goes `deepest` (m), with soil `below` it (m)."""
    height = math.ceil(1e3 * max(deepest + below, 1.02 * deepest / CLEAR)) / 1e3
    wide = math.ceil(1e3 * max(ROOM * width, height / SLENDEREST)) / 1e3
    return Cylinder(min(wide, WIDEST), height)


def whole_steps(length: float) -> float:
    """A length (m) rounded down to 0.01 mm, so that no curve ends before it."""
    return math.floor(1e5 * length + 1e-6) / 1e5


def _area(test: Any) -> float:
    return math.pi / 4 * test.diameter**2


def _pressed(test: Any, cylinder: Cylinder) -> float:
    """N in one kPa on the tool."""
    return 1e3 * _area(test)


PRESSED = (
    MachineColumn("force"),
    MachineColumn("resistance", _pressed),
    MachineColumn("stress", _pressed),
)


class ConeRecord(AbstractMachineRecord):
    """Force or pressure on the base, and its depth; or the travel from where the apex touches."""

    loads = PRESSED
    travels = (
        MachineColumn(
            "depth", counts="as written", said="the depth of the cone's base, as in ASABE EP542"
        ),
        MachineColumn(
            "displacement",
            counts="contact",
            datum=lambda test: 1e3 * cone_length(test.diameter, test.angle),
            said="the way from where the apex touches the soil: the base is less deep by the "
            "length of the cone",
        ),
    )
    tool = ("diameter",)
    called = "cone"

    def entries(self, tool: Sequence[float]) -> tuple[dict[str, Any], str]:
        return {"diameter": millimetres(tool[0])}, "a cone of 30 degrees without a shaft"

    def bed(self, test: Any) -> Cylinder:
        return roomy(test.deepest, test.diameter, test.diameter)

    def reached(self, test: Any, cylinder: Cylinder, curves: Sequence[Curve]) -> dict[str, Any]:
        first = 1e-3 * max(float(curve.displacement_mm[0]) for curve in curves)
        last = whole_steps(1e-3 * min(float(curve.displacement_mm.max()) for curve in curves))
        least, _ = DEPTH.ends
        first = math.ceil(1e5 * first - 1e-6) / 1e5 if first >= least else 0.0
        if last < max(least, first + least):
            problem = f"the base of the cone comes to a depth of {1e3 * last:.3g} mm only"
            raise BadValue(problem, "export the whole record, or check the unit of depth")
        begun = {"depth_from": millimetres(first)} if first else {}
        return {**begun, "depth_to": millimetres(last)}

    def numbers(self, test: Any, cylinder: Cylinder, curve: Curve) -> dict[str, float]:
        ends = 1e3 * (test.depth_from or 0.0), 1e3 * test.depth_to
        mean = mean_force(curve.displacement_mm, curve.force_n, *ends)
        return {CONE_INDEX.name: 1e-3 * mean / _area(test)}


class PlateRecord(AbstractMachineRecord):
    """Force or pressure, and sinkage."""

    loads = PRESSED
    travels = (
        MachineColumn("depth", counts="as written"),
        MachineColumn("displacement", counts="contact"),
    )
    tool = ("diameter", "thickness")
    called = "plate"

    def entries(self, tool: Sequence[float]) -> tuple[dict[str, Any], str]:
        stated = dict(zip(self.tool, map(millimetres, tool), strict=False))
        return stated, "" if len(tool) > 1 else "the thickness of the plate"

    def bed(self, test: Any) -> Cylinder:
        sunk = BEYOND * test.sinkage
        below = 2 * test.diameter
        return roomy((sunk + SEATED_WITHIN * below) / (1 - SEATED_WITHIN), test.diameter, below)

    def reached(self, test: Any, cylinder: Cylinder, curves: Sequence[Curve]) -> dict[str, Any]:
        ways = [float(c.displacement_mm.max()) - self._seated(test, c) for c in curves]
        reach = whole_steps(min(1e-3 * min(ways) - AROUND, test.diameter / 2))
        least, _ = DEPTH.ends
        if reach < least:
            problem = f"the plate sinks by {min(ways):.3g} mm only"
            raise BadValue(problem, "export the whole record, or check the unit of sinkage")
        return {"sinkage": millimetres(reach)}

    def numbers(self, test: Any, cylinder: Cylinder, curve: Curve) -> dict[str, float]:
        at = self._seated(test, curve) + 1e3 * test.sinkage
        near = at - 1e3 * AROUND, at + 1e3 * AROUND
        mean = mean_force(curve.displacement_mm, curve.force_n, *near)
        return {SINKAGE_PRESSURE.name: 1e-3 * mean / _area(test)}

    def _seated(self, test: Any, curve: Curve) -> float:
        """Displacement (mm) at which the plate is seated."""
        force = SEATING * _area(test)
        return float(displacement_on_rise(curve.displacement_mm, curve.force_n, np.array(force)))


class ConeTest(AbstractLabTest):
    """A cone of a base diameter (m) and a full angle (degrees) pushed at `rate` (m/s); its index is
    the mean over depths of its base from `depth_from` to `depth_to` (m)."""

    type_name = "cone_penetration"
    title = "cone penetration"
    observables = (CONE_INDEX,)
    axes = ("depth of the cone's base (mm)", "force on the cone (N)")
    channels = (ResultChannel("shaft", "shaft_force_n"),)
    shape = "stiffens"
    in_mould = True
    record = ConeRecord()

    diameter: Annotated[Length, TOOL] = 12.83e-3
    shaft: Annotated[Length | None, TOOL] = None
    angle: float = Field(default=30.0, gt=5.0, lt=170.0)
    rate: Annotated[Speed, PUSHED] = 0.03
    depth_from: Annotated[Length | None, DEPTH] = None
    depth_to: Annotated[Length, DEPTH] = 0.03

    @model_validator(mode="after")
    def _check_tool(self) -> "ConeTest":
        if self.shaft is not None and self.shaft > self.diameter:
            raise BadValue("the shaft is wider than the cone", "give it a smaller one", "shaft")
        if self.depth_from is not None and self.depth_from >= self.depth_to:
            raise BadValue("it is not above depth_to", "give a smaller depth", "depth_from")
        return self

    @property
    def deepest(self) -> float:
        """How deep the apex goes, m."""
        return BEYOND * self.depth_to + cone_length(self.diameter, self.angle)

    def check_on(self, cylinder: Cylinder) -> None:
        check_room(self.deepest, self.diameter, cylinder, "depth_to")

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        first = 0.0 if self.depth_from is None else self.depth_from
        area = math.pi / 4 * self.diameter**2
        return Penetration(
            parts=cone(self.diameter, self.angle, self.shaft or 0.0),
            gauges=(
                MeanPressure(area=area, low=first, high=self.depth_to, name=CONE_INDEX.source),
            ),
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            stroke=self.deepest,
            datum=cone_length(self.diameter, self.angle),
            width=self.diameter,
            name=self.called,
        )


class PlateTest(AbstractLabTest):
    """A round plate of a diameter and a thickness (m) pushed at `rate` (m/s); the pressure is read
    at `sinkage` (m), which counts from a pressure of 1 kPa."""

    type_name = "plate_sinkage"
    title = "plate sinkage"
    observables = (SINKAGE_PRESSURE,)
    axes = ("sinkage (mm)", "force on the plate (N)")
    shape = "stiffens"
    in_mould = True
    record = PlateRecord()

    diameter: Annotated[Length, TOOL] = 0.025
    thickness: Annotated[Length, DEPTH] = 4e-3
    rate: Annotated[Speed, PUSHED] = 0.01
    sinkage: Annotated[Length, DEPTH] = 6e-3

    def deepest(self, cylinder: Cylinder) -> float:
        """How deep the plate goes, m."""
        return BEYOND * self.sinkage + SEATED_WITHIN * cylinder.height

    def check_on(self, cylinder: Cylinder) -> None:
        check_room(self.deepest(cylinder), self.diameter, cylinder, "sinkage")

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        area = math.pi / 4 * self.diameter**2
        return Penetration(
            parts=plate(self.diameter, self.thickness),
            gauges=(PressureAt(area=area, depth=self.sinkage, name=SINKAGE_PRESSURE.source),),
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            stroke=self.deepest(cylinder),
            seating_force=SEATING * area,
            width=self.diameter,
            name=self.called,
        )

    def guides(self) -> tuple[float, ...]:
        return (SEATING * math.pi / 4 * self.diameter**2,)
