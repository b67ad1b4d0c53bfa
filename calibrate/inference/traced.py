"""Slopes that JAX takes of a campaign's runs, packing by packing, and their certificates.

`traced_slopes` takes them of what an audit reads.  `FirstOrder` makes of them runs beside a run, to
first order, so that slopes of any feature follow:

    curve(p exp(s)) = curve(p) + s d curve/d ln p
    slope = [feature(+STEP) - feature(-STEP)] / (2 STEP)

A neighbour is a `Run` like any other, so all that is read from runs can be read from it, and it is
kept in the campaign's cache like one.  Where the strategy does not believe its derivative of a
test, the neighbours' numbers of that test are NaN.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.parameters import Space
from calibrate.inference.problem import Problem
from calibrate.labtests.composite import names_observed
from calibrate.simulation import Campaign, Run, side_by_side
from calibrate.simulation.keys import classes, content_hash
from jdem.core.kernel import program
from jdem.laboratory.virtual_lab import Outcome, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing
from jdem.physics import DERIVATIVES
from jdem.sensitivity.base import AbstractTraced, Sensitivity, Traced, averaged
from jdem.sensitivity.overdamped import Overdamped

STEP = 0.05  # in ln p; curves move by more than their rows are rough
SIGNS = (1, -1)


@dataclass(frozen=True, eq=False)
class Certificate:
    """What a traced strategy says of its own slopes on one packing: arrays (tests, p); `refused`
    says why they are not believed, and is empty where they are."""

    seed: int
    growth: np.ndarray
    imbalance: np.ndarray
    refused: np.ndarray


def traced_slopes(
    strategy: AbstractTraced,
    space: Space,
    work: Campaign,
    seeds: Sequence[int],
    points: CurvePoints,
) -> tuple[Sensitivity, list[Certificate]]:
    """Slopes of everything that `points` reads, packing by packing, at the strategy's time step for
    the base soil; NaN where the strategy does not believe them."""
    lab = strategy.laboratory(work.lab)
    slopes = traced(strategy, lab, space, points)
    packings = work.packings(seeds)

    def on(number: int) -> Traced:
        packing = packings[number]
        found = slopes(packing, lab.time_step(packing, space.base))
        return jax.tree.map(np.asarray, found)

    found = side_by_side(
        on, len(packings), work.progress, "derivatives", work.workers, compiles=True
    )
    tests, certificates, believed = points.tests(), [], []
    for seed, each in zip(seeds, found, strict=True):
        refused = np.array(strategy.refusals(lab, each))
        believed.append(jnp.where((refused == "")[tests], each.slopes, jnp.nan))
        sizes = (np.asarray(each.growth), np.asarray(each.imbalance))
        certificates.append(Certificate(seed, *sizes, refused))
    values = jnp.stack([each.values for each in found])
    return averaged(values, jnp.stack(believed)), certificates


def traced(
    strategy: AbstractTraced, lab: VirtualLab, space: Space, points: CurvePoints
) -> Callable[[Packing, Array], Traced]:
    """A compiled function of one packing and its time step (s), at the space's base soil; slopes
    are per unit of ln p.  `lab` is what the strategy makes of the campaign's."""
    point = jnp.log(jnp.asarray(space.start()))

    @program
    def slopes(packing: Packing, time_step: Array) -> Traced:
        def simulated(lab: VirtualLab, asked: Array) -> Outcome:
            values = space.start() * jnp.exp(asked - point)  # at the point exactly the base soil's
            return lab.run(packing, space.soil(values), time_step)

        return strategy.traced(lab, simulated, points.traced, point)

    return slopes


