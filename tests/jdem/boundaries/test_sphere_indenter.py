"""A sphere as a boundary: pressed on a single particle, and into a bed on the base."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.boundaries.base import DOWN, UP, Rates, point
from jdem.boundaries.composite import FORCE, effective_radius, resistances
from jdem.boundaries.plane import Plane
from jdem.boundaries.sphere import Sphere
from jdem.core.vector import Vector
from jdem.engine.loop import begun, run
from jdem.engine.segment import LOWER, Segment, stack
from tests.support.hand_made_beds import CAPACITY, RADIUS, advanced, bed_of, soil_of, spheres_of

pytestmark = pytest.mark.thorough

INDENTER = 6e-3  # m, its radius
SURFACES = ("platen", "platen")
running = eqx.filter_jit(run)


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
    record = running(bed, state, programme, jnp.asarray(1), CAPACITY)
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
    record = running(bed, state, stack([press]), jnp.asarray(50), CAPACITY)
    last = int(np.flatnonzero(np.asarray(record.samples.segment) >= 0)[-1])
    assert bool(record.finished)
    assert float(record.samples.reading[last]) == pytest.approx(0.5, abs=5e-3)
    base = float(record.samples.loads[last, 0, 2])
    assert base == pytest.approx(-0.5, rel=0.1)
    top = float(record.samples.reference[0, 1, 2])
    assert top == pytest.approx(3.6 * RADIUS + INDENTER, rel=0.01)
