"""How often the diagnosis names what is hidden in resolved beds, and nothing where nothing is.

    python benchmarks/open_cases.py        27 minutes with nothing hidden, then one minute a case

Specimens of 1100 and 2200 spheres of this simulator, other packings and porosities than the library
of runs, four a case: 30 with nothing hidden, 8 and 8 with one effect at a signal-to-noise of 2 to
6 and above 6.  Cases are open: they serve development, no sealed validation.  A folder keeps
simulations, and the verdicts of one state of library and diagnosis, so that a stopped run goes on.
Results hold the parts that were asked for; write both before you quote them.
"""

import argparse
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import reporting

from calibrate.core import runtime
from calibrate.core.files import write_json
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.compare import compare, label
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.diagnosis import InferenceSetup, described, prepared_diagnosis
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.run_library import RunLibrary
from calibrate.io.lab import load_lab
from calibrate.simulation.keys import source_hash
from calibrate.validation import run
from calibrate.validation.seal import open_seal

FINER = 1600  # spheres, between those of the two kinds of bed
FIRST_SEED = 2_900_000  # of packings, which no library and no sealed set has
PARTS = {"nothing hidden": ({"none": 30}, 77), "one effect": ({"above 6": 8, "2-6": 8}, 991)}


def verdict_of(case: Path, emulated: EmulatedLibrary, setup: InferenceSetup, hidden: Sequence[str]):
    """What is said of a case, and whether that is right."""
    _, d, measured = described(load_lab(case / "lab.toml"), emulated, 0)
    prepared = prepared_diagnosis(d, measured, 0, setup)
    found = compare(prepared, measured)
    truth = label(prepared.classes, tuple(hidden)) if hidden else NONE
    first = max((n for n in found.by_class if n not in (NONE, UNKNOWN)), key=found.by_class.get)
    return {
        "case": case.name, "verdict": found.verdict, "stated": found.stated, "truth": truth,
        "right": found.verdict == truth, "first_effect": first, "first_right": first == truth,
        "p_gap": found.summary.p_before, "unconfined_scatter": found.noise.amplitudes["unconfined"],
    }  # fmt: skip


@cache
def judged_by() -> str:
    """A name for this state of library and diagnosis."""
    library = hashlib.sha256(store.bundled_library().read_bytes()).hexdigest()
    return f"verdicts-{library[:8]}-{source_hash(described, prepared_diagnosis, compare)[:8]}"


def judged(part: str, work: Path, emulated: EmulatedLibrary) -> list[dict]:
    """All cases of a part, made and judged if they are not yet."""
    counts, seed = PARTS[part]
    out, progress = work / part.replace(" ", "_"), for_terminal()
    out.mkdir(parents=True, exist_ok=True)
    run.generate(out, emulated, counts, seed, progress, first_seed=FIRST_SEED)
    labels, setup, rows = open_seal(out), InferenceSetup(), []
    for case in run.case_folders(out):
        kept, truth = out / judged_by() / f"{case.name}.json", labels[case.name]
        if not kept.exists():
            hidden = [one["name"] for one in truth["hidden"]]
            kept.parent.mkdir(exist_ok=True)
            write_json(kept, verdict_of(case, emulated, setup, hidden))
        more = {key: truth[key] for key in ("stratum", "planned_snr", "spheres", "porosity")}
        rows.append({**json.loads(kept.read_text()), **more})
    return rows


def table(rows: Sequence[dict]) -> list[str]:
    lines = ["| hidden | spheres | signal-to-noise | verdict | stated | p of a gap |",
             "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for row in sorted(rows, key=lambda r: (r["truth"] != NONE, r["stratum"], r["truth"])):
        lines.append(
            f"| {row['truth']} | {row['spheres']} | {row['planned_snr']:.1f} | "
            f"{row['verdict']}{'' if row['right'] else ' *'} | {row['stated']:.2f} | "
            f"{row['p_gap']:.3f} |"
        )
    return lines


def summary(rows: Sequence[dict]) -> dict[str, dict[str, int]]:
    """How many of how many are right."""
    sound = [row for row in rows if row["truth"] == NONE]
    kinds = {
        "nothing hidden, 1100 spheres": [r for r in sound if r["spheres"] < FINER],
        "nothing hidden, 2200 spheres": [r for r in sound if r["spheres"] > FINER],
        "signal-to-noise 2 to 6": [r for r in rows if r["stratum"] == "2-6"],
        "signal-to-noise above 6": [r for r in rows if r["stratum"] == "above 6"],
    }  # fmt: skip
    return {
        name: {
            "right": sum(r["right"] for r in some), "cases": len(some),
            "unknown": sum(r["verdict"] == UNKNOWN for r in some),
            "none": sum(r["verdict"] == NONE for r in some),
        }
        for name, some in kinds.items() if some
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    kept = reporting.CACHE / "open_cases"
    parser.add_argument("--work", type=Path, default=kept, help="folder for simulations")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    chosen = parser.parse_args()
    runtime.configure()
    library = store.load(store.bundled_library())
    emulated = EmulatedLibrary.of(library)
    rows = [row for part in chosen.parts for row in judged(part, chosen.work, emulated)]
    print("\n".join(table(rows)))
    written(rows, library)


def written(rows: Sequence[dict], library: RunLibrary) -> None:
    """The results file of these cases."""
    found, origin = summary(rows), reporting.provenance()
    content = {"summary": found, "rows": rows, "library": len(library.values),
               "library_engine": library.engine, **origin}  # fmt: skip
    lines = ["| cases | right | called none | called unknown |", "| --- | --- | --- | --- |"]
    lines += [
        f"| {name} | {n['right']} of {n['cases']} | {n['none']} | {n['unknown']} |"
        for name, n in found.items()
    ]
    text = "\n".join(["# Open cases", "", *lines, "", "\\* wrong", "", *table(rows)])
    reporting.write("open_cases", content, text + "\n" + reporting.footer(origin))


if __name__ == "__main__":
    main()
