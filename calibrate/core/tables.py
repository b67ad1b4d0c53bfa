"""What all tables of a lab file are made of: quantities with units, and names that are checked.

Quantities are strings with units (`calibrate.core.units`) and leave a table in SI.  What a table
refuses is a `BadValue` with its repair; `calibrate.io.labfile` adds file and field.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from calibrate.core.errors import BadValue, shown, suggestion
from calibrate.core.units import (
    DENSITY,
    FORCE,
    FRACTION,
    LENGTH,
    MILLIMETRES,
    SPEED,
    STRESS,
    TIME,
    Kind,
    positive_quantity,
    unit_factor,
    unsigned_quantity,
)


def _read(reader: Callable[[Any, Kind], float], kind: Kind) -> BeforeValidator:
    """The pydantic form of `reader` for one kind of quantity."""
    return BeforeValidator(lambda written: reader(written, kind))


Length = Annotated[float, _read(positive_quantity, LENGTH)]
Speed = Annotated[float, _read(positive_quantity, SPEED)]
Force = Annotated[float, _read(positive_quantity, FORCE)]
Duration = Annotated[float, _read(unsigned_quantity, TIME)]
Density = Annotated[float, _read(positive_quantity, DENSITY)]
Fraction = Annotated[float, _read(unsigned_quantity, FRACTION)]
Millimetres = Annotated[float, _read(positive_quantity, MILLIMETRES)]
LengthUnit = Annotated[float, _read(unit_factor, MILLIMETRES)]
ForceUnit = Annotated[float, _read(unit_factor, FORCE)]
StressUnit = Annotated[float, _read(unit_factor, STRESS)]
StrainUnit = Annotated[float, _read(unit_factor, FRACTION)]
Text = Annotated[str, Field(min_length=1, max_length=1000)]
Count = Annotated[int, Field(ge=1)]


def required(example: str) -> Any:
    """A field that must be given; `example` is the repair when it is not."""
    return Field(description=example)


class AbstractTable(BaseModel):
    """A table of the lab file.  Unknown entries and missing ones are refused by name."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            raise BadValue(f"{shown(data)} is not a table", "write it as a TOML table")
        fields = {field.alias or name: field for name, field in cls.model_fields.items()}
        for name in data:
            if name not in fields:
                raise BadValue("unknown name", suggestion(name, fields), name)
        for name, field in fields.items():
            if field.is_required() and name not in data:
                raise BadValue("missing", f"add {field.description}", name)
        return data


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

    Force or stress, against displacement, strain or void ratio; stress and strain are turned into
    force and displacement by the specimen's size.  `where` keeps the rows whose columns have these
    values; `points` says that rows are load steps, not a continuous record.  `test` is the test's
    name in a list [[curves]] outside of [[tests]].
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

    @model_validator(mode="after")
    def _check_two_columns(self) -> "CurveTable":
        along = [self.displacement, self.strain, self.void_ratio]
        if sum(column is not None for column in along) != 1:
            repair = 'add displacement = { column = "displacement", unit = "mm" }'
            raise BadValue("give displacement, strain or void_ratio, one of them", repair)
        if (self.force is None) == (self.stress is None):
            repair = 'add force = { column = "force", unit = "N" }'
            raise BadValue("give force or stress, one of them", repair)
        if self.delimiter == self.decimal:
            raise BadValue("it is the delimiter too", 'give delimiter = ";"', "decimal")
        return self
