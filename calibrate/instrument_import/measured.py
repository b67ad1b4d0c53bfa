"""One column in the unit that is kept: N, kPa or N m, mm, rad or a fraction, s.

Units come from the command line, else from the heading; without one the usual unit is assumed
and said.  Time may be written as its root: t = (sqrt t)^2.
"""

import re
from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.columns import Channel
from calibrate.instrument_import.headings import refused_unit, unit_option
from calibrate.instrument_import.sizes import Column
from calibrate.instrument_import.tables import Table
from calibrate.instrument_import.unittext import GRAVITY, Unit
from calibrate.instrument_import.vocabulary import Quantity

_USUAL = {
    Quantity.FORCE: Unit(Quantity.FORCE, "N", 1.0),
    Quantity.DISPLACEMENT: Unit(Quantity.DISPLACEMENT, "mm", 1.0),
    Quantity.STRESS: Unit(Quantity.STRESS, "kPa", 1.0),
    Quantity.TIME: Unit(Quantity.TIME, "s", 1.0),
    Quantity.ANGLE: Unit(Quantity.ANGLE, "degrees", np.pi / 180),
}
_USUAL_OF_ROOT = Unit(Quantity.TIME, "min", 60.0)
_WHOLE = 1e-6  # a degree of consolidation ends at 1 (or 100 %) within this
_STEP = re.compile(
    r"(\d+(?:\.\d+)?)\s*(?:-|–|→|->|to|bis|a|à)\s*(\d+(?:\.\d+)?)(?!\d)", re.IGNORECASE
)


@dataclass(frozen=True)
class Units:
    """Units that the user insists on; None: as the file says."""

    force: Unit | None = None
    displacement: Unit | None = None
    stress: Unit | None = None
    strain: Unit | None = None
    time: Unit | None = None

    def of(self, kind: Quantity) -> Unit | None:
        """The unit that the user gave for a column of this kind."""
        return getattr(self, kind.option, None)

    def assumed_of(self, *channels: Channel | None) -> frozenset[Quantity]:
        """The kinds of these columns whose unit neither the user nor the file gives."""
        used = (c for c in channels if c is not None and c.heading.unit is None)
        return frozenset(c.kind for c in used if self.of(c.kind) is None)


def measured(table: Table, channel: Channel, units: Units) -> tuple[Column, str]:
    """A column in its kept unit, and what was assumed about its unit, "" if nothing."""
    values = table.numbers[:, channel.column]
    words = f"column {shown(channel.heading.words(), 40)}"
    if channel.kind == Quantity.CONSOLIDATION:
        return _degrees(words, values)
    factor, note = _factor(channel, values, units)
    return Column(channel.kind, words, values * factor), note


def time_in_seconds(
    table: Table, channel: Channel | None, units: Units
) -> tuple[np.ndarray | None, str]:
    """The times (s) of a table, None if it has none, and what was assumed about their unit."""
    if channel is None:
        return None, ""
    values = table.numbers[:, channel.column]
    factor, note = _factor(channel, values, units)
    return (values**2 if channel.kind == Quantity.ROOT_TIME else values) * factor, note


def is_degree(channel: Channel, parts: list[np.ndarray]) -> bool:
    """Whether a column without a length rises in every specimen from 0 to exactly 1 or 100."""
    if channel.kind != Quantity.STRAIN or not parts:
        return False
    finite = [part[np.isfinite(part)] for part in parts]
    return all(len(p) and p[0] == 0 and _is_whole(float(p.max())) for p in finite)


def load_of_name(label: str, travel: Column, units: Units) -> tuple[Column, str]:
    """The stress (kPa) of a step that only the specimen's name states: "25-50 kPa".

    The first reading counts as taken before the load was added.
    """
    found = _STEP.search(label)
    if found is None:
        problem = f"{travel.words} is a settlement over time whose load is not stated"
        repair = 'add a column of stress, or name the specimens by their step: "25-50"'
        raise BadValue(problem, repair)
    written = units.of(Quantity.STRESS)
    per = written.factor if written is not None else 1.0
    low, high = (float(text) * per for text in found.groups())
    values = np.full(len(travel.values), high)
    values[:1] = low
    name = f"the name {shown(label, 30)}"
    text = f"stress from {low:g} to {high:g} kPa, as {name} says: "
    unit = "unit as given" if written is not None else "taken as kPa"
    text += f"{unit}; the first reading counts as before the load was added"
    return Column(Quantity.STRESS, name, values), text


def _factor(channel: Channel, values: np.ndarray, units: Units) -> tuple[float, str]:
    """Kept units in one unit of the column, and what was assumed."""
    wanted, heading = units.of(channel.kind), channel.heading
    if wanted is not None and wanted.kind != channel.kind.dimension:
        problem = (
            f"{wanted.name} is not a unit of {channel.kind}, in column {shown(heading.name, 30)}"
        )
        raise BadValue(problem, unit_option(channel.kind))
    if wanted is None and heading.not_understood and channel.kind != Quantity.VOID_RATIO:
        raise refused_unit(heading, channel.kind)
    unit, name = wanted or heading.unit, shown(heading.name, 30)
    if unit is not None:
        text = f"{unit.name} of column {name} is a weight: mass times {GRAVITY} m/s2"
        return unit.factor, text if unit.by_weight else ""
    if channel.kind == Quantity.VOID_RATIO:
        return 1.0, ""
    if channel.kind == Quantity.STRAIN:
        largest = float(np.nanmax(np.abs(values)))
        per, word = (0.01, "%") if largest > 1 else (1.0, "a fraction")
        return per, f"column {name} has no unit: taken as {word}"
    if channel.kind == Quantity.TORQUE:
        raise BadValue(f"column {name} of torque has no unit", unit_option(channel.kind))
    is_root = channel.kind == Quantity.ROOT_TIME
    usual = _USUAL_OF_ROOT if is_root else _USUAL[channel.kind.dimension]
    return usual.factor, f"column {name} has no unit: taken as {usual.name}"


def _degrees(words: str, values: np.ndarray) -> tuple[Column, str]:
    """A degree of consolidation as a fraction, whether it was written up to 1 or to 100."""
    largest = float(np.nanmax(values))
    factor = 0.01 if largest > 1.5 else 1.0
    text = f"{words} ends at {largest:g}: taken as a degree of consolidation"
    return Column(Quantity.CONSOLIDATION, words, factor * values), text


def _is_whole(largest: float) -> bool:
    return any(abs(largest / whole - 1) < _WHOLE for whole in (1.0, 100.0))
