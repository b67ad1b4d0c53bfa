"""The lab file and the curve files that `calibrate fit` reads, as texts.

What the export does not say is written with the word ASSUMED beside it.  Specimens whose load
takes the same course are repeats of one test.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit

from calibrate.instrument_import.convert import Export, file_stem
from calibrate.instrument_import.specimens import DIAMETER, HEIGHT, Specimen
from calibrate.instrument_import.steps import turning_rows
from calibrate.instrument_import.strengths import Strengths
from calibrate.instrument_import.vocabulary import SOFTENS, STIFFENS
from calibrate.labtests.base import clean_name
from calibrate.labtests.features import SEATING, cyclic_course
from calibrate.labtests.reading import displacement_on_rise, loading
from jdem.materials.soil import SoilParameters

STRENGTHS_FILE = "strengths.csv"
FORCE_LOW, FORCE_HIGH = 200.0, 400.0  # N; of the depression depth, as in the bundled soil
REACHED = 0.98  # of force_high is what `calibrate fit` asks of a curve
STIFFNESS = 10.0  # shear modulus of particles over the largest stress that a bed has to bear
STIFFEST = 5e7  # Pa; half of what a fit may reach
USUAL = {"diameter": DIAMETER, "height": HEIGHT}  # m

Course = tuple[str, ...]  # the loads at which the direction of loading turns: "1200 kPa"
Lines = Iterator[str]

# ------------------------------------------------------------------ curves


def curve_files(export: Export) -> dict[str, Specimen]:
    """The specimens by the name of their curve file."""
    files: dict[str, Specimen] = {}
    for number, specimen in enumerate(export.specimens, start=1):
        name = f"{file_stem(specimen.label)}_{specimen.test}.csv"
        files[name if name not in files else f"{number}_{name}"] = specimen
    return files


def usable(specimen: Specimen) -> bool:
    """Whether `calibrate fit` can read the curve: it exceeds the force where travel counts."""
    return bool(specimen.force_n.max() > SEATING)


def fitted(export: Export) -> list[Specimen]:
    """The specimens that the lab file names; clipped ones only where a test has no other."""
    whole = {s.test for s in export.specimens if usable(s) and not s.clipped}
    return [s for s in export.specimens if usable(s) and not (s.clipped and s.test in whole)]


def curve_text(specimen: Specimen) -> str:
    """A curve as CSV with a header and units in it.

    Beside what was converted stand stress (kPa), strain and void ratio.
    """
    columns = {"displacement_mm": specimen.displacement_mm, "force_n": specimen.force_n}
    if specimen.raw.is_converted or specimen.points:
        columns |= stresses(specimen)
    if specimen.time_s is not None:
        columns = {"time_s": specimen.time_s - specimen.time_s[0], **columns}
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def stresses(specimen: Specimen) -> dict[str, np.ndarray]:
    """Stress on the initial area, engineering strain and void ratio, as far as sizes are known."""
    size, columns = specimen.raw.size, {}
    if size.diameter is not None:
        columns["stress_kpa"] = 1e-3 * specimen.force_n / (np.pi / 4 * size.diameter**2)
    if size.height is not None:
        columns["strain"] = 1e-3 * specimen.displacement_mm / size.height
    if size.void_ratio is not None and size.height is not None:
        columns["void_ratio"] = size.void_ratio - (1 + size.void_ratio) * columns["strain"]
    return columns


def strengths_text(strengths: Strengths) -> str:
    """Strengths as CSV, one specimen a row."""
    names = [safe(label).replace('"', "'") for label in strengths.labels]
    rows = zip(names, strengths.stress_kpa, strengths.force_n, strict=True)
    lines = [f'"{name}",{stress:.7g},{force:.7g}' for name, stress, force in rows]
    return "\n".join(["specimen,compressive_strength_kpa,crushing_force_n", *lines]) + "\n"


# ------------------------------------------------------------------ what the curves give


@dataclass(frozen=True)
class Forces:
    """The forces (N) between which the depression depth counts; why, if not the usual ones."""

    low: float
    high: float
    note: str


def loading_forces(export: Export) -> Forces:
    """200 and 400 N where every stiffening curve reaches them, less where one does not."""
    peaks = [float(s.force_n.max()) for s in fitted(export) if s.test == STIFFENS]
    if not peaks or min(peaks) >= REACHED * FORCE_HIGH:
        return Forces(FORCE_LOW, FORCE_HIGH, "")
    size = 10.0 ** np.floor(np.log10(min(peaks)) - 1)
    high = float(np.floor(min(peaks) / size) * size)
    note = f"a curve ends at {min(peaks):.4g} N, so not 200 and 400 N"
    return Forces(0.5 * high, high, note)


def observables(export: Export) -> dict[str, list[float]]:
    """Depression depths (mm) and crushing forces (N) of the curves, clipped ones left out."""
    forces = loading_forces(export)
    depths, crushing = [], []
    for specimen in fitted(export):
        if specimen.test == STIFFENS:
            rise = loading(specimen.displacement_mm, specimen.force_n)
            low, high = (displacement_on_rise(*rise, f) for f in (forces.low, forces.high))
            depths.append(float(high - low))
        elif specimen.test == SOFTENS and not specimen.clipped:
            crushing.append(float(specimen.force_n.max()))
    if export.strengths:
        crushing = export.strengths.force_n.tolist()
    return {"depression_depth_mm": depths, "crushing_force_n": crushing}


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


# ------------------------------------------------------------------ the lab file


def lab_text(export: Export) -> str:
    """The lab file that names these curves and strengths: one table a test, and the curves, where
    all is force and displacement under the usual protocols, else a list of tests."""
    plain = export.is_plain and not any(course_of(s) for s in export.specimens)
    sections = [head(export), soil(export), _specimen(export)]
    sections += [*_plain_tests(export)] if plain else [*_listed_tests(export), _start(export)]
    return "\n\n".join(filter(None, map("\n".join, sections))) + "\n"


def safe(text: str) -> str:
    """Text from a file on one line without control characters."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else "?" for c in line)[:300]


