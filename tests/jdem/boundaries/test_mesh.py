"""Triangle meshes as boundaries: planes in triangles, edges and vertices, bodies that move, files.

A tessellated plane is the plane.  Convex bodies touch a sphere once, whatever is closest; concave
corners act twice.  `data/mesh_curves.npz` holds forces of LIGGGHTS 3.8.0 on a sphere that is led
over a roof, into a valley, over steps, an apex and slight kinks (`data/README.md`).
"""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import UP, Rates, point
from jdem.boundaries.composite import about_references, power
from jdem.boundaries.cylinder import Cylinder
from jdem.boundaries.mesh import Mesh
from jdem.boundaries.plane import Plane
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.loads import Loads, wall_loads
from jdem.engine.loop import begun, run
from jdem.engine.neighbors import Grid, rebuild
from jdem.engine.segment import LOWER, Segment, placed, stack
from jdem.engine.state import Bed
from jdem.materials.contact_laws import CONTACT_LAWS, Stated
from tests import DATA
from tests.support.hand_made_beds import quickly

pytestmark = pytest.mark.thorough

RADIUS, DENSITY, YOUNG, POISSON = 3e-3, 2650.0, 1e7, 0.3  # those of LIGGGHTS' curves
MODULUS = YOUNG / 2 / (1 - POISSON**2)
TIME_STEP = 2e-6
SKIN = 0.1 * RADIUS
KEPT = np.load(DATA / "mesh_curves.npz")
SHAPES = json.loads(str(KEPT["shapes"]))


def hertz(distance):
    """Force (N) of a sphere on a flat wall, an edge or a vertex, 4/3 E* sqrt(R) d^1.5."""
    return 4 / 3 * MODULUS * np.sqrt(RADIUS) * np.maximum(RADIUS - distance, 0.0) ** 1.5


