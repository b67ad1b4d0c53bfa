"""What every contact law owes along its normal: the contract of `jdem.laws.base`.

No force without overlap, finite values and gradients through every kink, tangent = difference, no
energy gained over a cycle, limits and precision, memory and adhesion.  What acts along the
contact is in test_laws_friction.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jdem.apparatus.pair import overlap_path
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from tests.support.law_cases import (
    MOST,
    POINTS,
    RANGES,
    all_jacobians,
    all_rows,
    contact_at,
    corner_soils,
    drive,
    every_exponent,
    every_smoothing,
    kink_paths,
    last_row,
    law_of,
    minimum_of,
    plastic_overlap_of,
    sampled_cycle,
    soil_of,
    stacked,
    stiffness_of,
)

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("cheaply_compiled")]

# ------------------------------------------------------------------ no overlap


@every_exponent
@every_smoothing
def test_no_force_and_no_memory_without_overlap(exponent, smoothing):
    soils = corner_soils(exponent)
    apart = -np.geomspace(1e-12, 1.0, 22)  # as many points as all paths of this file have
    loaded_then_apart = [[1e-5, MOST, 0.5 * MOST, 0.0, *apart]] * len(soils)
    forces, memory = all_rows(stacked(soils), smoothing, jnp.asarray(loaded_then_apart))
    assert not np.any(forces[:, 3:])
    assert not np.any(memory[:, 3:])


@every_exponent
def test_no_pull_off_force_without_overlap(exponent):
    law = law_of(soil_of(exponent, pull_off_force=-0.01))
    for overlap, expected in ((0.0, 0.0), (-1e-6, 0.0), (1e-6, -0.01)):
        normal = law.normal._pull_off(
            contact_at(jnp.asarray(overlap)), jnp.asarray(overlap).clip(0)
        )
        assert normal == expected


# ------------------------------------------------------------------ gradients


@pytest.mark.slow
@every_exponent
@every_smoothing
def test_values_and_gradients_are_finite_through_every_kink(exponent, smoothing):
    soils, paths = stacked(corner_soils(exponent)), kink_paths(exponent)
    by_soil, by_overlap = all_jacobians(soils, smoothing, paths)
    forces, memory = all_rows(soils, smoothing, paths)
    for leaf in jax.tree.leaves((forces, memory, by_soil, by_overlap)):
        assert np.isfinite(leaf).all()
    assert np.any(by_soil.plasticity_ratio)  # the path does feel its parameters


@pytest.mark.slow
@every_exponent
@every_smoothing
def test_tangents_equal_central_differences_away_from_kinks(exponent, smoothing):
    """Relative steps h = 1e-6 and 2h in float64, combined to fourth order.

    d_min lies within 1/100 to 1/1000 of dp, and forces there are differences of numbers as
    large as k2 dp: what h changes, and what round-off does, is amplified by up to A = 1000.
    Truncation (A h)^4 = 1e-12; cancellation A eps/h = 2e-7 of the part's largest force.
    Points of the path are clear of kinks by more than A h.
    """
    soils = corner_soils(exponent)
    paths = jnp.stack([smooth_path(soil) for soil in soils])
    tangents = all_jacobians(stacked(soils), smoothing, paths)[0]
    largest = np.abs(all_rows(stacked(soils), smoothing, paths)[0]).max(axis=1, keepdims=True)
    for name in RANGES:
        expected = central_difference(soils, smoothing, paths, name, 1e-6)
        value = np.asarray([getattr(soil, name) for soil in soils])[:, None, None]
        error = np.abs(getattr(tangents, name) - expected) * value
        assert (error <= 1e-6 * largest + 1e-20).all(), name


def smooth_path(soil):
    plastic, turn = plastic_overlap_of(soil), minimum_of(soil)[1]
    loading = [*np.linspace(0.13, 0.83, 7) * MOST, MOST]
    line = [0.5 * (MOST + plastic), 0.3 * plastic + 0.7 * turn]
    branch = np.linspace(0.61, 0.43, 7) * turn
    reloaded = np.linspace(0.57, 0.73, 4) * turn
    again = np.linspace(0.63, 0.31, 5) * turn
    return jnp.asarray([*loading, *line, *branch, *reloaded, *again])


def central_difference(soils, smoothing, paths, name, step):
    together = stacked(soils)

    def rows(factor):
        moved = eqx.tree_at(lambda s: getattr(s, name), together, getattr(together, name) * factor)
        return np.asarray(all_rows(moved, smoothing, paths)[0])

    value = np.asarray(getattr(together, name))[:, None, None]
    near, wide = (rows(1 + h) - rows(1 - h) for h in (step, 2 * step))
    return (8 * near - wide) / (12 * step * value)


# ------------------------------------------------------------------ energy

turning_points = st.lists(st.floats(-0.1 * MOST, MOST), min_size=6, max_size=6)


def work_done(law, turns):
    """Work that the spring does on its surroundings along the path (J), and the bound on the
    trapezoidal rule's error: between two points the force stays between its two values."""
    overlaps = overlap_path(jnp.asarray(turns), POINTS)
    force = np.concatenate([[0.0], drive(law, overlaps)])
    change = np.diff(np.concatenate([[0.0], overlaps]))
    work = -np.sum(0.5 * (force[1:] + force[:-1]) * change)
    return work, 0.5 * np.sum(np.abs(np.diff(force)) * np.abs(change))


