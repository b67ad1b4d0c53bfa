"""A machine's readings in closed form: against the effects' own equations along whole curves, the
filter step by step, and as slopes; the beginning of a curve in a fuller mould; the whole response
against what it was when its slopes were written by hand."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.lab_size import SoilPrior, soil_prior_for
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.discrepancy.library.store import bundled_library, load
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.diagnosis.curves import feature_values
from calibrate.response.machine import LAG, MACHINE, TOLD, Machine
from calibrate.response.mould import Filling, MouldReading
from calibrate.response.reading import MachineErrors, filtered
from calibrate.response.response import LAGS, BetweenLags
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


@eqx.filter_jit
def shift(machine: Machine, *given):
    return machine.shift(*given)


def shifted(values: np.ndarray, shape: np.ndarray = USUAL_SHAPE, **strengths: float) -> np.ndarray:
    return np.asarray(shift(MACHINE_HERE, values, errors_of(**strengths), shape, 0.0 * values))


@eqx.filter_jit
def slopes(machine: Machine, *given):
    """Of the shift with values, strengths and shape."""
    return jax.jacfwd(machine.shift, (0, 1, 2))(*given)


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
    return shape + np.array([0.0, MACHINE_HERE.overload(errors_of(**strengths), shape)])


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
    by_stress = power * soil() * CRUSHED
    given = soil(), errors_of(acquisition_lag=lag), USUAL_SHAPE, by_stress
    found = np.asarray(shift(MACHINE_HERE, *given))
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
    assert np.abs(shifted(soil())).max() < 1e-12
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
    given = soil(), errors_of(**error, acquisition_lag=lag), USUAL_SHAPE, 0.0 * soil()
    shown = shift(MACHINE_HERE, *given)
    assert not np.asarray(shown)[BRANCHES].any()
    assert all(np.isfinite(part).all() for part in (shown, *slopes(MACHINE_HERE, *given)))


def test_the_closed_form_is_the_filter_step_by_step():
    """Against a filter in steps of 1 um along the curve that is laid through the features."""
    way, back = map(np.asarray, MOULD._curve(jnp.asarray(soil())))
    length, step, top = 0.3, 1e-3, 400.0
    path = np.arange(way[0], way[-1], step)
    reading = filtered(path, np.interp(path, way, MOULD._loaded), length)
    read = np.interp([20.0, 140.0, 290.0, 200.0, top], reading, path)
    over = np.interp(read[-1], way, MOULD._loaded) / top
    home = np.arange(0.0, over * back[-1] + 6 * length, step)
    force = over * top * np.interp(home / over, back, MOULD._released)
    falling = filtered(home, force + 0.0, length) + (top - force[0]) * np.exp(-home / length)
    none = MachineErrors(*jnp.zeros(6), jnp.ones(()))
    shown = map(jnp.asarray, MOULD._shown)
    late, _, reached = MOULD._late(
        jnp.asarray(way), jnp.asarray(back), none, jnp.asarray(length), *shown
    )
    assert reached
    up = [f.abscissa for f in FEATURES if f.kind == "loading"]
    for force_n, found in zip((20.0, 140.0, 290.0), read[:3], strict=True):
        assert late[up.index(force_n)] == pytest.approx(found - read[3], abs=2e-3)
    for force_n in (40.0, 200.0):
        down = sorted((f.abscissa for f in FEATURES if f.kind == "unloading"), reverse=True)
        where = read[-1] - np.interp(force_n, falling[::-1], home[::-1]) - read[3]
        assert late[len(up) + down.index(force_n)] == pytest.approx(where, abs=2e-3)


@pytest.mark.parametrize("lag", [0.0, 0.04])
def test_slopes_are_those_of_the_shifted_values(lag):
    """By finite differences; at no lag the slope is that of the line to 10 ms (`shift`)."""
    strengths, powers = errors_of(**STRENGTHS, acquisition_lag=lag), np.where(BRANCHES, 0.02, 0.5)
    known = soil(), strengths, USUAL_SHAPE
    directions = [
        (0.1 * soil(), 0 * strengths, USUAL_SHAPE),
        (BRANCHES * np.linspace(0.0, 1.0, len(FEATURES)), 0 * strengths, USUAL_SHAPE),
        *((0 * soil(), 0 * strengths, one) for one in np.eye(2)),
        *((0 * soil(), STRENGTHS.get(name, lag) * one, USUAL_SHAPE)
          for name, one in zip(MACHINE, np.eye(len(MACHINE)), strict=True)),
    ]  # fmt: skip
    found = slopes(MACHINE_HERE, *known, powers * soil())
    before = np.asarray(shift(MACHINE_HERE, *known, powers * soil()))
    for direction in directions:
        ahead = [at + 1e-6 * along for at, along in zip(known, direction, strict=True)]
        shown = np.asarray(shift(MACHINE_HERE, *ahead, powers * ahead[0]))
        along = sum(np.asarray(of @ part) for of, part in zip(found, direction, strict=True))
        largest = np.abs(along).max()
        assert (shown - before) / 1e-6 == pytest.approx(along, abs=1e-3 * largest + 1e-6)
    if not lag:
        small = strengths + 0.01 * (np.array(MACHINE) == "acquisition_lag")
        late = np.asarray(shift(MACHINE_HERE, soil(), small, USUAL_SHAPE, powers * soil()))
        by_lag = np.asarray(found[1])[:, MACHINE.index("acquisition_lag")]
        assert by_lag == pytest.approx((late - before) / 0.01, rel=1e-9, abs=1e-9)


def test_a_good_machine_shows_a_soil_and_its_slopes_as_they_are():
    by_value, by_strength, by_shape = slopes(MACHINE_HERE, soil(), errors_of(), USUAL_SHAPE, soil())
    assert np.abs(by_value).max() < 1e-9 and np.abs(by_shape).max() < 1e-9
    assert (np.abs(by_strength).max(axis=0) > 0).all()


# ---- a fuller mould ----------------------------------------------------------------------------

FILLING = Filling(share=2 / 3, roundness=1e-3)
FULLER = np.array([0.015, 0.0, -0.015])
HEIGHT = 100.0  # mm
LOADING = np.flatnonzero(UP)


def test_a_fuller_mould_begins_where_the_soil_is_pressed_by_its_growth():
    """1 mm of 100 mm times 0.015 times 2/3, from the touch on; the same curve from there on."""
    values, up = soil(), LOADING
    fuller, usual, looser = (
        np.asarray(FILLING.moved(FEATURES, jnp.asarray(values), growth, HEIGHT))
        for growth in jnp.asarray(FULLER)
    )
    assert not usual.any() and not looser.any()
    touch = 2 * values[up[0]] - values[up[1]]  # at 5 and 10 N
    begins = touch + 1.0
    joins = np.maximum(values[up], begins)
    assert (values + fuller)[up] == pytest.approx(joins, abs=2e-3)
    assert (joins == begins).sum() >= 4 and not fuller[~BRANCHES].any()


def test_how_a_mould_fills_is_found_from_its_curves():
    rng, known = np.random.default_rng(5), Filling(0.7, 0.4)
    before = soil() * rng.uniform(0.7, 1.3, (60, 1))
    growth, height = rng.uniform(0.004, 0.025, 60), np.full(60, 100.0)
    moved = jax.vmap(lambda *of: known.moved(FEATURES, *of))
    after = before + np.asarray(moved(before, growth, height))
    after = after + 0.02 * rng.standard_normal(after.shape)
    found = Filling.of(FEATURES, before, after, growth, height)
    assert found is not None
    assert found.share == pytest.approx(0.7, abs=0.02)
    assert found.roundness == pytest.approx(0.4, abs=0.1)
    assert Filling.of(FEATURES, before[:5], after[:5], growth[:5], height[:5]) is None


def test_slopes_with_the_filling_are_those_of_the_values():
    machine = Machine(FEATURES, SPEED, CRUSHING_SPEED, TOLD, filling=Filling(0.7, 0.4))
    strengths, none = np.append(errors_of(load_frame_compliance=1e-6), 0.012), 0.0 * soil()
    found = slopes(machine, soil(), strengths, USUAL_SHAPE, none)
    by_value, by_strength, by_shape = map(np.asarray, found)
    before = np.asarray(shift(machine, soil(), strengths, USUAL_SHAPE, none))

    def ahead(step: float, values=0.0, strength=0.0, shape=0.0) -> np.ndarray:
        known = soil() + step * values, strengths + step * strength, USUAL_SHAPE + step * shape
        return (np.asarray(shift(machine, *known, none)) - before) / step

    assert ahead(1e-6, values=0.1 * soil()) == pytest.approx(by_value @ (0.1 * soil()), abs=1e-4)
    last, taller = np.eye(len(TOLD))[-1], np.array([1.0, 0.0])
    assert ahead(1e-7, strength=last) == pytest.approx(by_strength[:, -1], rel=1e-3, abs=1e-2)
    assert ahead(1e-6, shape=taller) == pytest.approx(by_shape[:, 0], rel=1e-3, abs=1e-3)


# ---- the whole response ------------------------------------------------------------------------


# Sums over features of values, of slopes along one direction of the soil's parameters, and along
# one of the effects, by number of the point: as derivatives written by hand gave them.
BY_HAND = {
    0: (-90.5507645131612, -277.66676263380344, -63.17480262113273),
    1: (-78.84797212718887, -223.53464455540455, -51.25444623684268),
    2: (-188.4161128224419, -254.94363281458084, -55.65782680018284),
    3: (-407.48535360540006, -485.3316643617636, -202.84499111809671),
    7: (-101.77937023791759, -190.9179386541428, -67.38216589388011),
    10: (-100.44805332761055, -165.04674270730365, -59.50859629835584),
    22: (-313.4956646205871, -626.6714714692448, -93.87483379030097),
    27: (-62.948316796557215, -79.11204011073163, -17.31069836215611),
    31: (-158.75262732308983, -380.28752211751333, -72.66451255990901),
    39: (-159.94924002245824, -229.36676342009466, -68.07822449928544),
}


def drawn(spread: np.ndarray, effects, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Soils and strengths of no, one, two or all effects, in turn."""
    rng = np.random.default_rng(2)
    delta = np.clip(rng.standard_normal((count, len(spread))), -2.5, 2.5) * spread
    strengths = np.zeros((count, len(effects)))
    for i in range(count):
        size = (0, 1, 2, len(effects))[i % 4]
        for j in rng.choice(len(effects), size=size, replace=False) if size else ():
            sign = 1 if effects[j].one_sided else rng.choice([-1, 1])
            strengths[i, j] = sign * rng.uniform(0, 0.9) * effects[j].reach
    return delta, strengths