@dataclass(eq=False)
class FirstOrder:
    """Slopes of a problem's features on the packings of a campaign, by a traced strategy."""

    campaign: Campaign
    space: Space
    strategy: AbstractTraced = field(default_factory=Overdamped)

    def __post_init__(self):
        self.lab = self.strategy.laboratory(self.campaign.lab)
        self._program = program(self._derivatives)

    def slopes(
        self, problem: Problem, values: np.ndarray, seeds: Sequence[int], what: str
    ) -> Sensitivity:
        """Features (n, m) at parameter values (p,), and slopes (m, p) of their mean per ln p."""
        centre = problem.simulated(self.campaign.runs([self.space.soil(values)], seeds, what)[0])
        beside = np.array([problem.simulated(n) for n in self.neighbours(values, seeds, what)])
        slopes = (beside[:, 0::2] - beside[:, 1::2]) / (2 * STEP)  # (n, p, m)
        return averaged(jnp.asarray(centre), jnp.asarray(np.swapaxes(slopes, 1, 2)))

    def neighbours(self, values: np.ndarray, seeds: Sequence[int], what: str) -> list[list[Run]]:
        """On each packing, for each parameter in turn, the runs at + and - STEP in ln p."""
        soil = self.space.soil(values)
        centres = self.campaign.runs([soil], seeds, what)[0]
        packings = self.campaign.packings(seeds)

        def on(number: int) -> list[Run]:
            keys = self._keys(soil, seeds[number])
            kept = [run for key in keys if (run := self.campaign.store.run(key)) is not None]
            if len(kept) == len(keys):
                return kept
            step = self.lab.time_step(packings[number], soil)
            traced = self._program(packings[number], step, jnp.asarray(values))
            found = self._runs(centres[number], jax.tree.map(np.asarray, traced))
            for key, run in zip(keys, found, strict=True):
                self.campaign.store.keep_run(key, run)
            return found

        progress, workers = self.campaign.progress, self.campaign.workers
        return side_by_side(
            on, len(seeds), progress, f"{what}: derivatives", workers, compiles=True
        )

    def _derivatives(self, packing: Packing, time_step: Array, values: Array) -> Traced:
        def simulated(lab: VirtualLab, shift: Array) -> Outcome:
            return lab.run(packing, self.space.soil(values * jnp.exp(shift)), time_step)

        return self.strategy.traced(self.lab, simulated, self._read, jnp.zeros(values.shape))

    def _read(self, outcome: Outcome) -> Array:
        """All observables, and all curves' displacements (mm), forces (N) and rows that count."""
        observed = [
            factor * outcome.observables[test][source]
            for (test, source), (_, factor) in names_observed(self.lab.tests.apparatus).items()
        ]
        curves = [
            column
            for test in self.lab.tests.apparatus
            for curve in [outcome.curves[test.name]]
            for column in (1e3 * curve.displacement, curve.force, curve.valid)
        ]
        return jnp.concatenate([jnp.stack(observed), *curves])

    def _runs(self, centre: Run, found: Traced) -> list[Run]:
        """Neighbours of one run in all parameters."""
        believed = np.array(self.strategy.refusals(self.lab, found)) == ""
        return [
            self._neighbour(centre, found, number, sign * STEP, believed)
            for number in range(found.slopes.shape[1])
            for sign in SIGNS
        ]

    def _neighbour(
        self, centre: Run, found: Traced, number: int, shift: float, believed: np.ndarray
    ) -> Run:
        tests, called = self.lab.tests.apparatus, names_observed(self.lab.tests.apparatus)
        order = [test.name for test in tests]
        moved = found.values + shift * found.slopes[:, number]
        single, rows = moved[: len(called)], moved[len(called) :].reshape(len(tests), 3, -1)
        valid = found.values[len(called) :].reshape(rows.shape)[:, 2] > 0
        observables = {
            name: float(value) if believed[order.index(test), number] else np.nan
            for ((test, _), (name, _)), value in zip(called.items(), single, strict=True)
        }
        curves = {
            name: np.where(believed[k, number], rows[k, :2].T[valid[k]], np.nan)
            for k, name in enumerate(order)
        }
        return replace(centre, observables=observables, curves=curves)

    def _keys(self, soil: SoilParameters, seed: int) -> list[str]:
        """Keys of the neighbours: what the run depends on, and how it was differentiated."""
        content = {
            "run": self.campaign.key(soil, seed),
            "derivatives": DERIVATIVES,
            "strategy": classes(self.strategy),
            "settings": repr(self.strategy),
        }
        return [
            content_hash({**content, "ln": name, "by": sign * STEP})
            for name in self.space.names
            for sign in SIGNS
        ]
