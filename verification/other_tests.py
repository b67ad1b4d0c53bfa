"""Does a soil that was calibrated on two compression tests predict a shear box and a cone?

Hidden soils of `verification.hidden_soils` were measured by depression depth and crushing force.
Of each, soils that these two numbers leave possible are drawn from the posterior (by brute force on
the library of runs) and simulated in tests that took no part; the hidden soil itself is simulated
on packings that none of them saw.  Its mean is to lie within the interval of one specimen.

Of the cone the mean force is read while its tip goes in, which all runs reach.  Deeper, some
runs end where the cone index is a third of the shear modulus or more: in the one that was looked at
a sphere had passed through the cone.

    python -m verification.other_tests                 some five hours of a core
    python -m verification.other_tests --soils 7 8 9 --tests direct_shear

Soils that verification/results/other_tests.json holds are not made again; runs are kept in
results/benchmarks.  Writes a section of verification/results/posterior.md after each soil.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from calibrate.core.files import write_text
from calibrate.core.progress import for_terminal
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.composite import label
from calibrate.labtests.measured import Target
from calibrate.simulation import Run, specimens
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import Preset
from verification import reporting
from verification.hidden_soils import DRAWN, STANDARD, Prior
from verification.posterior import question_of, share_of

SOILS = 10
DRAWN_ON = (7000, 7001, 7006, 7007, 7008, 7009)  # packings, one for each drawn soil
HIDDEN_ON = (7002, 7003)  # packings of the hidden one
SHARE = 0.9  # of specimens that an interval is to hold
BOX_NUMBERS = ("peak_shear_stress_kpa", "residual_shear_stress_kpa", "plane_stress_kpa")
CONE_FORCE = "cone_force_n"
GOING_IN = (-7.0, -1.0)  # mm, depths of the base: the tip is 10.8 to 16.8 mm deep
BOX = """
[soil]
name = "in a shear box"

[specimen]
diameter = "61.8 mm"
height = "20 mm"

[[tests]]
type = "direct_shear"
normal_stress = "50 kPa"
gap = "1 mm"  # 0.3 of a sphere
targets.peak_shear_stress = { mean = "60 kPa", scatter = "5 kPa", repeats = 4 }  # not looked at
"""
CONE = """
[soil]
name = "under a cone"

[specimen]
diameter = "42 mm"
height = "27 mm"

[[tests]]
type = "cone_penetration"
diameter = "20.5 mm"
angle = 60  # ISO 22476-1; at 30 degrees the bed would have to be twice as high
depth_from = "1 mm"
depth_to = "6 mm"
targets.cone_index = { mean = "1 MPa", scatter = "0.1 MPa", repeats = 4 }  # not looked at
"""


def box_numbers(run: Run) -> dict[str, float]:
    """Of a shear box; none of a run that failed."""
    return {} if run.failure else {name: run.observables[name] for name in BOX_NUMBERS}


def cone_force(run: Run) -> dict[str, float]:
    """The mean force (N) while the tip goes in, by depth; none of a run that ended before."""
    depth, force = run.curves["cone_penetration"].T
    low, high = GOING_IN
    if not depth.size or depth.max() < high:
        return {}
    places = np.linspace(low, high, 400)
    return {CONE_FORCE: float(np.interp(places, depth, force).mean())}


@dataclass(frozen=True)
class Asked:
    """A test that took no part: where it is made, its lab file, the preset, how many soils of a
    posterior are simulated, each on a packing of its own, and what is read of a run."""

    where: str
    lab: str
    preset: Preset
    draws: int
    read: Callable[[Run], dict[str, float]]


# Spheres so small that the cone is ten wide; at 0.1 m/s the inertial number is 5e-4.
AT_CONE = replace(STANDARD, spheres=5150, rate_free=0.1, dtype="float32")
TESTS = {
    "direct_shear": Asked(
        "in a shear box 20 spheres wide", BOX, STANDARD, draws=6, read=box_numbers
    ),
    "cone_penetration": Asked(
        "under a cone of 60 degrees, ten spheres wide at its base in a mould of 20, whose mean "
        "force is read while the base is 7 to 1 mm above the surface (there the cone is 6.2 to 9.6 "
        "spheres wide; all runs come so far, and the range was chosen after that was seen)",
        CONE,
        AT_CONE,
        draws=4,
        read=cone_force,
    ),
}


def other_lab(path: Path, text: str) -> Lab:
    """The bundled soil in a test."""
    write_text(path, text)
    bundled, written = load_lab(bundled_lab()), load_lab(path)
    names = ("density_kg_m3", "particles", "parameters")
    return replace(written, targets={}, **{name: getattr(bundled, name) for name in names})


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is needed to predict a test of hidden soils."""

    asked: Asked
    lab: Lab
    work: AbstractCampaign
    prior: Prior

    def soil(self, number: int, entry: dict) -> dict:
        """Of one hidden soil: truth and prediction by observable."""
        question = question_of(_measured(entry), STANDARD)
        weights = self.prior.weights(question.density(question.own_error(), []))
        random = np.random.default_rng(number)
        drawn = random.choice(len(weights), self.asked.draws, p=weights)
        base, names = base_soil(self.lab), question.space.names
        soils = [
            with_values(base, dict(zip(names, np.exp(self.prior.logs[n]), strict=True)))
            for n in drawn
        ]
        hidden = with_values(base, entry["hidden"])
        (runs,) = self.work.each([soils], DRAWN_ON[: len(soils)], "soils of the posterior")
        (truth,) = self.work.runs([hidden], HIDDEN_ON, f"hidden soil {number}")
        found = compared([self.asked.read(r) for r in runs], [self.asked.read(r) for r in truth])
        ended = sum(bool(run.failure) for run in [*runs, *truth])
        return {name: row | {"ended": ended} for name, row in found.items()}


