"""Is the signal-to-noise of withheld effects told rightly from four packings?

    mkdir sixth && tar xf benchmarks/results/withheld_sixth_cases.tar.xz -C sixth
    python benchmarks/visibility.py sixth          a quarter of an hour of one core; resumes

Of single effects of soil and walls in an opened set (their labels hold what the effect did on the
case's four packings) those that were scored above a signal-to-noise of 6, and as many others above
2.4, drawn with seed 0, are simulated with and without it on the twelve packings that were held
back, by which no case was chosen.  Told: signal-to-noise as scored; as it is told from the four
today (`retold.py`, to be run before); from the twelve, without the bank's prediction
(`Visibility.realised`); as the bank predicts it.
"""

import argparse
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import reporting

from calibrate.discrepancy import mismatch
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import MEASURING, Ready
from calibrate.validation.laboratory import Laboratory
from calibrate.validation.plan import CENTRE, PACKINGS, SPECIMENS, Case, Hidden, Visibility
from calibrate.validation.seal import open_seal

LARGE, SEEN = 6.0, 2.4
HEADER = [
    "case", "effect", "as scored", "told from four", "twelve others", "predicted", "right class",
]  # fmt: skip
COLUMNS = ("scored", "told", "twelve", "predicted")


def case_of(label: dict) -> Case:
    """The case that a label tells of."""
    kept = {f.name: label[f.name] for f in fields(Case) if f.name in label}
    hidden = tuple(Hidden(**h) for h in label["hidden"])
    packings = tuple(label["packings"])
    return Case(**{**kept, "snr": label["planned_snr"], "hidden": hidden, "packings": packings})


def drawn(scored: dict) -> list[dict]:
    """Rows of the scores that are looked at."""
    rows = [
        row for row in scored["rows"] if row["kind"] == "single" and row["snr"] >= SEEN
        and scored["hidden"][row["case"]][0]["name"] not in MEASURING
    ]  # fmt: skip
    large = [row for row in rows if row["snr"] >= LARGE]
    others = [row for row in rows if row["snr"] < LARGE]
    np.random.default_rng(0).shuffle(others)
    return large + others[: len(large)]


def measured(row: dict, label: dict, laboratory: Laboratory, ready: Ready, known) -> dict:
    """One case's numbers."""
    case = case_of(label)
    twelve = laboratory.changes(case, range(SPECIMENS, PACKINGS))
    visible = Visibility(ready, case.soil, SPECIMENS, known)
    predicted = visible.change({h.name: h.strength for h in case.hidden})
    return {
        "case": row["case"], "effect": case.hidden[0].name, "scored": row["snr"],
        "twelve": visible.realised(twelve), "packings": len(twelve),
        "predicted": visible.left(predicted), "right": row["verdict"] == row["truth"],
    }  # fmt: skip


def markdown(rows: list[dict], which: str, origin: dict) -> str:
    lines = [
        [r["case"], r["effect"].replace("_", " "), *(f"{r[key]:.1f}" for key in COLUMNS),
         "yes" if r["right"] else "no"]
        for r in rows
    ]  # fmt: skip
    means = [
        ", ".join(f"{np.mean([r[key] for r in some]):.1f}" for key in COLUMNS)
        for some in ([r for r in rows if r["scored"] >= LARGE],
                     [r for r in rows if r["scored"] < LARGE])
    ]  # fmt: skip
    text = (
        "# Signal-to-noise from four packings and from twelve others\n\n"
        f"Effects of soil and walls of the {which} own set. Means of the four numbers over cases "
        f"scored above {LARGE:g}: {means[0]}; over others: {means[1]}.\n\n"
    )
    return text + reporting.table(HEADER, lines) + reporting.footer(origin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an opened set, named as in results")
    folder = parser.parse_args().folder
    reporting.configure()
    ready, which = Ready.of(store.load(store.bundled_bank())), f"withheld_{folder.name}"
    known = mismatch.load(reporting.RESULTS / f"{which}_mismatch.json", ready)
    laboratory = Laboratory(folder / "simulated", CENTRE)
    scored = json.loads((reporting.RESULTS / f"{which}.json").read_text())
    told = json.loads((reporting.RESULTS / "retold.json").read_text())["snr"][f"{which}.json"]
    labels, rows = open_seal(folder), []
    for row in drawn(scored):
        found = measured(row, labels[row["case"]], laboratory, ready, known)
        rows.append({**found, "told": told[row["case"]]})
        print(rows[-1], flush=True)
    origin = reporting.provenance()
    reporting.write("visibility", {**origin, "rows": rows}, markdown(rows, folder.name, origin))


if __name__ == "__main__":
    main()
