"""The reference of the lab file: every table and entry of `calibrate.io.tables`.

Unit, default and example are read from the pydantic models, so the page cannot go stale.
`MEANING` adds a few words to entries whose name does not say enough.
"""

import json
import sys
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from calibrate.core.units import Kind, Range
from calibrate.inference.parameters import candidates
from calibrate.io.conventions import LAWS
from calibrate.io.labfile import PARAMETER_RANGES, PARAMETER_UNITS
from calibrate.io.tables import LabTables
from calibrate.labtests.composite import TYPES
from jdem.materials.catalogue import CATALOGUE, EVERY, parameters_of
from jdem.materials.contact_laws import CONTACT_LAWS
from jdem.materials.soil import SoilParameters

HEAD = """# Lab file

A lab file is a text file in TOML. A quantity is a string with its unit, such as `"50 mm"`. Any
unit of the right kind is read. Curves are CSV files in the folder of the lab file or below it. An
unknown name is refused.

There are two forms. A file has one of them, not both.

- **A list of tests.** Each test is a table `[[tests]]` with its own targets and curves. The tests
  are made in the order of the file. A test goes on with the specimen as the test before left it.
  A test with a `specimen` of its own begins with a new one; `machine` takes none.
- **The usual pair.** `[confined]` and `[unconfined]` stand alone, with `[targets]` and `[[curves]]`
  beside them. Both tests are made on one specimen, first the confined and then the unconfined one,
  also if the file says nothing about one of them.

A unit in the column "unit" is the one that the program uses inside. You may write another. A table
that has several places, such as a protocol, is shown once, at its first place.
"""
MEANING = {
    "AbstractLabTables.accept": "entries whose values are meant though they are unusual",
    "AbstractLabTables.soil": "what was tested",
    "AbstractLabTables.specimen": "the cylinder of soil; also of each test without its own",
    "AbstractLabTables.tests": "a list of tests; the tables below show each type",
    "AbstractLabTables.curves": "curves of the usual pair",
    "AbstractLabTables.particles": "size and Poisson's ratio of the particles",
    "AbstractLabTables.parameters": "what is known of each contact parameter",
    "AbstractLabTables.named_sets": "sets of parameter values; a fit simulates them for comparison",
    "LabTables.targets": "targets of the usual pair",
    "LabTables.confined": "the first test of the usual pair",
    "LabTables.unconfined": "the second test of the usual pair",
    "TargetsTable.depression_depth": "of the confined test",
    "TargetsTable.crushing_force": "of the unconfined test",
    "SoilTable.name": "of the soil, in results",
    "SoilTable.density": "bulk density, one value a sample; without it that of the bundled soil",
    "SoilTable.water_content": "gravimetric, one value a sample; kept for the record",
    "SoilTable.source": "where the numbers come from",
    "SpecimenTable.diameter": "inner diameter of the mould",
    "SpecimenTable.height": "of the soil in the mould",
    "SpecimenTable.mould_height": "of the mould, if known",
    "SpecimenTable.moisture": "water over dry mass; chooses among values by moisture",
    "ConfinedTest.rate": "speed of the platen in the laboratory",
    "ConfinedTest.pressed_at": "of a simulation that stands for a laboratory: how fast it pressed",
    "ConfinedTest.force_low": "the depression depth counts from here",
    "ConfinedTest.force_high": "and to here; the platen turns",
    "ConfinedTest.greased": "whether the mould was greased; kept for the record",
    "ConfinedTest.fresh_grease": "a further test in a mould that was greased just before",
    "UnconfinedTest.lubricated": "a further test between lubricated platens",
    "UnconfinedTest.at_once": "a further test of a specimen that was sealed and crushed at once",
    "UnconfinedTest.rate": "speed of the platen in the laboratory",
    "RelaxationTest.rate": "speed of the platen in the laboratory",
    "RelaxationTest.force": "to which the platen goes",
    "RelaxationTest.hold": "how long the platen stands still",
    "UnconfinedTest.rest": "between the removal of the mould and the test",
    "MachineTest.force": "of the platen on the bare base",
    "MachineTest.loading": "until the force is there, and again until it is gone",
    "MachineTest.weight": "a known weight that was laid on the load cell",
    "MachineTest.reads": "what the machine shows with it",
    "AbstractLabTest.type": "kind of test; must be given in `[[tests]]`",
    "AbstractLabTest.name": "of the test in results; default: its type; each name once",
    "AbstractLabTest.specimen": "a specimen of its own, in place of that of the test before",
    "AbstractLabTest.protocol": "a list of steps; replaces the usual course of the test",
    "AbstractLabTest.targets": "one table for each observable",
    "AbstractLabTest.curves": "any number of repeats",
    "StepTable.step": "what the machine does",
    "StepTable.to": "a force, stress, displacement or strain where the movement ends",
    "StepTable.rate": "a speed or a strain rate, of the laboratory; default: 1 mm/min",
    "StepTable.keep": "what a hold keeps, by default the displacement",
    "StepTable.duration": "how long a hold or a rest lasts",
    "TargetTable.mean": "a quantity; a stress or strain is converted with the specimen's size",
    "TargetTable.scatter": "standard deviation of one repeat",
    "TargetTable.repeats": "number of repeats behind the mean",
    "TargetTable.file": "a CSV file with one repeat a row, in place of mean, scatter and repeats",
    "TargetTable.column": "of the file",
    "TargetTable.unit": "of the column",
    "TargetTable.times": "a factor, such as 2 from undrained to compressive strength",
    "TargetTable.where": "rows to keep, by column and value",
    "CurveTable.test": "`confined` or `unconfined`; must be given for the usual pair",
    "CurveTable.where": "rows to keep, by column and value",
    "CurveTable.points": "true: rows are load steps, not a continuous record",
    "CurveTable.compared": "false: it is drawn, and a fit compares targets alone",
    "CurveTable.decimal": "decimal sign of the numbers",
    "CurveTable.file": "path of the CSV file",
    "CurveTable.displacement": "give this, strain or void_ratio",
    "CurveTable.strain": "in place of displacement",
    "CurveTable.void_ratio": "in place of displacement",
    "CurveTable.force": "give this or stress",
    "CurveTable.stress": "in place of force",
    "DisplacementColumn.column": "name of the column in the CSV file",
    "StrainColumn.column": "name of the column in the CSV file",
    "VoidRatioColumn.column": "name of the column in the CSV file",
    "ForceColumn.column": "name of the column in the CSV file",
    "StressColumn.column": "name of the column in the CSV file",
    "DisplacementColumn.unit": "of the column",
    "StrainColumn.unit": "of the column",
    "ForceColumn.unit": "of the column",
    "StressColumn.unit": "of the column",
    "VoidRatioColumn.initial": "initial void ratio e0; default: the first row",
    "CurveTable.delimiter": "between cells of a row",
    "ParticlesTable.reference_diameter": "size at which `surface_energy` is stated (default: "
    "80 um), or `gamma` and stiffnesses of bonds (5 mm)",
    "ParticlesTable.poisson_ratio": "of the particles",
    "TargetTable.published_error": "relative error of a published simulation, for comparison",
    "ParticlesTable.porosity": "of the bed of spheres; default: usual for their size",
    "ParticlesTable.law": "the contact law: eepa, hertz_mindlin, hertz_cohesion, "
    "hysteretic_cohesion, jkr or parallel_bond",
    "ParticlesTable.conventions": "of the law eepa: eepa, liggghts or liggghts_history",
    "ParameterTable.value": "where a fit begins",
    "ParameterTable.low": "lower bound of a fit",
    "ParameterTable.high": "upper bound of a fit",
    "ParameterTable.by_moisture": "a value for each moisture of specimens, in place of one",
    "ParameterTable.prior_sd": "prior standard deviation of ln p; 0.1 is about 10 %",
    "ParameterTable.free": "true: fit it, hold the rest; false: hold it; no true: the data choose",
}
EXAMPLES = {
    "accept": 'accept = ["specimen.diameter"]',
    "reference_diameter": 'reference_diameter = "80 um"',
    "porosity": "porosity = 0.43",
    "published_error": 'published_error = "3 %"',
    "mould_height": 'mould_height = "150 mm"',
    "by_moisture": 'by_moisture = { "4 %" = "0.4 J/m^2", "12 %" = "0.5 J/m^2" }',
    "source": 'source = "own tests, 2026"',
    "value": "value = 7e6",
    "low": "low = 2e6",
    "high": "high = 2e7",
    "prior_sd": "prior_sd = 0.5",
    "free": "free = false",
}
SCALE = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "": ("", 1.0)}


