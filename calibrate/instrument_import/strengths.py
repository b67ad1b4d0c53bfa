"""A table of strengths, one specimen a row and no curve: F = q_u A, with q_u = 2 s_u.

The uniaxial compressive strength q_u is the largest axial stress of a crushing test.  It is
the diameter of Mohr's circle at failure, and the undrained shear strength s_u its radius.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.instrument_import.cells import Sheet
from calibrate.instrument_import.columns import STRENGTHS, Channel, channels_in, channels_of
from calibrate.instrument_import.measured import measured
from calibrate.instrument_import.preamble import read_preamble
from calibrate.instrument_import.recordings import MOST_SPECIMENS, Choices
from calibrate.instrument_import.sizes import Column, converted
from calibrate.instrument_import.specimen_rows import names_of_rows, unique_labels
from calibrate.instrument_import.tables import FEWEST_STEPS, Table, tables_in
from calibrate.instrument_import.vocabulary import SOFTENS, Quantity


@dataclass(frozen=True, eq=False)
class Strengths:
    """Crushing tests of which only the strength is known, one a specimen.

    `stress_kpa` is q_u and `force_n` the crushing force, shape (specimens,); diameter and
    height (m), the latter None where not stated; `notes` say what was computed and assumed.
    """

    test: str
    labels: tuple[str, ...]
    stress_kpa: np.ndarray
    force_n: np.ndarray
    diameter: float
    height: float | None
    density: float | None
    place: str
    notes: tuple[str, ...]


def strengths_in(sheets: list[Sheet], choices: Choices) -> Strengths | None:
    """The strengths of a file; None where it holds none, or curves beside them.

    Raises `BadValue` for strengths without a size, and for one that is not above zero.
    """
    tables = [table for page in sheets for table in tables_in(page, FEWEST_STEPS, 1)]
    found = [(table, channels_in(table, FEWEST_STEPS)) for table in tables]
    if any(channels_of(table, FEWEST_STEPS) for table in tables):
        return None
    for table, channels in found:
        of_kind = [c for kind in STRENGTHS for c in channels if c.kind == kind]
        if of_kind:
            return _strengths(table, of_kind[0], choices)
    return None


def _strengths(table: Table, channel: Channel, choices: Choices) -> Strengths:
    stated, size_notes = choices.size.over(read_preamble([*table.preamble]))
    column, unit_note = measured(table, channel, choices.units)
    is_shear = channel.kind == Quantity.SHEAR_STRENGTH
    rows = np.isfinite(column.values)
    stress = (2.0 if is_shear else 1.0) * column.values[rows]
    _check(column, stress)
    load = Column(Quantity.STRESS, column.words, stress)
    nothing = Column(Quantity.DISPLACEMENT, "", np.zeros(len(stress)))
    size = converted(load, nothing, stated, choices.size, 0)
    assert size.diameter is not None  # `converted` refuses a stress without it
    if (choices.test or SOFTENS) != SOFTENS:
        problem = f"it holds strengths and no curve, which no {choices.test} test gives"
        raise BadValue(problem, f"give --test {SOFTENS}, or export the recorded points")
    names = [name for name, kept in zip(names_of_rows(table), rows, strict=True) if kept]
    shear = f"compressive strength is twice the undrained one in {column.words}"
    notes = (unit_note, shear if is_shear else "", *size_notes, *stated.assumed, *size.sentences)
    return Strengths(
        test=SOFTENS,
        labels=tuple(unique_labels(names)),
        stress_kpa=stress,
        force_n=size.force_n,
        diameter=size.diameter,
        height=stated.quantities.get("height"),
        density=stated.quantities.get("density"),
        place=f"rows from {table.line}, {channel.kind} of {column.words}",
        notes=tuple(note for note in notes if note),
    )


def _check(column: Column, stress: np.ndarray) -> None:
    """Refuses strengths that are none, and more of them than a file may hold."""
    if not stress.min() > 0:
        problem = f"{column.words} holds a strength that is not above zero"
        raise BadValue(problem, "correct it or leave the specimen out")
    if len(stress) > 10 * MOST_SPECIMENS:
        raise BadValue(f"{len(stress)} strengths stand in it", "export fewer specimens")
