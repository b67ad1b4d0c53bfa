"""Both laboratory tests on small beds: weight, energy, derivatives, extremes, precision.

One bed of 60 spheres is prepared for the whole file.  Laboratories differ only in how
fast and how far they press; one program serves them all with every soil, packing and rate,
which `assert_max_traces` checks while the tests use it.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jdem.packing.settling
from calibrate.inference.parameters import FACTORS
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.engine.bed import build_bed, steps_per_sample
from jdem.engine.loop import run, start
from jdem.engine.segment import KEEP, REMOVE, cell_segment, stack
from jdem.engine.step import GRAVITY
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.observables import inertial_number
from jdem.packing.composite import prepare
from jdem.packing.settling import neutral_soil
from jdem.packing.specimen import Specimen, load, save
from tests.support.effect_lab import NUMERICS, ROWS, SMALL, SOIL, small_lab

pytestmark = pytest.mark.thorough

LOW = dict(zip(FACTORS, (0.3, 0.2, 0.1, 4.0, 0.2, 0.5, 0.3), strict=True))  # Table 2
HIGH = dict(zip(FACTORS, (0.7, 1.0, 0.6, 20.0, 0.7, 3.0, 1.0), strict=True))
GENERATOR = np.array([1, 1, -1, 1, 1, 1, -1, -1, -1, 1, -1])  # Plackett and Burman 1946, 12 runs


def brief():
    """Half the paper's forces and hardly any crushing: for what needs many runs."""
    confined = ConfinedCompression(
        simulated_rate=0.05, force_low=100.0, force_high=200.0, stroke=0.2 * SMALL.height
    )
    return TestSequence((confined, UnconfinedCompression(stroke=5e-4, rest=2e-3, opening=1e-4)))


def full():
    """The paper's forces, and crushing past the first peak; rates in m/s, strokes in m."""
    confined = ConfinedCompression(simulated_rate=0.05, stroke=0.35 * SMALL.height)
    tests = TestSequence((confined, UnconfinedCompression(stroke=0.004)))
    return small_lab(tests)


WHOLE = full()
BRIEF = replace(WHOLE, tests=brief())
# The same laboratory with the paper's forces.
PRESSED = eqx.tree_at(
    lambda lab: (lab.tests["confined"].force_low, lab.tests["confined"].force_high),
    BRIEF,
    (jnp.asarray(200.0, float), jnp.asarray(400.0, float)),
)


def soil_of(log_factors):
    """The bundled soil with its seven factors at exp(log_factors)."""
    values = [jnp.exp(value) for value in log_factors]
    return eqx.tree_at(lambda soil: [getattr(soil, n) for n in FACTORS], SOIL, values)


def log_factors(values):
    return np.log([values[name] for name in FACTORS])


CENTRE = np.log([float(getattr(SOIL, name)) for name in FACTORS])


@pytest.fixture(scope="session")
def packing():
    return prepare(SMALL, 0)


@pytest.fixture(scope="session")
def other_packing():
    return prepare(SMALL, 1)


whole = eqx.filter_jit(eqx.debug.assert_max_traces(VirtualLab.run, max_traces=1))


def ran(lab, packing, soil):
    return whole(lab, packing, soil, lab.time_step(packing, soil))


@pytest.fixture(scope="session")
def outcome(packing):
    return ran(WHOLE, packing, SOIL)


@eqx.filter_jit
@eqx.debug.assert_max_traces(max_traces=1)
def observables(lab, packing, point, tangent, time_step):
    """(H in mm, F in N), their derivatives along `tangent` of ln p, and `failed`."""

    def response(point):
        outcome = lab.run(packing, soil_of(point), time_step)
        both = jnp.stack(
            [
                1e3 * outcome.observables["confined"]["depression_depth"],
                outcome.observables["unconfined"]["crushing_force"],
            ]
        )
        return both, outcome.failed

    values, tangents, failed = jax.jvp(response, (point,), (tangent,), has_aux=True)
    return values, tangents, failed


