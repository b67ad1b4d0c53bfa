"""What the lines above a table say about specimen and test: "Durchmesser d0;50,0;mm".

A line counts for a quantity if one of its words names it and a number with a fitting unit
follows; a length may lack its unit, which is then taken as mm, and said so; a void ratio has none.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain

from calibrate.core.errors import BadValue
from calibrate.core.units import (
    AREA,
    DENSITY,
    FORCE,
    LENGTH,
    SPEED,
    STRESS,
    VOID_RATIO,
    Kind,
    unit_factor,
)
from calibrate.instrument_import.cells import number
from calibrate.instrument_import.unittext import unit_of
from calibrate.instrument_import.vocabulary import WORDS, Above, Quantity, plain, test_named_in

MASS = Kind("mass", "kg", "360 g")

_QUANTITIES: dict[Above, tuple[Kind, float, float]] = {  # and what a bench-top test can have, SI
    "diameter": (LENGTH, 5e-3, 1.0),
    "height": (LENGTH, 5e-3, 2.0),
    "mass": (MASS, 1e-3, 1e3),
    "density": (DENSITY, 300.0, 4000.0),
    "speed": (SPEED, 1e-8, 1.0),
    "area": (AREA, 1e-5, 1.0),
    "void_ratio": (VOID_RATIO, 0.05, 20.0),
}
_IN_ANY_CASE = {STRESS: Quantity.STRESS, FORCE: Quantity.FORCE}  # "kpa", as lines are compared
_NUMBER = re.compile(r"(?<![\w.,])[-+]?\d+(?:[.,]\d+)?")
_LABEL = re.compile(
    r"\S+?(?:\s*(?:id|name|label|no|nr|nummer|number|code|编号))?\.?\s*[:：#=\s]\s*(.+)",
    re.IGNORECASE,
)
_LONGEST = 200  # characters of a line


@dataclass(frozen=True)
class Stated:
    """What a preamble states: quantities in SI, the test, the specimen's name.

    `assumed` lists in words what had to be supplied, such as a missing unit; `impossible` the
    lines, by quantity, whose number is zero or negative.
    """

    quantities: dict[str, float] = field(default_factory=dict)
    test: str | None = None
    label: str = ""
    assumed: tuple[str, ...] = ()
    impossible: dict[str, str] = field(default_factory=dict)


def read_preamble(rows: list[list[str]]) -> Stated:
    """All that the rows state; the last statement of a quantity counts."""
    quantities: dict[str, float] = {}
    assumed: list[str] = []
    impossible: dict[str, str] = {}
    label, test = "", None
    for row in rows:
        cells = [cell.strip() for cell in row if cell.strip()]
        line = " ".join(cells)[:_LONGEST]
        test = test_named_in(line) or test
        label = _label(cells) or label
        for name, (kind, low, high) in _QUANTITIES.items():
            value, note = quantity_in(line, kind, words_above(name))
            if value is not None and low <= value <= high:
                quantities[name] = value
                assumed += [note] if note else []
            elif value is not None and value <= 0:
                impossible[name] = line.strip()
    return Stated(quantities, test, label, tuple(dict.fromkeys(assumed)), impossible)


def quantity_in(line: str, kind: Kind, words: Iterable[str]) -> tuple[float | None, str]:
    """The quantity (in the unit of its kind) that a line states under one of these words, and what
    was assumed about its unit."""
    lower = plain(line)
    places = [end for word in words if (end := _end_of(word, lower)) is not None]
    if not places:
        return None, ""
    rest = lower[min(places) :]
    found = _NUMBER.search(rest)
    if found is None:
        return None, ""
    value = number(found[0].replace(",", "."), ".")
    after = re.split(r"[\s()\[\]]+", rest[found.end() :].strip(" ()[]"))[0]
    before = re.search(r"[\[(]([^\[\]()]{1,10})[\])]", rest[: found.start()])
    for unit in (after, before[1] if before else ""):
        factor = _factor(unit, kind)
        if factor is not None:
            return value * factor, ""
    if kind is VOID_RATIO:
        return (value, "") if not after[:1].isalpha() else (None, "")
    if kind is not LENGTH or after:
        return None, ""  # "speed 2 of the programme"
    return value * unit_factor("mm", kind), f"{line.strip()!r} is in mm"


def words_above(name: Above) -> Iterator[str]:
    """What a quantity is called, in all languages."""
    return chain.from_iterable(WORDS.above[name].values())


def _end_of(word: str, line: str) -> int | None:
    """Where the word ends in the line; a short one must stand alone ("e0", not "probe01")."""
    if len(word) > 3 or not word.isascii():
        return line.find(word) + len(word) if word in line else None
    found = re.search(rf"(?<!\w){word}(?!\w)", line)
    return found.end() if found else None


def _factor(unit: str, kind: Kind) -> float | None:
    """SI units in one `unit`, or None if it is no unit of this kind."""
    if kind in _IN_ANY_CASE:
        known = unit_of(unit.strip(".;,:"))
        return known.factor if known is not None and known.kind == _IN_ANY_CASE[kind] else None
    written = unit.strip(".;,:").replace("毫米", "mm").replace("³", "^3").replace("cm3", "cm^3")
    written = re.sub(r"m([23])$", r"m^\1", written.replace("²", "^2"))
    try:
        return unit_factor(written, kind) if written else None
    except BadValue:
        return None


def _label(cells: list[str]) -> str:
    """The specimen's name in a line such as "Specimen: A-12" or "Probe Nr.;3"."""
    if not cells or not plain(cells[0]).startswith((*words_above("specimen"),)):
        return ""
    line = " ".join(cells)
    found = _LABEL.match(line)
    label = found[1].strip() if found else ""
    shape = any(word in plain(line) for name in _QUANTITIES for word in words_above(name))
    return "" if shape or not label else label[:60]
