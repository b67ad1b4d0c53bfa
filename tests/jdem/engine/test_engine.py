"""The engine against mechanics: conservation, closed forms, restarts, energy, precision.

Beds are those of hand_made_beds; lists of neighbours are in test_neighbour_lists.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.bodies.spheres import kinetic_energy
from jdem.boundaries.composite import BASE
from jdem.core import kernel
from jdem.core.fusion import fenced, once
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.loop import run
from jdem.engine.neighbors import Demand
from jdem.engine.segment import LOWER, Segment, cell_segment, stack
from jdem.engine.step import LOADED, step
from tests.support.hand_made_beds import (
    CAPACITY,
    GRAVITY,
    RADIUS,
    SHARP,
    STEPS,
    WIDE,
    advanced,
    bed_of,
    idle,
    last,
    listed,
    quickly,
    ran,
    simulate,
    soil_of,
    spheres_of,
    state_of,
)

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("cheaply_compiled")]

# ------------------------------------------------------------------ action = reaction


def momentum(spheres, motion):
    mass = np.asarray(spheres.mass)[:, None]
    inertia = np.asarray(spheres.inertia)[:, None]
    place, velocity, spin = (
        np.asarray(v.stack()) for v in jax.tree.leaves(motion, is_leaf=is_vector)
    )
    angular = np.cross(place, mass * velocity) + inertia * spin
    return (mass * velocity).sum(0), angular.sum(0)


def is_vector(node):
    return isinstance(node, Vector)


OBLIQUE = {  # relative to a point high above the base; all spheres meet off their centres
    "position": np.array([[0, 0, 1], [5.3e-3, 1e-3, 1.0005], [-4e-3, 3e-3, 1.002]]),
    "velocity": np.array([[0.3, 0, 0], [-0.2, 0.1, 0], [0.4, -0.2, -0.1]]),
    "spin": np.array([[0, 30.0, 5], [10, 0, -40], [0, 0, 20]]),
}


@pytest.mark.parametrize("smoothing", [SHARP, Smoothing()], ids=["sharp", "default"])
def test_collisions_conserve_momentum_and_angular_momentum(smoothing):
    spheres = spheres_of(3, spread=0.2)
    soil = soil_of(plasticity_ratio=0.4, surface_energy=5.0, restitution=0.5)
    bed = bed_of(spheres, soil, gravity=0.0, smoothing=smoothing)
    state = state_of(bed, **OBLIQUE)
    final = advanced(bed, state, 500)[0]
    before, after = momentum(spheres, state.motion), momentum(spheres, final.motion)
    change = kinetic_energy(spheres, final.motion) / kinetic_energy(spheres, state.motion)
    assert change < 0.9  # they did collide
    # 500 additions, each rounded to eps of the largest term; arms are 1 m.
    scale = np.sum(np.asarray(spheres.mass)) * 0.5
    for a, b in zip(before, after, strict=True):
        assert np.abs(a - b).max() < 500 * np.finfo(float).eps * scale


# ------------------------------------------------------------------ sliding and rolling


def on_the_base(soil, speed, spin, smoothing=SHARP, **numerics):
    """One sphere at rest on the base under its weight, then given a speed along x."""
    spheres = spheres_of(1)
    bed = bed_of(spheres, soil, smoothing=smoothing, skin=WIDE, **numerics)
    stiffness = float(bed.wall_law.normal.stiffness.normal(RADIUS))
    height = RADIUS - float(spheres.mass[0]) * GRAVITY / stiffness
    state = state_of(bed, [[0.0, 0.0, height]], [[speed, 0.0, 0.0]], [[0.0, spin, 0.0]])
    return bed, state


def test_a_sliding_sphere_begins_to_roll_when_and_as_fast_as_it_should():
    """Sliding: v = v0 - mu g t, w R = 5/2 mu g t; equal at t = 2 v0/(7 mu g), v = 5/7 v0."""
    speed, friction = 0.1, 0.3
    bed, state = on_the_base(soil_of(platen_friction=friction), speed, 0.0)
    begin = 2 * speed / (7 * friction * GRAVITY)
    _, (motion, _) = advanced(bed, state, STEPS)
    time = np.arange(1, STEPS + 1) * float(bed.time_step)
    assert time[-1] > 2 * begin
    velocity, surface = (
        np.asarray(motion.velocity.x[:, 0]),
        np.asarray(motion.spin.y[:, 0]) * RADIUS,
    )
    sliding = time < 0.95 * begin
    # The spring first stretches by mu m g / k_t, and the lever arm is shorter than R by the
    # overlap: both about 1e-3 of what is measured.
    expected = speed - friction * GRAVITY * time
    assert np.abs(velocity - expected)[sliding].max() < 2e-3 * speed
    assert np.abs(surface - 2.5 * friction * GRAVITY * time)[sliding].max() < 5e-3 * speed
    rolls = np.argmax(surface >= 0.999 * velocity)
    assert time[rolls] == pytest.approx(begin, rel=0.02)
    assert velocity[-1] == pytest.approx(5 / 7 * speed, rel=2e-3)
    assert surface[-1] == pytest.approx(5 / 7 * speed, rel=2e-3)


@pytest.mark.parametrize("smoothing", [SHARP, Smoothing()], ids=["sharp", "default"])
def test_a_rolling_sphere_slows_down_and_stops_without_turning_back(smoothing):
    """m dv/dt = -f and 2/5 m R^2 dw/dt = f R - mu_r m g R with v = w R give

    dv/dt = -5/7 mu_r g        (f = 5/7 mu_r m g, below sliding friction)
    """
    speed, rolling = 0.05, 0.1
    soil = soil_of(rolling_friction=rolling, platen_friction=0.5, restitution=0.5)
    bed, state = on_the_base(soil, speed, speed / RADIUS, smoothing)
    stops = speed / (5 / 7 * rolling * GRAVITY)
    _, (motion, _) = advanced(bed, state, STEPS)
    time = np.arange(1, STEPS + 1) * float(bed.time_step)
    assert time[-1] > 1.5 * stops
    spin, velocity = np.asarray(motion.spin.y[:, 0]), np.asarray(motion.velocity.x[:, 0])
    slowing = time < 0.9 * stops
    expected = speed - 5 / 7 * rolling * GRAVITY * time
    assert np.abs(velocity - expected)[slowing].max() < 5e-3 * speed
    # The spring's 5/7 of the rolling limit is held by a spin w with w/(w + width) = 5/7.
    assert spin.min() >= -2.5 * float(smoothing.roll) - 1e-12
    assert np.abs(spin[-1]) * RADIUS < 1e-3 * speed
    assert np.abs(velocity[-1]) < 1e-3 * speed


def test_a_spin_without_contact_is_kept():
    bed = bed_of(spheres_of(1), soil_of(rolling_friction=0.5), gravity=0.0, skin=WIDE)
    state = state_of(bed, [[0.0, 0.0, 1.0]], spin=[[1.0, 2.0, 3.0]])
    final = advanced(bed, state, STEPS)[0]
    round_off = STEPS * np.finfo(float).eps
    assert np.abs(final.motion.spin.stack() / np.array([1.0, 2.0, 3.0]) - 1).max() < round_off


# ------------------------------------------------------------------ a few spheres at rest


one_step = eqx.filter_jit(step)


def slowed(overlap, unloaded):
    """Share of a sphere's sideways speed that one step leaves, pressed into the base (m)."""
    bed = bed_of(spheres_of(1), soil_of(restitution=1.0, platen_friction=0.0), gravity=0.0)
    place, speed = np.array([[0.0, 0.0, RADIUS - overlap]]), np.array([[1e-3, 0.0, 0.0]])
    state = listed(bed, state_of(bed, place, speed))
    after = one_step(bed, state, idle(state, unloaded=unloaded))
    share = float(after.motion.velocity.x[0]) / 1e-3
    load = float(after.wall_force[BASE]) / (GRAVITY * float(bed.spheres.mass[0]))
    return share, load, float(bed.time_step)


