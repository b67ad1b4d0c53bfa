"""Which rows no longer hold?  Smaller forms of them in ten minutes: `make verification-quick`.

    python -m verification.quick                     nine processor minutes
    python -m verification.quick --only contact

First every sentence is compared with the result page that it rests on, and with its rule.  Then
rows of which a smaller form can be had are measured anew and compared with the stored numbers: a
mean over fewer specimens may differ by three standard errors, sqrt(1/n + 1/N) of the stored scatter
each.  Nothing is kept.  Exit status 1 if a row does not hold; rows that take longer are named.
"""

import argparse
import contextlib
import io
import re
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibrate.io.lab import bundled_lab, load_lab
from studies.liggghts import export_contact
from verification import convergence, prior, recovery, reporting, resolution
from verification.reporting import ROOT, Cell, Row
from verification.rows import ROWS
from verification.scripts import SCRIPTS

ERRORS = 3.0  # standard errors that a mean may differ by
SPHERES, SPECIMENS = 500, 4
SOILS = 6
ENERGY = 0.002  # of the platen's work, what a sound run has
REFUSED = 20  # malformed files of each kind
Measured = dict[str, list[float]]


@dataclass(frozen=True)
class Reading:
    """One number of a row: as stored, as it is now, and by how much these may differ."""

    row: str
    what: str
    stored: float
    now: float
    allowed: float

    def holds(self) -> bool:
        return bool(abs(self.now - self.stored) <= self.allowed)


@dataclass(frozen=True)
class Check:
    """What is measured (in a folder for runs), and its comparison with the stored numbers (in the
    result pages under a root)."""

    rows: tuple[str, ...]
    measure: Callable[[Path], Measured]
    compare: Callable[[Measured, Path], list[Reading]]


# ---------------------------------------------------------------- one contact


def contact(folder: Path) -> Measured:
    """Our law along the loops that LIGGGHTS took: largest deviation over the largest force."""
    path = export_contact.DATA / "loops.csv"
    loops = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    found = {}
    for name, changes in export_contact.CASES.items():
        rows = loops[loops["loop"] == f"liggghts_{name}"]
        overlap, force = rows["overlap_m"], rows["normal_force_n"]
        ours = export_contact.ours(export_contact.soil(changes), overlap)
        found[name] = export_contact.deviations(overlap, force, ours)
    return found


def compare_contact(found: Measured, root: Path) -> list[Reading]:
    readings = []
    for name, legs in found.items():
        cells = [Cell("export_contact", leg, {"soil": name}, folder="studies")
                 for leg in ("load", "unload", "reload", "separate")]  # fmt: skip
        stored = max(cell.read(root) for cell in cells)
        what = f"{name}: deviation along a loop, over the largest force"
        readings.append(Reading("one contact in LIGGGHTS", what, stored, max(legs), 2e-6))
    return readings


# ---------------------------------------------------------------- specimens of 500 spheres


def specimens(folder: Path) -> Measured:
    """Depth, force and energy error of four specimens; changes with half the time step."""
    lab = load_lab(bundled_lab())
    chosen = Namespace(spheres=SPHERES, packings=SPECIMENS, seed=0, folder=folder)
    halved = next(v for v in convergence.VARIANTS if v.what == "time step halved")
    usual, finer = (convergence.measured(lab, v, chosen) for v in (convergence.BASE, halved))
    depths, forces = (
        [[run.observables[name] for run in runs] for runs in (usual, finer)]
        for name in ("depression_depth_mm", "crushing_force_n")
    )
    return {
        "H": depths[0],
        "F": forces[0],
        "dH": np.subtract(depths[1], depths[0]).tolist(),
        "dF": np.subtract(forces[1], forces[0]).tolist(),
        "energy": [run.quality["energy_balance"] for run in usual],
    }