def depth(lab, packing, point, time_step):
    outcome = whole(lab, packing, soil_of(point), time_step)
    return 1e3 * outcome.observables["confined"]["depression_depth"]


# ------------------------------------------------------------------ weight and energy


def at_rest(packing, soil, mould):
    """Means over the second half of two damped seconds without platen."""
    bed = build_bed(packing.spheres, soil, WHOLE.grid, NUMERICS)
    state = start(bed, packing.position, packing.height, packing.mould_radius)
    rest = cell_segment(damping=100.0, duration=2.0, platen=REMOVE, mould=mould)
    steps = steps_per_sample(bed, NUMERICS)
    record = eqx.filter_jit(run)(bed, state, stack([rest]), steps, ROWS)
    assert not record.overflow_of(WHOLE.grid), record.explain_overflow(WHOLE.grid)
    rows = np.flatnonzero(np.asarray(record.samples.segment) == 0)
    late = rows[len(rows) // 2 :]
    return jax.tree.map(lambda leaf: np.mean(np.asarray(leaf)[late], axis=0), record.samples)


@pytest.mark.slow
@pytest.mark.parametrize("wall_friction", [0.0, 0.3])
def test_base_and_mould_carry_the_weight(packing, wall_friction):
    """Base force (down) and drag on the mould (up is positive): base - drag = sum m g.

    1e-3 of the weight: what the slowest sphere still accelerates by after that time.
    """
    soil = replace(neutral_soil(), wall_friction=jnp.asarray(wall_friction))
    last = at_rest(packing, soil, KEEP)
    weight = GRAVITY * float(jnp.sum(packing.spheres.mass))
    assert last.base_force - last.mould_drag == pytest.approx(weight, rel=1e-3)
    assert np.isfinite(last.mould_force) and last.mould_force > 0
    assert last.platen_force == 0.0
    if wall_friction == 0:
        assert last.mould_drag == 0.0


@pytest.mark.slow
def test_energy_is_accounted_for(outcome):
    """The ledger closes to round-off: 3e5 additions of terms up to 1 J, 1e-16 each."""
    energy, last = outcome.record.state.energy, outcome.record.samples
    row = np.flatnonzero(np.asarray(last.segment) >= 0)[-1]
    left = float(energy.supplied() - energy.absorbed() - last.kinetic_energy[row])
    assert abs(left) < 1e-10 * float(energy.platen)
    # Semi-implicit Euler, first order in the time step: what it adds must stay small.
    assert abs(float(energy.integration)) < 0.01 * float(energy.platen)


@pytest.mark.slow
def test_the_specimen_rests_before_it_is_crushed(outcome):
    samples = outcome.record.samples
    row = np.flatnonzero(np.asarray(samples.segment) == WHOLE.tests.names.index("resting"))[-1]
    share = float(samples.kinetic_energy[row] / outcome.record.state.energy.platen)
    print(f"kinetic energy after the rest: {share:.1e} of the platen's work")
    assert share < 1e-4


@pytest.mark.slow
def test_nothing_failed(outcome):
    assert not outcome.failed
    assert 0.5e-3 < outcome.observables["confined"]["depression_depth"] < 10e-3
    assert outcome.observables["unconfined"]["crushing_force"] > 5.0
    assert 400.0 < outcome.curves["confined"].force.max() < 404.0  # two servo widths beyond 400 N


# ------------------------------------------------------------------ one program for all


@pytest.mark.slow
def test_one_compilation_serves_all_soils_packings_and_rates(outcome, other_packing):
    """`whole` may be traced once."""
    harder = replace(SOIL, shear_modulus=jnp.asarray(2e7), restitution=jnp.asarray(0.5))
    slower = eqx.tree_at(
        lambda lab: lab.tests["confined"].simulated_rate, WHOLE, jnp.asarray(0.07, float)
    )
    outcomes = [ran(WHOLE, other_packing, harder), ran(slower, other_packing, SOIL)]
    depths = [float(o.observables["confined"]["depression_depth"]) for o in (outcome, *outcomes)]
    assert len(set(depths)) == 3


@pytest.mark.slow
def test_a_batch_of_soils_gives_what_single_runs_give(packing):
    """The same arithmetic in another order: equal until chaos has amplified round-off.

    Round-off of 1e-16 stays below 1e-9 of the depth; 1e-6 has room.
    """
    points = jnp.stack([CENTRE, CENTRE + 1e-3])
    step = 0.8 * PRESSED.time_step(packing, SOIL)
    batch = jax.vmap(depth, in_axes=(None, None, 0, None))(PRESSED, packing, points, step)
    single = [depth(PRESSED, packing, point, step) for point in points]
    np.testing.assert_allclose(batch, single, rtol=1e-6)


@pytest.mark.slow
def test_single_precision_gives_the_same_depth(packing):
    """Within 2 %: round-off of 1e-7 decides otherwise at slips and rearrangements, and a bed
    of 60 spheres answers one of these with some 1e-2 mm (scatter of packings: several %)."""
    coarse = replace(BRIEF, numerics=replace(NUMERICS, dtype="float32"))
    step = BRIEF.time_step(packing, SOIL) * 0.8
    double = float(depth(BRIEF, packing, CENTRE, step))
    found = eqx.filter_jit(VirtualLab.run)(coarse, packing, soil_of(CENTRE), step)
    assert found.record.samples.platen_force.dtype == np.float32
    single = 1e3 * float(found.observables["confined"]["depression_depth"])
    print(f"depth in float64 {double:.5f} mm, in float32 {single:.5f} mm")
    assert single == pytest.approx(double, rel=0.02)


# ------------------------------------------------------------------ derivatives


@pytest.mark.slow
def test_depth_has_its_exact_derivative(packing):
    """Tangents against central differences in each of the seven ln p, at a fixed time step.

    Differences tend to the tangents in proportion to their step, because a step crosses slips
    that begin one time step earlier or later: for rolling friction they are off by 0.03 at
    3e-6, 5e-4 at 1e-7 and 1e-4 mm at 3e-8, 6e-4 of the derivative.  Round-off in H is up to
    2e-12 mm, so 3e-5 mm per unit of ln p at 3e-8.  Numerics and damping are the defaults, and
    the bed is no special one (docs/derivatives.md).
    """
    time_step, size = 0.8 * PRESSED.time_step(packing, SOIL), 3e-8
    found, expected = [], []
    for direction in np.eye(len(FACTORS)):
        found.append(observables(PRESSED, packing, CENTRE, direction, time_step)[1][0])
        ends = [depth(PRESSED, packing, CENTRE + s * direction, time_step) for s in (size, -size)]
        expected.append((ends[0] - ends[1]) / (2 * size))
    found, expected = np.array(found), np.array(expected)
    for name, ours, theirs in zip(FACTORS, found, expected, strict=True):
        print(f"dH/dln {name:22s} tangent {ours: .7f}  difference {theirs: .7f} mm")
    assert np.abs(found).max() > 0.05, "the bed does not respond: nothing was tested"
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=5e-5)


