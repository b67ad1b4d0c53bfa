"""What a calibration costs: gradient fit, derivative-free search and response surface.

Four free parameters, both targets of the bundled soil, the mean of three packings at quick,
from the same three starts.  A method is done once depression depth and crushing force both lie
within the repeat scatter of their targets; its cost is counted in forward runs a packing.

    gradient      calibrate.inference.fit with the strategy that passed the audit
    Nelder-Mead   scipy, on the sum of squares over the repeat scatter
    surface       central composite design (pyDOE), quadratic least squares (statsmodels), its
                  optimum simulated once; from every start, as the centre of the design

    python -m verification.calibration               about 25 minutes on two cores

Runs are kept in results/benchmarks; a second call resumes.  Writes
notebooks/data/calibration.json and a section of verification/results/designs.md after every start.
"""

import argparse
import contextlib
from pathlib import Path

import numpy as np
import pydoe
import statsmodels.api as sm
from scipy.optimize import minimize

from calibrate.core.progress import for_terminal
from calibrate.inference.evaluation import Calibration, packing_scatter
from calibrate.inference.fit import descend
from calibrate.inference.parameters import Space, space
from calibrate.inference.problem import Problem, pose
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.specimens import Seeds
from verification import reporting
from verification.recovery import STARTS

FREE = ("shear_modulus", "surface_energy", "plasticity_ratio", "rolling_friction")
QUICK = PRESETS["quick"]
LIMIT = 60  # forward runs a packing after which a search is given up
LEVEL = 0.3  # of the design's factorial points, in ln p
PAPER = 50  # designs that the paper simulated


class Task:
    """Misfits of parameter points, and how many points were asked for."""

    def __init__(self, lab, free: Space, work: Campaign, seeds, problem: Problem):
        self._free, self._work, self._seeds, self._problem = free, work, seeds, problem
        self.scatter = np.array([lab.targets[f.name].scatter for f in problem.features])
        self.measured = problem.measured
        self.spent = 0
        self.reached = 0

    def features(self, point: np.ndarray) -> np.ndarray:
        """H and F (mean over packings) at ln p; NaN where a run fails."""
        soil = self._free.soil(np.exp(self._free.inside(point)))
        self.spent += 1
        runs = self._work.runs([soil], self._seeds, f"run {self.spent}")[0]
        found = self._problem.simulated(runs).mean(axis=0)
        if not self.reached and self.within(found):
            self.reached = self.spent
        return found

    def within(self, found: np.ndarray) -> bool:
        return bool(np.all(np.abs(found - self.measured) <= self.scatter))

    def cost(self, point: np.ndarray) -> float:
        if self.reached or self.spent >= LIMIT:
            raise StopIteration
        misfit = (self.features(point) - self.measured) / self.scatter
        return float(np.nan_to_num(misfit @ misfit, nan=1e6))


def by_gradient(task: Task, calibration: Calibration, start: np.ndarray) -> dict:
    """Forward runs a packing until both targets are within the repeat scatter."""
    found = descend(calibration, start)
    names = [feature.name for feature in calibration.problem.features]
    for row in found.history:
        if task.within(np.array([row["features"][name] for name in names])):
            return _entry(row["forward_runs"], row["features"], True)
    return _entry(found.history[-1]["forward_runs"], found.history[-1]["features"], False)


def by_nelder_mead(task: Task, start: np.ndarray) -> dict:
    first = np.log(start)
    simplex = np.vstack([first, first + 0.2 * np.eye(len(first))])
    with contextlib.suppress(StopIteration):
        minimize(task.cost, first, method="Nelder-Mead", options={"initial_simplex": simplex})
    return _entry(task.reached or task.spent, {}, bool(task.reached))


def by_surface(task: Task, start: np.ndarray) -> dict:
    """A central composite design around the start, its quadratic optimum, and one check."""
    centre = np.log(start)
    design = pydoe.ccdesign(len(centre), center=(0, 1), alpha="rotatable", face="ccc")  # pyright: ignore[reportArgumentType]
    responses = np.array([task.features(centre + LEVEL * row) for row in design])
    good = np.all(np.isfinite(responses), axis=1)
    models = [sm.OLS(column, _quadratic(design[good])).fit() for column in responses[good].T]

    def predicted(x: np.ndarray) -> np.ndarray:
        return np.array([model.predict(_quadratic(x[None]))[0] for model in models])

    def cost(x: np.ndarray) -> float:
        misfit = (predicted(x) - task.measured) / task.scatter
        return float(misfit @ misfit + 1e-3 * x @ x)

    bound = float(np.abs(design).max())
    best = minimize(cost, np.zeros(len(centre)), bounds=[(-bound, bound)] * len(centre)).x
    found = task.features(centre + LEVEL * best)
    features = dict(zip(("depression_depth_mm", "crushing_force_n"), found.tolist(), strict=True))
    return _entry(task.spent, features, task.within(found))


def _quadratic(x: np.ndarray) -> np.ndarray:
    """Columns 1, x_i, x_i x_j of a full quadratic."""
    first, second = np.triu_indices(x.shape[1])
    return np.column_stack([np.ones(len(x)), x, x[:, first] * x[:, second]])


def _entry(runs: float, features: dict, reached: bool) -> dict:
    return {"forward_runs": float(runs), "reached": reached, "features": features}


def measured(start: dict[str, float], seed: int, folder: Path) -> dict[str, dict]:
    """All methods from one start."""
    lab = load_lab(bundled_lab())
    problem, seeds, free = pose(lab), Seeds.of(seed, QUICK.packings), space(lab, FREE)
    work = Campaign(virtual_lab(lab, QUICK), specimen(lab, QUICK), folder, for_terminal())
    runs = work.runs([free.base], seeds.scatter, "scatter of packings")[0]
    scatter = packing_scatter(problem, runs)
    calibration = Calibration(problem, free, work, seeds.fitted, scatter, len(seeds.scatter))
    first = free.start() * np.array([start.get(name, 1.0) for name in FREE])

    def task() -> Task:
        return Task(lab, free, work, seeds.fitted, problem)

    return {
        "gradient": by_gradient(task(), calibration, first),
        "Nelder-Mead": by_nelder_mead(task(), first),
        "surface": by_surface(task(), first),
    }


def markdown(starts: dict, origin: dict) -> str:
    methods = ("gradient", "Nelder-Mead", "surface")
    rows = [[name, *(_cell(found[method]) for method in methods)] for name, found in starts.items()]
    return (
        "# Cost of a calibration\n\nForward runs a packing until H and F (means of three packings,"
        " quick preset, four free parameters) are both within the repeat scatter of the bundled "
        f"soil's targets. The paper simulated {PAPER} designs.\n\n"
        + reporting.table(("start", *methods), rows)
        + reporting.footer(origin)
    )


def _cell(entry: dict) -> str:
    runs = f"{entry['forward_runs']:.0f}"
    return runs if entry["reached"] else f"not within {runs}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0, help="choice of packings")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    chosen = parser.parse_args()
    reporting.configure()
    starts: dict[str, dict] = {}
    for name, start in STARTS.items():
        starts[name] = measured(start, chosen.seed, chosen.folder)
        origin = reporting.provenance()
        content = {**origin, "seed": chosen.seed, "free": FREE, "starts": starts}
        reporting.write_content("calibration", content)
        reporting.write_section("designs", markdown(starts, origin))


if __name__ == "__main__":
    main()
