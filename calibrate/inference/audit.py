"""The audit of gradients: is an estimate the slope of the response over a usable range?

    reference   one parameter at a time, steps of +-0.2 in ln p, every packing
    estimate    what a strategy of `jdem.sensitivity` returns on the same packings

All observables are judged, and all whole curves are differentiated with them from the same
runs: displacement at a force on loading, or force at a displacement.

An estimate passes where it has the reference's sign and lies within the observable's share of it
(`calibrate.labtests`: 15 % of depression depth, 25 % of crushing force).  Slopes that are not three
standard errors from zero are not judged: there the data could not tell a right estimate from a
wrong one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import cast

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.core.errors import COMMAND_LINE, CalibrationError, InputError, suggestion
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.on_response import OnResponse
from calibrate.inference.parameters import Space, ensemble, fitting_ensemble
from calibrate.inference.traced import Certificate, traced_slopes
from calibrate.labtests.composite import described
from calibrate.simulation import Campaign
from calibrate.simulation.joint import AbstractCampaign
from jdem.sensitivity.base import AbstractStrategy, AbstractTraced, Sensitivity, forward_mode
from jdem.sensitivity.composite import Blend, blended
from jdem.sensitivity.overdamped import Overdamped
from jdem.sensitivity.pathwise import Pathwise
from jdem.sensitivity.regression import Regression
from jdem.sensitivity.virtual_power import VirtualPower


@dataclass(frozen=True)
class Strategy:
    """A way to slopes that can be audited.

    `constructor` makes it with the steps that suit a space's parameters.  One that is `simulated`
    needs only values of runs, which a campaign keeps; others differentiate the run itself.
    A `blend_of` a strategy that differentiates weighs it against the ensemble.
    """

    doc: str
    constructor: Callable[[Space], AbstractStrategy]
    simulated: bool = False
    blend_of: str = ""


def _blend(name: str, precise: Callable[[], AbstractStrategy]) -> Strategy:
    doc = f"{name} and ensemble, weighted by measured variance"
    return Strategy(doc, lambda space: Blend(precise(), ensemble(space)), blend_of=name)


class OfRuns(AbstractStrategy):
    """Slopes of a response that was learned from runs: JAX takes them, and nothing is simulated."""

    def __call__(self, response: Callable, point: Array, packings: int) -> Sensitivity:
        return forward_mode(response, point, packings)

    def runs(self, parameters: int, packings: int) -> float:
        return 0.0

    def describe(self) -> str:
        return "library of runs, its slopes by JAX at the point itself"


RESPONSE = "response"

# By name; a blend stands below the two that it is made of.  docs/derivatives.md has the same table.
STRATEGIES = {
    "fit": Strategy("pairs of runs, some parameters alone: as in fits", fitting_ensemble, True),
    RESPONSE: Strategy("library of runs, by JAX: what fits explore with", lambda _: OfRuns(), True),
    "ensemble": Strategy("pairs of runs, parameters in groups", ensemble, True),
    "regression": Strategy(
        "pairs of runs, one parameter at a time", lambda _: Regression((0.25,)), True
    ),
    "pathwise": Strategy("exact derivative of the computed path, by JAX", lambda _: Pathwise()),
    "blend": _blend("pathwise", Pathwise),
    "overdamped": Strategy("from equilibrium to equilibrium, by JAX", lambda _: Overdamped()),
    "overdamped_blend": _blend("overdamped", Overdamped),
    "virtual_power": Strategy("power balance, velocities frozen, by JAX", lambda _: VirtualPower()),
    "virtual_power_blend": _blend("virtual_power", VirtualPower),
}
REFERENCE = Regression((0.2,))
JUDGED_FROM = 3.0  # standard errors of the reference


@dataclass(frozen=True, eq=False)
class Audit:
    """Slopes (m, p) per unit of ln p, by strategy, and the reference's.

    Rows are all observables, and then, for strategies that have them, all curves.
    """

    names: tuple[str, ...]
    reference: Sensitivity
    estimates: dict[str, Sensitivity]
    costs: dict[str, float]  # forward runs a packing
    described: dict[str, str]
    packings: int
    points: CurvePoints
    certificates: dict[str, list[Certificate]] = field(default_factory=dict)

    def rows(self, strategy: str) -> list[dict]:
        """One row for each parameter and observable: the contract's keys, and intervals."""
        found = self.estimates[strategy]
        return [
            judged(
                {
                    "parameter": parameter,
                    "observable": observable,
                    "estimate": float(found.slopes[m, p]),
                    "estimate_se": float(found.standard_error[m, p]),
                    "reference": float(self.reference.slopes[m, p]),
                    "reference_se": float(self.reference.standard_error[m, p]),
                    "estimate_by_packing": _by_packing(found, m, p),
                    "reference_by_packing": _by_packing(self.reference, m, p),
                }
            )
            for m, observable in enumerate(self.points.observables)
            for p, parameter in enumerate(self.names)
        ]


def _by_packing(found: Sensitivity, m: int, p: int) -> list[float] | None:
    return None if found.by_packing is None else np.asarray(found.by_packing[:, m, p]).tolist()


def judged(row: dict) -> dict:
    """The row with relative_error, whether it can be judged, and if so whether it passed."""
    estimate, reference = row["estimate"], row["reference"]
    large = abs(reference) > JUDGED_FROM * row["reference_se"]
    close = abs(estimate - reference) <= described(row["observable"]).within * abs(reference)
    return {
        **row,
        "relative_error": estimate / reference - 1 if reference else float("nan"),
        "judged": large,
        "passed": bool(close) if large else None,
    }


