"""From evidences to probabilities over no gap, each effect, each pair, and unknown.

    none     - t s(b)                                     b = max ln B - ln B
    effect   - t s(b) + a1 + h(effect) - ln k             s(b) = c arsinh(b/c)
    pair     - t s(b) + a2 + h(one) + h(other) - ln q
    unknown  - t s(b) + a3 + d [p < ALPHA] + g ln(1 + <max ln B>)

Probabilities are their softmax.  p is the p-value of what the best effect and the best pair leave,
B the evidence of an explanation over that of none (`evidence`); g: a large gap is oftener one
outside the library of effects.  Evidence rests on simulations that are wrong in unknown ways: t is
the temperature, s damps differences of more than c, the a are prior odds, the class biases h say
which effects the evidence favours too much or too little (Guo et al. 2017, On Calibration of Modern
Neural Networks).  All are fitted to withheld cases whose seal has been opened
(`studies.sealed.training`); so probabilities have the prior of these cases.

A set of explanations is every one of at least the probability `smallest`.  By split conformal
prediction (Vovk et al. 2005; least ambiguous sets, Sadinle et al. 2019) that study chooses it so
that on cases like these nine of ten sets hold the right explanation.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources

import numpy as np
from scipy.special import logsumexp

from calibrate.discrepancy.comparison.evidence import Evidence

NONE, UNKNOWN = "none", "unknown"
ALPHA = 0.05  # of a test for a gap
BUNDLED = "probability_calibration.json"  # beside this file
MUCH = 3.0  # c: difference of ln evidences, beyond which more of it counts less
NAMED_BELOW = 0.25  # probability of no gap: alarms in 6 % of open nulls, by the other folds
HOPELESS = -1e6  # ln evidence of what could not be fitted


@dataclass(frozen=True)
class ProbabilityCalibration:
    """t, the three a, d, g and the class biases by effect (0 where not listed); `smallest` is the
    least probability of a member of the set of explanations.  Neutral: evidences as they are."""

    sharpness: float = 1.0
    single: float = 0.0
    pair: float = -1.5
    unknown: float = -1.0
    left_over: float = 0.0
    large: float = 0.0
    class_bias: Mapping[str, float] = field(default_factory=dict)
    smallest: float = 0.1

    def numbers(self, names: Sequence[str]) -> np.ndarray:
        """t, a1, a2, a3, d, g and the class biases of these effects (6 + k,)."""
        kinds = (self.single, self.pair, self.unknown)
        class_bias = (self.class_bias.get(name, 0.0) for name in names)
        return np.array([self.sharpness, *kinds, self.left_over, self.large, *class_bias])


@dataclass(frozen=True, eq=False)
class EvidenceSummary:
    """What is known of a gap: evidence for the effects `names`, the p-value of the test for any
    gap, and the larger of those of the tests after the best effect and after the best pair."""

    names: tuple[str, ...]
    evidence: Evidence
    p_before: float
    p_after: float


def hypotheses(summary: EvidenceSummary) -> list[tuple[str, ...]]:
    """Explanations in the order of their scores: none, effects, pairs, unknown."""
    pairs = [(summary.names[i], summary.names[j]) for i, j in summary.evidence.pair_index]
    return [(NONE,), *((name,) for name in summary.names), *pairs, (UNKNOWN,)]


def log_probabilities(summary: EvidenceSummary, calibration: ProbabilityCalibration) -> np.ndarray:
    """ln of the probability of each of the `hypotheses`."""
    columns, share = score_table(summary, summary.names)
    score = columns @ calibration.numbers(summary.names) + share
    return score - logsumexp(score)


@cache
def bundled_calibration() -> ProbabilityCalibration:
    """The one that comes with the package."""
    text = (resources.files("calibrate.discrepancy.comparison") / BUNDLED).read_text(
        encoding="utf-8"
    )
    return ProbabilityCalibration(**json.loads(text)["calibration"])


def score_table(summary: EvidenceSummary, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """What each hypothesis' score is linear in, shape (h, 6 + k), and ln of its share (h,) in the
    prior of its kind."""
    found = summary.evidence
    raw = np.concatenate([[0.0], found.singles, found.pairs, [found.unknown]])
    raw = np.where(np.isfinite(raw), raw, HOPELESS)
    count = (len(found.singles), len(found.pairs))
    kind = np.repeat([0, 1, 2, 3], [1, *count, 1])
    kinds = kind[:, None] == np.array([1, 2, 3])
    left = float(summary.p_after < ALPHA)
    outside = (kind == 3)[:, None] * np.array([left, np.log1p(raw.max())])
    inside = np.array([[name in h for name in names] for h in hypotheses(summary)], float)
    behind = MUCH * np.arcsinh((raw.max() - raw) / MUCH)
    columns = np.column_stack([-behind, kinds, outside, inside.reshape(len(raw), -1)])
    share = np.array([1, max(count[0], 1), max(count[1], 1), 1], float)
    return columns, -np.log(share)[kind]


def explanations(probability: Mapping[str, float], smallest: float) -> list[str]:
    """Explanations of at least that probability, likeliest first; never empty."""
    ordered = sorted(probability, key=lambda name: -probability[name])
    return [n for i, n in enumerate(ordered) if i == 0 or probability[n] >= smallest - 1e-12]
