"""What every contact law owes: the contract of `jdem.laws.base`, over soils and roundings.

Soils are the corners of a Plackett-Burman design of the seven calibrated factors, one with
tensile exponent 5, and two with the large surface energies that coarse spheres carry, at
which the adhesion's cap acts.  A path of overlaps visits every kink of EEPA.  Laws are pure
functions of arrays, so all soils of one slope exponent run in one compiled program.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jdem.contact import ContactHistory, NormalForce
from jdem.experiments.pair import SpherePair, drive_overlap, overlap_path
from jdem.laws.coulomb import CoulombSpring
from jdem.laws.rolling import ConstantTorque
from jdem.quantity import cast
from jdem.smooth import Smoothing
from jdem.soil import SoilParameters, particle_law
from jdem.vector import Vector

RADIUS = 2.5e-3
PAIR = SpherePair(RADIUS)
MOST = 3e-5  # m; largest overlap of a path
SLIP, APPROACH, TIME_STEP, FRICTION = 2e-3, 1e-3, 1e-5, 0.5

RANGES = {
    "restitution": (0.3, 0.7),
    "static_friction": (0.2, 1.0),
    "rolling_friction": (0.1, 0.6),
    "surface_energy": (4.0, 20.0),
    "plasticity_ratio": (0.2, 0.7),
    "tensile_exponent": (0.5, 3.0),
    "tangential_multiplier": (0.3, 1.0),
}
SCALED_ENERGIES = (400.0, 1500.0)  # J/m2; near the cap, and far above it
EXPONENTS = [1.0, 1.5]
SMOOTHINGS = {"sharp": Smoothing.sharp(), "default": Smoothing()}

every_exponent = pytest.mark.parametrize("exponent", EXPONENTS)
every_smoothing = pytest.mark.parametrize("smoothing", SMOOTHINGS.values(), ids=SMOOTHINGS.keys())


# ------------------------------------------------------------------ soils and paths


def plackett_burman_signs():
    """Eight runs of seven two-level factors: a generating row, its shifts, all low."""
    generator = np.array([1, 1, 1, 0, 1, 0, 0])
    return np.array([*(np.roll(generator, k) for k in range(7)), np.zeros(7, int)])


PAPER_OPTIMUM = {"plasticity_ratio": 0.358, "rolling_friction": 0.5, "shear_modulus": 12e6}


def soil_of(exponent, **values):
    """The paper's optimum; the reference diameter is the spheres' own (energy not scaled)."""
    given = {**PAPER_OPTIMUM, **values}
    return SoilParameters(**given, reference_diameter=2 * RADIUS, slope_exponent=exponent)


def corner_soils(exponent):
    corners = [
        soil_of(exponent, **{k: RANGES[k][s] for k, s in zip(RANGES, signs, strict=True)})
        for signs in plackett_burman_signs()
    ]
    steep = soil_of(exponent, tensile_exponent=5.0)
    coarse = [soil_of(exponent, surface_energy=energy) for energy in SCALED_ENERGIES]
    return [*corners, steep, *coarse]


def stacked(soils):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *soils)


def law_of(soil, smoothing=SMOOTHINGS["default"]):
    return particle_law(soil, 2 * RADIUS, smoothing)


def contact_at(overlap, slip=SLIP, friction=FRICTION):
    contact = PAIR.contact(overlap, APPROACH * jnp.ones_like(overlap), TIME_STEP)
    slip = Vector(0.0 * overlap, slip + 0.0 * overlap, 0.0 * overlap)
    changed = (slip, friction + 0.0 * overlap)
    return cast(eqx.tree_at(lambda c: (c.slip, c.friction), contact, changed), overlap.dtype)


def row_of(force):
    """Everything a law returns for one contact, as one row."""
    normal, traction = force.normal, force.traction()
    parts = [normal.hysteretic, normal.viscous, normal.frictional_load]
    return jnp.stack([*parts, traction.x, traction.y, traction.z, force.rolling_limit])


def rows_along(soil, smoothing, overlaps):
    """Rows of force parts, and of memory, along a path of overlaps with steady slip."""
    law = law_of(soil, smoothing)

    def advance(history, overlap):
        force, history = law.force(contact_at(overlap, friction=soil.static_friction), history)
        memory = jnp.stack([history.max_overlap, history.low_overlap, history.stretch.y])
        return history, (row_of(force), memory)

    return jax.lax.scan(advance, ContactHistory.zeros((), overlaps.dtype), overlaps)[1]


def minimum_of(soil):
    """f_min (N) and d_min (m) after loading to MOST, from the law as it is printed."""
    n, k1 = soil.slope_exponent, stiffness_of(soil)
    plastic, k2 = plastic_overlap_of(soil), k1 / (1 - soil.plasticity_ratio)
    lens = np.sqrt(RADIUS * plastic - plastic**2 / 4)
    free, cap = 1.5 * np.pi * soil.surface_energy * lens, k2 * plastic**n / 2
    if free > cap:
        return float(cap), float(plastic / 2)
    return float(free), float((plastic**n - free / k2) ** (1 / n))


def stiffness_of(soil):
    modulus = soil.shear_modulus / (1 - soil.poisson_ratio)  # E* of equal bodies
    linear = 2 * modulus * RADIUS / 2
    return float(linear if soil.slope_exponent == 1.0 else 4 / 3 * modulus * np.sqrt(RADIUS / 2))


def plastic_overlap_of(soil):
    """d_p (m) after loading to MOST."""
    return float(soil.plasticity_ratio) ** (1 / soil.slope_exponent) * MOST


def path_through_every_kink(soil):
    """Zero, virgin loading, both unloading branches, d_min itself, adhesive reload, separation."""
    plastic, turn = plastic_overlap_of(soil), minimum_of(soil)[1]
    loading = [-1e-6, 0.0, 1e-16, 1e-9, 0.5 * MOST, MOST]
    unloading = [plastic, 1.01 * turn, turn, 0.99 * turn, 0.5 * turn]
    reloading = [0.5 * turn, 0.51 * turn, 0.53 * turn, turn, 0.4 * turn, 0.7 * turn]
    ending = [1.2 * MOST, plastic, 0.3 * turn, 1e-9, 1e-16, 0.0, 0.0, -1e-6, 0.2 * MOST]
    return jnp.asarray([*loading, *unloading, *reloading, *ending])


def kink_paths(exponent):
    return jnp.stack([path_through_every_kink(soil) for soil in corner_soils(exponent)])


@eqx.filter_jit
def all_rows(soils, smoothing, overlaps):
    return jax.vmap(rows_along, (0, None, 0))(soils, smoothing, overlaps)


@eqx.filter_jit
def all_jacobians(soils, smoothing, overlaps):
    """Of every row along the path: by the soil's numbers, and by every overlap before."""

    def one(soil, overlap):
        return jax.jacfwd(lambda s, d: rows_along(s, smoothing, d)[0], (0, 1))(soil, overlap)

    return jax.vmap(one)(soils, overlaps)


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


