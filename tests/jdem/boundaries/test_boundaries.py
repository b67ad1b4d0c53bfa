"""What every kind of boundary owes, alone; and what a spun or driven one does to spheres.

The distance falls as the normal says, surfaces move as `moved` says, what is removed is far,
what is lowered touches; forces, torques and work balance.  A sphere as a boundary is pressed on a
single particle and into a bed.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.boundaries.base import DOWN, FAR, UP, Rates, along, point
from jdem.boundaries.composite import (
    BASE,
    FORCE,
    KINDS,
    MOULD,
    PLATEN,
    TORQUE,
    cell,
    driven,
    effective_radius,
    nearest,
    resistances,
)
from jdem.boundaries.plane import Plane
from jdem.boundaries.sphere import Sphere
from jdem.core.vector import Vector
from jdem.engine.loop import begun, run
from jdem.engine.segment import LOWER, Segment, cell_segment, stack
from tests.support.hand_made_beds import (
    CAPACITY,
    RADIUS,
    advanced,
    bed_of,
    soil_of,
    spheres_of,
    state_of,
)

pytestmark = pytest.mark.thorough

TILTED = (0.6, 0.0, 0.8)
CENTRE = np.array([0.2, -0.1, 0.3])
RATES = Rates(*map(jnp.asarray, (0.3, 2.0, 0.1)))

AXES = [UP, DOWN, TILTED]
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
every_axis = pytest.mark.parametrize("axis", AXES)


def made(kind, axis):
    """About CENTRE, of a size of 0.2 m, moving in all its ways."""
    return kind.at(point(*CENTRE, float), axis, 0.2).driven(RATES)


def around(boundary, count=20):
    """Points on the soil's side of a boundary."""
    places = CENTRE + np.random.default_rng(1).uniform(-0.3, 0.3, (count * 20, 3))
    vectors = Vector.from_rows(jnp.asarray(places))
    chosen = places[np.asarray(boundary.distance(vectors)) > 0.01][:count]
    assert len(chosen) == count
    return Vector.from_rows(jnp.asarray(chosen))


@every_kind
@every_axis
def test_the_normal_is_the_slope_of_the_distance(kind, axis):
    boundary = made(kind, axis)
    position = around(boundary)
    surface = boundary.surface(position)
    np.testing.assert_allclose(surface.distance, boundary.distance(position), rtol=1e-14)
    slope = jax.vmap(jax.grad(boundary.distance))(position).stack()
    normal = jnp.broadcast_to(surface.normal.stack(), slope.shape)
    np.testing.assert_allclose(normal, slope, atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, rtol=1e-13)


@every_kind
@every_axis
def test_the_surface_moves_as_the_boundary_does(kind, axis):
    """The distance of a resting point changes by minus the normal velocity; a spin alone moves
    no surface along its normal."""
    boundary = made(kind, axis)
    position, step = around(boundary), 1e-7
    surface = boundary.surface(position)
    later = boundary.moved(jnp.asarray(step)).distance(position)
    rate = (later - surface.distance) / step
    np.testing.assert_allclose(rate, -surface.velocity.dot(surface.normal), atol=1e-6)
    farthest = np.abs(later - surface.distance).max()
    travelled = boundary.moved(jnp.asarray(step)).travelled(boundary)
    assert float(travelled) >= farthest * (1 - 1e-6)


@every_kind
@every_axis
def test_a_spin_turns_the_surface_about_the_axis(kind, axis):
    boundary = made(kind, axis)
    still = boundary.driven(Rates(*map(jnp.asarray, (0.3, 0.0, 0.1))))
    position = around(boundary)
    surface = boundary.surface(position)
    spun = surface.velocity - still.surface(position).velocity
    touched = position - surface.normal * surface.distance
    arm = (touched - boundary.reference).stack()
    expected = np.cross(np.array(axis) * 2.0, arm)
    np.testing.assert_allclose(spun.stack(), expected, atol=1e-13)


@every_kind
def test_what_is_removed_is_far_and_what_is_lowered_touches(kind):
    boundary = made(kind, UP)
    position, radius = around(boundary), jnp.linspace(0.001, 0.02, 20)
    assert float(boundary.removed().distance(position).min()) > 0.5 * FAR
    gap = boundary.touching(position, radius).distance(position) - radius
    assert float(gap.min()) == pytest.approx(0.0, abs=1e-14)
    listed = boundary.near(position, radius, 0.1)
    np.testing.assert_array_equal(listed, boundary.distance(position) - radius < 0.1)


