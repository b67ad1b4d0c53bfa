"""How often the diagnosis names what is hidden in resolved beds, and nothing where nothing is.

    python -m studies.open_cases                 20 seconds a case, then ten to judge it
    python -m studies.open_cases --learn         the same, and evidences are kept to learn from

Two hundred cases of four specimens of 1100 spheres of this simulator: 60 hide nothing, 100 one
effect, 15 two, 25 one that the library lacks.  Beds come from few packings, other ones than those
of the library and of any sealed set.  Cases are open: they serve development, and the bundled
probability calibration is learned from them; so shares are told by cross-validation, each case with
what the other folds' cases gave.  Sealed sets that have been judged and opened join them.
How visible an effect is, two specimens tell that are simulated without it, as for a sealed set.

results/open_cases.tar.xz holds what has been made so far, 78 of the 200, and the opened set of
other specimens; results/withheld_own.tar.xz the opened set of usual ones.  A folder keeps these,
and the evidences of one state of library and diagnosis, so that a stopped run goes on; --made stops
at what is there.  `studies.diagnosis` makes the page.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import sys
import tarfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.compare import compare, likeliest_verdict
from calibrate.discrepancy.comparison.probability_calibration import (
    ProbabilityCalibration,
    bundled_calibration,
)
from calibrate.discrepancy.diagnosis import described
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import CENTRE
from calibrate.io.lab import Lab, load_lab
from calibrate.simulation import side_by_side
from studies import reporting
from studies.sealed import run, training, trial
from studies.sealed.labels import FEWEST_CHANGES, with_visibility
from studies.sealed.laboratory import Laboratory
from studies.sealed.plan import COUNTS, Beds, WithheldCase, without_nan

SEED = 4242
BEDS = Beds(first_seed=2_900_000, spheres=(1100,), pool=8, packings=8)  # of no library, no seal
SET = "open, 1100 spheres"
WORK = reporting.CACHE / "open_cases"
DIAGNOSIS = 1  # raise it with a change of the diagnosis that alters evidences: they are found anew
CLOSE = 1e-3  # in ln evidence
OPENED = ("withheld_shapes", "withheld_own")  # sealed sets that were judged
ARCHIVES = ("open_cases.tar.xz", "withheld_own.tar.xz")


@cache
def emulated() -> EmulatedLibrary:
    return EmulatedLibrary.of(store.load(store.bundled_library()))


@cache
def setup() -> trial.InferenceSetup:
    return trial.InferenceSetup()


@cache
def judged_by() -> str:
    """A name for this state of library and diagnosis; probabilities do not count, as only
    evidences are kept."""
    library = hashlib.sha256(store.bundled_library().read_bytes()).hexdigest()
    return f"evidences-{library[:8]}-{DIAGNOSIS}"


def unpack(archives: Sequence[str] = ARCHIVES) -> None:
    """The cases made so far, and those of opened sets, where there are none."""
    reporting.CACHE.mkdir(parents=True, exist_ok=True)
    for name in archives:
        if not (reporting.CACHE / name.split(".")[0]).exists():
            with tarfile.open(reporting.RESULTS / name) as archive:
                archive.extractall(reporting.CACHE, filter="data")


def kept_at(case: Path) -> Path:
    return case.parents[1] / judged_by() / f"{case.name}.json"


def judge(case: Path) -> None:
    """The evidences of a case, kept."""
    if kept_at(case).exists():
        return
    try:
        found = evidence_of(load_lab(case / "lab.toml"), emulated())
    except InputError as error:
        print(f"{case.name}: {error}", file=sys.stderr)
        return
    kept_at(case).parent.mkdir(exist_ok=True)
    write_json(kept_at(case), found)


def evidence_of(lab: Lab, known: EmulatedLibrary) -> dict:
    """What a library says of a lab: facts, classes of alike effects, ln evidences."""
    _, d, measured = described(lab, known, 0)
    prepared = setup().prepared(d, measured)
    found = compare(prepared, measured)
    return {
        "p_before": found.summary.p_before, "p_after": found.summary.p_after,
        "classes": [list(members) for members in prepared.classes.members],
        "ln_evidence": {n: round(x, 4) for n, x in trial.ln_evidence(found).items()},
    }  # fmt: skip


def judged(cases: Sequence[Path]) -> list[Path]:
    """Judges cases that are not judged yet; those that can be.  The first that is kept is judged
    again, as a change of the diagnosis may have been forgotten in its version."""
    for case in [case for case in cases if kept_at(case).exists()][:1]:
        before = json.loads(kept_at(case).read_text())["ln_evidence"]
        now = evidence_of(load_lab(case / "lab.toml"), emulated())["ln_evidence"]
        if now.keys() != before.keys() or any(abs(now[n] - before[n]) > CLOSE for n in now):
            sys.exit(f"{case.name}: evidences changed: raise DIAGNOSIS, or find the fault")
    apart = multiprocessing.get_context("spawn")  # threads of JAX do not survive a fork
    with ProcessPoolExecutor(os.cpu_count(), apart, runtime.configure) as workers:
        list(workers.map(judge, cases))
    return [case for case in cases if kept_at(case).exists()]


def changes_of(folder: Path, true: WithheldCase, only_made: bool) -> np.ndarray:
    """What the effects of a folder's case do to its features (n, m), by simulations with and
    without them on two of its packings, kept; none where they are not made."""
    path = folder / "changes" / f"{true.name}.json"
    if not path.exists() and true.hidden and not only_made:
        found = Laboratory(folder / "simulated", CENTRE).changes(true, range(FEWEST_CHANGES))
        path.parent.mkdir(exist_ok=True)
        write_json(path, {"changes": without_nan(found.round(6))})
    kept = json.loads(path.read_text())["changes"] if path.exists() else []
    return np.array(kept, float)


def of_work(only_made: bool) -> list[dict]:
    """The open cases, made if they are not yet, as lines of the table of evidences."""
    if not only_made:
        run.generate(WORK, emulated(), COUNTS, SEED, for_terminal(), beds=BEDS, with_changes=False)
    seen = snr_of_work(only_made)
    return [
        {
            "set": SET, "case": case.name, "kind": true.kind, "snr": seen[case.name],
            "hidden": [h.name for h in true.hidden],
            **json.loads(kept_at(case).read_text()),
        }
        for case in judged(run.case_folders(WORK))
        for true in [run.planned_case(WORK, case.name)]
    ]  # fmt: skip


def snr_of_work(only_made: bool) -> dict[str, float]:
    """Of the open cases that are made."""
    return snr_by_case(WORK, [case.name for case in run.case_folders(WORK)], only_made)


def snr_by_case(folder: Path, names: Sequence[str], only_made: bool) -> dict[str, float]:
    """Signal-to-noise of a folder's cases by simulations without the effect, as far as these are
    made."""
    every = [run.planned_case(folder, name) for name in names]
    changes = side_by_side(
        lambda i: changes_of(folder, every[i], only_made), len(every), for_terminal(),
        "without effects",
    )  # fmt: skip
    labels = {c.name: c.label(made) for c, made in zip(every, changes, strict=True)}
    seen = with_visibility(labels, emulated(), None)
    return {name: label["snr"] for name, label in seen.items()}


def of_opened(name: str, only_made: bool) -> list[dict]:
    """The cases of a sealed set that has been opened and scored, as lines of the same table.  Where
    its labels do not tell how visible an effect is, because some feature is missing, the others
    tell it now."""
    scored = reporting.content_of(reporting.file_of(name))
    known = {row["case"]: row for row in scored["rows"]}
    untold = [case for case, row in known.items() if row["kind"] == "outside" and not row["snr"]]
    for case, snr in snr_by_case(reporting.CACHE / name, untold, only_made).items():
        known[case]["snr"] = snr
    return [
        {
            "set": name, "case": case.name, "kind": known[case.name]["kind"],
            "snr": known[case.name]["snr"],
            "hidden": [one["name"] for one in scored["hidden"][case.name]],
            **json.loads(kept_at(case).read_text()),
        }
        for case in judged(run.case_folders(reporting.CACHE / name))
    ]  # fmt: skip


def said_of(rows: Sequence[dict], by: Sequence[ProbabilityCalibration]) -> list[dict]:
    """What is said of each case with a calibration of its own."""
    found = []
    for row, calibration in zip(rows, by, strict=True):
        case = training.known(row)
        probability = case.said(calibration)
        verdict = likeliest_verdict(probability)
        found.append({
            "set": row["set"], "case": row["case"], "hidden": row["hidden"],
            "stratum": case.stratum, "snr": row["snr"], "truth": case.truth, "verdict": verdict,
            "stated": probability[verdict], "right": verdict == case.truth,
            "p_gap": row["p_before"],
        })  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--learn", action="store_true", help="keep evidences for studies.sealed.training"
    )
    parser.add_argument("--made", action="store_true", help="judge the cases made so far, no more")
    chosen = parser.parse_args()
    runtime.configure()
    unpack()
    opened = [row for name in OPENED for row in of_opened(name, chosen.made)]
    rows = [*of_work(chosen.made), *opened]
    some = [training.known(row) for row in rows]
    if chosen.learn:
        training.keep(rows)
    others = training.by_other_folds(some)
    bundled = training.quality(some, [bundled_calibration()] * len(some))
    folds = training.quality(some, others)
    print(json.dumps({"bundled": bundled, "folds": folds}, indent=1))
    content = {"bundled calibration": bundled, "that of the other folds": folds,
               "cases": said_of(rows, others), **reporting.provenance()}  # fmt: skip
    reporting.write_content("open_cases", content)


if __name__ == "__main__":
    main()
