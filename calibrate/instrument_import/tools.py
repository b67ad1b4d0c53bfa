"""Tests with tools: how large the tool is, under what was tested, and the columns as a curve.

    T, phi     F = 2 T/D        x = phi D/2     at the rim of a vane
    p          F = p A                          of a cone or a plate
    tau        F = tau A                        of a shear box

The `AbstractMachineRecord` of each test says so.  Sizes come from the command line, else from the
lines above the table, else they are the usual ones of the test, and a warning says that.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown
from calibrate.core.units import AREA, FORCE, LENGTH, STRESS, Kind, Range, quantity
from calibrate.instrument_import.preamble import Stated, quantity_in, words_above
from calibrate.instrument_import.sizes import Column, Converted, Size, stated_diameter
from calibrate.instrument_import.unittext import KEPT, KEPT_OF_TOOLS, unit_of
from calibrate.instrument_import.vocabulary import WORDS, Quantity, holds, plain, searched
from calibrate.io.labfile import validated
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.composite import TYPES
from calibrate.labtests.measured import AbstractMachineRecord, Cylinder, MachineColumn

Row = list[str]
Sentences = tuple[str, ...]
_KINDS: dict[Quantity, Kind] = {Quantity.STRESS: STRESS, Quantity.FORCE: FORCE}
_VARIES = 0.05  # of a condition; more within one specimen is a warning
_AMOUNT = re.compile(r"(\d+(?:[.,]\d+)?)\s*([A-Za-z/0-9^²]+)")


@dataclass(frozen=True, eq=False)
class Place:
    """Where a specimen stands: the lines that belong to its table, all lines above it and what
    these state, what it is called, its number in the file."""

    own: Sequence[Row]
    above: Sequence[Row]
    stated: Stated
    names: tuple[str, ...]
    number: int


@dataclass(frozen=True, eq=False)
class Tool:
    """A test before its curves: `entries` of a lab file, the test that they make, the `cylinder`
    (m) of soil, what it was tested under (SI), None where its record has nothing of that kind.

    `mould` has the sizes of the cylinder that the user gives; `not_said` names entries that no
    record says; `notes` and `warnings` are sentences.
    """

    record: AbstractMachineRecord
    entries: dict[str, Any]
    test: AbstractLabTest
    cylinder: Cylinder
    mould: Size
    condition: float | None
    not_said: str
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    def bed(self, test: AbstractLabTest) -> Cylinder:
        """The soil of the test, as far as its curves go: with room for it, unless it is known."""
        if self.record.own_bed:
            return self.cylinder
        room = self.record.bed(test)
        return Cylinder(self.mould.diameter or room.diameter, self.mould.height or room.height)

    def travel(self, kind: Quantity) -> MachineColumn:
        """What the record says of this kind of travel."""
        return _of_kind(self.record.travels, kind)

    def per(self, kind: Quantity) -> float:
        """N or mm in one kept unit of a column of this kind."""
        column = _of_kind((*self.record.loads, *self.record.travels), kind)
        return column.per(self.test, self.cylinder)

    def converted(self, load: Column, travel: Column) -> Converted:
        """Both columns as force and displacement of the test's curve."""
        words = [self._words(what, each) for what, each in (("force", load), ("travel", travel))]
        return Converted(
            force_n=load.values * self.per(load.kind),
            displacement_mm=travel.values * self.per(travel.kind),
            diameter=getattr(self.test, "diameter", self.cylinder.diameter),
            height=self.cylinder.height if self.record.own_bed else None,
            void_ratio=None,
            sentences=tuple(filter(None, words)),
        )

    def _words(self, what: str, column: Column) -> str:
        said = _of_kind((*self.record.loads, *self.record.travels), column.kind).said
        per = self.per(column.kind)
        if per == 1.0:
            return f"{column.words} is taken as {said}" if said else ""
        taken = f", taken as {said}," if said else ""
        kept = (KEPT | KEPT_OF_TOOLS)[column.kind.dimension]
        unit = "N" if what == "force" else "mm"
        return f"{what} is {column.words}{taken} times {per:.6g} {unit} per {kept}"


