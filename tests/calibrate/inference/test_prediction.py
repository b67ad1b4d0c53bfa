"""Predictions of tests that took no part: bands by cause, from a response and from runs; and what
further tests would narrow.

Soils are drawn from a known distribution, and tests are formulas, so that every variance and the
share of specimens within an interval can be worked out.
"""

import json
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from calibrate.core.errors import CalibrationError, InputError
from calibrate.figures.posterior import prediction_figure
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.draws import SoilDraws
from calibrate.inference.narrowing import Told, left, menu, relative_scatter
from calibrate.inference.prediction import SHARE, by_response, by_runs, prediction_json
from calibrate.io.lab import bundled_lab
from calibrate.io.soil import with_values
from calibrate.labtests.diagnosis.curves import TARGETS
from tests.support.formulas import BASE, LAB, FormulaBeds, Formulas, on_response

POINTS = CurvePoints.of(Formulas())
FORCE = POINTS.observables.index("crushing_force_n")
DEPTH = POINTS.observables.index("depression_depth_mm")
SD = 0.15  # of ln surface energy, over which alone soils differ


def soils(count, sd=SD, seed=1):
    shifts = np.random.default_rng(seed).normal(size=count) * sd
    energy = float(BASE.surface_energy)
    return [with_values(BASE, {"surface_energy": energy * np.exp(shift)}) for shift in shifts]


class BothTests(FormulaBeds):
    """With a curve of the unconfined test too; strength is `factor` times as large."""

    factor: float = eqx.field(default=1.0)

    def shown(self, values):
        values = values.at[2].multiply(self.factor)
        observables, curves = super().shown(values)
        travel = jnp.linspace(0, 12, 241)
        crushing = values[2] * -jnp.expm1(-travel / values[3])
        return observables, {**curves, "unconfined": jnp.column_stack([travel, crushing])}


def response(factor=1.0, **options):
    made = on_response(**options)
    return replace(made, campaign=replace(made.campaign, beds=BothTests(factor=factor)))


def predicted(**options):
    return by_response(response(**options), None, soils(300), POINTS, 0)


def test_each_cause_has_the_deviation_that_it_was_given():
    found = predicted(spread=(0.03, 0.0, 0.05, 0.0))
    strength = found.middle[FORCE]
    assert strength == pytest.approx(200.0, rel=0.02)
    assert found.sd["parameters"][FORCE] == pytest.approx(0.6 * SD * strength, rel=0.15)
    assert found.sd["packings"][FORCE] == pytest.approx(0.05 * strength, rel=0.25)
    assert found.sd["library"][FORCE] == pytest.approx(0.01 * strength, rel=0.1)
    assert found.sd["parameters"][DEPTH] == pytest.approx(0.0, abs=1e-9)
    assert found.sd["packings"][DEPTH] == pytest.approx(0.03 * found.middle[DEPTH], rel=0.25)
    assert (found.by, found.runs, found.soils) == ("the library of runs", 0, 300)


def test_specimens_of_a_laboratory_scatter_as_its_repeats_do_where_these_scatter_more():
    """Four times the variance of packings in the numbers and curve of one test, no less."""
    usual = predicted(spread=(0.03, 0.0, 0.05, 0.0))
    wider = {"depression_depth_mm": 4.0, "crushing_force_n": 0.5}
    made = response(spread=(0.03, 0.0, 0.05, 0.0))
    found = by_response(made, None, soils(300), POINTS, 0, wider)
    rate = found.sd["packings"] / np.where(usual.sd["packings"] > 0, usual.sd["packings"], 1.0)
    test = POINTS.tests()
    assert rate[test == test[DEPTH]] == pytest.approx(2.0)
    assert rate[FORCE] == pytest.approx(1.0)
    for cause in ("parameters", "library"):
        assert found.sd[cause] == pytest.approx(usual.sd[cause], nan_ok=True)


def test_intervals_hold_the_share_of_specimens_that_they_promise():
    """Of other soils from the same distribution, with errors and luck of the same size."""
    found, random = predicted(spread=(0.03, 0.0, 0.05, 0.0)), np.random.default_rng(5)
    force = np.array([float(BothTests().values(soil)[2]) for soil in soils(2000, seed=2)])
    means = force * (1 + 0.01 * random.normal(size=len(force)))
    specimens = means + 0.05 * force * random.normal(size=len(force))
    for numbers, (low, high) in ((means, found.of_means), (specimens, found.of_specimens)):
        inside = np.mean((numbers > low[FORCE]) & (numbers < high[FORCE]))
        assert inside == pytest.approx(SHARE, abs=0.04)


