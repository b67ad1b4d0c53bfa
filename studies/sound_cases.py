"""What the diagnosis says of sound specimens whose records begin at a preload, and of others again.

    python -m studies.sound_cases --make          a minute of a core a specimen; goes on
    python -m studies.sound_cases                 a minute and a half of a core a case; goes on

Fresh soils of four specimens of 1100 spheres hide nothing; beds and soils are of no other set.  All
four specimens of a soil, three of them, or both of two parts are judged as cases of their own.
Records of a case begin at a preload, drawn between 0 and 10 N: rows before the first that reaches
it are left out.
results/sound_cases.tar.xz holds the 48 soils that have been made, enough for `CASES`; with fewer,
sound ones of opened sets fill up, told apart, as their answers taught the probability
calibration.  Cases with one effect above six times the noise are judged again as they are, in an
order of chance.  Writes results/sound_cases.json.xz.
"""

import argparse
import json
import random
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.files import write_json, write_text
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.compare import compare
from calibrate.discrepancy.comparison.naming import FEWEST
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.diagnosis import (
    answered,
    beyond_library,
    described,
    library_error,
)
from calibrate.discrepancy.library.measurements import Measurements
from calibrate.io.lab import Lab, load_lab
from studies import open_cases, reporting
from studies.sealed import run
from studies.sealed.plan import Beds
from studies.sealed.scores import share

SEED, CASES = 5757, 60
BEDS = Beds(first_seed=3_900_000, spheres=(1100,), pool=8, packings=8)  # of no other set
WORK = reporting.CACHE / "sound_cases"
HIGHEST = 10.0  # N, of a preload
SETS = {open_cases.SET: "open_cases", "withheld_own": "withheld_own",
        "withheld_shapes": "withheld_shapes"}  # fmt: skip
FRESH, FILLED, STRONG = "fresh", "opened, nothing hidden", "opened, one effect above 6"


def cut(case: Path, out: Path, preload: float, specimens: range) -> Path:
    """A case's copy, whose records begin at a preload (N), of some of its specimens (from 1)."""
    text = (case / "lab.toml").read_text(encoding="utf-8")
    head, *curves = text.split("[[curves]]")
    densities = re.findall(r'"[^"]*"', re.findall(r"density = \[(.*)\]", head)[0])
    densities = [densities[number - 1] for number in specimens]
    head = re.sub(r"density = \[.*\]", f"density = [{', '.join(densities)}]", head)
    kept = [c for c in curves if int(re.findall(r"_(\d+)\.csv", c)[0]) in specimens]
    write_text(out / "lab.toml", "[[curves]]".join([head, *kept]))
    for curve in kept:
        name = re.findall(r'file = "([^"]*)"', curve)[0]
        first, *rows = (case / name).read_text(encoding="utf-8").split()
        force = np.array([float(row.split(",")[1]) for row in rows])
        write_text(out / name, "\n".join([first, *rows[int(np.argmax(force >= preload)) :]]) + "\n")
    return out / "lab.toml"


def said(lab: Lab) -> dict:
    """What is said of a lab, as `calibrate diagnose` says it, and what it rests on."""
    emulated = open_cases.emulated()
    found, d, measured = described(lab, emulated, 0)
    first = compare(open_cases.setup().prepared(d, measured), measured)
    last, reduction = answered(lab, emulated, found, d, measured, first, 0)
    delta = first.base.delta
    return {
        "verdict": last.verdict, "reason": last.reason, "likeliest": first.verdict,
        "stated": first.stated, "p_gap": first.summary.p_before, "begin": _begin(found),
        "beyond": list(beyond_library(lab, emulated, delta)),
        "library_error": library_error(lab, emulated, delta),
        "shrinkage": None if reduction is None else reduction.shrinkage,
    }  # fmt: skip


def _begin(found: Measurements) -> dict[str, float]:
    return {test: round(force, 2) for test, force in found.begun.items()}


# Which specimens (from 1) of twelve soils become fifteen cases; and again.
FOUR, THREE = (range(1, 5),), (range(1, 4),)
AND_ONE, IN_TWO = (range(1, 4), range(4, 5)), (range(1, 3), range(3, 5))
PARTS = (FOUR, THREE, FOUR, AND_ONE, FOUR, THREE, THREE, IN_TWO, THREE, FOUR, FOUR, AND_ONE)


