"""The paper's printed numbers as they stand in `tables.csv`: text, value and rounding.

A number keeps its printed text, because the last digit says how far it is known: 3.36 stands
for the interval 3.355 to 3.365.
"""

import csv
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("tables.csv")


@dataclass(frozen=True)
class Range:
    """A number that is known to `value` ± `reach`, both in the same unit."""

    value: float
    reach: float = 0.0

    def meets(self, other: "Range") -> bool:
        """Whether the two intervals have a point in common."""
        return abs(self.value - other.value) <= self.reach + other.reach


def printed(text: str) -> Range:
    """A printed number, ± half a unit of its last digit: "1.062e5" is 106200 ± 50."""
    number = Decimal(text)
    return Range(float(number), 0.5 * 10.0 ** int(number.as_tuple().exponent))


@dataclass(frozen=True)
class Table:
    """One table: `title` as the paper names it, rows by the text of their first column."""

    title: str
    columns: tuple[str, ...]
    rows: dict[str, dict[str, str]]

    def text(self, row: str, column: str) -> str:
        """A cell as printed; "" where nothing was printed."""
        return self.rows[row][column]

    def cell(self, row: str, column: str) -> Range:
        return printed(self.rows[row][column])

    def values(self, column: str) -> np.ndarray:
        """A column of numbers (n,)."""
        return np.array([printed(row[column]).value for row in self.rows.values()])

    def half_units(self, column: str) -> np.ndarray:
        """Half a unit of the last printed digit of each number of a column (n,)."""
        return np.array([printed(row[column]).reach for row in self.rows.values()])

    def points(self, columns: tuple[str, ...]) -> np.ndarray:
        """Columns side by side (n, p)."""
        return np.column_stack([self.values(column) for column in columns])


@cache
def table(number: int) -> Table:
    """Table 1 to 10 of the paper."""
    return _read(f"table_{number:02d}", f"Table {number}")


@cache
def equation(response: str) -> dict[str, str]:
    """Printed coefficients of the "depth" or "force" equation by term; "1" is the intercept."""
    rows = _read(f"equation_{response}", f"{response} equation").rows
    return {term: row["coefficient"] for term, row in rows.items()}


@cache
def in_text(name: str) -> str:
    """What the running text prints under a name of the table `text`."""
    return _text().text(name, "printed")


@cache
def place(name: str) -> str:
    """Where in the paper that stands, such as "section 3.2"."""
    return _text().text(name, "place")


@cache
def _text() -> Table:
    return _read("text", "text")


@cache
def _blocks() -> dict[str, list[str]]:
    """The lines of every table by its name."""
    found: dict[str, list[str]] = {}
    for block in FILE.read_text(encoding="utf-8").split("\n\n"):
        name, *lines = block.strip().split("\n")
        found[name.removeprefix("# ")] = lines
    return found


def _read(name: str, title: str) -> Table:
    reader = csv.DictReader(_blocks()[name])
    columns = tuple(reader.fieldnames or ())
    return Table(title, columns, {row[columns[0]]: row for row in reader})
