"""Does a soil that was calibrated on two compression tests predict a shear box and a cone?

Hidden soils of `verification.hidden_soils` were measured by depression depth and crushing force.
Of each, soils that these two numbers leave possible are drawn from the posterior (by brute force on
the library of runs) and simulated in tests that took no part; the hidden soil itself is simulated
on packings that none of them saw.  Its mean is to lie within the interval for so many specimens.

    python -m verification.other_tests                 some two hours of a core
    python -m verification.other_tests --soils 0 1 --tests direct_shear

Soils that verification/results/other_tests.json holds are not made again; runs are kept in
results/benchmarks.  Writes a section of verification/results/posterior.md after each soil.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibrate.core.files import write_text
from calibrate.core.progress import for_terminal
from calibrate.inference.prediction import by_runs, prediction_json
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.composite import label
from calibrate.labtests.measured import Target
from calibrate.simulation import specimens
from calibrate.simulation.joint import AbstractCampaign
from verification import reporting
from verification.hidden_soils import DRAWN, STANDARD, Prior
from verification.posterior import question_of, share_of

SOILS, DRAWS, PACKINGS, TRUTH = 10, 6, 2, 4
FIRST = 7000  # seed of the packings of drawn soils; those of the hidden ones come after
TESTS = ("direct_shear", "cone_penetration")
OBSERVABLES = ("peak_shear_stress_kpa", "residual_shear_stress_kpa", "cone_index_kpa")
LAB = """
[soil]
name = "in a shear box and under a cone"

[specimen]
diameter = "61.8 mm"
height = "20 mm"

[[tests]]
type = "direct_shear"
normal_stress = "50 kPa"
gap = "1 mm"  # 0.3 of a sphere
targets.peak_shear_stress = { mean = "60 kPa", scatter = "5 kPa", repeats = 4 }  # not looked at

[[tests]]
type = "cone_penetration"
diameter = "12.83 mm"
shaft = "9.53 mm"
depth_from = "10 mm"
depth_to = "30 mm"
specimen = { diameter = "60 mm", height = "70 mm" }
"""


def other_lab(path: Path, tests: Sequence[str]) -> Lab:
    """The bundled soil in these tests."""
    write_text(path, LAB)
    bundled, written = load_lab(bundled_lab()), load_lab(path)
    names = ("density_kg_m3", "particles", "parameters")
    kept = tuple(test for test in written.tests if test.called in tests)
    soil = {name: getattr(bundled, name) for name in names}
    return replace(written, tests=kept, targets={}, **soil)


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is needed to predict other tests of hidden soils."""

    lab: Lab
    work: AbstractCampaign
    prior: Prior

    def soil(self, number: int, entry: dict) -> dict:
        """Of one hidden soil: truth and prediction by observable."""
        question = question_of(_measured(entry), STANDARD)
        weights = self.prior.weights(question.density(question.own_error(), []))
        drawn = np.random.default_rng(number).choice(len(weights), DRAWS, p=weights)
        base, names = base_soil(self.lab), question.space.names
        soils = [
            with_values(base, dict(zip(names, np.exp(self.prior.logs[n]), strict=True)))
            for n in drawn
        ]
        found = by_runs(self.work, soils, range(FIRST, FIRST + PACKINGS))
        hidden = with_values(base, entry["hidden"])
        seeds = range(FIRST + PACKINGS, FIRST + PACKINGS + TRUTH)
        runs = self.work.runs([hidden], seeds, f"hidden soil {number}")[0]
        truth = specimens.summary_json(runs)
        targets = {
            name: {"mean": mean, "repeats": len(runs)}
            for name, mean in truth["observables"].items()
        }
        return prediction_json(found, targets)["observables"]


def _measured(entry: dict) -> Lab:
    """The bundled lab with the numbers of a hidden soil."""
    targets = {n: Target(mean, entry["scatter"][n], 3) for n, mean in entry["measured"].items()}
    return replace(load_lab(bundled_lab()), targets=targets)


# ---------------------------------------------------------------- the page


def markdown(found: dict[str, dict], origin: dict) -> str:
    header = ("soil", "number", "expected", "90 % of means lie within", "hidden soil", "inside")
    rows = [
        _row(number, name, numbers[name])
        for number, numbers in found.items()
        for name in OBSERVABLES
        if name in numbers
    ]
    return (
        "# Tests that took no part\n\n"
        f"{len(found)} hidden soils, measured by depression depth and crushing force alone. "
        f"{DRAWS} soils of each posterior were simulated on {PACKINGS} packings, and the hidden "
        f"one on {TRUTH} others.\n\n"
        + reporting.table(header, rows) + "\n" + _summary(found) + reporting.footer(origin)
    )  # fmt: skip


def _row(number: str, name: str, row: dict) -> list[str]:
    measured = row["measured"]
    return [
        number, label(name), f"{row['middle']:.4g}", f"± {measured['half_width']:.2g}",
        f"{measured['mean']:.4g}", "yes" if measured["holds"] else "NO",
    ]  # fmt: skip


def _summary(found: dict[str, dict]) -> str:
    said = []
    for name in OBSERVABLES:
        rows = [numbers[name] for numbers in found.values() if name in numbers]
        if not rows:
            continue
        holds = np.array([row["measured"]["holds"] for row in rows])
        off = np.abs([row["measured"]["mean"] / row["middle"] - 1 for row in rows])
        wide = [row["measured"]["half_width"] / row["middle"] for row in rows]
        said.append(
            f"- {label(name)}: {holds.sum()} of {len(rows)} intervals hold the hidden soil's mean "
            f"({share_of(holds)}); it is off by {100 * np.median(off):.0f} % (middle; at most "
            f"{100 * off.max():.0f} %), and the half-width is {100 * np.median(wide):.0f} %.\n"
        )
    return "".join(said)


def predicted(tests: Sequence[str], drawn: int) -> Predicted:
    """These tests, with so many soils of the prior."""
    lab = other_lab(reporting.CACHE / "other_tests" / "lab.toml", tests)
    question = question_of(load_lab(bundled_lab()), STANDARD)
    prior = Prior.of(question, question.density(question.own_error(), []), drawn)
    work = specimens.campaign(lab, STANDARD, reporting.CACHE, for_terminal())
    return Predicted(lab, work, prior)


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--soils", nargs="+", type=int, default=list(range(SOILS)))
    parser.add_argument("--tests", nargs="+", default=list(TESTS), choices=TESTS)
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of the prior")
    chosen = parser.parse_args()
    reporting.configure()
    hidden, about = (
        reporting.earlier("hidden_soils", "entries"),
        predicted(chosen.tests, chosen.drawn),
    )
    for number in chosen.soils:
        found = dict(reporting.earlier("other_tests", "soils"))
        known = found.get(str(number), {})
        if not set(chosen.tests) <= set(known.get("tests", ())):
            numbers = {**known, **about.soil(number, hidden[str(number)])}
            found[str(number)] = {**numbers, "tests": [*known.get("tests", ()), *chosen.tests]}
        found = dict(sorted(found.items(), key=lambda each: int(each[0])))
        origin = {**reporting.provenance(), "command": "python -m verification.other_tests"}
        reporting.write_content("other_tests", {**origin, "soils": found})
        reporting.write_section("posterior", markdown(found, origin))


if __name__ == "__main__":
    main()
