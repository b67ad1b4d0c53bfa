"""The words of testing machines: what a column is called, and of which test.

They stand in `vocabulary.toml`, by what they mean and by language, and are checked when it is
read.  Names are compared without accents and case, as words however they were joined (snake_case,
camelCase).
"""

import re
import unicodedata
from collections.abc import Iterable, Mapping
from enum import StrEnum
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal

import pint
from pydantic import AfterValidator, BaseModel, ConfigDict

from calibrate.core.errors import BadValue, shown, suggestion
from calibrate.core.units import registry
from calibrate.io.labfile import read_toml, validated
from calibrate.labtests.composite import TYPES

RECORDED = {name: kind.record for name, kind in TYPES.items() if kind.record is not None}
FILE = Path(__file__).with_name("vocabulary.toml")
_SHORTEST = 3  # letters of a word that is searched for inside names
_SYMBOLS = "symbols"
_SYMBOL_RANK = 15  # after all words
_VOID_RATIO = re.compile(r"e|e[\s_]*\(\w{1,12}\)|e[\s_]+[a-z]{0,4}\d{1,3}|e[1-9]\d?")

Lists = Mapping[str, tuple[str, ...]]  # words by language


class Quantity(StrEnum):
    """What a column of numbers holds."""

    OTHER = "other"
    SHEAR_STRENGTH = "undrained shear strength"
    STRENGTH = "compressive strength"
    VOID_RATIO = "void ratio"
    CONSOLIDATION = "degree of consolidation"
    ROOT_TIME = "root of time"
    STRESS = "stress"
    STRAIN = "strain"
    FORCE = "force"
    TIME = "time"
    DISPLACEMENT = "displacement"
    TORQUE = "torque"
    ANGLE = "angle"
    SHEAR_FORCE = "shear force"
    SHEAR_STRESS = "shear stress"
    SHEAR_DISPLACEMENT = "shear displacement"
    NORMAL_FORCE = "normal force"
    NORMAL_STRESS = "normal stress"
    NORMAL_DISPLACEMENT = "normal displacement"
    RESISTANCE = "resistance"
    DEPTH = "depth"

    @property
    def dimension(self) -> "Quantity":
        """The quantity whose units it is written in."""
        return _DIMENSIONS.get(self, self)

    @property
    def option(self) -> "Quantity":
        """The quantity whose option says its unit: a torque is a load, an angle a travel."""
        loads = {Quantity.TORQUE: Quantity.FORCE, Quantity.ANGLE: Quantity.DISPLACEMENT}
        return loads.get(self, self.dimension)


_DIMENSIONS = {
    Quantity.STRENGTH: Quantity.STRESS,
    Quantity.SHEAR_STRENGTH: Quantity.STRESS,
    Quantity.ROOT_TIME: Quantity.TIME,
    Quantity.SHEAR_FORCE: Quantity.FORCE,
    Quantity.SHEAR_STRESS: Quantity.STRESS,
    Quantity.SHEAR_DISPLACEMENT: Quantity.DISPLACEMENT,
    Quantity.NORMAL_FORCE: Quantity.FORCE,
    Quantity.NORMAL_STRESS: Quantity.STRESS,
    Quantity.NORMAL_DISPLACEMENT: Quantity.DISPLACEMENT,
    Quantity.RESISTANCE: Quantity.STRESS,
    Quantity.DEPTH: Quantity.DISPLACEMENT,
}
Kinds = tuple[Quantity, ...]  # of columns, beyond the usual ones, that a test's machine writes


def plain(text: str) -> str:
    """`text` in lower case without accents, on one line."""
    letters = unicodedata.normalize("NFKD", text.casefold())
    return " ".join("".join(c for c in letters if not unicodedata.combining(c)).split())


def words_of(name: str) -> str:
    """A name as words with blanks, however it was written: snake_case, camelCase, with dots."""
    spaced = re.sub(r"(?<=[a-zß-ÿ])(?=[A-Z])", " ", name)
    return plain(re.sub(r"[_.\\-]+", " ", spaced))


# ------------------------------------------------------------------ the file, checked


