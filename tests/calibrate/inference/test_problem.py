"""The calibration problem and what its data fix, on inputs whose answers are known.

Features of curves that are straight lines, covariances written down by hand, bounded
parameters there and back, and linear toy problems for `assess` and `choose_free`.
"""

from collections import Counter
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some
from scipy import stats

from calibrate.core.errors import InputError
from calibrate.inference.curve_points import CurveReading
from calibrate.inference.identifiability import IDENTIFIED, assess, choose_free
from calibrate.inference.parameters import RANGES, Space, space
from calibrate.inference.problem import ZERO_KNOWN, Problem, begun_late, pose, shrunk_covariance
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.diagnosis.base import UsualSizes
from calibrate.labtests.diagnosis.curves import declare, feature_values
from calibrate.labtests.features import (
    SEATING,
    DisplacementOnLoading,
    DisplacementOnPath,
    DisplacementOnUnloading,
    ForceAtDisplacement,
    ForceAtEnd,
    ScalarTarget,
    Waypoint,
)
from calibrate.labtests.measured import Curve
from calibrate.labtests.reading import (
    AS_RECORDED,
    Zero,
    averaged,
    displacement_on_rise,
    falling,
    rising,
)
from jdem.materials.soil import SoilParameters
from jdem.observables import Curve as RunCurve
from jdem.observables import displacement_at
from tests.support.formulas import two_tests

LAB = load_lab(bundled_lab())

# ------------------------------------------------------------------ features of curves

UP, DOWN = 100.0, 400.0  # N/mm of the straight lines below
TOE = 0.7  # mm of travel before the platen touches


def confined_curve(peak=400.0, points=801):
    """No force for TOE, a straight line up to `peak`, a steeper one back to zero."""
    rise = np.linspace(0, peak, points)
    fall = np.linspace(peak, 0, points)[1:]
    top = TOE + peak / UP
    displacement = np.concatenate([[0.0], TOE + rise / UP, top - (peak - fall) / DOWN])
    return displacement, np.concatenate([[0.0], rise, fall])


def crushing_curve(slope=50.0, points=401):
    displacement = np.linspace(0, 10, points)
    return displacement, slope * np.maximum(displacement - TOE, 0.0)


@pytest.mark.parametrize("force", [50.0, 200.0, 400.0])
def test_displacement_on_loading_counts_from_the_seating_force(force):
    feature = DisplacementOnLoading("up", "mm", "confined", force)
    assert feature.of_curve(*confined_curve()) == pytest.approx((force - SEATING) / UP, rel=1e-12)


@pytest.mark.parametrize("force", [40.0, 200.0])
def test_displacement_on_unloading_counts_from_the_same_zero(force):
    feature = DisplacementOnUnloading("down", "mm", "confined", force)
    expected = (400.0 - SEATING) / UP - (400.0 - force) / DOWN
    assert feature.of_curve(*confined_curve()) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("travel", [0.5, 2.0, 8.0])
def test_crushing_force_at_a_travel_from_first_contact(travel):
    """On a straight line the mean over a symmetric window is the value in its middle.

    Contact is noticed at the first point above SEATING: up to one point (0.025 mm) late
    on top of SEATING/slope, and the window's ends may hold one point more on one side.
    """
    slope = 50.0
    feature = ForceAtDisplacement("crush", "N", "unconfined", travel)
    expected = slope * travel + SEATING
    assert abs(feature.of_curve(*crushing_curve(slope)) - expected) < 1.5 * slope * 0.025


def test_features_do_not_depend_on_where_the_machine_counts_from():
    displacement, force = confined_curve()
    for kind, abscissa in ((DisplacementOnLoading, 300.0), (DisplacementOnUnloading, 100.0)):
        feature = kind("x", "mm", "confined", abscissa)
        shifted = feature.of_curve(displacement + 12.5, force)
        assert shifted == pytest.approx(feature.of_curve(displacement, force), abs=1e-9)