def _of_kind(columns: Sequence[MachineColumn], kind: Quantity) -> MachineColumn:
    return next(column for column in columns if column.kind == kind)


def made(test: str, entries: dict[str, Any]) -> AbstractLabTest:
    """The test that these entries of a lab file make; `BadValue` where one cannot be."""
    for name, written in entries.items():
        for allowed in TYPES[test].model_fields[name].metadata:
            if isinstance(allowed, Range) and not allowed.holds(quantity(written, allowed.kind)):
                problem = f"{name.replace('_', ' ')} {written} of the {TYPES[test].title} test"
                problem += f" is outside {allowed.low} to {allowed.high}"
                raise BadValue(problem, "check the units of the file and the sizes that are given")
    try:
        return validated(TYPES[test], {"type": test, **entries}, test)
    except InputError as bad:
        raise BadValue(f"{bad.field.replace('_', ' ')}: {bad.problem}", bad.repair) from None


def tool_of(test: str, size: Size, place: Place, condition: Column | None) -> Tool:
    """The test of a specimen; `condition` is its column of what it was tested under.

    Raises `BadValue` for a size that cannot be, and a condition that nobody states.
    """
    record = TYPES[test].record
    assert record is not None  # the caller asks for such tests alone
    own = _own_bed(record, size, place.stated) if record.own_bed else None
    sizes, *sizes_said = (
        _tool_sizes(test, record, size, place.above) if own is None else ((), (), ())
    )
    entries, not_said = record.entries(sizes)
    cylinder, notes, warnings = own or (None, *sizes_said)
    under = None
    if record.condition and cylinder is not None:
        under, text, varies = _condition(record, size, place, condition, cylinder)
        notes, warnings = (*notes, text), (*warnings, *varies)
        entries = {record.condition: f"{1e-3 * under:.6g} kPa", **entries}
    known = made(test, entries)
    return Tool(
        record=record,
        entries=entries,
        test=known,
        cylinder=cylinder or record.bed(known),
        mould=size,
        condition=under,
        not_said=not_said,
        notes=notes,
        warnings=warnings,
    )


def _own_bed(
    record: AbstractMachineRecord, size: Size, stated: Stated
) -> tuple[Cylinder, Sentences, Sentences]:
    """The specimen that was tested, of the usual size where none is stated; in words, and what of
    it is assumed."""
    usual = record.bed(None)
    diameter = size.diameter or stated_diameter(stated)
    if len(size.tool) > 2:
        raise BadValue(f"{len(size.tool)} sizes of the {record.called}", "give --tool as its area")
    if size.tool:
        round_one, sides = size.tool[0], float(np.sqrt(4 / np.pi * np.prod(size.tool)))
        diameter = round_one if len(size.tool) == 1 else sides
    height = size.height or stated.quantities.get("height")
    found = Cylinder(diameter or usual.diameter, height or usual.height)
    wide, high = 1e3 * found.diameter, 1e3 * found.height
    about = f"{record.called} {wide:.5g} mm in diameter ({1e4 * found.area:.5g} cm2), "
    about += f"{high:.5g} mm high"
    missing = [
        option
        for known, option in ((diameter, "--tool, a width or an area"), (height, "--height"))
        if known is None
    ]
    if not missing:
        return found, (about,), ()
    return found, (), (f"{about}: ASSUMED where the file does not say it ({', '.join(missing)})",)


def _tool_sizes(
    test: str, record: AbstractMachineRecord, size: Size, above: Sequence[Row]
) -> tuple[tuple[float, ...], Sentences, Sentences]:
    """The sizes of a tool (m), as many as are known; in words, and what of it is assumed."""
    if len(size.tool) > len(record.tool):
        known = " x ".join(record.tool)
        raise BadValue(f"{len(size.tool)} sizes of the {record.called}", f"give --tool as {known}")
    sizes = size.tool or tuple(_stated_sizes(record, above))
    if not sizes:
        usual = TYPES[test].model_fields[record.tool[0]].default
        text = (
            f"the file does not say how wide the {record.called} is: ASSUMED {1e3 * usual:.4g} mm"
        )
        return (usual,), (), (f"{text} (--tool)",)
    named = zip(record.tool, sizes, strict=False)
    about = ", ".join(f"{name} {1e3 * value:.5g} mm" for name, value in named)
    where = "as given" if size.tool else "as the file states"
    return sizes, (f"{record.called}: {about}, {where}",), ()


