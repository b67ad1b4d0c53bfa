"""The words of testing machines: what a column is called and in which unit.

Names are compared without accents and case; they are English, German, Spanish, French,
Italian, Portuguese and Chinese.  Where a name and a unit are both written, the dimension of
the unit decides between a length and a strain, or a force and a stress.
"""

import re
import unicodedata

TIME, FORCE, DISPLACEMENT = "time", "force", "displacement"
STRESS, STRAIN, OTHER = "stress", "strain", "other"

# Searched in this order: "compressive stress" is a stress, "extension rate" none of these.
# In each entry the preferred channel of a machine that records several comes first.
_PARTS: dict[str, tuple[str, ...]] = {
    OTHER: (
        *("rate", "speed", "geschwindigkeit", "velocidad", "vitesse", "速度", "速率"),
        *("temperat", "energ", "arbeit", "work", "modul", "cycle", "zyklus", "温度"),
        *("max", "peak", "bruch", "break", "mean", "mittel", "average", "最大", "平均"),
    ),
    STRESS: ("stress", "spannung", "pressure", "esfuerzo", "contrainte", "应力", "压强", "强度"),
    STRAIN: ("strain", "应变"),
    FORCE: (
        *("standardkraft", "kraft", "force", "load", "fuerza", "carga", "charge", "forza"),
        *("carico", "forca", "试验力", "力", "荷", "载"),
    ),
    TIME: ("time", "zeit", "tiempo", "temps", "tempo", "时间", "sekunde", "seconds"),
    DISPLACEMENT: (
        *("standardweg", "extension", "displacement", "desplazamiento", "deplacement"),
        *("spostamento", "deslocamento", "位移", "weg", "verschiebung", "travel", "stroke"),
        *("recorrido", "carrera", "course", "corsa", "curso", "行程", "deflection", "setzung"),
        *("settlement", "compression", "stauchung", "allongement", "dehnung"),
        *("deforma", "verformung", "变形", "crosshead", "traverse", "position", "posicion"),
    ),
}
_WHOLE: dict[str, tuple[str, ...]] = {  # names that are too short to be searched for
    FORCE: ("f", "fn", "fz", "last", "p"),
    TIME: ("t", "tid"),
    DISPLACEMENT: ("s", "x", "z", "u", "dl", "l", "d", "disp", "ext", "pos"),
}

_UNITS: dict[str, dict[str, str]] = {  # as machines write them -> as pint knows them
    FORCE: {
        **dict.fromkeys(("n", "newton", "newtons", "牛", "牛顿"), "N"),
        **dict.fromkeys(("kn", "kilonewton", "千牛"), "kN"),
        **{"dan": "daN", "kgf": "kgf", "kp": "kgf", "gf": "gram_force"},
        **dict.fromkeys(("lbf", "lb", "lbs"), "lbf"),
    },
    DISPLACEMENT: {
        **dict.fromkeys(("mm", "毫米", "millimeter", "millimetre", "millimeters"), "mm"),
        **dict.fromkeys(("um", "µm", "μm", "微米", "micron"), "um"),
        **dict.fromkeys(("in", "inch", "inches"), "inch"),
        **{"cm": "cm", "m": "m", "厘米": "cm", "米": "m", "meter": "m"},
    },
    TIME: {
        **dict.fromkeys(("s", "sec", "secs", "sek", "seg", "second", "seconds", "秒"), "s"),
        **dict.fromkeys(("min", "分", "分钟"), "min"),
        **{"ms": "ms", "h": "hour", "hh:mm:ss": "s", "毫秒": "ms"},
    },
    STRESS: {
        **{"pa": "Pa", "kpa": "kPa", "mpa": "MPa", "gpa": "GPa", "psi": "psi"},
        **dict.fromkeys(("n/mm2", "n/mm²", "n/mm^2"), "MPa"),
    },
    STRAIN: {"%": "%", "mm/mm": ""},
}
_EXACT = {"MN": (FORCE, "MN"), "mN": (FORCE, "mN")}  # case tells them apart
_DIMENSION = {unit: (kind, name) for kind, units in _UNITS.items() for unit, name in units.items()}
_BRACKETS = re.compile(r"[\[(（【<]\s*([^\[\]()（）【】<>]{1,12})\s*[\])）】>]")
_TAIL = re.compile(r"(.+?)(?:\s+in\s+|[\s_,/;:-]+)(\S{1,12})")


def plain(text: str) -> str:
    """`text` in lower case without accents, on one line."""
    letters = unicodedata.normalize("NFKD", text.casefold())
    return " ".join("".join(c for c in letters if not unicodedata.combining(c)).split())


def unit_of(text: str) -> tuple[str, str] | None:
    """(kind, pint name) of a text that is a unit and nothing else, perhaps in brackets."""
    inner = text.strip().strip("[]()（）【】<>").strip()
    return _EXACT.get(inner) or _DIMENSION.get(inner.casefold())


def split_unit(text: str) -> tuple[str, tuple[str, str] | None]:
    """A column's heading without its unit, and the unit: "Load (kN)", "Kraft in N", "F/N"."""
    for match in _BRACKETS.finditer(text):
        unit = unit_of(match[1])
        if unit is not None:
            return (text[: match.start()] + text[match.end() :]).strip(), unit
    match = _TAIL.fullmatch(text.strip())
    unit = unit_of(match[2]) if match else None
    return (match[1].strip(), unit) if match and unit else (text.strip(), None)


def kind_of(name: str) -> tuple[str | None, int]:
    """What a column of this name holds, and its rank among columns of that kind (0 is best)."""
    words = plain(name)
    for kind, parts in _PARTS.items():
        for rank, part in enumerate(parts):
            if part in words:
                return kind, rank
    for kind, names in _WHOLE.items():
        if words.rstrip("0123456789 _.#") in names:
            return kind, len(_PARTS[kind])
    return None, 0


_UNCONFINED = (
    *("unconfined", "uniaxial compressive strength", "ucs", "einaxial", "unbehindert"),
    *("no confinad", "inconfinad", "compresion simple", "non confine", "无侧限", "crush"),
)
_CONFINED = (
    *("confined", "oedomet", "odomet", "edomet", "behinderte seitendehnung", "confinad"),
    *("confine", "侧限", "固结", "mould compression"),
)


def test_named_in(text: str) -> str | None:
    """ "confined" or "unconfined" where the text says so, in any of the languages."""
    words = plain(text)
    if any(word in words for word in _UNCONFINED):
        return "unconfined"
    return "confined" if any(word in words for word in _CONFINED) else None
