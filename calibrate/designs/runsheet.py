"""Run sheets: a design as CSV, filled in elsewhere (in EDEM, say) and read back.

`Design.write_csv` writes the sheet.  It may pass through a spreadsheet on the way: rows may be
sorted, columns moved, cells left empty where a run failed.  Whatever no longer fits the design
is refused with an `InputError` that names the file, the run and the column.
"""

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.designs.design import CODED, Design
from calibrate.designs.factors import Factor
from calibrate.io.labfile import read_file

CLOSE = 1e-3  # to which natural and coded values of a cell must agree, in coded units


@dataclass(frozen=True, eq=False)
class RunSheet:
    """A design with what was measured: responses (n,) by name, NaN where a cell is empty.

    Rows follow the design's standard order, whatever the order in the file.
    """

    design: Design
    responses: dict[str, np.ndarray]
    file: str

    def response(self, name: str) -> np.ndarray:
        """One response (n,), complete; `InputError` if its column or a cell of it is missing."""
        if name not in self.responses:
            repair = suggestion(name, self.responses)
            raise InputError(self.file, name, "there is no such response column", repair)
        values = self.responses[name]
        missing = sorted(self.design.run_order[~np.isfinite(values)].tolist())
        if missing:
            runs = ", ".join(str(run) for run in missing[:8]) + (" ..." if missing[8:] else "")
            problem = f"{len(missing)} of {len(values)} cells are empty (runs {runs})"
            raise InputError(self.file, name, problem, "fill them in")
        return values


def read_csv(path: Path) -> RunSheet:
    """A run sheet that `Design.write_csv` wrote, with its responses filled in."""
    file = str(path)
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(read_file(path)))]
    except csv.Error as error:
        raise InputError(file, "", f"not valid CSV: {error}", "save it as CSV again") from None
    kind, factors = _description([row for row in rows if row and row[0].startswith("#")], file)
    body = [row for row in rows if any(row) and not row[0].startswith("#")]
    if len(body) < 2:
        raise InputError(file, "", "there are no runs", "give a heading and one row for each run")
    return _Table(file, body[0], body[1:]).sheet(kind, factors)


def _description(rows: list[list[str]], file: str) -> tuple[str, tuple[Factor, ...]]:
    """Kind and factors from the lines that begin with #."""
    factors, kind = [], ""
    for row in rows:
        if row[0] == "#design":
            kind = "".join(row[1:2])
        elif row[0] == "#factor":
            factors.append(_factor(row[1:], file))
    if not factors:
        repair = "keep the lines that begin with #, with commas between the cells"
        raise InputError(file, "#factor", "no line describes a factor", repair)
    return kind, tuple(factors)


def _factor(cells: list[str], file: str) -> Factor:
    name, unit, low, high, scale = (cells + [""] * 5)[:5]
    field = f"#factor {name}"
    if scale not in ("linear", "log"):
        raise InputError(file, field, f"the scale is {shown(scale)}", "write linear or log")
    try:
        return Factor(name, float(low), float(high), unit, scale == "log")
    except BadValue as bad:
        raise bad.at(file, field) from None
    except ValueError:
        problem = f"the levels are {shown(low)} and {shown(high)}"
        raise InputError(file, field, problem, "give two numbers") from None


@dataclass(frozen=True)
class _Table:
    """Heading and rows of cells; a cell is named by its run and the heading of its column."""

    file: str
    heading: list[str]
    rows: list[list[str]]

    def sheet(self, kind: str, factors: tuple[Factor, ...]) -> RunSheet:
        self._check_shape()
        run = self._numbering("run")
        order = np.argsort(self._numbering("point"))
        coded = np.column_stack([self._coded(factor, run) for factor in factors])
        used = {"run", "point"} | {name for f in factors for name in _columns(f)}
        dummies = [name for name in self.heading if name.startswith("dummy_")]
        blank = np.zeros((len(run), 0))
        extra = np.column_stack([blank, *(self._column(name, run) for name in dummies)])
        others = [name for name in self.heading if name not in {*used, *dummies, ""}]
        try:
            design = Design(factors, coded[order], kind, extra[order], run[order])
        except BadValue as bad:
            raise bad.at(self.file, "") from None
        responses = {name: self._column(name, run)[order] for name in others}
        return RunSheet(design, responses, self.file)

    def _check_shape(self) -> None:
        named = [name for name in self.heading if name]
        twice = sorted({name for name in named if named.count(name) > 1})
        if twice:
            raise InputError(self.file, twice[0], "two columns have this name", "rename one")
        for number, row in enumerate(self.rows):
            if any(row[len(self.heading) :]):
                problem = f"row {number + 1} has more cells than the heading"
                raise InputError(self.file, "", problem, "use decimal points, not decimal commas")

    def _numbering(self, name: str) -> np.ndarray:
        """A column that counts the rows from 1, in any order."""
        numbers = self._column(name, None)
        if sorted(numbers) != list(range(1, len(self.rows) + 1)):
            problem = f"the numbers are not 1 to {len(self.rows)}, each once"
            raise InputError(self.file, name, problem, "keep one row for each run, failed ones too")
        return numbers.astype(int)

    def _coded(self, factor: Factor, run: np.ndarray) -> np.ndarray:
        """The coded column, or what the natural one says where that is empty; both must agree."""
        label, coded_label = _columns(factor)
        natural, coded = self._column(label, run), self._column(coded_label, run)
        implied = factor.coded(natural)
        found = np.where(np.isfinite(coded), coded, implied)
        for row in range(len(run)):
            if not np.isfinite(implied[row]):
                problem = f"run {run[row]} has no usable value"
                raise InputError(self.file, label, problem, "give the value that was set")
            if abs(found[row] - implied[row]) > CLOSE:
                problem = f"in run {run[row]} {natural[row]:g} is {implied[row]:g} coded, not "
                repair = "correct it, or empty the coded cell if another value was set"
                raise InputError(self.file, label, problem + f"{coded[row]:g}", repair)
        return found

    def _column(self, name: str, run: np.ndarray | None) -> np.ndarray:
        """Numbers of a column, NaN for empty cells."""
        if name not in self.heading:
            repair = suggestion(name, [other for other in self.heading if other])
            raise InputError(self.file, name, "this column is missing", repair)
        place = self.heading.index(name)
        cells = [(row + [""] * len(self.heading))[place] for row in self.rows]
        return np.array([self._number(cell, name, row, run) for row, cell in enumerate(cells)])

    def _number(self, cell: str, name: str, row: int, run: np.ndarray | None) -> float:
        try:
            number = float(cell) if cell else math.nan
        except ValueError:
            number = math.inf
        if math.isinf(number) or (cell and math.isnan(number)):
            where = f"run {run[row]}" if run is not None else f"row {row + 1}"
            repair = "write a number with a decimal point, or leave the cell empty"
            raise InputError(self.file, name, f"{where} has {shown(cell)}", repair)
        return number


def _columns(factor: Factor) -> tuple[str, str]:
    return factor.label, f"{factor.name} {CODED}"