def _plain_word(word: str) -> str:
    if not plain(word):
        raise BadValue("the word is empty", "write a word, or leave it out")
    return plain(word)


def _searchable(lists: Lists) -> Lists:
    for language, words in lists.items():
        for word in words if language != _SYMBOLS else ():
            if word.isascii() and len(word) < _SHORTEST:
                problem = f"{shown(word)} is too short to be searched for inside names"
                raise BadValue(problem, f"write it under `{_SYMBOLS}`", language)
    return lists


def _one_meaning(meanings: Mapping[str, Mapping[str, Iterable[str]]]):
    found: dict[str, str] = {}
    for name, lists in meanings.items():
        for word in chain.from_iterable(lists.values()):
            if found.setdefault(word, name) != name:
                problem = f"{shown(word)} stands under {found[word]} too"
                raise BadValue(problem, "leave it under one of both", name)
    return meanings


def _known_tests(tests: dict[str, Lists]):
    for name in tests:
        if name not in TYPES:
            raise BadValue("no such test", suggestion(name, TYPES), name)
    return tests


def _recorded_tests(tests: dict[str, Lists]):
    for name in tests:
        if name not in RECORDED:
            raise BadValue("no test whose machine writes more", suggestion(name, RECORDED), name)
    return tests


def _known_units(units: dict[str, tuple[str, ...]]):
    _one_meaning({name: {"": map(str.casefold, words)} for name, words in units.items()})
    for name in units:
        number, _, unit = name.rpartition(" ")
        try:
            registry().Quantity(float(number or 1), unit)
        except (pint.PintError, ValueError):
            repair = 'write a unit that pint knows, such as "kPa" or "1000 lbf/ft^2"'
            raise BadValue("no such unit", repair, name) from None
    return units


Words = tuple[Annotated[str, AfterValidator(_plain_word)], ...]
ByLanguage = Annotated[dict[str, Words], AfterValidator(_searchable)]
Above = Literal["specimen", "diameter", "height", "mass", "density", "speed", "area", "void_ratio"]


class Section(BaseModel):
    """A section of the file, without unknown entries."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Names(Section):
    """Whole names of columns."""

    specimen: Words
    numbered: Words
    ending: Words
    whole: Words
    load_steps: Words
    negations: Words
    statistics: Words

    @cached_property
    def of_specimens(self) -> set[str]:
        """All names of a column that says to which specimen a row belongs."""
        words = (*self.specimen, *self.numbered)
        ended = (f"{word} {end}" for word in words for end in self.ending)
        return {*words, *ended, *self.whole}


class OtherTests(Section):
    """Signs of tests that are not simulated."""

    pressures: ByLanguage
    columns: ByLanguage
    names: ByLanguage


class DoubtfulUnit(Section):
    """Words of several sizes."""

    words: tuple[str, ...]
    why: str


class ForeignUnits(Section):
    """Units of something else than a curve of a test."""

    words: tuple[str, ...]
    letters: tuple[str, ...]


class PintUnits(Section):
    """Names of units in pint that laboratories use."""

    with_prefix: tuple[str, ...]
    prefixes: tuple[str, ...]
    alone: tuple[str, ...]


class OfTools(Section):
    """Words of tests with a tool, read where the user names such a test; `columns` are searched in
    the file's order, before the usual ones."""

    other: ByLanguage
    columns: Annotated[dict[Quantity, ByLanguage], AfterValidator(_one_meaning)]
    tool: dict[str, ByLanguage]
    signs: Annotated[dict[str, ByLanguage], AfterValidator(_recorded_tests)]
    units: dict[Quantity, Annotated[dict[str, tuple[str, ...]], AfterValidator(_known_units)]]


class Vocabulary(Section):
    """The whole file; `columns` and `tests` are searched in its order."""

    columns: Annotated[dict[Quantity, ByLanguage], AfterValidator(_one_meaning)]
    tools: OfTools
    names: Names
    above: dict[Above, ByLanguage]
    tests: Annotated[dict[str, ByLanguage], AfterValidator(_known_tests)]
    other_tests: OtherTests
    units: Annotated[dict[str, tuple[str, ...]], AfterValidator(_known_units)]
    doubtful_units: tuple[DoubtfulUnit, ...]
    foreign_units: ForeignUnits
    pint: PintUnits


