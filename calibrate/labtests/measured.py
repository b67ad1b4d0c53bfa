"""What was measured, as a lab file states it: curve files with their columns, and scalar targets.

Curves are force or stress against displacement, strain or void ratio; stress and strain become
force and displacement by the specimen's size.  What the machine of a test with a tool writes, such
as torque and angle, is an `AbstractMachineRecord` of that test.
"""

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from calibrate.core.errors import BadValue
from calibrate.core.tables import (
    AbstractTable,
    Count,
    ForceUnit,
    Fraction,
    Length,
    LengthUnit,
    StrainUnit,
    StressUnit,
    Text,
    required,
)
from calibrate.core.units import FRACTION, LENGTH, Range


@dataclass(frozen=True)
class Cylinder:
    """A specimen: diameter and height in the mould (m), height of the mould (m) and moisture (water
    over dry mass) if known."""

    diameter: float
    height: float
    mould_height: float | None = None
    moisture: float | None = None

    @property
    def area(self) -> float:
        """Cross-section, m2."""
        return np.pi / 4 * self.diameter**2


@dataclass(frozen=True)
class Target:
    """A measured observable in its unit: mean of `repeats` tests, standard deviation of one, and
    the relative error that those who published it found for their own simulation, if known."""

    mean: float
    scatter: float
    repeats: int
    published_error: float | None = None


@dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve, in the order of recording; `file` is its path as written in the lab
    file.  Both arrays have shape (points,) and are read-only; `points`: they are load steps;
    `compared`: a fit compares it."""

    test: str
    displacement_mm: np.ndarray
    force_n: np.ndarray
    file: str
    points: bool = False
    compared: bool = True


@dataclass(frozen=True)
class MachineColumn:
    """A kind of column that a machine writes, and what makes it one of its test's curve.

    `per` is N in one N, kPa or N m of a load, mm in one mm or rad of a travel, or an entry's SI
    unit in one of a condition, on a test and the cylinder that it is made on.  A travel counts from
    its first row, from the tool's contact with the soil, or as it is written, less `datum` (mm).
    `said`: as what it is taken, where its name leaves that open.
    """

    kind: str
    per: Callable[[Any, Cylinder], float] = lambda test, cylinder: 1.0
    counts: Literal["first row", "contact", "as written"] = "first row"
    datum: Callable[[Any], float] = lambda test: 0.0
    said: str = ""


class AbstractMachineRecord(abc.ABC):
    """What the machine of a test writes, and what of it the test's entries in a lab file are.

    loads, travels: kinds of columns, of which the first that a file holds is taken; beside: kinds
    that it may hold as well; tool: entries that say how large the tool is, with its width first;
    called: the tool in words; condition: the entry that says what a specimen was tested under, as
    one of the columns `conditions` or a line above the table has it, "" if there is none; own_bed:
    the specimen is the soil that was tested, and no bed around a tool.
    """

    loads: ClassVar[tuple[MachineColumn, ...]]
    travels: ClassVar[tuple[MachineColumn, ...]]
    beside: ClassVar[tuple[str, ...]] = ()
    tool: ClassVar[tuple[str, ...]] = ()
    called: ClassVar[str] = "tool"
    condition: ClassVar[str] = ""
    conditions: ClassVar[tuple[MachineColumn, ...]] = ()
    own_bed: ClassVar[bool] = False

    @property
    def kinds(self) -> tuple[str, ...]:
        """All kinds of columns that the file may hold."""
        columns = (*self.loads, *self.travels, *self.conditions)
        return tuple(dict.fromkeys((*(column.kind for column in columns), *self.beside)))

    @abc.abstractmethod
    def entries(self, tool: Sequence[float]) -> tuple[dict[str, Any], str]:
        """Entries of the test whose tool has these sizes (m), as many as are known and the width at
        least, and which of them no record says."""

    @abc.abstractmethod
    def bed(self, test: Any) -> Cylinder:
        """A specimen with room for the test, or the usual one where it is the soil's own."""

    @abc.abstractmethod
    def reached(self, test: Any, cylinder: Cylinder, curves: Sequence[Curve]) -> dict[str, Any]:
        """Entries that say how far all curves go; `BadValue` where that is too short."""

    @abc.abstractmethod
    def numbers(self, test: Any, cylinder: Cylinder, curve: Curve) -> dict[str, float]:
        """The observables that a curve holds, by name, in their units."""

    def rate(self, test: Any, speed: float) -> str:
        """The entry `rate` of a curve that goes on at this speed (m/s)."""
        return f"{1e3 * speed:.4g} mm/s"


def millimetres(length: float) -> str:
    """A length (m) as an entry of a lab file."""
    return f"{1e3 * length:.6g} mm"


