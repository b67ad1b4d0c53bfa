"""Which columns of a table are time, force and displacement, and of which specimen.

One table may hold several specimens side by side: then the kinds of columns repeat, in
groups (t F s  t F s), or beside one shared column (s  F F F).
"""

import re
from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.tables import FEWEST_ROWS, Heading, Table
from calibrate.instrument_import.vocabulary import (
    DISPLACEMENT,
    FORCE,
    OTHER,
    STRAIN,
    STRESS,
    TIME,
    kind_of,
)

_NAMED_BY_UNIT = {  # what a name may mean once its unit is known
    (STRAIN, DISPLACEMENT): DISPLACEMENT,
    (DISPLACEMENT, STRAIN): STRAIN,
    (FORCE, STRESS): STRESS,
    (STRESS, FORCE): FORCE,
}


@dataclass(frozen=True, eq=False)
class Channel:
    """One column of a table: its kind, its rank among its kind, its heading and place."""

    kind: str
    rank: int
    heading: Heading
    column: int


@dataclass(frozen=True, eq=False)
class Channels:
    """The columns of one specimen; `label` is what the file calls it, "" if nothing."""

    time: Channel | None
    force: Channel
    displacement: Channel
    label: str
    passed_over: tuple[Channel, ...]  # further columns of force or displacement


def channels_of(table: Table) -> list[Channels]:
    """The specimens of a table; none if it holds no force or no displacement."""
    found = [
        channel
        for column, heading in enumerate(table.headings)
        if np.isfinite(table.numbers[:, column]).sum() >= FEWEST_ROWS
        and (channel := _channel(heading, column)) is not None
    ]
    of_kind = {kind: [c for c in found if c.kind == kind] for kind in (TIME, FORCE, DISPLACEMENT)}
    forces, travels = of_kind[FORCE], of_kind[DISPLACEMENT]
    if not forces or not travels:
        return []
    if len(forces) > 1 and len(forces) == len(travels) and _repeats(forces, table):
        return _side_by_side(of_kind)
    if len(forces) > 1 and len(travels) == 1 and _repeats(forces, table):
        return [_chosen(of_kind[TIME], [force], travels) for force in forces]
    return [_chosen(of_kind[TIME], forces, travels)]


def explain_missing(tables: list[Table]) -> BadValue:
    """Why no table could be used: which of force and displacement was not found, and where."""
    headings = [h for table in tables for h in table.headings if h.name or h.unit]
    if not headings:
        problem = "its columns of numbers have no names"
        return BadValue(problem, "put a line such as time_s;force_N;displacement_mm above them")
    kinds = {c.kind for h in headings if (c := _channel(h, 0)) is not None}
    missing = [kind for kind in (FORCE, DISPLACEMENT) if kind not in kinds] or ["curve"]
    names = ", ".join(dict.fromkeys(shown(h.words(), 30) for h in headings[:8]))
    problem = f"no column of {' or '.join(missing)} was found among {names}"
    if STRAIN in kinds or STRESS in kinds:
        problem += " (stress and strain are not enough)"
    return BadValue(problem, 'export the recorded points with columns "Force (N)", "Travel (mm)"')


def _channel(heading: Heading, column: int) -> Channel | None:
    """What the column holds by name and unit; None if neither says so."""
    kind, rank = kind_of(heading.name) if heading.name else (None, 0)
    unit_kind = heading.unit[0] if heading.unit else None
    if kind is None:
        kind, rank = unit_kind, 50
    elif unit_kind is not None and unit_kind != kind:
        if kind == OTHER:
            return None
        known = _NAMED_BY_UNIT.get((kind, unit_kind))
        if known is None:
            problem = f"the unit of column {shown(heading.words(), 40)} is not one of {kind}"
            raise BadValue(problem, "correct the name or the unit in the heading")
        kind, rank = known, rank + 20
    return None if kind in (None, OTHER) else Channel(kind, rank, heading, column)


def _repeats(channels: list[Channel], table: Table) -> bool:
    """Whether these columns are one quantity of several specimens, not several quantities:
    same name but for a number, same unit, and not one in multiples of another."""
    names = {_without_number(c.heading.name) for c in channels}
    units = {c.heading.unit for c in channels}
    return len(names) == 1 and len(units) == 1 and not _proportional(channels, table)


def _without_number(name: str) -> str:
    return re.sub(r"[\s_.#-]*\d+$|\([a-z0-9]\)$", "", name.strip().casefold())


def _proportional(channels: list[Channel], table: Table) -> bool:
    one, other = (table.numbers[:, c.column] for c in channels[:2])
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < FEWEST_ROWS or not np.any(one[both]):
        return False
    factor = (one[both] @ other[both]) / (one[both] @ one[both])
    return bool(np.abs(other[both] - factor * one[both]).max() <= 1e-6 * np.abs(other[both]).max())


def _side_by_side(of_kind: dict[str, list[Channel]]) -> list[Channels]:
    """Groups in the order of the columns; time columns one each, or the nearest on the left."""
    groups = []
    for force, travel in zip(of_kind[FORCE], of_kind[DISPLACEMENT], strict=True):
        left = [c for c in of_kind[TIME] if c.column <= max(force.column, travel.column)]
        groups.append(_chosen(left[-1:], [force], [travel]))
    return groups


def _chosen(times: list[Channel], forces: list[Channel], travels: list[Channel]) -> Channels:
    """The best ranked column of each kind."""
    force = min(forces, key=lambda c: c.rank)
    travel = min(travels, key=lambda c: c.rank)
    time = min(times, key=lambda c: c.rank, default=None)
    others = tuple(c for c in (*forces, *travels) if c not in (force, travel))
    return Channels(time, force, travel, force.heading.label or _number_in(force), others)


def _number_in(force: Channel) -> str:
    found = re.search(r"\d+$", force.heading.name.strip())
    return f"specimen {found[0]}" if found else ""
