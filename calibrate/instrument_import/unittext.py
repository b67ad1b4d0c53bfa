"""A unit as laboratories write it: "kN", "lbs.", "psf", "N/cm2", "kg per sq cm", "0.01 mm".

Three ways, in this order: a table of spellings, a quotient or a multiple of known units, and
pint for the units that laboratories use.  A unit of mass says the weight F = m g of that mass,
so kg of load are kgf.  A word of several meanings ("ton") is none, and says why.
"""

import re
import unicodedata
from dataclasses import dataclass, replace
from functools import cache

import pint

from calibrate.core.units import UNITS

TIME, FORCE, DISPLACEMENT = "time", "force", "displacement"
STRESS, STRAIN = "stress", "strain"
KEPT = {FORCE: "N", STRESS: "kPa", DISPLACEMENT: "mm", TIME: "s", STRAIN: ""}  # what is kept
GRAVITY = 9.80665  # m/s2, standard


@dataclass(frozen=True)
class Unit:
    """What a unit measures, its name, its size in the kept unit of that kind, and whether it is
    one of mass, whose weight counts."""

    kind: str
    name: str
    factor: float
    by_weight: bool = False


_SPELLINGS: dict[str, str] = {  # as pint knows it -> as it is written, in small letters
    "N": "n newton newtons ньютон н 牛 牛顿",
    "kN": "kn kilonewton kilonewtons кн 千牛",
    "MN": "meganewton meganewtons",
    "daN": "dan decanewton",
    "kgf": "kgf kg-f kg_f kg(f) kp kilopond kgs.f kgr-f кгс 公斤力 千克力",
    "gram_force": "gf g-f pond ponds",
    "9806.65 N": "tf t-f tonnef",
    "lbf": "lbf lb-f lb_f lbsf lbs-f pound-force pounds-force pound_force pounds_force",
    "kip": "kip kips k-lbf klbf",
    "ounce_force": "ozf oz-f",
    "mm": "mm millimeter millimeters millimetre millimetres milimetro milimetros millimetro "
    "millimetri mms мм 毫米",
    "cm": "cm centimeter centimeters centimetre centimetres centimetro centimetros centimetri "
    "cms zentimeter см 厘米",
    "m": "m meter meters metre metres metro metros metri м 米",
    "um": "um µm μm micron microns micrometer micrometers micrometre micrometres mkm мкм 微米",
    "inch": "in in. inch inches zoll pulgada pulgadas pouce pouces pollice pollici polegada "
    "polegadas \" '' ” 英寸",
    "ft": "ft foot feet fuß fuss pie pies pied pieds piede piedi pe pes ' ′ 英尺",
    "thou": "mil mils thou thous milli-inch",
    "s": "s sec secs sek seg segs second seconds sekunde sekunden segundo segundos seconde "
    "secondes secondo secondi с сек 秒",
    "min": "min mins minute minutes minuten minuto minutos minuti мин 分 分钟",
    "hour": "h hr hrs hour hours std stunde stunden hora horas heure heures ora ore ч час 时 小时",
    "day": "d day days tag tage dia dias jour jours giorno giorni 天 日",
    "ms": "ms msec msecs millisecond milliseconds millisekunden milisegundos 毫秒",
    "Pa": "pa pascal pascals па 帕",
    "kPa": "kpa kilopascal kilopascals кпа 千帕",
    "MPa": "mpa megapascal megapascals мпа 兆帕",
    "GPa": "gpa gigapascal",
    "hPa": "hpa hectopascal",
    "psi": "psi lbf-in2 p.s.i",
    "ksi": "ksi kpsi",
    "lbf/ft^2": "psf p.s.f",
    "1000 lbf/ft^2": "ksf",
    "2000 lbf/ft^2": "tsf",
    "bar": "bar bars",
    "mbar": "mbar millibar",
    "standard_atmosphere": "atm",
    "kgf/cm^2": "ata technical_atmosphere ksc",
    "percent": "% pct percent per-cent prozent porcentaje pourcentage pourcent percentuale "
    "percentagem por-ciento pour-cent per-cento por-cento percentage",
    "permille": "‰ permille promille permil pro-mille",
    "1e-6 dimensionless": "microstrain microstrains ustrain µstrain µε με µm/m um/m",
    "1e-3 dimensionless": "millistrain mε",
    "dimensionless": "- – — 1 fraction decimal unitless dimensionless adim",
    "kg": "kg kgs kilogram kilograms kilogramm kilo kilos kilogramo kilogramos kilogramme "
    "kilogrammes chilogrammi quilogramas kgm кг 公斤 千克",
    "g": "g gm gms gram grams gramm gramo gramos gramme grammes grammi gramas г 克",
    "tonne": "t tonne tonnes metric-ton metric_ton metric-tons tonelada-metrica mton 吨",
    "lb": "lb lbs pound pounds libra libras lbm 磅",
    "ounce": "oz ounce ounces",
    "short_ton": "short-ton short_ton short-tons us-ton us-tons",
    "long_ton": "long-ton long_ton long-tons uk-ton",
}
_EXACT = {"MN": "MN", "mN": "mN", "Mg": "Mg", "mg": "mg"}
_CLOCK = "hh:mm:ss h:mm:ss hh:mm:ss.0 hh:mm:ss.000 mm:ss hms h:m:s"  # of cells such as 00:01:02
DOUBTFUL = {  # words of several sizes, and what each could be given as
    **dict.fromkeys(
        ("ton", "tons", "tonf", "tons-f", "ton-force", "tn", "toneladas", "tonelada"),
        "is metric, short or long; tonne, short_ton and long_ton say which",
    ),
    **dict.fromkeys(("gr", "grs"), "is a gram or a grain; g and grain say which"),
    **dict.fromkeys(("cwt",), "is 100 or 112 pounds"),
    **dict.fromkeys(("lb/ft", "kn/m", "n/mm", "kn/mm"), "is a force over a length"),
}
# Further units that pint knows and laboratories use; those of SI take prefixes.
_SI = {"meter", "newton", "pascal", "second", "gram", "bar", "dyne", "gram_force", "force_gram"}
_SI |= {"meter_Hg", "meter_H2O"}
_PREFIXES = {"", "nano", "micro", "milli", "centi", "deci", "deca", "hecto", "kilo", "mega", "giga"}
_OTHERS = {
    *("pound_force", "force_pound", "kip", "ounce_force", "force_ounce", "poundal"),
    *("kilogram_force", "force_kilogram", "kilopond", "ton_force", "force_ton"),
    *("metric_ton_force", "force_metric_ton", "pound_force_per_square_inch"),
    *("kip_per_square_inch", "torr", "inch_Hg", "inch_H2O", "foot_H2O", "barye"),
    *("standard_atmosphere", "technical_atmosphere", "inch", "foot", "yard", "thou", "micron"),
    *("angstrom", "minute", "hour", "day", "week", "metric_ton", "tonne", "pound", "ounce"),
    *("slug", "stone", "grain", "percent", "permille", "long_ton", "short_ton"),
}
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


