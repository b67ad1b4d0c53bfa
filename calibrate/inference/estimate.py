"""An estimate of the parameters by the library of runs alone: seconds, and nothing is simulated.

It is where a fit begins (`calibrate.inference.calibration`).  Its intervals hold the scatter of as
many packings as the fit would simulate, that of repeats, and the library's own error at the soil.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibrate.core.errors import CalibrationError
from calibrate.inference.calibration import Explored
from calibrate.inference.evaluation import Calibration, Evaluation, compared
from calibrate.inference.identifiability import Identifiability, assess
from calibrate.inference.misfit import misses
from calibrate.inference.on_response import OnResponse
from calibrate.inference.widening import chosen
from calibrate.simulation.run import Run
from calibrate.simulation.specimens import curves_json, measured_json, soil_json


@dataclass(frozen=True, eq=False)
class Estimate:
    """The best point of the library of runs; `error` (m,) is its own deviation of each feature
    there, of which the calibration's covariance holds account; features `unknown` (m,) lie beyond
    its curves and had no say."""

    explored: Explored
    calibration: Calibration
    best: Evaluation
    run: Run
    error: np.ndarray
    unknown: np.ndarray
    identifiability: Identifiability


def estimated(explored: Explored, response: OnResponse) -> Estimate:
    """What exploring on a response says; `CalibrationError` where its soil is beyond the runs."""
    kept = chosen(explored.rounds)
    if kept.best is None:
        (failed, *_) = kept.descent.best.failures if kept.descent.best else ("nothing was found",)
        repair = "leave out --no-runs: simulations are needed there"
        raise CalibrationError(f"the library of runs has no estimate: {failed}; {repair}")
    space, problem = kept.calibration.space, kept.calibration.problem
    soil = space.soil(kept.best.values)
    error = response.error(problem, soil)
    wider = replace(problem, target_variance=problem.target_variance + error**2)
    calibration = replace(kept.calibration, problem=wider)
    best = calibration.evaluate(kept.best.values, "the best point of the library of runs")
    slopes = response.slopes(problem, space, best.values)
    found = assess(
        space.names,
        best.values,
        calibration.whitened(slopes),
        space.prior_sd(),
        calibration.scatter_packings - 1,
        space.bounds(),
    )
    (run,) = response.campaign.runs([soil], [0], "")[0]
    unknown = response.unknown(problem, soil)
    return Estimate(explored, calibration, best, run, error, unknown, found)


def estimate_json(found: Estimate) -> dict:
    """Keys as those of a fit; `simulated` is false."""
    calibration, setup, best = found.calibration, found.explored.setup, found.best
    features = compared(calibration.problem, calibration.covariance, best)
    met = not misses(features)
    rows = zip(features, found.error.tolist(), (~found.unknown).tolist(), strict=True)
    own = {name: {"library_sd": error, "known": known} for name, error, known in rows}
    return {
        "simulated": False,
        "parameters": soil_json(calibration.space.soil(best.values)),
        "start": soil_json(setup.base),
        "free": list(calibration.space.names),
        "observables": found.run.observables,
        "curves": curves_json(found.run),
        "measured": measured_json(setup.lab),
        "features": {name: {**row, **own[name]} for name, row in features.items()},
        "met": met,
        "identifiability": found.identifiability.as_json(met),
        "screening": found.explored.screening,
        "at_bound": calibration.space.at_bound(best.values),
    }
