"""Tables in a sheet: runs of rows of numbers, the heading above each, the lines before it.

preamble     Material;silt          any lines: specimen, diameter, speed, ...
heading      Time;Force             names, a row of units, a row of labels, in any order
             s;N
rows         0,00;0,1               at least FEWEST_ROWS
"""

from dataclasses import dataclass, replace

import numpy as np

from calibrate.instrument_import.cells import Sheet, number
from calibrate.instrument_import.headings import Heading, heading_of, split_heading
from calibrate.instrument_import.preamble import read_preamble
from calibrate.instrument_import.unittext import unit_of
from calibrate.instrument_import.vocabulary import Kinds, kind_of, names_specimens

FEWEST_ROWS = 8
FEWEST_STEPS = 3  # rows of a table of load steps, or of strengths
_TALLEST = 4  # rows of a heading
_LONGEST_PREAMBLE = 200  # rows looked at for the specimen's data

Row = list[str]


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
    blocks: tuple[int, ...] = ()  # rows above which the heading stood again
    lost: int = 0  # lines among the rows that hold no numbers

    @property
    def above(self) -> list[Row]:
        """All lines of words above the first row, those above earlier tables among them."""
        rows = self.sheet.texts[: self.line - 1]
        return [row for row in rows if any(c.isalpha() for cell in row for c in cell)]


def tables_in(
    sheet: Sheet, fewest: int = FEWEST_ROWS, numeric: int = 2, kinds: Kinds = ()
) -> list[Table]:
    """The tables of a sheet of at least `fewest` rows, with at least `numeric` numbers a row;
    `kinds` of columns beyond the usual ones.

    Rows that follow without a heading, or under the same heading and no other specimen's data,
    continue the table before.
    """
    tables: list[Table] = []
    begun, before = 0, 0  # where the lines above this table begin, and those above the last one
    for first, last in _runs(sheet, numeric):
        above = sheet.texts[max(begun, first - _LONGEST_PREAMBLE) : first]
        headings, used = _headings(above, sheet.numbers.shape[1], kinds)
        between, rows = above[: len(above) - used], slice(first, last)
        if tables and _continues(tables[-1], sheet.numbers[rows], headings, used, between, fewest):
            tables[-1] = _continued(tables[-1], rows, bool(used), between)
            begun = last
            continue
        if tables and len(tables[-1].numbers) < fewest:  # a few numbers above a table, no table
            tables.pop()
            begun = before
            between = sheet.texts[max(begun, first - _LONGEST_PREAMBLE) : first - used]
        if last - first >= fewest or used:
            numbers, texts = sheet.numbers[rows], sheet.texts[rows]
            tables.append(Table(sheet, between, headings, numbers, texts, first + 1))
            before, begun = begun, last
    return [table for table in tables if len(table.numbers) >= fewest]


def _runs(sheet: Sheet, least: int) -> list[tuple[int, int]]:
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
            runs.append((int(kept[start]), int(kept[stop - 1]) + 1))
            start = None
    return runs


def _continues(
    table: Table,
    numbers: np.ndarray,
    headings: list[Heading],
    used: int,
    between: list[Row],
    fewest: int,
) -> bool:
    """Whether a run of rows belongs to the table before it."""
    if not used:
        if not np.array_equal(_used(table.numbers), _used(numbers)):
            return False
        return len(numbers) >= fewest or _goes_on(table.numbers, numbers)
    same = [h.words() for h in headings] == [h.words() for h in table.headings]
    stated, before = read_preamble(between), read_preamble(table.preamble)
    told = (stated.label, stated.test, stated.quantities)
    return same and told in (("", None, {}), (before.label, before.test, before.quantities))


