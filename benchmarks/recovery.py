"""Does calibration find the parameters that made the data?  With the real DEM, at standard.

"Laboratory" data are made from hidden parameters (within 25 % of the bundled soil) on four
packings of 2000 spheres that no fit sees, written as a lab file, read back, and fitted as
`calibrate fit --preset standard` does, exploring with 500 spheres, from three starts:

    two    shear modulus and surface energy from the scalar targets H and F
    four   these, plasticity ratio and rolling friction from whole curves, four repeats

For every start: fitted values, 95 % intervals, whether the hidden values lie inside, and how many
simulations of each size it takes from nothing, those for profiles too.  The starts share one set of
data, so they test the solver three times and the data's scatter once; --seed makes other data.

    python benchmarks/recovery.py --case two      about 13 minutes on two cores

Runs and lab files are kept in results/benchmarks/recovery, a folder a start; a second call resumes.
Writes benchmarks/results/recovery.json and .md after every start.
"""

import argparse
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import reporting
from made_lab import LABORATORY, of_curves, of_targets, scaled

from calibrate.core.progress import for_terminal
from calibrate.inference.calibration import THRIFTY, explored, fit_from, scatter_of_packings
from calibrate.inference.evaluation import Calibration
from calibrate.inference.fit import Fit
from calibrate.inference.parameters import Space, space
from calibrate.inference.problem import pose
from calibrate.inference.resolutions import Coarse
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation import Run
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import PRESETS, Preset
from calibrate.simulation.specimens import Seeds, campaign, mean_observables, spread_observables

REPEATS = 4
LARGE = PRESETS["standard"]
SMALL = replace(LARGE, spheres=LARGE.explored)
FOLDER = reporting.CACHE / "recovery"


@dataclass(frozen=True)
class Case:
    """Hidden values of the free parameters and the starts, all relative to the base soil."""

    hidden: dict[str, float]
    whole_curves: bool


CASES = {
    "two": Case({"shear_modulus": 0.8, "surface_energy": 1.2}, whole_curves=False),
    "four": Case(
        {
            "shear_modulus": 0.8,
            "surface_energy": 1.2,
            "plasticity_ratio": 0.85,
            "rolling_friction": 1.25,
        },
        whole_curves=True,
    ),
}
STARTS = {
    "base soil": {},
    "stiff, weak": {
        "shear_modulus": 1.5,
        "surface_energy": 0.6,
        "plasticity_ratio": 0.75,
        "rolling_friction": 1.5,
    },
    "soft, strong": {
        "shear_modulus": 0.65,
        "surface_energy": 1.6,
        "plasticity_ratio": 1.1,
        "rolling_friction": 0.7,
    },
}


def made_lab(name: str, case: Case, seed: int) -> tuple[Lab, list[Run]]:
    """The lab of the hidden parameters, written and read back, and the runs behind it."""
    lab = load_lab(bundled_lab())
    seeds = range(LABORATORY + seed, LABORATORY + seed + REPEATS)
    hidden = scaled(base_soil(lab), case.hidden)
    work = campaign(lab, LARGE, FOLDER / "laboratory", for_terminal())
    runs = work.runs([hidden], seeds, f"laboratory, case {name}")[0]
    failures = [run.failure for run in runs if run.failure]
    if failures:
        raise RuntimeError(f"a laboratory specimen failed: {failures[0]}; give another --seed")
    path = FOLDER / f"{name}-{seed}" / "lab.toml"
    return (of_curves if case.whole_curves else of_targets)(path, runs), runs


@dataclass(frozen=True, eq=False)
class Recovered:
    """One fit from one start: the space it moved in, what it found, simulations by spheres."""

    space: Space
    found: Fit
    simulations: dict[int, int]


def recovered(
    lab: Lab, names: tuple[str, ...], start: dict[str, float], seed: int, folder: Path
) -> Recovered:
    """The fit from a start, on beds that all starts share."""
    small, large = (_with_beds(lab, preset, seed, folder) for preset in (SMALL, LARGE))
    problem, seeds, free = pose(lab), Seeds.of(seed, LARGE.packings), space(lab, names)
    coarse = Coarse(small, SMALL.spheres, LARGE.spheres)
    scatter, scattered = scatter_of_packings(problem, free.base, seeds, large, coarse)
    calibration = Calibration(
        problem, free, large, seeds.fitted, scatter, scattered, THRIFTY, coarse
    )
    first = free.start() * np.array([start.get(name, 1.0) for name in names])
    walked = explored(calibration, calibration.correction(first, "both at the start"), first)
    found = fit_from(calibration, walked)
    runs = {p.spheres: folder / str(p.spheres) / "runs" for p in (SMALL, LARGE)}
    return Recovered(free, found, {n: len(list(kept.iterdir())) for n, kept in runs.items()})