def bed_of(count, boundaries, *, friction=0.0, restitution=1.0, gravity=0.0, faces=128, each=8):
    """Spheres on Hertz-Mindlin walls, with room for `each` contacts; pairs are not listed."""
    values = {"static_friction": friction, "restitution": restitution}
    law = CONTACT_LAWS["hertz_mindlin"].law(Stated(YOUNG, POISSON, values, {}, Smoothing.sharp()))
    radius = np.full(count, RADIUS)
    return Bed(
        spheres=Spheres(radius, DENSITY * 4 / 3 * np.pi * radius**3),
        particle_law=law,
        wall_law=law,
        friction=friction,
        wall_friction=jnp.full(boundaries, friction),
        time_step=TIME_STEP,
        roll_width=0.0,
        gravity=gravity,
        grid=Grid(
            shape=(3, 3, 3),
            per_cell=1,
            pairs=1,
            wall_contacts=-(-each * count // 128) * 128,
            cell=2.1 * RADIUS + SKIN,
            skin=SKIN,
            faces=faces,
        ),
        surfaces=("platen",) * boundaries,
        follows=None,
    )


def vector(rows):
    return Vector.from_rows(jnp.asarray(rows, float))


@quickly
def lists(bed, boundaries, places):
    state = begun(bed, places, boundaries)
    return rebuild(bed.grid, bed.spheres, boundaries, places, state.pairs, state.wall_contacts)


@quickly
def loads(bed, boundaries, places, motion, contacts):
    """Loads of each sphere and on boundaries, where spheres have velocities and spins."""
    state = begun(bed, places, boundaries)
    state = eqx.tree_at(lambda s: (s.motion.velocity, s.motion.spin), state, motion)
    rows = bed.spheres.rows(state.motion)
    none = Loads(jnp.zeros((bed.spheres.count, 8)), jnp.zeros(4), jnp.zeros(()))
    found, _, felt = wall_loads(bed, rows, boundaries, contacts, none)
    return found, felt


def pressed(boundaries, places, motion=None, **given):
    """Loads of spheres at places (count, 3) that do not see each other."""
    bed = bed_of(len(places), len(boundaries), **given)
    contacts = lists(bed, boundaries, vector(places))[1]
    still = (vector(np.zeros_like(places)),) * 2
    return loads(bed, boundaries, vector(places), motion or still, contacts)


def forces(mesh, places):
    return np.asarray(pressed((mesh,), np.asarray(places, float))[0].rows[:, :3])


def grid_of(cells, jitter=0.0, half=0.03):
    """A plane z = 0 in 2 cells^2 triangles; its inner vertices are moved at random."""
    rng, side = np.random.default_rng(1), np.linspace(-half, half, cells + 1)
    place = np.stack([*np.meshgrid(side, side, indexing="ij"), np.zeros([cells + 1] * 2)], -1)
    place[1:-1, 1:-1, :2] += (
        rng.uniform(-1, 1, (cells - 1, cells - 1, 2)) * jitter * (side[1] - side[0])
    )
    a, b, c, d = place[:-1, :-1], place[1:, :-1], place[1:, 1:], place[:-1, 1:]
    ways = [np.stack([[a, b, c], [a, c, d]]), np.stack([[a, b, d], [b, c, d]])]
    chosen = rng.random((cells, cells)) < (0.5 if jitter else 2.0)
    both = np.where(chosen[..., None], *ways)
    return np.moveaxis(both, (0, 1), (2, 3)).reshape(-1, 3, 3)


def shell(name, **given):
    return Mesh.from_triangles(KEPT[f"corners/{name}"], two_sided=True, **given)


def sometimes(name: str, *always: str):
    """A case of `make test-slow`, but for some: each mesh compiles a program of its own."""
    return pytest.param(name, marks=() if name in always else pytest.mark.slow)


PLANES = {
    "2": grid_of(1),
    "288 regular": grid_of(12),
    "288 irregular": grid_of(12, 0.3),
    "5000": grid_of(50, 0.25),
}
FLOOR = Plane.at(point(0, 0, 0, float), UP)


@pytest.mark.parametrize("name", [sometimes(name, "2", "288 irregular") for name in PLANES])
def test_a_tessellated_plane_is_the_plane(name):
    """Anywhere, above edges and vertices too, with friction, on both sides of the shell."""
    corners, rng = PLANES[name], np.random.default_rng(0)
    mesh = Mesh.from_triangles(corners, two_sided=True)
    assert (mesh.parts, mesh.faces) == (1, len(corners))
    inner = corners[np.abs(corners).max(axis=(1, 2)) < 0.02].reshape(-1, 3)
    chosen = inner[rng.choice(len(inner), 60)] if len(inner) else np.zeros((60, 3))
    middles = 0.5 * (chosen[:30] + chosen[30:])
    places = np.concatenate([chosen[:30], middles, rng.uniform(-0.02, 0.02, (60, 3))])
    places[:, 2] = RADIUS * (1 - rng.uniform(-1e-3, 1e-2, 120))
    motion = (vector(rng.normal(size=(120, 3))), vector(rng.normal(size=(120, 3)) * 300))
    given = {"friction": 0.3, "restitution": 0.5}
    plane, on_plane = pressed((FLOOR,), places, motion, **given)
    found, felt = pressed((mesh,), places, motion, **given)
    largest = np.abs(plane.rows).max()
    np.testing.assert_allclose(found.rows, plane.rows, atol=1e-12 * largest)
    np.testing.assert_allclose(felt, on_plane, atol=1e-12 * np.abs(on_plane).max())
    below = forces(mesh, places * [1, 1, -1])
    np.testing.assert_allclose(below, forces(FLOOR, places) * [1, 1, -1], atol=1e-12 * largest)


simulated = eqx.filter_jit(run)


def moved_by(bed, boundaries, place, velocity, duration, spin=0.0, every=500):
    """What is left of one sphere after a time (s) of the last boundary's spin (rad/s)."""
    state = begun(bed, vector([place]), boundaries)
    state = eqx.tree_at(lambda s: s.motion.velocity, state, vector([velocity]))
    none = jnp.zeros(len(boundaries))
    segment = Segment(
        speed=none,
        spin=none.at[-1].set(spin),
        growth=none,
        placed=jnp.zeros(len(boundaries), int),
        servo=0,
        duration=duration,
    )
    record = simulated(bed, state, stack([segment]), jnp.asarray(every), 150)
    assert not record.overflow_of(bed.grid), record.explain_overflow(bed.grid)
    assert record.finished
    motion = record.state.motion
    parts = (motion.position, motion.velocity, motion.spin)
    return [np.asarray(part.stack())[0] for part in parts], record


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "place", "velocity"),
    [
        ("288 irregular", [-0.012, 0.0013, RADIUS], [0.25, 0.03, 0.0]),
        ("288 regular", [-0.0125, 0.0, RADIUS], [0.25, 0.0, 0.0]),
    ],
    ids=["across edges", "along edges and through vertices"],
)
def test_a_sphere_slides_and_rolls_on_it_as_on_the_plane(name, place, velocity):
    """At last with 5/7 of its first speed; the lists are rebuilt on the way."""
    mesh = Mesh.from_triangles(PLANES[name], two_sided=True)
    bed = bed_of(1, 1, friction=0.3, restitution=0.3, gravity=9.81)
    found, _ = moved_by(bed, (mesh,), place, velocity, 0.06)
    expected, _ = moved_by(bed, (FLOOR,), place, velocity, 0.06)
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-13)
    assert np.linalg.norm(found[1]) == pytest.approx(5 / 7 * np.linalg.norm(velocity), rel=1e-3)


