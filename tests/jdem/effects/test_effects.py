"""Effects on one small bed: off bit for bit at strength 0, and the curve moves where they say.

One program with all effects serves every strength, which `assert_max_traces` checks while the
tests use it; a second one is the base model.  Tests that run them are slow; the numbers that each
effect gives are in `test_physics`, its own formulas in `test_effects_library`.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.bodies.spheres import Spheres
from jdem.core.quantity import Real, as_quantity, quantity
from jdem.core.vector import Vector
from jdem.effects.base import FADING_STRAIN, About, AbstractEffect, with_contacts_scaled
from jdem.effects.cementation import STRAIN
from jdem.effects.composite import EFFECTS, Altered, with_strengths
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.observables import Curve, displacement_at
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing
from tests.support.effect_lab import (
    HOLD,
    NUMERICS,
    SMALL,
    SOIL,
    arrays,
    assert_same,
    both_tests,
    depth_of,
    force_of,
    lab_with,
)

pytestmark = pytest.mark.thorough

NAMES = list(EFFECTS)
TYPICAL = {name: effect.about.typical[-1] for name, effect in EFFECTS.items()}


def strengths(**values):
    return [jnp.asarray(values.get(name, 0.0), float) for name in NAMES]


BASE, ALL = lab_with(), lab_with(*[effect(0.0) for effect in EFFECTS.values()])
HEIGHT = 0.06  # m, of a bed
STEP = 0.4  # of the stable time step, the same for all strengths


@pytest.fixture(scope="session")
def packing():
    return prepare(SMALL, 0)


@pytest.fixture(scope="session")
def heap():
    """The small bed's spheres, none in its place: enough to trace a run or for a time step."""
    radius = SMALL.mean_radius() * np.linspace(1 - SMALL.spread, 1 + SMALL.spread, SMALL.count)
    spheres = Spheres(jnp.asarray(radius), jnp.asarray(2650 * 4 / 3 * np.pi * radius**3))
    place = jnp.zeros(SMALL.count)
    return Packing(Vector(place, place, place), spheres, SMALL.height, SMALL.diameter / 2)


@pytest.fixture(scope="session")
def time_step(packing):
    return STEP * BASE.time_step(packing, SOIL)


@pytest.fixture(scope="session")
def base(packing, time_step):
    return eqx.filter_jit(VirtualLab.run)(BASE, packing, SOIL, time_step)


altered = eqx.filter_jit(eqx.debug.assert_max_traces(VirtualLab.run, max_traces=1))


@pytest.fixture(scope="session")
def outcome(packing, time_step):
    """Both tests at given strengths; every set of strengths is run once."""
    known = {}

    def run(hold=0.0, /, **values):
        key = (hold, *sorted(values.items()))
        if key not in known:
            lab = eqx.tree_at(lambda lab: lab.tests["confined"].hold, ALL, jnp.asarray(hold, float))
            effects = with_strengths(ALL.effects, strengths(**values))
            lab = eqx.tree_at(lambda lab: lab.effects, lab, effects)
            known[key] = altered(lab, packing, SOIL, time_step)
        return known[key]

    return run


def are_same(ours, theirs):
    pairs = zip(arrays(ours), arrays(theirs), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def rows(curve):
    """Displacement (m) and force (N) of the valid rows."""
    valid = np.asarray(curve.valid) > 0
    return np.asarray(curve.displacement)[valid], np.asarray(curve.force)[valid]


def segment(outcome, name):
    """Samples of one segment."""
    chosen = np.asarray(outcome.record.samples.segment) == ALL.tests.names.index(name)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[chosen], outcome.record.samples)


# ------------------------------------------------------------------ strength 0


@pytest.mark.slow
def test_strength_zero_is_the_base_model_bit_for_bit(base, outcome):
    """All effects at once, in one program that is not the base model's."""
    nothing = outcome()
    assert not base.failed
    assert len(rows(base.curves["unconfined"])[0]) > 20 and force_of(base) > 5.0
    for field in ("observables", "curves", "nominal_time"):
        assert_same(getattr(nothing, field), getattr(base, field))
    assert_same(nothing.record.samples, base.record.samples)
    assert_same(nothing.record.state.motion, base.record.state.motion)


