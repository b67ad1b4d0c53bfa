"""The tables of a lab file, as pydantic models: which names there are and what they may hold.

Tests stand in a list [[tests]], each with its targets and curves (`calibrate.labtests`), or, those
that are `plain`, in tables of their own names beside [targets] and [[curves]].
"""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, create_model

from calibrate.core.tables import (
    AbstractTable,
    Density,
    Fraction,
    Length,
    Text,
    required,
)
from calibrate.core.units import DENSITY, FRACTION, LENGTH, Range
from calibrate.labtests.composite import PLAIN
from calibrate.labtests.measured import CurveTable, SpecimenTable, TargetTable
from jdem.materials.conventions import DEFAULT


class SoilTable(AbstractTable):
    """What was tested; density in kg/m^3, water content as a fraction."""

    name: Text = required('name = "silt loam, field 3"')
    source: str = ""
    density: Annotated[list[Density], Range(DENSITY, "200 kg/m^3", "3500 kg/m^3")] = Field(
        default_factory=list
    )
    water_content: Annotated[list[Fraction], Range(FRACTION, "0.5 %", "300 %")] = Field(
        default_factory=list
    )


class ParticlesTable(AbstractTable):
    """How the soil is represented; the reference diameter in m, the porosity that of the bed; law
    and conventions by name (`calibrate.io.conventions`)."""

    reference_diameter: Annotated[Length | None, Range(LENGTH, "0.1 um", "20 mm")] = None
    poisson_ratio: float = Field(default=0.3, ge=0, lt=0.5)
    porosity: float | None = Field(default=None, gt=0, lt=1)
    law: str = DEFAULT
    conventions: str = DEFAULT


class ParameterTable(AbstractTable):
    """One entry of [parameters]; its values are checked by `check_parameter`.  by_moisture has one
    for each moisture of specimens in place of `value`; the rest is said of all.
    """

    value: Any = None
    by_moisture: dict[str, Any] = Field(default_factory=dict)
    low: Any = None
    high: Any = None
    prior_sd: float | None = Field(default=None, gt=0)
    free: bool | None = None


def _as_table(entry: Any) -> Any:
    """A parameter given as a plain value, in the form of a table."""
    return entry if isinstance(entry, dict) else {"value": entry}


class AbstractLabTables(AbstractTable):
    """What every lab file has; `tests` are read by `calibrate.io.labfile`; `accept` names the
    entries whose values are meant though they are unusual (`calibrate.io.plausible`)."""

    accept: list[Text] = Field(default_factory=list)
    soil: SoilTable = required("a table [soil] with the soil's name")
    specimen: SpecimenTable = required("a table [specimen] with diameter and height")
    tests: list[dict[str, Any]] = Field(default_factory=list)
    curves: list[CurveTable] = Field(default_factory=list)
    particles: ParticlesTable = ParticlesTable()
    parameters: dict[str, Annotated[ParameterTable, BeforeValidator(_as_table)]] = Field(
        default_factory=dict
    )
    named_sets: dict[str, dict[str, Any]] = Field(default_factory=dict)


# [targets]: the observables of plain tests, without their units.
TargetsTable = create_model(
    "TargetsTable",
    __base__=AbstractTable,
    **{o.short: (TargetTable | None, None) for kind in PLAIN.values() for o in kind.every()},  # pyright: ignore[reportArgumentType, reportCallIssue]
)

LabTables = create_model(
    "LabTables",
    __base__=AbstractLabTables,
    targets=(TargetsTable, TargetsTable()),
    **{name: (kind | None, None) for name, kind in PLAIN.items()},  # pyright: ignore[reportArgumentType, reportCallIssue]
)


def targets_of(tables: AbstractLabTables) -> AbstractTable:
    """The table [targets]; its entries are `TargetTable` or None."""
    return getattr(tables, "targets")  # noqa: B009, the field is made above
