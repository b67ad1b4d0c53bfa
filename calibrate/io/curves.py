"""Measured curves and repeats from CSV files, as a lab file names them, in mm and N.

Files must lie in the folder of the lab file or below it.  Stress and strain become force and
displacement by the specimen's first size; a void ratio e is a strain (e0 - e)/(1 + e0).
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown
from calibrate.io.labfile import read_text
from calibrate.labtests.measured import Curve, CurveTable, Cylinder, TargetTable

FEWEST_POINTS = 5  # of a measured curve
FEWEST_STEPS = 3  # of a test in load steps

Row = tuple[int, list[str]]  # number of the line, cells


@dataclass(frozen=True)
class Table:
    """The rows of a CSV file that are not blank, the header first; its decimal sign."""

    rows: list[Row]
    file: str
    decimal: str

    @property
    def header(self) -> list[str]:
        return [cell.strip() for cell in self.rows[0][1]]

    def index(self, name: str) -> int:
        """Number of the column `name`."""
        if self.header.count(name) != 1:
            problem = f"{self.header.count(name)} columns have this name"
            repair = f"name one of {shown(self.header)} as column, and check the delimiter"
            raise InputError(self.file, name, problem, repair)
        return self.header.index(name)

    def column(self, name: str, factor: float = 1.0) -> np.ndarray:
        """Column `name` times `factor`, read-only, shape (points,)."""
        index = self.index(name)
        values = np.array([self._cell(row, index, line, name) for line, row in self.rows[1:]])
        values = values * factor
        if not np.all(np.isfinite(values)):
            line = self.rows[1 + int(np.argmin(np.isfinite(values)))][0]
            problem = f"line {line}: this is too large"
            raise InputError(self.file, name, problem, "correct it or remove it")
        values.flags.writeable = False
        return values

    def where(self, wanted: dict[str, str], fewest: int) -> "Table":
        """The rows whose columns have the wanted values; at least `fewest`."""
        rows = self.rows
        for name, value in wanted.items():
            index = self.index(name)
            rows = [rows[0]] + [
                r for r in rows[1:] if len(r[1]) > index and r[1][index].strip() == value
            ]
            if len(rows) == 1:
                problem = f"no row has {shown(value)} in this column"
                raise InputError(self.file, name, problem, "correct where = {...} in the lab file")
        if len(rows) <= fewest:
            problem = f"{max(len(rows) - 1, 0)} points below the header are too few"
            repair = f"give a header and at least {fewest} points"
            raise InputError(self.file, "", problem, repair)
        return Table(rows, self.file, self.decimal)

    def _cell(self, row: list[str], index: int, line: int, name: str) -> float:
        """Cell `index` of `row`; must be a finite number."""
        written = row[index] if index < len(row) else ""
        try:
            value = float(written.replace(self.decimal, "."))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            problem = f"line {line}: {shown(written)} is not a finite number"
            repair = "correct it (decimal point, no unit) or remove it"
            if self.decimal == ",":
                repair = "correct it (decimal comma, no unit) or remove it"
            raise InputError(self.file, name, problem, repair)
        return value


def read_curve(
    table: CurveTable, test: str, cylinder: Cylinder, lab_path: Path, field: str
) -> Curve:
    """One measured curve; `field` is where the lab file names it.

    Of load steps the last reading under each load counts: what happens in between is time.
    """
    rows = _opened(table, lab_path, f"{field}.file", "curve")
    rows = rows.where(table.where, FEWEST_STEPS if table.points else FEWEST_POINTS)
    displacement, force = _displacement(table, rows, cylinder), _force(table, rows, cylinder)
    if table.points:
        ends = np.append(force[1:] != force[:-1], True)
        displacement, force = displacement[ends], force[ends]
    for values in (displacement, force):
        values.flags.writeable = False
    return Curve(test, displacement, force, table.file, table.points, table.compared)


def read_repeats(table: TargetTable, lab_path: Path, field: str) -> np.ndarray:
    """The repeats (n,) of a target in a file, in its unit."""
    rows = _opened(table, lab_path, f"{field}.file", "target").where(table.where, 1)
    return table.times * rows.column(table.column or "")


def read_columns(path: Path) -> Table:
    """A CSV file whose columns are asked for by name: decimal points, commas between cells."""
    try:
        text = read_text(path)
    except BadValue as bad:
        raise InputError(str(path), "", bad.problem, bad.repair) from None
    return Table(_rows(text, ",", str(path)), str(path), ".").where({}, 1)


def _opened(table: CurveTable | TargetTable, lab_path: Path, field: str, what: str) -> Table:
    """The CSV file of a table, which must lie in the lab file's folder."""
    written = table.file or ""
    path = lab_path.parent / written
    try:
        _check_inside(path, written, lab_path.parent)
        text = read_text(path)
    except BadValue as bad:
        problem = f"{what} {shown(written)}: {bad.problem}"
        raise InputError(str(lab_path), field, problem, bad.repair) from None
    return Table(_rows(text, table.delimiter, str(path)), str(path), table.decimal)


def _displacement(table: CurveTable, rows: Table, cylinder: Cylinder) -> np.ndarray:
    """Displacement (mm)."""
    if table.displacement is not None:
        return rows.column(table.displacement.column, table.displacement.unit)
    height_mm = 1e3 * cylinder.height
    if table.strain is not None:
        return height_mm * rows.column(table.strain.column, table.strain.unit)
    assert table.void_ratio is not None  # as the table itself has checked
    ratio = rows.column(table.void_ratio.column)
    initial = float(ratio[0]) if table.void_ratio.initial is None else table.void_ratio.initial
    if initial <= -1:
        problem = f"a void ratio of {initial:g} is impossible"
        raise InputError(rows.file, table.void_ratio.column, problem, "give volumes over volumes")
    return height_mm * (initial - ratio) / (1 + initial)


def _force(table: CurveTable, rows: Table, cylinder: Cylinder) -> np.ndarray:
    """Force (N), some of it above zero."""
    if table.force is not None:
        name, values = table.force.column, rows.column(table.force.column, table.force.unit)
    else:
        assert table.stress is not None
        name = table.stress.column
        values = 1e3 * cylinder.area * rows.column(name, table.stress.unit)
    if values.max() <= 0:
        repair = "give compressive force as positive numbers"
        raise InputError(rows.file, name, "no force is above zero", repair)
    return values


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


def _rows(text: str, delimiter: str, file: str) -> list[Row]:
    """The rows that are not blank, the header first, each with its line number."""
    reader = csv.reader(text.splitlines(), delimiter=delimiter)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(file, "", f"not a CSV file: {error}", "export it again as CSV") from None
    if not rows:
        repair = f"give a header and at least {FEWEST_POINTS} points"
        raise InputError(file, "", "0 points below the header are too few", repair)
    return rows
