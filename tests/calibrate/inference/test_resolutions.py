"""Fits across resolutions: ratios in closed form, and a soil of formulas at two sizes of spheres.

The small beds press deeper and are weaker, by a ratio that the soil changes.  The last part takes
slopes from derivatives through forty spheres that are pressed in the mould, and compares them with
differences of runs.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.progress import Silent
from calibrate.inference.calibration import (
    exploring,
    fit_from,
    resolutions_json,
    scatter_of_packings,
)
from calibrate.inference.evaluation import Calibration, packing_scatter
from calibrate.inference.fit import descend, fit
from calibrate.inference.parameters import space
from calibrate.inference.problem import Problem, pose
from calibrate.inference.resolutions import Coarse, Correction, corrected, disagreement, pooled
from calibrate.inference.traced import FirstOrder
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.features import ScalarTarget
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.specimens import Seeds
from tests.support.formulas import BASE, LAB, Formulas, shift

NAMES = ("shear_modulus", "surface_energy")
FEATURES = (
    ScalarTarget("depression_depth_mm", "mm", ""),
    ScalarTarget("crushing_force_n", "N", ""),
)
SEEDS = range(4)


@dataclass
class Small(Formulas):
    """Beds of fewer spheres: depth 1.2 times, force 0.8 times, with a slope of its own."""

    bends: float = 0.1

    def _run(self, soil, seed):
        run = super()._run(soil, seed)
        force = 0.8 * np.exp(self.bends * shift(soil, "surface_energy"))
        depth, strength = (run.observables[f.name] for f in FEATURES)
        values = {"depression_depth_mm": 1.2 * depth, "crushing_force_n": force * strength}
        return replace(run, observables=values)


def truth():
    return space(LAB, NAMES, BASE).start() * [1.5, 0.6]


def calibration(large, small):
    """Two targets that a large bed of the true soil shows, without scatter of the laboratory."""
    hidden = space(LAB, NAMES, BASE).soil(truth())
    runs = large.runs([hidden], range(1000, 1064), "laboratory")[0]
    measured = np.array([list(run.observables.values()) for run in runs]).mean(axis=0)
    problem = Problem(FEATURES, measured, (0.01 * measured) ** 2, np.zeros(2, int))
    scatter = packing_scatter(problem, large.runs([BASE], range(8), "scatter")[0])
    large.simulated = 0
    coarse = None if small is None else Coarse(small, 500, 2000)
    return Calibration(problem, space(LAB, NAMES, BASE), large, SEEDS, scatter, 8, coarse=coarse)


def across(case):
    """The fit from where the small beds' fit ends."""
    smaller = explored(case)
    return fit_from(case, smaller.best, smaller.slopes)


def explored(case):
    """The fit of the small beds to corrected targets."""
    return descend(exploring(case, case.correction(case.space.start(), "start")))


def test_the_ratio_and_its_error_are_those_of_the_means():
    rng = np.random.default_rng(0)
    large, small = rng.normal([2.0, 200.0], [0.1, 20.0], (6, 2)), np.full((3, 2), [4.0, 100.0])
    found = Correction.of(large, small)
    assert found.ratio == pytest.approx(large.mean(axis=0) / [4.0, 100.0])
    spread = large.std(axis=0, ddof=1) / large.mean(axis=0)
    assert found.relative_se == pytest.approx(spread / np.sqrt(6))


def test_failed_runs_do_not_count_and_signs_do_not_scale():
    large = np.array([[2.0, 5.0], [np.nan, np.nan], [2.2, 5.0]])
    small = np.array([[1.0, -5.0], [1.0, -4.0]])
    found = Correction.of(large, small)
    assert found.ratio == pytest.approx([2.1, 1.0])
    assert np.isfinite(found.relative_se[0]) and np.isinf(found.relative_se[1])


def test_corrected_targets_are_what_small_beds_have_to_show():
    problem = Problem(FEATURES, np.array([3.0, 200.0]), np.array([0.01, 16.0]), np.zeros(2, int))
    found = corrected(problem, Correction(np.array([0.8, 1.25]), np.zeros(2)))
    assert found.measured == pytest.approx([3.75, 160.0])
    assert np.sqrt(found.target_variance) / found.measured == pytest.approx([0.1 / 3, 4 / 200])


def test_scatter_of_both_sizes_is_that_of_large_packings():
    """Deviations of 1 and 7 % at 2000 spheres are 2 and 14 % at 500; their correlation is kept."""
    rng, coarse = np.random.default_rng(0), Coarse(Formulas(), 500, 2000)
    shape = np.linalg.cholesky([[1.0, 0.5], [0.5, 1.0]]) * 0.01
    large = [2.0, 200.0] * (1 + rng.normal(size=(4000, 2)) @ shape.T * [1, 7])
    small = [3.0, 150.0] * (1 + rng.normal(size=(8000, 2)) @ shape.T * [2, 14])
    covariance, freedom = pooled(large, small, coarse)
    assert freedom == 11_998
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.01, 0.07], rel=0.03)
    assert covariance[0, 1] == pytest.approx(0.5 * 0.01 * 0.07, rel=0.06)


def test_scatter_of_few_packings_has_no_bias():
    """4 large and 8 small packings, over 2000 draws."""
    rng, coarse = np.random.default_rng(1), Coarse(Formulas(), 500, 2000)
    draws = [
        pooled(1 + 0.01 * rng.normal(size=(4, 1)), 1 + 0.02 * rng.normal(size=(8, 1)), coarse)
        for _ in range(2000)
    ]
    assert np.mean([c[0, 0] for c, _ in draws]) == pytest.approx(1e-4, rel=0.03)
    assert draws[0][1] == 10