# ------------------------------------------------------------------------ edges and vertices


def test_a_roof_is_its_faces_and_its_edge():
    """Right above the edge too, where both faces and the edge are at the same distance."""
    x = np.concatenate([np.linspace(-1e-3, 1e-3, 41), np.zeros(5)])
    y = np.linspace(-0.01, 0.012, len(x))
    height = 0.995 * RADIUS - np.abs(x)
    found = forces(shell("roof_90"), np.stack([x, y, height], 1))
    distance = np.hypot(x, height)  # |x| < z, so the edge is closest
    expected = hertz(distance)[:, None] * np.stack([x, 0 * x, height], 1) / distance[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_a_valley_acts_with_both_walls():
    x = np.linspace(-2e-5, 2e-5, 11)
    height = np.full_like(x, np.sqrt(2) * 0.995 * RADIUS)
    found = forces(shell("valley_90"), np.stack([x, 0 * x, height], 1))
    left, right = hertz((height + x) / np.sqrt(2)), hertz((height - x) / np.sqrt(2))
    expected = np.stack([left - right, 0 * x, left + right], 1) / np.sqrt(2)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_an_apex_is_a_point():
    """Four patches meet there; it acts once, along the axis and off it."""
    x = np.linspace(-1e-3, 1e-3, 11)
    places = np.stack([x, 0.5 * x, 0.99 * RADIUS - x * x / RADIUS], 1)
    places = np.concatenate([places, [[0, 0, 0.995 * RADIUS]]])
    distance = np.linalg.norm(places, axis=1, keepdims=True)
    expected = hertz(distance) * places / distance
    found = forces(shell("pyramid"), places)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


CUBE = Mesh.at(point(0, 0, 0, float), UP, 0.01)


def test_a_convex_body_touches_once_wherever_its_faces_meet():
    """A cube about which spheres stand at faces, edges, vertices, and at what divides these."""
    half, rng = 5e-3, np.random.default_rng(2)
    near = rng.choice([-half, half], (300, 3))
    inside = rng.random((300, 3)) < 0.4
    near = np.where(inside, rng.uniform(-half, half, near.shape), near)
    near[inside.all(axis=1), 0] = half
    outward = np.where(np.abs(near) == half, np.sign(near) * rng.random(near.shape), 0.0)
    outward[:100] = np.where(rng.random((100, 3)) < 0.4, 0.0, outward[:100])  # on what divides
    kept = np.abs(near + outward * 1e-6).max(axis=1) > half
    near, outward = near[kept], outward[kept]
    normal = outward / np.linalg.norm(outward, axis=1, keepdims=True)
    distance = RADIUS * (1 - rng.uniform(0, 1e-2, (len(near), 1)))
    expected = hertz(distance) * normal
    found = forces(CUBE, near + normal * distance)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert np.abs(forces(CUBE, near - normal * 1e-4)).max() == 0.0  # from within, nothing


def test_the_far_side_of_a_thin_plate_is_not_felt():
    thin = CUBE.form.corners * [1.0, 1.0, 0.02]
    mesh = Mesh.from_triangles(thin)
    places = np.array([[1e-3, 2e-4, 1e-4 + 0.995 * RADIUS], [0, 0, -1e-4 - 0.995 * RADIUS]])
    expected = hertz(0.995 * RADIUS) * np.array([[0, 0, 1], [0, 0, -1]])
    np.testing.assert_allclose(forces(mesh, places), expected, atol=1e-12)


# LIGGGHTS goes on counting the edge while the sphere stands above a face beside it: within the
# contact's radius of a convex edge, and of a concave one outside of what touches both faces.
# Right above a concave edge, where a face ends, one or both may count.
DOUBLED = {  # from x to x, m
    "over_step": (-1e-3, 1e-12),
    "kink_convex_1deg": (-1e-3, 1e-12),
    "kink_convex_10deg": (-1e-3, 1e-12),
    "kink_concave_1deg": (-1e-3, 1e-12),
    "kink_concave_10deg": (-1e-12, 1e-12),
}


@pytest.mark.parametrize(
    "name", [sometimes(name, "over_apex", "kink_convex_10deg", "over_step") for name in SHAPES]
)
def test_forces_are_those_of_liggghts_where_it_counts_once(name):
    mesh = shell(SHAPES[name], smooth_below=0.1)
    rows = KEPT[f"curves/{name}"]
    low, high = DOUBLED.get(name, (0.0, 0.0))
    found, expected = forces(mesh, rows[:, :3]), rows[:, 3:]
    compared = (rows[:, 0] <= low) | (rows[:, 0] >= high)
    touching = np.abs(expected[compared]).max(axis=1) > 0
    assert touching.sum() > 1
    largest = np.abs(expected[compared]).max()
    np.testing.assert_allclose(found[compared], expected[compared], atol=5e-5 * largest)


def test_what_touches_both_sides_of_a_slight_kink_touches_a_patch_once():
    """One contact with a patch, of the closest of its faces; two where the kink divides patches."""
    places = [[-0.99 * RADIUS * np.tan(np.radians(5)), 0.0, 0.99 * RADIUS]]  # in the middle
    once, twice = (shell("kink_concave_10deg", smooth_below=below) for below in (20.0, 5.0))
    assert (once.parts, twice.parts) == (1, 2)
    one, two = (np.linalg.norm(forces(mesh, places)) for mesh in (once, twice))
    assert two == pytest.approx(one * 2 * np.cos(np.radians(5)), rel=1e-6)


# -------------------------------------------------------------------------- bodies and motion


def tube(count, radius, half=0.03, inward=False):
    """A tube about z in 2 count triangles, its normals outward or inward."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)
    low, high = (np.column_stack([ring, np.full(count, z)]) for z in (-half, half))
    a, b, c, d = low, np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high
    corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return corners[:, ::-1] if inward else corners


def test_a_cone_in_many_triangles_is_the_cone():
    """Distance from a cone of 30 degrees beside its axis, to within the facets' height."""
    count, half_angle, length = 256, np.radians(15), 0.04
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    base = length * np.tan(half_angle)
    ring = np.stack([base * np.cos(turn), base * np.sin(turn), np.full(count, length)], 1)
    following, tip = np.roll(ring, -1, axis=0), np.zeros_like(ring)
    top = tip + np.array([0, 0, length])
    corners = np.concatenate(
        [np.stack(t, 1) for t in ((tip, following, ring), (top, ring, following))]
    )
    mesh = Mesh.from_triangles(corners)
    assert mesh.parts == 2
    rng = np.random.default_rng(3)
    place = rng.uniform(0.01, 0.03, 100)  # along the flank
    turn = rng.uniform(0, 2 * np.pi, 100)
    out = np.stack([np.cos(turn), np.sin(turn)], 1)
    distance = 0.99 * RADIUS
    off_axis = place * np.sin(half_angle) + distance * np.cos(half_angle)
    height = place * np.cos(half_angle) - distance * np.sin(half_angle)
    found = forces(mesh, np.column_stack([out * off_axis[:, None], height]))
    facets = (
        0.03 * np.tan(half_angle) * (1 - np.cos(np.pi / count))
    )  # m, that the flank lies within
    size = np.linalg.norm(found, axis=1)
    assert np.all(size <= hertz(distance) * (1 + 1e-9))
    assert np.all(size >= hertz(distance + facets))
    normal = np.column_stack([out * np.cos(half_angle), np.full(100, -np.sin(half_angle))])
    assert np.all(np.sum(found * normal, axis=1) > 0.999 * size)


@pytest.mark.slow
def test_friction_survives_the_facets_of_a_turning_drum():
    """A rough drum carries a sphere up; its flat facets do as the smooth cylinder does."""
    radius, spin = 0.02, 4.0
    mesh = Mesh.from_triangles(tube(360, radius, inward=True), two_sided=True)
    drum = Cylinder.at(point(0, 0, 0, float), UP, radius)
    bed = bed_of(1, 1, friction=0.6, restitution=0.3)
    place, velocity = [radius - 0.999 * RADIUS, 0, 0], [0.3, 0.0, 0.0]
    found, record = moved_by(bed, (mesh,), place, velocity, 0.03, spin, every=250)
    smooth, _ = moved_by(bed, (drum,), place, velocity, 0.03, spin, every=250)
    assert np.linalg.norm(smooth[0][:2] - place[:2]) > 2e-3  # it bounces and is carried
    for ours, theirs in zip(found, smooth, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=0.05 * np.abs(theirs).max())  # half a degree
    assert float(record.state.boundaries[0].angle) == pytest.approx(spin * 0.03, rel=1e-3)


def turning_cube():
    """Turned, moving along a tilted axis and spinning about it, and spheres all around it."""
    axis, place = (0.6, 0.0, 0.8), (2e-3, -1e-3, 4e-3)
    mesh = Mesh.from_triangles(CUBE.form.corners + place, np.array(place) + 1e-3, axis)
    mesh = mesh.driven(Rates(*map(jnp.asarray, (0.3, 20.0, 0.0)))).moved(0.05)
    rng = np.random.default_rng(4)
    places = np.asarray(mesh.reference.stack()) + rng.uniform(-0.012, 0.012, (2000, 3))
    distance = np.asarray(mesh.distance(vector(places)))
    chosen = places[(distance > 0.9 * RADIUS) & (distance < RADIUS)]
    assert len(chosen) > 10
    motion = (vector(rng.normal(size=chosen.shape)), vector(rng.normal(size=chosen.shape) * 100))
    return mesh, chosen, motion


def test_action_is_reaction_and_power_is_work():
    mesh, places, motion = turning_cube()
    found, felt = pressed((mesh,), places, motion, friction=0.5, restitution=0.4)
    force, torque = np.asarray(found.rows[:, :3]), np.asarray(found.rows[:, 3:6])
    assert (np.abs(force).max(axis=1) > 0).all()
    felt = np.asarray(felt)[0]
    np.testing.assert_allclose(force.sum(axis=0), -felt[:3], rtol=1e-12)
    about_origin = (np.cross(places, force) + torque).sum(axis=0)
    np.testing.assert_allclose(about_origin, -felt[3:6], atol=1e-12 * np.abs(felt).max())
    velocity, spin = (np.asarray(part.stack()) for part in motion)
    on_spheres = np.sum(force * velocity) + np.sum(torque * spin)
    given = float(power((mesh,), about_references((mesh,), jnp.asarray(felt[None])))[0])
    assert on_spheres + float(found.power.sum()) == pytest.approx(given, rel=1e-12)


def test_forces_turn_and_move_with_the_mesh():
    """The same mesh whose triangles were turned and moved instead."""
    mesh, places, _ = turning_cube()
    local = mesh._local(vector(places))
    still = Mesh.from_triangles(mesh.form.corners)
    here = vector(forces(still, np.asarray(local.stack())))
    expected = np.asarray(mesh._from_local(here).stack())
    np.testing.assert_allclose(forces(mesh, places), expected, atol=1e-10 * np.abs(expected).max())


def test_it_is_lowered_onto_the_first_sphere_that_it_meets():
    """By whatever touches first; and only where a segment asks for it."""
    rng = np.random.default_rng(5)
    places = vector(rng.uniform(-0.01, 0.01, (8, 3)) - [0, 0, 0.03])
    radius = jnp.full(8, RADIUS)
    cube = Mesh.from_triangles(CUBE.form.corners, axis=(0.0, 0.0, -1.0))
    for mode, touches in ((LOWER, True), (0, False)):
        segment = Segment(*[jnp.zeros(1)] * 3, placed=jnp.asarray([mode]))
        (mesh,) = jax.jit(lambda: placed((cube,), segment, places, radius))()  # noqa: B023
        gap = float(jnp.min(mesh.distance(places) - radius))
        assert (abs(gap) < 1e-14) == touches


# -------------------------------------------------------------------- lists and derivatives


def waves(cells=20):
    """A bumpy shell whose faces are smaller than the spheres."""
    corners = grid_of(cells, 0.1, half=0.02)
    corners[..., 2] = 1.5e-3 * np.sin(500 * corners[..., 0]) * np.cos(400 * corners[..., 1])
    return corners


@pytest.mark.slow
@pytest.mark.parametrize("smooth_below", [20.0, 5.0])
def test_lists_know_every_face_that_can_be_touched_before_the_next_rebuild(smooth_below):
    """Forces from lists made before a motion shorter than the skin are those from new lists."""
    mesh = Mesh.from_triangles(waves(), two_sided=True, smooth_below=smooth_below)
    rng = np.random.default_rng(6)
    places = rng.uniform(-0.012, 0.012, (200, 3))
    places[:, 2] = RADIUS * rng.uniform(0.9, 1.5, 200)
    moved = rng.normal(size=places.shape)
    moved *= 0.99 * SKIN / np.linalg.norm(moved, axis=1, keepdims=True)
    bed = bed_of(200, 1, each=24)
    _, old, demand = lists(bed, (mesh,), vector(places))
    new = lists(bed, (mesh,), vector(places + moved))[1]
    for room in ("faces", "wall_contacts"):
        assert int(getattr(demand, room)) <= getattr(bed.grid, room)
    still = (vector(np.zeros_like(places)),) * 2
    after = vector(places + moved)
    late, fresh = (loads(bed, (mesh,), after, still, c)[0].rows for c in (old, new))
    assert np.abs(fresh).max() > 0
    np.testing.assert_allclose(late, fresh, atol=1e-12 * np.abs(fresh).max())


def test_too_little_room_for_faces_is_reported():
    mesh = Mesh.from_triangles(PLANES["5000"], two_sided=True)
    bed = bed_of(1, 1, faces=4)
    demand = lists(bed, (mesh,), vector([[0, 0, RADIUS]]))[2]
    need = int(demand.faces)
    assert need > 4 and demand.exceeds(bed.grid)
    state = begun(bed, vector([[0, 0, RADIUS]]), (mesh,))
    none = jnp.zeros(1)
    still = Segment(none, none, none, jnp.zeros(1, int), 0, duration=1e-4)
    record = simulated(bed, state, stack([still]), jnp.asarray(10), 150)
    assert f"faces per contact: have 4, need {need}" in record.explain_overflow(bed.grid)


@pytest.mark.slow
def test_derivatives_are_those_of_finite_differences_and_never_nan():
    """At faces, edges and vertices of a cube; finite also at what divides them."""
    mesh, places, (velocity, spin) = turning_cube()
    bed = bed_of(len(places), 1, friction=0.5, restitution=0.4)
    contacts = lists(bed, (mesh,), vector(places))[1]
    way = np.random.default_rng(7).normal(size=places.shape)

    def of(places):
        found, felt = loads(bed, (mesh,), places, (velocity, spin), contacts)
        return found.rows[:, :3], felt

    _, slopes = jax.jvp(of, (vector(places),), (vector(way),))
    step = 1e-9
    ahead, back = (of(vector(places + sign * step * way)) for sign in (1, -1))
    for slope, one, two in zip(slopes, ahead, back, strict=True):
        numeric = np.asarray(one - two) / (2 * step)
        np.testing.assert_allclose(slope, numeric, atol=1e-5 * np.abs(numeric).max())
    half = 5e-3
    special = np.array([[half, half, half + 1e-3], [half, 0, half + 2e-3], [half, half, half]])
    bed, still = bed_of(3, 1), (vector(np.zeros((3, 3))),) * 2
    contacts = lists(bed, (CUBE,), vector(special))[1]
    at = jax.jvp(
        lambda p: loads(bed, (CUBE,), p, still, contacts)[0].rows,
        (vector(special),),
        (vector(np.ones((3, 3))),),
    )
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in at)


