"""Curves as features: what a laboratory is free to choose must not move them."""

from dataclasses import replace

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison.recording import (
    Channel,
    recordings,
    through_air,
)
from calibrate.discrepancy.comparison.repeats import (
    from_targets,
    from_vectors,
    measured_features,
)
from calibrate.discrepancy.library.measurements import _from_seating, read_measurements
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.diagnosis.base import BEFORE, TOE, UsualSizes
from calibrate.labtests.diagnosis.confined import NAME as CONFINED
from calibrate.labtests.diagnosis.contact import (
    begins_before_contact,
    force_before_contact,
    readings_before_contact,
)
from calibrate.labtests.diagnosis.curves import (
    TEST_FEATURES,
    declare,
    declare_before_contact,
    declare_targets,
    feature_values,
    recorded_feature_values,
    segments_of,
    tared_rows,
)
from calibrate.labtests.diagnosis.unconfined import NAME as UNCONFINED
from calibrate.labtests.measured import Target

FEATURES = declare(UsualSizes(400.0, 6.0, 200.0))
PEAK = [f.kind for f in FEATURES].index("peak force")


def confined(points=2000):
    """Displacement grows with the root of force, unloads along a line of 800 N/mm."""
    force = np.linspace(0, 400, points)
    up = 0.3 * np.sqrt(force)
    down = up[-1] - (400 - force[::-1]) / 800
    return np.concatenate([up, down[1:]]), np.concatenate([force, force[::-1][1:]])


def unconfined(points=2000):
    """A parabola with its peak of 200 N at 6 mm."""
    travel = np.linspace(0, 13, points)
    return travel, 200 * np.maximum(1 - (travel / 6 - 1) ** 2, 0.0) + 0 * travel


def both(points=2000):
    return {CONFINED: confined(points), UNCONFINED: unconfined(points)}


def test_there_are_about_fifty_features_in_named_segments():
    assert 40 <= len(FEATURES) <= 60
    names = {(test, segment) for test, segment, _ in segments_of(FEATURES)}
    assert {(CONFINED, s) for s in ("toe", "loading", "200-400 N", "reversal", "unloading")} < names
    assert {(UNCONFINED, s) for s in ("toe", "rise", "peak", "softening")} < names
    assert all(0 <= f.position <= 1 for f in FEATURES)


def test_displacements_on_loading_and_unloading_are_those_of_the_formula():
    values = feature_values(FEATURES, both())
    for feature, value in zip(FEATURES, values, strict=True):
        if feature.kind == "loading":
            assert value == pytest.approx(0.3 * (feature.abscissa**0.5 - 200**0.5), abs=2e-3)
        if feature.kind == "unloading":
            exact = 0.3 * (20 - 200**0.5) - (400 - feature.abscissa) / 800
            assert value == pytest.approx(exact, abs=2e-3)


def test_forces_in_crushing_count_from_the_seating_force():
    """Seating at 4 N lies where 1 - (1 - x)^2 = 0.02; a line through a window of a parabola
    is off by its curvature times a third of the half-width squared: 0.1 N here."""
    seat = 6 * (1 - np.sqrt(1 - 0.02))
    values = feature_values(FEATURES, both())
    for feature, value in zip(FEATURES, values, strict=True):
        if feature.kind == "crushing" and 0.5 < feature.abscissa < 11:
            exact = 200 * (1 - ((feature.abscissa + seat) / 6 - 1) ** 2)
            assert value == pytest.approx(exact, abs=0.25)
    assert values[PEAK] == pytest.approx(200, abs=0.2)


@pytest.mark.parametrize("zero", [-7.0, 0.0, 120.0])
def test_the_zero_of_displacement_drops_out(zero):
    moved = {test: (x + zero, f) for test, (x, f) in both().items()}
    np.testing.assert_allclose(
        feature_values(FEATURES, moved), feature_values(FEATURES, both()), atol=1e-9
    )


def test_noise_and_coarse_sampling_move_features_by_little():
    """Noise of 1 N and 0.005 mm at 150 points a test: no feature moves by more than 2 % of
    the range of its unit."""
    rng = np.random.default_rng(3)
    noisy = {
        test: (x + 0.005 * rng.standard_normal(len(x)), f + rng.standard_normal(len(f)))
        for test, (x, f) in both(150).items()
    }
    apart = np.abs(feature_values(FEATURES, noisy) - feature_values(FEATURES, both()))
    ranges = np.array([6.0 if f.unit == "mm" else 200.0 for f in FEATURES])
    special = np.array([f.kind == "peak displacement" for f in FEATURES])
    assert (apart / ranges)[~special].max() < 0.02