@pytest.mark.slow
def test_the_extra_damping_is_for_spheres_without_load():
    """1/(1 + c dt) with c = c0/(1 + (S/S0)^2), S/S0 the load over LOADED own weights."""
    for overlap in (-1e-6, 1e-6, 1e-5, 1e-4):
        share, load, time_step = slowed(overlap, 4000.0)
        rate = 4000.0 / (1 + (load / LOADED) ** 2)
        assert share == pytest.approx(1 / (1 + rate * time_step), rel=1e-12)
    assert slowed(-1e-6, 4000.0)[1] == 0.0, "no load was tested"
    assert slowed(1e-4, 4000.0)[1] > 2 * LOADED, "no heavy load was tested"


def test_a_boundary_changes_no_number():
    def compute(x):
        return once((jnp.sin(x), {"a": x * x}))

    @jax.jit
    def kept_apart(x):
        with fenced():
            return compute(x)

    x = jnp.linspace(0, 1, 5)
    jax.tree.map(np.testing.assert_array_equal, kept_apart(x), compute(x))
    slope = jax.jvp(lambda y: kept_apart(y)[1]["a"], (x,), (jnp.ones(5),))[1]
    np.testing.assert_allclose(slope, 2 * x)
    assert once(x) is x


def looped(x):
    """A boundary inside a loop, as the engine's are."""

    def advance(_, y):
        with fenced():
            return once(jnp.sin(y)) + 1

    return jax.lax.fori_loop(0, 9, advance, x)


