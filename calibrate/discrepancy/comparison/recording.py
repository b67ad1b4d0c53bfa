"""What recording adds to features: sampling at the laboratory's rate, and instruments' noise.

A simulated curve has thousands of points and no noise; a recorded one misses the very peak and
scatters.  Shift and scatter are found by recording one typical curve many times, each time from
another moment on.  Some machines store what they read at a moment, others the mean since the last
reading, and few say which: half of the difference is one more error that all specimens share.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.noise import best_shape
from calibrate.labtests.diagnosis.base import Curves, Feature
from calibrate.labtests.diagnosis.curves import feature_values, recorded_feature_values
from calibrate.labtests.reading import rising

REPEATS = 100
REACHED = 0.01  # share of a load by which a curve may end before it


class AbstractChannel(abc.ABC):
    """How one test is recorded: travel between readings (mm), noise of force (N) and of
    displacement (mm)."""

    spacing: float
    force_sd: float
    displacement_sd: float

    @abc.abstractmethod
    def record(
        self, displacement: np.ndarray, force: np.ndarray, rng: np.random.Generator,
        averaging: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """A recording of a curve; averaging: of the mean force between readings."""


@dataclass(frozen=True)
class Channel(AbstractChannel):
    """Readings at equal intervals of travel."""

    spacing: float
    force_sd: float
    displacement_sd: float

    def record(
        self, displacement: np.ndarray, force: np.ndarray, rng: np.random.Generator,
        averaging: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """A recording that begins anywhere within the first interval."""
        path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])
        half, end = self.spacing / 2, float(path[-1])
        at = np.arange(rng.uniform(0.0, self.spacing), end, self.spacing)
        x = np.interp(at, path, displacement) + self.displacement_sd * rng.standard_normal(len(at))
        if averaging:
            ends = (np.clip(at - half, 0.0, end), np.clip(at + half, 0.0, end))
            read = interval_means(path, force, *ends)
        else:
            read = np.interp(at, path, force)
        return x, read + self.force_sd * rng.standard_normal(len(at))


@dataclass(frozen=True, eq=False)
class LoadSteps(AbstractChannel):
    """One reading at each of rising loads (k,), N, as of an oedometer: what lies between is read
    straight, in measured and simulated curves alike."""

    loads: np.ndarray
    displacement_sd: float
    spacing = 0.0
    force_sd = 0.0

    def record(
        self, displacement: np.ndarray, force: np.ndarray, rng: np.random.Generator,
        averaging: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        top = int(np.argmax(force)) + 1
        travel, level = rising(displacement[:top], force[:top])
        loads = self.loads[self.loads <= (1 + REACHED) * level[-1]]
        x = np.interp(loads, level, travel)
        return x + self.displacement_sd * rng.standard_normal(len(x)), loads


def interval_means(
    path: np.ndarray, force: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> np.ndarray:
    """Mean force (k,) between positions on a path: what an averaging recorder stores."""
    area = np.concatenate([[0.0], np.cumsum(np.diff(path) * (force[1:] + force[:-1]) / 2)])
    low, high = (np.interp(at, path, area) for at in (begin, end))
    return (high - low) / np.maximum(end - begin, 1e-12)


@dataclass(frozen=True, eq=False)
class Recordings:
    """Features (r, m) of recordings of one specimen less those of its curves: of force at moments,
    and of means since the last reading; NaN where the specimen ends."""

    moments: np.ndarray
    means: np.ndarray

    @property
    def shift(self) -> np.ndarray:
        """Of the mean (m,): between both ways."""
        return (self.moments.mean(axis=0) + self.means.mean(axis=0)) / 2

    @property
    def either(self) -> np.ndarray:
        """How far (m,) each way is from that: an error that all specimens share."""
        return self.moments.mean(axis=0) - self.shift

    def covariance(self) -> np.ndarray:
        """Of a specimen (m, m)."""
        ways = map(np.nan_to_num, (self.moments, self.means))
        centred = np.concatenate([way - way.mean(axis=0) for way in ways])
        return best_shape(centred).of(centred)


def recordings(
    features: Sequence[Feature], curves: Curves, channels: Mapping[str, AbstractChannel],
    rng: np.random.Generator, repeats: int = REPEATS, air: Mapping[str, float] | None = None,
) -> Recordings:  # fmt: skip
    """Recordings, read as those of a laboratory are (`recorded_feature_values`).

    curves: finely sampled ones of a typical specimen, from contact on; channels: one for each test;
    air: ways (mm) before contact that are recorded too.
    """
    exact, air = feature_values(features, curves), air or {}
    whole = {test: through_air(x, force, air.get(test, 0.0)) for test, (x, force) in curves.items()}

    def once(averaging: bool) -> np.ndarray:
        read = {test: channels[test].record(*whole[test], rng, averaging) for test in whole}
        return recorded_feature_values(features, read) - exact

    def repeated(averaging: bool) -> np.ndarray:
        found = np.array([once(averaging) for _ in range(repeats)])
        return np.where(np.isfinite(found), found, 0.0 * exact)

    return Recordings(repeated(False), repeated(True))


def through_air(
    displacement: np.ndarray, force: np.ndarray, way: float
) -> tuple[np.ndarray, np.ndarray]:
    """A curve with a way (mm) before contact, at the force of its first point."""
    if not way:
        return displacement, force
    return (
        np.concatenate([[displacement[0] - way], displacement]),
        np.concatenate([[force[0]], force]),
    )