def _goes_on(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether every column goes on within a few of its steps: results below a table do not."""
    used = _used(before)
    steps = np.abs(np.diff(before[:, used], axis=0))
    if not len(steps) or np.isnan(steps).all(axis=0).any():
        return False
    jump = np.abs(after[0, used] - before[-1, used])
    return bool(np.all(jump <= 3 * np.nanmax(steps, axis=0)))


def _headings(above: list[Row], columns: int, kinds: Kinds) -> tuple[list[Heading], int]:
    """Headings of all columns from the rows directly above, and how many rows they took."""
    rows, taken = _heading_rows(above, kinds)
    width = max([columns, *(len(row) for row in rows)])
    names, units, labels = [], [], []
    for row in rows:
        cells = [cell.strip() for cell in row] + [""] * (width - len(row))
        if _is_of_units(cells, kinds):
            units.append(cells)
        elif _count_named(cells, kinds):
            names.append(cells)
        else:
            labels.append(_filled_forward(cells))
    return [_heading(names, units, labels, j, kinds) for j in range(columns)], taken


def _heading(
    names: list[Row], units: list[Row], labels: list[Row], j: int, kinds: Kinds
) -> Heading:
    label = " ".join(dict.fromkeys(row[j] for row in labels if row[j]))
    name = " ".join(row[j] for row in names if row[j])
    return heading_of(name, [row[j] for row in units], label, kinds)


def _is_of_units(cells: Row, kinds: Kinds) -> bool:
    """Whether a row holds units rather than names: "m" and "h" among names are names."""
    filled = [cell for cell in cells if cell]
    units = _count_units(filled, kinds)
    named = sum(
        _is_channel(cell, kinds) and (unit_of(cell, kinds) is None or len(cell.strip("[]() ")) < 2)
        for cell in filled
    )
    others = sum(not unit_of(cell, kinds) and not _is_channel(cell, kinds) for cell in filled)
    return units > 0 and units > named + others


def _heading_rows(above: list[Row], kinds: Kinds) -> tuple[list[Row], int]:
    """The lowest rows of `above` that can be a heading, and how far up they reach."""
    rows: list[Row] = []
    taken = 0
    for depth, row in enumerate(reversed(above), start=1):
        if not any(cell.strip() for cell in row):
            if rows:
                break
            continue
        if len(rows) == _TALLEST or not _is_heading(row, bool(rows), kinds):
            break
        rows.insert(0, row)
        taken = depth
    return rows, taken


def _is_heading(row: Row, below_known: bool, kinds: Kinds) -> bool:
    """A row of names or units, or, above such a row, of labels over groups of columns."""
    if below_known and any(cell.strip().endswith((":", "：")) for cell in row):
        return False  # "Time: 320 s" above a heading states something
    if kinds and any(number(cell, sign) == number(cell, sign) for cell in row for sign in ".,"):
        return False  # "Normal stress;50;kPa" does so as well
    named = _count_named(row, kinds)
    if named and not below_known:
        named += sum(names_specimens(cell) for cell in row)
    if named + _count_units(row, kinds) >= 2:
        return True
    filled = [cell for cell in row if cell.strip()]
    is_text = not any(number(cell, ".") == number(cell, ".") for cell in filled)
    return below_known and is_text and 2 <= len(filled) < len(row) and not _count_units(row, kinds)


def _count_named(row: Row, kinds: Kinds) -> int:
    return sum(1 for cell in row if cell.strip() and _is_channel(cell, kinds))


def _is_channel(cell: str, kinds: Kinds) -> bool:
    heading = split_heading(cell, kinds)
    if not any(c.isalpha() for c in heading.name):
        return False  # "500 N" is a value
    known = heading.unit is not None and not heading.unit.by_weight
    return known or (len(cell) < 60 and kind_of(heading.name, kinds)[0] is not None)


def _count_units(row: Row, kinds: Kinds) -> int:
    return sum(1 for cell in row if cell.strip() and unit_of(cell, kinds))


def _filled_forward(row: Row) -> Row:
    """A row of labels where a blank cell belongs to the label on its left."""
    filled, last = [], ""
    for cell in row:
        last = cell or last
        filled.append(last)
    return filled


def _used(numbers: np.ndarray) -> np.ndarray:
    return np.isfinite(numbers).mean(axis=0) > 0.5


def _continued(table: Table, rows: slice, headed: bool, between: list[Row]) -> Table:
    """The table with further rows of its sheet; lines between that could be rows are counted."""
    numbers, texts = table.sheet.numbers[rows], table.sheet.texts[rows]
    width = int(_used(table.numbers).sum())
    lost = [] if headed else [r for r in between if sum(bool(c.strip()) for c in r) >= width]
    return replace(
        table,
        numbers=np.concatenate([table.numbers, numbers]),
        texts=[*table.texts, *texts],
        blocks=(*table.blocks, len(table.numbers)) if headed else table.blocks,
        lost=table.lost + len(lost),
    )