def test_a_dip_on_the_way_up_does_not_confuse_the_reading():
    """The running maximum is read: a dip after the force was reached changes nothing."""
    displacement, force = confined_curve()
    dipped = np.where((force > 250) & (displacement < TOE + 2.6), 245.0, force)
    feature = DisplacementOnLoading("up", "mm", "confined", 200.0)
    assert feature.of_curve(displacement, dipped) == feature.of_curve(displacement, force)


def smooth_curve(points=60, last=1.02):
    """Force rises with the square of displacement and falls back along a line."""
    way = np.linspace(0.0, 4.0 * np.sqrt(last), points)
    back = way[-1] - np.linspace(0.0, 1.0, 20)[1:]
    top = 25.0 * way[-1] ** 2
    return np.append(way, back), np.append(25.0 * way**2, np.linspace(top, 10.0, 20)[1:])


@pytest.mark.parametrize("force", [110.0, 260.0, 380.0])
def test_fit_audit_diagnosis_and_run_read_one_number_where_zero_and_force_are_the_same(force):
    """Each has a zero of its own by default; from one zero, half of 400 N, they are equal."""
    zero, (way, load) = Zero(200.0), smooth_curve()
    fitted = DisplacementOnLoading("", "mm", "confined", force, zero).of_curve(way, load)
    audited = CurveReading("confined", "force_n", np.array([force, 200.0]))
    from_there = replace(audited.feature(), zero=zero).of_curve(way, load)[0]
    features = declare(UsualSizes(force / 0.275, 6.0, 200.0))
    named = [f.name for f in features].index(f"displacement at {force:g} N, loading")
    diagnosed = replace(features[named], zero=zero)
    curves = {"confined": (way, load)}
    of_run = RunCurve(*map(jnp.asarray, (1e-3 * way, load, np.ones_like(way))))
    run = 1e3 * float(displacement_at(of_run, force) - displacement_at(of_run, 200.0))
    assert fitted == from_there == feature_values([diagnosed], curves)[0]
    assert fitted == pytest.approx(-np.subtract(*audited.read(np.stack([way, load], 1))[::-1]))
    assert fitted == pytest.approx(run, rel=1e-12)
    assert fitted == pytest.approx(np.sqrt(force / 25) - np.sqrt(8), rel=2e-3)


def test_every_reader_states_its_zero():
    """Fit: the seating force; audit: as recorded; diagnosis: half load, and seating of a peak."""
    lab = lab_with(Curve("confined", *smooth_curve(), "c.csv"), targets={})
    assert {f.zero for f in pose(lab).features} == {Zero(SEATING)}
    assert CurveReading("confined", "force_n", np.ones(2)).feature().zero == AS_RECORDED
    zeros = {f.test: f.zero for f in declare(UsualSizes(400.0, 6.0, 200.0))}
    assert zeros == {"confined": Zero(200.0), "unconfined": Zero(4.0)}


def read_by_jax():
    """What is read off the curve below; every row but those at the ends matters to one of them."""
    up, down = Waypoint(90.0, True), Waypoint(60.0, False)
    path = (Waypoint(30.0, True), up, down)
    of_mould = {
        "on loading": DisplacementOnLoading("", "mm", "", 111.0),
        "on unloading": DisplacementOnUnloading("", "mm", "", 111.0),
        "of a path": DisplacementOnPath("", "mm", "", path),
        "at a displacement": ForceAtDisplacement("", "N", "", 1.3, half_width=0.0),
        "near a displacement": ForceAtDisplacement("", "N", "", 1.3, half_width=0.4),
        "at the end": ForceAtEnd("", "N", ""),
    }
    lines = {
        "rise": lambda x, f: displacement_on_rise(*rising(x[:15], f[:15]), 95.0),
        "rise by rows": lambda x, f: displacement_on_rise(*rising(x[:15], f[:15], False), 95.0),
        "fall": lambda x, f: displacement_on_rise(*falling(x[14:], f[14:]), 70.0),
        "line": lambda x, f: averaged(x, f, np.array([1.4]), 0.45)[0],
    }
    return {**{name: feature.of_curve for name, feature in of_mould.items()}, **lines}


