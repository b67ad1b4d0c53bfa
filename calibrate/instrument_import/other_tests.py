"""Signs that a file holds a test which is not simulated: triaxial, direct shear, CBR, tension, ...

A specimen under a confining pressure is stronger than an unconfined one, so its strength must not
become a crushing force.  Signs are columns of such pressures that are not zero, columns of shear,
pressures above zero in the lines before the table, and names of tests there.
"""

import re

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.cells import number
from calibrate.instrument_import.tables import Table
from calibrate.instrument_import.vocabulary import (
    WORDS,
    holds,
    test_named_in,
    tool_test_in,
    words_of,
)
from calibrate.labtests.composite import TYPES

SIGNS = WORDS.other_tests
_INVARIANTS = frozenset(("q", "p", "p'", "peff", "p'eff"))  # of stress, if both stand there


def signs_of_other_tests(table: Table, rows: np.ndarray, label: str, is_steps: bool) -> list[str]:
    """Sentences, one a sign; `rows` (rows,) are the specimen's.  Load steps of an oedometer may
    have a pore pressure beside them."""
    found = [text for text in _columns(table, rows) if not (is_steps and "pore" in text.casefold())]
    lines = [" ".join(cell for cell in row if cell.strip()) for row in table.preamble]
    above = [line for line in lines if _names_another(words_of(line))]
    found += [f"{shown(line.strip(), 50)} stands above the table" for line in above[:2]]
    found += [] if is_steps else [text for line in lines if (text := _pressure(line))][:2]
    for name in (table.sheet.name, label):
        if _names_another(words_of(name)):
            found.append(f"it is called {shown(name, 40)}")
    return list(dict.fromkeys(found))


def refuse(signs: list[str], insisted: bool, named: str | None) -> tuple[str, ...]:
    """Warnings where the user insists on a test, or the file names one beside its signs; else the
    refusal of a test that is not simulated."""
    if not signs:
        return ()
    if insisted or (named is not None and not any("column" in sign for sign in signs)):
        text = "a test that is not simulated shows in the file"
        return (f"{text} ({'; '.join(signs[:3])}): its strength is not an unconfined one",)
    repair = "if it is an (un)confined test all the same, give --test"
    named_by = {tool_test_in([sign]) for sign in signs}
    if len(named_by) == 1 and (test := next(iter(named_by))) is not None:
        problem = f"it is a {TYPES[test].title} test, which is not simulated as compression"
        raise BadValue(f"{problem}: {'; '.join(signs[:2])}", f"give --test {test}; {repair}")
    raise BadValue(f"it is a test that is not simulated: {'; '.join(signs[:2])}", repair)


def _columns(table: Table, rows: np.ndarray) -> list[str]:
    found = []
    names = [words_of(heading.name).replace(" ", "") for heading in table.headings]
    if len(_INVARIANTS.intersection(names)) > 1 or "peff" in names:
        found.append("it has columns of the invariants p and q")
    for column, heading in enumerate(table.headings):
        name = words_of(heading.name)
        values = table.numbers[rows, column] if column < table.numbers.shape[1] else rows[:0]
        largest = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        if holds(name, SIGNS.columns):
            found.append(f"it has a column {shown(heading.words(), 40)}")
        elif holds(name, SIGNS.pressures) and largest > 0:
            found.append(f"column {shown(heading.words(), 40)} reads up to {largest:.4g}")
    return found


def _pressure(line: str) -> str:
    """A pressure above zero that a line states."""
    words = words_of(line)
    if len(line) > 120 or not holds(words, SIGNS.pressures):
        return ""
    values = [number(text.replace(",", "."), ".") for text in re.findall(r"\d+[.,]?\d*", line)]
    return f"{shown(line.strip(), 50)} stands above the table" if any(v > 0 for v in values) else ""


def _names_another(words: str) -> bool:
    """Whether words name a test that is not simulated, and none that is."""
    negated = not set(WORDS.names.negations).isdisjoint(re.findall(r"\w+", words))
    return holds(words, SIGNS.names) and not negated and test_named_in(words) is None