def page() -> str:
    """All tables, outermost first, and the parameters that a lab file may name."""
    return "\n".join([HEAD, *[_table(path, model) for path, model in tables()], _parameters()])


def tables() -> list[tuple[str, type[BaseModel]]]:
    """Every table with its place in the file: "", soil, specimen, ..., curves[].force."""
    found: list[tuple[str, type[BaseModel]]] = []
    _add("", LabTables, found)
    for name, kind in TYPES.items():
        _add(f'tests[], type = "{name}"', kind, found)
    return found


def _add(path: str, model: type[BaseModel], found: list[tuple[str, type[BaseModel]]]) -> None:
    """Adds a table and the tables inside it; one that several tables hold is shown once."""
    if any(model is seen for _, seen in found):
        return
    found.append((path, model))
    for name, field in model.model_fields.items():
        for each in _models(field.annotation):
            _add(f"{path}.{name}".strip(".") + _mark(field.annotation), each, found)


def _mark(annotation: Any) -> str:
    origin = getattr(annotation, "__origin__", None)
    return "[]" if origin in (list, tuple) else ".NAME" if origin is dict else ""


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models(part)]


def _table(path: str, model: type[BaseModel]) -> str:
    place, _, kind = path.partition(",")
    title = f"[{place}]" if place and "[]" not in place else place.replace("[]", "")
    if place.endswith("[]"):
        title = f"[[{title}]]"
    doc = " ".join((model.__doc__ or "").split()) + _observables(model)
    head = ["| entry | meaning | unit | default | example |", "| --- | --- | --- | --- | --- |"]
    rows = [_row(model, name, field) for name, field in model.model_fields.items()]
    heading = f"## `{title}`{kind and f' with `{kind.strip()}`'}" if path else "## Tables"
    return "\n".join([heading, "", doc, "", *head, *rows, ""])


