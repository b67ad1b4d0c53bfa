"""The tables of a lab file, as pydantic models: which names there are and what they may hold.

Quantities are strings with units (`calibrate.core.units`) and leave this file in SI, targets in
mm and N.  What a table refuses is a `BadValue` with its repair; `calibrate.io.labfile` adds file
and field.
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
Text = Annotated[str, Field(min_length=1, max_length=1000)]
Count = Annotated[int, Field(ge=1)]


def _required(example: str) -> Any:
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
        for name in data:
            if name not in cls.model_fields:
                raise BadValue("unknown name", suggestion(name, cls.model_fields), name)
        for name, field in cls.model_fields.items():
            if field.is_required() and name not in data:
                raise BadValue("missing", f"add {field.description}", name)
        return data


class SoilTable(AbstractTable):
    """What was tested; density in kg/m^3, water content as a fraction."""

    name: Text = _required('name = "silt loam, field 3"')
    source: str = ""
    density: list[Density] = []
    water_content: list[Fraction] = []


class SpecimenTable(AbstractTable):
    """The cylinder of soil, in m."""

    diameter: Length = _required('diameter = "50 mm"')
    height: Length = _required('height = "100 mm"')
    mould_height: Length | None = None

    @model_validator(mode="after")
    def _check_fits_mould(self) -> "SpecimenTable":
        if self.mould_height is not None and self.height > self.mould_height:
            raise BadValue("the soil is higher than its mould", "lower it", "height")
        return self


class ConfinedTable(AbstractTable):
    """Loading in the mould: platen speed in m/s, the two forces of the depression depth in N."""

    rate: Speed = 8e-3
    force_low: Force = 200.0
    force_high: Force = 400.0
    greased: bool = True

    @model_validator(mode="after")
    def _check_order(self) -> "ConfinedTable":
        if self.force_low >= self.force_high:
            problem = f"{self.force_high:g} N is not above force_low, {self.force_low:g} N"
            raise BadValue(problem, 'give a higher force such as "400 N"', "force_high")
        return self


class UnconfinedTable(AbstractTable):
    """Crushing without mould: platen speed in m/s, rest before it in s."""

    rate: Speed = 1e-5
    rest: Duration = 1.0


class DepthTarget(AbstractTable):
    """A measured depression depth and the standard deviation of one repeat, in mm."""

    mean: Millimetres = _required('mean = "3.36 mm"')
    scatter: Millimetres = _required('scatter = "0.2 mm"')
    repeats: Count = _required("repeats = 4")


class ForceTarget(AbstractTable):
    """A measured crushing force and the standard deviation of one repeat, in N."""

    mean: Force = _required('mean = "206 N"')
    scatter: Force = _required('scatter = "10 N"')
    repeats: Count = _required("repeats = 4")


class TargetsTable(AbstractTable):
    """The scalar targets."""

    depression_depth: DepthTarget | None = None
    crushing_force: ForceTarget | None = None


class DisplacementColumn(AbstractTable):
    """A column of a curve file; `unit` becomes the factor that takes it to mm."""

    column: Text = _required('column = "displacement"')
    unit: LengthUnit = _required('unit = "mm"')


class ForceColumn(AbstractTable):
    """A column of a curve file; `unit` becomes the factor that takes it to N."""

    column: Text = _required('column = "force"')
    unit: ForceUnit = _required('unit = "N"')


class CurveTable(AbstractTable):
    """Where one measured curve is found."""

    test: Literal["confined", "unconfined"] = _required('test = "confined"')
    file: Text = _required('file = "confined_1.csv"')
    displacement: DisplacementColumn = _required(
        'displacement = { column = "displacement", unit = "mm" }'
    )
    force: ForceColumn = _required('force = { column = "force", unit = "N" }')
    delimiter: Literal[",", ";", "\t", "|", " "] = ","


class ParticlesTable(AbstractTable):
    """How the soil is represented; the reference diameter in m."""

    reference_diameter: Length | None = None
    poisson_ratio: float = Field(default=0.3, ge=0, lt=0.5)


class ParameterTable(AbstractTable):
    """One entry of [parameters]; the three values are checked by `check_parameter`."""

    value: Any = None
    low: Any = None
    high: Any = None
    prior_sd: float | None = Field(default=None, gt=0)
    free: bool | None = None


def _as_table(entry: Any) -> Any:
    """A parameter given as a plain value, in the form of a table."""
    return entry if isinstance(entry, dict) else {"value": entry}


class LabTables(AbstractTable):
    """A whole lab file."""

    soil: SoilTable = _required("a table [soil] with the soil's name")
    specimen: SpecimenTable = _required("a table [specimen] with diameter and height")
    confined: ConfinedTable = ConfinedTable()
    unconfined: UnconfinedTable = UnconfinedTable()
    targets: TargetsTable = TargetsTable()
    curves: list[CurveTable] = []
    particles: ParticlesTable = ParticlesTable()
    parameters: dict[str, Annotated[ParameterTable, BeforeValidator(_as_table)]] = {}
    named_sets: dict[str, dict[str, Any]] = {}
