"""What the laboratory measured, in plain numbers: `load_lab` reads a lab file into a `Lab`.

Everything is SI except curves and targets, which stay in the units of the observables, mm and
N.  Curve files are CSV and must lie in the folder of the lab file or below it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.core.units import Kind, positive_quantity, unit_factor
from calibrate.io.choices import (
    AT,
    ParameterChoice,
    check_moistures,
    choices,
    differing,
    named_sets,
    percent,
)
from calibrate.io.conventions import (
    check_free,
    check_needed,
    check_sized,
    check_values,
    chosen,
    held_by,
)
from calibrate.io.curves import read_curve, read_repeats
from calibrate.io.labfile import read_toml, validated
from calibrate.io.plausible import Plausibility
from calibrate.io.stated import StatedTarget, StatedTests, stated_tests
from calibrate.io.tables import LabTables, ParticlesTable
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.composite import names_of
from calibrate.labtests.measured import Curve, Cylinder, Target
from calibrate.labtests.pair import Pair, pair_of
from jdem.materials.catalogue import WHOLE
from jdem.materials.contact_laws import BED_LAWS
from jdem.materials.conventions import DEFAULT


@dataclass(frozen=True)
class Particles:
    """How the soil is represented: surface energy is scaled by d/`reference_diameter` [m]
    (None: not given); Poisson's ratio; porosity of the bed of spheres (None: the usual one); whose
    `conventions` the contact law follows, or which other law it is."""

    reference_diameter: float | None
    poisson_ratio: float
    porosity: float | None = None
    conventions: str = DEFAULT

    @staticmethod
    def of(table: ParticlesTable, file: str) -> "Particles":
        """What a lab file states; `InputError` for a law that there is not."""
        stated = "conventions" in table.model_fields_set
        name = chosen(table.law, table.conventions, stated, file)
        return Particles(table.reference_diameter, table.poisson_ratio, table.porosity, name)


@dataclass(frozen=True, eq=False)
class Lab:
    """One soil and what was measured on it.

    `specimen` is the usual one, `tests` are made one after the other on the specimens that they
    state; `targets` is keyed by observable (depression_depth_mm, ...); `parameters` and each of
    `named_sets` by parameter name.  Determinations of density [kg/m^3] and of water content
    [fraction] are kept one by one.
    """

    file: str
    name: str
    source: str
    density_kg_m3: tuple[float, ...]
    water_content: tuple[float, ...]
    specimen: Cylinder
    tests: tuple[AbstractLabTest, ...]
    targets: dict[str, Target]
    curves: tuple[Curve, ...]
    particles: Particles
    parameters: dict[str, ParameterChoice]
    named_sets: dict[str, dict[str, float]]

    def specimens(self) -> list["TestedSpecimen"]:
        """The specimens in order, each with the tests that are made on it."""
        found: list[TestedSpecimen] = []
        for test in (each for each in self.tests if each.with_soil):
            if test.specimen is not None or not found:
                own = test.specimen.cylinder() if test.specimen else self.specimen
                found.append(TestedSpecimen(own, (test,)))
            else:
                found[-1] = TestedSpecimen(found[-1].cylinder, (*found[-1].tests, test))
        return found

    def without_soil(self) -> tuple[AbstractLabTest, ...]:
        """The tests that are made on no specimen."""
        return tuple(test for test in self.tests if not test.with_soil)

    def on_soil(self) -> "Lab":
        """The tests with soil alone, and what was measured in them; `InputError` without any."""
        if not self.without_soil():
            return self
        kept = [test.called for test in self.tests if test.with_soil]
        called = names_of(self.tests)
        names = [name for (test, _), (name, _) in called.items() if test in kept]
        targets = {name: target for name, target in self.targets.items() if name in names}
        curves = tuple(curve for curve in self.curves if curve.test in kept)
        if not (targets or curves):
            problem = "nothing is measured on soil, only on the machine without it"
            repair = "add a test of soil with a target or a curve"
            raise InputError(self.file, "tests", problem, repair)
        tests = tuple(test for test in self.tests if test.with_soil)
        return replace(self, tests=tests, targets=targets, curves=curves)

    def pair(self) -> Pair:
        """The two tests of the diagnosis; `InputError` where the lab has others on soil, or soils
        that differ."""
        self.check_same_soil()
        try:
            return pair_of([test for test in self.tests if test.with_soil])
        except BadValue as bad:
            raise bad.at(self.file, "") from None

    def differing(self) -> dict[str, list[str]]:
        """Parameters that differ with moisture, with the names of their values at the moistures of
        the lab's specimens."""
        present = {percent(s.cylinder.moisture or 0.0) for s in self.specimens()}
        found = differing(self.parameters)
        return {
            name: [value for value in values if value.partition(AT)[2] in present]
            for name, values in found.items()
        }

    def check_same_soil(self) -> None:
        """`InputError` where parameters differ with the moisture of specimens."""
        if found := self.differing():
            name = next(iter(found))
            problem = f"{name} differs with moisture, and this takes one soil"
            repair = "give it one value, in a lab file for each moisture"
            raise InputError(self.file, f"parameters.{name}.by_moisture", problem, repair)

    def cylinder_of(self, test: str) -> Cylinder:
        """The specimen on which the test of this name is made."""
        return next(s.cylinder for s in self.specimens() if test in [t.called for t in s.tests])

    def following(self, conventions: str, field: str = "--conventions") -> "Lab":
        """The lab with conventions by name; what these hold is held, in named sets too."""
        own = self.particles.conventions
        if own in WHOLE:
            problem = f"the lab file's law is '{own}', and only '{DEFAULT}' has conventions"
            raise InputError(self.file, field, problem, "leave them out")
        held = held_by(conventions, self.file, field)
        choices = {n: ParameterChoice(v, None, None, None, False) for n, v in held.items()}
        return replace(
            self,
            particles=replace(self.particles, conventions=conventions),
            parameters={**self.parameters, **choices},
            named_sets={name: {**values, **held} for name, values in self.named_sets.items()},
        )