@pytest.mark.parametrize("what", read_by_jax())
def test_jax_differentiates_what_is_read(what):
    """Along a random direction, against a difference; the value is that which numpy reads."""
    rng = np.random.default_rng(1)
    way = np.concatenate([np.linspace(0, 2, 15), np.linspace(1.95, 1.6, 9)])
    load = np.concatenate([40 * np.linspace(0, 2, 15) ** 2, np.linspace(150, 5, 9)])
    load[8:10] = load[9], load[8]  # a dip, so that two rows make a block
    read, curve = read_by_jax()[what], (way, load)
    apart = (0.1 * rng.standard_normal(24), 3.0 * rng.standard_normal(24))

    def moved(by: float):
        return read(*(part + by * change for part, change in zip(curve, apart, strict=True)))

    differentiated = jax.jit(jax.value_and_grad(read, argnums=(0, 1)))
    value, slopes = differentiated(*map(jnp.asarray, curve))
    along = sum(float(slope @ change) for slope, change in zip(slopes, apart, strict=True))
    assert float(value) == pytest.approx(float(moved(0.0)), rel=1e-12)
    assert along == pytest.approx(float(moved(1e-6) - moved(-1e-6)) / 2e-6, rel=1e-6)
    assert along != 0


def run_of(depth=3.0, force=200.0, failure=""):
    confined, crushing = (np.stack(c, axis=1) for c in (confined_curve(), crushing_curve()))
    return two_tests(depth, force, confined, crushing, {}, failure)


def test_a_run_is_read_by_observable_or_by_curve():
    problem = Problem(
        (
            ScalarTarget("depression_depth_mm", "mm", ""),
            ScalarTarget("crushing_force_n", "N", ""),
            DisplacementOnLoading("up", "mm", "confined", 400.0),
        ),
        np.zeros(3),
        np.zeros(3),
        np.zeros(3),
    )
    rows = problem.simulated([run_of(depth=3.3, force=190.0), run_of()])
    np.testing.assert_allclose(rows, [[3.3, 190.0, 3.98], [3.0, 200.0, 3.98]], rtol=1e-12)


def test_a_failed_run_has_no_features():
    problem = Problem((ScalarTarget("crushing_force_n", "N", ""),), *np.zeros((3, 1)))
    assert np.isnan(problem.simulated([run_of(failure="the bed exploded")])).all()


# ------------------------------------------------------------------ posing


def lab_with(*curves, targets=None):
    """The bundled soil with curves, as far as `pose` reads a lab."""
    return replace(
        LAB,
        file="lab.toml",
        targets=LAB.targets if targets is None else targets,
        curves=curves,
    )


def test_scalar_targets_have_the_variance_of_their_mean():
    problem = pose(LAB)
    assert [f.name for f in problem.features] == ["depression_depth_mm", "crushing_force_n"]
    np.testing.assert_allclose(problem.measured, [3.36, 206.0])
    np.testing.assert_allclose(np.sqrt(problem.target_variance), [0.168 / 2, 10.3 / 2])
    assert list(problem.repeats) == [0, 0]


def test_curves_add_features_averaged_over_repeats():
    first, second = confined_curve(), confined_curve()
    stretched = (2 * second[0], second[1])
    curves = [Curve("confined", *pair, "c.csv") for pair in (first, stretched)]
    problem = pose(lab_with(*curves, Curve("unconfined", *crushing_curve(), "u.csv")))
    assert list(Counter(type(f) for f in problem.features).items()) == [
        (ScalarTarget, 2),
        (DisplacementOnLoading, 5),
        (DisplacementOnUnloading, 2),
        (ForceAtDisplacement, 6),  # 10 mm on the machine are 9.3 mm beyond the toe
    ]
    assert list(problem.repeats) == [0, 0] + [2] * 7 + [1] * 6
    assert problem.measured[6] == pytest.approx(1.5 * (400 - SEATING) / UP)


