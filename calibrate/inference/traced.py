"""Slopes that JAX takes of a campaign's runs, packing by packing, and their certificates."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.parameters import Space
from calibrate.simulation import Campaign, side_by_side
from jdem.core.program import program
from jdem.effects.composite import with_strengths
from jdem.laboratory.virtual_lab import Outcome, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing
from jdem.sensitivity.base import AbstractTraced, Sensitivity, Traced, averaged


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


def traced_strengths(
    strategy: AbstractTraced, lab: VirtualLab, soil: SoilParameters, points: CurvePoints
) -> Callable[[Packing, Array], Traced]:
    """A compiled function of one packing and its time step (s), at the strengths of the effects of
    a campaign's `lab`; slopes are per typical strength.

    Slopes lack what the load cell's lag and drift do to where the machine turns.
    """
    typical = jnp.asarray([max(map(abs, effect.about.typical)) for effect in lab.effects])
    point = jnp.stack([jnp.asarray(effect.strength, float) for effect in lab.effects]) / typical

    @program
    def slopes(packing: Packing, time_step: Array) -> Traced:
        def simulated(lab: VirtualLab, asked: Array) -> Outcome:
            changed = with_strengths(lab.effects, list(asked * typical))
            altered = strategy.laboratory(replace(lab, effects=changed))
            return altered.run(packing, soil, time_step)

        return strategy.traced(lab, simulated, points.traced, point)

    return slopes