@every_exponent
@every_smoothing
@settings(max_examples=40, deadline=None)
@given(turns=turning_points, corner=st.integers(0, 10))
def test_no_energy_is_gained_over_a_closed_cycle_of_overlap(exponent, smoothing, turns, corner):
    work, uncertainty = work_done(law_of(corner_soils(exponent)[corner], smoothing), [*turns, 0.0])
    assert work <= uncertainty


@every_exponent
@every_smoothing
@settings(max_examples=20, deadline=None)
@given(turns=turning_points)
def test_an_elastic_contact_keeps_its_energy(exponent, smoothing, turns):
    soil = soil_of(exponent, plasticity_ratio=1e-9, surface_energy=0.0)
    work, uncertainty = work_done(law_of(soil, smoothing), [*turns, 0.0])
    # The memory of 1e-9 lets k2 differ from k1, and the line end, by that share.
    assert abs(work) <= uncertainty + 1e-6 * MOST * stiffness_of(soil) * MOST**exponent


@every_exponent
def test_a_reload_is_never_above_virgin_loading(exponent):
    """f_hys <= f0 + k1 d^n: the outer minimum of the printed law, also in one large step."""
    for soil in corner_soils(exponent):
        turn = minimum_of(soil)[1]
        for low in (0.001, 0.1, 0.5, 0.9):
            turns = jnp.asarray([MOST, low * turn, 1.2 * MOST])
            for points in (3, POINTS):
                overlaps = overlap_path(turns, points)
                virgin = stiffness_of(soil) * np.asarray(overlaps) ** exponent
                excess = np.asarray(drive(law_of(soil), overlaps)) - virgin
                assert excess.max() <= 1e-12 * virgin.max()


# ------------------------------------------------------------------ limits and precision


@every_exponent
def test_narrow_roundings_recover_the_sharp_law(exponent):
    """The mean deviation from the sharp law shrinks with the width, and vanishes with it.

    The mean, because the sharp law jumps (d_min at the cap for n = 1.5), so that next to a
    jump any width deviates.  It shrinks in proportion to the width near a jump, as its
    square at a fillet; a factor of 5 is left for how few points lie in a narrow one.
    """
    soils = corner_soils(exponent)
    paths = jnp.stack([sampled_cycle(soil) for soil in soils])
    sharp = np.asarray(all_rows(stacked(soils), Smoothing.sharp(), paths)[0])

    def deviation(share):
        smoothing = jax.tree.map(lambda width: share * width, Smoothing())
        rows = np.asarray(all_rows(stacked(soils), smoothing, paths)[0])
        return np.abs(rows - sharp).mean(axis=(0, 1))[[0, 2, 4, 6]] / largest

    largest = np.abs(sharp).max(axis=(0, 1))[[0, 2, 4, 6]]
    assert (deviation(1.0) > 1e-5).all()  # else nothing was rounded on this path
    assert (deviation(0.01) < 0.05 * deviation(1.0)).all()
    assert not np.any(deviation(0.0))


@every_exponent
def test_without_plasticity_and_adhesion_the_law_is_hertz_or_linear(exponent):
    soil = soil_of(exponent, plasticity_ratio=1e-12, surface_energy=0.0)
    overlaps = overlap_path(jnp.asarray([MOST, 0.2 * MOST, 0.8 * MOST, 0.0]), 50)
    expected = stiffness_of(soil) * np.asarray(overlaps).clip(0) ** exponent
    # The plastic overlap that is left has the n-th power 1e-12 of the largest.
    error = np.abs(drive(law_of(soil, Smoothing.sharp()), overlaps) - expected)
    assert error.max() <= 1e-11 * expected.max()


