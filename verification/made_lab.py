"""Lab files of simulated specimens, behind which parameters are hidden.

Everything but the measurements is the bundled soil's: starting values, sizes, rates.

    python -m verification.made_lab                    all of LABS, some six minutes each of a core
    python -m verification.made_lab --labs strong      one of them

fits soils that are far from that start: `calibrate fit LAB --preset quick`, nothing chosen by hand.
Fits are kept in results/benchmarks/made_lab; a second call resumes.  Writes
verification/results/made_lab.md from every lab that is finished.
"""

import argparse
import csv
import json
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import with_values
from calibrate.simulation import Run
from jdem.materials.soil import SoilParameters
from verification import reporting

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


# Depth H, force F and the peak of one unconfined curve, over those of the bundled lab file.
LABS = {
    "strong and stiff": {"depth": 0.5, "force": 2.0},
    "strong": {"depth": 1.0, "force": 2.0},
    "weak": {"depth": 1.0, "force": 0.5},
    "stiff": {"depth": 0.5, "force": 1.0},
    "soft": {"depth": 2.0, "force": 1.0},
    "one strong curve": {"curve": 2.0},
    "one weak curve": {"curve": 0.5},
    "contradicting": {"curve": 1.0, "force": 3.0},
}
SCATTER, COUNT = 0.05, 5
HEADER = ("lab", "free", "met", "measured", "fitted packings", "fresh packings", "evaluations",
          "what the fit warned of first")  # fmt: skip


def far_lab(name: str, folder: Path) -> Path:
    """The lab file of one of LABS."""
    bundled, measured = load_lab(bundled_lab()), ""
    far, folder = LABS[name], folder / name.replace(" ", "_")
    for key, observable, unit in (
        ("depth", "depression_depth", "mm"),
        ("force", "crushing_force", "N"),
    ):
        if key in far:
            mean = far[key] * bundled.targets[f"{observable}_{unit.lower()}"].mean
            measured += (
                f'[targets.{observable}]\nmean = "{mean:.6g} {unit}"\n'
                f'scatter = "{SCATTER * mean:.6g} {unit}"\nrepeats = {COUNT}\n\n'
            )
    if "curve" in far:
        travel = np.linspace(0, 15, 301)  # mm; a bent rise to 206 N, as the bundled soil's
        peak = far["curve"] * bundled.targets["crushing_force_n"].mean
        _write(folder / "curve.csv", np.stack([travel, peak * -np.expm1(-travel / 2.5)], axis=1))
        measured += (
            '[[curves]]\ntest = "unconfined"\nfile = "curve.csv"\n'
            'displacement = { column = "displacement", unit = "mm" }\n'
            'force = { column = "force", unit = "N" }\n\n'
        )
    _made(folder / "lab.toml", measured)
    return folder / "lab.toml"


def row(name: str, result: dict) -> list[str]:
    """What one fit came to."""
    groups = [result["observables"], result["fresh_packings"]["observables"]]
    numbers = {key: result["targets"][key] for key in result["targets"]}
    peak = [f for f in result["features"].values() if not f["target"]]
    cells = [
        [f"{numbers[k]:.4g}" for k in numbers],
        *([f"{g[k]:.4g}" for k in numbers] for g in groups),
    ]
    if peak:
        cells[0].append(f"peak {max(f['measured'] for f in peak):.4g} N")
        cells[1].append(f"peak {max(f['simulated'] for f in peak):.4g} N")
        cells[2].append(f"F {groups[1]['crushing_force_n']:.4g} N")
    return [name, ", ".join(result["free"]), "yes" if result["met"] else "no",
            *("; ".join(c) for c in cells), str(len(result["history"])),
            next((w for w in result["warnings"] if "spheres across" not in w), "")]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--labs", nargs="+", choices=list(LABS), default=list(LABS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE / "made_lab")
    chosen = parser.parse_args()
    for name in chosen.labs:
        lab = far_lab(name, chosen.folder)
        options = [
            "--preset",
            "quick",
            "--seed",
            str(chosen.seed),
            "--out",
            str(lab.parent / "fit"),
        ]
        command = [sys.executable, "-m", "calibrate", "fit", str(lab), *options]
        subprocess.run(command, check=True)
        write_finished(chosen.folder)


def write_finished(folder: Path) -> None:
    """The page, of every lab that has a result."""
    found = {name: folder / name.replace(" ", "_") / "fit" / "result.json" for name in LABS}
    rows = [row(n, json.loads(p.read_text("utf-8"))) for n, p in found.items() if p.exists()]
    text = (
        "# Soils far from the start, fitted with nothing chosen by hand\n\n"
        "`calibrate fit LAB --preset quick`: 150 spheres, three packings fitted, three fresh. "
        "Labs measured H (mm) and F (N) of the bundled lab file, times some factor, or one made "
        "unconfined curve. So few spheres are for trying: fresh packings, unseen by the fit, "
        "crush at another force than those of the fit.\n\n"
    )
    reporting.write_page(
        "made_lab", text + reporting.table(HEADER, rows) + reporting.footer(reporting.provenance())
    )


if __name__ == "__main__":
    main()