@every_exponent
@every_smoothing
def test_values_and_gradients_are_finite_through_every_kink(exponent, smoothing):
    soils, paths = stacked(corner_soils(exponent)), kink_paths(exponent)
    by_soil, by_overlap = all_jacobians(soils, smoothing, paths)
    forces, memory = all_rows(soils, smoothing, paths)
    for leaf in jax.tree.leaves((forces, memory, by_soil, by_overlap)):
        assert np.isfinite(leaf).all()
    assert np.any(by_soil.plasticity_ratio)  # the path does feel its parameters


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
    def rows(factor):
        moved = [
            eqx.tree_at(lambda s: getattr(s, name), s, getattr(s, name) * factor) for s in soils
        ]
        return np.asarray(all_rows(stacked(moved), smoothing, paths)[0])

    value = np.asarray([getattr(soil, name) for soil in soils])[:, None, None]
    near, wide = (rows(1 + h) - rows(1 - h) for h in (step, 2 * step))
    return (8 * near - wide) / (12 * step * value)


# ------------------------------------------------------------------ energy

POINTS = 400
drive = eqx.filter_jit(lambda law, overlaps: drive_overlap(law, PAIR, overlaps))
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


def sampled_cycle(soil):
    turn = minimum_of(soil)[1]
    return overlap_path(jnp.asarray([MOST, 0.4 * turn, 0.9 * MOST, -0.01 * MOST]), POINTS)


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


