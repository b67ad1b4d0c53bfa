"""One specimen's record as the machine wrote it: time (s), displacement (mm), force (N).

Stated units are converted; missing ones are taken as N, kPa, mm and s and said so.  Stress,
strain and void ratio are converted with the specimen's size (`sizes`).  Compression is turned
to be positive.  A table whose time starts again holds several specimens.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.cells import Sheet
from calibrate.instrument_import.columns import Channels, channels_of, explain_missing
from calibrate.instrument_import.measured import (
    Units,
    is_degree,
    load_of_name,
    measured,
    time_in_seconds,
)
from calibrate.instrument_import.preamble import Stated, read_preamble
from calibrate.instrument_import.sizes import Converted, Size, check_counts, converted
from calibrate.instrument_import.steps import are_steps
from calibrate.instrument_import.tables import FEWEST_ROWS, FEWEST_STEPS, Table, tables_in
from calibrate.instrument_import.vocabulary import (
    CONSOLIDATION,
    DISPLACEMENT,
    FORCE,
    VOID_RATIO,
    test_named_in,
)
from calibrate.instrument_import.whose import by_specimen

MINOR = 0.1  # tables with fewer rows than this share of the longest are no recordings
MOST_SPECIMENS = 60


@dataclass(frozen=True)
class Choices:
    """What the user says against or beside the file; None: as the file says.

    `points`: whether rows are load steps rather than points of a curve.
    """

    test: str | None = None
    units: Units = field(default_factory=Units)
    size: Size = field(default_factory=Size)
    points: bool | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """One specimen in file order, arrays of shape (points,); `time_s` is None if not recorded.

    `place` says where in the file it stands; `stated` holds what its preamble says, the user's
    sizes in place; `units_fixed` the kinds of columns whose unit the user insists on; `assumed`
    and `warnings` are sentences.  `load` and `travel` are the kinds of columns that were
    recorded, `points` whether the rows are load steps, `size` what was converted with.
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
    load: str
    travel: str
    points: bool
    size: Converted

    @property
    def is_converted(self) -> bool:
        """Whether anything but force and displacement was recorded."""
        return (self.load, self.travel) != (FORCE, DISPLACEMENT)


@dataclass(frozen=True, eq=False)
class Source:
    """Where one specimen stands: the columns of a table, and a mask of its rows."""

    table: Table
    rows: np.ndarray
    channels: Channels
    label: str


def recordings_in(sheets: list[Sheet], choices: Choices) -> list[Recording]:
    """All specimens of a file; `BadValue` if there is none, or far too many."""
    tables = [table for page in sheets for table in tables_in(page)]
    sources = _sources(tables, FEWEST_ROWS)
    if sources:
        found = _recordings(sources, choices, len(sheets) > 1)
        parts = [part for recording in found for part in _split(recording)]
        _check_number(len(parts))
        if not parts:
            raise _nothing()
        return parts
    few = [table for page in sheets for table in tables_in(page, FEWEST_STEPS, 1)]
    sources = _sources(few, FEWEST_STEPS)
    if not sources:
        raise explain_missing(tables) if tables else _nothing()
    found = [r for r in _recordings(sources, choices, len(sheets) > 1) if r.points]
    if not found:
        problem = f"it holds fewer than {FEWEST_ROWS} rows of load and travel"
        raise BadValue(problem, "export the whole record, or give --test oedometer for load steps")
    return found


def _sources(tables: list[Table], fewest: int) -> list[Source]:
    """All specimens of these tables, without tables that are minor beside the longest."""
    with_channels = [(t, channels) for t in tables if (channels := channels_of(t, fewest))]
    longest = max((len(table.numbers) for table, _ in with_channels), default=0)
    sources = [
        source
        for table, several in with_channels
        if len(table.numbers) >= MINOR * longest
        for source in _sources_of(table, several)
    ]
    _check_number(len(sources))
    return sources


def _sources_of(table: Table, several: list[Channels]) -> Iterator[Source]:
    """The specimens of one table: groups of columns, each taken apart by the column of names."""
    groups = by_specimen(table)
    for channels in several:
        parts = [table.numbers[rows, channels.travel.column] for _, rows in groups]
        if channels.load is None and is_degree(channels.travel, parts):
            degrees = replace(channels.travel, kind=CONSOLIDATION)
            channels = replace(channels, travel=degrees)
        for label, rows in groups:
            yield Source(table, rows, channels, f"{channels.label} {label}".strip())


