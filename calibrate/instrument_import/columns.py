"""Which columns of a table are time, load and travel, and of which specimen.

A load is a force or a stress; a travel is a displacement, a strain, a void ratio or a degree
of consolidation.  One table may hold several specimens side by side: then the kinds of columns
repeat, in groups (t F s  t F s), or beside one shared column (s  F F F,  sigma  e e e).  Of a test
with a tool, its `AbstractMachineRecord` says which kinds are load and travel.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.headings import Heading, meant
from calibrate.instrument_import.tables import FEWEST_ROWS, Table
from calibrate.instrument_import.vocabulary import WORDS, Kinds, Quantity, kind_of
from calibrate.labtests.measured import AbstractMachineRecord, MachineColumn

LOADS = (Quantity.FORCE, Quantity.STRESS)  # the first that a table holds is taken
TRAVELS = (Quantity.DISPLACEMENT, Quantity.STRAIN, Quantity.VOID_RATIO, Quantity.CONSOLIDATION)
TRAVELS_OF_STRESS = (
    Quantity.STRAIN,
    Quantity.DISPLACEMENT,
    Quantity.VOID_RATIO,
    Quantity.CONSOLIDATION,
)
TIMES = (Quantity.TIME, Quantity.ROOT_TIME)
BY_UNIT = 50  # rank of a column of which only the unit says what it holds
STRENGTHS = (Quantity.STRENGTH, Quantity.SHEAR_STRENGTH)

_EXAMPLES = {
    Quantity.FORCE: "Force (N)",
    Quantity.DISPLACEMENT: "Travel (mm)",
    Quantity.TORQUE: "Torque (N m)",
    Quantity.ANGLE: "Angle (deg)",
    Quantity.DEPTH: "Depth (mm)",
    Quantity.SHEAR_FORCE: "Shear force (N)",
    Quantity.SHEAR_DISPLACEMENT: "Shear displacement (mm)",
}
_BY_UNIT_ELSE = (Quantity.VOID_RATIO, Quantity.ROOT_TIME, *STRENGTHS)  # "E (MPa)" is no void ratio

# How the name of a column ends with its specimen: "Force 2"; "e M1", "e (A)".
_NUMBER = re.compile(r"[\s_.#-]*\d+$|\([a-z0-9]\)$")
_LABEL = re.compile(r"[\s_]*\(\w{1,12}\)$|[\s_]+[a-z]{0,3}\d+$|\d+$")


@dataclass(frozen=True, eq=False)
class Channel:
    """One column of a table: its kind, its rank among its kind, its heading and place."""

    kind: Quantity
    rank: int
    heading: Heading
    column: int


@dataclass(frozen=True, eq=False)
class Channels:
    """The columns of one specimen; `label` is what the file calls it, "" if nothing.

    `load` is None where the table holds travel over time under a load that is named elsewhere.
    """

    time: Channel | None
    load: Channel | None
    travel: Channel
    label: str
    passed_over: tuple[Channel, ...]  # further columns of load or travel
    condition: Channel | None = None  # what the specimen was tested under


def channels_in(table: Table, fewest: int, kinds: Kinds = ()) -> list[Channel]:
    """The columns that hold at least `fewest` numbers and something known."""
    return [
        channel
        for column, heading in enumerate(table.headings)
        if np.isfinite(table.numbers[:, column]).sum() >= fewest
        and (channel := _channel(heading, column, kinds)) is not None
    ]


def further_kinds(record: AbstractMachineRecord | None) -> Kinds:
    """The kinds of columns beyond the usual ones that a test's machine writes."""
    kinds = map(Quantity, record.kinds if record is not None else ())
    return tuple(kind for kind in kinds if kind in WORDS.tools.columns)


def recorded_channels(table: Table, record: AbstractMachineRecord) -> list[Channels]:
    """The specimens of a table of a test with a tool; none if it lacks load or travel."""
    found = channels_in(table, FEWEST_ROWS, further_kinds(record))
    loads, travels = (_first_of(_kinds(each), found) for each in (record.loads, record.travels))
    if not (loads and travels):
        return []
    several = _several(_first_of(TIMES, found), loads, travels, table)
    conditions = _first_of(_kinds(record.conditions), found)
    if len(conditions) != len(several):
        conditions = sorted(conditions, key=_preference)[:1] * len(several)
    if not conditions:
        return several
    return [replace(a, condition=c) for a, c in zip(several, conditions, strict=True)]


