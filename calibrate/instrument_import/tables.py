"""Tables in a sheet: runs of rows of numbers, the heading above each, the lines before it.

preamble     Material;silt          any lines: specimen, diameter, speed, ...
heading      Time;Force             names, a row of units, a row of labels, in any order
             s;N
rows         0,00;0,1               at least FEWEST_ROWS
"""

from dataclasses import dataclass, replace

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.core.units import UNITS
from calibrate.instrument_import.cells import Sheet, number
from calibrate.instrument_import.vocabulary import kind_of, names_specimens, split_unit, unit_of

FEWEST_ROWS = 8
FEWEST_STEPS = 3  # rows of a table of load steps, or of strengths
_TALLEST = 4  # rows of a heading
_LONGEST_PREAMBLE = 200  # rows looked at for the specimen's data

Row = list[str]


@dataclass(frozen=True, eq=False)
class Heading:
    """What stands above one column: its name, its unit as (kind, pint name) if written, and
    the label of a group of columns ("Specimen 2") if there is one."""

    name: str
    unit: tuple[str, str] | None
    label: str

    def words(self) -> str:
        return f"{self.name} [{self.unit[1]}]" if self.unit else self.name


@dataclass(frozen=True, eq=False)
class Table:
    """A run of numbers (rows, columns), NaN where a cell is empty, with what stands above.

    `texts` holds the same rows as written.
    """

    sheet: Sheet
    preamble: list[Row]
    headings: list[Heading]
    numbers: np.ndarray
    texts: list[Row]
    line: int  # of the first row, counted from 1


def tables_in(sheet: Sheet, fewest: int = FEWEST_ROWS, numeric: int = 2) -> list[Table]:
    """The tables of a sheet of at least `fewest` rows, with at least `numeric` numbers a row;
    rows that follow without a heading continue the table before."""
    tables: list[Table] = []
    begun = 0
    for first, last in _runs(sheet, fewest, numeric):
        above = sheet.texts[max(begun, first - _LONGEST_PREAMBLE) : first]
        headings, used = _headings(above, sheet.numbers.shape[1])
        numbers, texts = sheet.numbers[first:last], sheet.texts[first:last]
        if not used and tables and _same_columns(tables[-1].numbers, numbers):
            tables[-1] = _continued(tables[-1], numbers, texts)
        else:
            preamble = above[: len(above) - used]
            tables.append(Table(sheet, preamble, headings, numbers, texts, first + 1))
        begun = last
    return tables


def _runs(sheet: Sheet, fewest: int, least: int) -> list[tuple[int, int]]:
    """First and last+1 of every run of rows of numbers; blank rows do not end a run."""
    numeric = np.isfinite(sheet.numbers).sum(axis=1)
    filled = np.array([sum(bool(cell.strip()) for cell in row) for row in sheet.texts])
    is_row = (numeric >= least) & (2 * numeric >= filled)
    kept = np.flatnonzero((filled > 0) | is_row)
    runs, start = [], None
    for place, row in enumerate(kept):
        if is_row[row] and start is None:
            start = place
        ends = not is_row[row] or place == len(kept) - 1
        if start is not None and ends:
            stop = place + 1 if is_row[row] else place
            if stop - start >= fewest:
                runs.append((int(kept[start]), int(kept[stop - 1]) + 1))
            start = None
    return runs


def _headings(above: list[Row], columns: int) -> tuple[list[Heading], int]:
    """Headings of all columns from the rows directly above, and how many rows they took."""
    rows, taken = _heading_rows(above)
    width = max([columns, *(len(row) for row in rows)])
    names, units, labels = [], [], []
    for row in rows:
        cells = [cell.strip() for cell in row] + [""] * (width - len(row))
        if _count_units(cells) >= 2 or (_count_units(cells) and not _count_named(cells)):
            units.append(cells)
        elif _count_named(cells):
            names.append(cells)
        else:
            labels.append(_filled_forward(cells))
    return [_heading(names, units, labels, j) for j in range(columns)], taken


def _heading_rows(above: list[Row]) -> tuple[list[Row], int]:
    """The lowest rows of `above` that can be a heading, and how far up they reach."""
    rows: list[Row] = []
    taken = 0
    for depth, row in enumerate(reversed(above), start=1):
        if not any(cell.strip() for cell in row):
            if rows:
                break
            continue
        if len(rows) == _TALLEST or not _is_heading(row, bool(rows)):
            break
        rows.insert(0, row)
        taken = depth
    return rows, taken


def _is_heading(row: Row, below_known: bool) -> bool:
    """A row of names or units, or, above such a row, of labels over groups of columns."""
    named = _count_named(row)
    if named and not below_known:
        named += sum(names_specimens(cell) for cell in row)
    if named + _count_units(row) >= 2:
        return True
    filled = [cell for cell in row if cell.strip()]
    is_text = not any(number(cell, ".") == number(cell, ".") for cell in filled)
    return below_known and is_text and 2 <= len(filled) < len(row) and not _count_units(row)


def _count_named(row: Row) -> int:
    return sum(1 for cell in row if cell.strip() and _is_channel(cell))


def _is_channel(cell: str) -> bool:
    name, unit = split_unit(cell)
    if not any(c.isalpha() for c in name):
        return False  # "500 N" is a value
    return unit is not None or (len(cell) < 60 and kind_of(name)[0] is not None)


def _count_units(row: Row) -> int:
    return sum(1 for cell in row if cell.strip() and unit_of(cell))


def _filled_forward(row: Row) -> Row:
    """A row of labels where a blank cell belongs to the label on its left."""
    filled, last = [], ""
    for cell in row:
        last = cell or last
        filled.append(last)
    return filled


def _heading(names: list[Row], units: list[Row], labels: list[Row], j: int) -> Heading:
    name, unit = split_unit(" ".join(row[j] for row in names if row[j]))
    below = [found for row in units if (found := unit_of(row[j]))]
    if unit and below and not _same_unit(unit, below[0]):
        problem = f"column {shown(name, 40)} has two units, {unit[1]} and {below[0][1]}"
        raise BadValue(problem, "correct the unit in the heading")
    label = " ".join(dict.fromkeys(row[j] for row in labels if row[j]))
    return Heading(name, below[0] if below else unit, label)


def _same_unit(one: tuple[str, str], other: tuple[str, str]) -> bool:
    """Whether two written units are of one kind and size."""
    sizes = [UNITS.Quantity(1.0, unit).to_base_units().magnitude for _, unit in (one, other)]
    return one[0] == other[0] and bool(np.isclose(*sizes))


def _same_columns(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(np.array_equal(_used(one), _used(other)))


def _used(numbers: np.ndarray) -> np.ndarray:
    return np.isfinite(numbers).mean(axis=0) > 0.5


def _continued(table: Table, numbers: np.ndarray, texts: list[Row]) -> Table:
    joined = np.concatenate([table.numbers, numbers])
    return replace(table, numbers=joined, texts=[*table.texts, *texts])