def test_each_contact_sees_its_own_boundary():
    boundaries = cell(0.1, 0.03, float)
    position = Vector.from_rows(jnp.asarray([[0.01, 0.02, 0.04]] * 3))
    surface = nearest(boundaries, jnp.arange(3), position)
    off_axis = np.hypot(0.01, 0.02)
    np.testing.assert_allclose(surface.distance, [0.04, 0.06, 0.03 - off_axis])
    np.testing.assert_allclose(surface.normal.z, [1.0, -1.0, 0.0])
    single = nearest(boundaries[:1], jnp.zeros(3, int), position)
    assert single.normal.x.shape == (3,)


# ------------------------------------------------------------------ spheres on moving boundaries


def resting(soil, spheres=1, **given):
    """Spheres pressed a little into the base of a bed without gravity."""
    bed = bed_of(spheres_of(spheres), soil, gravity=0.0, skin=20.0, **given)
    x = 4 * RADIUS * np.arange(spheres) + 3 * RADIUS
    places = np.stack([x, 0 * x, 0 * x + RADIUS - 1e-6], axis=1)
    return bed, state_of(bed, places)


@eqx.filter_jit
def ran(bed, state, segment, steps):
    return run(bed, state, stack([segment]), steps, CAPACITY)


def running(bed, state, segment, steps):
    """One program serves every bed of one sphere, whatever its segment and steps of a sample."""
    return ran(bed, state, segment, jnp.asarray(steps))


def test_a_spun_base_carries_a_sphere_along_and_feels_its_torque():
    """Impulse and angular impulse on the base are those that the sphere lost; work is booked."""
    soil = soil_of(platen_friction=0.5, restitution=0.5)
    bed, state = resting(soil)
    spin = jnp.zeros(3).at[BASE].set(3.0)
    segment = Segment(spin=spin, duration=300 * bed.time_step)
    record = running(bed, state, segment, 10)
    assert not record.overflow_of(bed.grid)
    final = record.state
    rows = np.flatnonzero(np.asarray(record.samples.segment) >= 0)
    elapsed = np.diff(np.asarray(record.samples.time)[rows], prepend=0.0)
    impulse = np.einsum("i,ij->j", elapsed, np.asarray(record.samples.loads)[rows, BASE])
    mass, inertia = (float(x[0]) for x in (bed.spheres.mass, bed.spheres.inertia))
    velocity, spins = (np.asarray(v.stack())[0] for v in (final.motion.velocity, final.motion.spin))
    place = np.asarray(state.motion.position.stack())[0]
    assert velocity[1] > 1e-3  # it is carried round
    np.testing.assert_allclose(impulse[:3], -mass * velocity, rtol=1e-9, atol=1e-12)
    angular = np.cross(place, mass * velocity) + inertia * spins
    # The arm is taken at its place at each step; it has moved by about 1e-3 of it.
    np.testing.assert_allclose(impulse[3:6], -angular, rtol=1e-2, atol=1e-9)
    ledger = final.energy
    assert abs(float(ledger.boundaries[BASE])) > 1e-9
    kinetic = 0.5 * mass * velocity @ velocity + 0.5 * inertia * spins @ spins
    error = float(ledger.supplied() - ledger.absorbed()) - kinetic
    assert abs(error) < 1e-12 * float(jnp.abs(ledger.boundaries).sum())


@pytest.mark.slow
def test_a_servo_holds_a_torque():
    """Platen and base turn against each other on spheres between them until the torque is there."""
    soil = soil_of(platen_friction=0.8, restitution=0.3, rolling_friction=0.5)
    bed = bed_of(spheres_of(4), soil, gravity=0.0, skin=20.0)
    turns = np.linspace(0, 2 * np.pi, 5)[:4]
    places = [[5 * RADIUS * np.cos(t), 5 * RADIUS * np.sin(t), RADIUS - 1e-5] for t in turns]
    state = state_of(bed, np.array(places))
    state = eqx.tree_at(lambda s: s.boundaries, state, cell(2 * RADIUS - 2e-5, FAR, float))
    target = 1e-3  # N m
    segment = Segment(
        spin=jnp.zeros(3).at[PLATEN].set(0.5),
        servo=PLATEN,
        component=TORQUE,
        force_target=target,
        servo_width=2e-4,
        tolerance=2e-5,
        damping=2000.0,
        duration=1.0,
    )
    record = running(bed, state, segment, 20)
    last = int(np.flatnonzero(np.asarray(record.samples.segment) >= 0)[-1])
    assert bool(record.finished)
    assert float(record.samples.reading[last]) == pytest.approx(target, abs=2e-5)
    table = resistances(record.state.boundaries, record.state.loads)
    assert float(table[TORQUE, PLATEN]) == pytest.approx(target, rel=0.05)
    # What turns the platen one way turns the base the other: axes point at each other.
    assert float(table[TORQUE, BASE]) == pytest.approx(target, rel=0.05)


