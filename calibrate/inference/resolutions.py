"""Two resolutions of one specimen: explored with small beds, decided on large ones.

    y_large(p) = rho y_small(p),   rho = y_large / y_small feature by feature at one point
    slopes:  dy_large/d ln p = rho dy_small/d ln p

Values come from where they are right, slopes from where they are cheapest for their noise
(multiplicative space mapping; Bandler et al. 2004, IEEE Trans. Microwave Theory Tech. 52, 337).
Small beds are fitted first, to what was measured divided by rho; the large beds then take few
steps, and rho is measured anew at each point where slopes are.  Scatter of packings comes from
both: a specimen's relative scatter goes with N^-1/2, as that of a mean over independent parts.
"""

import abc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from calibrate.inference.parameters import Space
from calibrate.inference.problem import Problem, finished_features, shrunk_covariance
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.specimens import Seeds
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


class AbstractCoarse(abc.ABC):
    """What a fit explores with and takes its slopes from, before the beds that decide: their tests
    at less cost, right but for a ratio of the features."""

    campaign: AbstractCampaign
    spheres: int  # of one bed
    near: ClassVar[bool] = False  # so near to the large beds that it explores as it is

    @property
    @abc.abstractmethod
    def cost(self) -> float:
        """Of a run over a run of the beds that decide."""

    @property
    @abc.abstractmethod
    def described(self) -> str:
        """In words: what explores."""

    @abc.abstractmethod
    def disagreeing(self, changed: Sequence[str]) -> str:
        """One sentence, where ratios of these features (with numbers) at the start and at the end
        differ beyond their errors."""

    def features(
        self, problem: Problem, soil: SoilParameters, seeds: Sequence[int], what: str
    ) -> np.ndarray:
        """Features (n, m) of one soil on these packings."""
        return problem.simulated(self.campaign.runs([soil], seeds, what)[0])

    @abc.abstractmethod
    def slopes(self, problem: Problem, space: Space, values: np.ndarray) -> np.ndarray | None:
        """Slopes (m, p) of the mean features per unit of ln p at parameters (p,); None: they have
        to be measured, by pairs of runs."""

    def heard(self, problem: Problem, soil: SoilParameters) -> Problem:
        """The problem in which only features have a say that it knows."""
        return problem

    @property
    def solver(self) -> Callable[..., Any] | None:
        """Of a fit on it; None: a descent by evaluations."""
        return None

    @abc.abstractmethod
    def scatter(
        self, problem: Problem, soil: SoilParameters, seeds: Seeds, large: AbstractCampaign
    ) -> tuple[np.ndarray, int]:
        """Covariance (m, m) of one large packing's features over their mean, and from how many
        packings."""


@dataclass(frozen=True, eq=False)
class Coarse(AbstractCoarse):
    """The same tests on beds of fewer spheres than the `large` ones that are fitted."""

    campaign: AbstractCampaign
    spheres: int
    large: int

    @property
    def cost(self) -> float:
        """Time steps go with the diameter, so with N^(4/3) of all spheres."""
        return (self.spheres / self.large) ** (4 / 3)

    @property
    def described(self) -> str:
        return f"{self.spheres} spheres"

    def disagreeing(self, changed: Sequence[str]) -> str:
        return (
            f"beds of {self.spheres} and {self.large} spheres disagree beyond their errors: "
            f"their ratio is {'; '.join(changed)} at the start and at the end: slopes of the "
            "smaller ones may mislead; fit again from here (--set), or with --preset fine"
        )

    def slopes(self, problem: Problem, space: Space, values: np.ndarray) -> None:
        return None

    def scatter(
        self, problem: Problem, soil: SoilParameters, seeds: Seeds, large: AbstractCampaign
    ) -> tuple[np.ndarray, int]:
        """Of few large packings, those that the fit needs in any case, and more small ones."""
        what = "scatter of packings"
        few = finished_features(problem, large.runs([soil], seeds.fitted, what)[0])
        many = finished_features(problem, self.campaign.runs([soil], seeds.scatter, what)[0])
        covariance, freedom = pooled(few, many, self)
        return covariance, freedom + 1


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
