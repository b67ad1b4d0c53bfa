"""The contract of a laboratory test: its table in a lab file, its virtual apparatus, what it gives.

    table -> apparatus (jdem) -> curve, observables
    measured curve -> features  <- simulated curve

Forces are N, displacements mm where a laboratory reads them, everything else SI.
"""

import abc
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from calibrate.core.errors import BadValue, shown, suggestion
from calibrate.core.tables import AbstractTable, Text
from calibrate.core.units import (
    ANGLE,
    ENERGY,
    FORCE,
    FRACTION,
    LENGTH,
    MILLIMETRES,
    PERCENT,
    STRAIN,
    STRESS,
    TORQUE,
    Kind,
    Range,
)
from calibrate.labtests.features import (
    AbstractCurveFeature,
    AbstractFeature,
    FeatureGauge,
    cyclic_course,
    path_features,
)
from calibrate.labtests.measured import (
    AbstractMachineRecord,
    Curve,
    CurveTable,
    Cylinder,
    SpecimenTable,
    TargetTable,
)
from calibrate.labtests.protocol import (
    MOVING,
    StepTable,
    check_protocol,
    program,
    written_course,
)
from jdem.apparatus.base import AbstractApparatus, Gauged
from jdem.apparatus.protocol import Protocol
from jdem.observables import AbstractGauge

AXES = ("displacement (mm)", "force (N)")  # of curves
STROKE = 0.35  # largest compression that is simulated, as a share of the height
LONGEST_NAME = 60
_STRANGE = re.compile(r"[^\w .+-]")


@dataclass(frozen=True)
class Unit:
    """A unit of observables: the kind of quantity that a target is given in, and where it usually
    lies; the `other` kind that a target may be given in instead, if there is one, and what one of
    that is in this unit on a specimen."""

    kind: Kind
    usual: Range
    other: Kind | None = None
    on: Callable[[Cylinder], float] = lambda size: 1.0


UNITS = {
    "mm": Unit(
        MILLIMETRES, Range(STRAIN, "0.01 %", "90 %"), FRACTION, lambda size: 1e3 * size.height
    ),
    "N": Unit(FORCE, Range(STRESS, "0.05 kPa", "20 MPa"), STRESS, lambda size: 1e3 * size.area),
    "%": Unit(PERCENT, Range(STRAIN, "0.01 %", "90 %"), LENGTH, lambda size: 100 / size.height),
    "kPa": Unit(STRESS, Range(STRESS, "10 kPa", "10 GPa")),
    "mN m": Unit(TORQUE, Range(TORQUE, "0.01 mN*m", "1000 N*m")),
    "deg": Unit(ANGLE, Range(ANGLE, "0.5 deg", "89 deg")),
    "J": Unit(ENERGY, Range(ENERGY, "0.01 mJ", "10 kJ")),
}


@dataclass(frozen=True)
class Observable:
    """A number that a test gives.

    `name` in results ends in its unit; `source` is its name in the apparatus and `scale` takes it
    from SI; an audit passes slopes `within` this share of the reference; `drawn`: a figure of the
    curve shows it as a force; `symbol` stands for it in narrow tables.  `feature`: what reads it
    off a specimen's curve, in `unit`, where the apparatus does not give it.
    """

    name: str
    label: str
    unit: str
    source: str
    scale: float
    within: float
    drawn: bool = False
    symbol: str = ""
    usually: Range | None = None
    feature: Callable[[Cylinder], AbstractCurveFeature] | None = None

    @property
    def usual(self) -> Range:
        """Where its values usually lie."""
        return self.usually or UNITS[self.unit].usual

    @property
    def short(self) -> str:
        """The name without its unit."""
        return self.name.rpartition("_")[0]

    @property
    def kind(self) -> Kind:
        """The kind of quantity that a target is given in."""
        return UNITS[self.unit].kind

    def by_size(self, cylinder: Cylinder) -> tuple[Kind, float]:
        """The other kind of quantity that a target may be given in, else its own; its factor."""
        unit = UNITS[self.unit]
        return unit.other or unit.kind, unit.on(cylinder)

    def gauge(self, cylinder: Cylinder) -> AbstractGauge:
        """What reads the observable's `feature` in a run."""
        assert self.feature is not None
        return FeatureGauge(feature=self.feature(cylinder), scale=self.scale, name=self.source)


