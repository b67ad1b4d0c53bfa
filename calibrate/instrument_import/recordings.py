"""One specimen's record as the machine wrote it: time (s), displacement (mm), force (N).

Stated units are converted; missing ones are taken as N, mm and s and said so.  Compression is
turned to be positive.  A table whose time starts again holds several specimens.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.core.units import FORCE as FORCE_KIND
from calibrate.core.units import MILLIMETRES, UNITS, unit_factor
from calibrate.core.units import TIME as TIME_KIND
from calibrate.instrument_import.cells import Sheet
from calibrate.instrument_import.columns import Channel, Channels, channels_of, explain_missing
from calibrate.instrument_import.preamble import Stated, read_preamble
from calibrate.instrument_import.tables import FEWEST_ROWS, Table, tables_in
from calibrate.instrument_import.vocabulary import DISPLACEMENT, FORCE, TIME, test_named_in

MINOR = 0.1  # tables with fewer rows than this share of the longest are no recordings
MOST_SPECIMENS = 60

_KINDS = {FORCE: FORCE_KIND, DISPLACEMENT: MILLIMETRES, TIME: TIME_KIND}
_USUAL = {FORCE: "N", DISPLACEMENT: "mm", TIME: "s"}


@dataclass(frozen=True)
class Units:
    """Units that the user insists on, as pint knows them; None: as the file says."""

    force: str | None = None
    displacement: str | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """One specimen in file order, arrays of shape (points,); `time_s` is None if not recorded.

    `place` says where in the file it stands; `stated` holds what its preamble says;
    `units_stated` whether the file wrote the units of force and displacement; `assumed` and
    `warnings` are sentences.
    """

    label: str
    place: str
    time_s: np.ndarray | None
    displacement_mm: np.ndarray
    force_n: np.ndarray
    stated: Stated
    units_fixed: frozenset[str]
    assumed: tuple[str, ...]
    warnings: tuple[str, ...]


def recordings_in(sheets: list[Sheet], units: Units) -> list[Recording]:
    """All specimens of a file; `BadValue` if there is none, or far too many."""
    tables = [table for page in sheets for table in tables_in(page)]
    with_channels = [(table, channels) for table in tables if (channels := channels_of(table))]
    if not with_channels:
        raise explain_missing(tables) if tables else _nothing()
    longest = max(len(table.numbers) for table, _ in with_channels)
    found = [
        recording
        for table, several in with_channels
        if len(table.numbers) >= MINOR * longest
        for channels in several
        for recording in _split(_recording(table, channels, units, len(sheets) > 1))
    ]
    if not found:
        raise _nothing()
    if len(found) > MOST_SPECIMENS:
        problem = f"{len(found)} specimens were found in it"
        raise BadValue(problem, f"export at most {MOST_SPECIMENS} in one file")
    return found


def _nothing() -> BadValue:
    return BadValue(
        f"it holds no table of at least {FEWEST_ROWS} recorded points, only text or results",
        "export the recorded points (time, force, extension) as .csv, .txt or .xlsx",
    )


def _recording(table: Table, channels: Channels, units: Units, many_sheets: bool) -> Recording:
    """The specimen in these columns, rows with a missing value left out."""
    stated = read_preamble([*table.preamble])
    force, force_note = _in_usual_unit(table, channels.force, units.force)
    travel, travel_note = _in_usual_unit(table, channels.displacement, units.displacement)
    time, time_note = None, ""
    if channels.time is not None:
        time, time_note = _in_usual_unit(table, channels.time, None)
    rows = np.isfinite(force) & np.isfinite(travel)
    if time is not None and np.isfinite(time[rows]).mean() < 0.9:
        time = None
    if time is not None:
        rows &= np.isfinite(time)
    named = test_named_in(f"{table.sheet.name} {channels.label}") or stated.test
    fixed = {
        kind
        for kind, channel, wanted in (
            (FORCE, channels.force, units.force),
            (DISPLACEMENT, channels.displacement, units.displacement),
        )
        if wanted is not None
    }
    page = f"sheet {shown(table.sheet.name, 30)}, " if many_sheets else ""
    recording = Recording(
        label=channels.label or stated.label or (table.sheet.name if many_sheets else ""),
        place=f"{page}rows from {table.line}, {_columns_in_words(channels)}",
        time_s=None if time is None else time[rows],
        displacement_mm=travel[rows],
        force_n=force[rows],
        stated=replace(stated, test=named),
        units_fixed=frozenset(fixed),
        assumed=tuple(
            note for note in (force_note, travel_note, time_note, _passed_over(channels)) if note
        )
        + stated.assumed,
        warnings=_missing(table, rows, force, travel),
    )
    return _compressive(recording)


def _in_usual_unit(table: Table, channel: Channel, wanted: str | None) -> tuple[np.ndarray, str]:
    """A column in N, mm or s, and what was assumed about its unit."""
    values = table.numbers[:, channel.column]
    kind = _KINDS[channel.kind]
    if wanted is not None:
        return values * unit_factor(wanted, kind), ""
    unit = channel.heading.unit
    if unit is not None:
        return values * float(UNITS.Quantity(1.0, unit[1]).to(kind.unit).magnitude), ""
    usual = _USUAL[channel.kind]
    return values, f"column {shown(channel.heading.name, 30)} has no unit: taken as {usual}"


def _columns_in_words(channels: Channels) -> str:
    several = (channels.time, channels.displacement, channels.force)
    return ", ".join(f"{c.kind} {shown(c.heading.words(), 40)}" for c in several if c is not None)


def _passed_over(channels: Channels) -> str:
    """Which column was taken where several could have been."""
    if not channels.passed_over:
        return ""
    others = ", ".join(shown(c.heading.words(), 30) for c in channels.passed_over[:4])
    return f"columns of {_columns_in_words(channels)} are used, not {others}"


def _missing(table: Table, rows: np.ndarray, force, travel) -> tuple[str, ...]:
    """A warning about rows within the record that lack a value."""
    any_value = np.isfinite(force) | np.isfinite(travel)
    inside = np.flatnonzero(any_value)
    lost = int((~rows[inside[0] : inside[-1] + 1]).sum()) if len(inside) else 0
    return (f"{lost} rows with a missing value were left out",) if lost else ()


def _compressive(recording: Recording) -> Recording:
    """Force and displacement turned so that compression is positive."""
    force, travel, notes = recording.force_n, recording.displacement_mm, []
    if len(force) < FEWEST_ROWS:
        return recording
    top = int(np.argmax(np.abs(force - np.median(force[:5]))))
    if force[top] < np.median(force[:5]):
        force, top = -force, int(np.argmin(force))
        notes.append("compressive force is negative in the file: its sign was turned")
    if travel[top] < travel[0]:
        travel = -travel
        notes.append("displacement falls while the force rises: its sign was turned")
    return replace(
        recording,
        force_n=force,
        displacement_mm=travel,
        assumed=recording.assumed + tuple(notes),
    )


def _split(recording: Recording) -> Iterator[Recording]:
    """The parts of a record whose time starts again; short parts are no specimens."""
    time = recording.time_s
    cuts = [] if time is None or len(time) < 2 else _restarts(time)
    edges = [0, *cuts, len(recording.force_n)]
    parts = [slice(a, b) for a, b in pairwise(edges)]
    parts = [part for part in parts if part.stop - part.start >= FEWEST_ROWS]
    for number, part in enumerate(parts, start=1):
        label = f"{recording.label} part {number}".strip() if len(parts) > 1 else recording.label
        yield replace(
            recording,
            label=label,
            time_s=None if time is None else time[part],
            displacement_mm=recording.displacement_mm[part],
            force_n=recording.force_n[part],
        )


def _restarts(time: np.ndarray) -> list[int]:
    """Rows where the clock jumps back by more than half of what it had reached."""
    cuts, begun = [], 0
    for row in range(1, len(time)):
        reached = time[begun:row].max() - time[begun] if row - begun >= FEWEST_ROWS else 0.0
        if reached > 0 and time[row] < time[row - 1] - 0.5 * reached:
            cuts.append(row)
            begun = row
    return cuts