@pytest.mark.parametrize("move", ["alone", "pushed", "batched"])
def test_boundaries_stay_in_the_compiled_program(move):
    moved = {
        "alone": looped,
        "pushed": lambda x: jax.jvp(looped, (x,), (x,)),
        "batched": jax.vmap(looped),
    }
    compiled = jax.jit(moved[move]).lower(jnp.ones((3, 5))).compile().as_text()
    assert (" call(" in compiled) == (jax.default_backend() == "cpu")


def heap(raised=0.0):
    """Three spheres side by side just above the base (or higher), and one on top of them."""
    ring = [[0, 0], [2.02, 0], [1.01, 1.75]]
    places = [[RADIUS * x, RADIUS * y, 1.01 * RADIUS] for x, y in ring]
    heights = np.array([0, 0, raised])
    return np.array([*places, [1.01 * RADIUS, 0.58 * RADIUS, 2.8 * RADIUS]]) + heights


def cohesive_soil(**values):
    return soil_of(
        **{
            "plasticity_ratio": 0.358,
            "surface_energy": 10.0,
            "restitution": 0.4,
            "rolling_friction": 0.2,
            "platen_friction": 0.5,
            **values,
        }
    )


@pytest.mark.slow
def test_the_base_carries_the_weight_of_what_rests_on_it():
    spheres = spheres_of(4)
    bed = bed_of(spheres, cohesive_soil(), smoothing=Smoothing())
    record = ran(bed, state_of(bed, heap()), 60, damping=100.0)
    weight = float(jnp.sum(spheres.mass)) * GRAVITY
    assert last(record.samples).base_force == pytest.approx(weight, rel=1e-3)
    assert last(record.samples).kinetic_energy < 1e-9 * weight * RADIUS
    assert record.state.motion.position.z[3] > 2 * RADIUS  # still on top