def entry(name: str, value: object, comment: str = "") -> str:
    """One line of TOML."""
    line = f"{name} = {tomlkit.item(value).as_string()}"
    return f"{line} # {safe(comment)}" if comment else line


def inline(**entries: object) -> str:
    """A table of TOML on one line."""
    return "{" + ", ".join(entry(name, value) for name, value in entries.items()) + "}"


def head(export: Export) -> Lines:
    """What was found and assumed, as comments; one line each."""
    yield "# Written by `calibrate convert`. Check what is ASSUMED."
    for sentence in export.skipped:
        yield f"# {safe(f'WARNING {sentence}')}"
    for specimen in export.specimens:
        for finding in specimen.findings:
            mark = "WARNING " if finding.fault else ""
            yield f"# {safe(f'{mark}{specimen.label}: {finding.text}')}"
    for note in export.strengths.notes if export.strengths else ():
        yield f"# {safe(note)}"


def soil(export: Export) -> Lines:
    """[soil]: its name, where it is from, its densities."""
    yield "[soil]"
    yield entry("name", safe(Path(export.file).stem) or "soil")
    yield entry("source", safe(f"{Path(export.file).name}, {export.layout}"))
    densities = _known(export, "density")
    if densities:
        yield entry("density", [f"{density:.5g} kg/m^3" for density in densities])
    else:
        yield '# density = ["1830 kg/m^3"]  # not in the file: add it'


def _specimen(export: Export) -> Lines:
    """[specimen]: mean diameter and height, or the usual ones and said so."""
    yield "[specimen]"
    for name, usual in USUAL.items():
        sizes = _known(export, name)
        comment = "" if sizes else "ASSUMED: the file does not say"
        if sizes and np.ptp(sizes) > 0.01 * float(np.mean(sizes)):
            comment = "mean: the specimens differ"
        yield entry(name, _millimetres(sizes, usual), comment)