def test_what_a_curve_does_not_reach_is_missing_and_can_be_dropped():
    x, f = confined()
    top = int(np.argmax(f))
    short = {CONFINED: (x[: top + 1], f[: top + 1])}
    values = feature_values(FEATURES, short)
    kinds = np.array([feature.kind for feature in FEATURES])
    assert np.isfinite(values[kinds == "loading"]).all()
    assert np.isnan(values[kinds == "unloading"][1:]).all()
    kept = measured_features(FEATURES, [short, short], np.array([values, values]))
    assert {f.kind for f in kept} <= {"loading", "largest force", "travel at the top", "unloading"}
    assert from_vectors(kept, np.array([feature_values(kept, short)] * 2)).counts.tolist() == [
        2.0
    ] * len(kept)


def test_a_curve_of_seven_points_can_be_read():
    values = feature_values(FEATURES, both(7))
    assert np.isfinite(values).all()


def test_specimens_of_one_test_share_nothing_with_those_of_the_other():
    both_tests, one = both(300), {CONFINED: confined(300)}
    sample = from_vectors(
        FEATURES, np.array([feature_values(FEATURES, c) for c in (both_tests, one, one)])
    )
    assert sample.counts.tolist() == [3.0 if f.test == CONFINED else 1.0 for f in FEATURES]
    assert sample.shared[0, -1] == 1.0
    assert CONFINED in sample.scatter and UNCONFINED not in sample.scatter


def test_never_measured_is_refused_by_name():
    with pytest.raises(ValueError, match="displacement at 5 N"):
        from_vectors(FEATURES, np.full((2, len(FEATURES)), np.nan))


def test_targets_alone_are_a_sample_too():
    features = declare_targets(["depression_depth_mm", "crushing_force_n"])
    values = {"depression_depth_mm": (3.36, 0.3, 4), "crushing_force_n": (206.0, 20.0, 4)}
    sample = from_targets(features, values)
    assert sample.mean.tolist() == [3.36, 206.0]
    assert sample.scatter[UNCONFINED].freedom == 3
    assert sample.scatter[UNCONFINED].products[0, 0] == pytest.approx(3 * 20.0**2)


def test_a_target_that_no_library_holds_is_refused_by_name():
    """A soil of which the failure strain alone is known."""
    lab = load_lab(bundled_lab())
    alone = replace(lab, targets={"failure_strain_percent": Target(5.0, 0.5, 3)})
    with pytest.raises(InputError, match="knows no target failure_strain_percent"):
        read_measurements(alone, declare_targets())


def test_recording_adds_nothing_where_the_typical_specimen_ends():
    """The same but for the last third of crushing: 0 there, finite everywhere."""
    channels = {CONFINED: Channel(0.3, 0.5, 0.002), UNCONFINED: Channel(0.3, 0.5, 0.002)}
    whole = both()
    displacement, force = whole[UNCONFINED]
    ends = displacement < 0.6 * displacement.max()
    short = {**whole, UNCONFINED: (displacement[ends], force[ends])}
    missing = np.isnan(feature_values(FEATURES, short))
    assert missing.any() and not np.isnan(feature_values(FEATURES, whole)).any()
    found = recordings(FEATURES, short, channels, np.random.default_rng(0))
    shift, covariance, either = map(np.nan_to_num, (found.shift, found.covariance(), found.either))
    assert not shift[missing].any() and not either[missing].any()
    assert np.isfinite(covariance).all() and np.diag(covariance)[~missing].all()


def test_recording_misses_the_peak_and_scatters():
    channels = {CONFINED: Channel(0.3, 0.5, 0.002), UNCONFINED: Channel(0.3, 0.5, 0.002)}
    found = recordings(FEATURES, both(), channels, np.random.default_rng(0))
    shift, covariance, either = found.shift, found.covariance(), found.either
    top = [f.kind for f in FEATURES].index("largest force")
    assert shift[top] < -1
    assert either[top] > 0.5  # a machine that averages misses more of it than one that samples
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
    assert 0.1 < np.sqrt(covariance[PEAK, PEAK]) < 1.0


def through(way: float, offset: float = 0.0):
    """Both curves, read too large by an offset, behind a way through the air, fine all along."""
    found = {}
    for test, (x, force) in both().items():
        x, force = through_air(x, force, way)
        path = np.linspace(0.0, np.abs(np.diff(x)).sum(), 4000)
        along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
        found[test] = (np.interp(path, along, x), np.interp(path, along, force) + offset)
    return found