def test_a_curve_without_unloading_is_not_asked_about_it():
    displacement, force = confined_curve()
    turn = int(np.argmax(force)) + 1
    curve = Curve("confined", displacement[:turn], force[:turn], "c.csv")
    assert DisplacementOnUnloading not in [type(f) for f in pose(lab_with(curve)).features]


# A record that begins at a preload holds nothing below it: neither it nor the simulation may be
# counted from there.

PRELOADS = [0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 10.0, 30.0]


def cut_at(preload, displacement, force):
    """What a machine records whose clocks start at a preload: travel from there, force whole."""
    first = int(np.argmax(force >= preload))
    return displacement[first:] - displacement[first], force[first:]


def curved(points=4001):
    """A confined curve with a soft toe, and a crushing curve that bends, as specimens have them."""
    share = np.linspace(0, 1, points)
    force = np.concatenate([400 * share, 400 * share[-2::-1]])
    up = 6.0 * share**0.4
    confined = (np.concatenate([up, up[-1] - 1.5 * (1 - share[-2::-1])]), force)
    travel = 15.0 * share
    return confined, (travel, 200 * -np.expm1(-((travel / 2.0) ** 1.5)))


@pytest.mark.parametrize("preload", PRELOADS)
def test_a_record_from_a_preload_on_differs_in_nothing_from_the_specimen_it_is_of(preload):
    """The simulated curve is whole; read as the record is, it gives the same numbers."""
    confined, crushing = curved()
    lab = lab_with(
        Curve("confined", *cut_at(preload, *confined), "c.csv"),
        Curve("unconfined", *cut_at(preload, *crushing), "u.csv"),
        targets={},
    )
    problem = pose(lab)
    whole = {"confined": np.stack(confined, 1), "unconfined": np.stack(crushing, 1)}
    read = [feature.of({}, whole) for feature in problem.features]
    np.testing.assert_allclose(read, problem.measured, rtol=1e-6, atol=1e-9)
    assert all(f.zero.force >= max(2.0, preload) for f in problem.features)


def test_the_latest_beginning_of_several_records_counts_for_all():
    confined, _ = curved()
    curves = [Curve("confined", *cut_at(p, *confined), f"{p:g}.csv") for p in (0.0, 4.0, 9.0)]
    problem = pose(lab_with(*curves, targets={}))
    whole = {"confined": np.stack(confined, 1)}
    read = [feature.of({}, whole) for feature in problem.features]
    np.testing.assert_allclose(read, problem.measured, rtol=1e-6)


def test_numbers_at_or_below_the_preload_are_not_compared():
    confined, _ = curved()
    problem = pose(lab_with(Curve("confined", *cut_at(60.0, *confined), "c.csv"), targets={}))
    names = [f.name for f in problem.features]
    assert "displacement at 50 N, loading" not in names
    assert "displacement at 100 N, loading" in names


def test_a_record_of_which_nothing_is_left_is_refused_by_name():
    short = (np.linspace(0, 0.3, 50), np.linspace(0, 80, 50))
    with pytest.raises(InputError, match=r"u\.csv.*nothing can be read"):
        pose(lab_with(Curve("unconfined", *short, "u.csv")))


def test_places_beyond_the_travel_since_contact_are_not_read():
    """The machine counts from 12 mm: its 17 mm are 5 mm of the specimen's way."""
    travel = np.linspace(0, 5, 401)
    force = 200 * -np.expm1(-travel)
    problem = pose(lab_with(Curve("unconfined", 12 + travel, force, "u.csv"), targets={}))
    assert [f.name for f in problem.features][-1] == "force at 4 mm, crushing"


