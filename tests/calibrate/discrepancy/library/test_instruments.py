"""What recording does to curves: read late (the filter, the shift between lags), by load steps."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.discrepancy.comparison.recording import Channel, LoadSteps, recordings
from calibrate.discrepancy.library.description import LocalEmulator
from calibrate.discrepancy.library.instruments import lagged, steering
from calibrate.discrepancy.library.measurements import Measurements, read_measurements
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.diagnosis.base import UsualSizes
from calibrate.labtests.diagnosis.curves import declare, feature_values
from calibrate.response.process import SoilResponse
from calibrate.response.response import LAGS, BetweenLags, Response

FOUND: Any = SimpleNamespace(speeds={"confined": 8.0, "unconfined": 0.01})  # mm/s


def ramp(points: int) -> np.ndarray:
    """Up at 50 N/mm to 400 N and down at 200 N/mm, shape (2, n)."""
    up = np.linspace(0, 8, points), np.linspace(0, 400, points)
    down = np.linspace(8, 6, points), np.linspace(400, 0, points)
    return np.array([np.append(a, b[1:]) for a, b in zip(up, down, strict=True)])


@pytest.mark.parametrize("points", [9, 2001])
def test_a_lagged_ramp_is_the_closed_form(points):
    """R = s (x - l (1 - exp(-x/l))) on the way up, whatever the spacing, and then stretched."""
    length = 8.0 * 0.05
    x, force = lagged({"confined": tuple(ramp(points))}, FOUND, 0.05)["confined"]
    rising = 50 * (x - length * -np.expm1(-x / length))
    factor = force[points - 1] / rising[points - 1]
    assert force[:points] == pytest.approx(factor * rising[:points], abs=1e-9)
    assert force.max() == pytest.approx(400.0)
    assert factor == pytest.approx(400 / (400 - 50 * length), rel=0.02)


def test_without_lag_nothing_changes_and_a_slow_test_hardly():
    curves = {"unconfined": tuple(ramp(400))}
    assert lagged(curves, FOUND, 0.0) is curves
    force = lagged(curves, FOUND, 0.1)["unconfined"][1]
    assert np.abs(force - ramp(400)[1]).max() < 0.5


def test_a_lagged_recording_loses_less_at_the_turn():
    """Coarse recording of a sharp turn misses it; that of a round one does not."""
    features = [f for f in declare(UsualSizes(400.0, 4.0, 250.0)) if f.test == "confined"]
    at = [f.name for f in features].index("travel at the top, confined")
    channels = {"confined": Channel(0.1, 0.1, 1e-3)}
    curves = {"confined": tuple(ramp(2000))}
    lost = [
        recordings(
            features, lagged(curves, FOUND, lag), channels, np.random.default_rng(0), 40
        ).shift
        for lag in (0.0, 0.1)
    ]
    assert abs(lost[1][at]) < 0.6 * abs(lost[0][at])


class Formula(eqx.Module):
    """A soil of three features that show their errors as they are."""

    formula: Callable = eqx.field(static=True)

    def along(self, x, s, direction):
        return self.formula(x, s), jnp.zeros(3)

    def steepness(self, x, s):
        return jnp.ones(3)


def local(soil, errors=lambda x, s: np.zeros((3, 0)), effects: int = 2) -> LocalEmulator:
    """Three features of one soil parameter and some effects by formula, and their errors."""
    none, one, shown = np.zeros(1), np.ones(1), cast(SoilResponse, Formula(soil))
    response = Response.plain(
        shown, none, one, np.ones(effects), np.zeros(effects, bool), np.ones(3), (0, 0), None,
        np.zeros((0, effects)),
    )  # fmt: skip
    emulator: Any = None
    stated: Any = SimpleNamespace(of_values=lambda emulator, x, s: errors(x, s))
    return LocalEmulator(emulator, stated, response)


def test_shifts_go_smoothly_between_lags_and_slopes_are_theirs():
    rows = np.random.default_rng(1).normal(size=(len(LAGS), 3))
    between = BetweenLags.of(rows)
    slope = jax.jacfwd(between)
    for number, lag in enumerate(LAGS):
        assert np.asarray(between(lag)) == pytest.approx(rows[number])
        if lag < LAGS[-1]:
            assert np.asarray(slope(lag)) == pytest.approx(np.asarray(slope(lag + 1e-9)), abs=1e-5)
    ahead, back = (np.asarray(between(0.7 + step)) for step in (1e-4, -1e-4))
    assert np.asarray(slope(0.7)) == pytest.approx((ahead - back) / 2e-4, rel=1e-4)
    assert not np.asarray(slope(2 * LAGS[-1])).any()


def test_an_emulator_as_recorded_adds_shift_slope_and_half_difference():
    rows = np.arange(3.0 * len(LAGS)).reshape(len(LAGS), 3)
    turn, shifts = np.array([[0.0], [0.5], [0.0]]), BetweenLags.of(rows)
    read = local(lambda x, s: jnp.ones(3)).recording(shifts, shifts, 0, turn)
    at = np.array([LAGS[1], 0.0])
    values, _, effects = (part[:3] for part in read(np.zeros(1), at))
    assert values == pytest.approx(1 + rows[1])
    assert effects[:, 0] == pytest.approx(np.asarray(jax.jacfwd(shifts)(LAGS[1])))
    assert effects[:, 0].all()
    wrong = read.wrong(np.zeros(1), at)[:3]
    assert wrong[:, 0] == pytest.approx(rows[1]) and (wrong[:, 1:] == turn).all()


def test_how_a_machine_turns_may_be_another_way():
    """1 N of 400, 0.02 mm; nothing else."""
    features = Cylinder(0.05, 0.1, 200.0, 400.0).features()
    found = steering(features)
    kinds = [f.kind for f in features]
    assert found.sum(axis=0) == pytest.approx([1.0, 0.02])
    for column, kind in enumerate(("largest force", "travel at the top")):
        assert np.flatnonzero(found[:, column]).tolist() == [kinds.index(kind)]


def test_an_effectless_library_has_one_shift():
    read = BetweenLags.of(np.array([[1.0, 2.0]]))
    for lag in (0.0, 0.3, 9.0):
        assert np.asarray(read(lag)) == pytest.approx([1.0, 2.0])
        assert not np.asarray(jax.jacfwd(read)(lag)).any()


MOVED = np.arange(9.0).reshape(3, 3) + 1  # three features that three effects move together


def affine(x, s):
    """The second effect is an offset, on which the slope with the soil depends."""
    return MOVED @ s + x * s[1]


def test_features_of_tared_curves_do_not_see_the_offset():
    rows = np.array([True, False, True])
    known = local(affine, lambda x, s: np.full((3, 2), s[1]), effects=3)
    tared, at = known.taring(1, rows), np.array([1.0, 2.0, 3.0])
    values, base, effects = (part[:3] for part in tared(np.zeros(1), at))
    without = MOVED @ np.array([1.0, 0.0, 3.0])
    assert values == pytest.approx(np.where(rows, without, MOVED @ at))
    assert base[:, 0].tolist() == [0.0, 2.0, 0.0]
    assert effects[:, 1].tolist() == [0.0, MOVED[1, 1], 0.0]
    assert effects[:, [0, 2]] == pytest.approx(MOVED[:, [0, 2]])
    assert tared.wrong(np.zeros(1), at)[:3, 0].tolist() == [0.0, 2.0, 0.0]
    same = tared(np.zeros(1), np.array([1.0, 0.0, 3.0]))[0][:3]
    assert same == pytest.approx(without)


def test_further_features_depend_on_effects_alone_and_errors_are_free_beside_them():
    rows = np.array([[0.0, 5.0, 0.0]])
    longer = local(affine, effects=3).freed(np.ones((3, 1))).longer(rows)
    values, base, effects = longer(np.ones(1), np.array([1.0, 2.0, 3.0]))
    assert values[3] == 10.0 and not base[3].any() and effects[3].tolist() == [0.0, 5.0, 0.0]
    assert longer.wrong(np.ones(1), np.zeros(3))[:4, 0].tolist() == [1.0, 1.0, 1.0, 0.0]


def test_under_another_condition_effects_are_scaled_and_move_the_soil():
    known, faster = local(affine, effects=3), np.array([[0.0, 0.0, 0.4]])
    moved = known.under(np.array([1.0, 0.5, 1.0]), faster)
    at = np.array([1.0, 2.0, 3.0])
    values, base, effects = moved(np.ones(1), at)
    there = known(np.array([1.0 + 0.4 * 3.0]), at * [1.0, 0.5, 1.0])
    assert values == pytest.approx(there[0]) and base == pytest.approx(there[1])
    expected = there[2] * [1.0, 0.5, 1.0] + there[1] @ faster
    assert effects == pytest.approx(expected)


@pytest.mark.parametrize(
    ("before", "tests"),
    [
        (np.empty((0, 2)), ()),
        (np.array([[0.1, np.nan], [np.nan, np.nan]]), ("confined",)),
        (np.array([[0.1, 0.2]]), ("confined", "unconfined")),
    ],
)
def test_tests_are_tared_where_a_force_before_contact_is_known(before, tests):
    nothing: Any = None
    assert Measurements(nothing, nothing, before, {}, (), {}).tared == tests


def of_loading(force_high: float) -> list:
    features = declare(UsualSizes(force_high, 4.0, 250.0))
    return [f for f in features if f.kind == "loading"]


def test_load_steps_are_read_straight_between_loads():
    """A root curve at five loads: what is read between them is off by the chord's distance."""
    force = np.linspace(0, 400, 4001)
    loads = np.array([25.0, 50.0, 100.0, 200.0, 400.0, 800.0])
    curves, steps = {"confined": (np.sqrt(force), force)}, LoadSteps(loads, 1e-9)
    x, read = steps.record(*curves["confined"], np.random.default_rng(0))
    assert read.tolist() == loads[:-1].tolist()
    assert x == pytest.approx(np.sqrt(loads[:-1]), abs=1e-6)
    features = of_loading(400.0)
    shift = recordings(features, curves, {"confined": steps}, np.random.default_rng(0)).shift
    for feature, found in zip(features, shift, strict=True):
        if feature.abscissa >= loads[0]:
            chord = np.interp(feature.abscissa, loads, np.sqrt(loads))
            assert found == pytest.approx(chord - np.sqrt(feature.abscissa), abs=1e-3)


