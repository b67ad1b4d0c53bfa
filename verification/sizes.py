"""Which beds should a fit use?  Small ones, large ones, or both: what each costs and where it ends.

    small     values and slopes from beds of 500 spheres
    large     values and slopes from beds of 2000
    both      what `calibrate fit --preset standard` does: slopes from 500, values from 2000

Each fits the same parameters to the soil's targets, from the same start, on four packings, and is
checked on fresh packings of 2000 spheres.  Costs are processor seconds of the fit, compiling in,
and particle-steps, which other work on the machine does not change; beds are made before, and the
check is not counted.  One soil from one start takes 20 minutes of two cores for fits of large beds
and of both.

    python -m verification.sizes --soils wheat_after_rice --starts base

`--ways` picks fits.  They are kept in results/benchmarks; a second call resumes at the next
one.  Writes verification/results/sizes.md after each; other fits with the same physics keep their
rows.
"""

import argparse
import json
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from calibrate.core.progress import for_terminal
from calibrate.inference.calibration import THRIFTY, exploring, fit_from, scatter_of_packings
from calibrate.inference.evaluation import Calibration
from calibrate.inference.fit import descend, fit
from calibrate.inference.parameters import space
from calibrate.inference.problem import pose
from calibrate.inference.resolutions import Coarse
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.composite import label
from calibrate.simulation import NETCDF
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import Seeds, campaign, summary_json
from verification import reporting

LARGE = replace(PRESETS["standard"], fresh=6)
SMALL = replace(LARGE, spheres=LARGE.explored)
FREE = ("shear_modulus", "surface_energy")  # what the command frees for both bundled soils
STARTS = {
    "base": {},
    "stiff, strong": {"shear_modulus": 1.3, "surface_energy": 1.5},
    "soft, weak": {"shear_modulus": 0.8, "surface_energy": 0.7},
}
WAYS = ("small", "large", "both")
HEADER = ("soil", "start", "beds", "processor (s)", "runs", "M particle-steps", "over large only",
          "observable", "measured", "fresh packings: mean ± s.e.", "error")  # fmt: skip


def fitted(lab: Lab, start: str, way: str, folder: Path, beds: Path) -> dict:
    """One fit, what it cost, and what fresh packings of the large size give."""
    done = folder / "done.json"
    if done.exists():
        return json.loads(done.read_text(encoding="utf-8"))
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(beds / "packings", folder / "packings")
    large, small = (campaign(lab, preset, folder, for_terminal()) for preset in (LARGE, SMALL))
    seeds, begun = Seeds.of(0, LARGE.packings, LARGE.fresh), time.process_time()
    found = _fit(lab, start, way, large, small, seeds)
    cost = {"processor_s": time.process_time() - begun, **simulated(folder)}
    runs = large.runs([found], seeds.fresh, "fresh packings")[0]
    fresh = summary_json(runs)
    entry = {
        "way": way,
        **cost,
        "parameters": {name: float(getattr(found, name)) for name in FREE},
        "mean": fresh["observables"],
        "scatter": fresh["spread"],
        "packings": len(runs),
    }
    done.write_text(json.dumps(entry), encoding="utf-8")
    return entry


def simulated(folder: Path) -> dict:
    """How many runs a fit has kept in its folder, by spheres, and their particle-steps."""
    counts: dict[str, int] = {}
    steps = 0.0
    for path in folder.glob("runs/*.nc"):
        with xr.open_dataset(path, engine=NETCDF) as run:
            spheres = int(run.attrs["spheres"])
            counts[str(spheres)] = counts.get(str(spheres), 0) + 1
            steps += spheres * float(run.attrs["steps"])
    return {"runs": counts, "particle_steps": steps}