def test_with_small_beds_only_the_fitted_packings_of_large_ones_are_run_for_scatter():
    large, small = Formulas(), Small()
    problem = calibration(Formulas(), None).problem
    seeds = Seeds.of(0, 4)
    _, packings = scatter_of_packings(problem, BASE, seeds, large, Coarse(small, 500, 2000))
    assert (large.simulated, small.simulated, packings) == (4, 8, 11)


def test_a_fit_across_resolutions_ends_where_one_with_large_beds_alone_does():
    """Within half of the stated deviation: both stop within the tolerance of their residuals."""
    large = Formulas()
    case = calibration(large, Small())
    result = across(case)
    alone = fit(calibration(large, None))
    apart = np.log(result.best.values / alone.best.values)
    assert np.all(np.abs(apart) < 0.5 * alone.identifiability.sd_log)
    simulated = result.best.features.mean(axis=0)
    assert simulated == pytest.approx(case.problem.measured, rel=0.03)


def test_it_takes_a_third_of_the_large_runs_that_a_fit_without_small_beds_takes():
    alone, both = Formulas(), Formulas()
    fit(calibration(alone, None))
    case = calibration(both, Small())
    across(case)
    assert both.simulated < alone.simulated / 3


def test_slopes_of_small_beds_are_taken_along_and_not_measured_again_at_their_end():
    asked = []

    class Asked(Small):
        def each(self, soils, seeds, what):
            asked.append(what)
            return super().each(soils, seeds, what)

    case = calibration(Formulas(), Asked())
    smaller = explored(case)
    before = len(asked)
    result = fit_from(case, smaller.best, smaller.slopes)
    assert not [what for what in asked[before:] if what.startswith("slopes at evaluation")]
    assert "slopes at the best point" in asked[before:]
    assert result.history[0]["status"] == "better"


def test_small_beds_alone_miss_what_large_ones_show():
    large = Formulas()
    case = calibration(large, Small())
    alone = descend(replace(case, campaign=case.coarse.campaign, coarse=None)).best
    shown = case.evaluate(alone.values, "check").features.mean(axis=0)
    assert abs(shown[0] / case.problem.measured[0] - 1) > 0.1


@dataclass
class Noted(Silent):
    lines: tuple = ()

    def say(self, line):
        self.lines += (line,)


@pytest.mark.parametrize(("bends", "said"), [(0.0, False), (2.0, True)])
def test_sizes_that_disagree_beyond_their_errors_are_said_in_one_sentence(bends, said):
    large = Formulas(progress=Noted())
    case = calibration(large, Small(bends=bends))
    first = case.correction(case.space.start(), "start")
    result = across(case)
    record = resolutions_json(case, first, result)
    lines = [line for line in large.progress.lines if "disagree beyond their errors" in line]
    assert (len(lines) == 1) == said and bool(record["disagree"]) == said
    assert record["explored_spheres"] == 500


def test_a_ratio_without_error_never_disagrees():
    problem = Problem(FEATURES, np.ones(2), np.ones(2), np.zeros(2, int))
    unknown = Correction(np.array([1.0, 2.0]), np.full(2, np.inf))
    assert disagreement(problem, Correction.none(2), unknown) == []


FREE = ("shear_modulus",)
QUICK = replace(PRESETS["quick"], spheres=40)
TARGETS = '[tests.targets]\ndepression_depth = { mean = "3 mm", scatter = "0.1 mm", repeats = 4 }\n'


def laboratory(folder: Path) -> Lab:
    """The bundled soil, in a lab that presses it in the mould and does nothing else."""
    bundled = load_lab(bundled_lab())
    soil = base_soil(bundled)
    values = "".join(
        f"{name} = {float(getattr(soil, name))!r}\n"
        for name, choice in bundled.parameters.items()
        if choice.value is not None
    )
    density = ", ".join(f'"{value} kg/m^3"' for value in bundled.density_kg_m3)
    path = folder / "lab.toml"
    path.write_text(
        f'[soil]\nname = "pressed"\ndensity = [{density}]\n'
        '[specimen]\ndiameter = "50 mm"\nheight = "50 mm"\n'
        '[[tests]]\ntype = "confined"\nrate = "8 mm/s"\nforce_low = "25 N"\n'
        f'force_high = "50 N"\n{TARGETS}'
        '[particles]\npoisson_ratio = 0.3\nreference_diameter = "80 um"\n'
        f"[parameters]\n{values}"
    )
    return load_lab(path)


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """The lab and its simulations."""
    folder = tmp_path_factory.mktemp("pressed")
    lab = laboratory(folder)
    return lab, Campaign(virtual_lab(lab, QUICK), specimen(lab, QUICK), folder)


@pytest.mark.thorough
@pytest.mark.rare
@pytest.mark.slow
def test_slopes_of_a_bed_are_those_of_its_response_and_are_kept(pressed):
    lab, work = pressed
    free, problem, seeds = space(lab, FREE), pose(lab), (0,)
    first = FirstOrder(work, free)
    found = first.slopes(problem, free.start(), seeds, "slopes")
    soils = [[free.soil(free.start() * factor)] for factor in np.exp([0.2, -0.2])]
    up, down = (problem.simulated(row) for row in work.each(soils, seeds, "differences"))
    difference = ((up - down) / 0.4)[0]
    assert difference[0] < -0.3
    np.testing.assert_allclose(np.asarray(found.slopes)[:, 0], difference, rtol=0.15)

    def refused(*_):
        raise AssertionError("a derivative that is kept was taken again")

    first._program = refused
    again = first.slopes(problem, free.start(), seeds, "slopes")
    np.testing.assert_array_equal(np.asarray(again.slopes), np.asarray(found.slopes))
