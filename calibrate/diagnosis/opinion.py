"""From evidences to probabilities over no gap, each effect, each pair, and unknown.

    none     g ln p_before + c [p_before > ALPHA]
    effect   a1 - ln k + ln B / T
    pair     a2 - ln q + ln B / T
    unknown  a3 - l ln p_after + d [p_after < ALPHA] + ln B / T       probabilities: softmax

T and the a are how evidences and priors have to be bent so that stated probabilities are
met; g, l, c and d let the two simulated p-values speak, which know of the covariance's own
uncertainty, and how much it means that a gate is passed or not.  All are fitted to generated
cases by their logarithmic score (`fitted`), with a weak pull to the neutral values below:
temperature scaling (Guo et al. 2017) with priors.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from scipy.optimize import minimize

from calibrate.diagnosis.evidence import Evidence

NONE, UNKNOWN = "none", "unknown"
ALPHA = 0.05  # of both gates
PULL_SD = np.array([1.5] * 6 + [5.0, 5.0])  # of an opinion's numbers about their neutral values
LOG_P_FLOOR = -6.0


@dataclass(frozen=True)
class Opinion:
    """The eight numbers: ln T, log prior odds of effect, pair, unknown against none, weights of
    the p-values before and after, and what the two gates add.  Neutral: evidences as they are."""

    log_temperature: float = 0.0
    single: float = 0.0
    pair: float = -1.5
    unknown: float = -1.0
    before: float = 0.0
    after: float = 0.0
    quiet: float = 0.0
    left_over: float = 0.0


@dataclass(frozen=True, eq=False)
class Facts:
    """What probabilities are made of: evidence, the two p-values, the effects' names."""

    names: tuple[str, ...]
    evidence: Evidence
    p_before: float
    p_after: float


def hypotheses(facts: Facts) -> list[tuple[str, ...]]:
    """Explanations in the order of their scores: none, effects, pairs, unknown."""
    pairs = [(facts.names[i], facts.names[j]) for i, j in facts.evidence.pair_index]
    return [(NONE,), *((name,) for name in facts.names), *pairs, (UNKNOWN,)]


def log_probabilities(facts: Facts, opinion: Opinion) -> np.ndarray:
    """ln of the probability of each of the `hypotheses`."""
    raw, offset, before, after = _ingredients(facts)
    score = _score(raw, offset, before, after, np.array(astuple(opinion)))
    return score - np.logaddexp.reduce(score)


def fitted(
    cases: Sequence[Facts], truths: Sequence[np.ndarray], start: Opinion | None = None
) -> Opinion:
    """The opinion with the best logarithmic score on cases.

    truths: for each case a mask over its `hypotheses`: those that would be right.
    """
    neutral = np.array(astuple(start or Opinion()))
    prepared = [_ingredients(facts) for facts in cases]

    def loss(numbers: np.ndarray) -> float:
        total = 0.5 * (((numbers - neutral) / PULL_SD) ** 2).sum()
        for ingredients, truth in zip(prepared, truths, strict=True):
            score = _score(*ingredients, numbers)
            total += np.logaddexp.reduce(score) - np.logaddexp.reduce(score[truth])
        return float(total)

    bounds = [(-1.0, 3.0), *[(-8.0, 8.0)] * 3, *[(0.0, 3.0)] * 2, *[(0.0, 12.0)] * 2]
    found = minimize(loss, neutral, method="L-BFGS-B", bounds=bounds)
    return Opinion(*(float(number) for number in found.x))


def _ingredients(facts: Facts):
    """ln evidences, which prior each has and its share, and the logarithms of p-values."""
    singles, pairs = facts.evidence.singles, facts.evidence.pairs
    raw = np.concatenate([[0.0], singles, pairs, [facts.evidence.unknown]])
    kind = np.repeat([0, 1, 2, 3], [1, len(singles), len(pairs), 1])
    share = np.array([1, max(len(singles), 1), max(len(pairs), 1), 1], float)
    before = max(np.log(facts.p_before), LOG_P_FLOOR)
    after = max(np.log(facts.p_after), LOG_P_FLOOR)
    return raw, (kind, -np.log(share)[kind]), before, after


def _score(raw, offset, before, after, numbers) -> np.ndarray:
    kind, share = offset
    prior = np.array([0.0, *numbers[1:4]])
    score = raw / np.exp(numbers[0]) + prior[kind] + share
    score[0] += numbers[4] * before + numbers[6] * (before > np.log(ALPHA))
    score[-1] += numbers[7] * (after < np.log(ALPHA)) - numbers[5] * after
    return score
