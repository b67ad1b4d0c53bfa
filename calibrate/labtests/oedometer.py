"""The oedometer: compression in a ring by load steps, with holds, unloading and reloading.

Measured are stress and strain or void ratio at the end of each step; the settlement s is the
farthest that the platen goes.  The base model knows no time: a step ends when its load is reached.
"""

from pydantic import model_validator

from calibrate.core.errors import BadValue
from calibrate.labtests.base import AbstractLabTest, Observable, Pace
from calibrate.labtests.measured import Cylinder
from jdem.apparatus.base import AbstractApparatus
from jdem.observables import LargestDisplacement

SETTLEMENT = Observable(
    "settlement_mm", "settlement", "mm", "settlement", 1e3, within=0.15, symbol="s"
)


class OedometerTest(AbstractLabTest):
    """Load steps in the ring; the protocol states them."""

    type_name = "oedometer"
    title = "oedometer test"
    observables = (SETTLEMENT,)
    shape = "steps"

    @model_validator(mode="after")
    def _check_steps(self) -> "OedometerTest":
        if not self.protocol:
            repair = 'add protocol = [{ step = "load", to = "100 kPa" }, ...]'
            raise BadValue(
                "an oedometer test has load steps, and none is given", repair, "protocol"
            )
        return self

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        return self.follow(self.protocol, cylinder, pace, (LargestDisplacement(),))