def verdict(rows: Sequence[dict]) -> bool:
    """Whether every slope that can be judged has passed."""
    return all(row["passed"] for row in rows if row["judged"])


def checked_strategies(names: Sequence[str]) -> tuple[str, ...]:
    """Names of strategies, each once; refused where one is unknown."""
    for name in names:
        if name not in STRATEGIES:
            repair = suggestion(name, STRATEGIES) or f"give {', '.join(STRATEGIES)}"
            raise InputError(COMMAND_LINE, "--strategy", f"no strategy '{name}'", repair)
    return tuple(dict.fromkeys(names))


def traces(names: Sequence[str]) -> bool:
    """Whether one of the strategies differentiates the run itself, which takes one `Campaign`."""
    return any(not STRATEGIES[name].simulated for name in names)


def audit(
    space: Space,
    work: AbstractCampaign,
    seeds: Sequence[int],
    names: Sequence[str],
    library: OnResponse | None = None,
) -> Audit:
    """Reference and estimates at the space's base soil, on the packings `seeds`.  `library` stands
    behind the strategy "response"."""
    point, count = jnp.log(jnp.asarray(space.start())), len(seeds)
    points = CurvePoints.of(work)
    simulated = simulated_response(space, work, seeds, points)
    reference = REFERENCE(simulated("reference"), point, count)
    if not bool(jnp.all(jnp.isfinite(reference.slopes))):
        raise CalibrationError("audit: a reference has no finite slope: every probe failed")
    made = {name: each.constructor(space) for name, each in STRATEGIES.items()}
    estimates, certificates = {}, {}
    for name in _with_parts(names):
        precise = STRATEGIES[name].blend_of
        if precise:
            estimates[name] = blended(estimates[precise], estimates["ensemble"])
        elif name == RESPONSE:
            assert library is not None
            estimates[name] = library.sensitivity(space, points.shown)
        elif STRATEGIES[name].simulated:
            estimates[name] = made[name](simulated(name), point, count)
        else:
            work.progress.say(f"{name}: one pass with all tangents on every packing")
            strategy = cast(AbstractTraced, made[name])
            found = traced_slopes(strategy, space, cast(Campaign, work), seeds, points)
            estimates[name], certificates[name] = found
    return Audit(
        names=space.names,
        reference=reference,
        estimates={name: estimates[name] for name in names},
        certificates=certificates,
        costs={name: made[name].runs(len(space.names), count) for name in names},
        described={name: made[name].describe() for name in names},
        packings=count,
        points=points,
    )


def _with_parts(names: Sequence[str]) -> list[str]:
    """Those of the strategies and what they are blended of, in the order of `STRATEGIES`."""
    parts = {part for name in names if (part := STRATEGIES[name].blend_of)}
    needed = {*names, *parts, *(["ensemble"] if parts else [])}
    return [name for name in STRATEGIES if name in needed]


def simulated_response(
    space: Space, work: AbstractCampaign, seeds: Sequence[int], points: CurvePoints
) -> Callable:
    """What: a response whose runs are cached simulations; failed runs are NaN."""

    def named(what: str):
        def response(asked: Array) -> Array:
            rows = np.asarray(space.inside(np.asarray(asked)))
            soils = [[space.soil(np.exp(point)) for point in row] for row in rows]
            runs = work.each(soils, seeds, what)
            return jnp.asarray([[points.read(run) for run in row] for row in runs])

        return response

    return named


def audit_json(found: Audit) -> dict:
    """The contract's keys for the first strategy, all of them under "strategies", and curves."""
    first = next(iter(found.estimates))
    each = {name: _strategy_json(found, name) for name in found.estimates}
    return {
        "strategy": first,
        "passed": each[first]["passed"],
        "packings": found.packings,
        "within": {name: described(name).within for name in found.points.observables},
        "judged_from": JUDGED_FROM,
        "rows": each[first]["rows"],
        "strategies": each,
        "curves": {test: _curve_json(found, test) for test in found.points.slices()},
    }


def _strategy_json(found: Audit, name: str) -> dict:
    rows = found.rows(name)
    certificates = found.certificates.get(name)
    certified = {} if certificates is None else {"certificate": _certificate_json(found, name)}
    return {
        **certified,
        "passed": verdict(rows),
        "rows": rows,
        "forward_runs": found.costs[name],
        "described": found.described[name],
    }


def _certificate_json(found: Audit, name: str) -> list[dict]:
    """Growth and imbalance of the derivative on every packing, by test and parameter."""
    return [
        {
            "seed": each.seed,
            "test": reading.test,
            "parameter": parameter,
            "growth": float(each.growth[test, p]),
            "imbalance": float(each.imbalance[test, p]),
            "accepted": not each.refused[test, p],
            "refused": str(each.refused[test, p]),
        }
        for each in found.certificates[name]
        for test, reading in enumerate(found.points.readings)
        for p, parameter in enumerate(found.names)
    ]


def _curve_json(found: Audit, test: str) -> dict:
    """Mean curve and its slopes in every parameter, by reference and by strategy."""
    rows = found.points.slices()[test]
    reading = next(each for each in found.points.readings if each.test == test)
    by_name = {"reference": found.reference} | {
        name: each for name, each in found.estimates.items() if len(each.slopes) >= rows.stop
    }
    return {
        reading.along: reading.points.tolist(),
        "mean": np.nanmean(found.reference.values[:, rows], axis=0).tolist(),
        "slopes": {
            parameter: {
                name: {
                    "slope": each.slopes[rows, p].tolist(),
                    "se": each.standard_error[rows, p].tolist(),
                }
                for name, each in by_name.items()
            }
            for p, parameter in enumerate(found.names)
        },
    }
