"""A library of formulas: 56 rows of the soil in `formulas`, two errors of the load cell, density.

Small enough that a whole diagnosis takes seconds; kernels are those that fitting starts from.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from formulas import BASE, LAB, specimen

from calibrate.discrepancy.library.design import Design
from calibrate.discrepancy.library.emulator import COMPONENTS
from calibrate.discrepancy.library.kernel import Kernel
from calibrate.discrepancy.library.run_library import Cylinder, RunLibrary, collect, curves_of
from calibrate.discrepancy.library.simulate import RunPoints
from calibrate.discrepancy.library.store import NOTHING, save
from calibrate.io.soil import with_values
from calibrate.labtests.diagnosis.base import Curves
from calibrate.simulation import Run
from calibrate.validation.laboratory import SpecimenRecords, recorded, write_case

PACKINGS, ROWS = 14, 4
CENTRE = {"shear_modulus": float(BASE.shear_modulus), "surface_energy": float(BASE.surface_energy)}
DESIGN = Design(
    packings=PACKINGS,
    rows_each=ROWS,
    slow_in=0,
    centre=CENTRE,
    soil_sd={"shear_modulus": 0.35, "surface_energy": 0.45},
    limits={
        "load_cell_gain": (-0.2, 0.2),
        "load_cell_offset": (-15.0, 15.0),
        "specimen_density": (-0.03, 0.03),
    },
)


def run(soil_ln: np.ndarray, strengths: np.ndarray, seed: int) -> Run:
    """One specimen: soil (2,) as ln p over the centre, strengths (3,) in SI."""
    values = {n: CENTRE[n] * float(np.exp(x)) for n, x in zip(CENTRE, soil_ln, strict=True)}
    plain = specimen(with_values(BASE, values), seed)
    gain, offset, density = strengths
    dense = np.array([1 - 5 * density, 1 + 10 * density])
    changed = {}
    for test in ("confined", "unconfined"):
        curve = plain.curves[test] * (dense if test == "unconfined" else [dense[0], 1.0])
        changed[test] = np.column_stack([curve[:, 0], (1 + gain) * curve[:, 1] + offset])
    return replace(plain, curves=changed)


def runs(design: Design) -> list[Run]:
    """All runs of a design of this kind."""
    base, strengths = design.rows()
    rows = zip(base[:, :2], strengths, range(len(base)), strict=True)
    return [run(soil, strength, row // ROWS) for soil, strength, row in rows]


@cache
def library() -> RunLibrary:
    made = collect(DESIGN, LAB, runs(DESIGN), run(np.zeros(2), np.zeros(3), 900))
    start = Kernel.start(made.base.shape[1], made.strengths.shape[1])
    kernels = (start._replace(local=np.full(made.strengths.shape[1], NOTHING)),) * COMPONENTS
    return replace(made, cylinder=Cylinder.of(LAB), kernels=kernels)


def run_points(design: Design, points: RunPoints, *_) -> list[Run]:
    """What `calibrate.discrepancy.library.simulate.run_points` does, by formula."""
    rows = zip(points.base[:, :2], points.strengths, points.seeds, strict=True)
    return [run(soil, strength, int(seed)) for soil, strength, seed in rows]


def write_library(path: Path) -> Path:
    save(library(), path)
    return path


def reference() -> Curves:
    return curves_of(run(np.zeros(2), np.zeros(3), 900))


def write_lab(folder: Path, name: str, offset: float, specimens: int = 4) -> Path:
    """A laboratory's files: specimens of other packings than the library's, offset in N."""
    rng = np.random.default_rng(3)
    made = []
    for number in range(specimens):
        found = run(np.array([0.1, -0.1]), np.array([0.0, offset, 0.0]), 700 + number)
        records = {
            test: recorded(found.curves[test], offset, rng) for test in ("confined", "unconfined")
        }
        made.append(SpecimenRecords(records, 1829.6 * (1 + 0.004 * rng.standard_normal())))
    write_case(name, made, CENTRE, folder)
    return folder / "lab.toml"