@dataclass(frozen=True)
class ResultChannel:
    """What a test records beside its curve: `source` is its name in the apparatus, `name` in
    results, which ends in its unit, and `scale` takes it there from SI."""

    source: str
    name: str
    scale: float = 1.0


@dataclass(frozen=True)
class Pace:
    """How a simulation moves: platen speeds (m/s) with the specimen in its mould, and free; the
    time (s) between samples; the mean diameter of its spheres (m), 0 where there are none."""

    in_mould: float
    free: float
    sample_time: float
    sphere: float = 0.0


@dataclass(frozen=True)
class Shown:
    """What a test showed on a simulated specimen: its cylinder, its curve (points, 2; mm, N), the
    test's observables by source, in their units, and how many spheres the specimen is wide."""

    cylinder: Cylinder
    curve: np.ndarray
    numbers: Mapping[str, float]
    across: float = math.inf


def clean_name(text: str) -> str:
    """The text with what a test's name cannot have replaced by "-", cut to `LONGEST_NAME`."""
    return _STRANGE.sub("-", text.strip())[:LONGEST_NAME] or "test"


def _test_name(name: str) -> str:
    """A name that may stand in results and files."""
    if name != clean_name(name):
        repair = f"give up to {LONGEST_NAME} letters, digits, blanks and . _ + -"
        raise BadValue(f"{shown(name)} cannot be a test's name", repair)
    return name