class SpecimenTable(AbstractTable):
    """The cylinder of soil, in m; its moisture (water over dry mass) chooses among parameters that
    differ with it."""

    diameter: Annotated[Length, Range(LENGTH, "5 mm", "400 mm")] = required('diameter = "50 mm"')
    height: Annotated[Length, Range(LENGTH, "5 mm", "1 m")] = required('height = "100 mm"')
    mould_height: Annotated[Length | None, Range(LENGTH, "5 mm", "1 m")] = None
    moisture: Annotated[Fraction | None, Range(FRACTION, "0.5 %", "300 %")] = None

    @model_validator(mode="after")
    def _check_fits_mould(self) -> "SpecimenTable":
        if self.mould_height is not None and self.height > self.mould_height:
            raise BadValue("the soil is higher than its mould", "lower it", "height")
        return self

    def cylinder(self) -> Cylinder:
        """The same as plain numbers."""
        return Cylinder(self.diameter, self.height, self.mould_height, self.moisture)


class TargetTable(AbstractTable):
    """A measured observable: mean and standard deviation of one repeat, as quantities, and their
    number; or a file with one repeat a row, its column and unit, each repeat `times` a factor.

    A length may be given as a strain and a strain as a length, a force as a stress of the
    specimen's area.  published_error is the relative error of a published simulation, for
    comparison.
    """

    mean: Any = None
    scatter: Any = None
    repeats: Count | None = None
    file: Text | None = None
    column: Text | None = None
    unit: Text | None = None
    delimiter: Literal[",", ";", "\t", "|", " "] = ","
    decimal: Literal[".", ","] = "."
    where: dict[str, str] = Field(default={})
    times: float = Field(default=1.0, gt=0)
    published_error: Annotated[Fraction | None, Range(FRACTION, "0.01 %", "200 %")] = None

    @model_validator(mode="after")
    def _check_complete(self) -> "TargetTable":
        if self.file is None:
            wanted = {"mean": '"3.36 mm"', "scatter": '"0.2 mm"', "repeats": "4"}
        else:
            wanted = {"column": '"strength"', "unit": '"kPa"'}
        for name, example in wanted.items():
            if getattr(self, name) is None:
                raise BadValue("missing", f"add {name} = {example}", name)
        return self


class DisplacementColumn(AbstractTable):
    """A column of displacements; `unit` becomes the factor that takes it to mm."""

    column: Text = required('column = "displacement"')
    unit: LengthUnit = required('unit = "mm"')


class ForceColumn(AbstractTable):
    """A column of forces; `unit` becomes the factor that takes it to N."""

    column: Text = required('column = "force"')
    unit: ForceUnit = required('unit = "N"')


class StressColumn(AbstractTable):
    """A column of stresses on the specimen's first area; `unit` becomes the factor to kPa."""

    column: Text = required('column = "stress"')
    unit: StressUnit = required('unit = "kPa"')


class StrainColumn(AbstractTable):
    """A column of axial strains, of the specimen's first height; `unit` becomes the factor to 1."""

    column: Text = required('column = "strain"')
    unit: StrainUnit = required('unit = "%"')


class VoidRatioColumn(AbstractTable):
    """A column of void ratios e: strain (e0 - e)/(1 + e0), e0 being `initial` or the first row."""

    column: Text = required('column = "e"')
    initial: float | None = Field(default=None, gt=0)


class CurveTable(AbstractTable):
    """Where one measured curve is found: a file, and two of its columns.

    `where` keeps the rows whose columns have these values; `points` says that rows are load steps,
    not a continuous record; a curve that is not `compared` is drawn and has no say in a fit, where
    targets hold its numbers.  `test` names the test in a list [[curves]] outside of [[tests]].
    """

    test: Text | None = None
    file: Text = required('file = "test_1.csv"')
    displacement: DisplacementColumn | None = None
    strain: StrainColumn | None = None
    void_ratio: VoidRatioColumn | None = None
    force: ForceColumn | None = None
    stress: StressColumn | None = None
    delimiter: Literal[",", ";", "\t", "|", " "] = ","
    decimal: Literal[".", ","] = "."
    where: dict[str, str] = Field(default={})
    points: bool = False
    compared: bool = True

    @model_validator(mode="after")
    def _check_two_columns(self) -> "CurveTable":
        along = [self.displacement, self.strain, self.void_ratio]
        given = sum(column is not None for column in along)
        if given != 1:
            problem = "missing" if given == 0 else "only one of displacement, strain, void_ratio"
            repair = 'give displacement = { column = "displacement", unit = "mm" }, or strain, or '
            raise BadValue(problem, repair + "void_ratio", "displacement")
        if (self.force is None) == (self.stress is None):
            problem = "missing" if self.force is None else "there is stress, too"
            repair = 'give force = { column = "force", unit = "N" } or stress, one of them'
            raise BadValue(problem, repair, "force")
        if self.delimiter == self.decimal:
            raise BadValue("it is the delimiter too", 'give delimiter = ";"', "decimal")
        return self