def _with_beds(lab: Lab, preset: Preset, seed: int, folder: Path) -> AbstractCampaign:
    """The tests of one size in a folder of this start, with the beds of all starts."""
    shared, own = FOLDER / "beds", folder / str(preset.spheres)
    seeds = sorted(Seeds.of(seed, preset.packings).scatter)
    campaign(lab, preset, shared, for_terminal()).packings(seeds)
    shutil.copytree(shared / "packings", own / "packings", dirs_exist_ok=True)
    return campaign(lab, preset, own, for_terminal())


def entry(done: Recovered, hidden: dict[str, float]) -> dict:
    """The numbers of one start."""
    found, known = done.found, done.found.identifiability
    parameters = {
        name: _recovery(hidden[name], known.values[k], known.interval[k], known.sd_log[k])
        for k, name in enumerate(done.space.names)
    }
    return {
        "parameters": parameters,
        "all_inside": all(row["inside"] for row in parameters.values()),
        "evaluations": len(found.history),
        "simulations": {str(n): count for n, count in done.simulations.items()},
        "cost": found.best.cost,
        "stopped": found.stopped,
        "history": found.history,
        "identifiability": known.as_json(),
    }


def _recovery(hidden: float, fitted: float, interval: np.ndarray, deviation: float) -> dict:
    return {
        "hidden": hidden,
        "fitted": float(fitted),
        "interval_95": interval.tolist(),
        "inside": bool(interval[0] <= hidden <= interval[1]),
        "error_in_ln": float(np.log(fitted / hidden)),
        "sd_of_ln": float(deviation),
    }


def measured_case(name: str, case: Case, seed: int) -> dict:
    """The laboratory's side of a case."""
    lab, runs = made_lab(name, case, seed)
    soil = scaled(base_soil(lab), case.hidden)
    return {
        "lab_file": str(lab.file),
        "hidden": {key: float(getattr(soil, key)) for key in case.hidden},
        "data": "whole curves" if case.whole_curves else "H and F",
        "repeats": REPEATS,
        "observables": mean_observables(runs),
        "spread": spread_observables(runs),
        "starts": {},
    }


def markdown(cases: dict, origin: dict) -> str:
    """A table a case: one row per start and parameter."""
    text = (
        f"# Recovery of hidden parameters\n\nFits at standard, {LARGE.packings} packings of "
        f"{LARGE.spheres} spheres, explored with {SMALL.spheres}; the data come from {REPEATS} "
        "other packings. Intervals are at 95 %. Simulations are those a start takes from nothing, "
        "those for scatter and profiles too: large ones + small ones.\n"
    )
    for name, case in cases.items():
        text += f"\n## {name}: {', '.join(case['hidden'])} from {case['data']}\n\n"
        rows = [
            _row(start, key, row, done)
            for start, done in case["starts"].items()
            for key, row in done["parameters"].items()
        ]
        header = (
            "start",
            "parameter",
            "hidden",
            "fitted",
            "95 % interval",
            "inside",
            "simulations",
            "stopped",
        )
        text += reporting.table(header, rows)
    return text + reporting.footer(origin)


def _row(start: str, key: str, row: dict, done: dict) -> list[str]:
    low, high = row["interval_95"]
    return [
        start,
        key,
        f"{row['hidden']:.4g}",
        f"{row['fitted']:.4g}",
        f"{low:.4g} to {high:.4g}",
        "yes" if row["inside"] else "NO",
        " + ".join(str(done["simulations"][str(p.spheres)]) for p in (LARGE, SMALL)),
        done["stopped"],
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", choices=list(CASES), action="append", help="default: both")
    parser.add_argument("--start", choices=list(STARTS), action="append", help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="choice of packings")
    return parser.parse_args()


def main() -> None:
    chosen = arguments()
    reporting.configure()
    cases = reporting.earlier("recovery", "cases")
    for name in chosen.case or CASES:
        case = CASES[name]
        done = measured_case(name, case, chosen.seed)
        done["starts"] = cases.get(name, done)["starts"]
        cases[name] = done
        lab = load_lab(Path(done["lab_file"]))
        for start in chosen.start or STARTS:
            folder = FOLDER / f"{name}-{chosen.seed}-{start}".replace(", ", "-")
            found = recovered(lab, tuple(case.hidden), STARTS[start], chosen.seed, folder)
            done["starts"][start] = entry(found, done["hidden"])
            _save(cases, chosen.seed)


def _save(cases: dict, seed: int) -> None:
    origin = reporting.provenance()
    reporting.write("recovery", {**origin, "seed": seed, "cases": cases}, markdown(cases, origin))


if __name__ == "__main__":
    main()
