"""Both laboratory tests from beginning to end, in turn with LIGGGHTS on two cores.

Ours is the command `calibrate simulate --preset standard`: four packings of 2000 spheres, two at
a time, with compiling, making of beds and writing in its time; again with `--single`, numbers in
single precision.  LIGGGHTS 3.8.0 does the same two
tests with its own EEPA (`edinburgh`) on two ranks, on our beds and at our platen speeds, with the
soil of peers/in.tests and its time step scaled to these spheres: with ours its specimen falls
apart without the mould.  Rates count spheres times steps over all of the time from start to end.

    python benchmarks/whole_tests.py --rounds 2          some 8 minutes on two idle cores

Writes a section of benchmarks/results/README.md.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import reporting

from calibrate.core.progress import for_terminal
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import campaign
from jdem.observables import displacement_on_rise
from jdem.packing.specimen import Packing

PEERS = Path(__file__).parent / "peers"
REFERENCE = (5e-6, 4e-3)  # time step (s) and mean radius (m) of peers/in.tests
HEADER = ("round", "program", "specimens", "wall time (s)", "wall time of one (s)",
          "M particle-steps/s", "H (mm)", "F (N)")  # fmt: skip
FELL = 50.0  # N; a specimen that bears less has fallen apart without the mould
STANDARD = PRESETS["standard"]


def ours(folder: Path, *options: str) -> dict:
    """The command, from nothing but compiled programs of other commands: none."""
    shutil.rmtree(folder, ignore_errors=True)
    result = folder / "simulate.json"
    command = [sys.executable, "-m", "calibrate", "simulate", "--preset", "standard", *options]
    begun = time.perf_counter()
    subprocess.run([*command, "--out", str(folder), "--json", str(result)], check=True)
    seconds = time.perf_counter() - begun
    found = json.loads(result.read_text(encoding="utf-8"))
    work = found["particle_steps_per_s"] * found["runtime_s"]
    return {
        "program": " ".join(["calibrate simulate", *options]),
        "specimens": len(found["packings"]),
        "seconds": seconds,
        "rate": work / seconds,
        "depth_mm": found["observables"]["depression_depth_mm"],
        "force_n": found["observables"]["crushing_force_n"],
    }


def theirs(packing: Packing, folder: Path) -> dict:
    """LIGGGHTS on two ranks, one specimen."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in ("in.tests", "plate.stl"):
        shutil.copy(PEERS / name, folder)
    _write_bed(folder / "bed.data", packing)
    variables = [part for name, v in _variables(packing).items() for part in ("-var", name, v)]
    command = ["mpirun", "--allow-run-as-root", "-np", "2", "liggghts", "-in", "in.tests"]
    begun = time.perf_counter()
    with open(folder / "out.txt", "w") as output:
        subprocess.run(
            [*command, *variables, "-log", "tests.log"], cwd=folder, check=True,
            stdout=output, stderr=subprocess.STDOUT, env=os.environ | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    seconds = time.perf_counter() - begun
    rows = [line.split() for line in (folder / "tests.log").read_text().splitlines()]
    steps = max(int(row[0]) for row in rows if row and row[0].isdigit())
    crushing = np.loadtxt(folder / "ucs.txt", skiprows=1)
    loading = np.loadtxt(folder / "load.txt", skiprows=1)
    force = _smooth(loading[:, 1], 5)
    low, high = displacement_on_rise(loading[:, 0], force, (200.0, min(400.0, force.max())))
    return {
        "program": "LIGGGHTS, two ranks",
        "specimens": 1,
        "seconds": seconds,
        "rate": packing.spheres.count * steps / seconds,
        "depth_mm": 1e3 * float(high - low),
        "force_n": float(_smooth(crushing[:, 1], 41).max()),
    }


def _smooth(force: np.ndarray, window: int) -> np.ndarray:
    return np.convolve(force, np.ones(window) / window, mode="same")


def _variables(packing: Packing) -> dict[str, str]:
    """What in.tests is told: ranks, our platen speeds, and its own step scaled to these spheres."""
    step, radius = REFERENCE
    values = {
        "np": 2,
        "dt": step * 0.5 * float(packing.mean_diameter()) / radius,
        "vload": STANDARD.rate_in_mould,
        "vunl": STANDARD.rate_in_mould,
        "vucs": STANDARD.rate_free,
    }
    return {name: f"{value:.8g}" for name, value in values.items()}


def _write_bed(path: Path, packing: Packing) -> None:
    """Our bed as a LIGGGHTS data file; the mould's axis is at x = y = 0."""
    place, spheres = np.asarray(packing.position.stack()), packing.spheres
    radius, mass = np.asarray(spheres.radius), np.asarray(spheres.mass)
    density = mass / (4 / 3 * np.pi * radius**3)
    top = float((place[:, 2] + radius).max()) + 0.01
    lines = [f"{len(radius)} atoms", "2 atom types", "-0.06 0.06 xlo xhi", "-0.06 0.06 ylo yhi"]
    lines += [f"-0.01 {top:.4f} zlo zhi", "", "Atoms", ""]
    for number, (r, rho, at) in enumerate(zip(radius, density, place, strict=True), 1):
        numbers = " ".join(f"{value:.9g}" for value in (2 * r, rho, *at))
        lines.append(f"{number} 1 {numbers}")
    path.write_text("# grown bed\n\n" + "\n".join(lines) + "\n")


def markdown(found: list[dict], origin: dict) -> str:
    rows = [
        [
            str(row["round"]), row["program"], str(row["specimens"]), f"{row['seconds']:.0f}",
            f"{row['seconds'] / row['specimens']:.0f}", f"{1e-6 * row['rate']:.1f}",
            f"{row['depth_mm']:.2f}", f"{row['force_n']:.0f}",
        ]
        for row in found
    ]  # fmt: skip
    return (
        "## Whole tests\n\nBoth tests, 2000 spheres, two cores, everything in the time. A specimen "
        "that falls apart without the mould (F near 0) is cheap to crush: its rate does not "
        "compare.\n\n"
        + reporting.table(HEADER, rows)
        + "\n"
        + compared(found)
        + reporting.footer(origin)
    )


def compared(found: list[dict]) -> str:
    """Means over rounds of ours over LIGGGHTS'; specimens that fell apart do not count."""
    standing = [row for row in found if row["force_n"] > FELL]
    programs = list(dict.fromkeys(row["program"] for row in standing))
    rate, wall = (
        {p: np.mean([f(row) for row in standing if row["program"] == p]) for p in programs}
        for f in (lambda row: row["rate"], lambda row: row["seconds"] / row["specimens"])
    )
    peer = next((p for p in programs if "LIGGGHTS" in p), None)
    if peer is None:
        return "- every specimen of LIGGGHTS fell apart: no comparison\n"
    return "".join(
        f"- {p} over LIGGGHTS: {rate[p] / rate[peer]:.2f} in particle-steps a second, "
        f"{wall[peer] / wall[p]:.1f} in specimens\n"
        for p in programs
        if p != peer
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--rounds", type=int, default=2)
    chosen = parser.parse_args()
    reporting.configure()
    lab = load_lab(bundled_lab())
    work = campaign(lab, STANDARD, reporting.CACHE, for_terminal())
    beds = work.packings(range(chosen.rounds))
    found: list[dict] = []
    with tempfile.TemporaryDirectory() as place:
        for number, bed in enumerate(beds, start=1):
            rows = (
                ours(Path(place) / "double"),
                ours(Path(place) / "single", "--single"),
                theirs(bed, Path(place) / "theirs"),
            )
            found += [{"round": number, **row} for row in rows]
            origin = reporting.provenance()
            reporting.write_page(markdown(found, origin))


if __name__ == "__main__":
    main()
