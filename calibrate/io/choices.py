"""What a lab file says of parameters: values, bounds, and values that differ with moisture.

A parameter that differs has a value for each moisture of specimens.  Each is a parameter of its
own: `gamma@8%` is gamma of specimens at 8 %.  Bounds and prior of gamma are those of all.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown
from calibrate.core.units import FRACTION, unsigned_quantity
from calibrate.io.labfile import PARAMETER_UNITS, check_parameter, entry_of
from calibrate.io.tables import ParameterTable

AT = "@"
T = TypeVar("T")


@dataclass(frozen=True)
class ParameterChoice:
    """What the lab file says about one parameter, in its SI unit; None where it says nothing."""

    value: float | None
    low: float | None
    high: float | None
    prior_sd: float | None
    free: bool | None


# ---------------------------------------------------------------- names


def percent(moisture: float) -> str:
    """A moisture (water over dry mass) as it stands in names: "8%"."""
    return f"{100 * moisture:.6g}%"


def plain(name: str) -> str:
    """A parameter's name without a moisture."""
    return name.partition(AT)[0]


def at(name: str, moisture: float) -> str:
    """The name of a parameter's value at a moisture."""
    return f"{name}{AT}{percent(moisture)}"


def unit_of(name: str) -> str:
    """The SI unit of a parameter, "" for a pure number."""
    return PARAMETER_UNITS[plain(name)]


def differing(names: Iterable[str]) -> dict[str, list[str]]:
    """Parameters that differ with moisture, each with the names of its values, the driest first."""
    found: dict[str, list[str]] = {}
    for name in sorted((name for name in names if AT in name), key=_dryness):
        found.setdefault(plain(name), []).append(name)
    return found


def _dryness(name: str) -> float:
    return float(name.partition(AT)[2].rstrip("%"))


def expanded(entries: Mapping[str, T], values: Mapping[str, Iterable[str]]) -> dict[str, T]:
    """Entries by parameter; of one that differs, the same for each of its `values`."""
    return {own: entry for name, entry in entries.items() for own in values.get(name, (name,))}


def of_one_soil(values: Mapping[str, T], moisture: float | None, file: str) -> dict[str, T]:
    """Values by parameter of the soil at a moisture; `InputError` where it is not said at which, or
    is said where nothing differs."""
    every = differing(values)
    if not every and moisture is None:
        return dict(values)
    if not every:
        raise InputError(file, "", "no parameter differs with moisture", "leave out --moisture")
    known = [value.partition(AT)[2] for value in next(iter(every.values()))]
    if moisture is None or percent(moisture) not in known:
        problem = f"{next(iter(every))} differs with moisture"
        if moisture is not None:
            problem += f", and has no value for {percent(moisture)}"
        raise InputError(file, "", problem, f"give --moisture, one of {', '.join(known)}")
    own = {name: values[at(name, moisture)] for name in every}
    return {**{name: x for name, x in values.items() if AT not in name}, **own}


# ---------------------------------------------------------------- entries of a lab file


def choices(
    tables: Mapping[str, ParameterTable], file: str, law: str
) -> dict[str, ParameterChoice]:
    """The entries of [parameters] by name; of one that differs, those of its values too."""
    found: dict[str, ParameterChoice] = {}
    for name, table in tables.items():
        found |= _choices(name, table, file, law)
    return found


def _choices(name: str, table: ParameterTable, file: str, law: str) -> dict[str, ParameterChoice]:
    """One entry of [parameters] by name, or one for each moisture and what stands for all: the mean
    of their logarithms, which a fit holds."""
    field = f"parameters.{name}"
    entry = entry_of(name, file, field, law)
    if not table.by_moisture:
        return {name: _choice(name, table, table.value, field, file, law)}
    if entry.search is None:
        problem = f"{name} cannot differ with moisture"
        raise InputError(file, f"{field}.by_moisture", problem, "give it one value")
    if table.value is not None:
        problem = "it has both one value and values by moisture"
        raise InputError(file, f"{field}.value", problem, "leave out one of them")
    found = {}
    for text, value in table.by_moisture.items():
        place = f'{field}.by_moisture."{text}"'
        called = at(name, _moisture(text, file, place))
        if called in found:
            raise InputError(file, place, "this moisture is given twice", "leave out one of them")
        found[called] = _choice(name, table, value, place, file, law)
    values = [choice.value for choice in found.values()]
    usual = float(np.exp(np.mean(np.log(values)))) if min(values) > 0 else max(values)
    return {name: ParameterChoice(usual, None, None, None, False), **found}


def named_sets(
    sets: Mapping[str, dict[str, Any]], differ: Iterable[str], file: str, law: str
) -> dict[str, dict[str, float]]:
    """All of [named_sets], in SI; refused where one has a parameter of those that `differ`."""
    return {name: _named_set(name, values, differ, file, law) for name, values in sets.items()}


def _named_set(
    set_name: str, values: dict[str, Any], differ: Iterable[str], file: str, law: str
) -> dict[str, float]:
    field = f"named_sets.{set_name}"
    for name in values:
        if name in differ:
            problem = f"{name} differs with moisture, and a named set has one value"
            raise InputError(file, f"{field}.{name}", problem, "leave it out")
    return {n: check_parameter(n, x, file, f"{field}.{n}", law) for n, x in values.items()}


def check_moistures(names: Iterable[str], specimens: Mapping[str, float | None], file: str) -> None:
    """Refuse parameters by name of which the moisture of a specimen (by field) has no value."""
    for name, values in differing(names).items():
        known = ", ".join(value.partition(AT)[2] for value in values)
        for field, moisture in specimens.items():
            if moisture is None:
                problem = f"{name} differs with moisture, and this specimen has none"
                raise InputError(file, f"{field}.moisture", problem, f"give one of {known}")
            if at(name, moisture) not in values:
                problem = f"{name} has no value for {percent(moisture)}"
                repair = f"give it one in parameters.{name}.by_moisture, or one of {known} here"
                raise InputError(file, f"{field}.moisture", problem, repair)


def _moisture(text: str, file: str, field: str) -> float:
    try:
        return unsigned_quantity(text, FRACTION)
    except BadValue:
        raise InputError(file, field, f"{shown(text)} is no moisture", 'write "8 %"') from None


def _choice(
    name: str, table: ParameterTable, written: Any, field: str, file: str, law: str
) -> ParameterChoice:
    """A value with the bounds and the prior of its entry, checked and in order."""
    value = _number_if_given(name, written, file, field, law)
    low = _number_if_given(name, table.low, file, f"parameters.{name}.low", law)
    high = _number_if_given(name, table.high, file, f"parameters.{name}.high", law)
    given = [number for number in (low, value, high) if number is not None]
    if given != sorted(given) or (low is not None and low == high):
        repair = "make low <= value <= high, and low < high"
        raise InputError(file, field, f"low, value, high are {low}, {value}, {high}", repair)
    return ParameterChoice(value, low, high, table.prior_sd, table.free)


def _number_if_given(name: str, value: Any, file: str, field: str, law: str) -> float | None:
    """`check_parameter`, or None for a value that is not in the file."""
    return check_parameter(name, value, file, field, law) if value is not None else None