def unit_of(text: str) -> Unit | None:
    """The unit that a text is and nothing else, perhaps in brackets or with a full stop."""
    return _unit(text.strip()[:40])


@cache
def _unit(text: str) -> Unit | None:
    bare = text.strip("[]()（）【】<>{} ").strip()
    if bare in _EXACT:
        return _of_pint(bare, _EXACT[bare])
    plain = _plain(bare)
    if plain in DOUBTFUL or plain.rstrip(".") in DOUBTFUL:
        return None
    for spelling in (plain, plain.rstrip("."), plain.rstrip(".").replace(" ", "-")):
        if spelling in _TABLE:
            expression = _TABLE[spelling]
            named = {"percent": "%", "dimensionless": ""}.get(expression, expression)
            return _of_pint(named if named.isalpha() or len(named) < 2 else bare, expression)
    return _quotient(bare) or _multiple(bare) or _known_to_pint(bare)


def doubt(text: str) -> str:
    """Why a word that looks like a unit is not taken for one; "" where it is just not known."""
    return DOUBTFUL.get(_plain(text).rstrip("."), "")


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


def _spelt() -> dict[str, str]:
    rows = ((word, name) for name, words in _SPELLINGS.items() for word in words.split())
    table = {_plain(word): name for word, name in rows}
    return table | dict.fromkeys(_CLOCK.split(), "s")


def _of_pint(name: str, expression: str) -> Unit | None:
    """The unit "lbf/ft^2" or "1000 lbf/ft^2" as pint knows it; None for another kind of
    quantity."""
    number, _, unit = expression.rpartition(" ")
    quantity = UNITS.Quantity(float(number or 1), unit)
    for kind, kept in KEPT.items():
        if quantity.check(UNITS.get_dimensionality(kept)):
            return Unit(kind, name, float(quantity.to(kept).magnitude))
    for kind, of_mass, per in ((FORCE, "kg", GRAVITY), (STRESS, "kg/m^2", 1e-3 * GRAVITY)):
        if quantity.check(UNITS.get_dimensionality(of_mass)):
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
    if first and side and (first.kind, side.kind) == (FORCE, DISPLACEMENT):
        factor = first.factor / side.factor**2 * 1e3  # N/mm2 -> kPa
        return Unit(STRESS, written, factor, first.by_weight)
    lengths = (first, _unit(below))
    if all(unit is not None and unit.kind == DISPLACEMENT for unit in lengths):
        return Unit(STRAIN, written, lengths[0].factor / lengths[1].factor)  # type: ignore[union-attr]
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
        readings = UNITS.parse_unit_name(name)
        readings += UNITS.parse_unit_name(name.lower()) if name[1:].islower() else ()
    except (pint.PintError, ValueError):
        return None
    for prefix, base, _ in readings:
        if (base in _OTHERS and not prefix) or (base in _SI and prefix in _PREFIXES):
            return _of_pint(text, prefix + base)
    return None


_TABLE = _spelt()
