"""Numbers in cells as machines write them: "1.234,56", "1 234.5", "-0,125", "00:01:02.5".

A `Sheet` is the common form of a text file and of a worksheet: rows of texts beside the
numbers that they hold.
"""

import math
import re
from dataclasses import dataclass

import numpy as np

_SPACES = "\u00a0\u2009\u202f'’"  # between thousands, beside the plain space
_NUMBERS = {
    decimal: re.compile(
        rf"[-+]?(?:\d{{1,3}}(?:[{group} {_SPACES}]\d{{3}})+|\d+)?(?:[{decimal}]\d*)?"
        r"(?:[eE][-+]?\d{1,3})?"
    )
    for decimal, group in ((".", ","), (",", "."))
}
_CLOCK = re.compile(
    r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[ T]+)?(?:(\d{1,3}):)?(\d{1,2}):(\d{1,2}(?:[.,]\d+)?)"
)
_LONGEST = 40  # characters of a number


@dataclass(frozen=True, eq=False)
class Sheet:
    """Rows of cells: `texts` as written, `numbers` (rows, columns) NaN where there is none.

    `layout` says in words how the rows were found, for what is reported as assumed.
    """

    name: str
    texts: list[list[str]]
    numbers: np.ndarray
    layout: str


def number(text: str, decimal: str) -> float:
    """The number that a cell holds (a clock time in seconds), or NaN."""
    text = text.strip().replace("−", "-")
    if not text or len(text) > _LONGEST or not any(c.isdigit() for c in text):
        return math.nan
    if _NUMBERS[decimal].fullmatch(text):
        return _float(text, decimal)
    clock = _CLOCK.fullmatch(text)
    if clock:
        hours, minutes, seconds = clock[1] or "0", clock[2], clock[3].replace(",", ".")
        return 3600 * float(hours) + 60 * float(minutes) + float(seconds)
    return math.nan


def is_grouped(text: str, decimal: str) -> bool:
    """Whether the cell is a number only if its other sign separates thousands."""
    return ("," if decimal == "." else ".") in text


def sheet(name: str, texts: list[list[str]], decimal: str, layout: str) -> Sheet:
    """The sheet of these texts, with the numbers read."""
    width = max((len(row) for row in texts), default=0)
    numbers = np.full((len(texts), width), np.nan)
    for i, row in enumerate(texts):
        for j, text in enumerate(row):
            numbers[i, j] = number(text, decimal)
    return Sheet(name, texts, numbers, layout)


def _float(text: str, decimal: str) -> float:
    """The number without what separates thousands; NaN for a sign alone, and beyond all floats."""
    group = "," if decimal == "." else "."
    bare = text.translate(str.maketrans(decimal, ".", f"{group} {_SPACES}"))
    try:
        value = float(bare)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
