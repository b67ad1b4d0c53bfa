"""How many further tests it takes to name what is hidden in another code's specimens.

    python -m studies.liggghts.further --given results/liggghts/sealed
        --discrepancy results/liggghts/discrepancy.json --work results/liggghts/further
        [--others 3]                              some two minutes for each test that needs soil

An opened set of LIGGGHTS: the cases whose one effect has a signal-to-noise above 1, and some with
nothing hidden or with an effect that the library lacks.  Up to three tests a case are made, as
`calibrate next` asks for them:

    test again      two fresh specimens of the case's soil, by LIGGGHTS; effects kept away or
                    scaled as the test's table says.  Nothing in this soil depends on rate: slower
                    or faster, only the machine's clock changes
    machine alone   the case's machine about a rigid block, and a known weight on its load cell
    hold            the force of spheres at rest stays, its reading drifts

Both tests of an hour at once are scored too; tests at random are not, for each needs specimens of
its own.  Answers and verdicts are kept in --work, so that a stopped run goes on; the rows join
results/withheld_liggghts.json.xz.  `diagnosis.py` makes the page.
"""

import argparse
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from calibrate.core import runtime
from calibrate.core.files import write_json
from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison.next_test import Proposal
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.library.further_tests import HOLD, REPEATS
from calibrate.discrepancy.model_discrepancy import load
from calibrate.io.lab import Lab, load_lab
from calibrate.labtests.diagnosis.curves import TEST_FEATURES
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.relaxation import RelaxationTest
from studies import further_tests, open_cases, reporting
from studies.liggghts.cases import SPECIMENS, Case, Hidden
from studies.liggghts.generate import specimen_run
from studies.liggghts.instrument import Instrument, lagged, seat_travel
from studies.liggghts.labfiles import measured
from studies.liggghts.visibility import case_of
from studies.sealed.further import (
    HOLDING,
    AbstractFurtherLaboratory,
    Asking,
    at_rest_after,
    read_in_time,
    variation_of,
)
from studies.sealed.labels import CONVERSIONS, normalised
from studies.sealed.seal import open_seal

RESULT, FURTHER = "withheld_liggghts", "further"
LOADING = 60.0  # s to the largest force on the block, and as long back
POINTS = 200  # each way
HOUR = 3600.0


@dataclass(frozen=True)
class MadeCase:
    """A case and the attempt that was accepted."""

    case: Case
    attempt: int

    @property
    def name(self) -> str:
        return self.case.name

    @property
    def instrument(self) -> Instrument:
        return self.case.setup(self.attempt).instrument

    @property
    def compliance(self) -> float:
        """mm/kN, of the frame."""
        return sum(h.strength for h in self.case.hidden if h.name == "frame_compliance")

    def under(self, factors) -> "MadeCase":
        """The same with strengths of effects, by our names, times factors; 0: without them."""
        hidden = (
            Hidden(h.name, h.strength * factors.get(our_name(h.name), 1.0))
            for h in self.case.hidden
        )
        kept = tuple(h for h in hidden if h.strength)
        return replace(self, case=replace(self.case, hidden=kept))

    def noise(self, asked: Proposal, *more: int) -> np.random.Generator:
        """The noise of a test."""
        return np.random.default_rng([self.case.seed, *asked.name.encode(), *more])


def our_name(theirs: str) -> str:
    return CONVERSIONS[theirs][0] if theirs in CONVERSIONS else theirs


@dataclass(frozen=True, eq=False)
class OtherLaboratory(AbstractFurtherLaboratory[MadeCase]):
    """The laboratory whose soil is LIGGGHTS'."""

    folder: Path

    def curves(self, case: MadeCase, lab: Lab, asked: Proposal) -> list[np.ndarray] | None:
        kind, random = asked.entries["type"], case.noise(asked)
        force = lab.pair().compression.force_high
        if kind == MachineTest.type_name:
            return [block(case, force, random) for _ in range(REPEATS)]
        if kind == RelaxationTest.type_name:
            drift = case.instrument.drift / HOUR * HOLD * HOLDING
            rest = case.instrument.offset
            return [at_rest_after(force, drift, rest, random) for _ in range(REPEATS)]
        return self._again(case, asked, random)

    def reads(self, case: MadeCase, asked: Proposal, weight: float) -> float:
        machine, noise = case.instrument, case.noise(asked, 1).standard_normal()
        return (1 + machine.gain) * weight + machine.offset + machine.noise_force * noise

    def _again(
        self, case: MadeCase, asked: Proposal, random: np.random.Generator
    ) -> list[np.ndarray] | None:
        """Curves of a test again, on specimens that no other test of the case has had."""
        number, test, variation = variation_of(asked)
        condition = TEST_FEATURES[test].varied(variation.faster, variation.entries)
        other, first = case.under(condition.factors), SPECIMENS + REPEATS * number
        work = self.folder.parent / "specimens"
        work.mkdir(parents=True, exist_ok=True)
        found = []
        for specimen in range(first, first + REPEATS):
            run = specimen_run(other.case, other.attempt, specimen, work)
            if not run.stands:
                return None
            record = getattr(measured(run, other.instrument, random), test)
            found.append(np.column_stack([record.displacement, record.force]))
        return found


