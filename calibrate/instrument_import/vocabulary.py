"""The words of testing machines: what a column is called, and of which test.

Names are compared without accents and case, as words however they were joined (snake_case,
camelCase); they are English, German, Spanish, French, Italian, Portuguese and Chinese.

`TESTS` lists the types of tests (`calibrate.labtests`) that a file can be of.
"""

import re
import unicodedata

from calibrate.instrument_import.unittext import DISPLACEMENT, FORCE, STRAIN, STRESS, TIME
from calibrate.labtests.composite import TYPES

OTHER = "other"
VOID_RATIO, CONSOLIDATION = "void ratio", "degree of consolidation"
ROOT_TIME = "root of time"
STRENGTH, SHEAR_STRENGTH = "compressive strength", "undrained shear strength"

# Searched in this order: "compressive stress" is a stress, "extension rate" none of these.
# In each entry the preferred channel of a machine that records several comes first.
_PARTS: dict[str, tuple[str, ...]] = {
    OTHER: (
        *("rate", "speed", "geschwindigkeit", "velocidad", "vitesse", "速度", "速率"),
        *("temperat", "energ", "arbeit", "work", "modul", "cycle", "zyklus", "温度"),
        *("setpoint", "set point", "command", "demand", "sollwert", "consigna", "consigne"),
        *("max", "peak", "bruch", "break", "mean", "mittel", "average", "最大", "平均"),
        *("pore pressure", "pore water", "porenwasser", "poros", "interstit", "back pressure"),
        *("cell pressure", "zelldruck", "confining", "confinamiento", "confinement", "radial"),
        *("chamber pressure", "camara", "lateral", "horizontal", "sigma 3", "σ3", "sigma3"),
        *("shear stress", "schubspannung", "scherspannung", "shear force", "scherkraft"),
        *("shear load", "shear displacement", "shear strain", "volumetric", "volume", "围压"),
        *(
            "孔压",
            "孔隙水压",
            "反压",
            "diameter",
            "durchmesser",
            "diametr",
            "cortante",
            "cisaillement",
            "moment",
            "torque",
            "dilat",
        ),
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
    DISPLACEMENT: ("s", "x", "z", "u", "dl", "l", "d", "dz", "uz", "disp", "ext", "pos"),
    SHEAR_STRENGTH: ("su", "s u", "cu", "c u"),
    STRENGTH: ("ucs", "qu", "q u"),
}
_VOID_RATIO = re.compile(r"e|e[\s_]*\(\w{1,12}\)|e[\s_]+[a-z]{0,4}\d{1,3}|e[1-9]\d?")
_STEP = ("step", "stage", "load step", "load stage", "stufe", "laststufe", "escalon", "palier")
NAMED = (  # what a specimen is called; a column of these names holds names
    *("sample", "specimen", "probe", "proben", "probekorper", "muestra", "probeta", "core"),
    *("echantillon", "eprouvette", "campione", "provino", "amostra", "cylinder", "prufkorper"),
    *("试样", "试件"),
)
_NUMBERED = (  # what is done with specimens; a column of these names may number anything
    *("replicate", "rep", "repeat", "repetition", "replica", "repeticion", "wiederholung"),
    *("run", "test", "trial", "versuch", "ensayo", "essai", "prova", "ensaio"),
)
_SPECIMENS = frozenset(
    name
    for word in (*NAMED, *_NUMBERED)
    for name in (word, *(f"{word} {end}" for end in ("id", "no", "nr", "number", "name", "#")))
) | {"probennummer", "编号", "试样编号", "试件编号", "id", "samples", "specimens"}
_STATISTICS = frozenset(("min", "max", "avg", "sd", "std", "mean", "average", "peak"))


def plain(text: str) -> str:
    """`text` in lower case without accents, on one line."""
    letters = unicodedata.normalize("NFKD", text.casefold())
    return " ".join("".join(c for c in letters if not unicodedata.combining(c)).split())


def words_of(name: str) -> str:
    """A name as words with blanks, however it was written: snake_case, camelCase, with dots."""
    spaced = re.sub(r"(?<=[a-zß-ÿ])(?=[A-Z])", " ", name)
    return plain(re.sub(r"[_.\\-]+", " ", spaced))


def kind_of(name: str) -> tuple[str | None, int]:
    """What a column of this name holds, and its rank among columns of that kind (0 is best)."""
    words = words_of(name)
    if words in _STEP:
        return None, 0
    if _VOID_RATIO.fullmatch(plain(name)):
        return VOID_RATIO, len(_PARTS[VOID_RATIO])
    if _STATISTICS.intersection(words.split()):
        return OTHER, 0
    for kind, parts in _PARTS.items():
        for rank, part in enumerate(parts):
            if part in words or (" " in part and part.replace(" ", "") in words):
                return kind, rank
    for kind, names in _WHOLE.items():
        if words.rstrip("0123456789 #") in names:
            return kind, len(_PARTS[kind])
    return None, 0


def ends_with_a_name(text: str) -> bool:
    """Whether the text ends with a whole word for what a column holds: "axialLoad"."""
    words = words_of(text)
    return any(words.endswith(part) for parts in _PARTS.values() for part in parts)


def names_specimens(name: str) -> bool:
    """Whether a column of this name says to which specimen a row belongs."""
    return words_of(name).strip(" :#") in _SPECIMENS


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
