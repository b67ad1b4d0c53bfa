"""What the laboratory measured, in plain numbers: `load_lab` reads a lab file into a `Lab`.

Everything is SI except curves and targets, which stay in the units of the observables, mm and
N.  Curve files are CSV and must lie in the folder of the lab file or below it.
"""

import csv
import math
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.io.labfile import check_parameter, read_tables, read_text
from calibrate.io.tables import CurveTable, LabTables, ParameterTable

FEWEST_POINTS = 5  # of a measured curve


@dataclass(frozen=True)
class Specimen:
    """The cylinder of soil: diameter, height in the mould, height of the mould if known [m]."""

    diameter: float
    height: float
    mould_height: float | None


@dataclass(frozen=True)
class Confined:
    """Loading in the mould: platen speed [m/s]; the forces between which depth counts [N]."""

    rate: float
    force_low: float
    force_high: float
    greased: bool


@dataclass(frozen=True)
class Unconfined:
    """Crushing without the mould: platen speed [m/s], rest after taking the mould away [s]."""

    rate: float
    rest: float


@dataclass(frozen=True)
class Target:
    """A measured observable: mean of `repeats` tests and standard deviation of one [mm or N]."""

    mean: float
    scatter: float
    repeats: int


@dataclass(frozen=True, eq=False)
class Curve:
    """One measured curve, in the order of recording; `file` is its path as written in the lab
    file.  Both arrays have shape (points,) and are read-only."""

    test: str
    displacement_mm: np.ndarray
    force_n: np.ndarray
    file: str


@dataclass(frozen=True)
class Particles:
    """How the soil is represented: surface energy is scaled by d/`reference_diameter` [m]
    (None: not given); Poisson's ratio."""

    reference_diameter: float | None
    poisson_ratio: float


@dataclass(frozen=True)
class ParameterChoice:
    """What the lab file says about one parameter, in its SI unit; None where it says nothing."""

    value: float | None
    low: float | None
    high: float | None
    prior_sd: float | None
    free: bool | None


@dataclass(frozen=True, eq=False)
class Lab:
    """One soil and what was measured on it.

    `targets` is keyed by observable (depression_depth_mm, crushing_force_n); `parameters` and
    each of `named_sets` by parameter name.  Determinations of density [kg/m^3] and of water
    content [fraction] are kept one by one.
    """

    file: str
    name: str
    source: str
    density_kg_m3: tuple[float, ...]
    water_content: tuple[float, ...]
    specimen: Specimen
    confined: Confined
    unconfined: Unconfined
    targets: dict[str, Target]
    curves: tuple[Curve, ...]
    particles: Particles
    parameters: dict[str, ParameterChoice]
    named_sets: dict[str, dict[str, float]]


def load_lab(path: Path) -> Lab:
    """The lab file at `path`, checked and converted; raises `InputError`."""
    tables = read_tables(Path(path))
    file = str(path)
    _check_something_measured(tables, file)
    return Lab(
        file=file,
        name=tables.soil.name,
        source=tables.soil.source,
        density_kg_m3=tuple(tables.soil.density),
        water_content=tuple(tables.soil.water_content),
        specimen=Specimen(**dict(tables.specimen)),
        confined=Confined(**dict(tables.confined)),
        unconfined=Unconfined(**dict(tables.unconfined)),
        targets=_targets(tables),
        curves=_curves(tables.curves, Path(path)),
        particles=Particles(**dict(tables.particles)),
        parameters={n: _choice(n, table, file) for n, table in tables.parameters.items()},
        named_sets={n: _named_set(n, table, file) for n, table in tables.named_sets.items()},
    )


def bundled_lab(name: str = "wheat_after_rice") -> Path:
    """The path of the lab file `name` that comes with the package."""
    folder = Path(str(resources.files("calibrate") / "soils"))
    known = sorted(file.stem for file in folder.glob("*.toml"))
    if name not in known:
        raise InputError("bundled soils", "", f"no soil {shown(name)}", suggestion(name, known))
    return folder / f"{name}.toml"


def _check_something_measured(tables: LabTables, file: str) -> None:
    """Refuse a lab file with neither a target nor a curve."""
    if not (_targets(tables) or tables.curves):
        repair = "add [targets.depression_depth], [targets.crushing_force] or [[curves]]"
        raise InputError(file, "targets", "nothing measured is given", repair)


def _targets(tables: LabTables) -> dict[str, Target]:
    """The scalar targets that are given, by observable."""
    given = {
        "depression_depth_mm": tables.targets.depression_depth,
        "crushing_force_n": tables.targets.crushing_force,
    }
    return {name: Target(**dict(table)) for name, table in given.items() if table is not None}


