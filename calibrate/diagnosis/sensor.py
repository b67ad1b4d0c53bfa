"""What recording adds to features: sampling at the laboratory's rate, and instruments' noise.

A simulated curve has thousands of points and no noise; a recorded one misses the very peak and
scatters.  Both the shift and the scatter of each feature are found by recording one
typical curve many times, each time beginning at another moment.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.diagnosis.features import Curves, Feature, vector
from calibrate.diagnosis.noise import best_shape

REPEATS = 100


@dataclass(frozen=True)
class Channel:
    """How one test is recorded: travel between samples (mm), noise of force (N) and of
    displacement (mm)."""

    spacing: float
    force_sd: float
    displacement_sd: float

    def record(
        self, displacement: np.ndarray, force: np.ndarray, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray]:
        """A recording that begins anywhere within the first interval."""
        path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])
        at = np.arange(rng.uniform(0.0, self.spacing), path[-1], self.spacing)
        x = np.interp(at, path, displacement) + self.displacement_sd * rng.standard_normal(len(at))
        return x, np.interp(at, path, force) + self.force_sd * rng.standard_normal(len(at))


def recording(
    features: Sequence[Feature],
    curves: Curves,
    channels: Mapping[str, Channel],
    rng: np.random.Generator,
    repeats: int = REPEATS,
) -> tuple[np.ndarray, np.ndarray]:
    """Shift (m,) of the mean and covariance (m, m) that recording adds to features.

    curves: finely sampled ones of a typical specimen; channels: one for each test.
    """
    exact = vector(features, curves)
    read = np.array(
        [
            vector(features, {test: channels[test].record(*curves[test], rng) for test in curves})
            for _ in range(repeats)
        ]
    )
    read = np.where(np.isfinite(read), read, exact)
    centred = read - read.mean(axis=0)
    return read.mean(axis=0) - exact, best_shape(centred).of(centred)
