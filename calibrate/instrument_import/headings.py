"""What stands above a column, taken apart: its name, its unit, the label of its specimen.

    Load (kN)   Kraft in N   F/N   axial_load_kN   forceKN   "Load" over "kN"   Load (lbs.)

A unit may stand in brackets, at the end after a blank or another sign, at the beginning, or in a
row of its own.  What stands in the place of a unit and is none is kept as `not_understood`: who
uses such a column has to refuse it.
"""

import re
from dataclasses import dataclass

from calibrate.core.errors import BadValue, shown
from calibrate.instrument_import.unittext import KEPT, Unit, doubt, unit_of
from calibrate.instrument_import.vocabulary import (
    WORDS,
    Kinds,
    Quantity,
    ends_with_a_name,
    kind_of,
)

NAMED_BY_UNIT = {  # what a name may mean once its unit is known
    (Quantity.STRAIN, Quantity.DISPLACEMENT): Quantity.DISPLACEMENT,
    (Quantity.DISPLACEMENT, Quantity.STRAIN): Quantity.STRAIN,
    (Quantity.FORCE, Quantity.STRESS): Quantity.STRESS,
    (Quantity.STRESS, Quantity.FORCE): Quantity.FORCE,
    (Quantity.VOID_RATIO, Quantity.STRAIN): Quantity.VOID_RATIO,
    (Quantity.CONSOLIDATION, Quantity.STRAIN): Quantity.CONSOLIDATION,
    (Quantity.TIME, Quantity.TORQUE): Quantity.TORQUE,
    (Quantity.FORCE, Quantity.TORQUE): Quantity.TORQUE,
    (Quantity.DISPLACEMENT, Quantity.ANGLE): Quantity.ANGLE,
    (Quantity.SHEAR_FORCE, Quantity.STRESS): Quantity.SHEAR_STRESS,
    (Quantity.SHEAR_STRESS, Quantity.FORCE): Quantity.SHEAR_FORCE,
    (Quantity.NORMAL_FORCE, Quantity.STRESS): Quantity.NORMAL_STRESS,
    (Quantity.NORMAL_STRESS, Quantity.FORCE): Quantity.NORMAL_FORCE,
    (Quantity.NORMAL_DISPLACEMENT, Quantity.STRAIN): Quantity.NORMAL_DISPLACEMENT,
    (Quantity.RESISTANCE, Quantity.FORCE): Quantity.FORCE,
    (Quantity.DEPTH, Quantity.FORCE): Quantity.FORCE,
    (Quantity.DEPTH, Quantity.STRESS): Quantity.RESISTANCE,
}
_BRACKETS = re.compile(r"[\[(（【<{]\s*([^\[\]()（）【】<>{}]{1,40})\s*[\])）】>}]")
_PERCENT = re.compile(r"%\s*([^\W\d].*)|(.*[^\W\d])%")  # "%settlement", "strain%"
_LABEL = re.compile(
    r"#?\s*(?:[A-Za-z]{0,3}[-_ ]?\d{1,3}|[A-UW-Z])"
)  # of a specimen: (1), (M2), (B)
_GLUED = re.compile(
    r"(.*?[a-z])((?:[kKMG]|da)?N|[kKMGh]?P[aA]|mm|cm|um|in|sec|min|kgf?|lbf?s?|psi|kips?)"
)
_NEW_WORD = re.compile(r"(?<=[a-zß-ÿ])(?=[A-Z0-9‰%])|(?<=[^\W\d_a-zA-Z])(?=[A-Za-z‰%])")
_NUMBERED = re.compile(r"(.*[^\W\d])[\s_.#]+(\d{1,3})")  # "displacement_mm_1"
_TIMES = re.compile(r"(?:\d+[ .,/^-]\s?\d+|[x×*]\s?\d+|\d{2,})$", re.IGNORECASE)  # 0.01, 10
_MOST = 4  # words of a unit: "kg per sq cm"
_IN = ("in", "en")  # before a unit
_ALONE = ("in", "min", "bar", "day", "std", "pa")  # words that are no units before a name
_LABELLED = (
    Quantity.VOID_RATIO,
    Quantity.CONSOLIDATION,
)  # kinds whose brackets hold labels: "void ratio (A)"


@dataclass(frozen=True, eq=False)
class Heading:
    """What stands above one column: its name, its unit if written, the label of a group of
    columns ("Specimen 2") if there is one, and what stands in the place of a unit and is none."""

    name: str
    unit: Unit | None
    label: str = ""
    not_understood: str = ""

    def words(self) -> str:
        written = self.unit.name if self.unit else self.not_understood
        return f"{self.name} [{written}]" if self.unit or written else self.name


