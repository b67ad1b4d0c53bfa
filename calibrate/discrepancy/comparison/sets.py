"""A set of explanations that holds the right one with a stated probability.

Split conformal prediction (Vovk et al. 2005; least ambiguous sets, Sadinle et al. 2019): on n
cases with a known truth, q is the k-th smallest of 1 - P(truth), and the set is every
explanation with 1 - P <= q.  k = ceil((n + 1) c) gives coverage c on average over such samples;
with `confidence`, k is raised until this very sample gives at least c that often (its
coverage is Beta(k, n + 1 - k) distributed).  Valid for cases like these.
"""

from collections.abc import Mapping

import numpy as np
from scipy import stats

COVERAGE = 0.9


def threshold(
    truth_probability: np.ndarray, coverage: float = COVERAGE, confidence: float | None = None
) -> float:
    """Smallest probability (0 if cases are too few) that an explanation of the set may have.

    truth_probability (n,): what was said of the truth of each case.
    """
    scores = np.sort(1 - truth_probability)
    n = len(scores)
    k = int(np.ceil((n + 1) * coverage))
    while confidence and k <= n and stats.beta.sf(coverage, k, n + 1 - k) < confidence:
        k += 1
    return float(1 - scores[k - 1]) if k <= n else 0.0


def explanations(probability: Mapping[str, float], smallest: float) -> list[str]:
    """Explanations of at least that probability, likeliest first; never empty."""
    ordered = sorted(probability, key=lambda name: -probability[name])
    return [n for i, n in enumerate(ordered) if i == 0 or probability[n] >= smallest - 1e-12]
