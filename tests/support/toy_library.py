"""A library of formulas: 56 rows of the soil in `formulas`, two errors of the load cell, density.

Small enough that a whole diagnosis takes seconds; kernels are those that fitting starts from.
"""

import hashlib
import sys
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import jax
import numpy as np
import pytest

from calibrate import cli
from calibrate.discrepancy import diagnosis
from calibrate.discrepancy.library.design import Design, RunPoints
from calibrate.discrepancy.library.emulator import COMPONENTS
from calibrate.discrepancy.library.kernel import start
from calibrate.discrepancy.library.run_library import Cylinder, RunLibrary, collect, curves_of
from calibrate.discrepancy.library.store import NOTHING, save
from calibrate.io.soil import with_values
from calibrate.labtests.diagnosis.base import Curves
from calibrate.simulation import Run
from studies.sealed import trial
from studies.sealed.laboratory import SpecimenRecords, recorded, write_case
from tests.support.formulas import BASE, LAB, specimen

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
    points = design.rows()
    rows = zip(points.base[:, :2], points.strengths, range(len(points.base)), strict=True)
    return [run(soil, strength, row // ROWS) for soil, strength, row in rows]


@cache
def library() -> RunLibrary:
    made = collect(DESIGN, LAB, runs(DESIGN), run(np.zeros(2), np.zeros(3), 900))
    first = start(made.rows.base.shape[1], made.rows.strengths.shape[1])
    kernels = (first._replace(local=np.full(made.rows.strengths.shape[1], NOTHING)),) * COMPONENTS
    return replace(made, cylinder=Cylinder.of(LAB), kernels=kernels)


def run_points(design: Design, points: RunPoints, *_) -> list[Run]:
    """What `calibrate.discrepancy.library.simulate.run_points` does, by formula."""
    rows = zip(points.base[:, :2], points.strengths, points.seeds, strict=True)
    return [run(soil, strength, int(seed)) for soil, strength, seed in rows]


def write_library(path: Path) -> Path:
    save(library(), path)
    return path


def with_few_draws(patch: pytest.MonkeyPatch) -> None:
    """From now on, null distributions of 100 draws in place of 400, which take most of the time
    of a diagnosis by this library."""
    few = partial(diagnosis.prepared_diagnosis, draws=100)
    for module in (diagnosis, trial):
        patch.setattr(module, "prepared_diagnosis", few)


def call(*arguments: object) -> int:
    """Exit status of a command line run in this process, with few draws."""
    settings = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in settings}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["calibrate", *map(str, arguments)])
        with_few_draws(patch)
        try:
            cli.main()
        except SystemExit as end:
            return int(end.code or 0)
        finally:
            for name, value in before.items():
                jax.config.update(name, value)
    return 0


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


# ------------------------------------------------------------------ withheld cases

CLASSES = [["seating_gap", "load_frame_compliance"], ["wall_friction"], ["acquisition_lag"]]
SEAT = "seating_gap / load_frame_compliance"


def there_and_back() -> np.ndarray:
    """A confined test as a formula: 100 N/mm up to 4 mm, and 400 N/mm back to no force."""
    up = np.column_stack([np.linspace(0, 4, 201), np.linspace(0, 400, 201)])
    down = np.column_stack([np.linspace(4, 3, 101), np.linspace(400, 0, 101)])
    return np.vstack([up, down[1:]])


def specimens(seed: int, stiff: float = 1.0, count: int = 4) -> list[SpecimenRecords]:
    """Specimens by formula; the second test rises to a peak at 4 mm and softens."""
    random = np.random.default_rng(seed)
    way = np.linspace(0, 12, 300)
    crushed = np.column_stack([way, 200 * stiff * way / 4 * np.exp(1 - way / 4)])
    return [
        SpecimenRecords(
            {
                "confined": recorded(there_and_back() * np.array([1 / stiff, 1.0]), 0.0, random),
                "unconfined": recorded(crushed, 0.0, random),
            },
            1830 * (1 + 0.004 * random.standard_normal()),
        )
        for _ in range(count)
    ]


def label(case: str, kind: str = "single", *hidden: str, snr: float = 7.0) -> dict:
    """What a generator seals of a case."""
    effects = [{"name": name, "strength": 1.0} for name in hidden]
    nonce = hashlib.sha256(case.encode()).hexdigest()
    return {"case": case, "kind": kind, "hidden": effects, "snr": snr, "nonce": nonce}


def verdict(case: str, said: str, stated: float = 0.9, **more) -> dict:
    """What a diagnosis writes of a case."""
    return {
        "case": case, "verdict": said, "stated": stated, "by_class": {said: stated},
        "likely_set": [said], "classes": CLASSES, "p_before": 0.01,
        "rivals": {name: "none" for name in ("majority", "template", "bic", "classifier")}, **more,
    }  # fmt: skip