@dataclass(frozen=True)
class TestedSpecimen:
    """A specimen and its tests, in order."""

    __test__ = False  # for pytest

    cylinder: Cylinder
    tests: tuple[AbstractLabTest, ...]


def load_lab(path: str | Path) -> Lab:
    """Reads a lab file and the curves that it names.

    Args:
        path: the TOML file; curves lie in its folder or below it.

    Returns:
        The lab, checked, in SI units (curves and targets in mm and N).

    Raises:
        InputError: the file, or an entry of it, is wrong; says which, and what to write instead.

    Example:
        >>> lab = calibrate.load_lab(calibrate.bundled_lab())
        >>> lab.name
        'wheat after rice, Lishui, Jiangsu'
    """
    file, raw = str(path), read_toml(Path(path))
    usual = Plausibility(file, _accepted(raw))
    usual.tables(raw)
    tables = validated(LabTables, raw, file)
    stated = stated_tests(tables, file)
    _check_something_measured(stated, "tests." * bool(tables.tests), file)
    particles = Particles.of(tables.particles, file)
    law = particles.conventions if particles.conventions in BED_LAWS else DEFAULT
    cylinders = _cylinders(stated, tables.specimen.cylinder())
    _check_protocols(stated, cylinders, file)
    parameters = choices(tables.parameters, file, law)
    lab = Lab(
        file=file,
        name=tables.soil.name,
        source=tables.soil.source,
        density_kg_m3=tuple(tables.soil.density),
        water_content=tuple(tables.soil.water_content),
        specimen=tables.specimen.cylinder(),
        tests=stated.tests,
        targets=_targets(stated, cylinders, Path(path), usual),
        curves=_curves(stated, cylinders, Path(path), usual),
        particles=particles,
        parameters=parameters,
        named_sets=named_sets(tables.named_sets, differing(parameters), file, law),
    )
    check_moistures(lab.parameters, _moistures(stated, cylinders), file)
    usual.finish()
    return _as_its_conventions(lab)


def _accepted(raw: dict[str, Any]) -> list[str]:
    """The entries that the file accepts though they are unusual, as far as it can be read."""
    given = raw.get("accept")
    return [name for name in given if isinstance(name, str)] if isinstance(given, list) else []


def _as_its_conventions(lab: Lab) -> Lab:
    """The lab with what its own conventions hold; refused where it states or frees that."""
    name, choices = lab.particles.conventions, lab.parameters
    values = {n: c.value for n, c in choices.items()}
    if name in WHOLE:
        check_needed(name, values, lab.file)
        check_sized(name, lab.particles.reference_diameter, lab.file)
        return lab
    check_values(name, values, lab.file, "parameters.")
    check_free(name, [n for n, c in choices.items() if c.free], lab.file, "parameters.")
    return lab.following(name, "particles.conventions")


def bundled_lab(name: str = "wheat_after_rice") -> Path:
    """A lab file that comes with the package.

    Args:
        name: of the soil.

    Returns:
        The path of its file.

    Raises:
        InputError: there is no such soil.

    Example:
        >>> path = calibrate.bundled_lab("trumao")
    """
    folder = Path(str(resources.files("calibrate") / "soils"))
    known = sorted(file.stem for file in folder.glob("*.toml"))
    if name not in known:
        raise InputError("bundled soils", "", f"no soil {shown(name)}", suggestion(name, known))
    return folder / f"{name}.toml"


LabLike = Lab | str | Path | None  # what verbs take for a soil; None: the bundled one


def lab_of(lab: LabLike) -> Lab:
    """The lab that is meant: read from its file, unless it has been read."""
    if lab is None or isinstance(lab, str | Path):
        return load_lab(bundled_lab() if lab is None else lab)
    return lab


def _check_something_measured(stated: StatedTests, within: str, file: str) -> None:
    """Refuse a lab file with neither a target nor a curve that is compared; these stand in tables
    whose names begin with `within`."""
    if not (stated.targets or any(curve.table.compared for curve in stated.curves)):
        short = dict.fromkeys(o.short for test in stated.tests for o in test.observables)
        tables = [f"[{within}targets.{name}]" for name in short]
        repair = f"add {', '.join(tables)} or [[{within}curves]]"
        raise InputError(file, "targets", "nothing measured is given", repair)


