"""A unit as laboratories write it: "kN", "lbs.", "psf", "N/cm2", "kg per sq cm", "0.01 mm".

Three ways, in this order: the spellings of `vocabulary.toml`, a quotient or a multiple of known
units, and pint for the units that laboratories use.  A unit of mass says the weight F = m g of
that mass, so kg of load are kgf.  A word of several meanings ("ton") is none, and says why.
"""

import re
import unicodedata
from dataclasses import dataclass, replace
from functools import cache

import pint

from calibrate.core.units import registry
from calibrate.instrument_import.vocabulary import WORDS, Kinds, Quantity

KEPT = {  # the unit in which numbers are kept
    Quantity.FORCE: "N",
    Quantity.STRESS: "kPa",
    Quantity.DISPLACEMENT: "mm",
    Quantity.TIME: "s",
    Quantity.STRAIN: "",
}
KEPT_OF_TOOLS = {Quantity.TORQUE: "N m", Quantity.ANGLE: "rad"}
GRAVITY = 9.80665  # m/s2, standard


@dataclass(frozen=True)
class Unit:
    """What a unit measures, its name, its size in the kept unit of that kind, and whether it is
    one of mass, whose weight counts."""

    kind: Quantity
    name: str
    factor: float
    by_weight: bool = False


_EXACT = {"MN": "MN", "mN": "mN", "Mg": "Mg", "mg": "mg"}
_NUMBER = (  # a size that cannot be the capacity of a load cell: "(10 kN)" is no unit
    r"(?:10\s*\^\s*[-−]?\s*\d{1,2}|10\s*[-−]\s*\d{1,2}|1\s*/\s*10{1,4}|0[.,]0*1"
    r"|1?[eE][-+]?\d{1,2}|(?<=[x×*])\s*10+|(?<=[x×*] )\s*10+)"
)
_MULTIPLE = re.compile(rf"(?:[x×*]\s*)?({_NUMBER})\s*[x×*·]?\s*(?=\D)(.+)", re.IGNORECASE)
_POWERS = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_AREA = re.compile(
    r"(?:sq\.?\s*|square\s+|q(?=[cm]m\b))(.+)|(.+?)\s*(?:\^|\*\*|\s)?\s*2|(.+) cuadrado",
    re.IGNORECASE,
)


def unit_of(text: str, kinds: Kinds = ()) -> Unit | None:
    """The unit that a text is and nothing else, perhaps in brackets or with a full stop; of torque
    and angle, if they are among `kinds`, before all others."""
    written = text.strip()[:40]
    bare = written.strip("[]()（）【】<>{} ").strip().rstrip(".")
    if Quantity.ANGLE in kinds and _plain(bare) in _ANGLES:
        return Unit(Quantity.ANGLE, bare, _ANGLES[_plain(bare)])
    torque = _torque(bare) if Quantity.TORQUE in kinds else None
    return torque or _unit(written)


@cache
def _unit(text: str) -> Unit | None:
    bare = text.strip("[]()（）【】<>{} ").strip()
    if bare in _EXACT:
        return _of_pint(bare, _EXACT[bare])
    plain = _plain(bare)
    if plain in _DOUBTS or plain.rstrip(".") in _DOUBTS:
        return None
    for spelling in (plain, plain.rstrip("."), plain.rstrip(".").replace(" ", "-")):
        if spelling in _SPELLINGS:
            expression = _SPELLINGS[spelling]
            named = {"percent": "%", "dimensionless": ""}.get(expression, expression)
            return _of_pint(named if named.isalpha() or len(named) < 2 else bare, expression)
    return _quotient(bare) or _multiple(bare) or _known_to_pint(bare)


def doubt(text: str) -> str:
    """Why a word that looks like a unit is not taken for one; "" where it is just not known."""
    return _DOUBTS.get(_plain(text).rstrip("."), "")


def _plain(text: str) -> str:
    """As it is compared: small letters without accents, otherwise as `_signs` leaves it."""
    letters = unicodedata.normalize("NFD", _signs(text).casefold())
    return "".join(c for c in letters if not unicodedata.combining(c))


def _signs(text: str) -> str:
    """One kind of sign for micro, powers and quotients, single blanks."""
    text = re.sub(r"[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", lambda m: "^" + m[0].translate(_POWERS), text)
    text = text.replace("∕", "/").replace("÷", "/").replace("−", "-")
    text = text.replace("µ", "u").replace("μ", "u")
    return " ".join(re.sub(r"\s*([/^])\s*", r"\1", text).split())