@pytest.mark.parametrize(("response", "calm"), [(5e-4, True), (0.0, False)])
def test_a_drive_that_follows_at_once_swings_from_step_to_step(response, calm):
    """The dashpots of a sphere answer the platen's speed v with C v: where C exceeds width/v
    the force alternates between two values, unless the drive takes time."""
    bed = bed_of(spheres_of(1), soil_of(restitution=0.2), gravity=0.0, skin=20.0)
    state = state_of(bed, [[0.0, 0.0, RADIUS]])
    state = eqx.tree_at(lambda s: s.boundaries, state, cell(2 * RADIUS, FAR, float))
    servo = {"force_target": 0.25, "servo_width": 0.04, "response": response}
    segment = cell_segment(platen_speed=0.2, damping=500.0, duration=1.0, **servo)
    samples = running(bed, state, segment, 1).samples
    force = np.asarray(samples.platen_force)[np.asarray(samples.segment) >= 0][-40:]
    swing = np.abs(np.diff(force)).max()
    assert (swing < 0.005) == calm and (swing > 0.05) != calm


def test_any_boundary_can_be_driven():
    """The base, pushed up against a sphere under the platen by a servo on its own force."""
    bed = bed_of(spheres_of(1), soil_of(restitution=0.3), gravity=0.0, skin=20.0)
    state = state_of(bed, [[0.0, 0.0, RADIUS]])
    state = eqx.tree_at(lambda s: s.boundaries, state, cell(2 * RADIUS, FAR, float))
    segment = Segment(
        speed=jnp.zeros(3).at[BASE].set(0.01),
        servo=BASE,
        component=FORCE,
        force_target=0.2,
        servo_width=0.02,
        tolerance=2e-3,
        damping=500.0,
        duration=1.0,
    )
    record = running(bed, state, segment, 20)
    assert bool(record.finished)
    force = resistances(record.state.boundaries, record.state.loads)[FORCE]
    assert float(force[BASE]) == pytest.approx(0.2, rel=0.05)
    assert float(force[PLATEN]) == pytest.approx(0.2, rel=0.1)


def test_a_bed_may_stand_in_other_boundaries_than_the_cell():
    """Two planes that meet at right angles; background damping follows nobody."""
    soil = soil_of(restitution=0.3)
    bed = bed_of(spheres_of(1), soil, skin=20.0, surfaces=("platen", "mould"), follows=None)
    origin = point(0, 0, 0, float)
    corner = (Plane.at(origin, UP), Plane.at(origin, (1.0, 0.0, 0.0)))
    place = Vector.from_rows(jnp.asarray([[1.01 * RADIUS, 0.0, 1.01 * RADIUS]]))
    state = begun(bed, place, corner)
    state = eqx.tree_at(lambda s: s.motion.velocity.x, state, jnp.asarray([-0.01]))
    final, _ = advanced(bed, state, 3000, 100.0)
    assert final.loads.shape == (2, 7)
    weight = float(bed.spheres.mass[0]) * 9.81
    assert float(final.loads[0, 2]) == pytest.approx(-weight, rel=1e-2)
    assert float(final.motion.position.x[0]) >= 0.999 * RADIUS


def test_the_cell_is_moved_by_the_machine_as_it_was():
    """Platen downward, mould outward, and both where they are put first."""
    segment = cell_segment(platen_speed=0.1, mould_speed=0.02)
    rates = jnp.stack([segment.speed, segment.spin, segment.growth])
    after = [b.moved(jnp.asarray(0.5)) for b in driven(cell(0.1, 0.03, float), rates)]
    assert float(after[PLATEN].reference.z) == pytest.approx(0.05)
    assert float(after[MOULD].size) == pytest.approx(0.04)
    assert float(after[BASE].reference.z) == 0.0
    assert float(along(after[PLATEN].axis, after[PLATEN].reference)) == pytest.approx(-0.05)


INDENTER = 6e-3  # m, its radius
SURFACES = ("platen", "platen")
pressing = eqx.filter_jit(run)


def between(base_height, indenter_centre):
    """A base, and the indenter above it, its axis downward."""
    base = Plane.at(point(0, 0, base_height, float), UP)
    return base, Sphere.at(point(*indenter_centre, float), DOWN, INDENTER)


def bed_with(places, boundaries, **values):
    count = len(places)
    soil = soil_of(**{"platen_friction": 0.0, **values})
    numerics = {"skin": 20.0, "surfaces": SURFACES, "follows": None}
    bed = bed_of(spheres_of(count), soil, gravity=0.0, **numerics)
    return bed, begun(bed, Vector.from_rows(jnp.asarray(places)), boundaries)