def _targets(
    stated: StatedTests, cylinders: Sequence[Cylinder], path: Path, usual: Plausibility
) -> dict[str, Target]:
    """The scalar targets that are given, by observable, in the order of the tests."""
    called = names_of(stated.tests)
    found: dict[str, Target] = {}
    for target in sorted(stated.targets, key=lambda target: target.test):
        name, _ = called[stated.tests[target.test].called, target.observable.source]
        if name in found:
            raise InputError(str(path), target.field, f"{name} is given twice", "give it once")
        found[name] = _target(target, cylinders[target.test], path)
        if target.table.file is not None:
            place = cylinders[target.test], f"{target.field}.unit"
            usual.repeats(found[name].mean, target.observable, *place)
    return found


def _target(target: StatedTarget, cylinder: Cylinder, path: Path) -> Target:
    """A target in the unit of its observable."""
    table, file = target.table, str(path)
    if table.file is None:
        mean, scatter = (
            _in_unit(
                positive_quantity,
                getattr(table, name),
                target,
                cylinder,
                f"{target.field}.{name}",
                file,
            )
            for name in ("mean", "scatter")
        )
        amounts = (table.times * mean, table.times * scatter)
        return Target(*amounts, table.repeats or 1, table.published_error)
    factor = _in_unit(unit_factor, table.unit, target, cylinder, f"{target.field}.unit", file)
    repeats = factor * read_repeats(table, path, target.field)
    if len(repeats) < 2 or repeats.min() <= 0:
        problem = "fewer than two repeats" if len(repeats) < 2 else "a repeat is not above zero"
        raise InputError(file, f"{target.field}.file", problem, "give mean, scatter and repeats")
    amounts = (float(repeats.mean()), float(repeats.std(ddof=1)))
    return Target(*amounts, len(repeats), table.published_error)


def _in_unit(
    read: Callable[[Any, Kind], float], written: Any, target: StatedTarget, size: Cylinder,
    field: str, file: str,
) -> float:  # fmt: skip
    """A quantity, or what takes a column's unit, to the observable's unit; stress and strain by the
    specimen's size."""
    try:
        return read(written, target.observable.kind)
    except BadValue as bad:
        other, factor = target.observable.by_size(size)
        try:
            return factor * read(written, other)
        except BadValue:
            raise bad.at(file, field) from None


def _curves(
    stated: StatedTests, cylinders: Sequence[Cylinder], path: Path, usual: Plausibility
) -> tuple[Curve, ...]:
    """The measured curves; the same columns of a file given twice would be a false repeat."""
    seen, found = set(), []
    for curve in stated.curves:
        key = curve.table.model_copy(update={"test": None}).model_dump_json()
        if key in seen:
            problem = f"{shown(curve.table.file)} is listed twice"
            raise InputError(str(path), f"{curve.field}.file", problem, "list it once")
        seen.add(key)
        test, cylinder = stated.tests[curve.test], cylinders[curve.test]
        found.append(read_curve(curve.table, test.called, cylinder, path, curve.field))
        usual.curve(found[-1], curve.table, cylinder, curve.field, test)
    return tuple(found)


def _moistures(stated: StatedTests, cylinders: Sequence[Cylinder]) -> dict[str, float | None]:
    """The moisture of each specimen with soil, by the field of its table."""
    rows = enumerate(zip(stated.tests, cylinders, strict=True))
    return {
        f"tests[{number}].specimen" if test.specimen else "specimen": cylinder.moisture
        for number, (test, cylinder) in rows
        if test.with_soil
    }


def _check_protocols(stated: StatedTests, cylinders: Sequence[Cylinder], file: str) -> None:
    """Refuse what a test's specimen does not let it do, or a mould that is gone already."""
    free = disturbed = ""  # the test that took the mould away, or left the soil disturbed
    for number, (test, cylinder) in enumerate(zip(stated.tests, cylinders, strict=True)):
        field = f"tests[{number}]"
        try:
            test.check_on(cylinder)
        except BadValue as bad:
            raise bad.at(file, field) from None
        if test.specimen is not None:
            free = disturbed = ""
        if test.with_soil and (disturbed or (free and test.in_mould)):
            left = (
                f"{disturbed} leaves the soil disturbed" if disturbed else f"{free} opens the mould"
            )
            problem = f"{left}, and {test.called} goes on with this specimen"
            repair = "give it a specimen of its own, or put it before"
            raise InputError(file, field, problem, repair)
        free = test.called if test.frees else free
        disturbed = test.called if test.in_mould else disturbed


def _cylinders(stated: StatedTests, first: Cylinder) -> list[Cylinder]:
    """The specimen that each test is made on."""
    found: list[Cylinder] = []
    for test in stated.tests:
        before = found[-1] if found else first
        found.append(test.specimen.cylinder() if test.specimen else before)
    return found
