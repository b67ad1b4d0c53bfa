"""Learns how probabilities are stated, from evidences on sets whose seals have been opened.

    python benchmarks/opinion.py                                         half a minute
    python benchmarks/opinion.py --add "own, seventh" withheld_own       first, of a newer set

Reads the evidences in tests/data/opinion (`support.evidences` says of which sets) and writes the
opinion that ships with the package.  --add appends those of a set that has been judged and opened,
from its archive of verdicts and its scores in benchmarks/results, to that table and learns from
all.

Printed: share right, false alarms where nothing was hidden, calibration error, mean logarithmic
score of evidences as they are, with the opinion learned, and with that which four fifths of the
cases gave for the other fifth; from the last follows the size of sets of explanations.  What an
opinion is made of (its terms, c, the pulls, NAMED_BELOW) was chosen on these sets too, so the last
are no blind numbers.
"""

import argparse
import json
import lzma
import sys
import tarfile
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import reporting

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support import evidences

from calibrate.core.files import write_text
from calibrate.discrepancy.comparison.probability_calibration import LEARNED, Opinion
from calibrate.discrepancy.comparison.sets import threshold

TARGET = Path(__file__).parents[1] / "calibrate" / "discrepancy" / "comparison" / LEARNED
DIGITS = 4  # of ln evidences in the table


def verdicts(which: str) -> list[dict]:
    """Those of a set that hold evidences, in the order of the cases' names."""
    with tarfile.open(reporting.RESULTS / f"{which}_verdicts.tar.xz") as opened:
        files = sorted((m for m in opened.getmembers() if m.isfile()), key=lambda m: m.name)
        every = [json.load(opened.extractfile(m)) for m in files]  # pyright: ignore
    return [verdict for verdict in every if "ln_evidence" in verdict]


def truths(which: str) -> dict[str, tuple[dict, list[dict]]]:
    """Of each case its row of the set's scores, and what was hidden."""
    found = json.loads((reporting.RESULTS / f"{which}.json").read_text())
    return {row["case"]: (row, found["hidden"][row["case"]]) for row in found["rows"]}


def rows_of(name: str, which: str) -> Iterable[dict]:
    """Lines of the table, of a set whose diagnosis did not fail."""
    true = truths(which)
    for verdict in verdicts(which):
        row, hidden = true[verdict["case"]]
        kept = {key: verdict[key] for key in ("p_before", "p_after", "classes")}
        rounded = {key: round(x, DIGITS) for key, x in verdict["ln_evidence"].items()}
        yield {
            "set": name, "case": row["case"], "kind": row["kind"], "snr": row["snr"],
            "hidden": [one["name"] for one in hidden], **kept, "ln_evidence": rounded,
        }  # fmt: skip


def add(name: str, which: str) -> None:
    """Appends a set to the table, in the place of one with the same name."""
    every = [row for row in evidences.rows() if row["set"] != name] + list(rows_of(name, which))
    text = "".join(json.dumps(row, separators=(",", ":")) + "\n" for row in every)
    evidences.TABLE.write_bytes(lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--add", nargs=2, metavar=("NAME", "RESULT"), help="a set, and its files")
    given = parser.parse_args()
    if given.add:
        add(*given.add)
    some = evidences.cases()
    found, others = evidences.learn(some), evidences.by_other_folds(some)
    of_truth = [case.said(o).get(case.truth, 0.0) for case, o in zip(some, others, strict=True)]
    found = replace(found, smallest=threshold(np.array(of_truth)))
    count = len(some)
    content = {
        "opinion": asdict(found),
        "cases": count,
        "evidences as they are": evidences.quality(some, [Opinion()] * count),
        "learned": evidences.quality(some, [found] * count),
        "learned from the other folds": evidences.quality(some, others),
        "command": reporting.provenance()["command"],
    }
    write_text(TARGET, json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


if __name__ == "__main__":
    main()
