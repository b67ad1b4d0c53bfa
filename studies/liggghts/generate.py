"""Generate cases whose reality LIGGGHTS computes, with sealed labels.

    python -m studies.liggghts.generate --work DIR --out OUT --cases 67 --jobs 2

Without --seed, a secret one is drawn into DIR/seed.  Finished specimens lie in DIR and are not
repeated, nor are cases that OUT holds, so the command may be stopped and given again.  A case
appears in OUT/cases when all its specimens stand; then its label joins OUT/sealed and its hash
OUT/labels.sha256.  Needs the `liggghts` program (Debian package of that name).
"""

import argparse
import json
import secrets
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

import numpy as np

from studies.liggghts.cases import ATTEMPTS, SPECIMENS, THIRDS, Case, accepted, plan
from studies.liggghts.labfiles import Specimen, measured, write_case
from studies.liggghts.specimen import Run, run
from studies.sealed.seal import open_seal, write_seal


def specimen_run(case: Case, attempt: int, number: int, work: Path) -> Run:
    """One specimen, from disk if it has been computed."""
    saved = work / f"{case.name}-{attempt}-{number}.npz"
    if saved.exists():
        with np.load(saved) as old:
            facts = json.loads(str(old["facts"]))
            numbers = [float(value) for value in old["numbers"]]
            return Run(numbers[0] == 1, numbers[1], numbers[2], old["first"], old["second"], facts)
    setup = case.setup(attempt)
    seed = case.specimen_seed(attempt, number)
    new = run(setup.soil, setup.physics, setup.instrument, seed, work / "runs" / case.name)
    np.savez_compressed(
        saved, facts=json.dumps(new.facts), numbers=[new.stands, new.height, new.mass],
        first=new.confined, second=new.unconfined,
    )  # fmt: skip
    return new


def attempt_case(case: Case, attempt: int, work: Path) -> list[Run] | None:
    """The runs of one attempt, or None as soon as it is not acceptable."""
    runs: list[Run] = []
    for number in range(SPECIMENS):
        runs.append(specimen_run(case, attempt, number, work))
        if not runs[-1].stands:
            return None
    good = accepted([r.depth_mm() for r in runs], [r.crushing_n() for r in runs])
    return runs if good else None


def made_before(out: Path) -> dict[str, dict]:
    """The labels by case of what a folder holds already."""
    return open_seal(out) if (out / "sealed").exists() else {}


def make_case(case: Case, work: Path, out: Path, made: dict[str, dict]) -> dict | None:
    """Simulate and write one case, unless it is made; its label, or None if no attempt was
    acceptable."""
    if case.name in made:
        return made[case.name]
    for attempt in range(ATTEMPTS):
        runs = attempt_case(case, attempt, work)
        if runs is not None:
            random = np.random.default_rng([case.seed, attempt, 10**6])
            instrument = case.setup(attempt).instrument
            specimens: list[Specimen] = [measured(r, instrument, random) for r in runs]
            write_case(case.name, specimens, out / "cases" / case.name)
            return case.label(attempt)
    return None


def master_seed(work: Path, given: int | None) -> int:
    """The seed given, or that of `work`, drawn at the first start."""
    kept = work / "seed"
    if given is None and not kept.exists():
        kept.write_text(f"{secrets.randbits(62)}\n")
    return int(kept.read_text()) if given is None else given


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=67)
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--nothing-hidden", action="store_true")
    what.add_argument("--strong", action="store_true", help="single effects from the upper third")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    seed, labels = master_seed(options.work, options.seed), []
    thirds = THIRDS[-1:] if options.strong else THIRDS
    planned = plan(options.cases, seed, options.nothing_hidden, thirds)
    (options.work / "plan.json").write_text(json.dumps([asdict(c) for c in planned], indent=1))
    made = made_before(options.out)
    with ThreadPoolExecutor(options.jobs) as pool:
        results = [pool.submit(make_case, c, options.work, options.out, made) for c in planned]
        for case, result in zip(planned, results, strict=True):
            label = result.result()
            print(case.name, "written" if label else "given up", flush=True)
            if label:
                labels.append(label)
                write_seal(labels, options.out)


if __name__ == "__main__":
    main()