def test_effects_keep_single_precision(heap):
    """Traced only: a loop whose numbers changed their precision could not be traced."""
    numerics = replace(NUMERICS, dtype="float32")
    lab = VirtualLab.of(SMALL, both_tests(), numerics, ALL.effects)
    outcome = eqx.filter_eval_shape(VirtualLab.run, lab, heap, SOIL)
    shown = (
        depth_of(outcome),
        outcome.curves["confined"],
        outcome.curves["unconfined"],
        outcome.nominal_time,
    )
    assert {leaf.dtype for leaf in jax.tree.leaves(shown)} == {jnp.dtype("float32")}


class Lightness(AbstractEffect):
    """An effect of a user's own, in one class."""

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About("share", "1", (0.0, 1.0), True, "", "", (), "", "soil")

    def soil(self, soil, stage):
        softer = soil.shear_modulus * (1 - 0.5 * self.strength * (1 - stage.free))
        return eqx.tree_at(lambda s: s.shear_modulus, soil, softer)


@pytest.mark.slow
def test_an_effect_of_a_users_own(base, packing, time_step):
    run = eqx.filter_jit(eqx.debug.assert_max_traces(VirtualLab.run, max_traces=1))
    outcomes = [run(lab_with(Lightness(s)), packing, SOIL, time_step) for s in (0.0, 1.0)]
    assert_same(outcomes[0].curves["confined"], base.curves["confined"])
    assert_same(outcomes[0].curves["unconfined"], base.curves["unconfined"])
    assert outcomes[1].observables["confined"]["depression_depth"] > 1.5 * depth_of(base)


# ------------------------------------------------------------------ instruments


@pytest.mark.slow
def test_compliance_flattens_slopes_by_the_closed_form(outcome):
    """1/S' = 1/S + 1/K on every chord of both curves; forces stay."""
    compliance = 3e-7
    true, shown = outcome(), outcome(load_frame_compliance=compliance)
    for name in ("confined", "unconfined"):
        (d, force), (shifted, same) = rows(true.curves[name]), rows(shown.curves[name])
        np.testing.assert_array_equal(same, force)
        expected = d - d[0] + compliance * (force - force[0])
        assert np.abs(shifted - shifted[0] - expected).max() < 1e-12
    unloading = segment(true, "unloading")
    steep = -np.diff(unloading.platen_force[:5]).sum() / np.diff(unloading.platen_height[:5]).sum()
    count = len(segment(true, "loading").time) + len(segment(true, "holding").time)
    d, force = (row[count : count + 5] for row in rows(shown.curves["confined"]))
    slope = (force[-1] - force[0]) / (d[-1] - d[0])
    assert slope == pytest.approx(steep / (1 + compliance * steep), rel=1e-9)
    assert slope < 0.97 * steep
    deeper = depth_of(shown) - depth_of(true)
    assert deeper == pytest.approx(100.0 * compliance, rel=1e-9)
    assert force_of(shown) == force_of(true)


@pytest.mark.slow
def test_a_seating_gap_is_a_toe(outcome):
    gap = 5e-4
    true, shown = outcome(), outcome(seating_gap=gap)
    (d, force), (shifted, same) = rows(true.curves["unconfined"]), rows(shown.curves["unconfined"])
    np.testing.assert_array_equal(same, force)
    closed = gap * (1 - np.exp(-np.maximum(force, 0) / 15.0))
    assert np.abs(shifted - shifted[0] - (d - d[0]) - (closed - closed[0])).max() < 1e-12
    # Between 100 and 200 N exp(-100/15) of the gap is left to close.
    change = depth_of(shown) - depth_of(true)
    assert abs(change) < 1.01 * gap * math.exp(-100 / 15)
    assert force_of(shown) == force_of(true)


@pytest.mark.slow
def test_a_false_record_scales_and_shifts_forces_exactly(packing, outcome):
    """in_servo = 0: the specimen's history is the base model's."""
    values = {"load_cell_gain": 0.01, "load_cell_offset": 2.0, "load_cell_drift": 0.01}
    effects = with_strengths(ALL.effects, strengths(**values))
    deaf = tuple(
        eqx.tree_at(lambda e: e.in_servo, effect, as_quantity(0.0)) if name in values else effect
        for name, effect in zip(NAMES, effects, strict=True)
    )
    true = outcome()
    shown = altered(
        eqx.tree_at(lambda lab: lab.effects, ALL, deaf),
        packing,
        SOIL,
        STEP * BASE.time_step(packing, SOIL),
    )
    assert_same(shown.record.samples, true.record.samples)
    for name in ("confined", "unconfined"):
        valid = np.asarray(true.curves[name].valid) > 0
        force, time = rows(true.curves[name])[1], np.asarray(true.nominal_time)[valid]
        expected = 1.01 * force + 2.0 + 0.01 * time
        assert np.abs(rows(shown.curves[name])[1] - expected).max() < 1e-9
    assert np.asarray(true.nominal_time)[valid][-1] == pytest.approx(1e-3 / 1e-5, rel=0.02)


