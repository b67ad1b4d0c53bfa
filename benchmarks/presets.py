"""What each preset costs: processor seconds of one packing and of one run of both tests.

    python benchmarks/presets.py [--presets quick standard fine]

One packing and one run of the bundled soil for each preset with one worker, so processor
time is about what an idle core would take; tracing and loading the program (some seconds)
is included, and with a cold compilation cache compiling it (ten more).  Quick and standard
take two minutes, fine about five.  Writes a section of benchmarks/results/README.md;
presets that were not asked for keep their rows.  Memory is the largest of the process so far.
"""

import argparse
import resource
import time

import reporting

from calibrate.core.progress import PlainLines
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import campaign

HEADER = (
    "preset",
    "spheres",
    "mean diameter (mm)",
    "packing (s)",
    "one run (s)",
    "time steps",
    "inertial number",
    "peak memory (GiB)",
    "H (mm)",
    "F (N)",
)


def main() -> None:
    arguments = _arguments()
    reporting.configure()
    rows = reporting.earlier("presets", "presets")
    for name in arguments.presets:
        rows[name] = _measured(name, arguments.seed)
        origin = reporting.provenance()
        content = {**origin, "seed": arguments.seed, "presets": rows}
        reporting.write("presets", content, _markdown(rows, origin))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", nargs="+", choices=list(PRESETS), default=list(PRESETS))
    parser.add_argument("--seed", type=int, default=0, help="packing")
    return parser.parse_args()


def _measured(name: str, seed: int) -> dict:
    """Cost and results of one packing; nothing is taken from an earlier call's cache."""
    lab, preset = load_lab(bundled_lab()), PRESETS[name]
    folder = reporting.CACHE / "presets" / f"{time.time_ns()}"
    work = campaign(lab, preset, folder, PlainLines())
    work.workers = 1
    begun = time.process_time()
    packing = work.packings([seed])[0]
    settled = time.process_time()
    run = work.runs([base_soil(lab)], [seed], f"preset {name}")[0][0]
    finished = time.process_time()
    return {
        "spheres": preset.spheres,
        "mean_diameter_mm": 1e3 * float(packing.mean_diameter()),
        "packing_s": settled - begun,
        "run_s": finished - settled,
        "steps": run.quality["steps"],
        "inertial_number": run.quality["inertial_number"],
        "peak_memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "failure": run.failure,
        **run.observables,
    }


def _markdown(rows: dict, origin: dict) -> str:
    cells = [
        (
            name,
            str(row["spheres"]),
            f"{row['mean_diameter_mm']:.1f}",
            f"{row['packing_s']:.0f}",
            f"{row['run_s']:.0f}",
            f"{row['steps']:.0f}",
            f"{row['inertial_number']:.1e}",
            f"{row['peak_memory_gib']:.1f}",
            f"{row['depression_depth_mm']:.2f}",
            f"{row['crushing_force_n']:.0f}",
        )
        for name, row in rows.items()
    ]
    return "## Presets\n\n" + reporting.table(HEADER, cells) + reporting.footer(origin)


if __name__ == "__main__":
    main()