def last_row(soil, smoothing, turns):
    """Force parts and d_max at the end of a path, which first loads in as many legs as make
    all paths alike (one compiled program)."""
    turns = [*np.linspace(0, turns[0], 6 - len(turns))[1:-1], *turns]
    overlaps = overlap_path(jnp.asarray(turns), 200)[None]
    forces, memory = all_rows(stacked([soil]), smoothing, overlaps)
    return np.asarray(forces)[0, -1], float(memory[0, -1, 0])


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


# ------------------------------------------------------------------ friction and rolling


@every_exponent
@every_smoothing
def test_friction_feels_adhesion_at_zero_total_force(exponent, smoothing):
    """At d = dp the hysteretic force is zero and the load is f_min (dp/d_min)^x."""
    soil = soil_of(exponent)
    plastic = plastic_overlap_of(soil)
    rows = last_row(soil, smoothing, [MOST, plastic])[0]
    strength, turn = minimum_of(soil)
    expected = strength * (plastic / turn) ** float(soil.tensile_exponent)
    scale = stiffness_of(soil) * MOST**exponent
    assert abs(rows[0]) < 1e-12 * scale
    # The default cap rounds f_min by a quarter of its width at most, here not at all.
    assert rows[2] == pytest.approx(expected, rel=1e-9)


def test_friction_load_is_zero_on_the_adhesive_branch():
    soil = soil_of(1.0)
    turn = minimum_of(soil)[1]
    rows = last_row(soil, Smoothing.sharp(), [MOST, 0.5 * turn])[0]
    assert rows[0] < 0
    assert rows[2] == 0.0


LOAD, STIFFNESS = 2.0, 1e4
pull = eqx.filter_jit(
    lambda spring, contact, history: spring.force(
        contact,
        NormalForce(jnp.asarray(LOAD), jnp.asarray(0.0), jnp.asarray(LOAD)),
        STIFFNESS,
        history,
    )
)


def spring_cycle(smoothing, stretches, restitution=1.0):
    """Traction (N) for a path of stretches (m) imposed along y under a constant load."""
    law, history, forces = (
        CoulombSpring(restitution, smoothing),
        ContactHistory.zeros((), float),
        [],
    )
    for change in np.diff([0.0, *stretches]):
        contact = contact_at(jnp.asarray(1e-6), slip=change / TIME_STEP)
        spring, dashpot, history = pull(law, contact, history)
        forces.append(float(spring.y + dashpot.y))
    return np.array(forces)


def dissipated(stretches, forces):
    """Work done on the spring over the path (J), by the trapezoidal rule."""
    force, place = np.array([0.0, *forces]), np.array([0.0, *stretches])
    return -np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(place))


LIMIT = FRICTION * LOAD
SLIPS_AT = LIMIT / STIFFNESS  # m; stretch at which a sharp spring begins to slip


@every_smoothing
@pytest.mark.parametrize(("amplitude", "slips"), [(0.9, False), (3.0, True)])
def test_a_cycle_of_tangential_stretch_costs_energy_only_if_it_slips(smoothing, amplitude, slips):
    path = amplitude * SLIPS_AT * np.sin(np.linspace(0, 2 * np.pi, 81)[1:])
    forces = spring_cycle(smoothing, path)
    work = dissipated(path, forces)
    if not slips:
        # The rule's error cancels, because force depends on the stretch alone.
        assert abs(work) < 1e-12 * LIMIT * SLIPS_AT
    else:
        assert work > LIMIT * SLIPS_AT
    assert np.abs(forces).max() <= LIMIT * (1 + 1e-12)


