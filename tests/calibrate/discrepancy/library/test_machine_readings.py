"""A machine's readings in closed form: against the effects' own equations along whole curves, the
filter step by step, and as slopes; the beginning of a curve in a fuller mould."""

from functools import cache

import numpy as np
import pytest

from calibrate.discrepancy.library.filling import Filling
from calibrate.discrepancy.library.machine import MACHINE, TOLD, Machine
from calibrate.discrepancy.library.mould_reading import MouldReading
from calibrate.discrepancy.library.reading import MachineErrors, filtered
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.labtests.diagnosis.curves import feature_values
from jdem.effects.composite import EFFECTS

SPEED, CRUSHING_SPEED = 8.0, 0.01  # mm/s
CYLINDER = Cylinder(0.05, 0.1, 200.0, 400.0)
FEATURES = CYLINDER.features()
MACHINE_HERE = Machine(FEATURES, SPEED, CRUSHING_SPEED)
MOULD = MouldReading(FEATURES, SPEED)
UP = np.array([f.kind == "loading" for f in FEATURES])
DOWN = np.array([f.kind == "unloading" for f in FEATURES])
BRANCHES = UP | DOWN
LARGEST = np.array([f.kind == "largest force" for f in FEATURES])
CRUSHED = np.array([f.test == "unconfined" and f.kind != "target" for f in FEATURES])
USUAL_SHAPE = np.zeros(2)
STRENGTHS = {  # strong ones, SI
    "load_frame_compliance": 1e-6, "seating_gap": 8e-4, "load_cell_gain": 0.09,
    "load_cell_offset": -11.0, "load_cell_drift": 0.02,
}  # fmt: skip


def errors_of(**strengths: float) -> np.ndarray:
    return np.array([strengths.get(name, 0.0) for name in MACHINE])


def shifted(values: np.ndarray, shape: np.ndarray = USUAL_SHAPE, **strengths: float) -> np.ndarray:
    given = values[None], errors_of(**strengths)[None], shape[None], 0.0 * values[None]
    return MACHINE_HERE.shift(*given)[0]


def pressed(top: float) -> tuple[np.ndarray, np.ndarray]:
    """Travel (mm) and force (N) of a soil that stiffens by x = 3 (F/400)^0.6, and springs back by
    0.8 mm F/400 as a force F falls to nothing."""
    up = np.linspace(0.0, top, 4001)
    loading = 3.0 * (up / 400.0) ** 0.6
    down = up[::-1]
    return (
        np.concatenate([loading, loading[-1] - 0.8 * (top - down) / 400.0]),
        np.concatenate([up, down]),
    )