def test_a_fit_says_that_a_record_begins_at_a_preload():
    confined, crushing = curved()
    late = Curve("unconfined", *cut_at(8.0, *crushing), "late.csv")
    whole = Curve("confined", *confined, "c.csv")
    (sentence,) = begun_late(lab_with(whole, late))
    assert "late.csv begins at a load of 8" in sentence and "unconfined" in sentence
    assert begun_late(lab_with(whole)) == []


def test_a_force_within_two_per_cent_is_read_where_the_record_ends():
    """393 N of 400 N: the last reading is at 393 N, in measurement and simulation."""
    (way, force), _ = curved()
    last = int(np.argmax(force >= 393.0))
    problem = pose(lab_with(Curve("confined", way[:last], force[:last], "c.csv"), targets={}))
    whole = {"confined": np.stack([way, force], 1)}
    read = [feature.of({}, whole) for feature in problem.features]
    np.testing.assert_allclose(read, problem.measured, rtol=1e-6)


def test_a_curve_that_stops_short_is_refused_by_name():
    curve = Curve("confined", *confined_curve(peak=300.0), "short.csv")
    with pytest.raises(InputError, match=r"short\.csv.*300 N"):
        pose(lab_with(curve))


# ------------------------------------------------------------------ covariance


def test_shrinkage_keeps_variances_and_lies_between_its_limits():
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(8, 5)) @ rng.normal(size=(5, 5))
    shrunk, plain = shrunk_covariance(samples), np.cov(samples.T)
    np.testing.assert_allclose(np.diag(shrunk), np.diag(plain))
    off = ~np.eye(5, dtype=bool)
    share = shrunk[off] / plain[off]
    np.testing.assert_allclose(share, share[0])  # one weight for all
    assert 0.0 <= share[0] < 1.0
    np.linalg.cholesky(shrunk)


def test_many_correlated_samples_are_hardly_shrunk():
    """The weight falls as 1/n: with 4000 samples and strong correlation below one per cent."""
    rng = np.random.default_rng(2)
    mixing = np.array([[1.0, 0.0, 0.0], [0.9, 0.4, 0.0], [0.8, 0.1, 0.5]])
    samples = rng.normal(size=(4000, 3)) @ mixing.T
    np.testing.assert_allclose(shrunk_covariance(samples), np.cov(samples.T), rtol=0.01)


def test_fewer_samples_than_features_still_give_a_definite_matrix():
    samples = np.random.default_rng(3).normal(size=(4, 16))
    assert np.linalg.eigvalsh(shrunk_covariance(samples)).min() > 0


def test_one_sample_tells_nothing_about_scatter():
    np.testing.assert_array_equal(shrunk_covariance(np.ones((1, 3))), np.zeros((3, 3)))


def test_one_feature_has_its_own_variance():
    samples = np.array([[1.0], [2.0], [4.0]])
    np.testing.assert_allclose(shrunk_covariance(samples), [[np.var(samples, ddof=1)]])


def test_covariance_adds_packings_and_repeats():
    """One target (measured 2, sd of mean 0.3) and one curve feature (measured 10, 4 repeats)."""
    features = (ScalarTarget("t", "mm", ""), ForceAtDisplacement("c", "N", "unconfined", 1.0))
    problem = Problem(features, np.array([2.0, 10.0]), np.array([0.09, 0.0]), np.array([0, 4]))
    relative = np.array([[0.04, 0.01], [0.01, 0.09]])
    expected = [
        [0.04 * 4 / 3 + 0.09, 0.01 * 20 / 3],
        [0.01 * 20 / 3, 0.09 * 100 * (1 / 3 + 1 / 4)],
    ]
    np.testing.assert_allclose(problem.covariance(relative, 3), expected)


def test_records_that_scatter_more_than_packings_count_for_less():
    """Four times the variance of packings in one test, a quarter of it in the other."""
    features = tuple(ForceAtEnd(name, "N", name) for name in ("confined", "unconfined"))
    relative, scatter = np.diag([0.01, 0.01]), np.array([0.2, 0.05])
    problem = Problem(features, np.ones(2), np.zeros(2), np.array([4, 4]), scatter)
    found = np.diag(problem.covariance(relative, 10**9))
    np.testing.assert_allclose(found, [4 * 0.01 / 4, 0.01 / 4])