def split_heading(text: str, kinds: Kinds = ()) -> Heading:
    """A column's heading without its unit, and the unit: "Load (kN)", "Kraft in N", "F/N"; `kinds`
    of columns beyond the usual ones."""
    text = " ".join(text.split())
    percent = _PERCENT.fullmatch(text)
    if percent:
        return Heading(percent[1] or percent[2], unit_of("%"))
    brackets = list(_BRACKETS.finditer(text))
    if kind_of(text, kinds)[0] == Quantity.ROOT_TIME:
        return Heading(text, _of_root([match[1] for match in brackets]))
    for match in brackets:
        unit, name = unit_of(match[1], kinds), _without(text, match)
        sure = unit is not None and not unit.by_weight and match[1].strip() != "1"
        if unit is not None and (sure or fits(name, unit, kinds)):
            return Heading(name, unit)
    strange = [m for m in brackets if not _LABEL.fullmatch(m[1].strip())]
    bare = _BRACKETS.sub(" ", text).strip() if brackets else text
    number = _NUMBERED.fullmatch(bare)
    bare = number[1] if number else bare
    found = _apart(bare, kinds)
    times = _TIMES.search(found[0]) if found else None
    if found is not None and times:
        return Heading(text, None, "", f"{times[0].strip()} {found[1].name}")
    if found is not None:
        label = [number[2]] if number else [match[0] for match in brackets[:1]]
        return Heading(" ".join([found[0].strip(" -,:;"), *label]), found[1])
    if strange and kind_of(bare, kinds)[0] not in _LABELLED:
        return Heading(_without(text, strange[0]), None, "", strange[0][1].strip())
    return Heading(text, None, "", _strange_end(text, kinds))


def _apart(text: str, kinds: Kinds) -> tuple[str, Unit] | None:
    """Name and unit that are written without brackets."""
    ways = (_at_the_end, _at_the_beginning, _glued, _behind_a_stroke)
    return next(filter(None, (way(text, kinds) for way in ways)), None)


def _of_root(written: list[str]) -> Unit | None:
    """The unit of time in brackets of a root of time: "sqrt(min)", "root time (min^0.5)"."""
    bare = (re.sub(r"√|\^?\(?0[.,]5\)?$|½$", "", text.strip()) for text in written)
    units = [unit for text in bare if (unit := unit_of(text)) and unit.kind == Quantity.TIME]
    return units[-1] if units else None


def heading_of(name: str, cells: list[str], label: str, kinds: Kinds = ()) -> Heading:
    """The heading of one column from its name and the cells of rows of units under or over it."""
    head = split_heading(name, kinds)
    written = [cell for cell in cells if cell]
    units = [unit for cell in written if (unit := unit_of(cell, kinds))]
    if head.unit and units and not _same(head.unit, units[0]):
        problem = f"column {shown(name, 40)} has two units, {head.unit.name} and {units[0].name}"
        raise BadValue(problem, "correct the unit in the heading")
    unit = units[0] if units else head.unit
    strange = "" if unit else next(iter(written), head.not_understood)
    return Heading(head.name, unit, label, strange.strip("[]() "))


def refused_unit(heading: Heading, kind: Quantity) -> BadValue:
    """Why a column whose unit is not understood cannot be used, and the option that settles it."""
    written = heading.not_understood
    why = doubt(written) or "is not known"
    problem = f"unit {shown(written, 20)} of column {shown(heading.name, 30)} {why}"
    return BadValue(problem, unit_option(kind))


def unit_option(kind: Quantity) -> str:
    """How the unit of a column of this kind is given on the command line."""
    examples = {"force": "kN", "strain": "%", "time": "min", "torque": '"N m"', "angle": "deg"}
    example = examples.get(kind.dimension) or KEPT[kind.dimension]
    return f"give --{kind.option}-unit, such as --{kind.option}-unit {example}"


def _same(one: Unit, other: Unit) -> bool:
    """Whether two written units are of one kind and size."""
    return one.kind == other.kind and abs(one.factor / other.factor - 1) < 1e-5


def fits(name: str, unit: Unit, kinds: Kinds = ()) -> bool:
    """Whether a column of this name can have this unit."""
    kind = kind_of(name, kinds)[0]
    return kind is not None and meant(kind, unit.kind) is not None


def meant(kind: Quantity, unit: Quantity) -> Quantity | None:
    """What a column holds whose name says this kind and whose unit is one of that; None where both
    contradict each other."""
    return kind if unit == kind.dimension else NAMED_BY_UNIT.get((kind, unit))


def _without(text: str, match: re.Match) -> str:
    return " ".join((text[: match.start()] + " " + text[match.end() :]).split())


