"""A fit of four parameters to whole curves, by derivatives that JAX took and by pairs of runs.

The data are confined curves, loading and unloading, of hidden parameters on four packings that no
fit sees.  Both kinds of slopes fit them from the same three starts, on three packings of 500
spheres that grow to the usual porosity.  A fit's cost is counted in forward runs a packing, where a
tangent costs what `Overdamped.cost` says, and in processor seconds.

    python -m verification.derivatives                   some 40 minutes on two cores

Runs are kept in results/benchmarks; a second call resumes, and then keeps the times of the first.
Writes a section of verification/results/tangents.md after every fit.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.core.progress import for_terminal
from calibrate.inference.evaluation import Calibration, Settings, packing_scatter
from calibrate.inference.fit import descend
from calibrate.inference.parameters import Space, fitting_ensemble, space
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.specimens import Seeds
from jdem.sensitivity.base import AbstractStrategy
from jdem.sensitivity.overdamped import Overdamped
from verification import reporting
from verification.made_lab import LABORATORY, of_curves, scaled

REPEATS = 4
HIDDEN = {
    "shear_modulus": 0.8,
    "plasticity_ratio": 0.85,
    "tangential_multiplier": 1.2,
    "rolling_friction": 1.25,
}
STARTS = {
    "base soil": {},
    "stiff": {"shear_modulus": 1.5, "plasticity_ratio": 1.1, "rolling_friction": 1.5},
    "soft": {"shear_modulus": 0.6, "plasticity_ratio": 0.75, "tangential_multiplier": 0.7},
}
HEADER = ("start", "slopes", "evaluations", "forward runs a packing", "processor (s)",
          "largest residual", "largest error in ln p")  # fmt: skip


def laboratory(folder: Path, spheres: int) -> tuple[Lab, Campaign]:
    """The lab file of the hidden parameters' confined curves, read back, and its simulations."""
    bundled = load_lab(bundled_lab())
    hidden = scaled(base_soil(bundled), HIDDEN)
    seeds = range(LABORATORY, LABORATORY + REPEATS)
    runs = _campaign(bundled, folder, spheres).runs([hidden], seeds, "laboratory")[0]
    path = folder / f"derivatives-{spheres}" / "lab.toml"
    lab = of_curves(path, runs, without=("unconfined",))
    return lab, _campaign(lab, folder, spheres)


def _campaign(lab: Lab, folder: Path, spheres: int) -> Campaign:
    preset = replace(PRESETS["standard"], spheres=spheres)
    return Campaign(virtual_lab(lab, preset), specimen(lab, preset), folder, for_terminal())


def fitted(
    free: Space, start: dict[str, float], strategy: AbstractStrategy, calibration: Calibration
) -> dict:
    """One fit: what it cost and where it ended."""
    settings = Settings(strategy=strategy)
    fresh = replace(calibration, settings=settings)
    first = free.start() * np.array([start.get(name, 1.0) for name in free.names])
    begun = time.process_time()
    found = descend(fresh, first)
    seconds = time.process_time() - begun
    best, truth = found.best, free.start() * np.array([HIDDEN[name] for name in free.names])
    if best is None:
        raise RuntimeError("no evaluation succeeded; give another --spheres")
    return {
        "evaluations": len(found.history),
        "forward_runs": fresh.forward_runs,
        "processor_s": seconds,
        "largest_residual": float(np.abs(best.residual[: len(best.residual) - len(truth)]).max()),
        "errors_in_ln": dict(zip(free.names, np.log(best.values / truth).tolist(), strict=True)),
        "history": found.history,
    }


def markdown(found: dict, spheres: int, origin: dict) -> str:
    rows = [
        [
            start,
            slopes,
            str(each["evaluations"]),
            f"{each['forward_runs']:.0f}",
            f"{each['processor_s']:.0f}",
            f"{each['largest_residual']:.2f}",
            f"{max(map(abs, each['errors_in_ln'].values())):.2f}",
        ]
        for start, both in found.items()
        for slopes, each in both.items()
    ]
    return (
        f"# Fits by derivatives and by pairs of runs\n\nFour parameters ({', '.join(HIDDEN)}) "
        f"from {REPEATS} confined curves of hidden values; {spheres} spheres, three packings. "
        "Residuals in standard deviations.\n\n"
        + reporting.table(HEADER, rows)
        + reporting.footer(origin)
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=500)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE)
    chosen = parser.parse_args()
    reporting.configure()
    lab, work = laboratory(chosen.folder, chosen.spheres)
    problem, seeds, free = pose(lab), Seeds.of(0, 3), space(lab, tuple(HIDDEN))
    runs = work.runs([free.base], seeds.scatter, "scatter of packings")[0]
    scatter = packing_scatter(problem, runs)
    calibration = Calibration(problem, free, work, seeds.fitted, scatter, len(seeds.scatter))
    ways = {"derivatives": Overdamped(), "pairs": fitting_ensemble(free)}
    kept = reporting.kept(f"derivatives-{chosen.spheres}", chosen.folder) / "fits.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    origin = reporting.provenance()
    for start, factors in STARTS.items():
        for way, strategy in ways.items():
            if way not in found.get(start, {}):
                done = fitted(free, factors, strategy, calibration)
                found.setdefault(start, {})[way] = done
                write_text(kept, json.dumps(found))
            reporting.write_section("tangents", markdown(found, chosen.spheres, origin))


if __name__ == "__main__":
    main()