def _kinds(columns: Iterable[MachineColumn]) -> Kinds:
    return tuple(Quantity(column.kind) for column in columns)


def channels_of(table: Table, fewest: int = FEWEST_ROWS) -> list[Channels]:
    """The specimens of a table; none if it holds no load (and no time) or no travel."""
    found = channels_in(table, fewest)
    loads, times = _first_of(LOADS, found), _first_of(TIMES, found)
    by_stress = bool(loads) and loads[0].kind == Quantity.STRESS
    travels = _first_of(TRAVELS_OF_STRESS if by_stress else TRAVELS, found)
    if not travels or not (loads or times):
        return []
    if not loads:
        known = travels[0].kind != Quantity.DISPLACEMENT and not _first_of(STRENGTHS, found)
        return [Channels(times[0], None, travels[0], "", tuple(travels[1:]))] if known else []
    several = len(travels) > 1 and travels[0].kind != Quantity.DISPLACEMENT
    if len(loads) == 1 and several and _repeats(travels, table, _LABEL):
        return [_chosen(times, loads, [travel], named_by=travel) for travel in travels]
    return _several(times, loads, travels, table)


def _several(
    times: list[Channel], loads: list[Channel], travels: list[Channel], table: Table
) -> list[Channels]:
    """Specimens side by side, or loads over one travel, or the one specimen that there is."""
    if len(loads) > 1 and len(loads) == len(travels) and _repeats(loads, table):
        return _side_by_side(times, loads, travels)
    if len(loads) > 1 and len(travels) == 1 and _repeats(loads, table):
        return [_chosen(times, [load], travels) for load in loads]
    return [_chosen(times, loads, travels)]


def _first_of(kinds: tuple[Quantity, ...], channels: list[Channel]) -> list[Channel]:
    """The channels of the first of these kinds that there is."""
    of_kind = ([c for c in channels if c.kind == kind] for kind in kinds)
    return next((some for some in of_kind if some), [])


def explain_missing(tables: list[Table], record: AbstractMachineRecord | None = None) -> BadValue:
    """Why no table could be used: which of load and travel was not found, and where."""
    headings = [h for table in tables for h in table.headings if h.name or h.unit]
    wanted = ((Quantity.FORCE, LOADS), (Quantity.DISPLACEMENT, TRAVELS))
    if record is not None:
        ways = [_kinds(columns) for columns in (record.loads, record.travels)]
        wanted = tuple((kinds[0], kinds) for kinds in ways)
    examples = [_EXAMPLES[kind] for kind, _ in wanted]
    if not headings:
        problem = "its columns of numbers have no names"
        above = [cell.strip() for table in tables for row in table.preamble[-1:] for cell in row]
        if sum(bool(cell) for cell in above) > 1:
            names = ", ".join(shown(cell, 20) for cell in above[:8] if cell)
            problem = f"its columns of numbers have no names that are understood ({names})"
        line = "time_s;force_N;displacement_mm" if record is None else ";".join(examples)
        return BadValue(problem, f"put a line such as {line} above them")
    further = further_kinds(record)
    kinds = {c.kind for h in headings if (c := _channel(h, 0, further)) is not None}
    missing = [kind for kind, ways in wanted if not kinds.intersection(ways)] or ["curve"]
    names = ", ".join(dict.fromkeys(shown(h.words(), 30) for h in headings[:8]))
    problem = f"no column of {' or '.join(missing)} was found among {names}"
    if len(missing) == 1:
        problem += _serves(missing[0], record)
    columns = ", ".join(f'"{example}"' for example in examples)
    return BadValue(problem, f"export the recorded points with columns {columns}")