@pytest.mark.slow
def test_a_turned_bed_moves_as_the_bed_turned():
    """By 90 degrees about the cylinder's axis; what differs is the order of additions."""
    bed = bed_of(spheres_of(4, 0.1), cohesive_soil(), smoothing=Smoothing())
    place, velocity = heap(), np.array([[0.1, 0.0, 0], [0, 0.05, 0], [0, -0.1, 0], [0.02, 0.03, 0]])
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    mould = 4 * RADIUS
    straight = ran(bed, state_of(bed, place, velocity, mould_radius=mould), 8)
    turned = ran(bed, state_of(bed, place @ quarter.T, velocity @ quarter.T, mould_radius=mould), 8)
    for vector in ("position", "velocity", "spin"):
        ours = np.asarray(getattr(turned.state.motion, vector).stack())
        expected = np.asarray(getattr(straight.state.motion, vector).stack()) @ quarter.T
        assert np.abs(ours - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.slow
def test_blocks_of_a_pair_list_add_up_to_the_whole(monkeypatch):
    """Four blocks of four pairs, some of them unused; what differs is the order of additions."""
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    state = ran(bed, state_of(bed, heap()), 8).state
    command = idle(state)

    def later():
        def advance(_, state):
            return step(bed, state, command)

        return eqx.filter_jit(lambda s: jax.lax.fori_loop(0, 20, advance, s))(state)

    whole = later()
    monkeypatch.setattr(kernel, "BLOCK", 4)
    assert kernel.block_count(bed.grid.pairs) == 4
    for ours, expected in zip(*map(jax.tree.leaves, (later(), whole)), strict=True):
        scale = np.abs(np.asarray(expected)).max()
        np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=1e-9 * scale)
    assert np.asarray(whole.pairs.history.normal.max_overlap).max() > 0, "nothing touched"


def test_two_halves_are_the_whole_bit_for_bit_through_a_file(tmp_path):
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    state = state_of(bed, heap())
    whole = ran(bed, state, 10).state
    half = ran(bed, state, 5).state
    leaves, structure = jax.tree.flatten(half)
    np.savez(tmp_path / "state.npz", *leaves)
    with np.load(tmp_path / "state.npz", allow_pickle=False) as stored:
        restored = jax.tree.unflatten(structure, [jnp.asarray(stored[k]) for k in stored.files])
    other = ran(bed, restored, 5).state
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(other), strict=True):
        assert np.array_equal(a, b)


def test_segments_last_as_long_as_they_say():
    """Ten intervals make a segment of ten intervals, whatever the round-off of the clock."""
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    interval = 20 * bed.time_step
    for samples in (1, 3, 7, 10):
        programme = stack([Segment(duration=samples * interval)])
        record = simulate(bed, state_of(bed, heap()), programme, jnp.asarray(20), CAPACITY)
        assert int(np.sum(record.samples.segment == 0)) == samples


# ------------------------------------------------------------------ lists that are too small


def thrown(speed, intervals=1):
    """A bed, and the record of intervals of 100 steps after its spheres were thrown (m/s)."""
    bed = bed_of(spheres_of(4), soil_of())
    fast = state_of(bed, heap(raised=0.1), np.full((4, 3), speed))
    programme = stack([Segment(duration=100 * intervals * bed.time_step)])
    return bed, simulate(bed, fast, programme, jnp.asarray(100), CAPACITY)


def test_the_record_says_which_capacity_or_skin_was_too_small():
    """Spheres that cross the skin in one step."""
    bed, record = thrown(1e4)
    assert record.overflow_of(bed.grid)
    assert "motion between rebuilds" in record.explain_overflow(bed.grid)
    assert not Demand.none().exceeds(bed.grid)


def test_a_run_ends_where_its_lists_were_too_small():
    """What came after would have contacts missing."""
    _, sound = thrown(1.0, intervals=3)
    bed, lost = thrown(1e4, intervals=3)
    assert lost.overflow_of(bed.grid) and sound.finished and not lost.finished
    assert [int(np.sum(record.samples.segment == 0)) for record in (sound, lost)] == [3, 1]


def test_an_interval_is_cut_where_spheres_would_outrun_their_lists():
    """They fly several skins in the interval, and every step of it is taken."""
    speed = 10.0
    bed, record = thrown(speed)
    way = 2 * np.sqrt(3) * speed * float(record.state.time)
    assert way > 3 * bed.grid.skin >= 3 * float(record.drift)
    assert not record.overflow_of(bed.grid)
    assert float(record.state.time) == pytest.approx(100 * float(bed.time_step), rel=1e-12)


# ------------------------------------------------------------------ energy