def plackett_burman():
    """The 12 corners of the screening design: seven columns of the cyclic design."""
    rows = [np.roll(GENERATOR, k) for k in range(11)] + [-np.ones(11, int)]
    return np.array(rows)[:, : len(FACTORS)]


def test_the_design_is_orthogonal():
    design = plackett_burman()
    np.testing.assert_array_equal(design.T @ design, 12 * np.eye(len(FACTORS)))


@pytest.mark.slow
@pytest.mark.parametrize("corner", range(12))
def test_extreme_soils_give_numbers_and_tangents(packing, corner):
    """One tangent along all seven factors at once; a corner may fail, but not be NaN."""
    signs = plackett_burman()[corner]
    point = np.where(signs > 0, log_factors(HIGH), log_factors(LOW))
    time_step = BRIEF.time_step(packing, soil_of(point))
    values, tangents, failed = observables(BRIEF, packing, point, np.ones(7), time_step)
    print(corner, np.asarray(values), np.asarray(tangents), bool(failed))
    assert np.all(np.isfinite(values))
    assert np.all(np.isfinite(tangents))


# ------------------------------------------------------------------ packings


def leaves(packing):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(packing)]


def test_a_seed_gives_one_packing(packing):
    for ours, again in zip(leaves(packing), leaves(prepare(SMALL, 0)), strict=True):
        np.testing.assert_array_equal(ours, again)