def _known(export: Export, name: str) -> list[float]:
    """A size or density (SI) of all specimens and strengths that state it."""
    all_of = [*export.specimens, *([export.strengths] if export.strengths else [])]
    return [value for each in all_of if (value := getattr(each, name)) is not None]


def _millimetres(sizes: Sequence[float], usual: float) -> str:
    return f"{1e3 * (float(np.mean(sizes)) if sizes else usual):.5g} mm"


def _start(export: Export) -> Lines:
    """[parameters]: a shear modulus to start from, where the usual one would not bear the load."""
    areas = [np.pi / 4 * (s.diameter or DIAMETER) ** 2 for s in fitted(export)]
    stresses = [s.force_n.max() / area for s, area in zip(fitted(export), areas, strict=True)]
    wanted = min(STIFFNESS * max(stresses, default=0.0), STIFFEST)
    if wanted > float(SoilParameters().shear_modulus):
        yield "[parameters]"
        comment = f"ASSUMED: a start that bears {1e-3 * max(stresses):.4g} kPa"
        yield entry("shear_modulus", f"{1e-6 * wanted:.3g} MPa", comment)


def _curves(export: Export, table: str, specimens: Sequence[Specimen]) -> Iterator[Lines]:
    """One table for each curve of these specimens that a fit uses."""
    for file, specimen in curve_files(export).items():
        if specimen in specimens and specimen in fitted(export):
            yield curve(table, file, specimen)


def curve(table: str, file: str, specimen: Specimen) -> Lines:
    """The table of one curve."""
    yield f"[[{table}]]"
    if table == "curves":
        yield entry("test", specimen.test)
    yield entry("file", file)
    yield f"displacement = {inline(column='displacement_mm', unit='mm')}"
    yield f"force = {inline(column='force_n', unit='N')}"
    if specimen.points:
        yield entry("points", True)


def _not_listed(export: Export, specimens: Sequence[Specimen]) -> Lines:
    """Why curves are left out."""
    for file, specimen in curve_files(export).items():
        if specimen in specimens and specimen not in fitted(export):
            why = "it ends at the load cell's limit" if usable(specimen) else "no force above 2 N"
            yield f"# {file} is not listed: {why}"


# ---- one table a test


def _plain_tests(export: Export) -> Iterator[Lines]:
    for test in (STIFFENS, SOFTENS):
        specimens = [s for s in export.specimens if s.test == test]
        if specimens:
            yield _plain_test(export, test, specimens)
    yield _not_listed(export, export.specimens)
    yield from _curves(export, "curves", export.specimens)


def _plain_test(export: Export, test: str, specimens: Sequence[Specimen]) -> Lines:
    """A test's platen speed and forces, and what its curves give as scalars, as a comment: the
    curves themselves are fitted."""
    yield f"[{test}]"
    known = rates(specimens)
    if known:
        yield entry("rate", f"{1e3 * float(np.mean(known)):.4g} mm/s")
    else:
        yield "# the platen's speed is not known: ASSUMED is the default"
    name, unit = "crushing_force_n", "N"
    if test == STIFFENS:
        forces = loading_forces(export)
        yield entry("force_low", f"{forces.low:.4g} N")
        note = f"ASSUMED: {forces.note}" if forces.note else ""
        yield entry("force_high", f"{forces.high:.4g} N", note)
        name, unit = "depression_depth_mm", "mm"
    values = observables(export)[name]
    if values:
        spread = f" +- {np.std(values, ddof=1):.3g}" if len(values) > 1 else ""
        text = f"{name}: {np.mean(values):.4g}{spread} {unit} from {len(values)} curve(s)"
        yield f"# {text}; not a target, because the curves hold it already"


def rates(specimens: Sequence[Specimen]) -> list[float]:
    """The speeds (m/s) of specimens that have one."""
    return [s.rate for s in specimens if s.rate is not None and s.rate > 0]


