"""Evidences on cases whose truth is known, and the probability calibration that they give.

`tests/data/opinion/evidences.jsonl.xz` has one case a line: the ln evidences of the explanations,
rounded to 1e-4, what was hidden, and its signal-to-noise.  They are those of open cases of 1100
spheres and of the sealed set of other specimens, opened (`benchmarks/open_cases.py --learn`).
Numbers are pulled towards what sealed sets of 120 to 200 spheres had taught before, which stands
beside what is learned (`before`).
"""

import json
import lzma
from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from calibrate.discrepancy.comparison.classes import TOGETHER, Classes
from calibrate.discrepancy.comparison.compare import label, likeliest_verdict, probabilities
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.probability_calibration import (
    BUNDLED,
    NONE,
    UNKNOWN,
    EvidenceSummary,
    ProbabilityCalibration,
    fit_calibration,
    hypotheses,
)
from calibrate.validation.scores import expected_error, truth_of

TABLE = Path(__file__).parents[1] / "data" / "opinion" / "evidences.jsonl.xz"
LEAST = 0.01  # probability below which a logarithmic score falls no further
FOLDS = 5
EDGES, STRATA = (2.0, 6.0), ("single below 2", "single 2 to 6", "single above 6")
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
    TABLE.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))


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
    folder = resources.files("calibrate.discrepancy.comparison")
    return json.loads((folder / BUNDLED).read_text(encoding="utf-8"))["before"]


def learn(some: list[Known]) -> ProbabilityCalibration:
    """From these cases, and from what coarse beds taught before.  An effect that the library lacks
    and that leaves nothing to see teaches nothing: there "none" is as right as "unknown"."""
    before = ProbabilityCalibration(**taught_before()["calibration"])
    seen = [case for case in some if case.stratum != UNSEEN]
    return fit_calibration([case.summary for case in seen], [case.right for case in seen], before)


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
