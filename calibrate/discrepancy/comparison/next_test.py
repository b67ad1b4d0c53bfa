"""Which further test would settle what these data leave open?

For two explanations k and l, the signal-to-noise with which the data at hand and a further
test together would tell k from l is

    s_k sqrt(1 - c_kl^2)     s, c of the projected effects of both data sets, stacked

(the linearised T-optimality of Harman and Mueller).  A test scores the smallest of
these over all pairs of leading explanations, both ways.  No gap is an explanation too, with
s alone.  Predicted curves are given for each explanation: what to look for.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.classes import SEPARABLE, separation
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.comparison.projection import project
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.score import confusability, lengths


@dataclass(frozen=True, eq=False)
class FurtherTest:
    """A feasible test: its name, cost (any unit, the same for all), labels of its
    features, simulated mean (m,), slopes of base parameters (m, p) and effects (m, k; per
    typical strength), covariance of one specimen (m, m), and repeats."""

    name: str
    cost: float
    labels: tuple[str, ...]
    mean: np.ndarray
    base_slopes: np.ndarray
    effect_slopes: np.ndarray
    specimen: np.ndarray
    repeats: int


@dataclass(frozen=True, eq=False)
class Proposal:
    """A test's separation of the leading explanations, now and with the test; the pair it
    separates least; and its curve (m,) under each explanation with deviations (m,)."""

    name: str
    cost: float
    now: float
    separation: float
    hardest: tuple[str, str]
    predicted: dict[str, np.ndarray]
    deviation: np.ndarray

    @property
    def settles(self) -> bool:
        """Whether all leading explanations are told apart with 80 % power."""
        return self.separation >= SEPARABLE


def next_tests(
    description: Linearised,
    noise: Noise,
    base: Refit,
    explanations: dict[int, Refit],
    tests: Sequence[FurtherTest],
) -> list[Proposal]:
    """Proposals, best first; explanations: the leading effects with their refits."""
    keys = list(explanations)
    strengths = np.array([explanations[k].strengths[k] for k in keys])
    names = [description.effect_names[k] for k in keys]
    design = (noise.mean, base.base_slopes, base.effect_slopes[:, keys])
    now = _separations(description, *design, keys, strengths)
    proposals = [
        _proposal(description, noise, base, explanations, names, keys, strengths, now, test)
        for test in tests
    ]
    return sorted(proposals, key=lambda p: (-p.separation, p.cost))


def _proposal(
    description, noise, base, explanations, names, keys, strengths, now, test: FurtherTest
) -> Proposal:
    m, q = len(noise.mean), len(test.mean)
    covariance = np.zeros((m + q, m + q))
    covariance[:m, :m] = noise.mean
    covariance[m:, m:] = test.specimen / test.repeats
    slopes = np.vstack([base.base_slopes, test.base_slopes])
    effects = np.vstack([base.effect_slopes, test.effect_slopes])
    apart = _separations(description, covariance, slopes, effects[:, keys], keys, strengths)
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    predicted = {
        name: test.mean
        + test.base_slopes @ explanations[k].delta
        + test.effect_slopes @ explanations[k].strengths
        for name, k in zip(names, keys, strict=True)
    }
    return Proposal(
        name=test.name,
        cost=test.cost,
        now=float(now.min()),
        separation=float(apart.min()),
        hardest=(names[i], names[j] if i != j else "none"),
        predicted=predicted,
        deviation=np.sqrt(np.diag(test.specimen) / test.repeats),
    )


def _separations(description, covariance, base_slopes, effect_slopes, keys, strengths):
    """Signal-to-noise (n, n) of explanation i against j; against none on the diagonal."""
    nothing, prior = np.zeros(len(covariance)), description.prior_sd
    design = project(nothing, base_slopes, prior, effect_slopes, covariance)
    snr = lengths(design.effects) * np.abs(strengths)
    apart = separation(confusability(design.effects), description.one_sided[keys])
    np.fill_diagonal(apart, 1.0)
    return snr[:, None] * apart
