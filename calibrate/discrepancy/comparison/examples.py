"""Cases generated from the description, with a known truth: what rivals are trained on.

Cases are made by `generated.World`: of twelve, four have no gap, five a single effect
(signal-to-noise 0.5-2, 2-6 and 6-15), one has a pair, and two have gaps that the library does not
hold: half of these are an effect of the library, left out of it with its class, the other half
smooth random ones.  These are about the shares of withheld sets.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.compare import Prepared
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.repeats import Measured

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