def compare_specimens(found: Measured, root: Path) -> list[Reading]:
    readings = []
    for name, unit in (("H", "mm"), ("F", "N")):
        columns = f"{name} ({unit}) ± scatter", f"{name} ({unit})"
        for row, cells in (
            ("convergence", [_variant("as the preset", columns[0], part) for part in (0, 1)]),
            ("number of spheres", [_bed(SPHERES, columns[1], part) for part in (0, 1)]),
        ):
            mean, scatter = (cell.read(root) for cell in cells)
            what = f"mean {name} of {SPHERES} spheres ({unit})"
            readings.append(_mean(row, what, mean, scatter, found[name]))
        cells = [_variant("time step halved", f"Δ{name} ± s.e.", part) for part in (0, 1)]
        mean, error = (cell.read(root) for cell in cells)
        now = found[f"d{name}"]
        allowed = ERRORS * float(np.hypot(error, np.std(now, ddof=1) / np.sqrt(len(now))))
        what = f"change of {name} by half the time step ({unit})"
        readings.append(Reading("convergence", what, mean, float(np.mean(now)), allowed))
    stored = _variant("as the preset", "energy balance").read(root)
    what = "energy error over the platen's work, largest"
    return [*readings, Reading("convergence", what, stored, max(found["energy"]), ENERGY)]


def _variant(variant: str, column: str, part: int = 0) -> Cell:
    return Cell("convergence", column, {"variant": variant}, part)


def _bed(spheres: int, column: str, part: int = 0) -> Cell:
    return Cell("resolution", column, {"beds": "usual porosity", "spheres": str(spheres)}, part)


def _mean(row: str, what: str, stored: float, scatter: float, now: list[float]) -> Reading:
    """A mean beside a stored one of eight or so specimens."""
    allowed = ERRORS * scatter * float(np.sqrt(1 / len(now) + 1 / 6))
    return Reading(row, what, stored, float(np.mean(now)), allowed)


def small(folder: Path) -> Measured:
    """Depth and force of specimens of 150 spheres."""
    runs = resolution.measured(load_lab(bundled_lab()), 150, folder)
    names = {"H": "depression_depth_mm", "F": "crushing_force_n"}
    return {key: [run.observables[name] for run in runs] for key, name in names.items()}


def compare_small(found: Measured, root: Path) -> list[Reading]:
    readings = []
    for name, unit in (("H", "mm"), ("F", "N")):
        mean, scatter = (_bed(150, f"{name} ({unit})", part).read(root) for part in (0, 1))
        what = f"mean {name} of 150 spheres ({unit})"
        readings.append(_mean("number of spheres", what, mean, scatter, found[name]))
    return readings


# ---------------------------------------------------------------- soils, a calibration, files


def soils(folder: Path) -> Measured:
    """Soils of the prior: how many fail, and what half the time step changes."""
    chosen = Namespace(soils=SOILS, seed=0, folder=folder)
    lab = load_lab(bundled_lab())
    runs = [prior.simulated(lab, SPHERES, factor, chosen) for factor in (1.0, 0.5)]
    found = prior.compared(runs[0], runs[1], [])
    return {"failed": [float(len(found["failures"]))], "changes": found["changes_of_depth"]}


def compare_soils(found: Measured, root: Path) -> list[Reading]:
    row, where = "any plausible soil", {"spheres": str(SPHERES)}
    failed = Cell("convergence", "failed", where).read(root)
    largest = Cell("convergence", "H changed by half the step, largest", where).read(root)
    change = 100 * max(found["changes"])
    return [
        Reading(row, f"soils that fail, of {SOILS}", failed, found["failed"][0], 0.0),
        Reading(row, "largest change of H by half the time step (%)", largest, change, 2.0),
    ]


def calibration(folder: Path) -> Measured:
    """One fit of two hidden parameters to depth and force, with 150 spheres."""
    case = recovery.CASES["two"]
    done = recovery.measured_case("two", case, 0, folder)
    work = recovery.campaign(lab := load_lab(Path(done["lab_file"])), folder)
    free, fit = recovery.recovered(lab, tuple(case.hidden), {}, 0, work)
    rows = recovery.entry(free, fit, done["hidden"], work)["parameters"]
    return {
        "inside": [float(row["inside"]) for row in rows.values()],
        **{name: [row["fitted"]] for name, row in rows.items()},
    }


