"""Which number tells best that a soil or a wall hides something: the gate's p-value, or others?

    mkdir fifth && tar xf benchmarks/results/withheld_fifth_cases.tar.xz -C fifth
    python benchmarks/gates.py fifth --each 25          ten minutes beside other jobs; resumes

On an opened set: `each` cases with nothing hidden, and as many with one effect of soil or walls at
a signal-to-noise of 2 to 8.  Of each number: how often a case that hides something has the larger
one (area under the ROC curve), and how many of these exceed what one in twenty of the others does.
The largest ln evidence is that of refitted single effects, no opinion applied.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import reporting

from calibrate.bank import mismatch, store
from calibrate.bank.description import Ready
from calibrate.campaign import engine_hash
from calibrate.diagnosed import Manner, described, ready_to_diagnose
from calibrate.diagnosis.opinion import NONE
from calibrate.diagnosis.score import admissible
from calibrate.diagnosis.which import diagnose
from calibrate.measurements import load_lab
from calibrate.output import write_json
from calibrate.withheld.run import case_folders
from calibrate.withheld.scores import area
from calibrate.withheld.trial import DRAWS, typical_case

SCORED = reporting.RESULTS / "withheld_fifth.json"
MISMATCH = reporting.RESULTS / "withheld_fifth_mismatch.json"
INSTRUMENTS = ("acquisition_lag", "load_cell_offset", "seating_gap")
RANGE = (2.0, 8.0)
NUMBERS = {
    "p_value": "1 - p of the gate",
    "score": "largest score of one linearisation",
    "fall": "largest fall of the objective",
    "evidence": "largest ln evidence",
}


def chosen(scored: dict, each: int) -> tuple[list[str], list[str]]:
    """Cases that hide nothing, and some that hide an effect of soil or walls."""
    rows, hidden = scored["rows"], scored["hidden"]
    nothing = [row["case"] for row in rows if row["kind"] == NONE]
    soils = [
        row["case"] for row in rows
        if row["kind"] == "single" and RANGE[0] <= row["snr"] < RANGE[1]
        and hidden[row["case"]][0]["name"] not in INSTRUMENTS
    ]  # fmt: skip
    return nothing[:each], soils[:each]


def numbers(folder: Path, ready: Ready, known, manner: Manner) -> dict:
    """What one case's diagnosis says, and which effect has the largest evidence."""
    _, d, measured = described(load_lab(folder / "lab.toml"), ready, 0, known)
    which = diagnose(ready_to_diagnose(d, measured, 0, manner, DRAWS), measured)
    alone = [fit.objective for key, fit in which.refits.items() if len(key) == 1]
    evidence = which.facts.evidence.singles
    return {
        "p_value": 1 - which.facts.p_before,
        "score": float(admissible(which.scores.z, d.one_sided).max()),
        "fall": which.base.objective - min(alone),
        "evidence": float(evidence.max()),
        "best": d.effect_names[int(np.argmax(evidence))],
    }


def compared(key: str, nothing: list[dict], soils: list[dict]) -> dict:
    """Area under the ROC curve, and the share above what one in twenty others exceed."""
    null, seen = (np.array([case[key] for case in cases]) for cases in (nothing, soils))
    limit = float(np.quantile(null, 0.95))
    return {
        "number": NUMBERS[key], "area": area((-seen).tolist(), (-null).tolist()),
        "limit": limit, "seen": float((seen > limit).mean()),
    }  # fmt: skip


def markdown(rows: list[dict], named: int, count: int, origin: dict) -> str:
    lines = [
        [r["number"], _area(r["area"]), f"{r['limit']:.2f}", f"{100 * r['seen']:.0f} %"]
        for r in rows
    ]
    head = ["number", "area under the ROC curve", "one in twenty nulls above", "seen above that"]
    text = (
        "# Numbers that tell that something is hidden\n\n"
        f"Fifth own set, opened: {count} cases with nothing hidden, {count} with one effect of "
        f"soil or walls. The largest ln evidence is that of the hidden effect in {named} of these."
        "\n\n"
    )
    return text + reporting.table(head, lines) + reporting.footer(origin)


def _area(found: dict) -> str:
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="an opened set")
    parser.add_argument("--each", type=int, default=25)
    given = parser.parse_args()
    reporting.configure()
    ready = Ready.of(store.load(store.bundled_bank()))
    known = mismatch.load(MISMATCH, ready)
    typical = typical_case(case_folders(given.folder)[0], ready, 0, known)
    manner = Manner(nulls={typical.world.plan.shape: typical.null})
    scored, kept = json.loads(SCORED.read_text()), reporting.CACHE / f"gates_{engine_hash()}"

    def of(case: str) -> dict:
        path = kept / f"{case}.json"
        if not path.exists():
            kept.mkdir(parents=True, exist_ok=True)
            write_json(path, numbers(given.folder / "cases" / case, ready, known, manner))
        return json.loads(path.read_text())

    nothing, soils = ([of(case) for case in cases] for cases in chosen(scored, given.each))
    truths = [scored["hidden"][case][0]["name"] for case in chosen(scored, given.each)[1]]
    named = sum(found["best"] == truth for found, truth in zip(soils, truths, strict=True))
    rows, origin = [compared(key, nothing, soils) for key in NUMBERS], reporting.provenance()
    content = {**origin, "rows": rows, "named": named, "each": given.each}
    reporting.write("gates", content, markdown(rows, named, given.each, origin))


if __name__ == "__main__":
    main()
