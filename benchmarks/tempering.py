"""Learns how stated probabilities are tempered, from verdicts on a set whose seal has been opened.

    python benchmarks/tempering.py                 a few seconds

Reads the fourth own set's verdicts (benchmarks/results/withheld_fourth_verdicts.tar.xz, as they
were stated before its seal was opened) and what was true (withheld_fourth.json); writes
calibrate/diagnosis/tempering.json.  Of verdicts that were tempered, what was stated before counts.

Printed: share right, false alarms where nothing was hidden, calibration error, mean logarithmic
score as stated, tempered, and tempered by what four fifths of the cases gave for the other fifth.
"""

import json
import tarfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import reporting

from calibrate.diagnosis.opinion import NONE
from calibrate.diagnosis.tempering import LEARNED, ODD, Tempering, fitted_tempering
from calibrate.output import write_text
from calibrate.withheld.scores import expected_error

RESULTS = Path(__file__).parent / "results"
VERDICTS, TRUTHS = RESULTS / "withheld_fourth_verdicts.tar.xz", RESULTS / "withheld_fourth.json"
TARGET = Path(__file__).parents[1] / "calibrate" / "diagnosis" / LEARNED
FOLDS = 5


def cases() -> tuple[list[dict], list[str]]:
    """What was stated by class, and the right class, of each case."""
    truth = {row["case"]: row["truth"] for row in json.loads(TRUTHS.read_text())["rows"]}
    with tarfile.open(VERDICTS) as archive:
        files = [m for m in archive.getmembers() if m.name.endswith(".json")]
        said = [json.load(archive.extractfile(m)) for m in files]  # pyright: ignore
    said = [verdict for verdict in said if "by_class" in verdict]
    stated = [v.get("before_tempering", v["by_class"]) for v in said]
    return stated, [truth[v["case"]] for v in said]


def quality(stated: list[dict], truths: list[str], by: list[Tempering]) -> dict:
    """Calibration error of the likeliest class and mean logarithmic score."""
    bent = [b.of(s) for s, b in zip(stated, by, strict=True)]
    best = [max(p, key=lambda name: p[name]) for p in bent]
    sure = np.array([p[name] for p, name in zip(bent, best, strict=True)])
    right = np.array([name == truth for name, truth in zip(best, truths, strict=True)], float)
    score = np.mean([np.log(max(p.get(t, 0.0), ODD)) for p, t in zip(bent, truths, strict=True)])
    alarms = [n != NONE for n, truth in zip(best, truths, strict=True) if truth == NONE]
    return {
        "right": float(right.mean()),
        "false_alarm": float(np.mean(alarms)),
        "calibration_error": expected_error(sure, right),
        "log_score": float(score),
    }


def left_out(stated: list[dict], truths: list[str]) -> list[Tempering]:
    """For each case the tempering that the other folds' cases gave."""
    fold = np.random.default_rng(0).permutation(len(truths)) % FOLDS
    of = []
    for k in range(FOLDS):
        kept = np.flatnonzero(fold != k)
        of.append(fitted_tempering([stated[i] for i in kept], [truths[i] for i in kept]))
    return [of[k] for k in fold]


def main() -> None:
    stated, truths = cases()
    found = fitted_tempering(stated, truths)
    count = len(truths)
    content = {
        "tempering": asdict(found),
        "cases": count,
        "as stated": quality(stated, truths, [Tempering()] * count),
        "tempered": quality(stated, truths, [found] * count),
        "tempered by the other folds": quality(stated, truths, left_out(stated, truths)),
        "command": reporting.provenance()["command"],
    }
    write_text(TARGET, json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