def _observables(model: type[BaseModel]) -> str:
    """What a type of test gives, under the names that its targets have."""
    given = [o.name for o in getattr(model, "every", tuple)()]
    return f" Observables: {', '.join(f'`{name}`' for name in given)}." if given else ""


def _row(model: type[BaseModel], name: str, field: FieldInfo) -> str:
    kind = kind_of(field)
    default = "**required**" if field.is_required() else _default(field, kind)
    entry, unit = field.alias or name, kind.unit if kind else ""
    cells = [f"`{entry}`", _meaning(model, name, field), unit, default]
    return "| " + " | ".join([*cells, _example(entry, field, kind)]) + " |"


def _meaning(model: type[BaseModel], name: str, field: FieldInfo) -> str:
    choices = _literals(field.annotation)
    words = next((w for kind in model.__mro__ if (w := MEANING.get(f"{kind.__name__}.{name}"))), "")
    if choices:
        words = f"{words}; one of ".lstrip("; ") + ", ".join(_shown(choice) for choice in choices)
    usual = [f"{r.low} to {r.high}" for r in field.metadata if isinstance(r, Range)]
    if usual:
        words += f"; usually {' or '.join(usual)}"
    return words.replace("|", "\\|") or ("a table" if _models(field.annotation) else "")


def _shown(choice: Any) -> str:
    """A choice as code; a blank and a tab as TOML writes them."""
    return "`" + json.dumps(choice) + "`" if str(choice).isspace() else f"`{choice}`"


def _literals(annotation: Any) -> list:
    if "Literal" in str(annotation).split("[")[0]:
        return list(get_args(annotation))
    return [choice for part in get_args(annotation) for choice in _literals(part)]