def _at_the_end(text: str, kinds: Kinds) -> tuple[str, Unit] | None:
    """Name and unit of "Load kN", "stress_N_mm2", "Kraft in N", "F/N", "strain, mm per mm"."""
    words = re.split(r"[\s_,;:]+|(?<=[^\W\d])\.(?=[^\W\d])|(?<=[^\W\d]{2})-(?=[^\W\d])", text)
    words = [word for word in words if word]
    for count in range(min(_MOST, len(words) - 1), 0, -1):
        name, tail = _name(words[:-count]), words[-count:]
        ways = (" ".join(tail), "/".join(tail), "".join(tail))
        preposition = tail[0].casefold() in _IN and len(set(tail)) > 1
        for joined in dict.fromkeys(ways[:1] if preposition else ways):
            unit = _unit_at_the_end(joined, name, count, kinds)
            if unit is not None:
                return name, unit
    return None


def _behind_a_stroke(text: str, kinds: Kinds) -> tuple[str, Unit] | None:
    """Name and unit of "F/N"."""
    before, slash, after = text.rpartition("/")
    unit = unit_of(after, kinds) if slash else None
    fitting = unit is not None and before and _may_be(unit, after, before, kinds)
    return (before.strip(), unit) if unit is not None and fitting else None


def _name(words: list[str]) -> str:
    """The words before a unit; "in" and "en" belong to neither."""
    words = words[:-1] if len(words) > 1 and words[-1].casefold() in _IN else words
    return " ".join(words)


def _unit_at_the_end(text: str, name: str, count: int, kinds: Kinds) -> Unit | None:
    if text[0] in "-–—" or (text[0].isdigit() and not any(c.isalpha() for c in text)):
        return None  # the number of a specimen, not a pure number
    if count > 1 and text == "".join(text.split()) and "/" not in text and len(text) < 3:
        return None
    unit = unit_of(text, kinds)
    if (
        unit is not None
        and count > 1
        and unit.kind == Quantity.STRAIN
        and kind_of(name, kinds)[0] != Quantity.STRAIN
    ):
        return None  # "Displacement in in"
    return unit if unit is not None and _may_be(unit, text, name, kinds) else None


def _may_be(unit: Unit, text: str, name: str, kinds: Kinds) -> bool:
    """Whether a word after a name is its unit: it fits the name, or is long enough not to be
    anything else ("delta_h" is no time)."""
    if fits(name, unit, kinds):
        return True
    short = len(text.strip(".()[]")) < 2 or text.casefold() in _ALONE
    return kind_of(name, kinds)[0] in (None, Quantity.OTHER) and not short


def _at_the_beginning(text: str, kinds: Kinds) -> tuple[str, Unit] | None:
    """Name and unit of "kN Load", "mm_displacement"."""
    first, _, rest = text.replace("_", " ").partition(" ")
    alone = not rest or len(first) < 2 or first.casefold() in _ALONE
    unit = None if alone else unit_of(first, kinds)
    return (rest, unit) if unit is not None and fits(rest, unit, kinds) else None


def _glued(text: str, kinds: Kinds) -> tuple[str, Unit] | None:
    """Name and unit of "forceKN", "cargaAxialKg", "displacementmm", "应变mm/mm"."""
    for new in _NEW_WORD.finditer(text):
        name, unit = text[: new.start()], unit_of(text[new.start() :], kinds)
        if unit is not None and fits(name, unit, kinds):
            return name, unit
    lower = _GLUED.fullmatch(text)
    unit = unit_of(lower[2], kinds) if lower and ends_with_a_name(lower[1]) else None
    fitting = lower and unit is not None and fits(lower[1], unit, kinds)
    return (lower[1], unit) if lower and unit is not None and fitting else None


def _strange_end(text: str, kinds: Kinds) -> str:
    """The last word of a heading where it is a unit of something else: "Load mV", "Force_N/foo"."""
    words = [word for word in re.split(r"[\s_,;:]+", text) if word]
    kind = kind_of(" ".join(words[:-1]), kinds)[0]
    if len(words) < 2 or kind in (None, Quantity.OTHER):
        return ""
    last, foreign = words[-1], WORDS.foreign_units
    if last.casefold().strip(".") in foreign.words or last in foreign.letters or doubt(last):
        return last
    loads = kind in (Quantity.STRESS, Quantity.FORCE)
    if loads and re.fullmatch(r"(?:[cdm]?m|in|ft)[\^]?[2²]", last.casefold()):
        return " ".join(words[-2:])
    parts = [part for part in re.split(r"[/^*]", last) if part]
    looks = len(parts) > 1 and any(unit_of(part, kinds) for part in parts)
    return last if looks else ""