def compare_calibration(found: Measured, root: Path) -> list[Reading]:
    row, inside = "recovery", found["inside"]
    readings = [Reading(row, "intervals with the hidden value", len(inside), sum(inside), 0.0)]
    for name in ("shear_modulus", "surface_energy"):
        where = {"under": re.compile("two"), "start": "base soil", "parameter": name}
        stored = Cell("recovery", "fitted", where).read(root)
        low, high = (Cell("recovery", "95 % interval", where, part).read(root) for part in (0, 1))
        readings.append(Reading(row, f"fitted {name}", stored, found[name][0], (high - low) / 2))
    return readings


def files(folder: Path) -> Measured:
    """Malformed files of each kind that lead to a traceback or another exit status."""
    from verification import fuzz  # brings tests' helpers

    found = {}
    for number, kind in enumerate(fuzz.KINDS):
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            counts, _ = fuzz.fuzzed(kind, REFUSED, number, folder / "strange")
        found[kind] = [float(counts["strange"])]
    return found


def compare_files(found: Measured, root: Path) -> list[Reading]:
    column = "traceback or other status"
    return [
        Reading("malformed files", f"{kind}: {column}", stored, now[0], 0.0)
        for kind, now in found.items()
        for stored in [Cell("reliability", column, {"file": kind}).read(root)]
    ]


CHECKS = {
    "contact": Check(("one contact in LIGGGHTS",), contact, compare_contact),
    "files": Check(("malformed files",), files, compare_files),
    "small": Check(("number of spheres",), small, compare_small),
    "specimens": Check(("convergence", "number of spheres"), specimens, compare_specimens),
    "soils": Check(("any plausible soil",), soils, compare_soils),
    "calibration": Check(("recovery",), calibration, compare_calibration),
}


# ---------------------------------------------------------------- what is told


def faults(row: Row, root: Path = ROOT) -> list[str]:
    """What is wrong with a row as it is stored: no number, a rule broken, another sentence."""
    try:
        numbers = row.numbers(root)
    except (LookupError, ValueError) as error:
        return [f"no number: {error}"]
    broken = [] if row.holds(numbers) else [f"its rule is broken: {row.rule}"]
    said = [f"{row.page} does not say {words!r}" for words in row.contradicted(numbers, root)]
    return broken + said


def told(readings: list[Reading]) -> str:
    """The table of what was measured."""
    lines = [
        [r.row, r.what, f"{r.stored:.4g}", f"{r.now:.4g}", f"{r.allowed:.2g}",
         "holds" if r.holds() else "DOES NOT HOLD"]
        for r in readings
    ]  # fmt: skip
    return reporting.table(("row", "number", "stored", "now", "may differ by", "verdict"), lines)


def judged(found: dict[str, Measured], root: Path = ROOT) -> tuple[list[Reading], dict[str, str]]:
    """All comparisons, and the rows that do not hold with the reason."""
    bad = {row.name: "; ".join(wrong) for row in ROWS if (wrong := faults(row, root))}
    readings = []
    for name, measured in found.items():
        try:
            readings += CHECKS[name].compare(measured, root)
        except (LookupError, ValueError) as error:
            bad |= {row: f"no number: {error}" for row in CHECKS[name].rows if row not in bad}
    for reading in readings:
        if not reading.holds():
            bad.setdefault(reading.row, f"{reading.what}: {reading.now:.4g}")
    return readings, bad


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--only", nargs="+", choices=list(CHECKS), default=list(CHECKS))
    chosen = parser.parse_args()
    reporting.configure()
    found, begun = {}, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for number, name in enumerate(chosen.only, start=1):
            rows = ", ".join(CHECKS[name].rows)
            print(f"{number} of {len(chosen.only)}: {rows}", file=sys.stderr, flush=True)
            found[name] = CHECKS[name].measure(Path(folder))
            spent = time.monotonic() - begun
            print(f"    {spent:.0f} s since the beginning", file=sys.stderr, flush=True)
    readings, bad = judged(found)
    print(told(readings))
    measured = {row for name in found for row in CHECKS[name].rows}
    print("Stored numbers not measured here (`make verification` does):")
    for row in ROWS:
        if row.name not in measured:
            print(f"    {row.name}: about {SCRIPTS[row.script].minutes:g} processor minutes")
    for name, why in bad.items():
        print(f"DOES NOT HOLD: {name}: {why}")
    print(f"{len(ROWS) - len(bad)} of {len(ROWS)} rows hold, {len(measured)} of them measured now")
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
