"""Data made from the description itself: specimens with or without a known gap.

Each draw shifts the base parameters by their prior, adds errors of mean and slopes, and scatters
packings as simulated ones scatter, times an amplitude from its prior: a smoothed bootstrap
(Silverman and Young 1987, Biometrika 74), so that rare specimens that slip are drawn as often as
they are simulated.  Data of the same make as the description flatter it: this is no test of it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import PRIOR_SD_LN_AMPLITUDE
from calibrate.discrepancy.comparison.projection import lengths, project
from calibrate.discrepancy.comparison.repeats import Measured, from_vectors, robust, scatter_of
from calibrate.labtests.diagnosis.curves import TESTS, tests_of

HEAVY = 5.0  # degrees of freedom of what a description is wrong by, as an emulator's errors are


@dataclass(frozen=True, eq=False)
class SampleGenerator:
    """Where the description is true; plan (s, m): which specimen has which feature; packing (m, m):
    covariance of simulated specimens, taken as true."""

    description: Linearised
    plan: np.ndarray
    packing: np.ndarray

    @cached_property
    def packing_root(self) -> np.ndarray:
        return root_of(self.packing)

    @cached_property
    def other_root(self) -> np.ndarray:
        """Of what specimens differ by beside their packing."""
        return root_of(self.specimen - self.packing)

    @cached_property
    def specimen(self) -> np.ndarray:
        """Covariance (m, m) of one specimen."""
        d = self.description
        return self.packing + d.extra + d.sensor

    def sample(self, specimens: np.ndarray) -> Measured:
        """That of specimens (..., s, m): one, or many."""
        d = self.description
        return robust(from_vectors(d.features, specimens), scatter_of(d))

    def specimens(
        self,
        rng: np.random.Generator,
        strengths: np.ndarray | None = None,
        gap: np.ndarray | None = None,
    ) -> np.ndarray:
        """Specimens (s, m) with effects of given strengths (k,) and any other gap (m,); NaN where a
        feature is not measured."""
        d = self.description
        delta = d.prior_sd * rng.standard_normal(len(d.prior_sd))
        given = np.zeros(len(d.effects)) if strengths is None else strengths
        mean = d.at(delta, given)[0] + self._wrong_by(rng, delta)
        if gap is not None:
            mean = mean + gap
        count = len(self.plan)
        packings = self._amplitude(rng) * self._packings(rng, count)
        values = mean + packings + normal(rng, self.other_root, count)
        return np.where(self.plan, values, np.nan)

    def _amplitude(self, rng: np.random.Generator) -> np.ndarray:
        """By how much more than simulated ones packings scatter (m,): a draw from the amplitudes'
        prior for each test."""
        drawn = [np.exp(PRIOR_SD_LN_AMPLITUDE * rng.standard_normal()) for _ in TESTS]
        return np.array(drawn)[self._test]

    @cached_property
    def _test(self) -> np.ndarray:
        """Which of TESTS each feature is of (m,)."""
        return np.array([TESTS.index(test) for test in tests_of(self.description.features)])

    def simulated(self, rng: np.random.Generator) -> np.ndarray:
        """As many residuals (n, m) of simulated specimens as the description has."""
        samples = self._packings(rng, len(self.description.packing_residuals))
        return samples - samples.mean(axis=0)

    def _packings(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Residuals (count, m): simulated ones and normal ones, of which more, the fewer simulated
        ones there are for the number of features."""
        rows = self._residuals
        normal_share = min(rows.shape[1] / len(rows), 1.0)
        drawn = rows[rng.integers(len(rows), size=count)]
        smooth = normal(rng, self.packing_root, count)
        return np.sqrt(1 - normal_share) * drawn + np.sqrt(normal_share) * smooth

    @cached_property
    def _residuals(self) -> np.ndarray:
        """Of simulated specimens, centred (n, m)."""
        residuals = self.description.packing_residuals
        return residuals - residuals.mean(axis=0)

    def snr(self, signatures: np.ndarray) -> np.ndarray:
        """Projected signal-to-noise of changes of features (m, k)."""
        return lengths(self.projected(signatures))

    def projected(self, signatures: np.ndarray) -> np.ndarray:
        """Changes of features (m, k) projected off the base parameters, in units of the scatter of
        the measured means."""
        d, none = self.description, np.zeros(len(self.description.mean))
        covariance = self.mean_covariance
        return project(none, d.base_slopes, d.prior_sd, signatures, covariance).effects

    @cached_property
    def mean_covariance(self) -> np.ndarray:
        """Covariance (m, m) of measured minus simulated mean."""
        planned = self.plan.astype(float)
        shared = planned.T @ planned
        weights = shared / np.outer(np.diag(shared), np.diag(shared))
        return (
            self.specimen * weights
            + self.packing / self.description.mean_specimens
            + self.description.own_error
        )

    def _wrong_by(self, rng: np.random.Generator, delta: np.ndarray) -> np.ndarray:
        """Errors (m,) of the description: of its mean, its slopes, and what it admits."""
        d = self.description
        deviation = np.sqrt(np.maximum(np.diag(self.packing), 1e-300))
        mean = normal(rng, self.packing_root, 1)[0] / np.sqrt(d.mean_specimens)
        shared = normal(rng, self.packing_root / deviation[:, None], len(delta)).T
        slopes = (d.base_errors * shared) @ delta
        tail = np.sqrt(HEAVY / rng.chisquare(HEAVY))  # a few soils are far off
        return mean + slopes + tail * d.wrong @ rng.standard_normal(d.wrong.shape[1])


def normal(rng: np.random.Generator, root: np.ndarray, count: int) -> np.ndarray:
    """Draws (count, m) with covariance `root` root'."""
    return rng.standard_normal((count, root.shape[1])) @ root.T


def root_of(covariance: np.ndarray) -> np.ndarray:
    """R (m, m) with R R' = covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def plan_of(measured: Measured) -> np.ndarray:
    """Which specimen (s, m) has which feature; scalar targets count as specimens apart."""
    if len(measured.specimens):
        return np.isfinite(measured.specimens)
    unit = np.eye(len(measured.features), dtype=bool)
    return np.repeat(unit, measured.counts.astype(int), axis=0)