def test_where_a_platen_touches_is_known_so_far_only():
    """Displacements move with the zero of their test as it does, forces as the curve falls."""
    names = ("confined", "confined", "unconfined")
    features = tuple(ForceAtEnd(f"{n}", "N", name) for n, name in enumerate(names))
    seating = np.array([-1.0, -1.0, 50.0])
    problem = Problem(features, np.ones(3), np.zeros(3), np.ones(3), seating=seating)
    expected = ZERO_KNOWN**2 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 2500.0]])
    np.testing.assert_allclose(problem.covariance(np.zeros((3, 3)), 1), expected)
    later = DisplacementOnLoading("", "mm", "confined", 400.0).begun_later(0.1)
    x, force = confined_curve()
    assert later.of_curve(x, force) == pytest.approx(3.98 - 0.1)
    line = ForceAtDisplacement("", "N", "unconfined", 2.0, half_width=0.0)
    travel = np.linspace(0.0, 10.0, 401)
    moved = line.begun_later(0.1).of_curve(travel, 30.0 * travel)
    assert moved - line.of_curve(travel, 30.0 * travel) == pytest.approx(3.0)
    as_recorded = ForceAtDisplacement("", "N", "unconfined", 2.0, AS_RECORDED)
    assert as_recorded.begun_later(0.1) is as_recorded


def test_a_feature_without_a_say_counts_for_nothing():
    features = tuple(ForceAtEnd(name, "N", name) for name in ("confined", "unconfined"))
    problem = Problem(features, np.array([2.0, 3.0]), np.full(2, 0.01), np.zeros(2))
    silent = problem.without(np.array([False, True]))
    found = np.diag(silent.covariance(np.zeros((2, 2)), 1))
    assert found[0] == 0.01 and found[1] > 1e5 * 9.0


@pytest.mark.parametrize("every", (0.01, 0.1, 0.2))
def test_a_force_does_not_depend_on_how_often_readings_were_taken(every):
    """A straight rise of 100 N/mm that begins 0.013 mm after a reading."""
    x = np.arange(0.0, 5.0, every)
    force = 100.0 * np.maximum(x - 0.013, 0.0)
    found = ForceAtDisplacement("", "N", "unconfined", 0.5, half_width=0.0).of_curve(x, force)
    assert found == pytest.approx(SEATING + 50.0, abs=100.0 * 0.013)


# ------------------------------------------------------------------ bounded parameters

EVERY = Space(tuple(RANGES), tuple(RANGES.values()), SoilParameters())
LOW, HIGH = (np.array([getattr(r, end) for r in RANGES.values()]) for end in ("low", "high"))
shares = some.lists(some.floats(1e-4, 1 - 1e-4), min_size=len(RANGES), max_size=len(RANGES))
anywhere = some.lists(some.floats(-500, 500), min_size=len(RANGES), max_size=len(RANGES))


@given(shares)
def test_values_survive_the_way_there_and_back(share):
    # The logit at share 1e-4 has slope 1e4, so a few 1e-16 become a few 1e-12.
    values = LOW * (HIGH / LOW) ** np.array(share)
    np.testing.assert_allclose(EVERY.from_unbounded(EVERY.to_unbounded(values)), values, rtol=1e-11)


@given(anywhere)
def test_no_step_of_a_solver_leaves_the_bounds(y):
    values = EVERY.from_unbounded(np.array(y))
    assert np.all(values >= LOW * (1 - 1e-12))
    assert np.all(values <= HIGH * (1 + 1e-12))
    assert np.all(np.isfinite(EVERY.log_slope(np.array(y))))