def test_one_particle_under_it_carries_the_closed_form():
    """Base, particle and indenter on one line: k1(r) d_b = k1(R*) d_i, k1 = 2 E* R*."""
    pressed = 2e-5
    height = 2 * RADIUS + INDENTER - pressed
    bed, state = bed_with([[0.0, 0.0, RADIUS]], between(0.0, (0.0, 0.0, height)), restitution=0.3)
    final, _ = advanced(bed, state, 3000, 200.0)
    stiffness = bed.wall_law.normal.stiffness.normal
    own = effective_radius(jnp.asarray(RADIUS), jnp.asarray(1 / INDENTER))
    assert float(own) == pytest.approx(RADIUS * INDENTER / (RADIUS + INDENTER))
    springs = float(stiffness(jnp.asarray(RADIUS))), float(stiffness(own))
    expected = pressed / (1 / springs[0] + 1 / springs[1])
    force = resistances(final.boundaries, final.loads)[FORCE]
    np.testing.assert_allclose(force, expected, rtol=1e-6)
    np.testing.assert_allclose(final.loads.sum(axis=0)[:3], 0.0, atol=1e-6 * expected)


@pytest.mark.slow
def test_forces_and_torques_balance_off_its_axis():
    """A particle under its flank, rough and spun against: what indenter and base feel is what the
    particle's motion lost, also as torque about one point."""
    place = np.array([2e-3, 0.0, RADIUS])
    height = RADIUS + np.sqrt((RADIUS + INDENTER) ** 2 - 4e-6) - 5e-6
    boundaries = between(0.0, (0.0, 0.0, height))
    spun = (boundaries[0], boundaries[1].driven(Rates(*map(jnp.asarray, (0.0, 5.0, 0.0)))))
    bed, state = bed_with([place], spun, platen_friction=0.6)
    rates = jnp.zeros((3, 2)).at[1, 1].set(5.0)
    programme = stack([Segment(*rates, jnp.zeros(2, int), duration=20 * bed.time_step)])
    record = pressing(bed, state, programme, jnp.asarray(1), CAPACITY)
    rows = np.flatnonzero(np.asarray(record.samples.segment) >= 0)
    loads = np.asarray(record.samples.loads)[rows] * float(bed.time_step)
    centres = np.asarray(record.samples.reference)[rows]
    motion = record.state.motion
    velocity, spin, now = (
        np.asarray(v.stack())[0] for v in (motion.velocity, motion.spin, motion.position)
    )
    mass, inertia = float(bed.spheres.mass[0]), float(bed.spheres.inertia[0])
    np.testing.assert_allclose(loads[..., :3].sum(axis=(0, 1)), -mass * velocity, rtol=1e-9)
    torque = loads[..., 3:6] + np.cross(centres, loads[..., :3])
    angular = np.cross(now, mass * velocity) + inertia * spin
    scale = np.abs(torque).sum()
    assert np.abs(torque.sum(axis=(0, 1)) + angular).max() < 1e-3 * scale
    assert abs(float(record.state.loads[1, 5])) > 0  # it is braked


@pytest.mark.slow
def test_a_servo_presses_it_into_a_bed():
    """Lowered onto the highest of four particles, then to a force; the base carries it."""
    ring = [[2.2 * RADIUS * np.cos(a), 2.2 * RADIUS * np.sin(a), RADIUS] for a in (0.5, 2.6, 4.7)]
    places = [*ring, [0.0, 0.0, 2.6 * RADIUS]]
    boundaries = between(0.0, (0.0, 0.0, 0.1))
    values = {"platen_friction": 0.6, "restitution": 0.3, "static_friction": 0.6}
    bed, state = bed_with(places, boundaries, **values)
    press = Segment(
        speed=jnp.asarray([0.0, 0.05]),
        spin=jnp.zeros(2),
        growth=jnp.zeros(2),
        placed=jnp.asarray([0, LOWER]),
        servo=1,
        component=FORCE,
        force_target=0.5,
        servo_width=0.05,
        tolerance=5e-3,
        damping=1000.0,
        duration=1.0,
    )
    record = pressing(bed, state, stack([press]), jnp.asarray(50), CAPACITY)
    last = int(np.flatnonzero(np.asarray(record.samples.segment) >= 0)[-1])
    assert bool(record.finished)
    assert float(record.samples.reading[last]) == pytest.approx(0.5, abs=5e-3)
    base = float(record.samples.loads[last, 0, 2])
    assert base == pytest.approx(-0.5, rel=0.1)
    top = float(record.samples.reference[0, 1, 2])
    assert top == pytest.approx(3.6 * RADIUS + INDENTER, rel=0.01)