def _check_number(specimens: int) -> None:
    if specimens > MOST_SPECIMENS:
        problem = f"{specimens} specimens were found in it"
        raise BadValue(problem, f"export at most {MOST_SPECIMENS} in one file")


def _recordings(sources: list[Source], choices: Choices, many_sheets: bool) -> list[Recording]:
    check_counts(choices.size, len(sources))
    return [_recording(source, choices, place, many_sheets) for place, source in enumerate(sources)]


def _nothing() -> BadValue:
    return BadValue(
        f"it holds no table of at least {FEWEST_ROWS} recorded points, only text or results",
        "export the recorded points (time, force, extension) as .csv, .txt or .xlsx",
    )


def _recording(source: Source, choices: Choices, place: int, many_sheets: bool) -> Recording:
    """The specimen in these columns, rows with a missing value left out."""
    table, channels, own = source.table, source.channels, source.rows
    stated, size_notes = choices.size.over(read_preamble([*table.preamble]))
    travel, travel_note = measured(table, channels.travel, choices.units)
    travel = travel.of(own)
    if channels.load is None:
        load, load_note = load_of_name(source.label, travel, choices.units)
    else:
        load, load_note = measured(table, channels.load, choices.units)
        load = load.of(own)
    time, time_note = time_in_seconds(table, channels.time, choices.units)
    time = None if time is None else time[own]
    rows = np.isfinite(load.values) & np.isfinite(travel.values)
    if time is not None and rows.any() and np.isfinite(time[rows]).mean() < 0.9:
        time = None
    if time is not None:
        rows &= np.isfinite(time)
    named = test_named_in(f"{table.sheet.name} {source.label}") or stated.test
    warnings = _missing(rows, load.values, travel.values)
    load, travel = load.of(rows), travel.of(rows)
    points = are_steps(load, travel, choices.test or named, choices.points)
    size = converted(load, travel, stated, choices.size, place)
    page = f"sheet {shown(table.sheet.name, 30)}, " if many_sheets else ""
    notes = (load_note, travel_note, time_note, _passed_over(channels), *size_notes)
    recording = Recording(
        label=source.label or stated.label or (table.sheet.name if many_sheets else ""),
        place=f"{page}rows from {table.line + int(np.argmax(own))}, {_columns_in_words(channels)}",
        time_s=None if time is None else time[rows],
        displacement_mm=size.displacement_mm,
        force_n=size.force_n,
        stated=replace(stated, test=named),
        units_fixed=choices.units.fixed(),
        assumed=tuple(note for note in notes if note) + stated.assumed + size.sentences,
        warnings=warnings,
        load=load.kind,
        travel=travel.kind,
        points=points,
        size=size,
    )
    return _pressed(recording) if points else _compressive(recording)


def _columns_in_words(channels: Channels) -> str:
    several = (channels.time, channels.travel, channels.load)
    return ", ".join(f"{c.kind} {shown(c.heading.words(), 40)}" for c in several if c is not None)


def _passed_over(channels: Channels) -> str:
    """Which column was taken where several could have been."""
    if not channels.passed_over:
        return ""
    others = ", ".join(shown(c.heading.words(), 30) for c in channels.passed_over[:4])
    return f"columns of {_columns_in_words(channels)} are used, not {others}"


def _missing(rows: np.ndarray, force, travel) -> tuple[str, ...]:
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


def _pressed(recording: Recording) -> Recording:
    """Load steps turned so that compression is positive; a void ratio has its sign."""
    force, travel, notes = recording.force_n, recording.displacement_mm, []
    if np.median(force) < 0:
        force = -force
        notes.append("compressive load is negative in the file: its sign was turned")
    if recording.travel != VOID_RATIO and travel[int(np.argmax(force))] < travel[0]:
        travel = -travel
        notes.append("travel falls while the load rises: its sign was turned")
    assumed = recording.assumed + tuple(notes)
    return replace(recording, force_n=force, displacement_mm=travel, assumed=assumed)


def _split(recording: Recording) -> Iterator[Recording]:
    """The parts of a record whose time starts again; short parts are no specimens."""
    if recording.points:
        yield recording
        return
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