@every_smoothing
@pytest.mark.parametrize("restitution", [0.1, 0.5, 1.0])
def test_sliding_friction_is_the_limit_and_opposes_the_slip(smoothing, restitution):
    forces = spring_cycle(smoothing, np.linspace(0, 4 * SLIPS_AT, 21)[1:], restitution)
    assert forces[-1] == pytest.approx(-LIMIT, rel=1e-12)


@every_smoothing
@pytest.mark.parametrize("stretch", [-1.5, -0.5, 0.0, 0.7, 4.0])
@pytest.mark.parametrize("speed", [-1.0, -1e-3, 1e-4, 10.0])
def test_spring_and_dashpot_together_stay_within_the_limit(smoothing, stretch, speed):
    """At any stretch and slip speed (m/s); a dashpot of its own would exceed it many times."""
    history = ContactHistory(
        jnp.asarray(0.0), jnp.asarray(0.0), Vector(0.0, stretch * SLIPS_AT, 0.0)
    )
    contact = contact_at(jnp.asarray(1e-6), slip=speed)
    spring, dashpot, _ = pull(CoulombSpring(0.1, smoothing), contact, history)
    assert abs(float(spring.y + dashpot.y)) <= LIMIT * (1 + 1e-12)


@every_smoothing
def test_no_load_means_no_friction(smoothing):
    history = ContactHistory(jnp.asarray(0.0), jnp.asarray(0.0), Vector(0.0, 4 * SLIPS_AT, 0.0))
    free = contact_at(jnp.asarray(1e-6), friction=0.0)
    spring, dashpot, kept = pull(CoulombSpring(0.5, smoothing), free, history)
    assert spring.y == dashpot.y == kept.stretch.y == 0.0


force_of = eqx.filter_jit(lambda law, contact, history: law.force(contact, history))


def rotation(seed):
    """A random rotation matrix."""
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix))


@pytest.mark.parametrize("seed", range(3))
@every_smoothing
def test_the_law_turns_with_its_contact(smoothing, seed):
    turn = rotation(seed)
    law = law_of(soil_of(1.5), smoothing)
    stretch = Vector(jnp.asarray(0.0), jnp.asarray(3e-6), jnp.asarray(-1e-6))
    history = ContactHistory(jnp.asarray(MOST), jnp.asarray(0.8 * MOST), stretch)
    contact = contact_at(jnp.asarray(0.9 * MOST))
    turned = eqx.tree_at(
        lambda c: (c.normal, c.slip),
        contact,
        (turned_by(turn, contact.normal), turned_by(turn, contact.slip)),
    )
    turned_history = eqx.tree_at(lambda h: h.stretch, history, turned_by(turn, stretch))
    force = force_of(law, contact, history)[0]
    rotated = force_of(law, turned, turned_history)[0]
    expected = turned_by(turn, force.traction()).stack()
    assert np.abs(rotated.traction().stack() - expected).max() < 1e-13 * np.abs(expected).max()
    assert rotated.normal.total() == force.normal.total()


def turned_by(matrix, vector):
    return Vector.from_rows(jnp.asarray(matrix) @ vector.stack())


def test_a_stretch_along_the_normal_is_forgotten():
    """The contact plane turns with the bodies; what is left along the normal is no stretch."""
    stretch = Vector(jnp.asarray(1e-6), jnp.asarray(0.0), jnp.asarray(0.0))
    history = ContactHistory(jnp.asarray(0.0), jnp.asarray(0.0), stretch)
    _, _, kept = pull(CoulombSpring(0.5), contact_at(jnp.asarray(1e-6), slip=0.0), history)
    assert not np.any(kept.stretch.stack())


@pytest.mark.parametrize("hysteretic", [3.0, -0.5])
@every_smoothing
def test_the_rolling_limit_is_friction_times_the_hysteretic_force(hysteretic, smoothing):
    normal = NormalForce(jnp.asarray(hysteretic), jnp.asarray(7.0), jnp.asarray(4.0))
    limit = ConstantTorque(0.4, smoothing).limit(normal)
    assert limit == pytest.approx(0.4 * abs(hysteretic), rel=1e-12)