# ---- a list of tests


def _listed_tests(export: Export) -> Iterator[Lines]:
    groups: dict[tuple[str, Course], list[Specimen]] = {}
    for specimen in export.specimens:
        groups.setdefault((specimen.test, course_of(specimen)), []).append(specimen)
    for place, ((test, course), specimens) in enumerate(groups.items()):
        name = test if len(groups) == 1 else clean_name(f"{test} {specimens[0].label}")
        sizes = _sizes(export, specimens) if place else ""
        if test == SOFTENS:
            yield _preparation(name, specimens[0].diameter, sizes)
            sizes = ""
        yield _listed_test(export, name, course, specimens, sizes)
        yield from _curves(export, "tests.curves", specimens)
    if export.strengths:
        yield _preparation(SOFTENS, export.strengths.diameter, "")
        yield from _crushing(export.strengths)


def _sizes(export: Export, specimens: Sequence[Specimen]) -> str:
    """A new specimen: mean diameter and height of these, of all where these do not say."""
    sizes = {name: [getattr(s, name) for s in specimens if getattr(s, name)] for name in USUAL}
    return inline(**{
        name: _millimetres(sizes[name] or _known(export, name), usual)
        for name, usual in USUAL.items()
    })  # fmt: skip


def _preparation(test: str, diameter: float | None, sizes: str) -> Lines:
    """The pressing in the mould before a crushing test; `sizes` of the specimen, if a new one."""
    share = ((diameter or DIAMETER) / DIAMETER) ** 2
    yield "[[tests]]"
    yield entry("name", "preparation" if test == SOFTENS else clean_name(f"preparation {test}"))
    yield entry("type", STIFFENS)
    yield (
        "# ASSUMED: how hard the specimen was pressed before; a bed never pressed has no strength"
    )
    if sizes:
        yield f"specimen = {sizes}"
    yield entry("force_low", f"{FORCE_LOW * share:.4g} N")
    yield entry("force_high", f"{FORCE_HIGH * share:.4g} N")


def _listed_test(
    export: Export, name: str, course: Course, specimens: Sequence[Specimen], sizes: str
) -> Lines:
    """One [[tests]] table, and the protocol to each turn of the load, without the steps between."""
    yield "[[tests]]"
    yield entry("name", name)
    yield entry("type", specimens[0].test)
    if sizes:
        yield f"specimen = {sizes}"
    if not course:
        known = rates(specimens)
        speed = f"{1e3 * float(np.mean(known)):.4g} mm/s" if known else "not known"
        yield f"# the platen's speed was {speed}; ASSUMED is the protocol of the type"
    else:
        yield (
            "# ASSUMED: the steps between the turns are passed without a hold, "
            "at the type's own rate"
        )
        yield "protocol = ["
        for place, load in enumerate(course):
            word = ("unload", "reload")[(place - 1) % 2] if place else "load"
            yield f"    {inline(step=word, to=load)},"
        yield "]"
        times = [s.time_s for s in specimens if s.time_s is not None and s.points]
        if times:
            longest = max(float(np.ptp(time)) for time in times) / 3600
            yield f"# read over {longest:.4g} h; drainage takes that time and is not simulated"
    yield from _not_listed(export, specimens)


def _crushing(strengths: Strengths) -> Iterator[Lines]:
    """Strengths as the scalar target of a crushing test."""
    force = strengths.force_n
    mean, scatter = float(np.mean(force)), float(np.std(force, ddof=1))
    table = ["[[tests]]", entry("name", strengths.test), entry("type", strengths.test)]
    if scatter < 1e-3 * mean:
        scatter = 0.05 * mean
        table.append("# ASSUMED: a scatter of 5 %, because all strengths are equal")
    yield iter(table)
    target = inline(mean=f"{mean:.4g} N", scatter=f"{scatter:.3g} N", repeats=len(force))
    yield iter(["[tests.targets]", f"crushing_force_n = {target}"])