@given(some.floats(-6, 6))
def test_log_slope_is_the_derivative(y):
    """Central difference with step 1e-5: truncation 1e-10, round-off 1e-11; slopes above 1e-3."""
    point, step = np.full(len(RANGES), y), 1e-5
    ahead, behind = (np.log(EVERY.from_unbounded(point + s)) for s in (step, -step))
    np.testing.assert_allclose(EVERY.log_slope(point), (ahead - behind) / (2 * step), rtol=1e-5)


def test_a_start_on_or_beyond_a_bound_stays_finite():
    for values in (LOW, HIGH, 0.5 * LOW, 2 * HIGH):
        assert np.all(np.isfinite(EVERY.to_unbounded(values)))


def test_parameters_at_a_bound_are_named():
    values = np.sqrt(LOW * HIGH)
    values[3], values[5] = HIGH[3], LOW[5] * 1.001
    assert EVERY.at_bound(values) == ["surface_energy", "tensile_exponent"]


def test_a_space_changes_only_its_own_parameters():
    free = space(LAB, ("static_friction", "surface_energy"))
    soil = free.soil(np.array([0.9, 30.0]))
    base = base_soil(LAB)
    assert (float(soil.static_friction), float(soil.surface_energy)) == (0.9, 30.0)
    for name in set(SoilParameters.__dataclass_fields__) - set(free.names):
        assert getattr(soil, name) == getattr(base, name)
    np.testing.assert_allclose(free.start(), [0.676, 17.158])


def test_the_slope_exponent_chooses_another_law():
    soil = with_values(base_soil(LAB), {"slope_exponent": 1.5, "static_friction": 0.4})
    assert soil.slope_exponent == 1.5
    assert float(soil.static_friction) == 0.4
    assert float(soil.surface_energy) == pytest.approx(17.158)


# ------------------------------------------------------------------ what the data fix

ONE = np.ones(2)


def assessed(slopes, prior=ONE, freedom=10**6):
    slopes = np.asarray(slopes, float)
    names = tuple("abcdef"[: slopes.shape[1]])
    prior = np.asarray(prior, float)
    return assess(names, np.full(len(names), 2.0), slopes, prior, freedom)


def test_well_measured_parameters_have_the_textbook_covariance():
    slopes, prior = np.array([[5.0, 1.0], [-2.0, 8.0], [1.0, 1.0]]), np.array([0.5, 2.0])
    found = assessed(slopes, prior)
    normal = slopes.T @ slopes
    expected = np.linalg.inv(normal + np.diag(1 / prior**2))
    np.testing.assert_allclose(found.covariance_log, expected, rtol=1e-10)
    np.testing.assert_allclose(found.sd_log_data, np.sqrt(np.diag(np.linalg.inv(normal))))


def test_the_covariance_is_undamped():
    """Nearly alike parameters: any damping (a relative 1e-6 of J'J) would halve this variance."""
    slopes = np.array([[1.0, 1.0], [0.0, 1e-3]])
    exact = np.sqrt(1e6 * np.array([1 + 1e-6, 1.0]))
    np.testing.assert_allclose(assessed(slopes).sd_log_data, exact, rtol=1e-8)


def test_the_interval_is_a_t_interval_in_the_logarithm():
    found = assessed([[10.0, 0.0], [0.0, 10.0]], freedom=7)
    reach = stats.t.ppf(0.975, 7) * found.sd_log
    np.testing.assert_allclose(np.log(found.interval / 2.0), np.stack([-reach, reach], axis=1))


def test_a_pair_that_only_acts_as_a_product_is_an_open_direction():
    """The data see a + b; the difference a - b is known from the prior alone."""
    found = assessed([[10.0, 10.0], [-4.0, -4.0]])
    assert np.all(np.isinf(found.sd_log_data))
    assert list(found.fixed()) == [True, False]
    np.testing.assert_allclose(np.abs(found.directions[:, 1]), np.sqrt([0.5, 0.5]))
    assert found.directions[0, 1] * found.directions[1, 1] < 0
    # The sum is fixed to 1/sqrt(1 + 232), the difference keeps its prior deviation of 1.
    difference, total = np.array([1, -1]) / np.sqrt(2), np.array([1, 1]) / np.sqrt(2)
    assert difference @ found.covariance_log @ difference == pytest.approx(1.0)
    assert total @ found.covariance_log @ total == pytest.approx(1 / 233)


