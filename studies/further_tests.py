"""How many further tests it takes to name what is hidden: those asked for, at random, all cheap.

    python -m studies.further_tests --most 50 --others 5       60 cases, 25 to 35 minutes

Cases of a sealed set, after it was judged: those whose one effect has a signal-to-noise above 1,
and some with nothing hidden or with an effect that the library lacks.  A laboratory answers up to
three tests a case from the list of `calibrate next`: each on two fresh specimens of the case's
soil, or without soil, with what is hidden.  Three ways to ask are scored on the same answers: what
`calibrate next` proposes until it says stop, tests drawn at random, and all tests of an hour at
most at once.  Answers and verdicts are kept, so that a stopped run goes on.  `diagnosis.py` makes
the page.
"""

import argparse
import json
import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.files import write_json
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.classes import TOGETHER
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.library.design import CENTRE
from calibrate.io.lab import load_lab
from studies import open_cases, reporting
from studies.sealed import run
from studies.sealed.further import ROUNDS, Asking, FurtherLaboratory
from studies.sealed.laboratory import Laboratory
from studies.sealed.scores import truth_of

ASKING = 1  # raise it with a change of what is asked for: verdicts are then found anew
VISIBLE = 1.0  # signal-to-noise from which an effect counts
DRAWS = 2000  # of the bootstrap
SET = "withheld_second"  # of which nothing was learned
WORK = reporting.CACHE / SET
WAYS = {"asked for": "asked", "at random": "random"}


@cache
def laboratory(work: Path) -> FurtherLaboratory:
    return FurtherLaboratory(Laboratory(work / "simulated", CENTRE), work / "answers")


def judged_by() -> str:
    return f"further-{open_cases.judged_by().removeprefix('evidences-')}-{ASKING}"


def loop(case: Path) -> dict:
    """Verdicts on a case after 0, 1, ... tests, by way of asking."""
    work = case.parents[1]
    kept = work / judged_by() / f"{case.name}.json"
    if not kept.exists():
        true, lab = run.planned_case(work, case.name), load_lab(case / "lab.toml")
        made = laboratory(work)
        asking = Asking.of(
            lab, open_cases.emulated(), open_cases.setup(), lambda p: made.answer(true, lab, p)
        )
        found = {
            "asked": asking.by_proposals(), "random": asking.at_random([true.seed]),
            "cheap": asking.all_cheap(),
            "classes": [list(members) for members in asking.prepared.classes.members],
        }  # fmt: skip
        kept.parent.mkdir(exist_ok=True)
        write_json(kept, found)
    return json.loads(kept.read_text())


def row_of(case: str, label: dict, snr: float, found: dict) -> dict:
    """A line of the results file, by a label in our words; probabilities of all explanations stay
    in the folder."""
    said = {way: found[way] for way in (*WAYS.values(), "cheap") if way in found}
    for one in (*said["asked"], *said.get("random", []), said["cheap"]):
        one.pop("by_class")
    hidden = TOGETHER.join(one["name"] for one in label["hidden"])
    truth = truth_of(label, found["classes"])
    return {
        "case": case, "kind": label["kind"], "snr": snr, "hidden": hidden, "truth": truth, **said
    }  # fmt: skip


def chosen_cases(work: Path, snr: dict[str, float], most: int, others: int) -> list[Path]:
    """Single effects above `VISIBLE`, and others, in the order of their meaningless names."""
    kinds: dict[str, list[Path]] = {"single": [], NONE: [], "outside": []}
    for case in run.case_folders(work):
        kind = run.planned_case(work, case.name).kind
        if kind in kinds and (kind != "single" or snr[case.name] > VISIBLE):
            kinds[kind].append(case)
    return [*kinds["single"][:most], *kinds[NONE][:others], *kinds["outside"][:others]]


def right_after(row: dict, way: str) -> list[bool]:
    """Whether the verdict is right after 0 to ROUNDS tests; one that stops keeps its verdict."""
    said = [one["verdict"] == row["truth"] for one in row[way]]
    return [said[min(k, len(said) - 1)] for k in range(ROUNDS + 1)]


def until_right(row: dict, way: str) -> int:
    """Number of tests after which the verdict is right first; one more than all if it never is."""
    right = right_after(row, way)
    return right.index(True) if True in right else ROUNDS + 1


def ratio(rows: Sequence[dict]) -> tuple[float, float, float]:
    """Tests until the verdict is right, asked for over at random, among cases that are not right at
    once; with a 95 % interval (bootstrap over cases)."""
    open_ = [row for row in rows if not right_after(row, "asked")[0]]
    counts = np.array([[until_right(row, way) for way in ("asked", "random")] for row in open_])
    if not len(counts):
        return np.nan, np.nan, np.nan
    rng = np.random.default_rng(0)
    drawn = counts[rng.integers(len(counts), size=(DRAWS, len(counts)))].sum(axis=1)
    low, high = np.quantile(drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
    return float(counts[:, 0].sum() / counts[:, 1].sum()), float(low), float(high)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--most", type=int, default=100, help="cases with one effect")
    parser.add_argument(
        "--others", type=int, default=10, help="with nothing hidden, and from outside"
    )
    given = parser.parse_args()
    runtime.configure()
    open_cases.unpack([f"{SET}.tar.xz"])
    judged = reporting.content_of(reporting.file_of(SET))["rows"]
    snr, progress = {row["case"]: row["snr"] for row in judged}, for_terminal()
    cases = chosen_cases(WORK, snr, given.most, given.others)
    progress.start("asking for further tests", len(cases))
    rows = []
    apart = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), apart, runtime.configure) as workers:
        for case, found in zip(cases, workers.map(loop, cases), strict=True):
            true = run.planned_case(WORK, case.name)
            label = {"kind": true.kind, "hidden": [{"name": h.name} for h in true.hidden]}
            rows.append(row_of(case.name, label, snr[case.name], found))
            progress.advance()
    progress.finish()
    written(rows)


def written(rows: Sequence[dict]) -> None:
    """The results file; how many are right, for a look."""
    single = [row for row in rows if row["kind"] == "single"]
    for way in (*WAYS.values(), "cheap"):
        for kind in dict.fromkeys(row["kind"] for row in rows):
            some = [row for row in rows if row["kind"] == kind]
            if way == "cheap":
                right = [sum(row["cheap"]["verdict"] == row["truth"] for row in some)]
            else:
                right = np.sum([right_after(row, way) for row in some], axis=0).tolist()
            print(f"{kind}, {way}: {right} of {len(some)} after 0, 1, ... tests")
    content = {"ratio": ratio(single), "cases": list(rows), **reporting.provenance()}
    reporting.write_content("further_tests", content)


if __name__ == "__main__":
    main()