def crushed(slender: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Travel (mm) and force (N) of a specimen that breaks at 250 N and 4 mm, from its touch on."""
    travel = np.linspace(0.0, 14.0 * slender, 8001)
    u = travel / 4.0 / slender
    return travel, 250.0 * u**1.3 * np.exp(1.3 * (1 - u))


def as_pressed(shape: np.ndarray = USUAL_SHAPE, **strengths: float) -> np.ndarray:
    """The shape at which a machine that is asked for one asks the emulator."""
    over = MACHINE_HERE.overload(errors_of(**strengths)[None], shape[None])[0]
    return shape + np.array([0.0, over])


def shown_by(name: str, strength: float, shape: np.ndarray = USUAL_SHAPE) -> np.ndarray:
    """The features of these soils on a machine with one error, by the effect's own equations."""
    slender, stress = np.exp(shape)
    effect = EFFECTS[name](strength=strength)
    reversal = 400.0 * stress
    if name == "load_cell_gain":
        reversal = reversal / (1 + strength)
    if name == "load_cell_offset":
        reversal = reversal - strength
    curves = {}
    for test, (travel, force), speed in (
        ("confined", pressed(reversal), SPEED), ("unconfined", crushed(slender), CRUSHING_SPEED),
    ):  # fmt: skip
        time = travel / speed if test == "unconfined" else np.zeros_like(travel)
        curves[test] = (
            travel + 1e3 * np.asarray(effect.travel_error(force)) + 0.0 * travel,
            force + np.asarray(effect.force_error(force, time)),
        )
    return feature_values(CYLINDER.shaped(shape).features(), curves)


@pytest.mark.parametrize("shape", [USUAL_SHAPE, np.log([0.6, 0.5])], ids=["usual", "other shape"])
@pytest.mark.parametrize("name", STRENGTHS)
def test_one_error_moves_features_as_its_equations_say(name, shape):
    strength = {name: STRENGTHS[name]}
    exact = shown_by(name, 0.0, as_pressed(shape, **strength))
    moved = shifted(np.nan_to_num(exact), shape, **strength)
    change = shown_by(name, STRENGTHS[name], shape) - exact
    for rows, least in ((BRANCHES, 2e-3), (CRUSHED, 0.5)):  # mm, N: what straight lines cut off
        read = rows & np.isfinite(change)
        largest = np.abs(change[read]).max()
        assert change[read] == pytest.approx(moved[read], abs=least + 0.1 * largest)
    assert np.abs(moved[CRUSHED]).max() > 1.0  # there was something to be told


def test_a_machine_turns_where_it_shows_the_force_that_it_is_asked_for():
    """A gain of 0.25 and an offset of 20 N, asked for 200 N: 180 N/1.25 = 144 N."""
    shape = np.log([1.0, 0.5])
    assert np.exp(as_pressed(shape, load_cell_gain=0.25, load_cell_offset=20.0)[1]) == (
        pytest.approx(144 / 400)
    )
    for harmless in ("load_frame_compliance", "seating_gap", "load_cell_drift"):
        assert as_pressed(shape, **{harmless: STRENGTHS[harmless]}) == pytest.approx(shape)


def test_a_gain_alone_shows_the_soil_at_another_stress_exactly():
    """All forces are read in one proportion: nothing is laid between features."""
    gain = {"load_cell_gain": -0.15}
    exact = np.nan_to_num(shown_by("load_cell_gain", 0.0, as_pressed(USUAL_SHAPE, **gain)))
    known = shown_by("load_cell_gain", -0.15)
    read = BRANCHES & np.isfinite(known)
    assert (exact + shifted(exact, **gain))[read] == pytest.approx(known[read], abs=1e-3)


def test_scalar_targets_move_with_the_machine():
    values, depth, strength = soil(), len(FEATURES) - 2, len(FEATURES) - 1
    assert shifted(values, load_frame_compliance=1e-6)[depth] == pytest.approx(0.2)  # 200 N
    peak = [f.kind for f in FEATURES].index("peak force")
    moved = shifted(values, load_cell_gain=0.1, load_cell_drift=0.01)
    assert moved[strength] == moved[peak] > 0.1 * values[peak]


def curve(length: float) -> tuple[np.ndarray, np.ndarray]:
    """The soil's curve as it is read `length` (mm) late, step by step: the platen goes down until
    the reading is 400 N and up again; unloading from F releases 0.8 mm F/400 as its force falls."""
    step, way, force, reading = 1e-3, 0.0, 0.0, 0.0
    path, shown = [0.0], [0.0]
    while reading < 400.0:
        way += step
        force = 400.0 * (way / 3.0) ** (1 / 0.6)
        reading += step / (length + step) * (force - reading)
        path.append(way)
        shown.append(reading)
    top, turn = force, way
    while way > turn - 0.8 * top / 400.0 - 5 * length:
        way -= step
        force = max(top - (turn - way) * 400.0 / 0.8, 0.0)
        reading += step / (length + step) * (force - reading)
        path.append(way)
        shown.append(reading)
    return np.array(path), np.array(shown)


@cache
def soil() -> np.ndarray:
    """All features of the soil in the mould and of the specimen that breaks, read at once."""
    return np.nan_to_num(
        feature_values(FEATURES, {"confined": curve(1e-6), "unconfined": crushed()})
    )


@pytest.mark.parametrize("lag", [0.01, 0.03, 0.06])
def test_a_soil_with_a_lag_moves_as_the_filter_says(lag):
    moved = shifted(soil(), acquisition_lag=lag)
    length = SPEED * lag
    change = feature_values(FEATURES, {"confined": curve(length)}) - soil()
    middle = DOWN & np.array([40 <= f.abscissa <= 320 for f in FEATURES])
    assert change[middle] == pytest.approx(moved[middle], abs=0.1 * length)
    assert change[UP] == pytest.approx(moved[UP], abs=0.12 * length)
    assert np.abs(change[middle]).min() > 0.9 * length  # something to be predicted


def test_a_late_machine_presses_harder_and_goes_on_reading_more():
    """The force where it turns is v tau S ahead of its reading; a soil that is crushed then is
    stronger by the power of that force by which it depends on stress."""
    lag, power = 0.02, 0.7
    values, strengths = soil()[None], errors_of(acquisition_lag=lag)[None]
    by_stress = power * values * CRUSHED
    found = MACHINE_HERE.shift(values, strengths, USUAL_SHAPE[None], by_stress)[0]
    slope = 400.0 / (0.6 * 3.0)  # N/mm at 400 N
    ahead = SPEED * lag * slope / 400.0
    peak = [f.kind for f in FEATURES].index("peak force")
    assert found[peak] / soil()[peak] == pytest.approx((1 + ahead) ** power - 1, rel=0.15)
    falls = 400.0 / 0.8 * SPEED * lag  # N
    more = 400.0 * ahead - falls * np.log(1 + 400.0 * ahead / falls)
    assert found[LARGEST] == pytest.approx(more, rel=0.25)
    late, prompt = (curve(SPEED * tau)[1].max() for tau in (lag, 1e-6))
    assert found[LARGEST] == pytest.approx(late - prompt, rel=0.25)


def test_nothing_moves_without_errors_and_a_lag_moves_nothing_but_the_branches():
    assert not shifted(soil()).any()
    moved = shifted(soil(), acquisition_lag=0.05)
    assert not moved[~BRANCHES & ~LARGEST].any() and np.abs(moved[DOWN]).min() > 0.1


@pytest.mark.parametrize("absurd", [0.0, 1e9, -1e9, np.inf])
def test_what_is_no_curve_is_left_as_it_is(absurd):
    """Fits try any values on their way."""
    values = np.full(len(FEATURES), absurd)
    with np.errstate(invalid="ignore"):
        assert not shifted(values, acquisition_lag=0.05)[BRANCHES].any()
        assert not shifted(soil(), acquisition_lag=1e9).any()
        assert np.isfinite(shifted(values, seating_gap=1e-3)).all()


@pytest.mark.parametrize(
    "error", [{"load_cell_offset": 500.0}, {"load_cell_gain": -1.0}, {"load_cell_gain": -1.5}]
)
@pytest.mark.parametrize("lag", [0.0, 0.05])
def test_a_machine_that_never_presses_moves_no_branch_of_the_mould(error, lag):
    slopes, along = np.ones((len(FEATURES), 1)), np.zeros((1, 2))
    strengths = errors_of(**error, acquisition_lag=lag)
    shown, *turned = MACHINE_HERE.read(soil(), slopes, strengths, USUAL_SHAPE, along, slopes[:, 0])
    assert (shown == soil())[BRANCHES].all()
    assert all(np.isfinite(part).all() for part in (shown, *turned))


def test_the_closed_form_is_the_filter_step_by_step():
    """Against a filter in steps of 1 um along the curve that is laid through the features."""
    way, back = (each[0] for each in MOULD._curve(soil()[None]))
    length, step, top = 0.3, 1e-3, 400.0
    path = np.arange(way[0], way[-1], step)
    reading = filtered(path, np.interp(path, way, MOULD._loaded), length)
    read = np.interp([20.0, 140.0, 290.0, 200.0, top], reading, path)
    over = np.interp(read[-1], way, MOULD._loaded) / top
    home = np.arange(0.0, over * back[-1] + 6 * length, step)
    force = over * top * np.interp(home / over, back, MOULD._released)
    falling = filtered(home, force + 0.0, length) + (top - force[0]) * np.exp(-home / length)
    none = MachineErrors(*np.zeros((6, 1, 1)), np.ones((1, 1)))
    shown = (each[None] for each in MOULD._shown)
    late, _, reached = MOULD._late(way[None], back[None], none, np.array([[length]]), *shown)
    assert reached.all()
    up = [f.abscissa for f in FEATURES if f.kind == "loading"]
    for force_n, found in zip((20.0, 140.0, 290.0), read[:3], strict=True):
        assert late[0, up.index(force_n)] == pytest.approx(found - read[3], abs=2e-3)
    for force_n in (40.0, 200.0):
        down = sorted((f.abscissa for f in FEATURES if f.kind == "unloading"), reverse=True)
        where = read[-1] - np.interp(force_n, falling[::-1], home[::-1]) - read[3]
        assert late[0, len(up) + down.index(force_n)] == pytest.approx(where, abs=2e-3)


@pytest.mark.parametrize("lag", [0.0, 0.04])
def test_slopes_are_those_of_the_shifted_values(lag):
    values, rng = soil(), np.random.default_rng(0)
    smooth = np.where(BRANCHES, np.linspace(0.0, 1.0, len(values)), 0.0)
    slopes = np.column_stack([0.1 * values, smooth, rng.standard_normal(len(values)) * ~BRANCHES])
    along = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    strengths = errors_of(**STRENGTHS, acquisition_lag=lag)
    powers = np.where(BRANCHES, 0.02, 0.5)
    by_stress = powers * values

    def read(values, strengths, shape):
        """The same, as far as the machine presses harder."""
        pair = (MACHINE_HERE.overload(s[None], h[None])[0] for s, h in
                ((strengths, shape), (known[0], USUAL_SHAPE)))  # fmt: skip
        now, before = pair
        pressed = values + by_stress * (now - before)
        return MACHINE_HERE.read(pressed, slopes, strengths, shape, along, powers * pressed)[0]

    known = (strengths, USUAL_SHAPE, along, by_stress)
    shown, turned, by_strength = MACHINE_HERE.read(values, slopes, *known)
    assert shown == pytest.approx(values + MACHINE_HERE.shift(
        values[None], strengths[None], USUAL_SHAPE[None], by_stress[None])[0])  # fmt: skip
    for before, after, shape in zip(slopes.T, turned.T, along, strict=True):
        beside = read(values + 1e-6 * before, strengths, USUAL_SHAPE + 1e-6 * shape)
        assert (beside - shown) / 1e-6 == pytest.approx(after, abs=1e-3 * np.abs(after).max())
    for number, after in enumerate(by_strength.T):
        step = 1e-5 * abs(STRENGTHS.get(MACHINE[number], 0.04 if lag else 1e3))
        more = strengths + step * np.eye(len(strengths))[number]
        beside = read(values, more, USUAL_SHAPE)
        assert (beside - shown) / step == pytest.approx(after, abs=1e-3 * np.abs(after).max())


def test_a_good_machine_shows_a_soil_and_its_slopes_as_they_are():
    slopes = np.ones((len(FEATURES), 2))
    shown, turned, by_strength = MACHINE_HERE.read(
        soil(), slopes, errors_of(), USUAL_SHAPE, np.zeros((2, 2)), slopes[:, 0]
    )
    assert shown == pytest.approx(soil(), abs=1e-12) and turned is slopes
    assert (np.abs(by_strength).max(axis=0) > 0).all()


@pytest.mark.parametrize("strengths", [errors_of(), errors_of(**STRENGTHS, acquisition_lag=0.04)])
@pytest.mark.parametrize("asked", [[], [0], [2, 5]])
def test_slopes_that_are_asked_for_are_the_same_without_the_others(strengths, asked):
    mask = np.isin(range(len(MACHINE)), asked)
    slopes = np.ones((len(FEATURES), 2))
    given = soil(), slopes, strengths, USUAL_SHAPE, np.zeros((2, 2)), slopes[:, 0]
    every, some = MACHINE_HERE.read(*given), MACHINE_HERE.read(*given, mask)
    assert some[0] == pytest.approx(every[0], abs=1e-12)
    assert some[1] == pytest.approx(every[1], abs=1e-12)
    assert some[2][:, mask] == pytest.approx(every[2][:, mask], abs=1e-12)


# ---- a fuller mould ----------------------------------------------------------------------------

FILLING = Filling(share=2 / 3, roundness=1e-3)
FULLER = np.array([[0.015], [0.0], [-0.015]])
HEIGHT = np.full((3, 1), 100.0)  # mm
LOADING = np.flatnonzero(UP)


def test_a_fuller_mould_begins_where_the_soil_is_pressed_by_its_growth():
    """1 mm of 100 mm times 0.015 times 2/3, from the touch on; the same curve from there on."""
    values, up = soil(), LOADING
    fuller, usual, looser = FILLING.moved(FEATURES, np.tile(values, (3, 1)), FULLER, HEIGHT)
    assert not usual.any() and not looser.any()
    touch = 2 * values[up[0]] - values[up[1]]  # at 5 and 10 N
    begins = touch + 1.0
    joins = np.maximum(values[up], begins)
    assert (values + fuller)[up] == pytest.approx(joins, abs=2e-3)
    assert (joins == begins).sum() >= 4 and not fuller[~BRANCHES].any()


def test_how_a_mould_fills_is_found_from_its_curves():
    rng, known = np.random.default_rng(5), Filling(0.7, 0.4)
    before = soil() * rng.uniform(0.7, 1.3, (60, 1))
    growth, height = rng.uniform(0.004, 0.025, (60, 1)), np.full((60, 1), 100.0)
    after = before + known.moved(FEATURES, before, growth, height)
    after = after + 0.02 * rng.standard_normal(after.shape)
    found = Filling.of(FEATURES, before, after, growth, height)
    assert found is not None
    assert found.share == pytest.approx(0.7, abs=0.02)
    assert found.roundness == pytest.approx(0.4, abs=0.1)
    assert Filling.of(FEATURES, before[:5], after[:5], growth[:5], height[:5]) is None


def test_slopes_with_the_filling_are_those_of_the_values():
    machine = Machine(FEATURES, SPEED, CRUSHING_SPEED, TOLD, filling=Filling(0.7, 0.4))
    values, strengths = soil(), np.append(errors_of(load_frame_compliance=1e-6), 0.012)
    slopes, along = np.outer(values, [0.1, 0.0]), np.array([[0.0, 0.0], [1.0, 0.0]])
    known = slopes, strengths, USUAL_SHAPE, along, 0.0 * values
    shown, turned, by_strength = machine.read(values, *known)
    ahead = machine.read(values + 1e-6 * slopes[:, 0], *known)[0]
    assert (ahead - shown) / 1e-6 == pytest.approx(turned[:, 0], abs=1e-4)
    more = strengths + 1e-7 * np.eye(len(TOLD))[-1]
    ahead = machine.read(values, slopes, more, USUAL_SHAPE, along, 0.0 * values)[0]
    assert (ahead - shown) / 1e-7 == pytest.approx(by_strength[:, -1], rel=1e-3, abs=1e-2)
    taller = machine.read(values, slopes, strengths, np.array([1e-6, 0.0]), along, 0.0 * values)[0]
    assert (taller - shown) / 1e-6 == pytest.approx(turned[:, 1], rel=1e-3, abs=1e-3)