def test_an_offset_that_was_seen_before_contact_is_taken_off_where_the_turn_does_not_matter():
    rows = tared_rows(FEATURES)
    tared, untared = (
        recorded_feature_values(FEATURES, through(0.8)),
        recorded_feature_values(FEATURES, through(0.8, 25.0)),
    )
    np.testing.assert_allclose(untared[rows], tared[rows], atol=0.02)
    largest = [f.kind for f in FEATURES].index("largest force")
    assert not rows[largest]
    assert untared[largest] == pytest.approx(tared[largest] + 25.0, abs=0.1)


def test_a_loading_that_ends_too_early_once_tared_lacks_its_last_features():
    """Read 25 N too large and turned at a reading of 400 N: nothing is known above 375 N."""
    x, force = confined()
    air = np.linspace(-0.8, -0.01, 20)
    on = force <= 375
    curves = {CONFINED: (np.append(air, x[on]), np.append(0 * air, force[on]) + 25.0)}
    values = dict(
        zip([f.name for f in FEATURES], recorded_feature_values(FEATURES, curves), strict=True)
    )
    assert np.isnan(values["displacement at 380 N, loading"])
    assert np.isnan(values["displacement at 396 N, loading"])
    assert np.isfinite(values["displacement at 350 N, loading"])
    assert np.isfinite(values["displacement at 392 N, unloading"])


def test_what_another_curve_shows_before_contact_serves_one_that_does_not():
    x, force = unconfined()
    alone = {UNCONFINED: (x, force + 25.0)}
    values = recorded_feature_values(FEATURES, alone, {UNCONFINED: 25.0})
    np.testing.assert_allclose(values[PEAK], feature_values(FEATURES, both())[PEAK], atol=0.1)
    assert recorded_feature_values(FEATURES, alone)[PEAK] == pytest.approx(
        values[PEAK] + 25.0, abs=0.5
    )


def test_a_soft_beginning_is_not_taken_for_air():
    force = unconfined()[1]
    assert readings_before_contact(force) > 3
    assert not force_before_contact(force) > 0.3  # NaN, or next to nothing
    noise = 0.3 * np.random.default_rng(0).standard_normal(len(force) + 40)
    behind = np.concatenate([np.zeros(40), force]) + 7.0 + noise
    assert force_before_contact(behind) == pytest.approx(7.0, abs=0.2)


def test_a_way_through_the_air_is_cut_off_again():
    """Recorded through air or from contact on: the same shifts, but for where readings fall."""
    channels = {CONFINED: Channel(0.1, 0.2, 0.002), UNCONFINED: Channel(0.1, 0.2, 0.002)}
    rows = np.array([f.kind != "loading" or f.abscissa >= 10 for f in FEATURES])
    found = [
        recordings(FEATURES, both(), channels, np.random.default_rng(0), 60, air).shift
        for air in ({}, {CONFINED: 0.6, UNCONFINED: 0.6})
    ]
    spread = np.where([f.unit == "mm" for f in FEATURES], 0.03, 0.8)
    assert (np.abs(found[1] - found[0]) < spread)[rows].all()


# ------------------------------------------------------------------ where records begin


def recorded(seed: int, air: float, begins: float = 0.0, rest: float = 0.0, power: float = 2.0):
    """A record with 0.4 N of noise that rises as 12 N (u/mm)^power after `air` (mm) at `rest` (N),
    and begins where the rise reaches `begins` (N)."""
    way = np.arange(0.0, 6.0, 0.05)
    rise = 12.0 * np.maximum(way - air, 0.0) ** power
    force = rise + rest + 0.4 * np.random.default_rng(seed).standard_normal(len(way))
    first = int(np.argmax(rise >= begins)) if begins else 0
    return way[first:], force[first:]


def held(seed: int, preload: float, creep: float = 0.0, tared: float = 0.0, air: float = 0.0):
    """A record whose platen stands for sixty readings, creeping by `creep` (mm) a reading, at a
    preload (N), before it moves, through `air` (mm) first; `tared` (N) was taken off."""
    way, force = recorded(seed, air, preload)
    noise = 0.4 * np.random.default_rng([seed, 1]).standard_normal(60)
    standing = way[0] + creep * np.arange(-60.0, 0.0)
    return np.r_[standing, way], np.r_[preload + noise, force] - tared


