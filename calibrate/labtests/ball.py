"""Ball penetration: a ball pushed into the bed, as full-flow penetrometers in soft soil.

The resistance is the mean force over a range of depths of the ball's middle, over the area of its
section.  Its shaft is thin and is left out.
"""

import math
from typing import Annotated

from pydantic import model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Length, Speed
from calibrate.core.units import STRESS, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace
from calibrate.labtests.measured import Cylinder
from calibrate.labtests.penetration import BEYOND, DEPTH, PUSHED, TOOL, check_room
from jdem.apparatus.base import AbstractApparatus, Tool
from jdem.apparatus.penetration import MeanPressure, Penetration
from jdem.boundaries.base import DOWN, point
from jdem.boundaries.sphere import Sphere

RESISTANCE = Observable(
    "ball_resistance_kpa", "resistance of the ball", "kPa", "ball_resistance", 1e-3, within=0.25,
    symbol="q", usually=Range(STRESS, "0.5 kPa", "20 MPa"),
)  # fmt: skip


class BallTest(AbstractLabTest):
    """A ball of a diameter (m) pushed at `rate` (m/s); the mean is taken over depths of its middle
    from `depth_from` to `depth_to` (m)."""

    type_name = "ball_penetration"
    title = "ball penetration"
    observables = (RESISTANCE,)
    axes = ("depth of the ball's middle (mm)", "force (N)")
    shape = "stiffens"
    in_mould = True

    diameter: Annotated[Length, TOOL] = 0.015
    rate: Annotated[Speed, PUSHED] = 0.02
    depth_from: Annotated[Length, DEPTH] = 0.01
    depth_to: Annotated[Length, DEPTH] = 0.03

    @model_validator(mode="after")
    def _check_depths(self) -> "BallTest":
        if self.depth_from >= self.depth_to:
            raise BadValue("it is not above depth_to", "give a smaller depth", "depth_from")
        return self

    @property
    def deepest(self) -> float:
        """How deep the lowest point goes, m."""
        return BEYOND * self.depth_to + self.diameter / 2

    def check_on(self, cylinder: Cylinder) -> None:
        check_room(self.deepest, self.diameter, cylinder, "depth_to")

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        radius, area = self.diameter / 2, math.pi / 4 * self.diameter**2
        ball = Sphere.at(point(0.0, 0.0, 0.0, float), DOWN, radius)
        mean = MeanPressure(
            area=area, low=self.depth_from, high=self.depth_to, name=RESISTANCE.source
        )
        return Penetration(
            parts=(Tool("ball", ball, 4 * area),),
            gauges=(mean,),
            simulated_rate=pace.free,
            nominal_rate=self.rate,
            stroke=self.deepest,
            datum=radius,
            width=self.diameter,
            name=self.called,
        )
