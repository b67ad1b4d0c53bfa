"""The words of testing machines: what a column is called, in which unit, and of which test.

Names are compared without accents and case; they are English, German, Spanish, French,
Italian, Portuguese and Chinese.  Where a name and a unit are both written, the dimension of
the unit decides between a length and a strain, or a force and a stress.

`TESTS` lists the types of tests (`calibrate.labtests`) that a file can be of.
"""

import re
import unicodedata

from calibrate.labtests.composite import TYPES

TIME, FORCE, DISPLACEMENT = "time", "force", "displacement"
STRESS, STRAIN, OTHER = "stress", "strain", "other"
VOID_RATIO, CONSOLIDATION = "void ratio", "degree of consolidation"
ROOT_TIME = "root of time"
STRENGTH, SHEAR_STRENGTH = "compressive strength", "undrained shear strength"

# Searched in this order: "compressive stress" is a stress, "extension rate" none of these.
# In each entry the preferred channel of a machine that records several comes first.
_PARTS: dict[str, tuple[str, ...]] = {
    OTHER: (
        *("rate", "speed", "geschwindigkeit", "velocidad", "vitesse", "速度", "速率"),
        *("temperat", "energ", "arbeit", "work", "modul", "cycle", "zyklus", "温度"),
        *("max", "peak", "bruch", "break", "mean", "mittel", "average", "最大", "平均"),
        *("pore pressure", "pore water", "porenwasser", "poros", "interstit", "back pressure"),
        *("cell pressure", "zelldruck", "confining", "shear stress", "schubspannung"),
        *("radial strain", "lateral strain", "volumetric strain", "shear strain"),
    ),
    SHEAR_STRENGTH: (
        *("undrained shear strength", "undrained strength", "scherfestigkeit"),
        *("resistencia al corte no drenad", "cohesion no drenada", "cohesion non drainee"),
    ),
    STRENGTH: (
        *("compressive strength", "druckfestigkeit", "resistencia a compresion"),
        *("resistencia a la compresion", "resistance a la compression"),
    ),
    VOID_RATIO: (
        *("void ratio", "voids ratio", "porenzahl", "indice de vacios", "relacion de vacios"),
        *("indice des vides", "indice dei vuoti", "indice de vazios", "孔隙比"),
    ),
    CONSOLIDATION: (
        *("degree of consolidation", "settlement ratio", "verfestigungsgrad"),
        *("konsolidationsgrad", "grado de consolidacion", "degre de consolidation", "固结度"),
    ),
    ROOT_TIME: ("sqrt(t", "sqrt t", "sqrt(min", "√", "root time", "root of time", "wurzel"),
    STRESS: (
        *("axial stress", "vertical stress", "effective stress", "normal stress", "stress"),
        *("sigma", "σ", "spannung", "pressure", "esfuerzo", "tension vertical"),
        *("tension efectiva", "tension normal", "contrainte", "应力", "压强", "强度"),
    ),
    STRAIN: (
        *("axial strain", "vertical strain", "strain", "deformacion unitaria"),
        *("deformation relative", "deformation unitaire", "epsilon", "ε", "应变"),
    ),
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
    SHEAR_STRENGTH: ("su", "s_u", "cu", "c_u"),
    STRENGTH: ("ucs", "qu", "q_u"),
}
_VOID_RATIO = re.compile(r"e|e[\s_]*\(\w{1,12}\)|e[\s_]+[a-z]{0,4}\d{1,3}|e[1-9]\d?")
_STEP = ("step", "stage", "load step", "load stage", "stufe", "laststufe", "escalon", "palier")
_SPECIMENS = (
    *("sample", "specimen", "sample id", "specimen id", "sample no", "specimen no"),
    *("sample name", "specimen name", "sample number", "specimen number", "probe", "probe nr"),
    *("proben nr", "probennummer", "probekorper", "muestra", "probeta", "ensayo"),
    *("echantillon", "eprouvette", "campione", "provino", "amostra", "试样", "试件"),
)

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
        **dict.fromkeys(("n/mm2", "n/mm²", "n/mm^2", "mn/m2", "mn/m²", "mn/m^2"), "MPa"),
        **dict.fromkeys(("kn/m2", "kn/m²", "kn/m^2", "千帕"), "kPa"),
        **dict.fromkeys(("kg/cm2", "kg/cm²", "kg/cm^2", "kgf/cm2", "kgf/cm²"), "kgf/cm^2"),
        **dict.fromkeys(("kgf/cm^2", "kp/cm2", "kp/cm²"), "kgf/cm^2"),
        **{"bar": "bar", "mbar": "mbar", "兆帕": "MPa"},
    },
    STRAIN: {"%": "%", "mm/mm": "", "m/m": ""},
}
_EXACT = {"MN": (FORCE, "MN"), "mN": (FORCE, "mN")}  # case tells them apart
_DIMENSION = {unit: (kind, name) for kind, units in _UNITS.items() for unit, name in units.items()}
_PURE = ("-", "1")  # how a pure number is written in brackets
_BRACKETS = re.compile(r"[\[(（【<]\s*([^\[\]()（）【】<>]{1,12})\s*[\])）】>]")
_PERCENT = re.compile(r"%\s*([^\W\d].*)|(.*[^\W\d])%")  # "%settlement", "strain%"
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
    percent = _PERCENT.fullmatch(text.strip())
    if percent:
        return percent[1] or percent[2], unit_of("%")
    for match in _BRACKETS.finditer(text):
        unit = (STRAIN, "") if match[1].strip() in _PURE else unit_of(match[1])
        if unit is not None:
            return (text[: match.start()] + text[match.end() :]).strip(), unit
    match = _TAIL.fullmatch(text.strip())
    unit = unit_of(match[2]) if match else None
    return (match[1].strip(), unit) if match and unit else (text.strip(), None)


def kind_of(name: str) -> tuple[str | None, int]:
    """What a column of this name holds, and its rank among columns of that kind (0 is best)."""
    words = plain(name)
    if words in _STEP:
        return None, 0
    if _VOID_RATIO.fullmatch(words):
        return VOID_RATIO, len(_PARTS[VOID_RATIO])
    for kind, parts in _PARTS.items():
        for rank, part in enumerate(parts):
            if part in words:
                return kind, rank
    for kind, names in _WHOLE.items():
        if words.rstrip("0123456789 _.#") in names:
            return kind, len(_PARTS[kind])
    return None, 0


def names_specimens(name: str) -> bool:
    """Whether a column of this name says to which specimen a row belongs."""
    return plain(name).strip(" .:#_-").replace("_", " ") in _SPECIMENS


# Test type -> words that name it; later types first, since their words hold those of earlier ones.
TESTS = {name: kind.words for name, kind in reversed(tuple(TYPES.items())) if kind.words}


def _of_shape(shape: str) -> str:
    """The type of test that a curve's shape says."""
    return next(name for name, kind in TYPES.items() if kind.shape == shape)


# What a curve's shape and its points say, as one of `TESTS`.
SOFTENS, STIFFENS, LOAD_STEPS = (_of_shape(shape) for shape in ("softens", "stiffens", "steps"))


def test_named_in(text: str) -> str | None:
    """The test of `TESTS` that the text names, in any of the languages, or None."""
    words = plain(text)
    return next((test for test, names in TESTS.items() if any(n in words for n in names)), None)