def _stated_sizes(record: AbstractMachineRecord, above: Sequence[Row]) -> Iterator[float]:
    """The sizes that lines which name the tool state, up to the first that none does."""
    lines = [" ".join(cell.strip() for cell in row if cell.strip()) for row in above]
    of_tool = [line for line in lines if holds(plain(line), WORDS.tools.tool[record.called])]
    width = _first(of_tool, LENGTH, words_above("diameter"))
    area = _first(of_tool, AREA, words_above("area"))
    if width is None and area is not None:
        width = float(np.sqrt(4 * area / np.pi))
    if width is not None:
        yield width
        if "height" in record.tool:
            height = _first(of_tool, LENGTH, words_above("height"))
            yield from (height,) if height is not None else ()


def _first(lines: Sequence[str], kind: Kind, words: Iterator[str]) -> float | None:
    """The quantity of the first line that states one under these words."""
    several = tuple(words)
    found = (quantity_in(line, kind, several)[0] for line in lines)
    return next((value for value in found if value is not None), None)


def _condition(
    record: AbstractMachineRecord,
    size: Size,
    place: Place,
    column: Column | None,
    cylinder: Cylinder,
) -> tuple[float, str, tuple[str, ...]]:
    """What a specimen was tested under (SI): as given, as its column, the lines above or its name
    say; that in words, and a warning where it varies."""
    called = record.condition.replace("_", " ")
    if size.normal_stresses is not None:
        several = size.normal_stresses
        value = several[0] if len(several) == 1 else several[place.number]
        return value, f"{called} {1e-3 * value:.5g} kPa, as given", ()
    if column is not None and np.isfinite(column.values).any():
        per = _of_kind(record.conditions, column.kind).per(None, cylinder)
        values = per * np.abs(column.values[np.isfinite(column.values)])
        value, span = float(np.median(values)), float(np.ptp(values))
        if value > 0:
            varies = f"the {called} varies by {1e-3 * span:.3g} kPa within the record"
            text = f"{called} {1e-3 * value:.5g} kPa, the median of {column.words}"
            return value, text, (varies,) if span > _VARIES * value else ()
    value, where = _stated_condition(record, place, cylinder)
    if value is None:
        problem = f"no column, no line above the table and no name states the {called}"
        raise BadValue(problem, 'give --normal-stress "50 kPa", or one a specimen in file order')
    return value, f"{called} {1e-3 * value:.5g} kPa, as {where} says", ()


def _stated_condition(
    record: AbstractMachineRecord, place: Place, cylinder: Cylinder
) -> tuple[float | None, str]:
    """A condition (SI) from the table's own lines, else the specimen's name, else the lines above
    earlier tables, the nearest first; and where it stands."""
    own = _condition_in_lines(record, place.own, cylinder)
    if own[0] is not None:
        return own
    for name in place.names:
        for number, written in _AMOUNT.findall(name):
            unit = unit_of(written)
            if unit is not None and unit.kind == Quantity.STRESS:
                value = 1e3 * unit.factor * float(number.replace(",", "."))
                return value, f"the name {shown(name, 30)}"
    return _condition_in_lines(record, place.above, cylinder)


def _condition_in_lines(
    record: AbstractMachineRecord, rows: Sequence[Row], cylinder: Cylinder
) -> tuple[float | None, str]:
    for row in reversed(rows):
        line = " ".join(cell.strip() for cell in row if cell.strip())
        for column in record.conditions:
            kind = Quantity(column.kind)
            words = tuple(searched(WORDS.tools.columns[kind]))
            value, _ = quantity_in(line, _KINDS[kind.dimension], words)
            if value is not None and value > 0:
                return value * column.per(None, cylinder), shown(line, 50)
    return None, ""