def bounce(share):
    """A heap thrown at the base, for one time at any share of the time step: the ledger, the
    kinetic energy gained, and the energy that was there to be had (J)."""
    bed = bed_of(spheres_of(4, 0.1), cohesive_soil(surface_energy=1.0), smoothing=Smoothing())
    bed = eqx.tree_at(lambda b: b.time_step, bed, bed.time_step * share)
    velocity = np.full((4, 3), [0.02, 0.01, -0.2])
    spin = np.outer(np.arange(4), [0.0, 5.0, 2.0])
    state = state_of(bed, heap(raised=1e-4), velocity, spin)
    final = ran(bed, state, 10, round(50 / share)).state
    before, after = (kinetic_energy(bed.spheres, s.motion) for s in (state, final))
    return final.energy, float(after - before), float(before)


def test_the_energy_ledger_closes():
    ledger, gained, energy = bounce(1.0)
    assert float(ledger.normal_dashpot) > 0.1 * energy  # it did bounce
    error = float(ledger.supplied()) - float(ledger.absorbed()) - gained
    # 500 steps of ten sums each
    assert abs(error) < 5000 * np.finfo(float).eps * energy


def test_the_integration_error_is_small_and_of_first_order():
    whole, half, quarter = (bounce(share) for share in (1.0, 0.5, 0.25))
    errors = [float(ledger.integration) for ledger, _, _ in (whole, half, quarter)]
    # A bounce off a linear spring, force F_max sin(w t), adds up to (pi/2) w dt of its energy;
    # the time step is a quarter of 1/w.
    assert 0 < errors[0] < np.pi / 2 * 0.25 * whole[2]
    # First order, and what the ratio misses of 1/2 halves with the time step as well.
    assert errors[1] / errors[0] == pytest.approx(0.5, abs=0.1)
    assert errors[2] / errors[1] == pytest.approx(0.5, abs=0.05)


def test_a_heap_at_rest_supplies_nothing_more():
    bed = bed_of(spheres_of(4), cohesive_soil(), smoothing=Smoothing())
    settled = ran(bed, state_of(bed, heap()), 60, damping=100.0).state
    later = ran(bed, settled, 10).state
    weight = float(jnp.sum(bed.spheres.mass)) * GRAVITY
    change = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), later.energy, settled.energy)
    assert max(jax.tree.leaves(change)) < 1e-6 * weight * RADIUS


# ------------------------------------------------------------------ programs and precision


def test_new_parameter_values_do_not_compile_anew():
    for values in ({}, {"restitution": 0.6}, {"surface_energy": 3.0, "tensile_exponent": 5.0}):
        bed = bed_of(spheres_of(4), cohesive_soil(**values), smoothing=Smoothing())
        ran(bed, state_of(bed, heap()), 2 + len(values), 10)  # raises if traced a second time


@pytest.mark.slow
def test_a_batch_of_soils_runs_as_each_alone():
    soils = [cohesive_soil(), cohesive_soil(surface_energy=3.0, static_friction=0.4)]
    beds = [bed_of(spheres_of(4), soil, smoothing=Smoothing()) for soil in soils]
    starts = [state_of(bed, heap()) for bed in beds]
    segments = [stack([Segment(duration=200.5 * bed.time_step)]) for bed in beds]
    many = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *zip(beds, starts, segments, strict=True)
    )
    batch = eqx.filter_vmap(lambda b, s, p: run(b, s, p, jnp.asarray(50), CAPACITY))
    together = eqx.filter_jit(batch)(*many)
    for k, one in enumerate(zip(beds, starts, segments, strict=True)):
        alone = simulate(*one, jnp.asarray(50), CAPACITY)
        for ours, expected in zip(results(together), results(alone), strict=True):
            assert np.abs(ours[k] - expected).max() < 1e-9 * np.abs(expected).max()


def results(record):
    motion, samples = record.state.motion, record.samples
    return [motion.position.stack(), motion.velocity.stack(), samples.base_force]


