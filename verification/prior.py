"""Soils from the whole prior: does every run end, once, and is its time step short enough?

Soils are drawn from the priors of all parameters that a fit may free, cut at their bounds, each
on a packing of its own, at the preset standard's rates.  Counted are runs that failed, runs that
were done twice because a list was too small, what half the time step changes, and how many fail
with a longer one: that is the margin.

    python -m verification.prior                     40 soils, 500 spheres, 6 minutes on two cores
    python -m verification.prior --spheres 2000 --soils 20

Runs are kept in results/benchmarks; a second call resumes.  Writes
a section of verification/results/convergence.md; other sizes of beds keep their rows.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import truncnorm

from calibrate.core.progress import for_terminal
from calibrate.inference.parameters import RANGES, space
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.simulation import Campaign, Run
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.engine.bed import Numerics
from jdem.materials.soil import SoilParameters
from verification import reporting

HEADER = ("spheres", "soils", "failed", "done twice", "energy balance, largest",
          "H changed by half the step, largest", "median", "soils compared",
          "failed with 1.3 times the step")  # fmt: skip
DEPTH, LONGER = "depression_depth_mm", 1.3


def soils(lab: Lab, count: int, seed: int) -> list[SoilParameters]:
    """Draws from the prior of every parameter that may be fitted, within its bounds."""
    free = space(lab, tuple(RANGES))
    centre, width = np.log(free.start()), free.prior_sd()
    low, high = (np.log([getattr(r, end) for r in free.ranges]) for end in ("low", "high"))
    drawn = truncnorm.rvs(
        (low - centre) / width, (high - centre) / width, centre, width,
        size=(count, len(centre)), random_state=seed,
    )  # fmt: skip
    return [free.soil(np.exp(row)) for row in np.asarray(drawn)]


def simulated(lab: Lab, spheres: int, factor: float, chosen: argparse.Namespace) -> list[Run]:
    """Every soil on a packing of its own, with `factor` times the usual time step."""
    preset = replace(PRESETS["standard"], spheres=spheres)
    cylinder = specimen(lab, preset)
    numerics = numerics_for(cylinder, safety=factor * Numerics().safety)
    lab_of = virtual_lab(lab, preset, numerics)
    work = Campaign(lab_of, cylinder, chosen.folder, for_terminal())
    row = soils(lab, chosen.soils, chosen.seed)
    return work.each([row], range(chosen.soils), f"time step x {factor:g}")[0]


def compared(usual: list[Run], finer: list[Run], coarser: list[Run]) -> dict:
    """What was counted, and relative changes of the depth where both runs have one."""
    sound = [not (a.failure or b.failure) for a, b in zip(usual, finer, strict=True)]
    depths = np.array([[r.observables[DEPTH] for r in runs] for runs in (usual, finer)])
    changes = np.abs(depths[0] / depths[1] - 1)[sound]
    return {
        "soils": len(usual),
        "failures": [run.failure for run in usual if run.failure],
        "repeats": float(sum(run.quality["repeats"] for run in usual)),
        "energy_balance": float(max(run.quality["energy_balance"] for run in usual)),
        "changes_of_depth": changes.tolist(),
        "failures_with_longer_step": sum(bool(run.failure) for run in coarser),
    }


def markdown(found: dict, origin: dict) -> str:
    rows = [
        [
            spheres,
            str(row["soils"]),
            str(len(row["failures"])),
            f"{row['repeats']:.0f}",
            f"{row['energy_balance']:.1e}",
            f"{100 * max(row['changes_of_depth']):.2f} %",
            f"{100 * np.median(row['changes_of_depth']):.2f} %",
            str(len(row["changes_of_depth"])),
            str(row["failures_with_longer_step"]),
        ]
        for spheres, row in found.items()
    ]
    failures = [
        f"- {spheres} spheres: {f}\n" for spheres, r in found.items() for f in r["failures"]
    ]
    return (
        "# Soils from the whole prior\n\nThe preset standard's rates and grown beds.\n\n"
        + reporting.table(HEADER, rows)
        + ("\nFailures:\n\n" + "".join(failures) if failures else "")
        + reporting.footer(origin)
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--spheres", type=int, default=500)
    parser.add_argument("--soils", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    chosen = parser.parse_args()
    reporting.configure()
    lab = load_lab(bundled_lab())
    runs = [simulated(lab, chosen.spheres, factor, chosen) for factor in (1.0, 0.5, LONGER)]
    found = reporting.earlier("prior", "sizes")
    found[str(chosen.spheres)] = compared(*runs)
    origin = reporting.provenance()
    reporting.write_content("prior", {**origin, "sizes": found})
    reporting.write_section("convergence", markdown(found, origin))


if __name__ == "__main__":
    main()
