"""The contract of a laboratory test: its table in a lab file, its virtual apparatus, what it gives.

    table -> apparatus (jdem) -> curve, observables
    measured curve -> features  <- simulated curve

Forces are N, displacements mm where a laboratory reads them, everything else SI.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import AbstractTable, Count, CurveTable, Length, Text, required
from calibrate.core.units import FORCE, MILLIMETRES, Kind
from calibrate.labtests.protocol import StepTable
from jdem.apparatus.base import AbstractApparatus

SEATING = 2.0  # N; force at which displacement starts to count


@dataclass(frozen=True)
class Cylinder:
    """A specimen: diameter and height in the mould (m), height of the mould (m) if known."""

    diameter: float
    height: float
    mould_height: float | None = None

    @property
    def area(self) -> float:
        """Cross-section, m2."""
        return np.pi / 4 * self.diameter**2


@dataclass(frozen=True)
class Observable:
    """A number that a test gives: `name` in results, label, unit, symbol; `source` is its name in
    the apparatus, `scale` takes it from SI; an audit passes slopes that lie `within` of the
    reference."""

    name: str
    label: str
    unit: str
    symbol: str
    source: str
    scale: float
    within: float

    @property
    def short(self) -> str:
        """The name without its unit, as in `[targets]`."""
        return self.name.rpartition("_")[0]

    @property
    def kind(self) -> Kind:
        """The kind of quantity that a target is given in."""
        return {"mm": MILLIMETRES, "N": FORCE}[self.unit]


@dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve, in the order of recording; `file` is its path as written in the lab
    file.  Both arrays have shape (points,) and are read-only; `points` says that they are load
    steps, not a continuous record."""

    test: str
    displacement_mm: np.ndarray
    force_n: np.ndarray
    file: str
    points: bool = False


@dataclass(frozen=True)
class AbstractFeature(abc.ABC):
    """One number of a specimen: its name, its unit, the test that it belongs to."""

    name: str
    unit: str
    test: str

    @abc.abstractmethod
    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        """This feature of one specimen's curve."""


@dataclass(frozen=True)
class CurveReading:
    """Where a test's curve is differentiated: at points of one axis, the other is read.

    `along` is "force_n" (displacement is read where the force is first reached) or
    "displacement_mm" (force is read).
    """

    along: str
    points: np.ndarray

    @property
    def unit(self) -> str:
        """Unit of what is read."""
        return "mm" if self.along == "force_n" else "N"

    @property
    def axis(self) -> str:
        """Label of the axis along which it is read."""
        return "force on loading (N)" if self.along == "force_n" else "displacement (mm)"

    @property
    def slope(self) -> str:
        """Label of the axis of slopes."""
        read = "displacement" if self.along == "force_n" else "force"
        return f"d {read} / d ln p ({self.unit})"


class SpecimenTable(AbstractTable):
    """The cylinder of soil, in m."""

    diameter: Length = required('diameter = "50 mm"')
    height: Length = required('height = "100 mm"')
    mould_height: Length | None = None

    @model_validator(mode="after")
    def _check_fits_mould(self) -> "SpecimenTable":
        if self.mould_height is not None and self.height > self.mould_height:
            raise BadValue("the soil is higher than its mould", "lower it", "height")
        return self

    def cylinder(self) -> Cylinder:
        return Cylinder(self.diameter, self.height, self.mould_height)


class TargetTable(AbstractTable):
    """A measured observable and the standard deviation of one repeat, as quantities; or the file,
    column and unit in which its repeats stand, each `times` a factor."""

    mean: Any = None
    scatter: Any = None
    repeats: Count | None = None
    file: Text | None = None
    column: Text | None = None
    unit: Text | None = None
    times: float = 1.0


@dataclass(frozen=True)
class Pace:
    """How fast platens move in a simulation (m/s): with the specimen in its mould, and free; the
    travel (m) over which a peak of force is averaged, as a number of samples."""

    in_mould: float
    free: float
    sample_time: float


class AbstractLabTest(AbstractTable):
    """One test as a lab file states it.

    `name` is unique among the tests of a lab; `specimen` is a specimen of its own, without which
    the test goes on with that of the test before; `protocol` replaces or extends the usual one.
    """

    observables: ClassVar[tuple[Observable, ...]]
    title: ClassVar[str]
    free: ClassVar[bool] = False
    classic: ClassVar[bool] = False  # may stand in a table of its own name, without [[tests]]

    type: Text
    name: Text = ""
    specimen: SpecimenTable | None = None
    protocol: list[StepTable] = Field(default=[])
    targets: dict[str, TargetTable] = Field(default={})
    curves: list[CurveTable] = Field(default=[])

    @property
    def called(self) -> str:
        """The test's name: what the lab file says, or its type."""
        return self.name or self.type

    def key(self, observable: Observable) -> str:
        """What an observable of this test is called in results."""
        return observable.name if self.called == self.type else f"{self.called}.{observable.name}"

    @abc.abstractmethod
    def apparatus(self, cylinder: Cylinder, pace: Pace) -> AbstractApparatus:
        """The virtual test on a specimen, at a simulated pace."""

    @abc.abstractmethod
    def features(self, cylinder: Cylinder, curves: Sequence[Curve]) -> list[AbstractFeature]:
        """Where the measured curves are compared with simulated ones."""

    @abc.abstractmethod
    def reading(self, apparatus: AbstractApparatus, points: int) -> CurveReading:
        """Where slopes of the simulated curve are read."""

    def refusal(self, curve: Curve) -> BadValue | None:
        """Why a measured curve cannot be compared with this test; None if it can."""
        return None

    def guides(self) -> tuple[float, ...]:
        """Forces (N) that a figure of the curve marks."""
        return ()

    def measured_on(self, targets: Mapping[str, Any]) -> list[Observable]:
        """The observables of which there is a target."""
        return [o for o in self.observables if self.key(o) in targets]


def seated(displacement: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Displacement beyond the first reading at SEATING or more."""
    return displacement - displacement[int(np.argmax(force >= SEATING))]