@every_exponent
@every_smoothing
def test_float32_agrees_with_float64(exponent, smoothing):
    """Some tens of roundings per step and none amplified but in the difference d^n - dp^n,
    k2/k1 <= 3.4 times: 100 eps of the largest force; friction is a difference once more."""
    soils = stacked(corner_soils(exponent))
    paths = jnp.stack([sampled_cycle(soil) for soil in corner_soils(exponent)])
    wide = np.asarray(all_rows(soils, smoothing, paths)[0])
    inputs = cast((soils, smoothing, paths), jnp.float32)
    narrow = np.asarray(all_rows(*inputs)[0])
    largest = np.abs(wide).max(axis=(0, 1))
    assert narrow.dtype == np.float32
    used = largest > 0
    error = np.abs(narrow - wide).max(axis=(0, 1))[used] / largest[used]
    assert (error < 300 * np.finfo(np.float32).eps).all(), error


# ------------------------------------------------------------------ memory and adhesion


def largest_overlap_remembered(soil, smoothing, turns):
    return last_row(soil, smoothing, turns)[1]


@every_exponent
@every_smoothing
def test_adhesive_reload_lowers_the_memory_for_good(exponent, smoothing):
    soil = soil_of(exponent)
    turn = minimum_of(soil)[1]
    before = largest_overlap_remembered(soil, smoothing, [MOST, 0.5 * turn])
    after = largest_overlap_remembered(soil, smoothing, [MOST, 0.5 * turn, 0.9 * turn])
    later = largest_overlap_remembered(soil, smoothing, [MOST, 0.5 * turn, 0.9 * turn, 0.6 * turn])
    assert before == pytest.approx(MOST, rel=1e-12)
    assert after == pytest.approx(reloaded_memory(soil, 0.5 * turn), rel=1e-6)
    assert later == after


def reloaded_memory(soil, low):
    """d_max that belongs to dp^n = l^n + (f_min/k2) (l/d_min)^x."""
    n, k2 = soil.slope_exponent, stiffness_of(soil) / (1 - soil.plasticity_ratio)
    strength, turn = minimum_of(soil)
    raised = low**n + strength / k2 * (low / turn) ** soil.tensile_exponent
    return float((raised / soil.plasticity_ratio) ** (1 / n))


@every_exponent
@every_smoothing
def test_reload_on_the_unloading_line_keeps_the_memory(exponent, smoothing):
    soil = soil_of(exponent)
    turn = minimum_of(soil)[1]
    kept = largest_overlap_remembered(soil, smoothing, [MOST, 1.05 * turn, 0.9 * MOST])
    assert kept == pytest.approx(MOST, rel=1e-12)


@every_exponent
def test_separation_clears_the_memory(exponent):
    soil, virgin = soil_of(exponent), [0.0, 0.5 * MOST]
    again = largest_overlap_remembered(soil, Smoothing(), [MOST, -1e-9, *virgin])
    assert again == largest_overlap_remembered(soil, Smoothing(), virgin)


def lowest_force(soil, smoothing):
    """Largest tension (N) on a path that turns nowhere but stops at d_min exactly."""
    overlaps = overlap_path(jnp.asarray([MOST, minimum_of(soil)[1], 0.0]), POINTS)
    return -float(jnp.min(drive(law_of(soil, smoothing), overlaps)))


def test_adhesion_is_capped_at_half_the_plastic_force():
    soil = soil_of(1.0, surface_energy=1e4)
    cap = minimum_of(soil)[0]
    assert cap == pytest.approx(stiffness_of(soil) * 0.358 / 0.642 * MOST / 2)
    assert lowest_force(soil, Smoothing.sharp()) == pytest.approx(cap, rel=1e-9)
    assert lowest_force(soil, Smoothing()) <= cap


@every_exponent
def test_below_the_cap_the_largest_tension_is_as_printed(exponent):
    soil = soil_of(exponent, surface_energy=4.0)
    assert lowest_force(soil, Smoothing.sharp()) == pytest.approx(minimum_of(soil)[0], rel=1e-9)
