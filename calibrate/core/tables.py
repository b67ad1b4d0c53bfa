"""What all tables of a lab file are made of: quantities with units, and names that are checked.

Quantities are strings with units (`calibrate.core.units`) and leave a table in SI.  What a table
refuses is a `BadValue` with its repair; `calibrate.io.labfile` adds file and field.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from calibrate.core.errors import BadValue, shown, suggestion
from calibrate.core.units import (
    DENSITY,
    FORCE,
    FRACTION,
    LENGTH,
    MILLIMETRES,
    ROTATION,
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
Stress = Annotated[float, BeforeValidator(lambda text: 1e3 * positive_quantity(text, STRESS))]  # Pa
Rotation = Annotated[  # rad/s
    float, BeforeValidator(lambda text: math.radians(positive_quantity(text, ROTATION)))
]
Density = Annotated[float, _read(positive_quantity, DENSITY)]
Fraction = Annotated[float, _read(unsigned_quantity, FRACTION)]
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
