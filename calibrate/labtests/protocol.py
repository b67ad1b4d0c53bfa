"""A test's protocol as a lab file states it: a list of steps, each one movement of the machine.

    { step = "load", to = "400 N", rate = "8 mm/s" }     to: a force, stress, strain, displacement
    { step = "hold", for = "60 s" }                      keep = "displacement" or "force"
    { step = "unload", to = "0 N" }    { step = "reload", to = "400 N" }
    { step = "remove_mould" }          { step = "rest", for = "1 s" }     { step = "approach" }

Forces and stresses are those of the platen; displacements and strains count from where the platen
first touches, and are known only while no step before went to a force.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import AbstractTable, Duration, required
from calibrate.core.units import (
    FORCE,
    FRACTION,
    LENGTH,
    SPEED,
    STRAIN,
    STRAIN_RATE,
    STRESS,
    TIME,
    Range,
    first_of,
)
from calibrate.labtests.measured import Cylinder
from jdem.apparatus.protocol import HOLD, KEEP_FORCE, OPEN, REST, TO_FORCE, TRAVEL, Step

KINDS = {"force": FORCE, "stress": STRESS, "displacement": LENGTH, "strain": FRACTION}
# Where the entries of tests usually lie: loads by the specimen's area, ways by its height.
LOAD = Range(STRESS, "0.5 kPa", "20 MPa")  # below, a free specimen falls under its own weight
LOW_LOAD = Range(STRESS, "0.005 kPa", "20 MPa")
WAY = Range(STRAIN, "0.001 %", "90 %")
PLATEN = Range(SPEED, "1e-6 mm/s", "500 mm/s")
RATE = Range(STRAIN_RATE, "1e-7 %/s", "1000 %/s")
WAIT = Range(TIME, "0.001 s", "400 day")

MOVING = ("load", "unload", "reload")
MOST_STEPS = 200
TOUCH = 2.0  # N; force at which the platen has come down on the specimen
USUAL_RATE = 1e-3 / 60  # m/s; 1 mm/min


class StepTable(AbstractTable):
    """One step; `to` and `rate` of a movement, `for` and `keep` of a hold, `for` of a rest."""

    step: Literal["approach", "load", "unload", "reload", "hold", "remove_mould", "rest"] = (
        required('step = "load"')
    )
    to: Annotated[Any, LOW_LOAD, WAY] = None
    rate: Annotated[Any, PLATEN, RATE] = None
    keep: Literal["displacement", "force"] | None = None
    duration: Annotated[Duration | None, WAIT] = Field(default=None, alias="for")

    @model_validator(mode="after")
    def _check_complete(self) -> "StepTable":
        moves, waits = self.step in MOVING, self.step in ("hold", "rest")
        if moves and self.to is None:
            raise BadValue("the step never ends: it says no `to`", 'add to = "400 N"', "to")
        if waits and self.duration is None:
            raise BadValue("the step never ends: it says no `for`", 'add for = "10 s"', "for")
        allowed = {"to": moves, "rate": moves, "keep": self.step == "hold", "for": waits}
        for name, fits in allowed.items():
            given = self.duration if name == "for" else getattr(self, name)
            if given is not None and not fits:
                raise BadValue(f"a step '{self.step}' has no {name}", "leave it out", name)
        if moves:
            self.goal()
            self.speed(0.1)
        return self

    def goal(self) -> tuple[str, float]:
        """Which quantity the step goes to, and its value (N, kPa, m or a fraction)."""
        expected = 'give a force, stress, displacement or strain: "400 N", "200 kPa", "2 mm", "5 %"'
        kind, value = first_of(self.to, list(KINDS.values()), expected, "to")
        name = next(name for name, each in KINDS.items() if each is kind)
        if value < 0 or (value == 0 and self.step != "unload"):
            raise BadValue(f"{self.to} is not above zero", 'give e.g. "400 N"', "to")
        if name == "strain" and value >= 1:
            raise BadValue(f"a strain of {self.to} leaves no specimen", 'give e.g. "5 %"', "to")
        return name, value

    def speed(self, height: float) -> float:
        """Nominal speed (m/s) of the platen on a specimen of this height (m)."""
        if self.rate is None:
            return USUAL_RATE
        expected = 'give a speed or a strain rate: "8 mm/s", "1 %/min"'
        kind, value = first_of(self.rate, [SPEED, STRAIN_RATE], expected, "rate")
        if value <= 0:
            raise BadValue(f"{self.rate} is not above zero", expected, "rate")
        return value if kind is SPEED else value * height


def written_course(forces: Sequence[float]) -> str:
    """Forces (N) at which loading turns, as the protocol of a lab file."""
    words = ("load", *(("unload", "reload")[k % 2] for k in range(len(forces) - 1)))
    steps = (
        f'{{ step = "{word}", to = "{max(force, 0.0):.4g} N" }}'
        for word, force in zip(words, forces, strict=True)
    )
    return f"protocol = [{', '.join(steps)}]"


def check_protocol(steps: Sequence[StepTable]) -> None:
    """Refuses what no machine can do: a mould removed twice, a rest in the mould, a hold before
    the platen touches, a force kept that was not reached."""
    if len(steps) > MOST_STEPS:
        raise BadValue(f"{len(steps)} steps are too many", f"give at most {MOST_STEPS}", "protocol")
    if steps and not {step.step for step in steps} & {*MOVING, "approach"}:
        repair = 'add { step = "load", to = "400 N" }'
        raise BadValue("no step moves the platen", repair, "protocol")
    for number, step in enumerate(steps):
        refusal = _out_of_place(step, steps[:number])
        if refusal:
            raise BadValue(*refusal, f"protocol[{number}].step")


def _out_of_place(step: StepTable, before: Sequence[StepTable]) -> tuple[str, str] | None:
    """What is wrong with a step after the steps before it, and the repair; None if nothing is."""
    opened = any(other.step == "remove_mould" for other in before)
    touches = bool(before) and before[-1].step not in ("remove_mould", "rest")
    if step.step == "remove_mould" and opened:
        return "the mould is removed twice", "remove it once"
    if step.step == "rest" and not opened:
        return "a rest needs a free specimen", 'put { step = "remove_mould" } before it'
    if step.step in ("hold", "unload") and not touches:
        return "the platen does not touch yet", "load first"
    moves = [other for other in before if other.step != "hold"]
    if step.keep == "force" and (
        moves[-1].step != "approach" and moves[-1].goal()[0] not in ("force", "stress")
    ):
        return "no force was reached that could be kept", "load to a force first"
    return None


def program(steps: Sequence[StepTable], cylinder: Cylinder) -> tuple[Step, ...]:
    """The steps as the virtual machine takes them; refuses a displacement after a force."""
    words = [step.step for step in steps]
    made: list[Step] = []
    travelled: float | None = 0.0  # m since the platen touched; None: not known
    rate = next((s.speed(cylinder.height) for s in steps if s.step in MOVING), USUAL_RATE)
    for number, step in enumerate(steps):
        name = step.step if words.count(step.step) == 1 else f"{step.step} {number + 1}"
        value = step.duration or 0.0
        if step.step in MOVING:
            rate = step.speed(cylinder.height)
            kind, goal = _goal(step, cylinder)
            value = goal if kind == TO_FORCE else _travel(goal, travelled, step, number)
            travelled = None if kind == TO_FORCE else goal
        elif step.step == "approach":
            kind, value = TO_FORCE, TOUCH
        elif step.step == "hold":
            kind = KEEP_FORCE if step.keep == "force" else HOLD
        else:
            kind, travelled = OPEN if step.step == "remove_mould" else REST, 0.0
        made.append(Step(kind, name, value, rate))
    return tuple(made)


def _goal(step: StepTable, cylinder: Cylinder) -> tuple[str, float]:
    """Kind of a movement, and the force (N) or displacement (m) that it goes to."""
    kind, value = step.goal()
    factor = {"stress": 1e3 * cylinder.area, "strain": cylinder.height}.get(kind, 1.0)
    return TO_FORCE if kind in ("force", "stress") else TRAVEL, factor * value


def _travel(goal: float, travelled: float | None, step: StepTable, number: int) -> float:
    """How far (m) the platen goes to be at `goal`; refused where it cannot be said."""
    where = f"protocol[{number}].to"
    if travelled is None:
        problem = "the step goes to a displacement, but a step before it went to a force"
        raise BadValue(problem, 'go to a force or stress, such as "400 N"', where)
    way = goal - travelled
    if (way > 0) == (step.step == "unload") or way == 0:
        raise BadValue(f"{step.to} is not where '{step.step}' leads from here",
                       "go farther with load and reload, back with unload", where)  # fmt: skip
    return way