class AbstractLabTest(AbstractTable):
    """One test as a lab file states it.

    `name` is unique among the tests of a lab, by default the type; `specimen` is a specimen of its
    own, without which the test goes on with that of the test before; `protocol` replaces the
    usual one.  type_name: what `type` says; title: of figures; observables: what it gives;
    further: what is read off its curve as well where a target asks for it; combined: what
    `together` may give; axes: what its curve's columns are, for figures; channels: what is
    recorded beside them; plain: its table may stand alone, called like the type, in a lab file
    without [[tests]]; shape: of a curve that says so itself; with_soil: without it, the test takes
    no specimen, and no fit compares it; in_mould: a tool's, which needs the soil in its mould,
    leaves it disturbed, and follows no protocol; record: what its machine writes, where that is no
    force and displacement.
    """

    type_name: ClassVar[str]
    title: ClassVar[str]
    observables: ClassVar[tuple[Observable, ...]]
    further: ClassVar[tuple[Observable, ...]] = ()
    combined: ClassVar[tuple[Observable, ...]] = ()
    axes: ClassVar[tuple[str, str]] = AXES
    channels: ClassVar[tuple[ResultChannel, ...]] = ()
    plain: ClassVar[bool] = False
    shape: ClassVar[Literal["", "softens", "stiffens", "steps"]] = ""
    with_soil: ClassVar[bool] = True
    in_mould: ClassVar[bool] = False
    record: ClassVar[AbstractMachineRecord | None] = None

    type: Text | None = None
    name: Annotated[str, AfterValidator(_test_name)] | None = None
    specimen: SpecimenTable | None = None
    protocol: list[StepTable] = Field(default=[])
    targets: dict[str, TargetTable] = Field(default={})
    curves: list[CurveTable] = Field(default=[])

    @model_validator(mode="after")
    def _check_whole(self) -> "AbstractLabTest":
        check_protocol(self.protocol)
        if self.protocol and self.in_mould:
            problem = f"a {self.title} test follows no protocol"
            raise BadValue(problem, "leave it out, and give its rate", "protocol")
        for given in self.targets:
            self.observable(given)
        return self

    @property
    def called(self) -> str:
        """The test's name: what the lab file says, or its type."""
        return self.name or self.type_name

    def observable(self, given: str) -> Observable:
        """The observable that a target is called after, with or without its unit."""
        for observable in self.every():
            if given in (observable.name, observable.short):
                return observable
        known = [observable.name for observable in self.every()]
        raise BadValue("unknown name", suggestion(given, known), f"targets.{given}")

    @property
    def nominal_rate(self) -> float | None:
        """The platen's speed (m/s) in the laboratory, None where the test says nothing."""
        height = self.specimen.height if self.specimen else 0.1
        moving = [step for step in self.protocol if step.step in MOVING]
        return moving[0].speed(height) if moving else None

    @classmethod
    def every(cls) -> tuple[Observable, ...]:
        """All observables that may be asked for."""
        return (*cls.observables, *cls.further)

    @property
    def given(self) -> tuple[Observable, ...]:
        """The observables that results hold: those of the test, and further ones with a target."""
        asked = [o for o in self.further if {o.name, o.short} & set(self.targets)]
        return (*self.observables, *asked)

    def asked_of(self, targets: Mapping[str, TargetTable]) -> Self:
        """The same test with further targets, by observable."""
        return self.model_copy(update={"targets": {**self.targets, **targets}})

    @property
    def frees(self) -> bool:
        """Whether the specimen stands without its mould afterwards."""
        return any(step.step == "remove_mould" for step in self.protocol)

    def check_on(self, cylinder: Cylinder) -> None:
        """`BadValue` where this specimen does not let the test be made."""
        program(self.protocol, cylinder)

    def machine(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        """The virtual test with a gauge for each observable that is read off its curve."""
        gauges = [o.gauge(cylinder) for o in self.given if o.feature]
        test = self.apparatus(cylinder, pace)
        return Gauged.of(test, tuple(gauges)) if gauges else test

    @abc.abstractmethod
    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        """The virtual test on a specimen, at a simulated pace."""

    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        """Where the measured curves (at least one) are compared with simulated ones."""
        return path_features(self.called, curves)

    def refusal(self, curve: Curve) -> BadValue | None:
        """Why a measured curve cannot be compared with this test; None if it can."""
        return None if self.protocol else self.cyclic(curve)

    def cyclic(self, curve: Curve) -> BadValue | None:
        """The protocol that a curve followed which is loaded several times."""
        course = () if curve.points else cyclic_course(curve.displacement_mm, curve.force_n)
        if not course:
            return None
        loadings = (len(course) + 1) // 2
        problem = f"the curve is loaded {loadings} times, and the test {self.called} once"
        return BadValue(problem, f"give the test {written_course(course)}")

    def doubt(self, observable: Observable, shown: "Shown") -> str:
        """Why the number of a simulated specimen is not what the observable is called; "" if it
        is."""
        return ""

    @classmethod
    def together(cls, found: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """Numbers that several tests of this type give together, by name with their unit: `found`
        has the observables of each test by name, and their conditions: none, unless said so."""
        return {}

    def conditions(self) -> dict[str, float]:
        """What the test was made under, by name with the unit, for `together`."""
        return {}

    def guides(self) -> tuple[float, ...]:
        """Forces (N) that a figure of the curve marks."""
        return ()

    def follow(
        self,
        steps: Sequence[StepTable],
        cylinder: Cylinder,
        pace: Pace,
        gauges: tuple[AbstractGauge, ...],
    ) -> Protocol:
        """The virtual machine that takes these steps and reads these gauges."""
        free = any(step.step == "remove_mould" for step in steps)
        made = program(steps, cylinder)
        moving = [step.nominal_rate for step in made if step.kind in ("force", "travel")]
        return Protocol(
            steps=made,
            simulated_rate=pace.free if free else pace.in_mould,
            nominal_rate=moving[0],
            stroke=STROKE * cylinder.height,
            gauges=gauges,
            name=self.called,
        )