def _fit(lab, start: str, way: str, large: AbstractCampaign, small: AbstractCampaign, seeds):
    """The fitted soil."""
    base, problem = base_soil(lab), pose(lab)
    base = with_values(base, {k: f * getattr(base, k) for k, f in STARTS[start].items()})
    work = small if way == "small" else large
    coarse = Coarse(small, SMALL.spheres, LARGE.spheres) if way == "both" else None
    scatter, scattered = scatter_of_packings(problem, base, seeds, work, coarse)
    free = space(lab, FREE, base)
    calibration = Calibration(
        problem, free, work, seeds.fitted, scatter, scattered, THRIFTY, coarse
    )
    if coarse is None:
        return free.soil(fit(calibration).best.values)
    ratio = calibration.correction(free.start(), "both at the start")
    smaller = descend(exploring(calibration, ratio))
    return free.soil(fit_from(calibration, smaller.best, smaller.slopes).best.values)


def prepared(lab: Lab, folder: Path) -> None:
    """The beds of both sizes, in `folder`."""
    seeds = Seeds.of(0, LARGE.packings, LARGE.fresh)
    for preset in (SMALL, LARGE):
        work = campaign(lab, preset, folder, for_terminal())
        work.packings(  # pyright: ignore[reportAttributeAccessIssue]
            sorted({*seeds.scatter, *seeds.fresh})
        )


def markdown(found: list[dict], origin: dict) -> str:
    dear = {(r["soil"], r["start"]): r["particle_steps"] for r in found if r["way"] == "large"}
    rows = [_cells(row, name, dear) for row in found for name in row["measured"]]
    return (
        f"# Beds of a fit\n\nSmall: {SMALL.spheres} spheres, large: {LARGE.spheres}; four "
        f"packings; checked on {LARGE.fresh} fresh packings of {LARGE.spheres} spheres. "
        f"Free: {', '.join(FREE)}.\n\n" + reporting.table(HEADER, rows) + reporting.footer(origin)
    )


def _cells(row: dict, name: str, dear: dict) -> list[str]:
    large, measured = dear.get((row["soil"], row["start"])), row["measured"][name]
    mean, error = row["mean"][name], row["scatter"][name] / np.sqrt(row["packings"])
    return [
        *(row["soil"], row["start"], row["way"]),
        f"{row['processor_s']:.0f}",
        ", ".join(f"{n} of {spheres}" for spheres, n in sorted(row["runs"].items())),
        f"{1e-6 * row['particle_steps']:.0f}",
        f"{row['particle_steps'] / large:.2f}" if large else "-",
        label(name),
        f"{measured:.4g}",
        f"{mean:.4g} ± {error:.2g}",
        f"{100 * (mean / measured - 1):+.1f} %",
    ]


def _order(row: dict) -> tuple:
    return row["soil"], list(STARTS).index(row["start"]), WAYS.index(row["way"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--soils", nargs="+", default=["wheat_after_rice", "trumao"])
    parser.add_argument("--starts", nargs="+", default=list(STARTS))
    parser.add_argument("--ways", nargs="+", default=list(WAYS), choices=WAYS)
    chosen = parser.parse_args()
    reporting.configure()
    found = list(reporting.earlier("sizes", "rows"))
    for soil in chosen.soils:
        lab, folder = load_lab(bundled_lab(soil)), reporting.kept("sizes") / soil
        prepared(lab, folder / "beds")
        targets = {name: target.mean for name, target in lab.targets.items()}
        for start in chosen.starts:
            for way in chosen.ways:
                place = folder / f"{start}-{way}".replace(", ", "-")
                entry = fitted(lab, start, way, place, folder / "beds")
                row = {"soil": soil, "start": start, **entry, "measured": targets}
                found = [
                    r
                    for r in found
                    if [r[k] for k in ("soil", "start", "way")] != [soil, start, way]
                ]
                found = sorted([*found, row], key=_order)
                origin = reporting.provenance()
                reporting.write("sizes", {**origin, "rows": found}, markdown(found, origin))


if __name__ == "__main__":
    main()