def block(case: MadeCase, force: float, random: np.random.Generator) -> np.ndarray:
    """A curve (readings, 2), mm and N, of loading a rigid block until the load cell reads a force
    (N), and back."""
    machine = case.instrument
    up = np.linspace(0.0, (force - machine.offset) / (1 + machine.gain), POINTS)
    true = np.concatenate([up, up[::-1]])
    time = np.linspace(0.0, 2 * LOADING, len(true))
    way = 1e-3 * case.compliance * true + 1e3 * seat_travel(true, machine.seat, random)
    drifted = machine.offset + machine.drift / HOUR * time
    reads = (1 + machine.gain) * lagged(time, true, machine.lag) + drifted
    return read_in_time(way, reads, machine.offset, random, float(drifted[-1]))


def judged_by() -> str:
    return f"{further_tests.judged_by()}-liggghts"


def loop(given: Path, discrepancy: Path, work: Path, label: dict) -> dict:
    """Verdicts on a case after 0, 1, ... tests that are asked for, and after both cheap ones."""
    kept = work / judged_by() / f"{label['case']}.json"
    if not kept.exists():
        case = MadeCase(case_of(label), label["attempt"])
        lab = load_lab(given / "cases" / label["case"] / "lab.toml")
        made = OtherLaboratory(work / "answers")
        known = load(discrepancy, open_cases.emulated())
        asking = Asking.of(
            lab, open_cases.emulated(), open_cases.setup(), lambda p: made.answer(case, lab, p),
            known,
        )  # fmt: skip
        found = {
            "asked": asking.by_proposals(), "cheap": asking.all_cheap(),
            "classes": [list(members) for members in asking.prepared.classes.members],
        }  # fmt: skip
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_json(kept, found)
    return json.loads(kept.read_text())


def chosen(labels: dict[str, dict], snr: dict[str, float], others: int) -> list[dict]:
    """Labels of single effects above `VISIBLE`, and of some others, in the order of their names."""
    kinds: dict[str, list[dict]] = {"single": [], NONE: [], "outside": []}
    for name in sorted(labels):
        kind = normalised(labels[name])["kind"]
        if kind in kinds and (kind == NONE or snr[name] > further_tests.VISIBLE):
            kinds[kind].append(labels[name])
    return [*kinds["single"], *kinds[NONE][:others], *kinds["outside"][:others]]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--given", type=Path, required=True, help="the opened set")
    parser.add_argument("--discrepancy", type=Path, required=True, help="that judged it")
    parser.add_argument("--work", type=Path, required=True, help="answers and verdicts")
    parser.add_argument("--others", type=int, default=3, help="nothing hidden, and from outside")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    runtime.configure()
    result = reporting.content_of(reporting.file_of(RESULT))
    snr = {row["case"]: row["snr_simulated"] for row in result["rows"]}
    labels, progress = chosen(open_seal(given.given), snr, given.others), for_terminal()
    progress.start("asking for further tests", len(labels))
    one = partial(loop, given.given, given.discrepancy, given.work)
    apart, rows = multiprocessing.get_context("spawn"), []
    with ProcessPoolExecutor(given.jobs, apart, runtime.configure) as workers:
        for label, found in zip(labels, workers.map(one, labels), strict=True):
            case = label["case"]
            rows.append(further_tests.row_of(case, normalised(label), snr[case], found))
            progress.advance()
    progress.finish()
    for kind in dict.fromkeys(row["kind"] for row in rows):
        some = [row for row in rows if row["kind"] == kind]
        right = np.sum([further_tests.right_after(row, "asked") for row in some], axis=0)
        cheap = sum(row["cheap"]["verdict"] == row["truth"] for row in some)
        print(f"{kind}: {right.tolist()} of {len(some)} after 0, 1, ... tests; {cheap} after both")
    made = {"cases": rows, **reporting.provenance()}
    reporting.write_content(RESULT, {**result, FURTHER: made})


if __name__ == "__main__":
    main()
