"""Whether the likeliest explanation may be named at all.

Probabilities stay as they are; the verdict is "none" for the first of these reasons that holds:

    no curves        numbers alone, which calibration meets whatever the model leaves out
    few specimens    one or two of a test do not tell by how much they scatter, and show no gap
    beyond library   the soil that fits best lies beyond the runs, where what is left may be an
                     error of the library; unless with the explanation it lies among them, the gap
                     is larger than the library's error, and the explanation removes a share of it
                     whose interval holds its value and does not reach zero
    no shrinkage     the explanation, added to the model, leaves the gap as large as it was

A gap that is smaller than the library's own error place by place may still be told by its pattern;
by how much it shrinks is not said then (`Reduction.visible`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calibrate.discrepancy.comparison.compare import Comparison
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.reduction import Reduction, estimate_reduction
from calibrate.discrepancy.comparison.repeats import Measured

FEWEST = 3  # specimens of a test that show a gap
MUTE, FEW, BEYOND = "no curves", "few specimens", "beyond library"
NO_SHRINKAGE = "no shrinkage"


@dataclass(frozen=True)
class Grounds:
    """What a name rests on beside evidences: specimens by test that was made; what lies beyond the
    library's runs at base coordinates (p,); whether there are curves."""

    specimens: Mapping[str, int] = field(default_factory=dict)
    beyond: Callable[[np.ndarray], tuple[str, ...]] = lambda delta: ()
    curves: bool = True

    @property
    def few(self) -> bool:
        """Whether a test has too few specimens."""
        return any(count < FEWEST for count in self.specimens.values())


def named(
    d: Linearised, measured: Measured, comparison: Comparison, grounds: Grounds, seed: int
) -> tuple[Comparison, Reduction | None]:
    """The comparison with the verdict that its grounds allow, and by how much the gap shrinks with
    the explanation that is named or, where nothing in the library is, comes nearest."""
    if not grounds.curves:
        return _unnamed(comparison, MUTE), None
    if grounds.few:
        return _unnamed(comparison, FEW), None
    if comparison.verdict == NONE or not comparison.best:
        return replace(comparison, best=()), None
    fit = comparison.refits[comparison.best]
    found = estimate_reduction(d, measured, comparison.noise, comparison.base, fit, seed)
    if grounds.beyond(comparison.base.delta):
        known = comparison.verdict != UNKNOWN and not grounds.beyond(fit.delta)
        if not (known and found.visible and found.holds and found.low > 0):
            return _unnamed(comparison, BEYOND), None
    if found.shrinks:
        return comparison, found
    if comparison.verdict == UNKNOWN or not found.visible:
        return replace(comparison, best=()), None
    return _unnamed(comparison, NO_SHRINKAGE), None


def _unnamed(comparison: Comparison, reason: str) -> Comparison:
    return replace(comparison, verdict=NONE, reason=reason, best=())