def sound() -> Iterator[tuple[str, Path, float, range]]:
    """Sound cases to be cut: set, folder, preload (N) and specimens, fresh ones first."""
    fresh = sorted(path.parent for path in (WORK / "cases").glob("*/lab.toml"))
    known = reporting.content_of(reporting.file_of("open_cases"))["cases"]
    none = [c for c in known if c["stratum"] == NONE and c["set"] in SETS]
    random.Random(SEED).shuffle(none)
    filled = [reporting.CACHE / SETS[c["set"]] / "cases" / c["case"] for c in none]
    parts = [(FRESH, f, r) for n, f in enumerate(fresh) for r in PARTS[n % len(PARTS)]]
    parts += [(FILLED, f, r) for n, f in enumerate(filled) for r in PARTS[n % len(PARTS)]]
    for kind, folder, specimens in parts[:CASES]:
        drawn = np.random.default_rng([SEED, *folder.name.encode(), specimens.start])
        yield kind, folder, round(float(drawn.uniform(0, HIGHEST)), 2), specimens


def strong() -> list[tuple[dict, Path]]:
    """Opened cases with one strong effect, in an order of chance."""
    known = reporting.content_of(reporting.file_of("open_cases"))["cases"]
    rows = [c for c in known if c["stratum"] == "single above 6" and c["set"] in SETS]
    random.Random(SEED).shuffle(rows)
    return [(c, reporting.CACHE / SETS[c["set"]] / "cases" / c["case"]) for c in rows]


def judge(only: str, most: int) -> None:
    """Judges what is not judged yet; answers are kept."""
    kept = WORK / "said"
    kept.mkdir(parents=True, exist_ok=True)
    if only != "strong":
        ordered = sorted(sound(), key=lambda row: len(row[-1]) < FEWEST)  # what tells most first
        for kind, case, preload, specimens in ordered[:most]:
            name = f"{case.name}_{specimens.start}"
            path = kept / f"sound_{name}.json"
            if not path.exists():
                lab = load_lab(cut(case, WORK / "cut" / name, preload, specimens))
                count = len(specimens)
                row = {"set": kind, "case": name, "preload": preload, "specimens": count}
                write_json(path, {**row, **said(lab)})
                print(path.name, flush=True)
    if only != "sound":
        for row, case in strong()[:most]:
            path = kept / f"strong_{case.name}.json"
            if not path.exists():
                before = {"hidden": row["hidden"], "truth": row["truth"], "before": row["verdict"]}
                found = said(load_lab(case / "lab.toml"))
                write_json(path, {"set": STRONG, "case": case.name, **before, **found})
                print(path.name, flush=True)


def summary(rows: Sequence[dict]) -> dict:
    """Shares with their intervals, by set."""
    found = {}
    for kind in (FRESH, FILLED):
        mine = [r for r in rows if r["set"] == kind]
        enough = [r["verdict"] != NONE for r in mine if r["specimens"] >= FEWEST]
        few = [r["verdict"] != NONE for r in mine if r["specimens"] < FEWEST]
        found[kind] = {"named of three or four": share(enough), "named of fewer": share(few)}
    mine = [r for r in rows if r["set"] == STRONG]
    found[STRONG] = {
        "named rightly before": share(r["before"] == r["truth"] for r in mine),
        "likeliest rightly": share(r["likeliest"] == r["truth"] for r in mine),
        "named rightly": share(r["verdict"] == r["truth"] for r in mine),
        "not named, by reason": {
            reason: sum(r["reason"] == reason for r in mine)
            for reason in sorted({r["reason"] for r in mine})
        },
    }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--make", action="store_true", help="make the fresh cases, judge nothing")
    parser.add_argument("--only", choices=("sound", "strong"), default="")
    parser.add_argument("--most", type=int, default=CASES + 87, help="of each kind")
    parser.add_argument("--made", action="store_true", help="write what is judged, judge nothing")
    chosen = parser.parse_args()
    runtime.configure()
    open_cases.unpack((*open_cases.ARCHIVES, "sound_cases.tar.xz"))
    if chosen.make:
        run.generate(WORK, open_cases.emulated(), {NONE: CASES}, SEED, for_terminal(), beds=BEDS,
                     with_changes=False)  # fmt: skip
        return
    if not chosen.made:
        judge(chosen.only, chosen.most)
    rows = [json.loads(p.read_text()) for p in sorted((WORK / "said").glob("*.json"))]
    print(json.dumps(summary(rows), indent=1))
    content = {"seed": SEED, "summary": summary(rows), "cases": rows, **reporting.provenance()}
    reporting.write_content("sound_cases", content)


if __name__ == "__main__":
    main()
