"""Quantities as people write them: one number and one unit, "8 mm/s".

A pattern takes the text apart and nothing is ever evaluated (pint alone would compute
"9**9**9 mm"); pint knows the units.  What cannot be used is a `BadValue` with its repair.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from calibrate.core.errors import BadValue, shown

if TYPE_CHECKING:
    import pint


@dataclass(frozen=True)
class Kind:
    """A kind of quantity: what it is called, the unit it is stored in, and an example."""

    noun: str
    unit: str
    example: str


LENGTH = Kind("length", "m", "100 mm")
SPEED = Kind("speed", "m/s", "8 mm/s")
FORCE = Kind("force", "N", "200 N")
TIME = Kind("time", "s", "1 s")
DENSITY = Kind("density", "kg/m^3", "1829.6 kg/m^3")
FRACTION = Kind("fraction", "", "22.84 %")
MILLIMETRES = Kind("length", "mm", "3.36 mm")
AREA = Kind("area", "m^2", "19.6 cm^2")
STRESS = Kind("stress", "kPa", "200 kPa")
ENERGY = Kind("energy", "J", "0.4 J")
STRAIN = Kind("strain", "", "5 %")
PERCENT = Kind("strain", "%", "5 %")
ANGLE = Kind("angle", "deg", "31 deg")
TORQUE = Kind("torque", "mN*m", "250 mN*m")
ROTATION = Kind("rotation speed", "deg/s", "1 deg/s")
STRAIN_RATE = Kind("strain rate", "1/s", "1 %/min")
VOID_RATIO = Kind("void ratio", "", "1.2")


@dataclass(frozen=True)
class Range:
    """Where the quantities of one entry usually lie: from `low` to `high`, both of `kind`.

    Of a stress, the entry may be a force too, which counts by the specimen's area; of a strain, a
    length, which counts by its height.
    """

    kind: Kind
    low: str
    high: str

    @property
    def ends(self) -> tuple[float, float]:
        """Both ends in `kind.unit`."""
        return quantity(self.low, self.kind), quantity(self.high, self.kind)

    def holds(self, value: float) -> bool:
        """Whether a value (`kind.unit`) is usual; 0 or less is allowed, or refused, elsewhere."""
        low, high = self.ends
        return value <= 0 or low * (1 - 1e-9) <= value <= high * (1 + 1e-9)


# What most lab files are written in, as pint knows it: dimensions, and factors to SI units.
OFTEN = {
    "m": ("m", 1.0), "cm": ("m", 0.01), "mm": ("m", 1e-3), "um": ("m", 1e-6),
    "m/s": ("m/s", 1.0), "mm/s": ("m/s", 1e-3), "mm/min": ("m/s", 1e-3 / 60),
    "N": ("N", 1.0), "kN": ("N", 1e3),
    "Pa": ("Pa", 1.0), "kPa": ("Pa", 1e3), "MPa": ("Pa", 1e6), "GPa": ("Pa", 1e9),
    "s": ("s", 1.0), "min": ("s", 60.0), "h": ("s", 3600.0), "day": ("s", 86400.0),
    "kg/m^3": ("kg/m^3", 1.0),
    "J/m^2": ("J/m^2", 1.0), "mJ/m^2": ("J/m^2", 1e-3),
    "": ("", 1.0), "%": ("", 0.01),
}  # fmt: skip
_LONGEST = 60  # characters of a quantity; also bounds the work of the patterns
_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_FACTOR = r"[A-Za-z\u00b5\u03bc%]+(?:\s*(?:\^|\*\*)\s*-?[1-9]|[²³])?"
_UNIT = re.compile(rf"{_FACTOR}(?:(?:\s*[*/·]\s*|\s+){_FACTOR})*")


@cache
def registry() -> "pint.UnitRegistry":
    """What pint knows; to load it takes a second, which most lab files do without (`OFTEN`)."""
    import pint

    return pint.UnitRegistry()


def unit_factor(unit: Any, kind: Kind) -> float:
    """How many `kind.unit` one `unit` is, e.g. 1000 N for "kN"."""
    repair = f'use a unit of {kind.noun}, as in "{kind.example}"'
    if not isinstance(unit, str) or len(unit) > _LONGEST or not _UNIT.fullmatch(unit):
        raise BadValue(f"unit {shown(unit)} is not understood", repair)
    if unit not in OFTEN or kind.unit not in OFTEN:
        return by_pint(unit, kind, repair)
    (dimension, factor), (wanted, per) = OFTEN[unit], OFTEN[kind.unit]
    if dimension != wanted:
        raise _other_kind(unit, kind, repair)
    return factor / per


def by_pint(unit: str, kind: Kind, repair: str = "") -> float:
    """The same of any unit."""
    import pint

    try:
        return float(registry().Quantity(1.0, unit).to(kind.unit).magnitude)
    except pint.UndefinedUnitError:
        raise BadValue(f"unit {shown(unit)} is not known", repair) from None
    except pint.DimensionalityError:
        raise _other_kind(unit, kind, repair) from None
    except (pint.PintError, ValueError, ArithmeticError, AssertionError):
        raise BadValue(f"unit {shown(unit)} is not understood", repair) from None


def _other_kind(unit: str, kind: Kind, repair: str) -> BadValue:
    return BadValue(f"{shown(unit)} is not a unit of {kind.noun}", repair)


def quantity(text: Any, kind: Kind) -> float:
    """`text` ("50 mm") as a finite number of `kind.unit`; a number without unit is refused."""
    repair = f'give a {kind.noun} with its unit such as "{kind.example}"'
    if not isinstance(text, str) or len(text) > _LONGEST:
        raise BadValue(f"{shown(text)} is not a quantity, which is a string", repair)
    match = _QUANTITY.fullmatch(text.strip())
    if match is None:
        raise BadValue(f"{shown(text)} does not start with a finite number", repair)
    if not match[2]:
        raise BadValue(f"{shown(text)} has no unit", repair)
    value = float(match[1]) * unit_factor(match[2], kind)
    if not math.isfinite(value):
        raise BadValue(f"{shown(text)} is too large", repair)
    return value


def number_of(text: Any) -> str:
    """The number before the unit of a quantity, as written; "" where there is none."""
    match = _QUANTITY.fullmatch(text.strip()) if isinstance(text, str) else None
    return match[1] if match else ""


def first_of(text: Any, kinds: Sequence[Kind], expected: str, name: str) -> tuple[Kind, float]:
    """The first kind that `text` ("200 kPa") is a quantity of, and its number in that unit;
    `name` of the entry, for the `BadValue`."""
    problem = ""
    for kind in kinds:
        try:
            return kind, quantity(text, kind)
        except BadValue as bad:
            problem = bad.problem
    if isinstance(text, str) and "is not a unit of" in problem:
        problem = f"{shown(text)} has a unit that does not fit here"
    raise BadValue(problem, expected, name)


def positive_quantity(text: Any, kind: Kind) -> float:
    """`quantity`, refused unless above zero."""
    value = quantity(text, kind)
    if value <= 0:
        sign = "negative" if value < 0 else "zero"
        repair = f'give a positive {kind.noun} such as "{kind.example}"'
        raise BadValue(f"{sign} {kind.noun} {text.strip()}", repair)
    return value


def unsigned_quantity(text: Any, kind: Kind) -> float:
    """`quantity`, refused if below zero."""
    value = quantity(text, kind)
    if value < 0:
        repair = f'give 0 or a positive {kind.noun} such as "{kind.example}"'
        raise BadValue(f"negative {kind.noun} {text.strip()}", repair)
    return value


def number_or_quantity(value: Any, unit: str) -> float:
    """A number in `unit`, or a string with or without a unit of its own, as a finite float."""
    repair = f'give a number or a quantity such as "1 {unit}"' if unit else "give a number"
    if isinstance(value, str) and not re.fullmatch(_NUMBER, value[:_LONGEST].strip()):
        return quantity(value, Kind(unit or "a pure number", unit, f"1 {unit}".strip()))
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise BadValue(f"{shown(value)} is not a number", repair)
    try:
        number = float(value)
    except (OverflowError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise BadValue(f"{shown(value)} is not a finite number", repair)
    return number