def test_seeds_give_different_packings(packing, other_packing):
    assert not np.any(packing.spheres.radius == other_packing.spheres.radius)
    apart = np.abs(packing.position.stack() - other_packing.position.stack())
    assert np.median(apart) > 0.1 * float(packing.mean_diameter())


@pytest.mark.slow
def test_falling_and_levelling_share_one_program(monkeypatch):
    """A bed of 50 falls for less time than levelling may take, by more than capacities round."""
    capacities, settle = [], jdem.packing.settling._program()

    def noted(*arguments):
        capacities.append(arguments[-1])
        return settle(*arguments)

    monkeypatch.setattr(jdem.packing.settling, "_program", lambda: noted)
    prepare(Specimen(count=50), 0)
    assert len(capacities) == 2 and len(set(capacities)) == 1


def test_a_packing_has_the_wanted_density_and_lies_in_its_mould(packing):
    assert float(packing.bulk_density()) == pytest.approx(SMALL.density, rel=1e-12)
    assert 0.4 < float(packing.solid_fraction()) < 0.64
    radius, place = np.asarray(packing.spheres.radius), packing.position
    outside = np.hypot(place.x, place.y) + radius - float(packing.mould_radius)
    # Overlaps at rest: a bed's weight of a few newtons over a stiffness of 1e5 N/m.
    assert outside.max() < 1e-4
    assert np.min(np.asarray(place.z) - radius) > -1e-4


def test_packings_have_about_the_wanted_height(packing, other_packing):
    """A bed is as high as its topmost sphere, which may stand alone: hence the mean of two."""
    heights = [float(bed.height) for bed in (packing, other_packing)]
    assert np.mean(heights) == pytest.approx(SMALL.height, rel=0.1)


def test_a_packing_survives_the_disk(packing, tmp_path):
    save(packing, tmp_path / "deep" / "bed.npz")
    for ours, stored in zip(leaves(packing), leaves(load(tmp_path / "deep" / "bed.npz")), strict=1):
        np.testing.assert_array_equal(ours, stored)
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["bed.npz"]


@pytest.mark.parametrize("kept", [0, 10, 100, 0.5, 0.99])
def test_a_damaged_packing_is_refused(packing, tmp_path, kept):
    path = tmp_path / "bed.npz"
    save(packing, path)
    whole_file = path.read_bytes()
    size = kept if isinstance(kept, int) else int(kept * len(whole_file))
    path.write_bytes(whole_file[:size])
    with pytest.raises((OSError, ValueError)):
        load(path)


@pytest.mark.parametrize("position", [0.3, 0.6, 0.9])
def test_a_packing_with_flipped_bits_is_refused(packing, tmp_path, position):
    path = tmp_path / "bed.npz"
    save(packing, path)
    content = bytearray(path.read_bytes())
    place = int(position * len(content))
    for k in range(place, place + 8):
        content[k] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises((OSError, ValueError)):
        load(path)


# ------------------------------------------------------------------ quasi-static presets


@pytest.mark.parametrize("name", PRESETS)
def test_presets_press_quasi_statically(name):
    """I = rate/height d sqrt(rho/P) below 1e-3 at force_low, from the preset's numbers alone.

    rho is that of a grain: bulk density over a solid fraction of 0.55, typical of beds.
    """
    lab, preset = load_lab(bundled_lab()), PRESETS[name]
    cylinder, tests = specimen(lab, preset), virtual_lab(lab, preset).tests
    pressure = float(tests["confined"].force_low) / (np.pi * cylinder.diameter**2 / 4)
    number = inertial_number(
        tests["confined"].simulated_rate,
        cylinder.height,
        2 * cylinder.mean_radius(),
        cylinder.density / 0.55,
        pressure,
    )
    print(f"{name}: inertial number {float(number):.1e}")
    assert float(number) < 1e-3
