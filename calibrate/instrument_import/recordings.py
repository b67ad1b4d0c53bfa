"""One specimen's record as the machine wrote it: time (s), displacement (mm), force (N).

Stated units are converted; missing ones are taken as N, kPa, mm and s and said so.  Stress,
strain and void ratio are converted with the specimen's size (`sizes`).  Compression is turned
to be positive.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.cells import Sheet
from calibrate.instrument_import.columns import (
    BY_UNIT,
    Channels,
    channels_of,
    explain_missing,
    further_kinds,
    recorded_channels,
)
from calibrate.instrument_import.measured import (
    Units,
    is_degree,
    load_of_name,
    measured,
    time_in_seconds,
)
from calibrate.instrument_import.other_tests import refuse, signs_of_other_tests
from calibrate.instrument_import.preamble import Stated, read_preamble
from calibrate.instrument_import.sizes import Column, Converted, Size, check_counts, converted
from calibrate.instrument_import.specimen_rows import (
    Rows,
    are_only_numbered,
    by_specimen,
    clock_restarts,
)
from calibrate.instrument_import.steps import are_steps
from calibrate.instrument_import.tables import FEWEST_ROWS, FEWEST_STEPS, Table, tables_in
from calibrate.instrument_import.tools import Place, Tool, tool_of
from calibrate.instrument_import.vocabulary import RECORDED, Kinds, Quantity, test_named_in
from calibrate.labtests.measured import AbstractMachineRecord

MINOR = 0.1  # tables with fewer rows than this share of the longest are no recordings
MOST_SPECIMENS = 60
FEW = 0.03  # of the rows; more that are left out are a warning


@dataclass(frozen=True)
class Choices:
    """What the user says against or beside the file; None: as the file says.

    `points`: whether rows are load steps rather than points of a curve.
    """

    test: str | None = None
    units: Units = field(default_factory=Units)
    size: Size = field(default_factory=Size)
    points: bool | None = None

    @property
    def record(self) -> AbstractMachineRecord | None:
        """What the machine of the test writes, where that is more than force and displacement."""
        return RECORDED.get(self.test or "")

    @property
    def kinds(self) -> Kinds:
        """The kinds of columns beyond the usual ones."""
        return further_kinds(self.record)

    def channels(self, table: Table, fewest: int) -> list[Channels]:
        """The specimens of a table."""
        if self.record is None:
            return channels_of(table, fewest)
        return recorded_channels(table, self.record)


@dataclass(frozen=True, eq=False)
class Recording:
    """One specimen in file order, arrays of shape (points,); `time_s` is None if not recorded.

    `place` says where in the file it stands; `stated` holds what its preamble says, the user's
    sizes in place; `units_assumed` the kinds of columns whose unit nobody wrote; `assumed` and
    `warnings` are sentences.  `load` and `travel` are the kinds of columns that were
    recorded, `points` whether the rows are load steps, `size` what was converted with, `tool` the
    test with a tool that it is of.
    """

    label: str
    place: str
    time_s: np.ndarray | None
    displacement_mm: np.ndarray
    force_n: np.ndarray
    stated: Stated
    units_assumed: frozenset[Quantity]
    assumed: tuple[str, ...]
    warnings: tuple[str, ...]
    load: Quantity
    travel: Quantity
    points: bool
    size: Converted
    tool: Tool | None = None

    def of(self, rows: np.ndarray | slice) -> "Recording":
        """These rows of it."""
        time = None if self.time_s is None else self.time_s[rows]
        force, travel = self.force_n[rows], self.displacement_mm[rows]
        return replace(self, time_s=time, force_n=force, displacement_mm=travel)

    @property
    def is_converted(self) -> bool:
        """Whether anything but force and displacement was recorded."""
        return (self.load, self.travel) != (Quantity.FORCE, Quantity.DISPLACEMENT)


@dataclass(frozen=True, eq=False)
class Source:
    """Where one specimen stands: the columns of a table, and a mask of its rows."""

    table: Table
    rows: np.ndarray
    channels: Channels
    label: str
    notes: tuple[str, ...] = ()


def recordings_in(sheets: list[Sheet], choices: Choices) -> list[Recording]:
    """All specimens of a file; `BadValue` if there is none, or far too many."""
    tables = [table for page in sheets for table in tables_in(page, kinds=choices.kinds)]
    sources = _sources(tables, FEWEST_ROWS, choices)
    if sources:
        return _recordings(sources, choices, len(sheets) > 1)
    if choices.record is not None and tables:
        raise explain_missing(tables, choices.record)
    few = [table for page in sheets for table in tables_in(page, FEWEST_STEPS, 1)]
    sources = _sources(few, FEWEST_STEPS, choices)
    if not sources:
        if tables:
            raise explain_missing(tables)
        raise BadValue(
            f"it holds no table of at least {FEWEST_ROWS} recorded points, only text or results",
            "export the recorded points (time, force, extension) as .csv, .txt or .xlsx",
        )
    found = [r for r in _recordings(sources, choices, len(sheets) > 1) if r.points]
    if not found:
        problem = f"it holds fewer than {FEWEST_ROWS} rows of load and travel"
        raise BadValue(problem, "export the whole record, or give --test oedometer for load steps")
    return found


def _sources(tables: list[Table], fewest: int, choices: Choices) -> list[Source]:
    """All specimens of these tables, without tables that are minor beside the longest."""
    with_channels = [(t, channels) for t in tables if (channels := choices.channels(t, fewest))]
    longest = max((len(table.numbers) for table, _ in with_channels), default=0)
    sources = [
        source
        for table, several in with_channels
        if len(table.numbers) >= MINOR * longest
        for source in _sources_of(table, several, choices)
    ]
    if len(sources) > MOST_SPECIMENS:
        problem = f"{len(sources)} specimens were found in it"
        raise BadValue(problem, f"export at most {MOST_SPECIMENS} in one file")
    notes = []
    unused = [t for t in tables if t not in [table for table, _ in with_channels]]
    if unused:
        names = dict.fromkeys(f"{t.sheet.name} from line {t.line}" for t in unused)
        text = f"{len(unused)} table(s) without load and travel were passed over"
        notes.append(f"{text} ({', '.join(shown(name, 30) for name in [*names][:4])})")
    minor = [t for t, _ in with_channels if len(t.numbers) < MINOR * longest]
    if minor:
        rows = ", ".join(f"{len(t.numbers)} rows from line {t.line}" for t in minor[:4])
        notes.append(f"{len(minor)} short table(s) beside the record were left out ({rows})")
    if sources:
        sources[0] = replace(sources[0], notes=(*sources[0].notes, *notes))
    return sources


def _sources_of(table: Table, several: list[Channels], choices: Choices) -> Iterator[Source]:
    """The specimens of one table: groups of columns, each taken apart by the column of names, and
    where travel or clock start again."""
    groups = by_specimen(table)
    for channels in several:
        parts = [table.numbers[rows, channels.travel.column] for _, rows in groups]
        if channels.load is None and is_degree(channels.travel, parts):
            degrees = replace(channels.travel, kind=Quantity.CONSOLIDATION)
            channels = replace(channels, travel=degrees)
        named = groups
        if len(groups) > 1 and are_only_numbered(table) and _is_one(table, channels, groups):
            named = [("", np.ones(len(table.numbers), bool))]
        for label, rows in named:
            whole = Source(table, rows, channels, f"{channels.label} {label}".strip())
            yield from _parts(whole, choices)


def _rows_of(table: Table, channels: Channels, rows: np.ndarray) -> tuple[np.ndarray, Rows | None]:
    """Which rows of the table hold load and travel, and what these are; None for too few."""
    if channels.load is None:
        return np.flatnonzero(rows), None
    load, travel = (table.numbers[:, c.column] for c in (channels.load, channels.travel))
    time = None if channels.time is None else table.numbers[:, channels.time.column]
    held = np.flatnonzero(rows & np.isfinite(load) & np.isfinite(travel))
    if len(held) < 2:
        return held, None
    if time is not None:
        time = time[held] if np.isfinite(time[held]).all() else None
    blocks = [int(np.searchsorted(held, block)) for block in table.blocks]
    sign = -1.0 if channels.travel.kind == Quantity.VOID_RATIO else 1.0
    inside = tuple(block for block in blocks if 0 < block < len(held))
    return held, Rows.of(time, load[held], sign * travel[held], inside)


def _is_one(table: Table, channels: Channels, groups: list[tuple[str, np.ndarray]]) -> bool:
    """Whether groups that are only numbered go on from each other: pages of one record."""
    held, whole = _rows_of(table, channels, np.ones(len(table.numbers), bool))
    if whole is None:
        return False
    number = np.argmax([rows[held] for _, rows in groups], axis=0)
    edges = np.flatnonzero(np.diff(number)) + 1
    return len(edges) == len(groups) - 1 and all(whole.goes_on(int(row)) for row in edges)


def _parts(source: Source, choices: Choices) -> Iterator[Source]:
    """The specimens below each other in these rows, each with its rows."""
    table, channels = source.table, source.channels
    held, rows = _rows_of(table, channels, source.rows)
    if rows is None or channels.load is None:
        yield source
        return
    named = choices.test or test_named_in(f"{table.sheet.name} {source.label}")
    named = named or read_preamble(table.preamble).test
    load = Column(channels.load.kind, "", rows.load)
    travel = Column(channels.travel.kind, "", rows.travel)
    starts = rows.starts(are_steps(load, travel, named, choices.points))
    if not starts:
        yield source
        return
    edges = [0, *(int(held[row]) for row in starts), len(source.rows)]
    places = np.arange(len(source.rows))
    for number, (first, last) in enumerate(pairwise(edges), start=1):
        text = f"travel or clock start again in {len(starts)} row(s): {len(edges) - 1} specimens"
        own = source.rows & (places >= first) & (places < last)
        label = f"{source.label} part {number}" if source.label else f"specimen {number}"
        yield replace(source, rows=own, label=label, notes=(*source.notes, text))


def _recordings(sources: list[Source], choices: Choices, many_sheets: bool) -> list[Recording]:
    check_counts(choices.size, len(sources))
    return [_recording(source, choices, place, many_sheets) for place, source in enumerate(sources)]


def _recording(source: Source, choices: Choices, place: int, many_sheets: bool) -> Recording:
    """The specimen in these columns, rows with a missing value left out."""
    table, channels, own = source.table, source.channels, source.rows
    above = [*table.preamble] if choices.record is None else table.above
    stated, size_notes = choices.size.over(read_preamble(above))
    if choices.record is not None and not choices.record.own_bed:
        stated, size_notes = Stated(label=stated.label), ()  # sizes above may be the tool's
    travel, travel_note = measured(table, channels.travel, choices.units)
    travel = travel.of(own)
    if channels.load is None:
        load, load_note = load_of_name(source.label, travel, choices.units)
    else:
        load, load_note = measured(table, channels.load, choices.units)
        load = load.of(own)
    time, time_note = time_in_seconds(table, channels.time, choices.units)
    time = None if time is None else time[own]
    clock_note = ""
    if time is not None and clock_restarts(time[np.isfinite(time)]):
        clock_note = "the clock starts again within the record: times are left out"
        time = None
    rows = np.isfinite(load.values) & np.isfinite(travel.values)
    if time is not None and rows.any() and np.isfinite(time[rows]).mean() < 0.9:
        time = None
    if time is not None:
        rows &= np.isfinite(time)
    named = test_named_in(f"{table.sheet.name} {source.label}") or stated.test
    warnings = _missing(rows, load.values, travel.values) + _lost(table)
    load, travel = load.of(rows), travel.of(rows)
    tool = _tool(source, choices, stated, rows, place)
    if tool is None:
        points = are_steps(load, travel, choices.test or named, choices.points)
        signs = signs_of_other_tests(table, own, source.label, points)
        warnings += refuse(signs, choices.test is not None, named)
        size = converted(load, travel, stated, choices.size, place)
    else:
        points, size = False, tool.converted(load, travel)
        warnings += tool.warnings
    page = f"sheet {shown(table.sheet.name, 30)}, " if many_sheets else ""
    notes = (load_note, travel_note, time_note, clock_note, _passed_over(channels))
    warnings += _by_unit(channels)
    notes = (*notes, *source.notes, *size_notes, *(tool.notes if tool is not None else ()))
    recording = Recording(
        label=source.label or stated.label or (table.sheet.name if many_sheets else ""),
        place=f"{page}rows from {table.line + int(np.argmax(own))}, {_columns_in_words(channels)}",
        time_s=None if time is None else time[rows],
        displacement_mm=size.displacement_mm,
        force_n=size.force_n,
        stated=replace(stated, test=named),
        units_assumed=choices.units.assumed_of(channels.load, channels.travel),
        assumed=tuple(note for note in notes if note) + stated.assumed + size.sentences,
        warnings=warnings,
        load=load.kind,
        travel=travel.kind,
        points=points,
        size=size,
        tool=tool,
    )
    return _turned(recording)


def _tool(
    source: Source, choices: Choices, stated: Stated, rows: np.ndarray, number: int
) -> Tool | None:
    """The test with a tool that the source is of, None for another test; `rows` of its own are
    complete."""
    if choices.record is None or choices.test is None:
        return None
    table, condition = source.table, None
    if source.channels.condition is not None:
        condition, _ = measured(table, source.channels.condition, choices.units)
        condition = condition.of(source.rows).of(rows)
    names = (source.label, stated.label, table.sheet.name)
    place = Place(table.preamble, table.above, stated, names, number)
    return tool_of(choices.test, choices.size, place, condition)


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


def _lost(table: Table) -> tuple[str, ...]:
    """A warning about lines among the rows that hold no numbers, if they are more than a few."""
    share = table.lost / (table.lost + len(table.numbers))
    text = f"{table.lost} lines among the rows hold no numbers and were left out"
    return (f"{text} ({100 * share:.0f} %)",) if share > FEW else ()


def _by_unit(channels: Channels) -> tuple[str, ...]:
    """A warning about columns that only their unit tells."""
    used = (c for c in (channels.time, channels.load, channels.travel) if c is not None)
    told = [f"{shown(c.heading.words(), 30)} is {c.kind}" for c in used if c.rank >= BY_UNIT]
    text = "the name is not known, so its unit alone says that"
    return (f"{text} {', '.join(told)}",) if told else ()


def _turned(recording: Recording) -> Recording:
    """Force and displacement turned so that compression is positive; of load steps a void ratio
    has its sign."""
    force, travel, notes = recording.force_n, recording.displacement_mm, []
    if len(force) < (1 if recording.points else FEWEST_ROWS):
        return recording
    top = int(np.argmax(np.abs(force - force[0])))
    if (np.median(force) < 0) if recording.points else (force[top] < force[0]):
        force = -force
        what = "compressive load" if recording.points else "compressive force"
        what = what if recording.tool is None else recording.load
        notes.append(f"{what} is negative in the file: its sign was turned")
    top = int(np.argmax(force)) if recording.points else top
    has_sign = recording.points and recording.travel == Quantity.VOID_RATIO
    if travel[top] < travel[0] and not has_sign:
        travel = -travel
        steps, curve = "travel falls while the load", "displacement falls while the force"
        moves = steps if recording.points else curve
        if recording.tool is not None:
            moves = f"{recording.travel} falls while the {recording.load}"
        notes.append(f"{moves} rises: its sign was turned")
    assumed = recording.assumed + tuple(notes)
    return replace(recording, force_n=force, displacement_mm=travel, assumed=assumed)
