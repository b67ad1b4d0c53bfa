"""Which rows of a table are one specimen's.

Specimens stand below each other with a column that names or numbers them, or without: then the
travel falls back in one row, or the clock starts again while nothing is loaded.  One record in
several blocks, with its heading repeated or a new clock in each, is one specimen: travel and
load go on from where they were.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.instrument_import.tables import FEWEST_STEPS, Table
from calibrate.instrument_import.vocabulary import WORDS, names_specimens, words_of

_LONGEST = 60  # characters of a name
_BACK = 0.5  # of the travel so far; to fall back by more in one row is another specimen
_LOADED = 0.2  # of the largest load so far; a record that is loaded more than this goes on
_NEAR = 8.0  # usual steps between rows; what lies nearer goes on
_WHOLE = 0.1  # of the largest travel and load; what is less is no specimen of its own


@dataclass(frozen=True, eq=False)
class Rows:
    """One column of time (None if not recorded), load and travel, of the rows of one table, turned
    so that compression is positive; `blocks` are the rows at which a heading stood again."""

    time: np.ndarray | None
    load: np.ndarray
    travel: np.ndarray
    blocks: Sequence[int] = ()

    @staticmethod
    def of(time, load, travel, blocks: Sequence[int] = ()) -> "Rows":
        """These columns, turned by the sign that they have at the largest load."""
        load = load - load[0]
        load = load if load[np.argmax(np.abs(load))] >= 0 else -load
        travel = travel - travel[0]
        return Rows(time, load, travel if travel[np.argmax(load)] >= 0 else -travel, blocks)

    def starts(self, are_steps: bool) -> list[int]:
        """The rows at which another specimen begins, the first row left out."""
        clock = clock_restarts(self.time)
        back = _jumps_back(self.travel, 0.8 if are_steps else _BACK)
        possible = back if are_steps else sorted({*back, *clock, *self.blocks})
        begun, found = 0, []
        for row in possible:
            if row > begun and self._is_another(begun, row, row in clock, are_steps):
                found.append(row)
                begun = row
        return found

    def _is_another(self, begun: int, row: int, clock: bool, are_steps: bool) -> bool:
        """Whether another specimen begins at `row`, the present one having begun at `begun`."""
        load, travel = self.load[begun:row], self.travel[begun:row]
        low, peak = float(travel.min()), float(load.max())
        reached = float(travel.max()) - low
        small = _WHOLE * np.ptp(self.travel), _WHOLE * self.load.max()
        if reached < small[0] or peak < small[1] or self._is_small_after(row, small):
            return False
        fell = travel[-1] - self.travel[row] > _BACK * reached > 0
        if fell or are_steps:
            return bool(fell)
        gone = load[-1] > 2 * _LOADED * peak and self.load[row] < _LOADED * peak
        if gone and row in self.blocks:
            return True
        far = self.travel[row] - low > _BACK * reached
        loaded = self.load[row] > _LOADED * peak
        return not (far or loaded) and (clock or self.time is None)

    def _is_small_after(self, row: int, small: tuple[float, float]) -> bool:
        """Whether what follows is no record of its own."""
        rise = (values[row:].max() - values[row] for values in (self.travel, self.load))
        return any(float(by) < least for by, least in zip(rise, small, strict=True))

    def goes_on(self, row: int) -> bool:
        """Whether travel and load at `row` lie within a few usual steps of the row above."""
        near = (
            abs(values[row] - values[row - 1]) <= _NEAR * _usual(values)
            for values in (self.travel, self.load)
        )
        return all(near)


def by_specimen(table: Table) -> list[tuple[str, np.ndarray]]:
    """The name and the rows, a mask of shape (rows,), of each specimen in the order of the file.

    One nameless specimen with all rows where no column names specimens, or where it counts the
    readings instead.  A blank cell belongs to the name above it.
    """
    whole = [("", np.ones(len(table.numbers), bool))]
    names = names_of_rows(table, filled=True)
    groups = list(dict.fromkeys(names))
    if groups == [""] or len(groups) * FEWEST_STEPS > len(names):
        return whole
    return [(group, np.array([name == group for name in names])) for group in groups]


def are_only_numbered(table: Table) -> bool:
    """Whether no column names specimens, but one numbers something: runs, tests, repeats."""
    named = [h.name for h in table.headings if names_specimens(h.name)]
    return bool(named) and not any(
        words_of(name).startswith(WORDS.names.specimen) for name in named
    )


def names_of_rows(table: Table, filled: bool = False) -> list[str]:
    """What the columns of names say of each row, "" where there are none; filled: a blank cell
    says what the one above it says.  A column that says the same of all rows is left out."""
    columns = [j for j, h in enumerate(table.headings) if names_specimens(h.name)]
    said = [_column(table, j, filled) for j in columns]
    telling = [column for column in said if len(set(column)) > 1] or said[:1]
    return [" ".join(filter(None, cells)) for cells in zip(*telling, strict=True)] or [""] * len(
        table.texts
    )


def unique_labels(names: list[str]) -> list[str]:
    """One name for each specimen, no two alike; "specimen 2" for one without."""
    labels: list[str] = []
    for number, name in enumerate(names, start=1):
        label = " ".join(name.split())[:_LONGEST] or f"specimen {number}"
        labels.append(f"{label} ({number})" if label in labels else label)
    return labels


def _column(table: Table, column: int, filled: bool) -> list[str]:
    names, last = [], ""
    for row in table.texts:
        own = row[column].strip()[:_LONGEST] if column < len(row) else ""
        last = own or last
        names.append(last if filled else own)
    return names


def clock_restarts(time: np.ndarray | None) -> list[int]:
    """Rows where the clock jumps back by more than half of what it had reached."""
    return [] if time is None else _jumps_back(time, _BACK)


def _jumps_back(values: np.ndarray, share: float) -> list[int]:
    """Rows where values fall in one row by more than this share of what they had risen by."""
    found, low, high = [], values[0], values[0]
    for row in range(1, len(values)):
        value = values[row]
        if values[row - 1] - value > share * (high - low) > 0 and row - (found or [0])[-1] > 2:
            found.append(row)
            low = high = value
        low, high = min(low, value), max(high, value)
    return found


def _usual(values: np.ndarray) -> float:
    steps = np.abs(np.diff(values))
    return float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
