"""Cases generated from the description, with a known truth: what rivals are trained on.

Cases are made by `generated.World`: of twelve, four have no gap, five a single effect
(signal-to-noise 0.5-2, 2-6 and 6-15), one has a pair, and two have gaps that no candidate
effect explains: half of these are an effect that is excluded with its class, the other half smooth
random ones.  These are about the shares of withheld sets.
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
class GeneratedCase:
    """A generated sample, what is true of it, and the effects that are no candidates."""

    measured: Measured
    truth: tuple[str, ...]
    excluded_effects: tuple[str, ...]
    snr: float


def generated_case(prepared: Prepared, rng: np.random.Generator, kind: str) -> GeneratedCase:
    """One case of a kind."""
    generator, names = prepared.generator, prepared.description.effect_names
    snr = float(rng.uniform(*STRATA[rng.integers(len(STRATA))]))
    strengths = np.zeros(len(names))
    if kind == NONE or not names:
        return GeneratedCase(generator.measured(rng), (NONE,), (), 0.0)
    if kind == UNKNOWN and rng.random() < 0.5:
        return GeneratedCase(
            generator.measured(rng, gap=generator.smooth_gap(rng, snr)), (UNKNOWN,), (), snr
        )
    count = 2 if kind == "pair" and len(names) > 1 else 1
    chosen = [int(k) for k in rng.permutation(len(names))[:count]]
    for k in chosen:
        strengths[k] = _signed(prepared, rng, k, snr)
    measured = generator.measured(rng, strengths)
    if kind == UNKNOWN:
        return GeneratedCase(measured, (UNKNOWN,), prepared.classes.of(names[chosen[0]]), snr)
    return GeneratedCase(measured, tuple(names[k] for k in chosen), (), snr)


def _signed(prepared: Prepared, rng: np.random.Generator, k: int, snr: float) -> float:
    """A strength with this signal-to-noise, of either sign where both are possible."""
    strength = prepared.generator.strength_of(k, snr)
    one_sided = prepared.description.effects[k].one_sided
    return strength if one_sided or rng.random() < 0.5 else -strength