@pytest.mark.slow
def test_derivatives_pass_through_the_loop():
    """Of the place after rolling over edges, with respect to the first speed."""
    mesh = Mesh.from_triangles(PLANES["288 irregular"], two_sided=True)
    bed = bed_of(1, 1, friction=0.3, restitution=0.3, gravity=9.81)

    def rolled(boundaries, speed):
        state = begun(bed, vector([[-0.003, 0.001, RADIUS]]), boundaries)
        state = eqx.tree_at(lambda s: s.motion.velocity.x, state, speed[None])
        none = jnp.zeros(1)
        segment = Segment(none, none, none, jnp.zeros(1, int), 0, duration=4e-3)
        record = run(bed, state, stack([segment]), jnp.asarray(100), 40)
        return record.state.motion.position.stack()

    slopes = [
        quickly(lambda speed, b=b: jax.jvp(lambda s: rolled(b, s), (speed,), (jnp.ones(()),)))(
            jnp.asarray(0.2)
        )
        for b in ((mesh,), (FLOOR,))
    ]
    np.testing.assert_allclose(slopes[0][1], slopes[1][1], rtol=1e-9, atol=1e-15)
    assert float(slopes[0][1][0, 0]) > 1e-3


# -------------------------------------------------------------------------------------- files


def written(path, corners):
    """An STL file, as text."""
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x:.17g} {y:.17g} {z:.17g}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in corners
    )
    path.write_text(f"solid made\n{facets}endsolid made\n")
    return path