@pytest.mark.slow
def test_the_machine_turns_at_what_its_load_cell_shows(outcome):
    """The record tops out where the base model's does; the true force is 3 % lower."""
    gain = 0.03
    true, shown = outcome(), outcome(load_cell_gain=gain)
    tops = [float(o.curves["confined"].force.max()) for o in (true, shown)]
    assert tops[1] == pytest.approx(tops[0], abs=1.0)  # within the servo's tolerance
    pressed = [segment(o, "loading").platen_force.max() for o in (true, shown)]
    assert pressed[1] == pytest.approx(pressed[0] / (1 + gain), abs=1.0)
    loading = Curve(*(np.asarray(x) for x in jax.tree.leaves(true.curves["confined"])))
    reached = [displacement_at(loading, force / (1 + gain)) for force in (100.0, 200.0)]
    assert depth_of(shown) == pytest.approx(float(reached[1] - reached[0]), rel=2e-3)


@pytest.mark.slow
def test_a_late_reading_shifts_loading_and_overshoots(outcome):
    """Loading lies v tau further; the true force exceeds the reading by v tau S at reversal."""
    lag, speed = 0.05, 8e-3
    true, shown = outcome(), outcome(acquisition_lag=lag)
    loading = segment(shown, "loading")
    travel = loading.platen_height[0] - loading.platen_height
    valid = np.ones_like(travel)
    curves = [Curve(travel, force, valid) for force in (loading.platen_force, loading.reading)]
    for force in (100.0, 150.0):
        shift = float(displacement_at(curves[1], force) - displacement_at(curves[0], force))
        assert shift == pytest.approx(speed * lag, rel=0.05)
    top = loading.platen_force.max()
    before = float(displacement_at(curves[0], top - 10.0))
    slope = 10.0 / (float(displacement_at(curves[0], top)) - before)
    over = top - segment(true, "loading").platen_force.max()
    print(f"overshoot {over:.1f} N, v tau S {speed * lag * slope:.1f} N")
    assert over == pytest.approx(speed * lag * slope, rel=0.25)
    # The reading is still below the force as the platen turns, and rises for a while.
    assert shown.curves["confined"].force.max() > true.curves["confined"].force.max() + 2.0


@pytest.mark.slow
def test_drift_shows_only_in_the_slow_test(outcome):
    drift = 0.014
    true, shown = outcome(), outcome(load_cell_drift=drift)
    seconds = 5e-3 / 8e-3  # a few millimetres at the nominal rate
    change = np.abs(
        rows(shown.curves["confined"])[1][:50] - rows(true.curves["confined"])[1][:50]
    ).max()
    assert 0 < change < drift * seconds
    minutes = np.asarray(true.nominal_time)[np.asarray(true.curves["unconfined"].valid) > 0][-1]
    grown = float(force_of(shown) - force_of(true))
    assert grown == pytest.approx(drift * minutes, rel=0.1)


# ------------------------------------------------------------------ soil and mould


@pytest.mark.slow
def test_wall_friction_keeps_force_from_the_base_and_falls_fast_after_reversal(outcome):
    low, high = outcome(), outcome(wall_friction=0.3)
    shares, drops = [], []
    for o in (low, high):
        loading, unloading = segment(o, "loading"), segment(o, "unloading")
        shares.append(loading.base_force[-1] / loading.platen_force[-1])
        travel = unloading.platen_height - unloading.platen_height[0]
        drops.append(np.interp(5e-4, travel, unloading.platen_force) / loading.platen_force[-1])
        late = travel > 5e-4
        assert np.mean(unloading.base_force[late]) > np.mean(unloading.platen_force[late])
    assert shares[1] < 0.9 * shares[0]
    assert depth_of(high) < depth_of(low)
    print(f"base/platen {shares}, force left after 0.5 mm of unloading {drops}")
    assert drops[1] < 0.95 * drops[0]


