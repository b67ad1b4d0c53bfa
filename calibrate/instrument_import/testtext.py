"""The lab file of stresses, strains, load steps and strengths: one [[tests]] table a test.

Specimens whose load takes the same course are repeats of one test.
"""

import numpy as np
import tomlkit
from tomlkit.items import InlineTable, Table

from calibrate.instrument_import.convert import Export
from calibrate.instrument_import.labparts import (
    FORCE_HIGH,
    FORCE_LOW,
    add_head,
    add_soil,
    add_specimen,
    add_start,
    column,
    curve_files,
    fitted,
    usable,
)
from calibrate.instrument_import.specimens import DIAMETER, Specimen
from calibrate.instrument_import.steps import turning_rows
from calibrate.instrument_import.strengths import Strengths
from calibrate.instrument_import.vocabulary import SOFTENS, STIFFENS
from calibrate.labtests.base import clean_name
from calibrate.labtests.features import cyclic_course

Course = tuple[str, ...]  # the loads at which the direction of loading turns: "1200 kPa"
_WORDS = ("load", "unload", "reload")


def lab_text(export: Export) -> str:
    """The lab file that names these curves and strengths."""
    document = tomlkit.document()
    add_head(document, export)
    add_soil(document, export)
    add_specimen(document, export)
    tests = tomlkit.aot()
    groups = _groups(export)
    for place, ((test, course), specimens) in enumerate(groups.items()):
        name = test if len(groups) == 1 else clean_name(f"{test} {specimens[0].label}")
        own = _specimen(specimens, export) if place else None
        if test == SOFTENS:
            tests.append(_preparation(name, specimens[0].diameter, own))
            own = None
        tests.append(_test(export, name, test, course, specimens, own))
    if export.strengths:
        tests.append(_preparation(export.strengths.test, export.strengths.diameter, None))
        tests.append(_crushing(export.strengths))
    document["tests"] = tests
    add_start(document, export)
    return tomlkit.dumps(document)


def _groups(export: Export) -> dict[tuple[str, Course], list[Specimen]]:
    """Specimens that were tested alike, in the order of the file."""
    groups: dict[tuple[str, Course], list[Specimen]] = {}
    for specimen in export.specimens:
        groups.setdefault((specimen.test, course_of(specimen)), []).append(specimen)
    return groups


def course_of(specimen: Specimen) -> Course:
    """Where loading of a specimen turns, for load steps and for a curve that is loaded several
    times; empty for one that is loaded once.  Turns of a curve have two digits: repeats differ."""
    if not specimen.points:
        turns = cyclic_course(specimen.displacement_mm, specimen.force_n)
        loads = () if specimen.test == SOFTENS else turns
        least = 0.01 * max(loads, default=0.0)  # less is no load
        return tuple(f"{float(f'{load:.2g}'):g} N" if load > least else "0 N" for load in loads)
    force, diameter = specimen.force_n, specimen.diameter
    unit, per_newton = "N", 1.0
    if diameter is not None:
        unit, per_newton = "kPa", 1e-3 / (np.pi / 4 * diameter**2)
    return tuple(f"{per_newton * force[row]:.4g} {unit}" for row in turning_rows(force))


def _test(
    export: Export,
    name: str,
    test: str,
    course: Course,
    specimens: list[Specimen],
    own: InlineTable | None,
) -> Table:
    """One [[tests]] table; `own` is the specimen that it is made on, if a new one."""
    table = tomlkit.table()
    table["name"] = name
    table["type"] = test
    if own is not None:
        table["specimen"] = own
    if course:
        _add_protocol(table, course, specimens)
    else:
        _add_rate(table, specimens)
    curves = tomlkit.aot()
    for file, specimen in curve_files(export).items():
        if specimen not in specimens:
            continue
        if specimen in fitted(export):
            curves.append(_curve(file, specimen))
        else:
            why = "it ends at the load cell's limit" if usable(specimen) else "no force above 2 N"
            table.add(tomlkit.comment(f"{file} is not listed: {why}"))
    if curves:
        table["curves"] = curves
    return table


def _preparation(test: str, diameter: float | None, own: InlineTable | None) -> Table:
    """The pressing in the mould before a crushing test; `own` as in `_test`."""
    share = ((diameter or DIAMETER) / DIAMETER) ** 2
    table = tomlkit.table()
    table["name"] = "preparation" if test == SOFTENS else clean_name(f"preparation {test}")
    table["type"] = STIFFENS
    text = "ASSUMED: how hard the specimen was pressed before; a bed never pressed has no strength"
    table.add(tomlkit.comment(text))
    if own is not None:
        table["specimen"] = own
    table["force_low"] = f"{FORCE_LOW * share:.4g} N"
    table["force_high"] = f"{FORCE_HIGH * share:.4g} N"
    return table


def _specimen(specimens: list[Specimen], export: Export) -> InlineTable:
    """Mean diameter and height of these specimens, of all where these do not say."""
    table = tomlkit.inline_table()
    whole = tomlkit.document()
    add_specimen(whole, export)
    for name in ("diameter", "height"):
        stated = [size for s in specimens if (size := getattr(s, name)) is not None]
        usual = str(whole["specimen"][name])  # pyright: ignore[reportIndexIssue]
        table[name] = f"{1e3 * float(np.mean(stated)):.5g} mm" if stated else usual
    return table


def _add_protocol(table: Table, course: Course, specimens: list[Specimen]) -> None:
    """The protocol: to each turn of the load, without the steps on the way."""
    steps = tomlkit.array()
    for place, load in enumerate(course):
        word = _WORDS[0] if place == 0 else _WORDS[1 + (place - 1) % 2]
        step = tomlkit.inline_table()
        step.update({"step": word, "to": load})
        steps.append(step)
    text = "ASSUMED: the steps between the turns are passed without a hold, at the type's own rate"
    table.add(tomlkit.comment(text))
    table["protocol"] = steps.multiline(True)
    times = [s.time_s for s in specimens if s.time_s is not None and s.points]
    if times:
        longest = max(float(np.ptp(time)) for time in times) / 3600
        text = f"read over {longest:.4g} h; drainage takes that time and is not simulated"
        table.add(tomlkit.comment(text))


def _add_rate(table: Table, specimens: list[Specimen]) -> None:
    """The platen's speed as a comment: the type's own protocol is used."""
    rates = [s.rate for s in specimens if s.rate is not None and s.rate > 0]
    speed = f"{1e3 * float(np.mean(rates)):.4g} mm/s" if rates else "not known"
    text = f"the platen's speed was {speed}; ASSUMED is the protocol of the type"
    table.add(tomlkit.comment(text))


def _curve(file: str, specimen: Specimen) -> Table:
    table = tomlkit.table()
    table["file"] = file
    table["displacement"] = column("displacement_mm", "mm")
    table["force"] = column("force_n", "N")
    if specimen.points:
        table["points"] = True
    return table


def _crushing(strengths: Strengths) -> Table:
    """Strengths as the scalar target of a crushing test."""
    table = tomlkit.table()
    table["name"] = strengths.test
    table["type"] = strengths.test
    force = strengths.force_n
    mean, scatter = float(np.mean(force)), float(np.std(force, ddof=1))
    if scatter < 1e-3 * mean:
        scatter = 0.05 * mean
        table.add(tomlkit.comment("ASSUMED: a scatter of 5 %, because all strengths are equal"))
    target = tomlkit.inline_table()
    target.update({"mean": f"{mean:.4g} N", "scatter": f"{scatter:.3g} N", "repeats": len(force)})
    targets = tomlkit.table()
    targets["crushing_force_n"] = target
    table["targets"] = targets
    return table