SOLID = CUBE.form.corners
DOUBLED_EDGE = np.concatenate([SOLID, SOLID + np.array([0.01, 0.01, 0.0])])
TWISTED = np.concatenate([SOLID[:1, ::-1], SOLID[1:]])
SPOILT = np.where(np.arange(12)[:, None, None] == 3, np.nan, SOLID)
SPLIT = np.array(
    [
        [[0, 0, 0], [2, 0, 0], [0, 1, 0]],
        [[0, 0, 0], [1, -1, 0], [1, 0, 0]],
        [[1, 0, 0], [1, -1, 0], [2, 0, 0]],
    ]
) * 1e-2  # fmt: skip
BAD = {
    "open": (SOLID[1:], {}, "declare it a shell"),
    "inside out": (SOLID[:, ::-1], {}, "turn its normals outward"),
    "more than two faces at an edge": (DOUBLED_EDGE, {}, "edges of more than two"),
    "one face turned": (TWISTED, {}, "orient all faces alike"),
    "without area": (np.concatenate([SOLID, SOLID[:1, [0, 1, 1]]]), {}, "without area"),
    "twice": (np.concatenate([SOLID, SOLID[:1]]), {}, "there more than once"),
    "not finite": (SPOILT, {}, "not finite"),
    "empty": (SOLID[:0], {}, "no triangle"),
    "a vertex within an edge": (SPLIT, {"two_sided": True}, "split by a vertex"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_refused_in_one_sentence_that_names_it(name, tmp_path):
    corners, given, says = BAD[name]
    path = written(tmp_path / "part.stl", corners)
    with pytest.raises(ValueError, match=says) as refused:
        Mesh.from_stl(path, **given)
    assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)


def test_what_is_no_stl_file_is_refused(tmp_path):
    path = tmp_path / "part.stl"
    with pytest.raises(ValueError, match="no such file"):
        Mesh.from_stl(path)
    for content in (b"", b"hello world\n" * 20, bytes(range(256)) * 3):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"part\.stl: (not an STL file|there is no triangle)"):
            Mesh.from_stl(path)


def test_a_file_is_read_in_its_unit_about_its_reference_point(tmp_path):
    path = written(tmp_path / "part.stl", SOLID * 1e3)
    mesh = Mesh.from_stl(path, 1e-3, reference=(0.0, 0.0, 0.004), axis=(0.0, 0.0, -1.0))
    places = vector([[0.0, 0.0, 0.007], [0.012, 0.001, 0.0]])
    np.testing.assert_allclose(mesh.distance(places), [0.002, 0.007], rtol=1e-12)
    assert mesh.form == Mesh.from_stl(path, 1e-3, reference=(0.0, 0.0, 0.004)).form