def secant(outcome, travel=5e-4):
    """Mean force (N) of the unconfined curve up to a displacement (m)."""
    d, force = rows(outcome.curves["unconfined"])
    return force[d < travel].mean()


@pytest.mark.slow
def test_platen_friction_acts_without_the_mould(outcome):
    """So few spheres are stronger or weaker by chance: asked is where it acts, not which way."""
    low, high = outcome(), outcome(platen_friction=1.0)
    depth = depth_of(high) / depth_of(low) - 1
    force = force_of(high) / force_of(low) - 1
    print(f"platen friction: depth {float(depth):+.3f}, crushing force {float(force):+.3f}")
    assert abs(depth) < 0.03 < abs(force)


@pytest.mark.slow
def test_the_second_test_alone_is_multiplied(outcome):
    low, high = outcome(), outcome(second_test_factor=0.3)
    assert_same(high.curves["confined"], low.curves["confined"])
    assert secant(high) / secant(low) == pytest.approx(1.3, rel=0.1)
    assert force_of(high) / low.observables["unconfined"]["crushing_force"] == pytest.approx(
        1.3, rel=0.1
    )


@pytest.mark.slow
def test_rate_dependence_lowers_the_slow_test_and_relaxes_in_a_hold(outcome):
    rho = 0.1
    low, high = outcome(), outcome(rate_dependence=rho)
    decades = math.log10(1e-5 / 8e-3)
    change = float(depth_of(high) / depth_of(low) - 1)
    assert abs(change) < 0.02
    ratio = secant(high) / secant(low)
    slowest = math.exp(rho * decades)
    print(f"depth {change:+.4f}, unconfined x {ratio:.3f}, at the slow rate {slowest:.3f}")
    assert slowest * 0.95 < ratio < 1.0
    rho = 0.5
    tests = [outcome(HOLD, **v) for v in ({}, {"rate_dependence": rho})]
    falls = [
        float(h.platen_force[-1] / h.platen_force[0])
        for h in (segment(test, "holding") for test in tests)
    ]
    slow = np.log10(slowness(tests[1]))[-len(segment(tests[1], "holding").time) :]
    expected = math.exp(-rho * (slow[-1] - slow[0]))
    print(f"force left after the hold {falls}, expected {expected:.4f}")
    assert expected < 0.97
    assert falls[1] / falls[0] == pytest.approx(expected, abs=0.003)


def slowness(outcome):
    """v_c/v at each sample of loading and holding: 1 while the machine loads, then fading."""
    loading, holding = (segment(outcome, name) for name in ("loading", "holding"))
    nominal = np.diff(holding.time, prepend=loading.time[-1:]) * (8e-3 / 0.06) * (0.05 / 8e-3)
    return np.concatenate([np.ones(len(loading.time)), 1 + np.cumsum(nominal) / FADING_STRAIN])


def test_a_servo_that_slows_down_before_its_target_does_not_soften_the_soil():
    """It would never arrive: forces fall as it slows; one bed in seven of the bank crept so."""
    timetable = ALL.tests.timetable()
    reference = 8e-3 / HEIGHT
    around = Altered(ALL.effects, SOIL, NUMERICS.smoothing, timetable, 8e-3, reference)
    clock = around.begin(jnp.zeros(()).dtype)
    before, after = (standing_at(HEIGHT, time) for time in (0.0, 1e-3))
    for name in ("loading", "holding"):
        number = ALL.tests.names.index(name)
        later = around.later(clock, number, before, after)
        seconds = 1e-3 * float(timetable.time_scale[number])
        expected = 1.0 if name == "loading" else 1 + reference * seconds / FADING_STRAIN
        assert float(later.slowness) == pytest.approx(expected, rel=1e-6)


def standing_at(height, time):
    """A state of the machine, as far as the clock of effects reads it."""
    return SimpleNamespace(time=jnp.asarray(time), platen_height=jnp.asarray(height))


@pytest.mark.slow
def test_capillary_tension_strengthens_without_the_mould(outcome):
    low, high = outcome(), outcome(capillary_tension=1e4)
    depth = float(depth_of(high) / depth_of(low) - 1)
    force = float(force_of(high) / force_of(low) - 1)
    print(f"capillary tension: depth {depth:+.3f}, crushing force {force:+.3f}")
    assert force > 0.1
    assert abs(depth) < 0.3 * force