def test_float32_agrees_with_float64_over_a_fall_and_a_bounce():
    """Each step rounds height and speed to eps/2 of themselves: STEPS eps/2 of the height
    for the first; for the second, STEPS eps/2 of the impact speed over the flight."""
    drop, time_step = 2 * RADIUS, 2e-5
    heights = {}
    for dtype in ("float64", "float32"):
        bed = bed_of(spheres_of(1), soil_of(restitution=0.7), skin=WIDE, dtype=dtype)
        bed = eqx.tree_at(lambda b: b.time_step, bed, jnp.asarray(time_step, dtype))
        final = advanced(bed, state_of(bed, [[0.0, 0.0, RADIUS + drop]]), STEPS)
        assert final[0].motion.position.z.dtype == dtype
        heights[dtype] = np.asarray(final[1][0].position.z[:, 0], float)
    assert heights["float64"].min() < RADIUS  # it reached the base ...
    assert heights["float64"][-1] > RADIUS  # ... and has left it again
    speed, flight = np.sqrt(2 * GRAVITY * drop), STEPS * time_step
    bound = STEPS * np.finfo(np.float32).eps / 2 * (RADIUS + drop + speed * flight)
    assert np.abs(heights["float32"] - heights["float64"]).max() < bound


def test_the_base_pushes_down_where_the_sphere_pushes_up():
    """A head-on fall: what the base feels is the momentum that the sphere takes back."""
    bed = bed_of(spheres_of(1), soil_of(), gravity=0.0, skin=WIDE)
    state = state_of(bed, [[0.0, 0.0, RADIUS + 1e-5]], [[0.0, 0.0, -0.2]])
    final, (_, wall_force) = advanced(bed, state, STEPS)
    impulse = float(jnp.sum(wall_force[:, BASE]) * bed.time_step)
    taken = float(bed.spheres.mass[0] * (final.motion.velocity.z[0] + 0.2))
    assert float(final.motion.velocity.z[0]) > 0.1
    assert impulse == pytest.approx(taken, rel=1e-12)


# ------------------------------------------------------------------ another unit of force

TARGET = 0.5  # N, of a press in another unit of force
HEAP = RADIUS * np.array([[0, 0, 1.0], [2.02, 0, 1.0], [1.01, 1.75, 1.0], [1.01, 0.58, 2.65]])


@eqx.filter_jit
def pressed_to_a_force(log_unit):
    """Force and height, and the segment, of samples of four spheres pressed up to a force, then on
    without a target."""
    unit = jnp.exp(log_unit)
    spheres = spheres_of(4)
    soil = soil_of(shear_modulus=1e6 * unit, surface_energy=5.0 * unit, plasticity_ratio=0.3)
    step = bed_of(spheres, soil_of(shear_modulus=1e6, plasticity_ratio=0.3)).time_step
    bed = bed_of(spheres, soil, smoothing=Smoothing())
    bed = eqx.tree_at(lambda b: b.spheres.mass, bed, spheres.mass * unit)
    bed = eqx.tree_at(lambda b: b.time_step, bed, step)
    common = {"platen_speed": 0.02, "servo_width": 0.05 * unit, "damping": 200.0}
    programme = stack(
        [
            cell_segment(
                **common,
                force_target=TARGET * unit,
                tolerance=0.1 * unit,
                duration=1.0,
                platen=jnp.asarray(LOWER),
            ),
            cell_segment(**common, duration=0.01),
        ]
    )
    samples = run(bed, state_of(bed, HEAP), programme, jnp.asarray(50), 400).samples
    return (samples.platen_force, samples.platen_height), samples.segment


@pytest.mark.slow
def test_forces_go_with_the_unit_and_displacements_do_not():
    """Modulus, surface energy, masses and the machine's forces times one factor: nothing moves
    differently, so a force's derivative in the factor's logarithm is the force."""
    pushed = quickly(lambda u, t: jax.jvp(pressed_to_a_force, (u,), (t,), has_aux=True))
    values, slopes, segment = pushed(0.0, 1.0)
    force, height = map(np.asarray, values)
    segment = np.asarray(segment)
    assert set(segment) == {-1, 0, 1}, "both movements ended"
    assert force[segment == 0].max() > 0.8 * TARGET
    assert force[segment == 1].max() > 2 * TARGET
    np.testing.assert_allclose(slopes[0], force, rtol=1e-6, atol=1e-6 * force.max())
    np.testing.assert_allclose(slopes[1], 0.0, atol=1e-9 * height[0])