def test_half_as_many_spheres_are_said_apart():
    found = by_response(response(), response(factor=1.1), soils(24), POINTS, 0)
    assert found.fewer_spheres is not None
    assert found.fewer_spheres[FORCE] == pytest.approx(20.0, rel=0.1)
    assert predicted().fewer_spheres is None


def test_curves_have_bands_where_their_numbers_have():
    found = prediction_json(predicted(spread=(0.03, 0.0, 0.05, 0.0)), {})
    curve = found["curves"]["unconfined"]
    low, high = (np.array(end) for end in curve["specimen"])
    inner, outer = (np.array(end) for end in curve["mean"])
    middle = np.array(curve["middle"])
    there = np.isfinite(middle)
    assert np.all(((low < inner) & (inner < middle) & (middle < outer) & (outer < high))[there])
    strength = found["observables"]["crushing_force_n"]
    assert middle[there][-1] == pytest.approx(strength["middle"], rel=1e-3)


def test_beyond_the_end_of_a_response_s_curve_it_says_nothing():
    """That of formulas ends at 12 mm, the test at 15."""
    found = prediction_json(predicted(), {})["curves"]["unconfined"]
    known = np.isfinite(found["middle"])
    assert np.array_equal(known, np.array(found["displacement_mm"]) <= 12)
    assert 3 < known.sum() < len(known)


@pytest.mark.parametrize(("share", "holds"), [(0.8, True), (2.5, False)])
def test_a_measured_number_holds_within_what_is_known_of_its_mean(share, holds):
    """`share` of the interval's half width for means over four specimens."""
    found = predicted()
    half = np.diff([end[FORCE] for end in found.of_specimens])[0] / 2
    narrower = half * found.sd_of(4)[FORCE] / found.sd_of(1)[FORCE]
    measured = {"mean": float(found.middle[FORCE] + share * narrower), "repeats": 4}
    row = prediction_json(found, {"crushing_force_n": measured})["observables"]["crushing_force_n"]
    assert row["measured"]["holds"] is holds
    assert row["measured"]["half_width"] == pytest.approx(narrower)
    assert narrower < half


def test_runs_split_soils_from_packings():
    """Many soils on many packings: the deviations that both were given."""
    found = by_runs(Formulas(), soils(60), range(2400))
    assert found.sd["parameters"][FORCE] == pytest.approx(0.6 * SD * 200, rel=0.2)
    assert found.sd["packings"][FORCE] == pytest.approx(0.05 * 200, rel=0.3)
    assert (found.by, found.runs) == ("simulations", 2400)
    assert found.fewer_spheres is None


def test_few_soils_make_wider_intervals_and_failed_ones_are_left_out():
    few, many = (by_runs(Formulas(), soils(n), range(2 * n)) for n in (4, 60))
    width = [np.diff([end[FORCE] for end in each.of_means])[0] for each in (few, many)]
    assert width[0] > 1.2 * width[1]
    weak = 0.9 * float(BASE.surface_energy)
    work = Formulas(fails=lambda soil: float(soil.surface_energy) < weak)
    assert 2 < by_runs(work, soils(20), range(40)).soils < 20
    with pytest.raises(
        CalibrationError, match=r"0 of 4 soils could be simulated .* the bed exploded"
    ):
        by_runs(Formulas(fails=lambda soil: True), soils(4), range(8))


def test_luck_that_all_soils_would_share_is_in_the_interval():
    """Of soils that hardly differ: each on two packings, whose luck no other soil has."""
    true, inside, tries = 200.0, 0, 150
    for trial in range(tries):
        alike, first = soils(4, sd=1e-3, seed=trial), 8 * trial
        found = by_runs(Formulas(), alike, range(first, first + 8))
        low, high = (end[FORCE] for end in found.of_means)
        inside += low < true < high
    assert inside / tries == pytest.approx(SHARE, abs=0.08)


def test_the_picture_has_a_panel_for_each_test_and_every_label_once():
    content = prediction_json(predicted(), {})
    curve = {"test": "unconfined", "displacement_mm": [0, 1, 2], "force_n": [0, 90, 150]}
    tests = {"unconfined": {"axes": ["lift (mm)", "drag (N)"]}}
    content["measured"] = {"curves": [curve, curve], "targets": {}, "tests": tests}
    figure = prediction_figure(content)
    assert [axis.get_title() for axis in figure.axes] == ["confined", "unconfined"]
    assert [axis.get_xlabel() for axis in figure.axes] == ["displacement (mm)", "lift (mm)"]
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sorted(labels) == ["90 % of means", "90 % of specimens", "expected", "measured"]


# ------------------------------------------------------------------ the command


def test_without_draws_it_says_what_to_do(calibrate, tmp_path):
    status, _, error = calibrate("predict", "nowhere")
    assert status == 2 and error.count("\n") == 1
    assert "nowhere/posterior.nc" in error and not (tmp_path / "results/prediction.json").exists()