def _choice(name: str, table: ParameterTable, file: str) -> ParameterChoice:
    """One entry of [parameters] with its numbers checked and in order."""
    field = f"parameters.{name}"
    value = _number_if_given(name, table.value, file, field)
    low = _number_if_given(name, table.low, file, f"{field}.low")
    high = _number_if_given(name, table.high, file, f"{field}.high")
    given = [number for number in (low, value, high) if number is not None]
    if given != sorted(given) or (low is not None and low == high):
        repair = "make low <= value <= high, and low < high"
        raise InputError(file, field, f"low, value, high are {low}, {value}, {high}", repair)
    return ParameterChoice(value, low, high, table.prior_sd, table.free)


def _number_if_given(name: str, value: Any, file: str, field: str) -> float | None:
    """`check_parameter`, or None for a value that is not in the file."""
    return check_parameter(name, value, file, field) if value is not None else None


def _named_set(set_name: str, values: dict[str, Any], file: str) -> dict[str, float]:
    """One of [named_sets], in SI."""
    field = f"named_sets.{set_name}"
    return {n: check_parameter(n, value, file, f"{field}.{n}") for n, value in values.items()}


def _curves(tables: list[CurveTable], lab_path: Path) -> tuple[Curve, ...]:
    """The measured curves; the same columns of a file given twice would be a false repeat."""
    seen = set()
    for number, table in enumerate(tables):
        key = (table.file, table.displacement.column, table.force.column)
        if key in seen:
            problem = f"{shown(table.file)} is listed twice"
            raise InputError(str(lab_path), f"curves[{number}].file", problem, "list it once")
        seen.add(key)
    return tuple(
        _curve(table, lab_path, f"curves[{number}]") for number, table in enumerate(tables)
    )


def _curve(table: CurveTable, lab_path: Path, field: str) -> Curve:
    """One measured curve in mm and N."""
    path = lab_path.parent / table.file
    try:
        _check_inside(path, table.file, lab_path.parent)
        text = read_text(path)
    except BadValue as bad:
        problem = f"curve {shown(table.file)}: {bad.problem}"
        raise InputError(str(lab_path), f"{field}.file", problem, bad.repair) from None
    rows = _rows(text, table.delimiter, str(path))
    displacement = _column(rows, table.displacement.column, table.displacement.unit, str(path))
    force = _column(rows, table.force.column, table.force.unit, str(path))
    if force.max() <= 0:
        repair = "give compressive force as positive numbers"
        raise InputError(str(path), table.force.column, "no force is above zero", repair)
    return Curve(table.test, displacement, force, table.file)


def _check_inside(path: Path, written: str, folder: Path) -> None:
    """Refuse a curve path that leaves `folder`, directly or through a link."""
    repair = "put the file in the folder of the lab file and give its relative path"
    if not written.isprintable() or "\\" in written or ":" in written:
        raise BadValue("backslashes, colons and control characters are not allowed", repair)
    if Path(written).is_absolute() or ".." in Path(written).parts:
        raise BadValue("the path leaves the folder of the lab file", repair)
    if not _is_below(path, folder):
        raise BadValue("a link leads out of the folder of the lab file", repair)


def _is_below(path: Path, folder: Path) -> bool:
    """Whether `path` stays in `folder` once all links are followed."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a loop of links, or a name that is too long
        return False


def _rows(text: str, delimiter: str, file: str) -> list[tuple[int, list[str]]]:
    """The rows that are not blank, the header first, each with its line number."""
    reader = csv.reader(text.splitlines(), delimiter=delimiter)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(file, "", f"not a CSV file: {error}", "export it again as CSV") from None
    if len(rows) <= FEWEST_POINTS:
        problem = f"{max(len(rows) - 1, 0)} points below the header are too few"
        raise InputError(file, "", problem, f"give a header and at least {FEWEST_POINTS} points")
    return rows


def _column(rows: list[tuple[int, list[str]]], name: str, factor: float, file: str) -> np.ndarray:
    """Column `name` times `factor`, read-only, shape (points,)."""
    header = [cell.strip() for cell in rows[0][1]]
    if header.count(name) != 1:
        problem = f"{header.count(name)} columns have this name"
        repair = f"name one of {shown(header)} as column, and check the delimiter"
        raise InputError(file, name, problem, repair)
    index = header.index(name)
    values = np.array([_cell(row, index, factor, line, name, file) for line, row in rows[1:]])
    values.flags.writeable = False
    return values


def _cell(row: list[str], index: int, factor: float, line: int, name: str, file: str) -> float:
    """Cell `index` of `row` times `factor`; must be a finite number."""
    written = row[index] if index < len(row) else ""
    try:
        value = float(written) * factor
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        problem = f"line {line}: {shown(written)} is not a finite number"
        raise InputError(file, name, problem, "correct it (decimal point, no unit) or remove it")
    return value
