"""Learns how probabilities are stated, from evidences on sets whose seals have been opened.

    python benchmarks/opinion.py                   half a minute

Reads the verdicts that hold ln evidences (`SETS`, in benchmarks/results): those on the fifth own
set, judged again (in 64 of its 309 with fits of commits before 9f3d01c, as `fits` says there), on
the sixth own set as they were stated, and on LIGGGHTS' fourth, judged again; and what was true;
writes calibrate/diagnosis/opinion.json.

Printed: share right, false alarms where nothing was hidden, calibration error, mean logarithmic
score of evidences as they are, with the opinion learned, and with that which four fifths of the
cases gave for the other fifth; from the last follows the size of sets of explanations.  What an
opinion is made of (its terms, c, the pulls, NAMED_BELOW) was chosen on these sets too, so the last
are no blind numbers.  Signal-to-noise is that of `retold.py`, for own cases.
"""

import json
import tarfile
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import reporting

from calibrate.core.files import write_text
from calibrate.discrepancy.comparison.classes import TOGETHER, Classes
from calibrate.discrepancy.comparison.compare import label, named, stated
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.probability_calibration import (
    LEARNED,
    NONE,
    UNKNOWN,
    Facts,
    Opinion,
    fitted,
    hypotheses,
)
from calibrate.discrepancy.comparison.sets import threshold
from calibrate.validation.scores import expected_error, truth_of

SETS = {  # archive of verdicts: what was true
    "withheld_fifth_again_verdicts.tar.xz": "withheld_fifth.json",
    "withheld_sixth_verdicts.tar.xz": "withheld_sixth.json",
    "withheld_liggghts_fourth_learned_verdicts.tar.xz": "withheld_liggghts_fourth_learned.json",
}
RETOLD = "retold.json"
LEAST = 0.01  # probability below which a logarithmic score falls no further
TARGET = Path(__file__).parents[1] / "calibrate" / "diagnosis" / LEARNED
FOLDS = 5
EDGES, STRATA = (2.0, 6.0), ("single below 2", "single 2 to 6", "single above 6")


@dataclass(frozen=True, eq=False)
class Known:
    """A case whose seal is open: facts, classes of alike effects, the class that is right, and its
    kind or, of a single effect, its signal-to-noise."""

    facts: Facts
    classes: Classes
    truth: str
    stratum: str

    @property
    def right(self) -> np.ndarray:
        """Mask over the hypotheses."""
        return np.array([label(self.classes, h) == self.truth for h in hypotheses(self.facts)])

    def said(self, opinion: Opinion) -> dict[str, float]:
        """Probabilities by class."""
        return stated(self.facts, self.classes, opinion)[1]


def verdicts(archive: str) -> list[dict]:
    """Those of an archive that hold evidences, in the order of the cases' names."""
    with tarfile.open(reporting.RESULTS / archive) as opened:
        files = sorted((m for m in opened.getmembers() if m.isfile()), key=lambda m: m.name)
        every = [json.load(opened.extractfile(m)) for m in files]  # pyright: ignore
    return [verdict for verdict in every if "ln_evidence" in verdict]


def truths(scored: str) -> dict[str, tuple[dict, list[dict]]]:
    """Of each case its row of the scores, with its signal-to-noise as told today, and what was
    hidden."""
    found = json.loads((reporting.RESULTS / scored).read_text())
    retold = json.loads((reporting.RESULTS / RETOLD).read_text())["snr"].get(scored, {})
    return {
        row["case"]: (
            {**row, "snr": retold.get(row["case"], row["snr"])}, found["hidden"][row["case"]]
        )
        for row in found["rows"]
    }  # fmt: skip


def cases() -> list[Known]:
    """All of the sets whose diagnosis did not fail."""
    return [one for archive in SETS for one in cases_of(archive)]


def cases_of(archive: str) -> list[Known]:
    true = truths(SETS[archive])
    return [known(verdict, *true[verdict["case"]]) for verdict in verdicts(archive)]


def known(verdict: dict, row: dict, hidden: list[dict]) -> Known:
    """A verdict's evidences beside what was hidden."""
    found: dict[str, float] = verdict["ln_evidence"]
    names = tuple(n for n in found if n not in (NONE, UNKNOWN) and TOGETHER not in n)
    pairs = [n.split(TOGETHER) for n in found if TOGETHER in n]
    index = np.array([[names.index(one) for one in pair] for pair in pairs])
    singles = np.array([found[n] for n in names])
    together = np.array([found[TOGETHER.join(pair)] for pair in pairs])
    evidence = Evidence(singles, together, index, found[UNKNOWN])
    facts = Facts(names, evidence, verdict["p_before"], verdict["p_after"])
    members = verdict["classes"]
    classes = Classes(names, tuple(tuple(group) for group in members), ())
    truth = truth_of({"kind": row["kind"], "hidden": hidden}, members)
    single = np.searchsorted(EDGES, row["snr"], side="right")
    stratum = STRATA[single] if row["kind"] == "single" else row["kind"]
    return Known(facts, classes, truth, stratum)


def learn(some: list[Known]) -> Opinion:
    return fitted([case.facts for case in some], [case.right for case in some])


def quality(some: list[Known], by: list[Opinion]) -> dict:
    """Shares, calibration error of the verdict, mean logarithmic score; `by_stratum`: how many are
    right of how many."""
    said = [case.said(opinion) for case, opinion in zip(some, by, strict=True)]
    best = [named(p) for p in said]
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


def by_other_folds(some: list[Known]) -> list[Opinion]:
    """For each case the opinion that the other folds' cases gave."""
    fold = np.random.default_rng(0).permutation(len(some)) % FOLDS
    of = [learn([some[i] for i in np.flatnonzero(fold != k)]) for k in range(FOLDS)]
    return [of[k] for k in fold]


def main() -> None:
    some = cases()
    found, others = learn(some), by_other_folds(some)
    of_truth = [case.said(o).get(case.truth, 0.0) for case, o in zip(some, others, strict=True)]
    found = replace(found, smallest=threshold(np.array(of_truth)))
    count = len(some)
    content = {
        "opinion": asdict(found),
        "cases": count,
        "evidences as they are": quality(some, [Opinion()] * count),
        "learned": quality(some, [found] * count),
        "learned from the other folds": quality(some, others),
        "command": reporting.provenance()["command"],
    }
    write_text(TARGET, json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
