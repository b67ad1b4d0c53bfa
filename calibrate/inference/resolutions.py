"""Two resolutions of one specimen: explored with small beds, decided on large ones.

    y_large(p) = rho y_small(p),   rho = y_large / y_small feature by feature at one point
    slopes:  dy_large/d ln p = rho dy_small/d ln p

Values come from where they are right, slopes from where they are cheapest for their noise
(multiplicative space mapping; Bandler et al. 2004, IEEE Trans. Microwave Theory Tech. 52, 337).
Small beds are fitted first, to what was measured divided by rho; the large beds then take few
steps, and rho is measured anew at each point where slopes are.  Scatter of packings comes from
both: a specimen's relative scatter goes with N^-1/2, as that of a mean over independent parts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.inference.problem import Problem, shrunk_covariance
from calibrate.simulation.joint import AbstractCampaign
from jdem.materials.soil import SoilParameters

WIDEST = 3.0  # a feature whose ratio is beyond it, or negative, is not scaled: it has another sign
CERTAIN = 3.0  # standard errors beyond which ratios at two points differ


@dataclass(frozen=True, eq=False)
class Correction:
    """Ratio (m,) of large beds to small ones for each feature, and its relative standard error,
    from both packings' scatter."""

    ratio: np.ndarray
    relative_se: np.ndarray

    @staticmethod
    def none(count: int) -> "Correction":
        """One resolution only: every ratio is 1."""
        return Correction(np.ones(count), np.zeros(count))

    @staticmethod
    def of(large: np.ndarray, small: np.ndarray) -> "Correction":
        """From features (n, m) on packings of both sizes; rows with a failed run are left out."""
        ours, theirs = (rows[np.all(np.isfinite(rows), axis=1)] for rows in (large, small))
        count = len(large[0])
        if not len(ours) or not len(theirs):
            return Correction(np.ones(count), np.full(count, np.inf))
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = ours.mean(axis=0) / theirs.mean(axis=0)
        usable = np.isfinite(ratio) & (ratio > 1 / WIDEST) & (ratio < WIDEST)
        variance = _relative_variance(ours) + _relative_variance(theirs)
        return Correction(np.where(usable, ratio, 1.0), np.where(usable, np.sqrt(variance), np.inf))


def _relative_variance(features: np.ndarray) -> np.ndarray:
    """Of the mean over packings; infinite where there is one packing only."""
    if len(features) < 2:
        return np.full(features.shape[1], np.inf)
    return (features.std(axis=0, ddof=1) / features.mean(axis=0)) ** 2 / len(features)


@dataclass(frozen=True, eq=False)
class Coarse:
    """The same tests on beds of fewer spheres than the `large` ones that are fitted."""

    campaign: AbstractCampaign
    spheres: int
    large: int

    @property
    def cost(self) -> float:
        """Of a run over a run of large beds: time steps go with the diameter, so with N^(4/3)."""
        return (self.spheres / self.large) ** (4 / 3)

    def features(
        self, problem: Problem, soil: SoilParameters, seeds: Sequence[int], what: str
    ) -> np.ndarray:
        """Features (n, m) of one soil on these packings."""
        return problem.simulated(self.campaign.runs([soil], seeds, what)[0])


def pooled(large: np.ndarray, small: np.ndarray, coarse: Coarse) -> tuple[np.ndarray, int]:
    """Covariance (m, m) of one large packing's features over their mean, and its degrees of
    freedom.

    From features (n, m) of finished runs on large packings and on small ones, whose relative
    deviations are scaled by (N_small / N_large)^(1/2); each size has deviations from its own mean.
    """
    scale = np.sqrt(coarse.spheres / coarse.large)
    groups = [_deviations(large), scale * _deviations(small)]
    rows = np.concatenate([group for group in groups if len(group) > 1])
    freedom = sum(len(group) - 1 for group in groups)
    return shrunk_covariance(rows) * (len(rows) - 1) / freedom, freedom


def _deviations(features: np.ndarray) -> np.ndarray:
    return features / features.mean(axis=0) - 1


def corrected(problem: Problem, correction: Correction) -> Problem:
    """The problem as small beds have to meet it."""
    return replace(
        problem,
        measured=problem.measured / correction.ratio,
        target_variance=problem.target_variance / correction.ratio**2,
    )


def disagreement(problem: Problem, first: Correction, last: Correction) -> list[str]:
    """Names of targets whose ratio changed between two points beyond its errors, with numbers."""
    found = []
    for k, feature in enumerate(problem.features):
        error = float(np.hypot(first.relative_se[k], last.relative_se[k]))
        change = float(np.log(last.ratio[k] / first.ratio[k]))
        if feature.is_target and np.isfinite(error) and abs(change) > CERTAIN * error:
            found.append(f"{feature.name} {first.ratio[k]:.2f} and {last.ratio[k]:.2f}")
    return found
