"""Whose row it is: a table with a column that names the specimen, taken apart by specimen."""

import numpy as np

from calibrate.instrument_import.tables import FEWEST_STEPS, Table
from calibrate.instrument_import.vocabulary import names_specimens

_LONGEST = 60  # characters of a name


def by_specimen(table: Table) -> list[tuple[str, np.ndarray]]:
    """The name and the rows, a mask of shape (rows,), of each specimen in the order of the file.

    One nameless specimen with all rows where no column names specimens, or where it counts the
    readings instead.  A blank cell belongs to the name above it.
    """
    whole = [("", np.ones(len(table.numbers), bool))]
    column = _naming_column(table)
    if column is None:
        return whole
    names, last = [], ""
    for row in table.texts:
        last = (row[column].strip()[:_LONGEST] if column < len(row) else "") or last
        names.append(last)
    groups = list(dict.fromkeys(names))
    if len(groups) * FEWEST_STEPS > len(names):
        return whole
    return [(group, np.array([name == group for name in names])) for group in groups]


def unlike(names: list[str]) -> list[str]:
    """One name a specimen, unlike all others; "specimen 2" for one without."""
    labels: list[str] = []
    for number, name in enumerate(names, start=1):
        label = " ".join(name.split())[:_LONGEST] or f"specimen {number}"
        labels.append(f"{label} ({number})" if label in labels else label)
    return labels


def names_of_rows(table: Table) -> list[str]:
    """What the column of names says of each row; "" where there is none."""
    column = _naming_column(table)
    return [
        row[column].strip() if column is not None and column < len(row) else ""
        for row in table.texts
    ]


def _naming_column(table: Table) -> int | None:
    named = (j for j, h in enumerate(table.headings) if names_specimens(h.name))
    return next(named, None)
