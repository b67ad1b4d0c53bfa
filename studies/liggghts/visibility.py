"""How visible effects are in another code's cases, once their seal is open.

    python -m studies.liggghts.visibility --work results/liggghts/sealed_runs
        --given results/liggghts/sealed --discrepancy results/liggghts/discrepancy.json

The library cannot tell what it lacks, nor what another code makes of an effect.  So two specimens
of each case are simulated again without it, from the same seeds, and both are recorded without
noise.  Signal-to-noise is what calibration leaves of that change, with the model discrepancy
that judged the cases: `snr_simulated` in studies/results/withheld_liggghts.json.xz.  What errors
of the machine do follows from equations: of these the library's word is taken.  A minute a
specimen; finished ones lie in DIR.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.discrepancy.model_discrepancy import load
from calibrate.labtests.diagnosis.base import Feature
from calibrate.labtests.diagnosis.curves import TARGETS, TESTS, recorded_feature_values
from calibrate.response.machine import MACHINE
from studies import open_cases, reporting
from studies.liggghts.cases import Case, Hidden
from studies.liggghts.generate import specimen_run
from studies.liggghts.labfiles import measured
from studies.liggghts.specimen import Run
from studies.sealed.labels import FEWEST_CHANGES, THEIRS, normalised
from studies.sealed.plan import USUAL, Visibility
from studies.sealed.scores import SCATTER
from studies.sealed.seal import open_seal


def of_the_soil(label: dict) -> bool:
    """Whether a case hides what moves the mean of its specimens, and not in the machine alone."""
    ours = normalised(label)
    names = {one["name"] for one in ours["hidden"]}
    return ours["kind"] != SCATTER and not names <= set(MACHINE)


def case_of(label: dict) -> Case:
    """A case as it was made."""
    hidden = tuple(Hidden(one["name"], one["strength"]) for one in label["effects"])
    return Case(label["case"], label["kind"], hidden, label["seed"], label["nonce"])


def features_of(run: Run, case: Case, label: dict, features: Sequence[Feature]) -> np.ndarray:
    """Features (m,) of a specimen, recorded by its case's machine without noise."""
    random = np.random.default_rng([case.seed, label["attempt"], 10**6])
    machine = case.setup(label["attempt"]).instrument
    quiet = replace(machine, noise_force=0.0, noise_displacement=0.0)
    specimen = measured(run, quiet, random)
    records = zip(TESTS, (specimen.confined, specimen.unconfined), strict=True)
    return recorded_feature_values(features, {t: (r.displacement, r.force) for t, r in records})


def changes(label: dict, work: Path, features: Sequence[Feature]) -> np.ndarray:
    """What a case's effects do to features (n, m) of as many specimens as own cases have, if they
    stand without them too."""
    case, attempt = case_of(label), label["attempt"]
    without = replace(case, hidden=())
    twins = work / "without"
    twins.mkdir(parents=True, exist_ok=True)
    found = []
    for number in range(FEWEST_CHANGES):
        twin = specimen_run(without, attempt, number, twins)
        if twin.stands:
            both = (specimen_run(case, attempt, number, work), twin)
            with_, own = (features_of(run, case, label, features) for run in both)
            found.append(with_ - own)
    return np.array(found).reshape(-1, len(features))


def visibility(label: dict, found: np.ndarray, discrepancy) -> float:
    """Signal-to-noise of changes (n, m) of a case."""
    emulated = open_cases.emulated().for_lab(USUAL.lab().following(label["conventions"]))
    seen = np.asarray(np.isfinite(found).all(axis=0))
    design = emulated.library.design
    soil = {n: label["soil"].get(n, design.centre[n]) for n in design.soil_names}
    visible = Visibility(emulated, soil, THEIRS, discrepancy, USUAL, seen)
    return visible.realised(found[:, seen])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--work", type=Path, required=True, help="where generate.py simulated")
    parser.add_argument("--given", type=Path, required=True, help="the opened set")
    parser.add_argument("--discrepancy", type=Path, required=True, help="that judged it")
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    runtime.configure()
    discrepancy = load(options.discrepancy, open_cases.emulated())
    result = reporting.content_of(reporting.file_of("withheld_liggghts"))
    labels = [one for one in open_seal(options.given).values() if of_the_soil(one)]
    features = open_cases.emulated().size.features[: -len(TARGETS)]
    with ThreadPoolExecutor(options.jobs) as pool:
        every = list(pool.map(lambda one: changes(one, options.work, features), labels))
    told = {
        label["case"]: visibility(label, found, discrepancy)
        for label, found in zip(labels, every, strict=True)
    }
    for row in result["rows"]:
        row["snr_simulated"] = told.get(row["case"], row["snr"])
    reporting.write_content("withheld_liggghts", result)
    for label in labels:
        print(label["case"], label["effects"], f"{told[label['case']]:.1f}")


if __name__ == "__main__":
    main()
