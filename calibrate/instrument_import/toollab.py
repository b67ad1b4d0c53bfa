"""The lab file of tests with tools: how far their curves go, and which numbers they hold.

    curves -> entries -> test -> numbers -> [[tests]] with targets

Curves are drawn beside simulated ones; a fit compares the numbers that they hold, as targets.
Specimens under the same condition with the same tool are repeats of one test.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibrate.core.errors import BadValue, InputError
from calibrate.core.units import Range, quantity
from calibrate.instrument_import import labtext
from calibrate.instrument_import.convert import Export
from calibrate.instrument_import.labtext import entry, inline
from calibrate.instrument_import.specimens import Specimen
from calibrate.instrument_import.tools import Tool, made
from calibrate.instrument_import.vocabulary import Quantity
from calibrate.labtests.base import AbstractLabTest, clean_name
from calibrate.labtests.measured import Curve, Cylinder, millimetres

SAME = 0.02  # relative; conditions that differ by less are one
ALONE, EQUAL = 0.10, 0.05  # scatter of one specimen over its number; of specimens without any
COLUMNS = {  # of a curve file, beside force and displacement, and what one kept unit is there
    Quantity.TORQUE: ("torque_nm", 1.0),
    Quantity.ANGLE: ("angle_deg", 180 / np.pi),
    Quantity.RESISTANCE: ("resistance_kpa", 1.0),
    Quantity.STRESS: ("stress_kpa", 1.0),
    Quantity.SHEAR_STRESS: ("shear_stress_kpa", 1.0),
}


@dataclass(frozen=True, eq=False)
class ToolTest:
    """Repeats of one test: its name and entries in a lab file, the test that these make on a
    `cylinder` (m), and the numbers of each specimen (specimens,) by observable, in its unit."""

    name: str
    entries: dict[str, Any]
    test: AbstractLabTest
    cylinder: Cylinder
    tool: Tool
    specimens: tuple[Specimen, ...]
    numbers: dict[str, np.ndarray]


def tool_tests(export: Export) -> list[ToolTest]:
    """The tests with tools of an export, none where it has no such test.

    Raises `InputError` for records that are too short, a mould without room and impossible numbers.
    """
    groups = _groups(export)
    try:
        return [_tool_test(group, len(groups) > 1) for group in groups]
    except BadValue as bad:
        raise InputError(export.file, "", bad.problem, bad.repair) from None


def _groups(export: Export) -> list[list[Specimen]]:
    """Repeats together, in file order; clipped records only where a group has no other."""
    groups: list[list[Specimen]] = []
    for specimen in (s for s in export.specimens if s.raw.tool is not None):
        alike = (g for g in groups if _alike(g[0].raw.tool, specimen.raw.tool))
        group = next(alike, None)
        if group is None:
            groups.append([specimen])
        else:
            group.append(specimen)
    return [[s for s in group if not s.clipped] or group for group in groups]


def _alike(one: Tool | None, other: Tool | None) -> bool:
    if one is None or other is None:
        return False
    name = one.record.condition
    mine, theirs = ({k: v for k, v in t.entries.items() if k != name} for t in (one, other))
    near = abs((one.condition or 1.0) / (other.condition or 1.0) - 1) <= SAME
    return near and mine == theirs and one.bed(one.test) == other.bed(other.test)


def _tool_test(group: Sequence[Specimen], several: bool) -> ToolTest:
    tool = group[0].raw.tool
    assert tool is not None  # as `_groups` has chosen
    kind, record, entries = group[0].test, tool.record, dict(tool.entries)
    name = kind
    if tool.condition is not None:
        stresses = [s.raw.tool.condition for s in group if s.raw.tool and s.raw.tool.condition]
        entries[record.condition] = f"{1e-3 * float(np.mean(stresses)):.6g} kPa"
        name = entries[record.condition]
    elif several:
        name = clean_name(f"{kind} {group[0].label}")
    curves = [Curve(kind, s.displacement_mm, s.force_n, "") for s in group]
    entries |= record.reached(tool.test, tool.cylinder, curves)
    entries |= _rate(tool, kind, group)
    test = made(kind, entries)
    cylinder = tool.bed(test)
    test.check_on(cylinder)
    found = [record.numbers(test, cylinder, curve) for curve in curves]
    shared = [n for n in found[0] if all(n in numbers for numbers in found)]
    numbers = {n: np.array([each[n] for each in found]) for n in shared}
    _check_numbers(test, numbers)
    called = clean_name(name) if several else kind
    return ToolTest(called, entries, test, cylinder, tool, tuple(group), numbers)


def _rate(tool: Tool, kind: str, group: Sequence[Specimen]) -> dict[str, str]:
    """The speed at which the tool moved, where it is known and lies where a lab file has it."""
    speeds = labtext.rates(group)
    if not speeds:
        return {}
    written = tool.record.rate(tool.test, float(np.mean(speeds)))
    allowed = type(tool.test).model_fields["rate"].metadata
    usual = (r.holds(quantity(written, r.kind)) for r in allowed if isinstance(r, Range))
    return {"rate": written} if all(usual) else {}


def _check_numbers(test: AbstractLabTest, numbers: dict[str, np.ndarray]) -> None:
    """Refuses what no such test gives, as a wrong unit or size makes it."""
    for name, values in numbers.items():
        observable = test.observable(name)
        usual = observable.usual
        for value in values:
            if value <= 0 or not usual.holds(float(value)):
                problem = f"the {observable.label} would be {value:.4g} {observable.unit}, where "
                problem += f"{usual.low} to {usual.high} is usual"
                repair = "check units and sizes: --force-unit, --stress-unit, --tool"
                raise BadValue(problem, repair)


# ------------------------------------------------------------------ curves


def curve_text(specimen: Specimen) -> str:
    """A curve as CSV with a header and units in it, what was recorded beside it."""
    raw, tool = specimen.raw, specimen.raw.tool
    assert tool is not None
    columns = {"displacement_mm": specimen.displacement_mm, "force_n": specimen.force_n}
    if specimen.time_s is not None:
        columns = {"time_s": specimen.time_s - specimen.time_s[0], **columns}
    for kind, values in ((raw.travel, specimen.displacement_mm), (raw.load, specimen.force_n)):
        if kind in COLUMNS:
            name, factor = COLUMNS[kind]
            columns[name] = factor * values / tool.per(kind)
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.10g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------ the lab file


def lab_text(export: Export, tests: Sequence[ToolTest]) -> str:
    """The lab file of an export whose tests these are."""
    sections = [labtext.head(export), labtext.soil(export), _specimen(tests[0])]
    for number, test in enumerate(tests):
        sections += [_test(test, number > 0), *_curves(export, test)]
    return "\n\n".join(filter(None, map("\n".join, sections))) + "\n"


def _specimen(first: ToolTest) -> Iterator[str]:
    """[specimen]: the bed of the first test."""
    yield "[specimen]"
    if not first.tool.record.own_bed:
        called, deep = first.tool.record.called, 1e3 * first.cylinder.height
        yield f"# ASSUMED unless --diameter and --height said it: a bed with room for the {called},"
        yield f"# {1e3 * first.cylinder.diameter:.4g} mm wide and {deep:.4g} mm high"
    yield entry("diameter", millimetres(first.cylinder.diameter))
    yield entry("height", millimetres(first.cylinder.height))


def _test(of: ToolTest, own: bool) -> Iterator[str]:
    """One [[tests]] table with its targets; `own`: on a specimen of its own."""
    yield "[[tests]]"
    yield entry("name", of.name)
    yield entry("type", of.test.type_name)
    if own:
        sizes = (of.cylinder.diameter, of.cylinder.height)
        diameter, height = map(millimetres, sizes)
        yield f"specimen = {inline(diameter=diameter, height=height)}"
    for name, value in of.entries.items():
        yield entry(name, value)
    if of.tool.not_said:
        yield f"# ASSUMED: {of.tool.not_said}"
    if "rate" not in of.entries:
        yield "# ASSUMED: the usual rate, since the record's is not known or unusual"
    for name, values in of.numbers.items():
        yield from _target(of.test, name, values)


def _target(test: AbstractLabTest, name: str, values: np.ndarray) -> Iterator[str]:
    """A number with its scatter; assumed where the specimens show none."""
    observable, mean = test.observable(name), float(np.mean(values))
    scatter = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    if scatter < 1e-3 * mean:
        share, why = (EQUAL, "all are equal") if len(values) > 1 else (ALONE, "it is one specimen")
        yield f"# ASSUMED: a scatter of {100 * share:.0f} %, because {why}"
        scatter = share * mean
    unit = observable.kind.unit
    given = {"mean": f"{mean:.11g} {unit}", "scatter": f"{scatter:.4g} {unit}"}
    yield f"targets.{observable.short} = {inline(**given, repeats=len(values))}"


def _curves(export: Export, of: ToolTest) -> Iterator[Iterator[str]]:
    """One table for each curve: the targets hold what a fit compares."""
    for file, specimen in labtext.curve_files(export).items():
        if specimen in of.specimens:
            yield iter([
                *labtext.curve("tests.curves", file, specimen),
                entry("compared", False, "drawn; a fit compares the targets"),
            ])  # fmt: skip


def sentences(tests: Sequence[ToolTest]) -> Iterator[str]:
    """The numbers that the curves hold, one line each."""
    for of in tests:
        for name, values in of.numbers.items():
            observable = of.test.observable(name)
            mean = f"{np.mean(values):.4g} {observable.unit}"
            yield f"{of.name}: {observable.label} {mean} from {len(values)} curve(s)"


def observables(tests: Sequence[ToolTest]) -> dict[str, list[float]]:
    """The same as plain data, by name; after the name of the test where there are several."""
    prefix = {of.name: f"{of.name}." if len(tests) > 1 else "" for of in tests}
    return {
        f"{prefix[of.name]}{name}": values.tolist()
        for of in tests
        for name, values in of.numbers.items()
    }