def compared(drawn: list[dict[str, float]], hidden: list[dict[str, float]]) -> dict[str, dict]:
    """By number: middle and half-width of the interval in which SHARE of specimens are expected,
    the mean over packings of the hidden soil, and whether it lies within.

    Each drawn soil was on one packing, so luck is in their scatter, and the interval is that of one
    specimen: a little wide for a mean of several.  A number of fewer than two soils, or of no
    packing of the hidden one, is left out."""
    found = {}
    for name in dict.fromkeys(name for row in [*drawn, *hidden] for name in row):
        values, truth = (
            np.array([row[name] for row in rows if name in row]) for rows in (drawn, hidden)
        )
        if len(values) < 2 or not len(truth):
            continue
        spread = values.std(ddof=1) * np.sqrt(1 + 1 / len(values))
        half = float(student.ppf(0.5 + SHARE / 2, len(values) - 1) * spread)
        middle, mean = float(values.mean()), float(truth.mean())
        measured = {"mean": mean, "half_width": half, "holds": abs(mean - middle) <= half}
        found[name] = {"middle": middle, "soils": len(values), "measured": measured}
    return found


def _measured(entry: dict) -> Lab:
    """The bundled lab with the numbers of a hidden soil."""
    targets = {n: Target(mean, entry["scatter"][n], 3) for n, mean in entry["measured"].items()}
    return replace(load_lab(bundled_lab()), targets=targets)


# ---------------------------------------------------------------- the page

NUMBERS = {name: label(name) for name in BOX_NUMBERS} | {
    CONE_FORCE: "mean force on the cone as its tip goes in (N)"
}


def markdown(found: dict[str, dict], origin: dict) -> str:
    header = ("soil", "number", "expected", "90 % lie within", "hidden soil", "inside")
    rows = [
        _row(number, name, numbers[name])
        for name in NUMBERS
        for number, numbers in found.items()
        if name in numbers
    ]
    return (
        "# Tests that took no part\n\n"
        f"{len(found)} hidden soils, measured by depression depth and crushing force alone. "
        + "".join(_design(test, found) for test in TESTS)
        + "Each was on a packing of its own; the hidden soil's number is the mean over "
        f"{len(HIDDEN_ON)} others.\n\n"
        + reporting.table(header, rows)
        + "\n"
        + _summary(found)
        + reporting.footer(origin)
    )


def _design(test: str, found: dict[str, dict]) -> str:
    """What was simulated, where any soil was."""
    count = sum(test in numbers["tests"] for numbers in found.values())
    asked = TESTS[test]
    said = (
        f"For {count} of them {asked.draws} soils of the posterior were simulated {asked.where}. "
    )
    return said if count else ""


def _row(number: str, name: str, row: dict) -> list[str]:
    measured = row["measured"]
    return [
        number, NUMBERS[name], f"{row['middle']:.4g}", f"± {measured['half_width']:.2g}",
        f"{measured['mean']:.4g}", "yes" if measured["holds"] else "NO",
    ]  # fmt: skip


def _summary(found: dict[str, dict]) -> str:
    said = []
    for name in NUMBERS:
        rows = [numbers[name] for numbers in found.values() if name in numbers]
        if not rows:
            continue
        holds = np.array([row["measured"]["holds"] for row in rows])
        off = np.abs([row["measured"]["mean"] / row["middle"] - 1 for row in rows])
        wide = [row["measured"]["half_width"] / row["middle"] for row in rows]
        ended = sum(row.get("ended", 0) for row in rows)
        said.append(
            f"- {NUMBERS[name]}: {holds.sum()} of {len(rows)} intervals hold the hidden soil's "
            f"mean ({share_of(holds)}); it is off by {100 * np.median(off):.0f} % (middle; at most "
            f"{100 * off.max():.0f} %), and the half-width is {100 * np.median(wide):.0f} %."
            + (f" {ended} runs ended early." if ended else "")
            + "\n"
        )
    return "".join(said)


def predicted(test: str, drawn: int) -> Predicted:
    """This test, with so many soils of the prior."""
    asked = TESTS[test]
    lab = other_lab(reporting.CACHE / "other_tests" / f"{test}.toml", asked.lab)
    question = question_of(load_lab(bundled_lab()), STANDARD)
    prior = Prior.of(question, question.density(question.own_error(), []), drawn)
    work = specimens.campaign(lab, asked.preset, reporting.CACHE, for_terminal())
    return Predicted(asked, lab, work, prior)


def note(number: int, test: str, numbers: dict) -> None:
    """Keeps a soil's numbers of a test, and writes the section."""
    found = dict(reporting.earlier("other_tests", "soils"))
    known = found.get(str(number), {})
    tests = [*known.get("tests", ()), test]
    found[str(number)] = {**known, **numbers, "tests": tests}
    found = dict(sorted(found.items(), key=lambda each: int(each[0])))
    origin = {**reporting.provenance(), "command": "python -m verification.other_tests"}
    reporting.write_content("other_tests", {**origin, "soils": found})
    reporting.write_section("posterior", markdown(found, origin))


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--soils", nargs="+", type=int, default=list(range(SOILS)))
    parser.add_argument("--tests", nargs="+", default=list(TESTS), choices=list(TESTS))
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of the prior")
    chosen = parser.parse_args()
    reporting.configure()
    hidden = reporting.earlier("hidden_soils", "entries")
    for test in chosen.tests:
        about = predicted(test, chosen.drawn)
        for number in chosen.soils:
            known = reporting.earlier("other_tests", "soils").get(str(number), {})
            if test not in known.get("tests", ()):
                note(number, test, about.soil(number, hidden[str(number)]))


if __name__ == "__main__":
    main()
