"""Late readings in closed form: against the filtered curve itself, and as slopes."""

import numpy as np
import pytest

from calibrate.discrepancy.library.load_cell_lag import LoadCellLag
from calibrate.discrepancy.library.low_pass import filtered
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.labtests.diagnosis.curves import feature_values

SPEED = 8.0  # mm/s
FEATURES = Cylinder(0.05, 0.1, 200.0, 400.0).features()
LAG_FILTER = LoadCellLag(FEATURES, SPEED)
UP = np.array([f.kind == "loading" for f in FEATURES])
DOWN = np.array([f.kind == "unloading" for f in FEATURES])


def stiff(force: np.ndarray) -> np.ndarray:
    """Travel (mm) of a soil that stiffens: the power law x = 3 (F/400)^0.6."""
    return 3.0 * (force / 400.0) ** 0.6


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


def features(length: float) -> np.ndarray:
    return feature_values(FEATURES, {"confined": curve(length)})


@pytest.mark.parametrize("lag", [0.01, 0.03, 0.06])
def test_a_soil_with_a_lag_moves_as_the_filter_says(lag):
    exact = features(1e-6)
    known = np.where(np.isfinite(exact), exact, 0.0)
    moved = LAG_FILTER.shift(known[None], np.array([lag]))[0]
    change = features(SPEED * lag) - exact
    length = SPEED * lag
    middle = DOWN & np.array([40 <= f.abscissa <= 320 for f in FEATURES])
    assert change[middle] == pytest.approx(moved[middle], abs=0.1 * length)
    assert change[UP] == pytest.approx(moved[UP], abs=0.12 * length)
    assert np.abs(change[middle]).min() > 0.9 * length  # something to be predicted


def test_nothing_moves_without_a_lag_and_nothing_but_the_branches_with_one():
    values = np.nan_to_num(features(1e-6))[None]
    assert not LAG_FILTER.shift(values, np.zeros(1)).any()
    moved = LAG_FILTER.shift(values, np.array([0.05]))[0]
    assert not moved[~(UP | DOWN)].any() and np.abs(moved[DOWN]).min() > 0.1


@pytest.mark.parametrize("absurd", [0.0, 1e9, -1e9, np.inf])
def test_what_is_no_curve_is_left_as_it_is(absurd):
    """Fits try any values on their way."""
    values = np.full((1, len(FEATURES)), absurd)
    with np.errstate(invalid="ignore"):
        assert not LAG_FILTER.shift(values, np.array([0.05])).any()
        assert not LAG_FILTER.shift(np.nan_to_num(features(1e-6))[None], np.array([1e9])).any()


def test_the_closed_form_is_the_filter_step_by_step():
    """Against a filter in steps of 1 um along the curve that is laid through the features."""
    values = np.nan_to_num(features(1e-6))[None]
    way, back = (each[0] for each in LAG_FILTER._curve(values))
    length, step, top = 0.3, 1e-3, 400.0
    path = np.arange(way[0], way[-1], step)
    reading = filtered(path, np.interp(path, way, LAG_FILTER._loaded), length)
    read = np.interp([20.0, 140.0, 290.0, 200.0, top], reading, path)
    over = np.interp(read[-1], way, LAG_FILTER._loaded) / top
    home = np.arange(0.0, over * back[-1] + 6 * length, step)
    force = over * top * np.interp(home / over, back, LAG_FILTER._released)
    falling = filtered(home, force + 0.0, length) + (top - force[0]) * np.exp(-home / length)
    late, reached = LAG_FILTER._late(way[None], back[None], np.array([[length]]))
    assert reached.all()
    up = [f.abscissa for f in FEATURES if f.kind == "loading"]
    for force_n, found in zip((20.0, 140.0, 290.0), read[:3], strict=True):
        assert late[0, up.index(force_n)] == pytest.approx(found - read[3], abs=2e-3)
    for force_n in (40.0, 200.0):
        down = sorted((f.abscissa for f in FEATURES if f.kind == "unloading"), reverse=True)
        where = read[-1] - np.interp(force_n, falling[::-1], home[::-1]) - read[3]
        assert late[0, len(up) + down.index(force_n)] == pytest.approx(where, abs=2e-3)


def test_slopes_are_those_of_the_shifted_values():
    values, rng = np.nan_to_num(features(1e-6)), np.random.default_rng(0)
    smooth = np.where(UP | DOWN, np.linspace(0.0, 1.0, len(values)), 0.0)
    slopes = np.column_stack(
        [0.1 * values, smooth, rng.standard_normal(len(values)) * ~(UP | DOWN)]
    )
    shown, turned, along = LAG_FILTER.read(values, slopes, 0.04)
    assert shown == pytest.approx(values + LAG_FILTER.shift(values[None], np.array([0.04]))[0])
    for before, after in zip(slopes.T, turned.T, strict=True):
        beside = LAG_FILTER.read(values + 1e-6 * before, slopes, 0.04)[0]
        assert (beside - shown) / 1e-6 == pytest.approx(after, abs=1e-4 * np.abs(before).max())
    later = LAG_FILTER.read(values, slopes, 0.04 + 1e-6)[0]
    assert along == pytest.approx((later - shown) / 1e-6, abs=1e-4 * np.abs(along).max())
    none = LAG_FILTER.read(values, slopes, 0.0)
    assert none[0] is values and none[1] is slopes
