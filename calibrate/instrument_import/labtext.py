"""The lab file and the curve files that `calibrate fit` reads, as texts.

What the export does not say is written with the word ASSUMED beside it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomlkit
from tomlkit import TOMLDocument

from calibrate.instrument_import.convert import Export, file_stem
from calibrate.instrument_import.specimens import DIAMETER, HEIGHT, Specimen
from calibrate.io.reading import SEATING, displacement_up

FORCE_LOW, FORCE_HIGH = 200.0, 400.0  # N; of the depression depth, as in the bundled soil
REACHED = 0.98  # of force_high is what `calibrate fit` asks of a curve


@dataclass(frozen=True)
class Forces:
    """The forces (N) between which the depression depth counts; why, if not the usual ones."""

    low: float
    high: float
    note: str


def curve_files(export: Export) -> dict[str, Specimen]:
    """The specimens by the name of their curve file."""
    files: dict[str, Specimen] = {}
    for number, specimen in enumerate(export.specimens, start=1):
        name = f"{file_stem(specimen.label)}_{specimen.test}.csv"
        files[name if name not in files else f"{number}_{name}"] = specimen
    return files


def curve_text(specimen: Specimen) -> str:
    """A curve as CSV with a header and units in it."""
    columns = {"displacement_mm": specimen.displacement_mm, "force_n": specimen.force_n}
    if specimen.time_s is not None:
        columns = {"time_s": specimen.time_s - specimen.time_s[0], **columns}
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


def loading_forces(export: Export) -> Forces:
    """200 and 400 N where every confined curve reaches them, less where one does not."""
    peaks = [float(s.force_n.max()) for s in fitted(export) if s.test == "confined"]
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
        if specimen.test == "confined":
            top = int(np.argmax(specimen.force_n)) + 1
            loading = (specimen.displacement_mm[:top], specimen.force_n[:top])
            low, high = (displacement_up(*loading, f) for f in (forces.low, forces.high))
            depths.append(high - low)
        elif not specimen.clipped:
            crushing.append(float(specimen.force_n.max()))
    return {"depression_depth_mm": depths, "crushing_force_n": crushing}


def usable(specimen: Specimen) -> bool:
    """Whether `calibrate fit` can read the curve: it exceeds the force where travel counts."""
    return bool(specimen.force_n.max() > SEATING)


def fitted(export: Export) -> list[Specimen]:
    """The specimens that the lab file names; clipped ones only where a test has no other."""
    whole = {s.test for s in export.specimens if usable(s) and not s.clipped}
    return [s for s in export.specimens if usable(s) and not (s.clipped and s.test in whole)]


def lab_text(export: Export) -> str:
    """The lab file that names these curves."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Written by `calibrate convert`. Check what is ASSUMED."))
    for sentence in export.skipped:
        document.add(tomlkit.comment(_safe(f"WARNING {sentence}")))
    for specimen in export.specimens:
        for finding in specimen.findings:
            mark = "WARNING " if finding.fault else ""
            document.add(tomlkit.comment(_safe(f"{mark}{specimen.label}: {finding.text}")))
    document.add(tomlkit.nl())
    _add_soil(document, export)
    _add_specimen(document, export)
    _add_tests(document, export)
    _add_targets(document, export)
    _add_curves(document, export)
    return tomlkit.dumps(document)


def _add_soil(document: TOMLDocument, export: Export) -> None:
    soil = tomlkit.table()
    soil["name"] = _safe(Path(export.file).stem) or "soil"
    soil["source"] = _safe(f"{Path(export.file).name}, {export.layout}")
    densities = [s.density for s in export.specimens if s.density is not None]
    if densities:
        soil["density"] = [f"{density:.5g} kg/m^3" for density in densities]
    else:
        soil.add(tomlkit.comment('density = ["1830 kg/m^3"]  # not in the file: add it'))
    document["soil"] = soil


def _add_specimen(document: TOMLDocument, export: Export) -> None:
    table = tomlkit.table()
    for name, usual in (("diameter", DIAMETER), ("height", HEIGHT)):
        stated = [size for s in export.specimens if (size := getattr(s, name)) is not None]
        size = float(np.mean(stated)) if stated else usual
        item = tomlkit.string(f"{1e3 * size:.5g} mm")
        if not stated:
            item.comment("ASSUMED: the file does not say")
        elif np.ptp(stated) > 0.01 * size:
            item.comment("mean: the specimens differ")
        table[name] = item
    document["specimen"] = table


def _add_tests(document: TOMLDocument, export: Export) -> None:
    forces = loading_forces(export)
    for test in ("confined", "unconfined"):
        specimens = [s for s in export.specimens if s.test == test]
        if not specimens:
            continue
        table = tomlkit.table()
        rates = [s.rate for s in specimens if s.rate is not None and s.rate > 0]
        if rates:
            table["rate"] = f"{1e3 * float(np.mean(rates)):.4g} mm/s"
        else:
            table.add(tomlkit.comment("the platen's speed is not known: ASSUMED is the default"))
        if test == "confined":
            table["force_low"] = f"{forces.low:.4g} N"
            high = tomlkit.string(f"{forces.high:.4g} N")
            if forces.note:
                high.comment(_safe(f"ASSUMED: {forces.note}"))
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
        table["displacement"] = _column("displacement_mm", "mm")
        table["force"] = _column("force_n", "N")
        curves.append(table)
    document["curves"] = curves


def _column(column: str, unit: str):
    table = tomlkit.inline_table()
    table.update({"column": column, "unit": unit})
    return table


def _safe(text: str) -> str:
    """Text from a file on one line without control characters."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else "?" for c in line)[:300]