def _of_pint(name: str, expression: str) -> Unit | None:
    """The unit "lbf/ft^2" or "1000 lbf/ft^2" as pint knows it; None for another kind of
    quantity."""
    number, _, unit = expression.rpartition(" ")
    quantity = registry().Quantity(float(number or 1), unit)
    for kind, kept in KEPT.items():
        if quantity.check(registry().get_dimensionality(kept)):
            return Unit(kind, name, float(quantity.to(kept).magnitude))
    weights = ((Quantity.FORCE, "kg", GRAVITY), (Quantity.STRESS, "kg/m^2", 1e-3 * GRAVITY))
    for kind, of_mass, per in weights:
        if quantity.check(registry().get_dimensionality(of_mass)):
            return Unit(kind, name, per * float(quantity.to(of_mass).magnitude), True)
    return None


def _quotient(written: str) -> Unit | None:
    """A force over an area, or a length over a length: N/cm2, lb per sq ft, kN m-2, mm/mm."""
    text = re.sub(r"[ *·.]([A-Za-z]+)(?:\^|\*\*)?\s?-\s?2$", r"/\1^2", _signs(written).rstrip("."))
    parts = re.split(r"/| per | pro | por | par ", text, flags=re.IGNORECASE)
    if len(parts) != 2 or not all(part.strip() for part in parts):
        return None
    above, below = (part.strip(" .") for part in parts)
    first = _unit(above)
    area = _AREA.fullmatch(below)
    side = _unit(next(filter(None, area.groups())).strip(" .^")) if area else None
    if first and side and (first.kind, side.kind) == (Quantity.FORCE, Quantity.DISPLACEMENT):
        factor = first.factor / side.factor**2 * 1e3  # N/mm2 -> kPa
        return Unit(Quantity.STRESS, written, factor, first.by_weight)
    lengths = (first, _unit(below))
    if all(unit is not None and unit.kind == Quantity.DISPLACEMENT for unit in lengths):
        return Unit(Quantity.STRAIN, written, lengths[0].factor / lengths[1].factor)  # type: ignore[union-attr]
    return None


@cache
def _torque(text: str) -> Unit | None:
    """A force times a length, in either order: N m, kNcm, kg-cm, in.lb, ft lbf."""
    apart = re.split(r"\s*[ ·⋅*x×.\-]\s*", text)
    ways = [apart] if len(apart) == 2 else []
    if len(apart) == 1:
        ways = [[text[:place], text[place:]] for place in range(1, len(text))]
    for pair in ways:
        parts = [_unit(part) if part else None for part in pair]
        sizes = {part.kind: part for part in parts if part is not None}
        if set(sizes) == {Quantity.FORCE, Quantity.DISPLACEMENT}:
            force, arm = sizes[Quantity.FORCE], sizes[Quantity.DISPLACEMENT]
            factor = force.factor * arm.factor * 1e-3  # N mm -> N m
            return Unit(Quantity.TORQUE, text, factor, force.by_weight)
    return None


def _multiple(text: str) -> Unit | None:
    """A number of units: 0.01 mm, x 10 N, 10^3 psi, 1/100 mm."""
    found = _MULTIPLE.fullmatch(text)
    unit = _unit(found[2]) if found and not found[2][0].isdigit() else None
    if found is None or unit is None or _MULTIPLE.fullmatch(found[2].strip()):
        return None
    factor = _value(re.sub(r"\s", "", found[1]).replace("−", "-").replace(",", "."))
    return replace(unit, name=text, factor=factor * unit.factor)


def _value(number: str) -> float:
    power = re.fullmatch(r"10\^?(-?\d{1,2})", number)
    if power and ("^" in number or "-" in number):
        return 10.0 ** int(power[1])
    if number[0] in "eE":
        number = "1" + number
    if "/" in number:
        return 1.0 / float(number.split("/")[1])
    return float(number)


def _known_to_pint(text: str) -> Unit | None:
    """A unit by its name in pint, if it is one of laboratories."""
    name = text.rstrip(".").replace(" ", "_").replace("-", "_")
    if len(name) < 2 or not re.fullmatch(r"[A-Za-z_0-9]+", name) or name[0].isdigit():
        return None
    try:
        readings = registry().parse_unit_name(name)
        readings += registry().parse_unit_name(name.lower()) if name[1:].islower() else ()
    except (pint.PintError, ValueError):
        return None
    for prefix, base, _ in readings:
        known = WORDS.pint.with_prefix if prefix else (*WORDS.pint.alone, *WORDS.pint.with_prefix)
        if base in known and prefix in ("", *WORDS.pint.prefixes):
            return _of_pint(text, prefix + base)
    return None


_SPELLINGS = {_plain(word): unit for unit, words in WORDS.units.items() for word in words}
_ANGLES = {
    _plain(word): float(registry().Quantity(1.0, unit).to("rad").magnitude)
    for unit, words in WORDS.tools.units[Quantity.ANGLE].items()
    for word in words
}
_DOUBTS = {word: doubtful.why for doubtful in WORDS.doubtful_units for word in doubtful.words}