def test_an_open_pair_does_not_hide_what_is_fixed():
    found = assessed([[3.0, 3.0, 0.0], [0.0, 0.0, 7.0]], prior=np.ones(3))
    np.testing.assert_allclose(found.sd_log_data, [np.inf, np.inf, 1 / 7])


def test_a_parameter_without_any_effect_keeps_its_prior():
    found = assessed([[5.0, 0.0]], prior=[1.0, 0.4])
    assert found.sd_log_data[1] == np.inf
    assert found.sd_log[1] == pytest.approx(0.4)
    assert list(found.fixed()) == [True, False]


def test_no_data_effect_at_all_leaves_everything_open():
    found = assessed(np.zeros((2, 2)), prior=[0.3, 0.6])
    np.testing.assert_allclose(found.sd_log, [0.3, 0.6])
    assert np.all(np.isinf(found.sd_log_data))
    assert not found.fixed().any()


def test_the_json_has_null_for_what_is_not_known():
    result = assessed([[10.0, 10.0], [-4.0, -4.0]]).as_json()
    assert result["sd_log_data_alone"] == {"a": None, "b": None}
    assert [d["fixed_by_data"] for d in result["directions"]] == [True, False]
    assert np.allclose(np.diag(result["correlation"]), 1.0)


def chosen(slopes, prior, most=9):
    slopes = np.asarray(slopes, float)
    names = tuple("abcdef"[: slopes.shape[1]])
    return [c.name for c in choose_free(names, slopes, np.asarray(prior, float), most)]


def test_the_strongest_parameters_are_chosen_strongest_first():
    assert chosen([[4.0, 0.0, 0.1], [0.0, 9.0, 0.1]], [1, 1, 1]) == ["b", "a"]


def test_of_two_alike_only_the_stronger_is_chosen():
    assert chosen([[5.0, 4.9, 0.0], [5.0, 4.9, 3.0]], [1, 1, 1]) == ["a", "c"]


def test_errors_of_slopes_do_not_decide_which_of_two_that_are_seen_alike_is_freed():
    """The wider prior does, whichever of both seems stronger; a clear difference counts."""
    rng = np.random.default_rng(0)
    for a, b in 10 * (1 + 0.1 * rng.normal(size=(50, 2))):
        assert chosen([[a / 0.4, b]], [0.4, 1.0]) == ["b"]
    assert chosen([[10 / 0.4, 6.0]], [0.4, 1.0]) == ["a"]
    (best, *_) = choose_free(
        ("a", "b", "c"), np.array([[25.0, 9.0, 2.0]]), np.array([0.4, 1, 1]), 1
    )
    assert best == ("b", 9.0, ("a",))


def test_a_parameter_known_beforehand_is_not_worth_freeing():
    assert chosen([[5.0, 0.0], [0.0, 5.0]], [1.0, 0.01]) == ["a"]


def test_nothing_is_chosen_where_the_data_say_nothing():
    weakest = np.sqrt(1 / IDENTIFIED**2 - 1)  # the signal that just halves the deviation
    assert chosen([[0.99 * weakest]], [1.0]) == []
    assert chosen([[1.01 * weakest]], [1.0]) == ["a"]
    assert chosen(np.zeros((2, 3)), [1, 1, 1]) == []


def test_no_more_than_asked_are_chosen():
    assert chosen(9.0 * np.eye(4), [1, 1, 1, 1], most=2) == ["a", "b"]


def test_choosing_stops_when_the_names_run_out():
    assert chosen(9.0 * np.eye(3), [1, 1, 1], most=9) == ["a", "b", "c"]
