"""How often the diagnosis names what is hidden in resolved beds, and nothing where nothing is.

    python benchmarks/open_cases.py                 20 seconds a case, then ten to judge it
    python benchmarks/open_cases.py --learn         the same, then probabilities are learned from it

Two hundred cases of four specimens of 1100 spheres of this simulator: 60 hide nothing, 100 one
effect, 15 two, 25 one that the library lacks.  Beds come from few packings, other ones than those
of the library and of any sealed set.  Cases are open: they serve development, and the bundled
probability calibration is learned from them; so shares are told by cross-validation, each case with
what the other folds' cases gave.  A folder keeps simulations, and the verdicts of one state of
library and diagnosis, so that a stopped run goes on.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import reporting

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from support import evidences

from calibrate.core import runtime
from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.compare import compare, likeliest_verdict
from calibrate.discrepancy.comparison.probability_calibration import (
    NONE,
    UNKNOWN,
    ProbabilityCalibration,
    bundled_calibration,
)
from calibrate.discrepancy.diagnosis import InferenceSetup, described, prepared_diagnosis
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.io.lab import load_lab
from calibrate.simulation.keys import source_hash
from calibrate.validation import run, trial
from calibrate.validation.plan import COUNTS, Beds
from calibrate.validation.seal import open_seal

SEED = 4242
BEDS = Beds(first_seed=2_900_000, spheres=(1100,), pool=8, packings=8)  # of no library, no seal
SET = "open, 1100 spheres"
WORK = reporting.CACHE / "open_cases"


@cache
def emulated() -> EmulatedLibrary:
    return EmulatedLibrary.of(store.load(store.bundled_library()))


@cache
def setup() -> InferenceSetup:
    return InferenceSetup()


@cache
def judged_by() -> str:
    """A name for this state of library and diagnosis; probabilities do not count, as only
    evidences are kept."""
    library = hashlib.sha256(store.bundled_library().read_bytes()).hexdigest()
    return f"evidences-{library[:8]}-{source_hash(described, prepared_diagnosis, compare)[:8]}"


def kept_at(case: Path) -> Path:
    return case.parents[1] / judged_by() / f"{case.name}.json"


def judge(case: Path) -> None:
    """The evidences of a case, kept."""
    if kept_at(case).exists():
        return
    try:
        _, d, measured = described(load_lab(case / "lab.toml"), emulated(), 0)
    except InputError as error:
        print(f"{case.name}: {error}", file=sys.stderr)
        return
    prepared = prepared_diagnosis(d, measured, 0, setup())
    found = compare(prepared, measured)
    kept_at(case).parent.mkdir(exist_ok=True)
    write_json(kept_at(case), {
        "p_before": found.summary.p_before, "p_after": found.summary.p_after,
        "classes": [list(members) for members in prepared.classes.members],
        "ln_evidence": {n: round(x, 4) for n, x in trial.ln_evidence(found).items()},
    })  # fmt: skip


def judged(work: Path, only_made: bool) -> list[dict]:
    """All cases, made and judged if they are not yet, as lines of the table of evidences."""
    if not only_made:
        run.generate(work, emulated(), COUNTS, SEED, for_terminal(), beds=BEDS, with_changes=False)
    cases = run.case_folders(work)
    apart = multiprocessing.get_context("spawn")  # threads of JAX do not survive a fork
    with ProcessPoolExecutor(os.cpu_count(), apart, runtime.configure) as workers:
        list(workers.map(judge, cases))
    labels = {} if only_made else open_seal(work)
    rows = []
    for case in (case for case in cases if kept_at(case).exists()):
        one = run.planned_case(work, case.name)
        true = labels.get(case.name, {"kind": one.kind, "planned_snr": one.snr})
        rows.append({
            "set": SET, "case": case.name, "kind": true["kind"], "snr": true["planned_snr"],
            "hidden": [h.name for h in one.hidden], **json.loads(kept_at(case).read_text()),
        })  # fmt: skip
    return rows


def said_of(rows: Sequence[dict], by: Sequence[ProbabilityCalibration]) -> list[dict]:
    """What is said of each case with a calibration of its own."""
    found = []
    for row, calibration in zip(rows, by, strict=True):
        case = evidences.known(row)
        probability = case.said(calibration)
        verdict = likeliest_verdict(probability)
        found.append({
            "case": row["case"], "hidden": row["hidden"], "stratum": case.stratum,
            "snr": row["snr"], "truth": case.truth, "verdict": verdict,
            "stated": probability[verdict], "right": verdict == case.truth,
            "p_gap": row["p_before"],
        })  # fmt: skip
    return found


def summary(said: Sequence[dict]) -> dict[str, dict[str, int]]:
    """How many of how many are right, called none and called unknown."""
    kinds = {"none": "nothing hidden", "single below 2": "one effect, 0.5 to 2",
             "single 2 to 6": "one effect, 2 to 6", "single above 6": "one effect, above 6",
             "two": "two effects", "outside": "an effect that the library lacks"}  # fmt: skip
    of = {words: [s for s in said if s["stratum"] == name] for name, words in kinds.items()}
    return {
        words: {
            "right": sum(s["right"] for s in some), "cases": len(some),
            "none": sum(s["verdict"] == NONE for s in some),
            "unknown": sum(s["verdict"] == UNKNOWN for s in some),
        }
        for words, some in of.items() if some
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--work", type=Path, default=WORK, help="folder for simulations")
    parser.add_argument("--learn", action="store_true", help="keep evidences for opinion.py")
    parser.add_argument("--made", action="store_true", help="judge the cases made so far, no more")
    chosen = parser.parse_args()
    runtime.configure()
    rows = judged(chosen.work, chosen.made)
    some = [evidences.known(row) for row in rows]
    if chosen.learn:
        evidences.keep(rows)
    others = evidences.by_other_folds(some)
    bundled = evidences.quality(some, [bundled_calibration()] * len(some))
    written(said_of(rows, others), {
        "bundled calibration": bundled, "that of the other folds": evidences.quality(some, others),
    })  # fmt: skip


def written(said: Sequence[dict], quality: dict) -> None:
    """The results file of these cases."""
    origin, found = reporting.provenance(), summary(said)
    header = ("cases, signal-to-noise", "right", "called none", "called unknown")
    lines = [
        (name, f"{n['right']} of {n['cases']}", str(n["none"]), str(n["unknown"]))
        for name, n in found.items()
    ]
    by_folds = quality["that of the other folds"]
    words = (
        "Each case with probabilities that were learned from the others. Wrong, and stated with "
        f"0.8 or more: {100 * by_folds['wrong_and_sure']:.0f} %; calibration error "
        f"{by_folds['calibration_error']:.3f}."
    )
    wrong = [s for s in said if not s["right"] and s["stratum"] != "single below 2"]
    listed = [
        (" + ".join(s["hidden"]) or "nothing", f"{s['snr']:.1f}", s["verdict"],
         f"{s['stated']:.2f}", f"{s['p_gap']:.3f}")
        for s in sorted(wrong, key=lambda s: (s["stratum"], s["hidden"], s["snr"]))
    ]  # fmt: skip
    text = "\n".join([
        "# Open cases", "", reporting.table(header, lines), words, "", "## Wrong above 2", "",
        reporting.table(("hidden", "signal-to-noise", "verdict", "stated", "p of a gap"), listed),
    ])  # fmt: skip
    content = {"summary": found, "quality": quality, "cases": list(said), **origin}
    reporting.write("open_cases", content, text + reporting.footer(origin))


if __name__ == "__main__":
    main()
