"""What infill runs about a lab's own explanations change in the answers to open cases.

    python -m studies.infill                three minutes of two cores a case; goes on
    python -m studies.infill --made         judges the cases that are simulated already

As `calibrate diagnose --simulate` does in its first round: the leading explanations of a case
(none, single effects, a pair) are simulated on four packings of 1000 spheres, 24 runs, which join
the library.  Cases: films above a signal-to-noise of 6, all single effects of 2 to 6, ten with
nothing hidden, eight with effects that the library lacks, in an order of chance.  Each is answered
by the library alone and with these runs, with the probabilities that the other folds' cases gave
without them.

results/infill.tar.xz holds the runs' features.
"""

import argparse
import json
import multiprocessing
import os
import random
import tarfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.files import write_json
from calibrate.discrepancy import infill
from calibrate.discrepancy.comparison.compare import likeliest_verdict
from calibrate.discrepancy.library.run_library import Rows
from calibrate.io.lab import load_lab
from studies import open_cases, reporting
from studies.sealed import training

WORK = reporting.CACHE / "infill"
FOLDERS = {open_cases.SET: "open_cases", "withheld_own": "withheld_own"}
PACKINGS = 4
SEED = 7
OTHERS = {"none": 10, "outside": 8}  # cases of these strata, drawn
FILMS = ["capillary_tension"]


def chosen() -> list[dict]:
    """The cases with what is known of them, a film above 6 before every four others."""
    every = reporting.content_of(reporting.file_of("open_cases"))["cases"]
    every = [c for c in every if c["set"] in FOLDERS]
    of = {stratum: [c for c in every if c["stratum"] == stratum] for stratum in
          ("single above 6", "single 2 to 6", *OTHERS)}  # fmt: skip
    drawn = random.Random(SEED)
    films = [c for c in of["single above 6"] if c["hidden"] == FILMS]
    rest = [*of["single 2 to 6"], *(c for n, k in OTHERS.items() for c in drawn.sample(of[n], k))]
    drawn.shuffle(rest)
    found = []
    while films or rest:
        found += [*films[:1], *rest[:4]]
        films, rest = films[1:], rest[4:]
    return found


def folder_of(case: dict) -> Path:
    return reporting.CACHE / FOLDERS[case["set"]] / "cases" / case["case"]


def rows_at(case: dict) -> Path:
    return WORK / "rows" / f"{case['case']}.npz"


def simulate(case: dict) -> None:
    """Infill runs of a case, kept as rows."""
    if rows_at(case).exists():
        return
    lab = load_lab(folder_of(case) / "lab.toml")
    plan = infill.InfillPlan(PACKINGS, WORK / "simulated", workers=1)
    emulated = open_cases.emulated().for_lab(lab)
    rows = infill.rows_about(lab, emulated, range(PACKINGS), 0, plan, sizes=(1.0,))
    rows_at(case).parent.mkdir(parents=True, exist_ok=True)
    np.savez(rows_at(case), **vars(rows))


def judge(case: dict) -> dict:
    """Evidences of a case with its infill runs, kept."""
    kept = WORK / open_cases.judged_by() / f"{case['case']}.json"
    if not kept.exists():
        lab = load_lab(folder_of(case) / "lab.toml")
        emulated = open_cases.emulated().for_lab(lab)
        with np.load(rows_at(case)) as made:
            emulated = emulated.joined(Rows(**made), emulated.library)
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_json(kept, open_cases.evidence_of(lab, emulated))
    return json.loads(kept.read_text())


def answers(cases: list[dict], found: list[dict]) -> list[dict]:
    """What is said of each case by the library alone, and with its infill runs."""
    table = training.rows()
    known = [training.known(row) for row in table]
    of = [(row["set"], row["case"]) for row in table]
    by = dict(zip(of, training.by_other_folds(known), strict=True))
    before = dict(zip(of, table, strict=True))
    answered = []
    for case, evidence in zip(cases, found, strict=True):
        name = case["set"], case["case"]
        row = before[name]
        said = {"hidden": case["hidden"], "stratum": case["stratum"], "snr": case["snr"]}
        for way, one in (("library", row), ("infill", {**row, **evidence})):
            known_case = training.known(one)
            probability = known_case.said(by[name])
            verdict = likeliest_verdict(probability)
            said[way] = {
                "verdict": verdict, "stated": probability[verdict],
                "of_truth": probability.get(known_case.truth, 0.0),
                "right": verdict == known_case.truth, "p_gap": one["p_before"],
            }  # fmt: skip
        answered.append({"case": case["case"], **said})
    return answered


def unpack() -> None:
    """The rows that were kept, where there are none."""
    archive = reporting.RESULTS / "infill.tar.xz"
    if archive.exists() and not (WORK / "rows").exists():
        WORK.mkdir(parents=True, exist_ok=True)
        with tarfile.open(archive) as kept:
            kept.extractall(WORK, filter="data")


def pack(cases: list[dict]) -> None:
    """Keeps the rows of these cases."""
    with tarfile.open(reporting.RESULTS / "infill.tar.xz", "w:xz") as kept:
        for case in sorted(cases, key=lambda one: one["case"]):
            kept.add(rows_at(case), f"rows/{rows_at(case).name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--made", action="store_true", help="judge what is simulated, no more")
    given = parser.parse_args()
    runtime.configure()
    open_cases.unpack()
    unpack()
    cases = chosen()
    apart = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), apart, runtime.configure) as workers:
        if not given.made:
            list(workers.map(simulate, cases))
        cases = [case for case in cases if rows_at(case).exists()]
        found = list(workers.map(judge, cases))
    said = answers(cases, found)
    pack(cases)
    reporting.write_content("infill", {"cases": said, **reporting.provenance()})
    for name in ("library", "infill"):
        right = sum(one[name]["right"] for one in said)
        score = np.mean([np.log(max(one[name]["of_truth"], training.LEAST)) for one in said])
        print(f"{name}: {right} of {len(said)} right, mean logarithmic score {score:.2f}")


if __name__ == "__main__":
    main()