def _serves(missing: Quantity | str, record: AbstractMachineRecord | None) -> str:
    """What a file may hold in the place of the column that is missing."""
    words = {Quantity.FORCE: "a stress", Quantity.DISPLACEMENT: "a strain or a void ratio"}
    if record is not None:
        ways = [_kinds(columns) for columns in (record.loads, record.travels)]
        words = {kinds[0]: " or ".join(f"a {kind}" for kind in kinds[1:]) for kinds in ways}
    others = words.get(Quantity(missing), "") if missing != "curve" else ""
    return f" ({others} serves too)" if others else ""


def _channel(heading: Heading, column: int, kinds: Kinds = ()) -> Channel | None:
    """What the column holds by name and unit; None if neither says so."""
    kind, rank = kind_of(heading.name, kinds) if heading.name else (None, 0)
    unit_kind = heading.unit.kind if heading.unit else None
    if kind is None:
        kind, rank = (unit_kind if _tells(heading) else None), BY_UNIT
    elif unit_kind is not None and unit_kind != kind:
        if kind == Quantity.OTHER:
            return None
        known = meant(kind, unit_kind)
        if known is None and kind in _BY_UNIT_ELSE:
            return None
        if known is None:
            problem = f"the unit of column {shown(heading.words(), 40)} is not one of {kind}"
            raise BadValue(problem, "correct the name or the unit in the heading")
        same = kind in kinds and known == kind  # "Depth (mm)" is not less sure than "Depth"
        kind, rank = known, rank + (0 if same else 20)
    if kind is None or kind == Quantity.OTHER:
        return None
    return Channel(kind, rank, heading, column)


def _tells(heading: Heading) -> bool:
    """Whether a unit says what a column of an unknown name holds: a mass may be a specimen's, and
    a share may be of anything."""
    unit = heading.unit
    return (
        unit is not None
        and not unit.by_weight
        and (unit.kind != Quantity.STRAIN or not heading.name)
    )


def _repeats(channels: list[Channel], table: Table, ending: re.Pattern = _NUMBER) -> bool:
    """Whether these columns are one quantity of several specimens, not several quantities:
    same name but for a number, same unit, and not one in multiples of another."""
    names = {ending.sub("", c.heading.name.strip().casefold()) for c in channels}
    units = {(c.heading.unit, c.heading.not_understood) for c in channels}
    return len(names) == 1 and len(units) == 1 and not _proportional(channels, table)


def _proportional(channels: list[Channel], table: Table) -> bool:
    one, other = (table.numbers[:, c.column] for c in channels[:2])
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < FEWEST_ROWS or not np.any(one[both]):
        return False
    factor = (one[both] @ other[both]) / (one[both] @ one[both])
    return bool(np.abs(other[both] - factor * one[both]).max() <= 1e-6 * np.abs(other[both]).max())


def _side_by_side(
    times: list[Channel], loads: list[Channel], travels: list[Channel]
) -> list[Channels]:
    """Groups in the order of the columns; time columns one each, or the nearest on the left."""
    groups = []
    for load, travel in zip(loads, travels, strict=True):
        left = [c for c in times if c.column <= max(load.column, travel.column)]
        groups.append(_chosen(left[-1:], [load], [travel]))
    return groups


def _chosen(
    times: list[Channel],
    loads: list[Channel],
    travels: list[Channel],
    named_by: Channel | None = None,
) -> Channels:
    """The best ranked column of each kind; the specimen is named by its load unless said."""
    load, travel = min(loads, key=_preference), min(travels, key=_preference)
    time = min(times, key=_preference, default=None)
    others = tuple(c for c in (*loads, *travels) if c not in (load, travel))
    naming = named_by or load
    return Channels(time, load, travel, naming.heading.label or _number_in(naming), others)


def _preference(channel: Channel) -> tuple[bool, int]:
    """Columns whose unit is understood first, then by rank."""
    return bool(channel.heading.not_understood), channel.rank


def _number_in(channel: Channel) -> str:
    """What the name of a column says of its specimen: "Force 2", "e M1", "void ratio (B)"."""
    name = channel.heading.name.strip()
    named = re.search(r"\(([A-Za-z]?\d{1,3}|[A-Z])\)$|[\s_]([A-Za-z]{1,3}\d+)$", name)
    if named and channel.kind not in LOADS:
        return named[1] or named[2]
    found = re.search(r"\d+$", name)
    return f"specimen {found[0]}" if found else ""
