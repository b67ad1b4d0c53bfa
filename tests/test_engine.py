"""The engine against mechanics: conservation, closed forms, neighbour lists, restarts.

Beds of one to a few spheres, made by hand, are advanced by `jdem.dynamics.step` or by
`jdem.simulate.run`.  Spheres of one material; what a test does not need is switched off.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.bed import Numerics, build_bed
from jdem.contact import ContactHistory
from jdem.dynamics import LOADED, Command, step
from jdem.fusion import boundaries, once
from jdem.neighbors import ContactList, Demand, Grid, rebuild
from jdem.particles import Motion, Spheres, kinetic_energy
from jdem.simulate import FAR, Segment, run, stack, start
from jdem.smooth import Smoothing
from jdem.soil import SoilParameters
from jdem.vector import Vector
from jdem.walls import BASE, Walls

RADIUS, DENSITY, GRAVITY = 2.5e-3, 2650.0, 9.81
WIDE = 40.0  # mean diameters; a skin that a single sphere does not leave
SHARP = Smoothing.sharp()
STEPS = 3000  # of every single sphere, and CAPACITY of every record: shapes are compiled in
CAPACITY = 64

# Every bed that `ran` advances has four spheres, so one program must serve them all.
simulate = eqx.filter_jit(eqx.debug.assert_max_traces(run, max_traces=1))


# ------------------------------------------------------------------ hand-made beds


def soil_of(**values):
    """Soft, elastic, without rolling resistance and adhesion, unless told otherwise."""
    plain = {
        "restitution": 0.9,
        "surface_energy": 0.0,
        "plasticity_ratio": 1e-6,
        "rolling_friction": 0.0,
        "shear_modulus": 1e6,
        "platen_friction": 0.3,
        "reference_diameter": 2 * RADIUS,
    }
    return SoilParameters(**{**plain, **values})


def spheres_of(count, spread=0.0):
    radius = RADIUS * np.linspace(1 - spread, 1 + spread, count)
    return Spheres(radius, DENSITY * 4 / 3 * np.pi * radius**3)


def bed_of(spheres, soil, *, gravity=GRAVITY, smoothing=SHARP, skin=1.0, **numerics):
    """`skin` is in mean diameters; every list has room for all there is."""
    count, gap = spheres.count, skin * 2 * RADIUS
    grid = Grid(
        shape=(3, 3, 3),
        per_cell=count,
        pairs=count * count,
        wall_contacts=3 * count,
        cell=2.4 * RADIUS + gap,
        skin=gap,
    )
    bed = build_bed(spheres, soil, grid, Numerics(smoothing=smoothing, **numerics))
    return eqx.tree_at(lambda b: b.gravity, bed, jnp.asarray(gravity, bed.time_step.dtype))


def state_of(bed, position, velocity=None, spin=None, mould_radius=FAR):
    """No platen, and a mould only if a radius is given."""
    dtype = bed.time_step.dtype
    zeros = np.zeros_like(position)
    rows = [zeros if given is None else given for given in (velocity, spin)]
    motion = Motion(*(Vector.from_rows(jnp.asarray(r, dtype)) for r in (position, *rows)))
    state = start(bed, motion.position, FAR, mould_radius)
    return eqx.tree_at(lambda s: s.motion, state, motion)


@eqx.filter_jit
def advanced(bed, state, steps, damping=0.0):
    """The motion after each of `steps` steps of one list (the skin must outlast them)."""
    pairs, contacts, _ = rebuild(
        bed.grid, bed.spheres, state.walls, state.motion.position, state.pairs, state.wall_contacts
    )
    state = eqx.tree_at(lambda s: (s.pairs, s.wall_contacts), state, (pairs, contacts))
    zero = jnp.zeros((), bed.time_step.dtype)
    command = Command(zero, zero, zero + damping, zero)

    def advance(state, _):
        state = step(bed, state, command)
        return state, (state.motion, state.wall_force)

    return jax.lax.scan(advance, state, None, length=steps)


def ran(bed, state, samples, steps=100, damping=0.0):
    """The record of a bed left to itself for `samples` intervals of `steps` steps."""
    duration = (samples - 0.25) * steps * bed.time_step
    programme = stack([Segment(duration=duration, damping=damping)])
    record = simulate(bed, state, programme, jnp.asarray(steps), CAPACITY)
    assert not record.overflow_of(bed.grid), record.explain_overflow(bed.grid)
    return record


def last(samples):
    """The last interval that was recorded."""
    row = np.flatnonzero(np.asarray(samples.segment) >= 0)[-1]
    return jax.tree.map(lambda leaf: float(leaf[row]), samples)


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


def slowed(overlap, unloaded):
    """Share of a sphere's sideways speed that one step leaves, pressed into the base (m)."""
    bed = bed_of(spheres_of(1), soil_of(restitution=1.0, platen_friction=0.0), gravity=0.0)
    place, speed = np.array([[0.0, 0.0, RADIUS - overlap]]), np.array([[1e-3, 0.0, 0.0]])
    command = Command(*(jnp.asarray(x) for x in (0.0, 0.0, 0.0, unloaded)))
    state = state_of(bed, place, speed)
    pairs, contacts, _ = rebuild(
        bed.grid, bed.spheres, state.walls, state.motion.position, state.pairs, state.wall_contacts
    )
    state = eqx.tree_at(lambda s: (s.pairs, s.wall_contacts), state, (pairs, contacts))
    after = eqx.filter_jit(step)(bed, state, command)
    share = float(after.motion.velocity.x[0]) / 1e-3
    load = float(after.wall_force[BASE]) / (GRAVITY * float(bed.spheres.mass[0]))
    return share, load, float(bed.time_step)


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
    def kept_apart(x, time):
        with boundaries(time >= 0):
            return compute(x)

    x = jnp.linspace(0, 1, 5)
    apart, plain = kept_apart(x, jnp.asarray(0.0)), compute(x)
    jax.tree.map(np.testing.assert_array_equal, apart, plain)
    slope = jax.jvp(lambda y: kept_apart(y, jnp.asarray(1.0))[1]["a"], (x,), (jnp.ones(5),))[1]
    np.testing.assert_allclose(slope, 2 * x)
    assert once(x) is x


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


