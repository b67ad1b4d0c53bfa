"""Does calibration find the parameters that made the data?  With the real DEM, at quick.

"Laboratory" data are made from hidden parameters (within 25 % of the bundled soil) on four
packings that no fit sees, written as a lab file with curves, read back, and fitted from
three starts:

    two    shear modulus and surface energy from the scalar targets H and F
    four   these, plasticity ratio and rolling friction from whole curves, four repeats

For every start: fitted values, 95 % intervals, whether the hidden values lie inside, and
how many simulations it takes from nothing.  The starts share one set of data, so they test
the solver three times and the data's scatter once; --seed makes other data.

    python -m verification.recovery --case two      about 6 minutes on two cores
    python -m verification.recovery --case four     about 25 minutes on two cores
    python -m verification.recovery                 both

Runs and lab files are kept in results/benchmarks; a second call resumes.  Writes
verification/results/recovery.md after every start.
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.inference.evaluation import Calibration, Settings, packing_scatter
from calibrate.inference.fit import Fit, fit
from calibrate.inference.parameters import Space, space
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation import Campaign, Run
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.specimens import Seeds, summary_json
from verification import reporting
from verification.made_lab import LABORATORY, of_curves, of_targets, scaled

REPEATS = 4
QUICK = PRESETS["quick"]


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


@dataclass(eq=False)
class CountingCampaign(Campaign):
    """A campaign that remembers which runs were asked for, cached or not."""

    asked: set[str] = field(default_factory=set)

    def each(self, soils, seeds, what):
        self.asked |= {
            self.key(soil, seed) for row in soils for soil, seed in zip(row, seeds, strict=True)
        }
        return super().each(soils, seeds, what)


def campaign(lab: Lab, folder: Path) -> CountingCampaign:
    """The quick preset's virtual laboratory."""
    return CountingCampaign(virtual_lab(lab, QUICK), specimen(lab, QUICK), folder, for_terminal())


def made_lab(name: str, case: Case, seed: int, folder: Path) -> tuple[Lab, list[Run]]:
    """The lab of the hidden parameters, written and read back, and the runs behind it."""
    lab = load_lab(bundled_lab())
    seeds = range(LABORATORY + seed, LABORATORY + seed + REPEATS)
    hidden = scaled(base_soil(lab), case.hidden)
    runs = campaign(lab, folder).runs([hidden], seeds, f"laboratory, case {name}")[0]
    failures = [run.failure for run in runs if run.failure]
    if failures:
        raise RuntimeError(f"a laboratory specimen failed: {failures[0]}; give another --seed")
    path = folder / "recovery" / f"{name}-{seed}" / "lab.toml"
    return (of_curves if case.whole_curves else of_targets)(path, runs), runs


def recovered(lab: Lab, names: tuple[str, ...], start: dict, seed: int, work: CountingCampaign):
    """One fit from one start: the space it moved in and what it found."""
    problem, seeds = pose(lab), Seeds.of(seed, QUICK.packings)
    free = space(lab, names)
    runs = work.runs([free.base], seeds.scatter, "scatter of packings")[0]
    scatter = packing_scatter(problem, runs)
    calibration = Calibration(
        problem, free, work, seeds.fitted, scatter, len(seeds.scatter), Settings()
    )
    first = free.start() * np.array([start.get(name, 1.0) for name in names])
    return free, fit(calibration, first)


def entry(free: Space, found: Fit, hidden: dict[str, float], work: CountingCampaign) -> dict:
    """The numbers of one start."""
    known = found.identifiability
    parameters = {
        name: _recovery(hidden[name], known.values[k], known.interval[k], known.sd_log[k])
        for k, name in enumerate(free.names)
    }
    return {
        "parameters": parameters,
        "all_inside": all(row["inside"] for row in parameters.values()),
        "evaluations": len(found.history),
        "simulations": len(work.asked),
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


def measured_case(name: str, case: Case, seed: int, folder: Path) -> dict:
    """The laboratory's side of a case."""
    lab, runs = made_lab(name, case, seed, folder)
    soil = scaled(base_soil(lab), case.hidden)
    return {
        "lab_file": str(lab.file),
        "hidden": {key: float(getattr(soil, key)) for key in case.hidden},
        "data": "whole curves" if case.whole_curves else "H and F",
        "repeats": REPEATS,
        **summary_json(runs),
        "starts": {},
    }


def markdown(cases: dict, origin: dict) -> str:
    """A table a case: one row per start and parameter."""
    text = (
        "# Recovery of hidden parameters\n\nReal DEM, quick preset, three fitted packings; "
        "the data come from four other packings. Intervals are at 95 %. Simulations are "
        "those a start takes from nothing, with the eight for the scatter and those for profiles.\n"
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
        str(done["simulations"]),
        done["stopped"],
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--case", choices=list(CASES), action="append", help="default: both")
    parser.add_argument("--start", choices=list(STARTS), action="append", help="default: all")
    parser.add_argument("--seed", type=int, default=0, help="choice of packings")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    return parser.parse_args()


def main() -> None:
    chosen = arguments()
    reporting.configure()
    cases = reporting.earlier("recovery", "cases")
    for name in chosen.case or CASES:
        case = CASES[name]
        done = measured_case(name, case, chosen.seed, chosen.folder)
        done["starts"] = cases.get(name, done)["starts"]
        cases[name] = done
        lab = load_lab(Path(done["lab_file"]))
        for start in chosen.start or STARTS:
            work = campaign(lab, chosen.folder)
            free, found = recovered(lab, tuple(case.hidden), STARTS[start], chosen.seed, work)
            done["starts"][start] = entry(free, found, done["hidden"], work)
            _save(cases, chosen.seed)


def _save(cases: dict, seed: int) -> None:
    origin = reporting.provenance()
    reporting.write("recovery", {**origin, "seed": seed, "cases": cases}, markdown(cases, origin))


if __name__ == "__main__":
    main()