def load(path: Path) -> Vocabulary:
    """The words of a file; `InputError` with the entry and the repair for the first slip in it."""
    return validated(Vocabulary, read_toml(path), str(path))


WORDS = load(FILE)

# ------------------------------------------------------------------ names of columns


def kind_of(name: str, kinds: Kinds = ()) -> tuple[Quantity | None, int]:
    """What a column of this name holds, and its rank among columns of that kind (0 is best);
    `kinds` beyond the usual ones come first."""
    words = words_of(name)
    if words in WORDS.names.load_steps:
        return None, 0
    if _VOID_RATIO.fullmatch(plain(name)):
        return Quantity.VOID_RATIO, _SYMBOL_RANK
    if not set(words.split()).isdisjoint(WORDS.names.statistics):
        return Quantity.OTHER, 0
    if kinds and holds(words, WORDS.tools.other):
        return Quantity.OTHER, 0
    further = {kind: lists for kind, lists in WORDS.tools.columns.items() if kind in kinds}
    for columns in (further, WORDS.columns):
        found = _kind_among(columns, words)
        if found is not None:
            return found
    return None, 0


def _kind_among(columns: Mapping[Quantity, Lists], words: str) -> tuple[Quantity, int] | None:
    """The first kind with a word inside these words, else the one with a symbol that they are."""
    for kind, lists in columns.items():
        ranks = [
            rank
            for language, parts in lists.items()
            if language != _SYMBOLS
            for rank, part in enumerate(parts)
            if is_in(words, part)
        ]
        if ranks:
            return kind, min(ranks)
    bare = words.rstrip("0123456789 #")
    for kind, lists in columns.items():
        if bare in lists.get(_SYMBOLS, ()):
            return kind, _SYMBOL_RANK
    return None


def holds(text: str, lists: Lists) -> bool:
    """Whether a text (as `words_of` or `plain` give it) holds one of these words, even if that was
    written as one word, or one of the symbols by itself."""
    alone = " ".join(["", *re.findall(r"\w+", text), ""])
    symbols = lists.get(_SYMBOLS, ())
    return any(is_in(text, w) for w in searched(lists)) or any(f" {s} " in alone for s in symbols)


def is_in(text: str, word: str) -> bool:
    return word in text or (" " in word and word.replace(" ", "") in text)


def searched(lists: Lists) -> Iterable[str]:
    """The words of all languages that are searched for inside names."""
    return (word for language, words in lists.items() if language != _SYMBOLS for word in words)


def ends_with_a_name(text: str) -> bool:
    """Whether the text ends with a whole word for what a column holds: "axialLoad"."""
    words = words_of(text)
    return any(words.endswith(part) for lists in WORDS.columns.values() for part in searched(lists))


def names_specimens(name: str) -> bool:
    """Whether a column of this name says to which specimen a row belongs."""
    return words_of(name).strip(" :#") in WORDS.names.of_specimens


# ------------------------------------------------------------------ names of tests

TESTS = tuple(WORDS.tests)  # types of tests (`calibrate.labtests`) that a file can be of


def _of_shape(shape: str) -> str:
    """The type of test that a curve's shape says."""
    return next(name for name, kind in TYPES.items() if kind.shape == shape)


# What a curve's shape and its points say, as one of `TESTS`.
SOFTENS, STIFFENS, LOAD_STEPS = (_of_shape(shape) for shape in ("softens", "stiffens", "steps"))


def test_named_in(text: str) -> str | None:
    """The test of `TESTS` that the text names, in any of the languages, or None."""
    words = plain(text)
    return next((test for test, lists in WORDS.tests.items() if holds(words, lists)), None)


def tool_test_in(texts: Iterable[str]) -> str | None:
    """The test of `RECORDED` that these texts are plainly of: one alone has its signs there."""
    words = [words_of(text) for text in texts]
    shown_by = [t for t, lists in WORDS.tools.signs.items() if any(holds(w, lists) for w in words)]
    return shown_by[0] if len(shown_by) == 1 else None
