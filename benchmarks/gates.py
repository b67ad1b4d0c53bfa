"""Which number tells best that a soil or a wall hides something: the gate's p-value, or others?

    python benchmarks/gates.py                     a second

On the newest own set, opened, from its archived verdicts: all cases with nothing hidden, and all
with one effect of soil or walls at a signal-to-noise of 2 to 6.  Of each number: how often a case
that hides something has the larger one (area under the ROC curve), and how many of these exceed
what one in twenty of the others does.  ln evidences are those of refitted single effects, no
opinion applied.
"""

import numpy as np
import opinion
import reporting

from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.comparison.score import admissible
from calibrate.discrepancy.library.description import MEASURING, TWO_SIDED
from calibrate.validation.scores import area
from jdem.effects.composite import EFFECTS

OWN = "withheld_own"
RANGE = (2.0, 6.0)
NUMBERS = {
    "p_value": "1 - p of the gate",
    "score": "largest score of one linearisation",
    "evidence": "largest ln evidence",
}


def chosen(true: dict[str, tuple[dict, list[dict]]]) -> tuple[list[str], list[str]]:
    """Cases that hide nothing, and those that hide an effect of soil or walls."""
    nothing = [case for case, (row, _) in true.items() if row["kind"] == NONE]
    soils = [
        case for case, (row, hidden) in true.items()
        if row["kind"] == "single" and RANGE[0] <= row["snr"] < RANGE[1]
        and hidden[0]["name"] not in MEASURING
    ]  # fmt: skip
    return nothing, soils


def numbers(verdict: dict) -> dict:
    """What one verdict says, and which effect has the largest evidence."""
    z = verdict["scores"]
    names = list(z)
    evidence = [verdict["ln_evidence"][name] for name in names]
    sided = np.array([EFFECTS[n].about.one_sided and n not in TWO_SIDED for n in names])
    return {
        "p_value": 1 - verdict["p_before"],
        "score": float(admissible(np.array(list(z.values())), sided).max()),
        "evidence": max(evidence),
        "best": names[int(np.argmax(evidence))],
    }


def compared(key: str, nothing: list[dict], soils: list[dict]) -> dict:
    """Area under the ROC curve, and the share above what one in twenty others exceed."""
    null, seen = (np.array([case[key] for case in cases]) for cases in (nothing, soils))
    limit = float(np.quantile(null, 0.95))
    return {
        "number": NUMBERS[key], "area": area((-seen).tolist(), (-null).tolist()),
        "limit": limit, "seen": float((seen > limit).mean()),
    }  # fmt: skip


def markdown(rows: list[dict], named: int, counts: tuple[int, int], origin: dict) -> str:
    lines = [
        [r["number"], _area(r["area"]), f"{r['limit']:.2f}", f"{100 * r['seen']:.0f} %"]
        for r in rows
    ]
    head = ["number", "area under the ROC curve", "one in twenty nulls above", "seen above that"]
    text = (
        "# Numbers that tell that something is hidden\n\n"
        f"Newest own set, opened: {counts[0]} cases with nothing hidden, {counts[1]} with "
        "one effect of soil or walls at a signal-to-noise of 2 to 6. The largest ln evidence is "
        f"that of the hidden effect in {named} of these.\n\n"
    )
    return text + reporting.table(head, lines) + reporting.footer(origin)


def _area(found: dict) -> str:
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f})"


def main() -> None:
    said = {verdict["case"]: numbers(verdict) for verdict in opinion.verdicts(OWN)}
    true = {case: both for case, both in opinion.truths(OWN).items() if case in said}
    without, with_one = chosen(true)
    nothing, soils = ([said[case] for case in cases] for cases in (without, with_one))
    named = sum(said[case]["best"] == true[case][1][0]["name"] for case in with_one)
    rows, origin = [compared(key, nothing, soils) for key in NUMBERS], reporting.provenance()
    counts = (len(nothing), len(soils))
    content = {**origin, "rows": rows, "named": named, "cases": counts}
    reporting.write("gates", content, markdown(rows, named, counts, origin))


if __name__ == "__main__":
    main()