def kind_of(field: FieldInfo) -> Kind | None:
    """The kind of quantity that the entry's reader was made for."""
    for holder in [*field.metadata, *_metadata(field.annotation)]:
        for cell in getattr(getattr(holder, "func", None), "__closure__", None) or ():
            if isinstance(cell.cell_contents, Kind):
                return cell.cell_contents
    return None


def _metadata(annotation: Any) -> list:
    own = list(getattr(annotation, "__metadata__", ()))
    return own + [item for part in get_args(annotation) for item in _metadata(part)]


def _default(field: FieldInfo, kind: Kind | None) -> str:
    value = field.get_default(call_default_factory=True)
    if value is None or value == "" or value == [] or value == {}:
        return "none"
    if isinstance(value, BaseModel):
        return "its own defaults"
    return f"`{_quantity(value, kind)}`"


def _quantity(value: Any, kind: Kind | None) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if kind is None:
        return f'"{value}"' if isinstance(value, str) else str(value)
    unit, factor = SCALE.get(kind.unit, (kind.unit, 1.0))
    return f'"{value * factor:g} {unit}"'.replace(' "', '"') if unit else f"{value:g}"


def _example(name: str, field: FieldInfo, kind: Kind | None) -> str:
    if name in EXAMPLES:
        return f"`{EXAMPLES[name]}`"
    if field.is_required() and " = " in (field.description or ""):
        return f"`{field.description}`".replace("|", "\\|")
    if field.is_required() or _models(field.annotation):
        return ""
    value = field.get_default(call_default_factory=True)
    if value not in (None, "", [], {}):
        return f"`{name} = {_quantity(value, kind)}`".replace("|", "\\|")
    if kind is not None:
        text = f'"{kind.example}"'
        return f"`{name} = {'[' + text + ']' if value == [] else text}`"
    return ""


def _parameters() -> str:
    """What `[parameters]` and `[named_sets.NAME]` may hold."""
    lines = [
        "## Parameters",
        "",
        "Names for `[parameters]`, `[named_sets.NAME]` and `--set`. A plain number is in the unit",
        "given here. Bounds and prior are those of a fit where the lab file gives none; a",
        "parameter without bounds cannot be fitted. A law takes its own parameters alone.",
        "",
        "| name | laws | unit | accepted | bounds of a fit | prior sd of ln p |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, unit in PARAMETER_UNITS.items():
        bounds = EVERY[name].search
        span = f"{bounds.low:g} to {bounds.high:g}" if bounds else ""
        width = f"{bounds.prior_sd:g}" if bounds else ""
        accepted = PARAMETER_RANGES[name][1].removeprefix("give ")
        cells = f"`{name}`", _laws_of(name), unit or "1", accepted, span, width
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def _laws_of(name: str) -> str:
    """Which laws have a parameter."""
    found = [law for law in LAWS if name in parameters_of(law)]
    return "all" if len(found) == len(LAWS) else ", ".join(found)


def catalogue_rows() -> list[str]:
    """The table of docs/parameters.md, which a test compares with it: every parameter of EEPA, and
    those that other laws have beside."""
    start, rows = SoilParameters().values(), []
    usual = {n: x for each in CONTACT_LAWS.values() for n, x in each.defaults.items()}
    own = {name: entry for name, entry in EVERY.items() if name not in CATALOGUE}
    for name, entry in {**CATALOGUE, **own}.items():
        found = entry.search
        bounds = f"{found.low:g} to {found.high:g}" if found else ""
        width = f"{found.prior_sd:g}" if found else ""
        chosen = any(name in candidates(law) for law in LAWS)
        fitted = "yes" if chosen else "if named" if found else "no"
        given = start.get(name, usual.get(name))
        value, called = "" if given is None else f"{float(given):.5g}", entry.names
        edem = called.get("EDEM", "").rpartition(" / ")[2]
        cells = (f"`{name}`", entry.label, entry.unit or "1", value, bounds, width, fitted, edem)
        rows.append("| " + " | ".join((*cells, called.get("LIGGGHTS", ""))) + " |")
    return rows


if __name__ == "__main__":
    sys.stdout.write(page())
