"""A run of the machine without soil: the platen presses on the bare base, and what yields is told.

The deflection is the displacement at the largest force.  It is 0 in the base model, whose machine
is rigid, and no soil changes it: a fit compares nothing of this test.  What the machine reads with
a known weight on its load cell is a number of its own, for the diagnosis.
"""

from typing import Annotated

from pydantic import model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import Duration, Force
from calibrate.core.units import STRAIN, Range
from calibrate.labtests.base import AbstractLabTest, Observable, Pace
from calibrate.labtests.measured import Cylinder
from calibrate.labtests.protocol import LOW_LOAD, WAIT
from jdem.apparatus.base import AbstractApparatus
from jdem.apparatus.platen_on_base import PlatenOnBase

DEFLECTION = Observable(
    "deflection_mm", "deflection of the machine", "mm", "deflection", 1e3, within=0.15,
    usually=Range(STRAIN, "0.0001 %", "50 %"),
)  # fmt: skip


class MachineTest(AbstractLabTest):
    """Loading on the bare base to `force` (N) within `loading` (s), and unloading as fast; a known
    `weight` (N) on the load cell `reads` (N) what it does; None: none was laid on."""

    type_name = "machine"
    title = "machine without soil"
    observables = (DEFLECTION,)
    with_soil = False

    force: Annotated[Force, LOW_LOAD] = 400.0
    loading: Annotated[Duration, WAIT] = 60.0
    weight: Annotated[Force | None, LOW_LOAD] = None
    reads: Annotated[Force | None, LOW_LOAD] = None

    @model_validator(mode="after")
    def _check_bare(self) -> "MachineTest":
        if self.loading <= 0:
            raise BadValue("the force takes no time to rise", 'give e.g. "60 s"', "loading")
        if self.weight is not None and self.reads is None:
            repair = f'give what the machine shows with it, e.g. "{self.weight:g} N", or no weight'
            raise BadValue("nothing is said of the weight", repair, "reads")
        if self.reads is not None and self.weight is None:
            raise BadValue("there is no known weight", 'give weight = "200 N"', "weight")
        for name, given in (("protocol", self.protocol), ("specimen", self.specimen)):
            if given:
                problem = f"a run of the machine without soil has no {name}"
                raise BadValue(problem, "leave it out, give force and loading", name)
        return self

    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        return PlatenOnBase(force=self.force, loading=self.loading, name=self.called)

    def guides(self) -> tuple[float, ...]:
        return (self.force,)
