"""A rehearsal: many generated cases are diagnosed, and the opinion learns to state what is so.

Cases are made by `generated.World`: of twelve, four have no gap, five a single effect
(signal-to-noise 0.5-2, 2-6 and 6-15), one has a pair, and two have gaps that the library does not
hold: half of these are an effect of the library, left out of it with its class, the other half
smooth random ones.  These shares are the prior of what is stated (those of withheld sets).
Each case is diagnosed with a covariance estimated anew from as many simulated specimens as
there are, so that what is not known of the covariance shows in the stated probabilities.
One half of the cases fits the probabilities, the other the size of sets of explanations. What is
stated then is tempered as opened withheld cases taught (`tempering`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.diagnosis.classes import Classes
from calibrate.diagnosis.noise import best_shape
from calibrate.diagnosis.opinion import NONE, UNKNOWN, Facts, fitted
from calibrate.diagnosis.repeats import Measured
from calibrate.diagnosis.sets import threshold
from calibrate.diagnosis.tempering import learned_tempering
from calibrate.diagnosis.which import Prepared, diagnose, label, right, stated

STRATA = ((0.5, 2.0), (2.0, 6.0), (6.0, 15.0))
KINDS = (NONE, "single", UNKNOWN, NONE, "single", "pair", NONE, "single", UNKNOWN, NONE,
         "single", "single")  # in turn  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """A generated sample, what is true of it, and what its library lacks."""

    measured: Measured
    truth: tuple[str, ...]
    left_out: tuple[str, ...]
    snr: float


def rehearsed(prepared: Prepared, seed: int, cases: int = 400) -> Prepared:
    """The same with an opinion and sets fitted to generated cases."""
    rng = np.random.default_rng(seed)
    residuals = prepared.description.packing_residuals
    shape = best_shape(residuals - residuals.mean(axis=0))
    facts: list[Facts] = []
    truths: list[np.ndarray] = []
    labels: list[tuple[Classes, str]] = []
    for number in range(cases):
        case = generated_case(prepared, rng, KINDS[number % len(KINDS)])
        library = prepared.without(case.left_out) if case.left_out else prepared
        library = library.with_packing(shape.of(prepared.world.simulated(rng)))
        found = diagnose(library, case.measured).facts
        facts.append(found)
        truths.append(right(found, library.classes, case.truth))
        labels.append((library.classes, label(library.classes, case.truth)))
    order = rng.permutation(cases)
    half = cases // 2
    opinion = fitted(_these(facts, order[:half]), _these(truths, order[:half]))
    tempering = learned_tempering()
    said = [
        stated(facts[i], labels[i][0], opinion, tempering)[1].get(labels[i][1], 0.0)
        for i in order[half:]
    ]
    smallest = threshold(np.array(said))
    return replace(prepared, opinion=opinion, smallest=smallest, tempering=tempering)


def generated_case(prepared: Prepared, rng: np.random.Generator, kind: str) -> Case:
    """One case of a kind."""
    world, names = prepared.world, prepared.description.effect_names
    snr = float(rng.uniform(*STRATA[rng.integers(len(STRATA))]))
    strengths = np.zeros(len(names))
    if kind == NONE or not names:
        return Case(world.measured(rng), (NONE,), (), 0.0)
    if kind == UNKNOWN and rng.random() < 0.5:
        return Case(world.measured(rng, gap=world.smooth_gap(rng, snr)), (UNKNOWN,), (), snr)
    count = 2 if kind == "pair" and len(names) > 1 else 1
    chosen = [int(k) for k in rng.permutation(len(names))[:count]]
    for k in chosen:
        strengths[k] = _signed(prepared, rng, k, snr)
    measured = world.measured(rng, strengths)
    if kind == UNKNOWN:
        return Case(measured, (UNKNOWN,), prepared.classes.of(names[chosen[0]]), snr)
    return Case(measured, tuple(names[k] for k in chosen), (), snr)


def _signed(prepared: Prepared, rng: np.random.Generator, k: int, snr: float) -> float:
    """A strength with this signal-to-noise, of either sign where both are possible."""
    strength = prepared.world.strength_of(k, snr)
    one_sided = prepared.description.effects[k].one_sided
    return strength if one_sided or rng.random() < 0.5 else -strength


def _these(values: Sequence, index: np.ndarray) -> list:
    return [values[i] for i in index]
