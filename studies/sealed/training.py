"""How probabilities are stated is learned from evidences on cases whose truth is known.

    python -m studies.sealed.training        half a minute

Writes the probability calibration that ships with the package.  evidences.jsonl.xz has one case a
line: the ln evidences of the explanations, rounded to 1e-4, what was hidden, and its
signal-to-noise.  They are those of open cases of 1100 spheres and of the sealed set of other
specimens, opened (`python -m studies.open_cases --learn`).  Numbers are pulled towards what sealed
sets of 120 to 200 spheres had taught before, which stands beside what is learned (`before`).

What is fitted: t, the a, d, g and the class biases of
`calibrate.discrepancy.comparison.probability_calibration`, by the logarithmic score, pulled towards
a prior.  A set of explanations holds the right one with a stated probability by split conformal
prediction (Vovk et al. 2005; least ambiguous sets, Sadinle et al. 2019): on n cases with a known
truth, q is the k-th smallest of 1 - P(truth), and the set is every explanation with 1 - P <= q.
k = ceil((n + 1) c) gives coverage c on average over such samples; with `confidence`, k is raised
until this very sample gives at least c that often (its coverage is Beta(k, n + 1 - k) distributed).
Valid for cases like these.

Printed: share right, false alarms where nothing was hidden, calibration error, mean logarithmic
score of evidences as they are, with the calibration fitted, and with that which four fifths of the
cases gave for the other fifth; from the last follows the size of sets of explanations.  What a
calibration is made of (its terms, c, the pulls, NAMED_BELOW) was chosen on such cases too, so the
last are no blind numbers.
"""

import json
import lzma
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy import stats
from scipy.optimize import minimize
from scipy.special import logsumexp

from calibrate.core.files import whole, write_text
from calibrate.discrepancy.comparison import probability_calibration
from calibrate.discrepancy.comparison.classes import TOGETHER, Classes
from calibrate.discrepancy.comparison.compare import label, likeliest_verdict, probabilities
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.probability_calibration import (
    BUNDLED,
    NONE,
    UNKNOWN,
    EvidenceSummary,
    ProbabilityCalibration,
    hypotheses,
    score_table,
)
from studies import reporting
from studies.sealed.scores import expected_error, truth_of

TABLE = Path(__file__).with_name("evidences.jsonl.xz")
TARGET = Path(probability_calibration.__file__).with_name(BUNDLED)
LEAST = 0.01  # probability below which a logarithmic score falls no further
FOLDS = 5
EDGES, STRATA = (2.0, 6.0), ("single below 2", "single 2 to 6", "single above 6")
ODD = 1e-4  # share of cases that nothing stated foresees, so that none of them decides alone
PULL_SD = (0.5, 1.5, 1.5, 1.5, 1.0, 1.0)  # of t, the a, d, g about those of the prior
CLASS_BIAS_SD = 1.2
SHARPEST, DULLEST = 2.0, 0.05  # t
COVERAGE = 0.9  # of a set of explanations
ABSENT = -1e9  # ln of the probability of what is no explanation of a case
OUTSIDE, UNSEEN = "outside", "outside below 2"  # effects that the library lacks


@dataclass(frozen=True, eq=False)
class Known:
    """A case whose seal is open: facts, classes of alike effects, the class that is right, and its
    kind or, of a single effect, its signal-to-noise."""

    summary: EvidenceSummary
    classes: Classes
    truth: str
    stratum: str

    @property
    def right(self) -> np.ndarray:
        """Mask over the hypotheses."""
        return np.array([label(self.classes, h) == self.truth for h in hypotheses(self.summary)])

    def said(self, calibration: ProbabilityCalibration) -> dict[str, float]:
        """Probabilities by class."""
        return probabilities(self.summary, self.classes, calibration)[1]


def rows() -> list[dict]:
    """The lines of the table."""
    with lzma.open(TABLE, "rt", encoding="utf-8") as lines:
        return [json.loads(line) for line in lines]


def keep(some: list[dict]) -> None:
    """Writes the table."""
    text = "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in some)
    with whole(TABLE) as part:
        part.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))


def cases() -> list[Known]:
    """All of the table."""
    return [known(row) for row in rows()]


def known(row: dict) -> Known:
    """One line's evidences beside what was hidden."""
    found: dict[str, float] = row["ln_evidence"]
    names = tuple(n for n in found if n not in (NONE, UNKNOWN) and TOGETHER not in n)
    pairs = [n.split(TOGETHER) for n in found if TOGETHER in n]
    index = np.array([[names.index(one) for one in pair] for pair in pairs])
    singles = np.array([found[n] for n in names])
    together = np.array([found[TOGETHER.join(pair)] for pair in pairs])
    evidence = Evidence(singles, together, index, found[UNKNOWN])
    summary = EvidenceSummary(names, evidence, row["p_before"], row["p_after"])
    members = row["classes"]
    classes = Classes(names, tuple(tuple(group) for group in members), ())
    hidden = [{"name": name} for name in row["hidden"]]
    truth = truth_of({"kind": row["kind"], "hidden": hidden}, members)
    single = np.searchsorted(EDGES, row["snr"], side="right")
    stratum = STRATA[single] if row["kind"] == "single" else row["kind"]
    if stratum == OUTSIDE and row["snr"] < EDGES[0]:
        stratum = UNSEEN
    return Known(summary, classes, truth, stratum)