@pytest.mark.parametrize(
    ("what", "records", "before"),
    [
        ("air", [recorded(k, 0.6) for k in range(4)], True),
        ("air, not tared", [recorded(k, 0.6, rest=10.0) for k in range(4)], True),
        ("air, one specimen", [recorded(9, 1.0)], True),
        ("one of four begins later", [recorded(k, 0.6, 3.0 * (k == 1)) for k in range(4)], True),
        ("preload of 1.5 N", [recorded(k, 0.6, 1.5) for k in range(4)], False),
        ("preload of 3.5 N", [recorded(k, 0.6, 3.5) for k in range(4)], False),
        ("preload of 10 N", [recorded(k, 0.6, 10.0) for k in range(4)], False),
        ("preload of 10 N, tared there", [recorded(k, 0.6, 10.0, -10.0) for k in range(4)], False),
        ("three of four begin later", [recorded(k, 0.6, 10.0 * (k > 0)) for k in range(4)], False),
        ("a straight rise from contact on", [recorded(k, 0.0, power=1.0) for k in range(4)], False),
        ("preload of 6 N", [recorded(k, 0.6, 6.0) for k in range(4)], False),
        ("no noise, from contact on", [(np.arange(9.0), 5.0 * np.arange(9.0))], False),
        ("a preload of 10 N, held", [held(k, 10.0) for k in range(4)], False),
        ("a preload of 10 N, held, creeping", [held(k, 10.0, 0.001) for k in range(4)], False),
        ("a preload, held, then tared", [held(k, 10.0, tared=10.0) for k in range(4)], False),
        ("three readings", [(np.arange(3.0), np.arange(3.0))], False),
        ("at rest, and then air", [held(k, 0.0, air=0.6) for k in range(4)], True),
    ],
)
def test_records_that_hold_readings_before_contact_are_told_from_those_that_do_not(
    what, records, before
):
    assert begins_before_contact(records) == before, what


def both_tests(begins: float) -> tuple[dict, dict]:
    """Curves of both tests from contact on, and the same from a force (N) on."""
    way = np.linspace(0.0, 12.0, 400)
    whole = {CONFINED: confined(400), UNCONFINED: (way, 200 * way / 6 * np.exp(1 - way / 6))}
    first = {test: int(np.argmax(force >= begins)) for test, (_, force) in whole.items()}
    return whole, {t: (x[first[t] :], f[first[t] :]) for t, (x, f) in whole.items()}


@pytest.mark.parametrize("begins", [1.0, 3.5, 10.0, 35.0])
def test_a_record_that_begins_at_a_preload_lacks_what_comes_before_and_nothing_else(begins):
    whole, cut = both_tests(begins)
    every = (*FEATURES, *declare_before_contact())
    before = feature_values(every, whole)
    found = recorded_feature_values(every, cut, begun=(CONFINED, UNCONFINED))
    lacks = [
        f.kind == BEFORE
        or f.segment == TOE
        or (f.kind == "loading" and f.abscissa < begins and f.test == CONFINED)
        for f in every
    ]
    assert np.isnan(found[lacks]).all()
    mould = np.array([f.test == CONFINED for f in every]) & ~np.array(lacks)
    assert found[mould] == pytest.approx(before[mould], abs=2e-2)


@pytest.mark.parametrize("begins", [8.0, 10.0, 20.0])
def test_travel_before_a_preload_is_that_of_a_curve_like_it(begins):
    """A reference half as strong and a third longer, of the same form: crushing counts from the
    seating force as if the record had begun there."""
    whole, cut = both_tests(begins)
    way, force = whole[UNCONFINED]
    like = {UNCONFINED: (1.33 * way, 0.5 * force)}
    from_there = _from_seating(FEATURES, cut, like, (UNCONFINED,))
    found = recorded_feature_values(FEATURES, from_there, begun=(UNCONFINED,))
    before = feature_values(FEATURES, whole)
    crushed = [
        i for i, f in enumerate(FEATURES)
        if f.test == UNCONFINED and f.segment != TOE and f.abscissa < 11.5
    ]  # fmt: skip
    assert found[crushed] == pytest.approx(before[crushed], rel=2e-3, abs=0.01)
    late = recorded_feature_values(FEATURES, cut, begun=(UNCONFINED,))
    assert np.abs(late[crushed] / before[crushed] - 1).max() > 0.01  # what it would be without


@pytest.mark.parametrize(
    ("high", "named"),
    [(400.0, "200-400 N"), (785.4, "393-785 N"), (100.0, "50-100 N"), (981.7, "491-982 N"),
     (39.0, "20-39 N"), (2000.0, "1000-2000 N")],
)  # fmt: skip
def test_the_upper_half_of_loading_is_named_by_the_lab_s_own_forces(high, named):
    features = declare(UsualSizes(high, 6.0, 200.0))
    segments = {f.segment for f in features if f.kind == "loading"}
    assert segments == {TOE, "loading", named}
    assert named in TEST_FEATURES[CONFINED].in_words(named)
