"""Is the signal-to-noise of withheld effects told rightly from four packings?

    mkdir fourth && tar xf benchmarks/results/withheld_fourth_cases.tar.xz -C fourth
    python benchmarks/visibility.py fourth          a quarter of an hour of one core; resumes

Of single effects of soil and walls with a signal-to-noise of 2.4 to 8 in an opened set (their
labels hold what the effect did on the case's four packings) twelve, drawn with seed 0, are
simulated with and without it on the twelve packings that were held back.  Told: signal-to-noise
from the four (as scored), from the twelve, from all (`Visibility.realised`); the length of the
projected change that the bank predicts, and how much of it the simulated one has along it, with its
standard error over packings.
"""

import argparse
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import reporting

from calibrate.bank import mismatch, store
from calibrate.bank.description import Ready
from calibrate.withheld.laboratory import Laboratory
from calibrate.withheld.plan import CENTRE, PACKINGS, SPECIMENS, Case, Hidden, Visibility
from calibrate.withheld.seal import open_seal

MISMATCH = reporting.RESULTS / "withheld_fourth_mismatch.json"
SCORED = reporting.RESULTS / "withheld_fourth.json"
INSTRUMENTS = ("acquisition_lag", "load_cell_offset", "load_cell_gain", "seating_gap")
RANGE, CASES = (2.4, 8.0), 12
HEADER = ["case", "effect", "SNR, four packings", "twelve others", "all sixteen",
          "length predicted", "simulated along it", "right class", "p of the gate"]  # fmt: skip


def case_of(label: dict) -> Case:
    """The case that a label tells of."""
    kept = {f.name: label[f.name] for f in fields(Case) if f.name in label}
    hidden = tuple(Hidden(**h) for h in label["hidden"])
    packings = tuple(label["packings"])
    return Case(**{**kept, "snr": label["planned_snr"], "hidden": hidden, "packings": packings})


def drawn(scored: dict) -> list[dict]:
    """Rows of the scores that are looked at."""
    rows = [
        row for row in scored["rows"]
        if row["kind"] == "single" and RANGE[0] <= row["snr"] < RANGE[1]
        and scored["hidden"][row["case"]][0]["name"] not in INSTRUMENTS
    ]  # fmt: skip
    np.random.default_rng(0).shuffle(rows)
    return rows[:CASES]


def measured(row: dict, label: dict, laboratory: Laboratory, ready: Ready, known) -> dict:
    """One case's numbers."""
    case, four = case_of(label), np.array(label["changes"])
    twelve = laboratory.changes(case, range(SPECIMENS, PACKINGS))
    visible = Visibility(ready, case.soil, SPECIMENS, known)
    predicted = visible.change({h.name: h.strength for h in case.hidden})
    every = np.vstack([four, twelve])
    direction, *simulated = visible.world.projected(np.vstack([predicted, every]).T).T
    length = float(np.linalg.norm(direction))
    along = np.array(simulated) @ direction / length
    told = [visible.realised(c, predicted) for c in (four, twelve, every)]
    return {
        "case": row["case"], "effect": case.hidden[0].name,
        "four": told[0], "twelve": told[1], "all": told[2], "packings": len(every),
        "predicted": length, "along": float(along.mean()),
        "along_error": float(along.std(ddof=1) / np.sqrt(len(along))),
        "right": row["verdict"] == row["truth"], "p_before": row["p_before"],
    }  # fmt: skip


def markdown(rows: list[dict], origin: dict) -> str:
    ratios = [row["twelve"] / row["four"] for row in rows]
    lines = [
        [r["case"], r["effect"].replace("_", " "), f"{r['four']:.1f}", f"{r['twelve']:.1f}",
         f"{r['all']:.1f}", f"{r['predicted']:.1f}", f"{r['along']:.1f} ± {r['along_error']:.1f}",
         "yes" if r["right"] else "no", f"{r['p_before']:.3f}"]
        for r in rows
    ]  # fmt: skip
    text = (
        "# Signal-to-noise from four packings and from twelve others\n\n"
        f"Fourth own set. Twelve packings tell {np.median(ratios):.2f} times (median; "
        f"{min(ratios):.2f} to {max(ratios):.2f}) what the case's own four told.\n\n"
    )
    return text + reporting.table(HEADER, lines) + reporting.footer(origin)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an opened set: cases/, sealed/, labels.sha256")
    folder = parser.parse_args().folder
    reporting.configure()
    ready = Ready.of(store.load(store.bundled_bank()))
    known = mismatch.load(MISMATCH, ready)
    laboratory = Laboratory(folder / "simulated", CENTRE)
    labels, rows = open_seal(folder), []
    for row in drawn(json.loads(SCORED.read_text())):
        rows.append(measured(row, labels[row["case"]], laboratory, ready, known))
        print(rows[-1], flush=True)
    origin = reporting.provenance()
    reporting.write("visibility", {**origin, "rows": rows}, markdown(rows, origin))


if __name__ == "__main__":
    main()
