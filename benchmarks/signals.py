"""Is an effect as visible as the bank says?  Planned and simulated signal-to-noise.

Cases are planned as `calibrate withheld` plans them, from a known seed, on packings of their
own; of each effect the first `--each` strong cases that stand are simulated with the effect
and without it on the same four packings.  What is left of the mean change once calibration
has absorbed what it can, over the scatter of four specimens, is compared with what the plan
took it for; the cosine says whether the change has the predicted shape at all.

    python benchmarks/signals.py                    # some minutes
    python benchmarks/signals.py --each 5

Writes benchmarks/results/signals.json and .md.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import reporting

from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.design import CENTRE
from calibrate.discrepancy.library.store import bundled_library, load
from calibrate.validation.laboratory import Laboratory
from calibrate.validation.plan import Planner, Visibility, WithheldCase

COUNTS = {"none": 10, "2-6": 8, "above 6": 26}  # of the plan
FIRST_SEED = 1_500_000  # of packings; not those of withheld cases
STRONG = "above 6"
HEADER = ["effect", "planned", "by the bank at the soil that stood", "simulated", "cosine"]


def main() -> None:
    parser = argparse.ArgumentParser(description="Planned and simulated signal-to-noise.")
    parser.add_argument("--seed", type=int, default=4242, help="of the plan")
    parser.add_argument("--each", type=int, default=2, help="cases of an effect")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE / "signals")
    given = parser.parse_args()
    reporting.configure()
    ready = EmulatedLibrary.of(load(bundled_library()))
    laboratory = Laboratory(given.folder, CENTRE)
    rows = []
    plan = Planner(ready, given.seed, FIRST_SEED).cases(COUNTS)
    for case in chosen(plan, laboratory, given.each):
        rows.append(compared(case, laboratory, ready))
        print(rows[-1], flush=True)
    reporting.write("signals", {"cases": rows, **reporting.provenance()}, page(rows))


def chosen(
    plan: list[list[WithheldCase]], laboratory: Laboratory, each: int
) -> Iterator[WithheldCase]:
    """The first standing attempts of strong cases, at most `each` of an effect."""
    taken = Counter()
    for attempts in plan:
        first = attempts[0]
        key = tuple(h.name for h in first.hidden)
        if first.stratum != STRONG or taken[key] >= each:
            continue
        standing = (case for case in attempts if laboratory.specimens(case) is not None)
        case = next(standing, None)
        if case is not None:
            taken[key] += 1
            yield case


def compared(case: WithheldCase, laboratory: Laboratory, ready: EmulatedLibrary) -> dict:
    """What the plan, the bank at the soil that stands, and simulations say of one case."""
    visible, changes = Visibility(ready, case.soil), laboratory.changes(case)
    strengths = {h.name: h.strength for h in case.hidden}
    mean, said = visible.world.projected(
        np.column_stack([changes.mean(axis=0), visible.change(strengths)])
    ).T
    return {
        "effect": case.hidden[0].name,
        "strength": case.hidden[0].strength,
        "planned": case.snr,
        "by_the_bank": visible.snr(strengths),
        "simulated": visible.realised(changes),
        "cosine": float(mean @ said / np.linalg.norm(mean) / np.linalg.norm(said)),
        "packings": len(changes),
    }


def page(rows: list[dict]) -> str:
    """The table, effect by effect."""
    keys = ("planned", "by_the_bank", "simulated")
    lines = [
        [r["effect"], *(f"{r[k]:.1f}" for k in keys), f"{r['cosine']:.2f}"]
        for r in sorted(rows, key=lambda r: (r["effect"], -r["planned"]))
    ]
    text = (
        "Projected signal-to-noise of single effects, as planned from the bank, and as simulated"
        " with and without the effect on four packings, free of what packings differ by; cosine"
        " of the simulated change with the predicted one."
    )
    made = reporting.footer(reporting.provenance())
    return f"# Signals\n\n{text}\n\n{reporting.table(HEADER, lines)}{made}"


if __name__ == "__main__":
    main()
