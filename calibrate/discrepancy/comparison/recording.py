"""What recording adds to features: sampling at the laboratory's rate, and instruments' noise.

A simulated curve has thousands of points and no noise; a recorded one misses the very peak and
scatters.  Both the shift and the scatter of each feature are found by recording one
typical curve many times, each time beginning at another moment.  Some machines store what
they read at a moment, others the mean since the last reading, and few say which: half of the
difference, which all specimens of a laboratory share, is one more thing that is not known.
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
        """A recording that begins anywhere within the first interval; averaging: of the mean
        force between readings."""
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


def recording(
    features: Sequence[Feature],
    curves: Curves,
    channels: Mapping[str, AbstractChannel],
    rng: np.random.Generator,
    repeats: int = REPEATS,
    air: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shift (m,) of the mean, covariance (m, m) of a specimen, and error (m,) that all share.

    curves: finely sampled ones of a typical specimen, from contact on; channels: one for each test;
    air: ways (mm) before contact that are recorded too.  What is recorded is read as that of a
    laboratory is (`recorded_feature_values`).
    """
    departures = _departures(features, curves, channels, rng, repeats, air or {})
    moments, means = map(np.nan_to_num, departures)  # nothing where the typical specimen ends
    centred = np.concatenate([moments - moments.mean(axis=0), means - means.mean(axis=0)])
    shift, either = _middle(moments, means)
    return shift, best_shape(centred).of(centred), either


def recording_shift(
    features: Sequence[Feature],
    curves: Curves,
    channels: Mapping[str, AbstractChannel],
    rng: np.random.Generator,
    repeats: int = REPEATS,
    air: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The shift and the shared error alone."""
    return _middle(*_departures(features, curves, channels, rng, repeats, air or {}))


def _departures(features, curves, channels, rng, repeats, air) -> tuple[np.ndarray, np.ndarray]:
    """Features (r, m) of recordings less those of the curves, by moments and by means."""
    exact = feature_values(features, curves)
    whole = {test: through_air(x, force, air.get(test, 0.0)) for test, (x, force) in curves.items()}

    def once(averaging: bool) -> np.ndarray:
        read = {test: channels[test].record(*whole[test], rng, averaging) for test in whole}
        return recorded_feature_values(features, read) - exact

    def recorded(averaging: bool) -> np.ndarray:
        found = np.array([once(averaging) for _ in range(repeats)])
        return np.where(np.isfinite(found), found, 0.0 * exact)

    return recorded(False), recorded(True)


def _middle(moments: np.ndarray, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Between both ways, and how far each is from it."""
    middle = (moments.mean(axis=0) + means.mean(axis=0)) / 2
    return middle, moments.mean(axis=0) - middle


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
