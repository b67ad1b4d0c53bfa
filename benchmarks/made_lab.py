"""Lab files of simulated specimens, behind which benchmarks hide parameters.

Everything but the measurements is the bundled soil's: starting values, sizes, rates.
"""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import with_values
from calibrate.simulation import Run
from jdem.materials.soil import SoilParameters

LABORATORY = 50_000  # added to a seed: the laboratory's packings are never fitted
UNITS = {"depression_depth": "mm", "crushing_force": "N"}


def scaled(soil: SoilParameters, factors: dict[str, float]) -> SoilParameters:
    """The soil with some parameters multiplied."""
    return with_values(soil, {n: f * float(getattr(soil, n)) for n, f in factors.items()})


def of_targets(path: Path, runs: Sequence[Run]) -> Lab:
    """A lab that measured depth and force of these runs."""
    measured = ""
    for name, unit in UNITS.items():
        values = [run.observables[f"{name}_{unit.lower()}"] for run in runs]
        measured += (
            f'[targets.{name}]\nmean = "{np.mean(values):.6g} {unit}"\n'
            f'scatter = "{np.std(values, ddof=1):.6g} {unit}"\nrepeats = {len(runs)}\n\n'
        )
    return _made(path, measured)


def of_curves(path: Path, runs: Sequence[Run], without: tuple[str, ...] = ()) -> Lab:
    """A lab that recorded these runs' curves, and did not do the tests `without`."""
    measured = ""
    for number, run in enumerate(runs, start=1):
        for test, curve in run.curves.items():
            if test in without:
                continue
            _write(path.with_name(f"{test}_{number}.csv"), curve)
            measured += (
                f'[[curves]]\ntest = "{test}"\nfile = "{test}_{number}.csv"\n'
                'displacement = { column = "displacement", unit = "mm" }\n'
                'force = { column = "force", unit = "N" }\n\n'
            )
    return _made(path, measured, without)


def _made(path: Path, measured: str, without: tuple[str, ...] = ()) -> Lab:
    """The bundled lab file with other measurements, written and read."""
    tables = re.split(r"(?m)^(?=\[)", bundled_lab().read_text(encoding="utf-8"))[1:]
    dropped = tuple(f"[{name}" for name in ("targets", "named_sets", *without))
    kept = "".join(table for table in tables if not table.startswith(dropped))
    write_text(path, kept + "\n\n" + measured)
    return load_lab(path)


def _write(path: Path, curve: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["displacement", "force"])
        writer.writerows([[f"{x:.6g}", f"{f:.6g}"] for x, f in curve])