@pytest.mark.slow
def test_cementation_acts_after_the_confined_test(outcome):
    low, high = outcome(), outcome(cementation=5e4)
    assert_same(high.curves["confined"], low.curves["confined"])
    assert force_of(high) > 1.1 * force_of(low)
    assert secant(high) > secant(low)


@pytest.mark.slow
def test_a_denser_specimen_is_stiffer(outcome):
    loose, usual, dense = (outcome(specimen_density=e) for e in (-0.01, 0.0, 0.01))
    at = [float(displacement_at(o.curves["confined"], 100.0)) for o in (loose, usual, dense)]
    print(f"displacement at 100 N, loose to dense: {at}")
    assert at[0] > at[1] > at[2]


# ------------------------------------------------------------------ sensitivities


@pytest.fixture(scope="session")
def slopes(packing, time_step):
    """Derivatives of H (mm) and F (N) at strength 0, shape (effects, 2), in one pass."""

    def response(values):
        effects = with_strengths(ALL.effects, list(values))
        lab = eqx.tree_at(lambda lab: lab.effects, ALL, effects)
        outcome = lab.run(packing, SOIL, time_step)
        return jnp.stack(
            [
                1e3 * depth_of(outcome),
                force_of(outcome),
            ]
        )

    def push(direction):
        return jax.jvp(response, (jnp.zeros(len(NAMES)),), (direction,))[1]

    return np.asarray(jax.jit(jax.vmap(push))(jnp.eye(len(NAMES))))


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_sensitivities_at_zero_are_differences(name, slopes, outcome):
    """Tangents against central differences over 1e-7 of a typical strength (one-sided at 0
    for the lag, whose filter has no meaning below 0); a step of 1e-6 crosses slips, which
    costs the depth 20 % with platen friction."""
    typical = TYPICAL[name]
    size = 1e-7 * typical
    found = slopes[NAMES.index(name)] * typical
    low = 0.0 if name == "acquisition_lag" else -size
    ends = [outcome(**{name: end}) for end in (size, low)]
    pairs = [
        np.array(
            [
                1e3 * depth_of(o),
                force_of(o),
            ],
            float,
        )
        for o in ends
    ]
    expected = (pairs[0] - pairs[1]) / (size - low) * typical
    print(f"{name}: tangent {found}, difference {expected} (mm, N per typical strength)")
    np.testing.assert_allclose(found[0], expected[0], rtol=0.01, atol=1e-6)
    np.testing.assert_allclose(found[1], expected[1], rtol=0.01, atol=1e-4)


# ------------------------------------------------------------------ the time step


def test_the_time_step_is_that_of_the_stiffest_stage(heap):
    """Forces times 1 + e in the second test: the step of a soil with these forces throughout."""
    step = lab_with(EFFECTS["second_test_factor"](0.75)).time_step(heap, SOIL)
    scaled = lab_with().time_step(heap, with_contacts_scaled(SOIL, jnp.asarray(1.75)))
    assert float(step) == pytest.approx(float(scaled), rel=1e-12)
    weaker = lab_with(EFFECTS["second_test_factor"](-0.5)).time_step(heap, SOIL)
    assert float(weaker) == float(lab_with().time_step(heap, SOIL))


def test_bonds_shorten_the_time_step_by_their_stiffness(heap):
    """1/dt^2 grows by k/(4 m) in units of the limit, k = T/w of a bond, m that of sliding."""
    numerics, stress = lab_with().numerics, 2e5
    plain, bonded = (
        float(lab_with(EFFECTS["cementation"](s)).time_step(heap, SOIL)) for s in (0.0, stress)
    )
    assert plain == float(lab_with().time_step(heap, SOIL))
    smallest = int(np.argmin(np.asarray(heap.spheres.radius)))
    radius = float(heap.spheres.radius[smallest])
    sliding = 2 / 7 * 0.5 * float(heap.spheres.mass[smallest])
    stiffness = stress * 2 * radius / STRAIN
    added = bonded**-2 - plain**-2
    assert added == pytest.approx(stiffness / (4 * sliding) / numerics.safety**2, rel=0.02)
