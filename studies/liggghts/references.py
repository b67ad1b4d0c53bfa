"""What the diagnosis says of another code's specimens in which nothing is hidden.

    python -m studies.liggghts.generate --work results/liggghts/reference_runs
        --out results/liggghts/reference --cases 12 --nothing-hidden --seed 4711
    python -m studies.liggghts.references          half a minute for each case and way

Each case is judged as if its lab file did not say whose conventions the soil follows, as it is, and
with a model discrepancy that was learned from the other cases.  Writes results/references.json, of
which `diagnosis.py` makes lines of its page; what is judged already is kept under results/liggghts.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from calibrate.core import runtime
from calibrate.core.files import write_json
from calibrate.discrepancy import model_discrepancy
from calibrate.discrepancy.comparison.compare import compare
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.diagnosis import (
    answered,
    described,
    prepared_diagnosis,
)
from calibrate.discrepancy.library.description import ModelDiscrepancy
from calibrate.discrepancy.model_discrepancy import BaseFitResidual
from calibrate.io.lab import Lab, load_lab
from jdem.materials.conventions import DEFAULT
from studies import open_cases, reporting

FOLDER = Path("results/liggghts/reference")
OWN_ROLLING = 0.1  # where a fit of the simulator's own conventions starts
AS_IF_UNKNOWN, AS_STATED = "conventions not stated", "conventions stated"
WITH_OTHERS = "conventions stated, difference learned from the other cases"


def without_conventions(lab: Lab) -> Lab:
    """A lab that does not say whose conventions its soil follows."""
    own = replace(lab.parameters["rolling_friction"], value=OWN_ROLLING)
    return replace(lab.following(DEFAULT), parameters={**lab.parameters, "rolling_friction": own})


def judged(lab: Lab, discrepancy: ModelDiscrepancy | None = None) -> dict:
    """What the command says of a lab, and what is likeliest before it asks for grounds."""
    emulated = open_cases.emulated()
    read, d, measured = described(lab, emulated, 0, discrepancy)
    found = compare(prepared_diagnosis(d, measured, 0), measured)
    last, _ = answered(lab, emulated, read, d, measured, found, 0)
    return {
        "verdict": last.verdict, "reason": last.reason, "likeliest": found.verdict,
        "stated": found.stated, "p_gap": found.summary.p_before,
        "misfit": found.base.objective, "features": len(d.features),
        "directions": 0 if discrepancy is None else discrepancy.directions.shape[1],
    }  # fmt: skip


def of_others(left: Sequence[BaseFitResidual | None], number: int) -> ModelDiscrepancy:
    """What all cases but one teach."""
    known = [one for i, one in enumerate(left) if i != number and one is not None]
    return model_discrepancy.of_references(known, len(open_cases.emulated().library.features))


def rows(labs: Sequence[Lab], folder: Path) -> Iterator[dict]:
    """Every case in every way, what is judged already from its file."""
    left = [model_discrepancy.base_fit_residual(lab, open_cases.emulated(), 0) for lab in labs]
    for number, lab in enumerate(labs):
        case = Path(lab.file).parent.name
        kept = folder / open_cases.judged_by() / f"{case}.json"
        if not kept.exists():
            ways = {
                AS_IF_UNKNOWN: judged(without_conventions(lab)),
                AS_STATED: judged(lab),
                WITH_OTHERS: judged(lab, of_others(left, number)),
            }
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_json(kept, [{"case": case, "way": way, **said} for way, said in ways.items()])
        yield from json.loads(kept.read_text(encoding="utf-8"))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--folder", type=Path, default=FOLDER, help="what generate.py wrote")
    folder = parser.parse_args().folder
    runtime.configure()
    labs = [load_lab(path) for path in sorted(folder.glob("cases/*/lab.toml"))]
    found = list(rows(labs, folder))
    for way in (AS_IF_UNKNOWN, AS_STATED, WITH_OTHERS):
        named = [row["verdict"] for row in found if row["way"] == way and row["verdict"] != NONE]
        print(f"{way}: something named in {len(named)} of {len(labs)}: {', '.join(named)}")
    reporting.write_content("references", {**reporting.provenance(), "cases": found})


if __name__ == "__main__":
    main()
