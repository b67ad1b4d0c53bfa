"""Learns how probabilities are stated, from evidences on cases whose truth is known.

    python benchmarks/opinion.py        half a minute

Reads the evidences in tests/data/opinion (`support.evidences` says of which cases) and writes the
probability calibration that ships with the package.  `open_cases.py --learn` makes that table.

Printed: share right, false alarms where nothing was hidden, calibration error, mean logarithmic
score of evidences as they are, with the calibration fitted, and with that which four fifths of the
cases gave for the other fifth; from the last follows the size of sets of explanations.  What a
calibration is made of (its terms, c, the pulls, NAMED_BELOW) was chosen on such cases too, so the
last are no blind numbers.
"""

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import reporting

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support import evidences

from calibrate.core.files import write_text
from calibrate.discrepancy.comparison.probability_calibration import (
    BUNDLED,
    ProbabilityCalibration,
    threshold,
)

TARGET = Path(__file__).parents[1] / "calibrate" / "discrepancy" / "comparison" / BUNDLED


def main() -> None:
    reporting.no_options(__doc__)
    some = evidences.cases()
    found, others = evidences.learn(some), evidences.by_other_folds(some)
    of_truth = [case.said(o).get(case.truth, 0.0) for case, o in zip(some, others, strict=True)]
    found = replace(found, smallest=threshold(np.array(of_truth)))
    count = len(some)
    content = {
        "calibration": asdict(found),
        "before": evidences.taught_before(),
        "cases": count,
        "evidences as they are": evidences.quality(some, [ProbabilityCalibration()] * count),
        "learned": evidences.quality(some, [found] * count),
        "learned from the other folds": evidences.quality(some, others),
        "command": reporting.provenance()["command"],
    }
    write_text(TARGET, json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