def test_the_base_carries_the_weight_of_what_rests_on_it():
    spheres = spheres_of(4)
    bed = bed_of(spheres, cohesive_soil(), smoothing=Smoothing())
    record = ran(bed, state_of(bed, heap()), 60, damping=100.0)
    weight = float(jnp.sum(spheres.mass)) * GRAVITY
    assert last(record.samples).base_force == pytest.approx(weight, rel=1e-3)
    assert last(record.samples).kinetic_energy < 1e-9 * weight * RADIUS
    assert record.state.motion.position.z[3] > 2 * RADIUS  # still on top


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


# ------------------------------------------------------------------ neighbour lists

CLOUD = 60


def cloud(seed, jitter=0.0):
    rng = np.random.default_rng(seed)
    place = rng.uniform([-0.012, -0.012, 0.0], [0.012, 0.012, 0.03], (CLOUD, 3))
    return place + np.random.default_rng(seed + 1).normal(0.0, 1.0, place.shape) * jitter


def cloud_grid(**capacities):
    sizes = {"per_cell": 30, "pairs": 800, "wall_contacts": 120, **capacities}
    return Grid(shape=(4, 3, 5), cell=2 * RADIUS * 1.2 + 1e-3, skin=1e-3, **sizes)


CLOUD_SPHERES = spheres_of(CLOUD, 0.2)
CLOUD_WALLS = Walls(*(jnp.asarray(x) for x in (0.03, 0.0, 0.014, 0.0)))
relisted = eqx.filter_jit(rebuild)


def empty_lists(grid):
    return ContactList.empty(grid.pairs, float), ContactList.empty(grid.wall_contacts, float)


def listed(grid, place, lists):
    return relisted(grid, CLOUD_SPHERES, CLOUD_WALLS, Vector.from_rows(jnp.asarray(place)), *lists)


def entries(contacts):
    """{(first, second): what the history remembers} of the live entries, each listed once."""
    live = np.flatnonzero(contacts.alive)
    history = contacts.history
    columns = (contacts.first, contacts.second, history.max_overlap, history.stretch.z)
    rows = zip(*(np.asarray(column)[live].tolist() for column in columns), strict=True)
    found = {(i, j): (most, stretch) for i, j, most, stretch in rows}
    assert len(found) == len(live)
    return found


def pairs_by_force(place, reach):
    radius = np.asarray(CLOUD_SPHERES.radius)
    distance = np.linalg.norm(place[:, None] - place[None], axis=-1)
    near = distance < radius[:, None] + radius[None] + reach
    return {(i, j) for i in range(CLOUD) for j in range(i + 1, CLOUD) if near[i, j]}


def walls_by_force(place, reach):
    off_axis = np.hypot(place[:, 0], place[:, 1])
    distance = np.stack([place[:, 2], 0.03 - place[:, 2], 0.014 - off_axis], axis=1)
    near = distance - np.asarray(CLOUD_SPHERES.radius)[:, None] < reach
    return {(int(i), int(w)) for i, w in np.argwhere(near)}


def mark_of(first, second):
    return 1.0 + 1000 * first + second


def marked(contacts):
    """Each entry remembers its own key."""
    mark = mark_of(contacts.first, contacts.second) * contacts.alive
    history = ContactHistory(mark, -mark, Vector(mark, mark, -mark))
    return eqx.tree_at(lambda c: c.history, contacts, history)