def test_a_curve_that_is_pressed_further_is_read_up_to_the_largest_force():
    features = declare(UsualSizes(400.0, 4.0, 250.0))
    up, down = np.linspace(0, 1200, 3001), np.linspace(1200, 0, 500)
    force = np.append(up, down[1:])
    x = np.append(np.sqrt(up), np.sqrt(1200) - (1200 - down[1:]) / 800)
    to = int(np.searchsorted(up, 400.0)) + 1
    further = feature_values(features, {"confined": (x, force)})
    only_up = feature_values(features, {"confined": (x[:to], force[:to])})
    for feature, one, other in zip(features, further, only_up, strict=True):
        if feature.kind == "loading":
            assert one == pytest.approx(other, abs=1e-9)
        else:
            assert np.isnan(one)


def test_load_steps_and_strengths_of_a_real_soil_are_measured_features():
    """Displacement from half to the largest load, and the strengths' mean and scatter, as the
    files give them."""
    lab = load_lab(bundled_lab("trumao_curves"))
    found = read_measurements(lab, Cylinder.of(lab).features())
    measured = found.measured
    names = [f.name for f in measured.features]
    assert names[-1] == "crushing_force_n"
    assert {f.kind for f in measured.features[:-1]} == {"loading"}
    assert min(f.abscissa for f in measured.features[:-1]) > 49.0  # 25 kPa, the first load
    assert isinstance(found.channels["confined"], LoadSteps)
    at = names.index("displacement at 777.546 N, loading")
    curves = [c for c in lab.curves if c.test == "confined"]
    ways = [np.interp([392.7, 777.546], c.force_n[:7], c.displacement_mm[:7]) for c in curves]
    assert measured.specimens[:3, at] == pytest.approx([b - a for a, b in ways], rel=1e-3)
    strengths, target = measured.specimens[3:, -1], lab.targets["crushing_force_n"]
    assert len(strengths) == target.repeats and not np.isfinite(measured.specimens[:3, -1]).any()
    assert strengths.mean() == pytest.approx(target.mean)
    assert strengths.std(ddof=1) == pytest.approx(target.scatter)
    assert measured.shared[at, -1] == 0 and measured.counts[at] == 3
