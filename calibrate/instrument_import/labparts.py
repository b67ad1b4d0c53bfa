"""The parts that every lab file has: which curves it names, its head, soil and specimen."""

from pathlib import Path

import numpy as np
import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import InlineTable

from calibrate.instrument_import.convert import Export, file_stem
from calibrate.instrument_import.specimens import DIAMETER, HEIGHT, Specimen
from calibrate.instrument_import.strengths import Strengths
from calibrate.labtests.features import SEATING
from jdem.materials.soil import SoilParameters

FORCE_LOW, FORCE_HIGH = 200.0, 400.0  # N; of the depression depth, as in the bundled soil
STIFFNESS = 10.0  # shear modulus of particles over the largest stress that a bed has to bear
STIFFEST = 5e7  # Pa; half of what a fit may reach


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


def add_head(document: TOMLDocument, export: Export) -> None:
    """What was found and assumed, as comments; one line each."""
    document.add(tomlkit.comment("Written by `calibrate convert`. Check what is ASSUMED."))
    for sentence in export.skipped:
        document.add(tomlkit.comment(safe(f"WARNING {sentence}")))
    for specimen in export.specimens:
        for finding in specimen.findings:
            mark = "WARNING " if finding.fault else ""
            document.add(tomlkit.comment(safe(f"{mark}{specimen.label}: {finding.text}")))
    for note in export.strengths.notes if export.strengths else ():
        document.add(tomlkit.comment(safe(note)))
    document.add(tomlkit.nl())


def add_soil(document: TOMLDocument, export: Export) -> None:
    """[soil]: its name, where it is from, its densities."""
    soil = tomlkit.table()
    soil["name"] = safe(Path(export.file).stem) or "soil"
    soil["source"] = safe(f"{Path(export.file).name}, {export.layout}")
    densities = [s.density for s in _sized(export) if s.density is not None]
    if densities:
        soil["density"] = [f"{density:.5g} kg/m^3" for density in densities]
    else:
        soil.add(tomlkit.comment('density = ["1830 kg/m^3"]  # not in the file: add it'))
    document["soil"] = soil


def add_specimen(document: TOMLDocument, export: Export) -> None:
    """[specimen]: mean diameter and height, or the usual ones and said so."""
    table = tomlkit.table()
    for name, usual in (("diameter", DIAMETER), ("height", HEIGHT)):
        stated = [size for s in _sized(export) if (size := getattr(s, name)) is not None]
        size = float(np.mean(stated)) if stated else usual
        item = tomlkit.string(f"{1e3 * size:.5g} mm")
        if not stated:
            item.comment("ASSUMED: the file does not say")
        elif np.ptp(stated) > 0.01 * size:
            item.comment("mean: the specimens differ")
        table[name] = item
    document["specimen"] = table


def add_start(document: TOMLDocument, export: Export) -> None:
    """[parameters]: a shear modulus to start from, where the usual one would not bear the load."""
    areas = [np.pi / 4 * (s.diameter or DIAMETER) ** 2 for s in fitted(export)]
    stresses = [s.force_n.max() / area for s, area in zip(fitted(export), areas, strict=True)]
    wanted = min(STIFFNESS * max(stresses, default=0.0), STIFFEST)
    if wanted > float(SoilParameters().shear_modulus):
        table = tomlkit.table()
        table["shear_modulus"] = f"{1e-6 * wanted:.3g} MPa"
        table["shear_modulus"].comment(
            f"ASSUMED: a start that bears {1e-3 * max(stresses):.4g} kPa"
        )  # pyright: ignore[reportAttributeAccessIssue]
        document["parameters"] = table


def _sized(export: Export) -> list[Specimen | Strengths]:
    """All that may state a size or a density."""
    return [*export.specimens, *([export.strengths] if export.strengths else [])]


def column(name: str, unit: str) -> InlineTable:
    """Where a curve's quantity is found: { column = "force_n", unit = "N" }."""
    table = tomlkit.inline_table()
    table.update({"column": name, "unit": unit})
    return table


def safe(text: str) -> str:
    """Text from a file on one line without control characters."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else "?" for c in line)[:300]
