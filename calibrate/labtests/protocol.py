"""A test's protocol as a lab file states it: a list of steps, each one movement of the machine.

    { step = "load", to = "400 N", rate = "8 mm/s" }     to: a force, stress, strain, displacement
    { step = "hold", for = "60 s" }                      keep = "displacement" or "force"
    { step = "unload", to = "0 N" }    { step = "reload", to = "400 N" }
    { step = "remove_mould" }          { step = "rest", for = "1 s" }     { step = "approach" }

Forces and stresses are those of the platen, displacements and strains count from the protocol's
begin and are known only while no step before went to a force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import AbstractTable, Duration, required
from calibrate.core.units import FORCE, FRACTION, LENGTH, SPEED, STRAIN_RATE, STRESS, first_of

KINDS = {"force": FORCE, "stress": STRESS, "displacement": LENGTH, "strain": FRACTION}
MOVING = ("load", "unload", "reload")
MOST_STEPS = 200
USUAL_RATE = 1e-3 / 60  # m/s; 1 mm/min


Name = Literal["approach", "load", "unload", "reload", "hold", "remove_mould", "rest"]


class StepTable(AbstractTable):
    """One step; `to` and `rate` of a movement, `for` of a hold or a rest."""

    step: Name = required('step = "load"')
    to: Any = None
    rate: Any = None
    keep: Literal["displacement", "force"] = "displacement"
    duration: Duration | None = Field(default=None, alias="for")

    @model_validator(mode="after")
    def _check_complete(self) -> "StepTable":
        moves, waits = self.step in MOVING, self.step in ("hold", "rest")
        if moves and self.to is None:
            raise BadValue("the step never ends: it says no `to`", 'add to = "400 N"', "to")
        if waits and self.duration is None:
            raise BadValue("the step never ends: it says no `for`", 'add for = "10 s"', "for")
        for name, given, wanted in (("to", self.to, moves), ("rate", self.rate, moves)):
            if given is not None and not wanted:
                raise BadValue(f"a step '{self.step}' has no {name}", "leave it out", name)
        if moves:
            self.goal()
            self.speed(0.1)
        return self

    def goal(self) -> tuple[str, float]:
        """Which quantity the step goes to, and its value (N, kPa, m or a fraction)."""
        expected = 'give a force, stress, displacement or strain: "400 N", "200 kPa", "2 mm", "5 %"'
        try:
            kind, value = first_of(self.to, list(KINDS.values()), expected)
        except BadValue as bad:
            raise BadValue(bad.problem, bad.repair, "to") from None
        name = next(name for name, each in KINDS.items() if each is kind)
        if value < 0 or (value == 0 and self.step != "unload"):
            raise BadValue(f"{self.to} is not above zero", 'give e.g. "400 N"', "to")
        if name == "strain" and value >= 1:
            raise BadValue(f"a strain of {self.to} leaves no specimen", 'give e.g. "5 %"', "to")
        return name, value

    def speed(self, height: float, usual: float = USUAL_RATE) -> float:
        """Platen speed (m/s) of a specimen of this height (m); `usual` where none is given."""
        if self.rate is None:
            return usual
        expected = 'give a speed or a strain rate: "8 mm/s", "1 %/min"'
        try:
            kind, value = first_of(self.rate, [SPEED, STRAIN_RATE], expected)
        except BadValue as bad:
            raise BadValue(bad.problem, bad.repair, "rate") from None
        if value <= 0:
            raise BadValue(f"{self.rate} is not above zero", expected, "rate")
        return value if kind is SPEED else value * height


@dataclass(frozen=True)
class Goal:
    """Where a movement ends: at a force (N), or at a displacement (m) from the begin."""

    force: float | None
    displacement: float | None


def goals(steps: Sequence[StepTable], area: float, height: float) -> list[Goal | None]:
    """Where each step ends, None for those that do not move; area in m2, height in m."""
    found: list[Goal | None] = []
    known = True  # whether the displacement is
    for number, step in enumerate(steps):
        if step.step not in MOVING:
            found.append(None)
            continue
        kind, value = step.goal()
        if kind in ("force", "stress"):
            known = False
            found.append(Goal(value * (1e3 * area if kind == "stress" else 1.0), None))
            continue
        if not known:
            problem = "the step goes to a displacement, but a step before it went to a force"
            raise BadValue(problem, 'go to a force or stress, such as "400 N"', f"[{number}].to")
        found.append(Goal(None, value * (height if kind == "strain" else 1.0)))
    return found


def check_protocol(steps: Sequence[StepTable]) -> None:
    """Refuses what cannot be run: nothing, too much, a mould that is removed twice."""
    if len(steps) > MOST_STEPS:
        raise BadValue(f"{len(steps)} steps are too many", f"give at most {MOST_STEPS}", "protocol")
    if sum(step.step == "remove_mould" for step in steps) > 1:
        raise BadValue("the mould is removed twice", "remove it once", "protocol")
