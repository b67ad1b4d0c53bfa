"""A made-up linear simulator for tests of the diagnosis: smooth slopes, smooth scatter.

Eight effects act on both tests or on one; specimens scatter by a few smooth modes, so that
neighbouring features are nearly the same number twice; what a diagnosis may know is sixty
simulated specimens.  `case` makes a laboratory of four repeats of each test.
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

from calibrate.discrepancy.comparison.linear import EffectCandidate, Linearised
from calibrate.discrepancy.comparison.repeats import Measured, from_vectors
from calibrate.labtests.diagnosis.base import Feature, UsualSizes
from calibrate.labtests.diagnosis.confined import NAME as CONFINED
from calibrate.labtests.diagnosis.curves import declare, tests_of

FEATURES = declare(UsualSizes(400.0, 6.0, 200.0))
CONFINED_ONES = tests_of(FEATURES) == CONFINED
PLACE = np.array([f.position for f in FEATURES]) + 1.5 * ~CONFINED_ONES
UNIT = np.where([f.unit == "mm" for f in FEATURES], 0.1, 10.0)
PLAN = np.array([CONFINED_ONES] * 4 + [~CONFINED_ONES] * 4)
EFFECTS = 8
SIMULATED = 60


def simple(
    features: Sequence[Feature],
    mean: np.ndarray,
    base: dict[str, tuple[np.ndarray, float]],
    effects: Sequence[tuple[EffectCandidate, np.ndarray]],
    packing_residuals: np.ndarray,
    mean_specimens: int | None = None,
) -> Linearised:
    """A description without slope errors, extra covariances or emulator.

    base: slope (m,) per ln p and prior deviation by name; effects with slopes (m,) per unit
    of their strength.  `dataclasses.replace` adds the rest.
    """
    m = len(mean)
    slopes = np.array([slope for slope, _ in base.values()]).reshape(-1, m).T
    columns = np.array([slope * e.typical for e, slope in effects]).reshape(-1, m).T
    return Linearised(
        features=tuple(features),
        mean=mean,
        base_names=tuple(base),
        base_slopes=slopes,
        prior_sd=np.array([sd for _, sd in base.values()]),
        effects=tuple(effect for effect, _ in effects),
        effect_slopes=columns,
        packing_residuals=packing_residuals,
        mean_specimens=mean_specimens or len(packing_residuals),
        base_errors=np.zeros_like(slopes),
        extra=np.zeros((m, m)),
        sensor=np.zeros((m, m)),
        wrong=np.zeros((m, 0)),
    )


def correlation(length: float) -> np.ndarray:
    """Smooth correlation (m, m) of features along both tests."""
    return np.exp(-0.5 * ((PLACE[:, None] - PLACE) / length) ** 2)


def scatter() -> np.ndarray:
    """True covariance (m, m) of a specimen: smooth, with a little roughness."""
    return np.outer(UNIT, UNIT) * (correlation(0.3) + 0.02 * np.eye(len(UNIT)))


def draws(covariance: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Normal vectors (count, m)."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0))
    return np.random.default_rng(seed).standard_normal((count, len(values))) @ root.T


@cache
def description(seed: int = 0) -> Linearised:
    """What a diagnosis knows; seed chooses the simulated specimens, not the truth."""
    shapes = UNIT * draws(correlation(0.25), EFFECTS, 1)
    shapes[0::4] *= CONFINED_ONES
    shapes[1::4] *= ~CONFINED_ONES
    slopes = 2 * UNIT * draws(correlation(0.5), 5, 2)
    simulated = draws(scatter(), SIMULATED, 100 + seed)
    effects = [(EffectCandidate(f"e{k}", k % 2 == 0, 1.0), shape) for k, shape in enumerate(shapes)]
    base = {f"b{i}": (slope, 0.5) for i, slope in enumerate(slopes)}
    mean = simulated.mean(axis=0)
    return simple(FEATURES, mean, base, effects, simulated - mean)


def case(seed: int, gap: np.ndarray | None = None, off_centre: float = 1.0) -> Measured:
    """A laboratory with a gap (m,) and base parameters from `off_centre` times their prior."""
    known = description()
    delta = off_centre * known.prior_sd * np.random.default_rng(seed).standard_normal(5)
    mean = known.base_slopes @ delta + (0 if gap is None else gap)
    specimens = mean + draws(scatter(), len(PLAN), 10_000 + seed)
    return from_vectors(FEATURES, np.where(PLAN, specimens, np.nan))