def taught_before() -> dict:
    """What coarse beds taught: a calibration, from how many cases, and where these are."""
    return json.loads(TARGET.read_text(encoding="utf-8"))["before"]


def learn(some: list[Known]) -> ProbabilityCalibration:
    """From these cases, and from what coarse beds taught before.  An effect that the library lacks
    and that leaves nothing to see teaches nothing: there "none" is as right as "unknown"."""
    before = ProbabilityCalibration(**taught_before()["calibration"])
    seen = [case for case in some if case.stratum != UNSEEN]
    return fit_calibration([case.summary for case in seen], [case.right for case in seen], before)


def fit_calibration(
    cases: Sequence[EvidenceSummary], truths: Sequence[np.ndarray],
    prior: ProbabilityCalibration | None = None,
) -> ProbabilityCalibration:  # fmt: skip
    """The probability calibration with the best logarithmic score on cases.

    truths: for each case a mask over its `hypotheses`: those that would be right; prior: towards
    which numbers are pulled (None: evidences as they are).
    """
    names = tuple(dict.fromkeys(name for summary in cases for name in summary.names))
    columns, share, right = _stacked([score_table(summary, names) for summary in cases], truths)
    before = (prior or ProbabilityCalibration()).numbers(names)
    pull = np.array([*PULL_SD, *[CLASS_BIAS_SD] * len(names)])

    def loss(numbers: np.ndarray) -> tuple[float, np.ndarray]:
        score = columns @ numbers + share
        p = np.exp(score - logsumexp(score, axis=1, keepdims=True))
        of_truth = (p * right).sum(axis=1)
        foreseen = ODD + (1 - ODD) * of_truth
        slope = ((1 - ODD) / foreseen)[:, None] * p * (right - of_truth[:, None])
        away = (numbers - before) / pull
        value = 0.5 * away @ away - np.log(foreseen).sum()
        return float(value), away / pull - np.einsum("nh,nhj->j", slope, columns)

    free, positive = (None, None), (0.0, None)
    bounds = [(DULLEST, SHARPEST), *[free] * 3, *[positive] * 2, *[free] * len(names)]
    found = minimize(loss, before, jac=True, method="L-BFGS-B", bounds=bounds).x.tolist()
    return ProbabilityCalibration(*found[:6], class_bias=dict(zip(names, found[6:], strict=True)))


def _stacked(
    tables: Sequence[tuple[np.ndarray, np.ndarray]], truths: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (n, h, j), shares (n, h) and truths (n, h) of cases, as long as the longest."""
    most = max(len(share) for _, share in tables)
    columns = np.zeros((len(tables), most, tables[0][0].shape[1]))
    shares, right = np.full((len(tables), most), ABSENT), np.zeros((len(tables), most))
    for i, ((rows, share), truth) in enumerate(zip(tables, truths, strict=True)):
        columns[i, : len(share)], shares[i, : len(share)] = rows, share
        right[i, : len(share)] = truth
    return columns, shares, right


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


def quality(some: list[Known], by: list[ProbabilityCalibration]) -> dict:
    """Shares, calibration error of the verdict, mean logarithmic score; `by_stratum`: how many are
    right of how many."""
    said = [case.said(calibration) for case, calibration in zip(some, by, strict=True)]
    best = [likeliest_verdict(p) for p in said]
    sure = np.array([p[name] for p, name in zip(said, best, strict=True)])
    right = np.array([name == case.truth for name, case in zip(best, some, strict=True)], float)
    score = [np.log(max(p.get(c.truth, 0.0), LEAST)) for p, c in zip(said, some, strict=True)]
    alarms = [name != NONE for name, case in zip(best, some, strict=True) if case.truth == NONE]
    return {
        "right": float(right.mean()),
        "false_alarm": float(np.mean(alarms)),
        "wrong_and_sure": float(((sure >= 0.8) & (right == 0)).mean()),
        "calibration_error": expected_error(sure, right),
        "log_score": float(np.mean(score)),
        "by_stratum": {
            name: [int(right[[c.stratum == name for c in some]].sum()), count]
            for name, count in sorted(Counter(case.stratum for case in some).items())
        },
    }


def by_other_folds(some: list[Known]) -> list[ProbabilityCalibration]:
    """For each case the calibration that the other folds' cases gave."""
    fold = np.random.default_rng(0).permutation(len(some)) % FOLDS
    of = [learn([some[i] for i in np.flatnonzero(fold != k)]) for k in range(FOLDS)]
    return [of[k] for k in fold]


def main() -> None:
    reporting.no_options(__doc__)
    some = cases()
    found, others = learn(some), by_other_folds(some)
    of_truth = [case.said(o).get(case.truth, 0.0) for case, o in zip(some, others, strict=True)]
    found = replace(found, smallest=threshold(np.array(of_truth)))
    content = {
        "calibration": asdict(found),
        "before": taught_before(),
        "cases": len(some),
        "evidences as they are": quality(some, [ProbabilityCalibration()] * len(some)),
        "learned": quality(some, [found] * len(some)),
        "learned from the other folds": quality(some, others),
        "command": reporting.provenance()["command"],
    }
    write_text(TARGET, json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
