"""What a fuller mould does to the beginning of a curve, in closed form.

Spheres that have grown by e in volume press on the mould before the platen moves.  So the curve
begins where the soil's own one is pressed by a share k of that growth over its height h, and joins
it from there on:

    d_shown(F) = max(d(F), d(0) + k e h)        e > 0; rounded over r k e h

An elastic bed that swells by e between walls that hold it presses with K e, one that is pressed by
the platen alone with M per strain, so k is about K/M = (1 + nu)/(3 - 3 nu), 0.6 to 0.8.  Looser
moulds have no such beginning.  An emulator of smooth functions spreads the corner over forces that
do not feel it.  k and r are estimated from a library's own rows; what remains the emulator learns.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from calibrate.discrepancy.library.reading import by_force
from calibrate.labtests.diagnosis.base import Feature

DENSITY = "specimen_density"
FEWEST = 20  # rows with a fuller mould, of which two numbers are estimated
START = (0.7, 0.3)  # share and roundness, from which they are
BOUNDS = ((0.2, 0.02), (1.5, 2.0))
SCALE = 0.1  # mm; errors beyond count less (`soft_l1`)


@dataclass(frozen=True)
class Filling:
    """Share k and roundness r."""

    share: float
    roundness: float

    def moved(
        self, features: Sequence[Feature], values: np.ndarray, growth: np.ndarray,
        height: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """What growths (n, 1) add to features (n, m) of a soil in specimens of heights (n, 1), mm;
        complex numbers carry derivatives."""
        moved = np.zeros(values.shape, np.result_type(values, growth, height))
        up, down = (by_force(features, kind) for kind in ("loading", "unloading"))
        if len(up) < 2:
            return moved
        pressed = self.share * np.where(np.real(growth) > 0, growth, 0.0) * height
        begins = _touch(features, up, values) + pressed
        width = self.roundness * pressed
        at_zero = _larger(0.0 * begins, begins, width)  # displacements count from half load
        moved[:, up] = _larger(values[:, up], begins, width) - values[:, up] - at_zero
        moved[:, down] = -at_zero
        return np.where(np.real(pressed) > 0, moved, 0.0)

    @staticmethod
    def of(
        features: Sequence[Feature], before: np.ndarray, after: np.ndarray, growth: np.ndarray,
        height: np.ndarray,
    ) -> "Filling | None":  # fmt: skip
        """The one that is likeliest, given features (n, m) of soils and those of the same with
        growths (n, 1); None where these are few."""
        up = by_force(features, "loading")
        if len(growth) < FEWEST or len(up) < 2:
            return None

        def left(at: np.ndarray) -> np.ndarray:
            moved = Filling(*at).moved(features, before, growth, height)
            return ((after - before - moved)[:, up] / SCALE).ravel()

        return Filling(*least_squares(left, START, bounds=BOUNDS, loss="soft_l1").x.tolist())


def _larger(a, b, width):
    """The larger of both, rounded; where they are equal by half the width more."""
    return 0.5 * (a + b + np.sqrt((a - b) ** 2 + width**2 + 1e-12))


def _touch(features: Sequence[Feature], up: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Displacements (n, 1) at no force: straight on from the two features of least force."""
    first, second = up[:2]
    low, high = features[first].abscissa, features[second].abscissa
    slope = (values[:, second] - values[:, first]) / (high - low)
    return (values[:, first] - slope * low)[:, None]