@pytest.mark.parametrize("seed", range(5))
def test_lists_hold_all_neighbours_and_history_travels_with_them(seed):
    grid = cloud_grid()
    before, after = cloud(seed), cloud(seed, jitter=1e-3)
    lists = [marked(c) for c in listed(grid, before, empty_lists(grid))[:2]]
    relists = listed(grid, after, lists)
    for old, new, brute in zip(lists, relists, (pairs_by_force, walls_by_force), strict=False):
        were, are = entries(old), entries(new)
        assert set(were) == brute(before, grid.skin)
        assert set(are) == brute(after, grid.skin)
        kept = were.keys() & are.keys()
        assert 10 < len(kept) < len(are)
        for key, remembered in are.items():
            mark = mark_of(*key) if key in kept else 0.0
            assert remembered == (mark, -mark)


def test_a_sphere_may_leave_the_grid():
    """Space is wrapped around the grid: far away, and across zero, neighbours are the same."""
    grid, shift = cloud_grid(), np.array([3.7, -8.1, 40.0])
    found = listed(grid, cloud(0) + shift, empty_lists(grid))[0]
    assert set(entries(found)) == pairs_by_force(cloud(0), grid.skin)


@pytest.mark.parametrize("names", [("pairs", "wall_contacts"), ("per_cell",)])
def test_an_overflow_is_detected_with_the_capacity_that_would_do(names):
    small = cloud_grid(**dict.fromkeys(names, 3))
    demand = listed(small, cloud(0), empty_lists(small))[2]
    assert demand.exceeds(small)
    needed = {name: int(getattr(demand, name)) for name in names}
    for name, capacity in needed.items():
        assert capacity > 3
        assert demand.exceeds(cloud_grid(**{**needed, name: capacity - 1}))
    enough = cloud_grid(**needed)
    pairs, contacts, demand = listed(enough, cloud(0), empty_lists(enough))
    assert not demand.exceeds(enough)
    assert set(entries(pairs)) == pairs_by_force(cloud(0), enough.skin)
    assert set(entries(contacts)) == walls_by_force(cloud(0), enough.skin)


def test_an_overflowing_list_keeps_only_true_neighbours():
    small = cloud_grid(pairs=20)
    pairs = listed(small, cloud(0), empty_lists(small))[0]
    assert len(entries(pairs)) == 20
    assert set(entries(pairs)) <= pairs_by_force(cloud(0), small.skin)


def test_rebuilding_twice_changes_nothing():
    grid = cloud_grid()
    once = [marked(c) for c in listed(grid, cloud(3), empty_lists(grid))[:2]]
    again = listed(grid, cloud(3), once)[:2]
    for a, b in zip(jax.tree.leaves(once), jax.tree.leaves(list(again)), strict=True):
        assert np.array_equal(a, b)


def test_the_record_says_which_capacity_or_skin_was_too_small():
    bed = bed_of(spheres_of(4), soil_of())
    fast = state_of(bed, heap(raised=0.1), np.full((4, 3), 10.0))
    record = simulate(bed, fast, stack([Segment()]), jnp.asarray(100), CAPACITY)
    assert record.overflow_of(bed.grid)
    assert "motion between rebuilds" in record.explain_overflow(bed.grid)
    assert not Demand.none().exceeds(bed.grid)


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
    change = jax.tree.map(lambda a, b: abs(float(a - b)), later.energy, settled.energy)
    assert max(jax.tree.leaves(change)) < 1e-6 * weight * RADIUS


# ------------------------------------------------------------------ programs and precision


def test_new_parameter_values_do_not_compile_anew():
    for values in ({}, {"restitution": 0.6}, {"surface_energy": 3.0, "tensile_exponent": 5.0}):
        bed = bed_of(spheres_of(4), cohesive_soil(**values), smoothing=Smoothing())
        ran(bed, state_of(bed, heap()), 2 + len(values), 10)  # raises if traced a second time


def test_a_batch_of_soils_runs_as_each_alone():
    soils = [cohesive_soil(), cohesive_soil(surface_energy=3.0, static_friction=0.4)]
    beds = [bed_of(spheres_of(4), soil, smoothing=Smoothing()) for soil in soils]
    starts = [state_of(bed, heap()) for bed in beds]
    segments = [stack([Segment(duration=400.5 * bed.time_step)]) for bed in beds]
    many = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *zip(beds, starts, segments, strict=True)
    )
    batch = eqx.filter_vmap(lambda b, s, p: run(b, s, p, jnp.asarray(100), CAPACITY))
    together = eqx.filter_jit(batch)(*many)
    for k, one in enumerate(zip(beds, starts, segments, strict=True)):
        alone = simulate(*one, jnp.asarray(100), CAPACITY)
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
