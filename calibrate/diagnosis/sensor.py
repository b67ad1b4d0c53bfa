"""What recording adds to features: sampling at the laboratory's rate, and instruments' noise.

A simulated curve has thousands of points and no noise; a recorded one misses the very peak and
scatters.  Both the shift and the scatter of each feature are found by recording one
typical curve many times, each time beginning at another moment.  Some machines store what
they read at a moment, others the mean since the last reading, and few say which: half of the
difference, which all specimens of a laboratory share, is one more thing that is not known.
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
        self, displacement: np.ndarray, force: np.ndarray, rng: np.random.Generator,
        averaging: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """A recording that begins anywhere within the first interval; averaging: of the mean
        force between readings."""
        path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])
        at = np.arange(rng.uniform(0.0, self.spacing), path[-1], self.spacing)
        x = np.interp(at, path, displacement) + self.displacement_sd * rng.standard_normal(len(at))
        read = self._means(path, force, at) if averaging else np.interp(at, path, force)
        return x, read + self.force_sd * rng.standard_normal(len(at))

    def _means(self, path: np.ndarray, force: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Mean force over the interval about each reading."""
        area = np.concatenate([[0.0], np.cumsum(np.diff(path) * (force[1:] + force[:-1]) / 2)])
        ends = np.clip([at - self.spacing / 2, at + self.spacing / 2], 0.0, path[-1])
        low, high = np.interp(ends, path, area)
        return (high - low) / np.maximum(ends[1] - ends[0], 1e-12)


def recording(
    features: Sequence[Feature],
    curves: Curves,
    channels: Mapping[str, Channel],
    rng: np.random.Generator,
    repeats: int = REPEATS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shift (m,) of the mean, covariance (m, m) of a specimen, and error (m,) that all share.

    curves: finely sampled ones of a typical specimen; channels: one for each test.
    """
    exact = vector(features, curves)

    def recorded(averaging: bool) -> np.ndarray:
        read = np.array([
            vector(features, {test: channels[test].record(*curves[test], rng, averaging)
                              for test in curves})
            for _ in range(repeats)
        ])  # fmt: skip
        return np.where(np.isfinite(read), read, exact)

    moments, means = recorded(False), recorded(True)
    centred = np.concatenate([moments - moments.mean(axis=0), means - means.mean(axis=0)])
    middle = (moments.mean(axis=0) + means.mean(axis=0)) / 2
    return middle - exact, best_shape(centred).of(centred), moments.mean(axis=0) - middle