@pytest.fixture(scope="module")
def bundled() -> tuple[EmulatedLibrary, SoilPrior]:
    lab, emulated = load_lab(bundled_lab()), EmulatedLibrary.of(load(bundled_library()))
    own = emulated.for_lab(lab)
    return own, soil_prior_for(lab, own.library)


@pytest.mark.slow
def test_the_response_of_the_bundled_library_is_as_it_was(bundled):
    own, prior = bundled
    local, m = own.at(prior), len(own.units)
    every = drawn(prior.prior_sd, own.candidates(), 100)
    rng, scale = np.random.default_rng(59), own.library.scale()
    weights = rng.standard_normal(m) / scale
    along = rng.standard_normal(len(prior.prior_sd)), rng.standard_normal(len(own.candidates()))
    for number, known in BY_HAND.items():
        values, base, effects = (part[:m] for part in local(*(at[number] for at in every)))
        assert weights @ values == pytest.approx(known[0], rel=1e-10)
        for slopes, direction, by_hand in zip((base, effects), along, known[1:], strict=True):
            assert weights @ slopes @ direction == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_slopes_of_the_whole_response_are_those_of_its_values(bundled, lag):
    """What JAX takes against central differences, as a lab records and tares it.  Where a machine
    is late, slopes of crushing hold the power by which a soil is stronger; at no lag the slope with
    the lag is that of a straight line to a real one."""
    own, prior = bundled
    m, p, k = len(own.units), len(prior.prior_sd), len(own.candidates())
    late = [effect.name for effect in own.candidates()].index(LAG)
    rng, step = np.random.default_rng(4), 1e-5
    shifts = BetweenLags.of(rng.standard_normal((len(LAGS), m)) / 10)
    tared, faster = np.arange(m) % 2 == 0, rng.standard_normal((p, k)) / 100
    shown = own.at(prior).recording(shifts, shifts, late, np.zeros((m, 0))).taring(3, tared)
    shown = shown.longer(rng.standard_normal((1, k))).under(np.linspace(0.5, 1.0, k), faster)
    rows = [not lag or f.test == "confined" for f in own.library.features] + 2 * [True]
    columns = [i for i in range(p + k) if lag or i != p + late]
    for at in rng.uniform(0.05, 0.1, (2, p + k)):
        at[p + late] = lag
        by_jax = np.hstack(shown(at[:p], at[p:])[1:])[rows]
        for column, one in ((i, step * np.eye(p + k)[i]) for i in columns):
            ahead, back = (shown(*np.split(moved, [p]))[0] for moved in (at + one, at - one))
            by_differences = (ahead - back)[rows] / (2 * step)
            largest = max(np.abs(by_jax[:, column]).max(), 1.0)
            assert by_jax[:, column] == pytest.approx(by_differences, abs=1e-6 * largest)
