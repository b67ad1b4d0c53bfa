"""The audit of gradients: is an estimate the slope of the response over a usable range?

    reference   one parameter at a time, steps of +-0.2 in ln p, every packing
    estimate    what a strategy of `jdem.sensitivity` returns on the same packings

An estimate passes where it has the reference's sign and lies within 15 % (depression depth)
or 25 % (crushing force) of it.  Slopes that are not three standard errors from zero are not
judged: there the data could not tell a right estimate from a wrong one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.campaign import Campaign
from calibrate.errors import CalibrationError
from calibrate.parameters import Space
from jdem.sensitivity.base import AbstractStrategy, Sensitivity, averaged
from jdem.sensitivity.composite import Blend, blended
from jdem.sensitivity.ensemble import Ensemble
from jdem.sensitivity.pathwise import Pathwise
from jdem.sensitivity.regression import Regression

STRATEGIES: dict[str, AbstractStrategy] = {
    "regression": Regression((0.25,)),
    "ensemble": Ensemble(),
    "pathwise": Pathwise(),
    "blend": Blend(),
}
REFERENCE = Regression((0.2,))
OBSERVABLES = ("depression_depth_mm", "crushing_force_n")
WITHIN = {"depression_depth_mm": 0.15, "crushing_force_n": 0.25}  # of the reference
JUDGED_FROM = 3.0  # standard errors of the reference


@dataclass(frozen=True, eq=False)
class Audit:
    """Slopes of both observables (2, p) per unit of ln p, by strategy, and the reference's."""

    names: tuple[str, ...]
    reference: Sensitivity
    estimates: dict[str, Sensitivity]
    packings: int

    def rows(self, strategy: str) -> list[dict]:
        """One row for each parameter and observable: the contract's keys, and intervals."""
        found = self.estimates[strategy]
        return [
            self._row(found, m, observable, p, parameter)
            for m, observable in enumerate(OBSERVABLES)
            for p, parameter in enumerate(self.names)
        ]

    def _row(self, found: Sensitivity, m: int, observable: str, p: int, parameter: str) -> dict:
        estimate, reference = float(found.slopes[m, p]), float(self.reference.slopes[m, p])
        error = float(self.reference.standard_error[m, p])
        judged = abs(reference) > JUDGED_FROM * error
        close = abs(estimate - reference) <= WITHIN[observable] * abs(reference)
        return {
            "parameter": parameter,
            "observable": observable,
            "estimate": estimate,
            "estimate_se": float(found.standard_error[m, p]),
            "reference": reference,
            "reference_se": error,
            "relative_error": estimate / reference - 1 if reference else float("nan"),
            "judged": judged,
            "passed": bool(close) if judged else None,
        }


def verdict(rows: Sequence[dict]) -> bool:
    """Whether every slope that can be judged has passed."""
    return all(row["passed"] for row in rows if row["judged"])


def audit(space: Space, work: Campaign, seeds: Sequence[int], strategies: Sequence[str]) -> Audit:
    """Reference and estimates at the space's base soil, on the packings `seeds`."""
    point, count = jnp.log(jnp.asarray(space.start())), len(seeds)
    simulated = simulated_response(space, work, seeds)
    reference = REFERENCE(simulated("reference"), point, count)
    if not bool(jnp.all(jnp.isfinite(reference.slopes))):
        raise CalibrationError("audit: a reference has no finite slope: every probe failed")
    estimates: dict[str, Sensitivity] = {}
    if "regression" in strategies:
        strategy = STRATEGIES["regression"]
        estimates["regression"] = strategy(simulated("regression"), point, count)
    if {"ensemble", "blend"} & set(strategies):
        strategy = STRATEGIES["ensemble"]
        estimates["ensemble"] = strategy(simulated("ensemble"), point, count)
    if {"pathwise", "blend"} & set(strategies):
        work.progress.say("pathwise: one pass with all tangents on every packing")
        estimates["pathwise"] = traced_slopes(space, work, seeds, point)
    if "blend" in strategies:
        estimates["blend"] = blended(estimates["pathwise"], estimates["ensemble"])
    return Audit(space.names, reference, {name: estimates[name] for name in strategies}, count)


def simulated_response(space: Space, work: Campaign, seeds: Sequence[int]) -> Callable:
    """What: a response whose runs are cached simulations; failed runs are NaN."""

    def named(what: str):
        def response(points: Array) -> Array:
            rows = np.asarray(space.inside(np.asarray(points)))
            soils = [[space.soil(np.exp(point)) for point in row] for row in rows]
            runs = work.each(soils, seeds, what)
            return jnp.asarray([[_observed(run) for run in row] for row in runs])

        return response

    return named


def _observed(run) -> list[float]:
    if run.failure:
        return [float("nan")] * len(OBSERVABLES)
    return [run.observables()[name] for name in OBSERVABLES]


def traced_slopes(space: Space, work: Campaign, seeds: Sequence[int], point: Array) -> Sensitivity:
    """Pathwise slopes, packing by packing, at the time step of the base soil."""
    lab = work.lab

    @eqx.filter_jit
    def slopes(packing, time_step):
        def observed(x):
            outcome = lab.run(packing, space.soil(jnp.exp(x)), time_step)
            return jnp.stack([1e3 * outcome.depression_depth, outcome.crushing_force])

        def push(tangent):
            return jax.jvp(observed, (point,), (tangent,))

        return jax.vmap(push, out_axes=(None, -1))(jnp.eye(point.shape[0]))

    found = [
        slopes(packing, lab.time_step(packing, space.base)) for packing in work.packings(seeds)
    ]
    values, each = (jnp.stack(part) for part in zip(*found, strict=True))
    return averaged(values, each)


def audit_json(found: Audit, first: str) -> dict:
    """The contract's keys for `audit`; all strategies under "strategies"."""
    rows = {name: found.rows(name) for name in found.estimates}
    return {
        "strategy": first,
        "passed": verdict(rows[first]),
        "packings": found.packings,
        "rows": rows[first],
        "strategies": {
            name: {"passed": verdict(each), "rows": each} for name, each in rows.items()
        },
    }