@pytest.mark.slow
def test_a_posterior_predicts_its_own_tests_and_another_specimen(calibrate, tmp_path):
    """By the library alone.  What the posterior was given holds, since it took part; a specimen as
    wide as it is high is another test."""
    assert calibrate("posterior", "--no-runs", "--out", "p")[0] == 0
    status, out, _ = calibrate("predict", "p", "--out", "o")
    assert status == 0 and "no simulation" in out
    found = json.loads((tmp_path / "o/prediction.json").read_text())
    assert all(row["measured"]["holds"] for row in found["observables"].values())
    assert all(TARGETS[k] in found["observables"] for k in range(2))
    assert (tmp_path / "o/prediction.png").stat().st_size > 10_000


RANDOM = np.random.default_rng(8)
SOILS = RANDOM.normal(size=(20_000, 2)) * [1.0, 2.0]  # of two parameters that are independent


def told(numbers, error, scatter):
    count = numbers.shape[1]
    return Told(numbers, error * np.eye(count), scatter * np.eye(count))


def test_one_number_narrows_as_a_normal_variable_does():
    """x ~ N(0, 1), seen with variance 0.25 + 1/n: what is left is sqrt(v/(1 + v))."""
    numbers = SOILS[:, :1]
    for specimens in (1, 4):
        variance = 0.25 + 1.0 / specimens
        found = left(SOILS, told(numbers, 0.25, 1.0), specimens)
        assert found[0] == pytest.approx(np.sqrt(variance / (1 + variance)), rel=0.02)
        assert found[1] == pytest.approx(1.0, abs=0.01)


def test_a_sum_tells_of_a_wide_parameter_more_than_of_a_narrow_one():
    """x + y seen exactly, deviations 1 and 2: variances left are 4/5 and 1/5 of them."""
    found = left(SOILS, told(SOILS.sum(axis=1, keepdims=True), 0.0, 0.0), 1)
    assert found**2 == pytest.approx([4 / 5, 1 / 5], rel=0.03)


def test_what_it_promises_is_what_regression_finds():
    """On fresh soils whose test is drawn with its errors."""
    shown = np.column_stack([SOILS.sum(axis=1), SOILS[:, 0] - 0.3 * SOILS[:, 1]])
    promised = left(SOILS, told(shown, 0.1, 0.8), 2)
    fresh = RANDOM.normal(size=(20_000, 2)) * [1.0, 2.0]
    seen = np.column_stack([fresh.sum(axis=1), fresh[:, 0] - 0.3 * fresh[:, 1]])
    seen = seen + np.sqrt(0.1 + 0.8 / 2) * RANDOM.normal(size=seen.shape)
    terms = np.column_stack([np.ones(len(seen)), seen])
    rest = fresh - terms @ np.linalg.lstsq(terms, fresh, rcond=None)[0]
    assert promised == pytest.approx(rest.std(axis=0) / fresh.std(axis=0), rel=0.03)


def test_the_menu_has_other_stresses_and_heights_of_the_same_laboratory():
    tests = list(menu(LAB))
    assert len({(test.name, test.read) for test in tests}) == len(tests) == 6
    forces = sorted({test.lab.tests[0].model_dump()["force_high"] for test in tests})
    assert forces == [200.0, 400.0, 800.0]
    heights = sorted({test.lab.specimen.height for test in tests})
    assert heights == pytest.approx([0.05, 0.1, 0.2])


def test_scatter_of_repeats_is_what_the_lab_file_says():
    share = [t.scatter / t.mean for t in LAB.targets.values() if t.repeats > 1]
    assert relative_scatter(LAB) == pytest.approx(np.mean(share))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--posterior", "p", "--simulate", "2"), "--simulate"),
        (("--posterior", "p", "--library", "x.nc"), "--library"),
        (("--prediction", "lab.toml"), "--prediction"),
    ],
)
def test_options_that_would_be_left_aside_are_refused(calibrate, options, said):
    status, _, error = calibrate("next", str(bundled_lab()), *options)
    assert status == 2 and error.count("\n") == 1 and said in error


def test_draws_of_another_contact_law_are_refused():
    attributes = {"conventions": "liggghts"}
    known = SoilDraws((), np.zeros((1, 0)), BASE, xr.DataTree(xr.Dataset(attrs=attributes)))
    with pytest.raises(InputError, match="the draws follow 'liggghts'"):
        known.base_in(LAB)


def test_a_lab_without_a_confined_test_has_fewer_further_tests():
    other = replace(LAB, tests=LAB.tests[1:])
    assert [test.name for test in menu(other)][:2] == ["the same tests again"] * 2
