"""Is a quantity of a lab file what was meant?  Most slips are of units, and land far outside.

Every entry with a unit says where it usually lies (`Range`, in its own description).  What lies
outside is refused, with the unit among the usual ones that would bring it inside; `accept` in the
lab file names the entries that are meant as they stand.  This looks at what is written, before
anything is built from it: what cannot be read as a quantity is refused elsewhere.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.core.tables import AbstractTable
from calibrate.core.units import (
    FORCE,
    LENGTH,
    STRAIN,
    STRESS,
    Kind,
    Range,
    number_of,
    quantity,
    unit_factor,
)
from calibrate.io.tables import ParticlesTable, SoilTable
from calibrate.labtests.base import AbstractLabTest, Observable
from calibrate.labtests.composite import PLAIN, TYPES
from calibrate.labtests.measured import Curve, CurveTable, Cylinder, SpecimenTable, TargetTable
from calibrate.labtests.protocol import StepTable
from jdem.materials.catalogue import EVERY

UNUSUAL = 30.0  # times beyond where a fit looks for a parameter
SLENDER = (0.1, 8.0)  # height over diameter
SCATTER = (1e-4, 1.0)  # over the mean
UNITS = {  # of each kind, the likeliest first
    "m": ("mm", "cm", "m", "um", "inch"),
    "N": ("N", "kN", "kgf", "MN"),
    "kPa": ("kPa", "MPa", "Pa", "bar"),
    "Pa": ("MPa", "kPa", "GPa", "Pa"),
    "kg/m^3": ("kg/m^3", "g/cm^3", "t/m^3", "lb/ft^3"),
    "m/s": ("mm/s", "mm/min", "m/s", "um/s"),
    "s": ("s", "min", "h", "ms", "day"),
    "1/s": ("%/min", "%/s", "%/h", "1/s"),
    "": ("%",),
    "J": ("J", "mJ", "kJ"),
    "J/m^2": ("J/m^2", "mJ/m^2"),
    "J/m^3": ("J/m^3", "kJ/m^3"),
    "N/m^3": ("N/m^3", "kN/m^3", "MN/m^3", "GN/m^3"),
}
BY_SIZE = {STRESS: FORCE, STRAIN: LENGTH}  # what counts by the specimen's size


def spoken(value: float, kind: Kind) -> str:
    """A value (`kind.unit`) in the first usual unit that gives it one to three places."""
    amounts = [(value / unit_factor(unit, kind), unit) for unit in UNITS[kind.unit]]
    amount, unit = next((a for a in amounts if 1 <= abs(a[0]) < 1000), amounts[0])
    return f"{amount:.4g} {unit}"


class Plausibility:
    """Checks the entries of one lab file; `accepted` are the names of those that are meant."""

    def __init__(self, file: str, accepted: list[str]):
        self.file = file
        self.accepted = accepted
        self.seen: list[str] = []

    def tables(self, raw: Mapping[str, Any]) -> None:
        """All entries but curves, as they stand in the file."""
        self._table(SoilTable, raw.get("soil"), "soil", None)
        size = self._specimen(raw.get("specimen"), "specimen", None)
        self._table(ParticlesTable, raw.get("particles"), "particles", None)
        found = raw.get("targets")
        given = found if isinstance(found, dict) else {}
        for name, kind in PLAIN.items():
            self._test(kind, raw.get(name), name, size)
            for observable in kind.every():
                where = f"targets.{observable.short}"
                self._target(observable, given.get(observable.short), where, size)
        for field, table in _listed(raw.get("tests"), "tests"):
            kind = TYPES.get(str(table.get("type")))
            if kind is not None:
                size = self._test(kind, table, field, size)
        self._parameters(raw)

    def curve(
        self, curve: Curve, table: CurveTable, cylinder: Cylinder, field: str, test: AbstractLabTest
    ) -> None:
        """The largest force and way of a curve that was read; those without soil are a machine's
        own, whose ways are small, and those of a tool do not press the specimen as a whole."""
        force, way = float(curve.force_n.max()), float(np.abs(curve.displacement_mm).max())
        least = "0.05 kPa" if curve.points else "0.5 kPa"
        whole = test.with_soil and test.record is None
        loads = Range(STRESS, least if whole else "0.005 kPa", "20 MPa")
        most = "100 %" if test.record is None else "1000 %"
        ways = Range(STRAIN, "0.02 %" if whole else "0 %", most)
        if table.force is not None:
            said = "largest force", force, force / table.force.unit, FORCE
            self._column(*said, loads, cylinder, f"{field}.force.unit")
        elif table.stress is not None:
            newtons = 1e3 * cylinder.area  # of one kPa
            said = "largest force", force, force / (table.stress.unit * newtons), STRESS
            self._column(*said, loads, cylinder, f"{field}.stress.unit")
        if table.displacement is not None:
            said = "largest displacement", 1e-3 * way, way / table.displacement.unit, LENGTH
            self._column(*said, ways, cylinder, f"{field}.displacement.unit")
        elif table.strain is not None:
            strain = way / (1e3 * cylinder.height)
            said = "largest strain", 1e-3 * way, strain / table.strain.unit, STRAIN
            self._column(*said, ways, cylinder, f"{field}.strain.unit")

    def repeats(self, mean: float, observable: Observable, cylinder: Cylinder, field: str) -> None:
        """The mean of a column of repeats, in the unit of its observable."""
        self._written(f"{mean!r} {observable.unit}", (observable.usual,), field, cylinder)

    def finish(self) -> None:
        """Refuses an entry of `accept` that names nothing."""
        for number, name in enumerate(self.accepted):
            if name not in self.seen and name not in {_plain(seen) for seen in self.seen}:
                problem = f"{shown(name)} is no entry of this file whose size is checked"
                known = dict.fromkeys(self.seen)
                repair = suggestion(name, known) if known else "leave it out"
                raise InputError(self.file, f"accept[{number}]", problem, repair)

    # ---- tables

    def _table(self, model: type[AbstractTable], raw: Any, field: str, size: Cylinder | None):
        """Every entry of one table that says where it usually lies."""
        for name, info in model.model_fields.items() if isinstance(raw, dict) else ():
            ranges = tuple(each for each in info.metadata if isinstance(each, Range))
            written = raw.get(info.alias or name)
            each = written if isinstance(written, list) else [written]
            for number, one in enumerate(each if ranges else ()):
                place = f"[{number}]" if isinstance(written, list) else ""
                self._written(one, ranges, f"{field}.{info.alias or name}{place}", size)

    def _specimen(self, raw: Any, field: str, before: Cylinder | None) -> Cylinder | None:
        """The size that a table [specimen] states, as far as it can be read."""
        if not isinstance(raw, dict):
            return before
        self._table(SpecimenTable, raw, field, None)
        sizes = [_read(raw.get(name), LENGTH) for name in ("diameter", "height")]
        diameter, height = (float(size or 0.0) for size in sizes)
        if diameter <= 0 or height <= 0:
            return before
        if not SLENDER[0] <= height / diameter <= SLENDER[1]:
            self._refuse(
                f"{field}.height",
                f"a specimen of {raw['diameter']} by {raw['height']} is {height / diameter:.3g} "
                f"times as high as wide, where {SLENDER[0]:g} to {SLENDER[1]:g} is usual",
                next(_sized(raw), ""),
            )
        self.seen.append(f"{field}.height")
        return Cylinder(diameter, height)

    def _test(
        self, kind: type[AbstractLabTest], raw: Any, field: str, size: Cylinder | None
    ) -> Cylinder | None:
        """One test; the specimen that the next one goes on with."""
        if not isinstance(raw, dict):
            return size
        size = self._specimen(raw.get("specimen"), f"{field}.specimen", size)
        self._table(kind, raw, field, size)
        for place, step in _listed(raw.get("protocol"), f"{field}.protocol"):
            self._table(StepTable, step, place, size)
        targets = raw.get("targets")
        for name, table in targets.items() if isinstance(targets, dict) else ():
            for observable in kind.every():
                if name in (observable.name, observable.short):
                    self._target(observable, table, f"{field}.targets.{name}", size)
        return size

    def _target(self, observable: Observable, raw: Any, field: str, size: Cylinder | None) -> None:
        """Mean and scatter of what was measured."""
        if not isinstance(raw, dict):
            return
        self._table(TargetTable, raw, field, size)
        self._written(raw.get("mean"), (observable.usual,), f"{field}.mean", size)
        mean, scatter = (_value(raw.get(n), observable.usual, size) for n in ("mean", "scatter"))
        if not mean or not scatter:
            return
        self.seen.append(f"{field}.scatter")
        if not SCATTER[0] <= scatter / mean <= SCATTER[1]:
            said = f"{shown(raw['scatter'])} is {scatter / mean:.3g} times the mean, {raw['mean']}"
            allowed = f"{SCATTER[0]:g} to {SCATTER[1]:g} is usual"
            wanted = [
                text
                for text in _rewritten(raw["scatter"], observable.usual)
                if (value := _value(text, observable.usual, size)) is not None
                and SCATTER[0] <= value / mean <= SCATTER[1]
            ]
            self._refuse(f"{field}.scatter", f"{said}, where {allowed}", next(iter(wanted), ""))

    def _parameters(self, raw: Mapping[str, Any]) -> None:
        """Values and bounds of parameters that have a unit and that a fit may look for."""
        for name, entry in EVERY.items():
            if entry.search is None or entry.unit not in UNITS or not entry.unit:
                continue
            kind = Kind(entry.label, entry.unit, entry.repair)
            ends = entry.search.low / UNUSUAL, entry.search.high * UNUSUAL
            allowed = Range(kind, *(spoken(end, kind) for end in ends))
            for field, written in _stated(raw, name):
                bare = not isinstance(written, str) or number_of(written) == written.strip()
                text = f"{written} {entry.unit}" if bare else written
                self._written(text, (allowed,), field, None)

    # ---- one entry

    def _written(
        self, written: Any, ranges: tuple[Range, ...], field: str, size: Cylinder | None
    ) -> None:
        """Refuses a quantity outside of the range of its kind."""
        for allowed in ranges:
            value = _value(written, allowed, size)
            if value is None:
                continue
            self.seen.append(field)
            if not allowed.holds(value):
                meant = [t for t in _rewritten(written, allowed) if _fits(t, allowed, size)]
                problem = _outside(written, value, allowed, field, size)
                self._refuse(field, problem, next(iter(meant), ""))
            return

    def _column(
        self, what: str, value: float, number: float, kind: Kind, allowed: Range, size: Cylinder,
        field: str,
    ) -> None:  # fmt: skip
        """Refuses a column whose largest value (N or m), which is a `number` of some unit of a kind
        in the file, lies outside."""
        text = f"{value!r} {'m' if allowed.kind is STRAIN else 'N'}"
        self.seen.append(field)
        found = _value(text, allowed, size)
        if found is None or allowed.holds(found):
            return
        meant = [
            unit for unit in UNITS[kind.unit] if _fits(f"{number!r} {unit}".strip(), allowed, size)
        ]
        problem = f"the {what} of the curve, {number:.4g} in this unit, "
        problem += _words(value, found, allowed, size)
        self._refuse(field, problem, f'unit = "{meant[0]}"' if meant else "")

    def _refuse(self, field: str, problem: str, meant: str) -> None:
        """Unless the lab file accepts the entry."""
        if field in self.accepted or _plain(field) in self.accepted:
            return
        repair = f"is {meant} meant?" if meant else "check number and unit."
        repair += f' If it is right as it is, add accept = ["{field}"] above the first table'
        raise InputError(self.file, field, problem, repair)


def _outside(written: Any, value: float, allowed: Range, field: str, size: Cylinder | None) -> str:
    """What is odd about a quantity."""
    related = _read(written, allowed.kind) is None
    if related and size is not None:
        amount = _read(written, BY_SIZE[allowed.kind]) or 0.0
        return f"{shown(written)} {_words(amount, value, allowed, size)}"
    entry = _plain(field).rpartition(".")[2].replace("_", " ")
    return f"{shown(written)} is outside {allowed.low} to {allowed.high}, the usual {entry}"


def _words(amount: float, value: float, allowed: Range, size: Cylinder) -> str:
    """What a force (N) or a length (m) is to the specimen, and what is usual."""
    if allowed.kind is STRESS:
        on = f"is {spoken(value, STRESS)} on the specimen, {1e3 * size.diameter:.4g} mm wide"
    else:
        on = f"is {value:.3g} times the specimen's height of {1e3 * size.height:.4g} mm"
    return f"{on}; {allowed.low} to {allowed.high} is usual"


def _value(written: Any, allowed: Range, size: Cylinder | None) -> float | None:
    """The number of `allowed.kind.unit` that is written; None where that cannot be said."""
    value = _read(written, allowed.kind)
    if value is not None or size is None or allowed.kind not in BY_SIZE:
        return value
    amount = _read(written, BY_SIZE[allowed.kind])
    if amount is None:
        return None
    return amount / (1e3 * size.area if allowed.kind is STRESS else size.height)


def _read(written: Any, kind: Kind) -> float | None:
    """A quantity of this kind; None where something else is written."""
    try:
        return quantity(written, kind)
    except BadValue:
        return None


def _rewritten(written: Any, allowed: Range) -> list[str]:
    """The same number in the other usual units of its kind."""
    kinds = [allowed.kind, *([BY_SIZE[allowed.kind]] if allowed.kind in BY_SIZE else [])]
    number = number_of(written)
    found = [f"{number} {u}" for k in kinds if _read(written, k) is not None for u in UNITS[k.unit]]
    if allowed.kind.unit == "":
        found.append(f"{100 * float(number or 0):g} %")
    return found


def _fits(text: str, allowed: Range, size: Cylinder | None) -> bool:
    value = _value(text, allowed, size)
    return value is not None and value > 0 and allowed.holds(value)


def _sized(raw: Mapping[str, Any]) -> Iterator[str]:
    """Another unit of height or diameter that makes a specimen of usual proportions."""
    for name, other in (("height", "diameter"), ("diameter", "height")):
        fixed = _read(raw[other], LENGTH) or 1.0
        for unit in UNITS["m"]:
            text = f"{number_of(raw[name])} {unit}"
            value = _read(text, LENGTH) or 0.0
            ratio = value / fixed if name == "height" else fixed / max(value, 1e-12)
            allowed = next(m for m in SpecimenTable.model_fields[name].metadata if type(m) is Range)
            if SLENDER[0] <= ratio <= SLENDER[1] and allowed.holds(value):
                yield f"{name} {text}"


def _listed(given: Any, field: str) -> list[tuple[str, dict]]:
    """The tables of a list with where they stand."""
    rows = given if isinstance(given, list) else []
    return [(f"{field}[{k}]", row) for k, row in enumerate(rows) if isinstance(row, dict)]


def _stated(raw: Mapping[str, Any], name: str) -> Iterator[tuple[str, Any]]:
    """All places where a parameter's value or bound is given."""
    chosen = raw.get("parameters")
    given = chosen.get(name) if isinstance(chosen, dict) else None
    if isinstance(given, dict):
        for key in ("value", "low", "high"):
            if key in given:
                yield f"parameters.{name}" + ("" if key == "value" else f".{key}"), given[key]
        moist = given.get("by_moisture")
        for text, value in moist.items() if isinstance(moist, dict) else ():
            yield f'parameters.{name}.by_moisture."{text}"', value
    elif given is not None:
        yield f"parameters.{name}", given
    sets = raw.get("named_sets")
    for called, values in sets.items() if isinstance(sets, dict) else ():
        if isinstance(values, dict) and name in values:
            yield f"named_sets.{called}.{name}", values[name]


def _plain(field: str) -> str:
    """The field without the number in a list at its end: soil.density[0] is soil.density."""
    return field[: field.rindex("[")] if field.endswith("]") else field
