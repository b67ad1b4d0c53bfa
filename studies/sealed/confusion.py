"""What was named for what was hidden: one row for each hidden effect, one column for each answer.

Classes of alike effects differ from case to case, so a right class counts at the hidden effect
itself and a wrong one at its first member.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from jdem.effects.composite import EFFECTS
from studies.sealed.scores import SCATTER, Row

NOTHING, TWO = "nothing", "two effects"  # rows besides effects
BOTH, OTHERS, FAILED = "the two hidden", "two others", "failed"  # columns besides


@dataclass(frozen=True, eq=False)
class ConfusionMatrix:
    """How often each answer (columns) was given for what was hidden (rows): counts (r, c);
    `right` (r, c) marks the right answers."""

    rows: Sequence[str]
    columns: Sequence[str]
    counts: np.ndarray
    right: np.ndarray


def confusion_matrix(result: dict, rows: Sequence[Row]) -> ConfusionMatrix:
    """The table of the rows of a result."""
    hidden = {row.case: _hidden_name(row, result["hidden"][row.case]) for row in rows}
    column = {row.case: _column(row, hidden[row.case]) for row in rows}
    rest = [BOTH, OTHERS, UNKNOWN, NONE, FAILED]
    names = [plain(name) for name in EFFECTS]
    lines = _ordered(hidden.values(), names, [TWO, NOTHING])
    columns = _ordered([*column.values(), *(n for n in lines if n in names)], names, rest)
    counts = np.zeros((len(lines), len(columns)), int)
    right = np.zeros((len(lines), len(columns)), bool)
    for row in rows:
        counts[lines.index(hidden[row.case]), columns.index(column[row.case])] += 1
    kinds = {hidden[row.case]: row.kind for row in rows}
    answer = {"two": BOTH, "outside": UNKNOWN, NONE: NONE, SCATTER: NONE}
    for r, line in enumerate(lines):
        wanted = answer.get(kinds[line], line)
        right[r] = [name == wanted for name in columns]
    return ConfusionMatrix(lines, columns, counts, right)


def _hidden_name(row: Row, hidden: Sequence[Mapping]) -> str:
    if row.kind == NONE:
        return NOTHING
    return TWO if row.kind == "two" else plain(hidden[0]["name"])


def _column(row: Row, hidden: str) -> str:
    if row.verdict == row.truth and row.kind == "two":
        return BOTH
    if row.verdict == row.truth and row.kind == "single":
        return hidden
    return OTHERS if TOGETHER in row.verdict else plain(row.verdict.split(JOINED)[0])


def _ordered(found: Iterable[str], first: Sequence[str], last: Sequence[str]) -> list[str]:
    """The names in `found`: those of `first` in their order, others by name, those of `last`."""
    present = set(found)
    middle = sorted(present - set(first) - set(last))
    return [*(n for n in first if n in present), *middle, *(n for n in last if n in present)]


def plain(name: str) -> str:
    """A name of the program as words."""
    return name.replace("_", " ")
