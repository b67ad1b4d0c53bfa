"""The lab file and the curve files that `calibrate fit` reads, as texts.

What the export does not say is written with the word ASSUMED beside it.
"""

from dataclasses import dataclass

import numpy as np
import tomlkit
from tomlkit import TOMLDocument

from calibrate.instrument_import import testtext
from calibrate.instrument_import.convert import Export
from calibrate.instrument_import.labparts import (
    FORCE_HIGH,
    FORCE_LOW,
    add_head,
    add_soil,
    add_specimen,
    column,
    curve_files,
    fitted,
    safe,
    usable,
)
from calibrate.instrument_import.specimens import Specimen
from calibrate.instrument_import.strengths import Strengths
from calibrate.instrument_import.vocabulary import SOFTENS, STIFFENS
from calibrate.labtests.reading import displacement_on_rise, loading

STRENGTHS_FILE = "strengths.csv"
REACHED = 0.98  # of force_high is what `calibrate fit` asks of a curve


@dataclass(frozen=True)
class Forces:
    """The forces (N) between which the depression depth counts; why, if not the usual ones."""

    low: float
    high: float
    note: str


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


def lab_text(export: Export) -> str:
    """The lab file that names these curves."""
    if not export.is_plain or any(testtext.course_of(s) for s in export.specimens):
        return testtext.lab_text(export)
    document = tomlkit.document()
    add_head(document, export)
    add_soil(document, export)
    add_specimen(document, export)
    _add_tests(document, export)
    _add_targets(document, export)
    _add_curves(document, export)
    return tomlkit.dumps(document)


def _add_tests(document: TOMLDocument, export: Export) -> None:
    forces = loading_forces(export)
    for test in (STIFFENS, SOFTENS):
        specimens = [s for s in export.specimens if s.test == test]
        if not specimens:
            continue
        table = tomlkit.table()
        rates = [s.rate for s in specimens if s.rate is not None and s.rate > 0]
        if rates:
            table["rate"] = f"{1e3 * float(np.mean(rates)):.4g} mm/s"
        else:
            table.add(tomlkit.comment("the platen's speed is not known: ASSUMED is the default"))
        if test == STIFFENS:
            table["force_low"] = f"{forces.low:.4g} N"
            high = tomlkit.string(f"{forces.high:.4g} N")
            if forces.note:
                high.comment(safe(f"ASSUMED: {forces.note}"))
            table["force_high"] = high
        document[test] = table


def _add_targets(document: TOMLDocument, export: Export) -> None:
    """What the curves give as scalars, as a comment: the curves themselves are fitted."""
    units = {"depression_depth_mm": "mm", "crushing_force_n": "N"}
    for name, values in observables(export).items():
        if not values:
            continue
        spread = f" +- {np.std(values, ddof=1):.3g}" if len(values) > 1 else ""
        text = f"{name}: {np.mean(values):.4g}{spread} {units[name]} from {len(values)} curve(s); "
        document.add(tomlkit.comment(text + "not a target, because the curves hold it already"))
    document.add(tomlkit.nl())


def _add_curves(document: TOMLDocument, export: Export) -> None:
    curves = tomlkit.aot()
    for name, specimen in curve_files(export).items():
        if specimen not in fitted(export):
            why = "it ends at the load cell's limit" if usable(specimen) else "no force above 2 N"
            document.add(tomlkit.comment(f"{name} is not listed: {why}"))
            continue
        table = tomlkit.table()
        table["test"] = specimen.test
        table["file"] = name
        table["displacement"] = column("displacement_mm", "mm")
        table["force"] = column("force_n", "N")
        curves.append(table)
    document["curves"] = curves
