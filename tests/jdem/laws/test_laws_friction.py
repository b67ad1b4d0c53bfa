"""What contact laws owe along the contact: friction, its spring and dashpot, rolling."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.bodies.spheres import kinetic_energy
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractRollingLaw
from jdem.laws.composite import ContactMemory
from jdem.laws.eepa import PlasticMemory
from jdem.laws.friction import ConstantTorque, CoulombSpring
from jdem.mechanics.contact import NormalForce
from jdem.mechanics.dashpot import longest_step
from tests.support.hand_made_beds import RADIUS, advanced, bed_of, spheres_of, state_of
from tests.support.hand_made_beds import soil_of as bed_soil
from tests.support.law_cases import (
    FRICTION,
    MOST,
    TIME_STEP,
    contact_at,
    every_exponent,
    every_smoothing,
    last_row,
    law_of,
    minimum_of,
    plastic_overlap_of,
    soil_of,
    stiffness_of,
)

pytestmark = pytest.mark.thorough


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
    law, forces = CoulombSpring(restitution, smoothing), []
    history = law.memory((), float)
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
    history = Vector(0.0, stretch * SLIPS_AT, 0.0)
    contact = contact_at(jnp.asarray(1e-6), slip=speed)
    spring, dashpot, _ = pull(CoulombSpring(0.1, smoothing), contact, history)
    assert abs(float(spring.y + dashpot.y)) <= LIMIT * (1 + 1e-12)


@every_smoothing
def test_no_load_means_no_friction(smoothing):
    history = Vector(0.0, 4 * SLIPS_AT, 0.0)
    free = contact_at(jnp.asarray(1e-6), friction=0.0)
    spring, dashpot, kept = pull(CoulombSpring(0.5, smoothing), free, history)
    assert spring.y == dashpot.y == kept.y == 0.0


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
    plastic = PlasticMemory(jnp.asarray(MOST), jnp.asarray(0.8 * MOST))
    history = ContactMemory(plastic, stretch, ())
    contact = contact_at(jnp.asarray(0.9 * MOST))
    turned = eqx.tree_at(
        lambda c: (c.normal, c.slip),
        contact,
        (turned_by(turn, contact.normal), turned_by(turn, contact.slip)),
    )
    turned_history = history._replace(tangential=turned_by(turn, stretch))
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
    _, _, kept = pull(CoulombSpring(0.5), contact_at(jnp.asarray(1e-6), slip=0.0), stretch)
    assert not np.any(kept.stack())


@pytest.mark.parametrize("hysteretic", [3.0, -0.5])
@every_smoothing
def test_the_rolling_limit_is_friction_times_the_hysteretic_force(hysteretic, smoothing):
    normal = NormalForce(jnp.asarray(hysteretic), jnp.asarray(7.0), jnp.asarray(4.0))
    limit = ConstantTorque(0.4, smoothing).limit(normal)
    assert limit == pytest.approx(0.4 * abs(hysteretic), rel=1e-12)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 1.5])
def test_the_longest_step_is_where_the_integration_turns_unstable(ratio):
    """Of x'' = -k x - c x', by the engine's step: v -= (k x + c v) dt/m, x += v dt."""
    mass, stiffness = 3e-4, 2e4
    damping = 2 * ratio * np.sqrt(mass * stiffness)
    longest = float(longest_step(jnp.asarray(mass), jnp.asarray(stiffness), ratio))
    for share, stable in ((0.999, True), (1.001, False)):
        dt = share * longest
        kick = np.array([[1.0, 0.0], [-stiffness * dt / mass, 1 - damping * dt / mass]])
        drift = np.array([[1.0, dt], [0.0, 1.0]])
        growth = np.abs(np.linalg.eigvals(drift @ kick)).max()
        assert (growth < 1 + 1e-9) == stable


class Spring(AbstractRollingLaw):
    """A moment against the relative rotation of a contact: a spring, and friction of its spin.

    What it remembers is the rotation (rad) since the bodies were listed, as a bond does.
    """

    stiffness: Real = quantity()
    viscosity: Real = quantity()

    def limit(self, normal):
        return 0.0 * normal.hysteretic

    def moment(self, contact, normal, history):
        rotation = history + contact.spin * contact.time_step
        return rotation * -self.stiffness - contact.spin * self.viscosity, rotation

    def memory(self, shape, dtype):
        return Vector.zeros(shape, dtype)


def with_rolling(bed, law):
    where = (lambda b: b.particle_law.rolling, lambda b: b.wall_law.rolling)
    for slot in where:
        bed = eqx.tree_at(slot, bed, law)
    return bed


def pair(law, spin):
    """Two spheres that touch without friction and turn about their line of centres and across."""
    soil = bed_soil(static_friction=0.0, restitution=1.0)
    bed = with_rolling(bed_of(spheres_of(2), soil, gravity=0.0, skin=40.0), law)
    place = [[0.0, 0.0, 1.0], [2 * RADIUS, 0.0, 1.0]]
    return bed, state_of(bed, place, spin=spin)


def test_a_moment_turns_both_bodies_and_conserves_angular_momentum():
    spin = np.array([[3.0, 1.0, -2.0], [0.0, 0.0, 0.0]])
    bed, state = pair(Spring(0.0, 1e-9), spin)
    final = advanced(bed, state, 3000)[0]
    after = np.asarray(final.motion.spin.stack())
    np.testing.assert_allclose(after.sum(axis=0), spin.sum(axis=0), rtol=1e-12)
    rate = 2 * 1e-9 / float(bed.spheres.inertia[0])  # of the relative spin, 1/s
    left = (after[0] - after[1]) / spin[0]
    expected = (1 - rate * float(bed.time_step)) ** 3000  # of an explicit step
    np.testing.assert_allclose(left, expected, rtol=1e-9)


def test_the_work_of_moments_is_in_the_ledger():
    bed, state = pair(Spring(1e-5, 1e-9), np.array([[3.0, 1.0, -2.0], [1.0, 0.0, 5.0]]))
    final = advanced(bed, state, 3000)[0]
    before, after = (kinetic_energy(bed.spheres, s.motion) for s in (state, final))
    energy = final.energy
    assert float(energy.rolling) > 0.1 * float(before)
    error = float(energy.supplied() - energy.absorbed() - (after - before))
    assert abs(error) < 3000 * np.finfo(float).eps * float(before) * 10


def test_a_wall_law_remembers_as_well():
    """A sphere on the base, held by a spring against its rotation, swings to and fro."""
    bed = bed_of(spheres_of(1), bed_soil(platen_friction=0.0), skin=40.0)
    bed = with_rolling(bed, Spring(1e-5, 0.0))
    state = state_of(bed, [[0.0, 0.0, RADIUS - 1e-6]], spin=[[0.0, 5.0, 0.0]])
    final, (motion, _) = advanced(bed, state, 3000)
    spin = np.asarray(motion.spin.y[:, 0])
    frequency = np.sqrt(1e-5 / float(bed.spheres.inertia[0]))
    time = np.arange(1, 3001) * float(bed.time_step)
    assert frequency * time[-1] > np.pi
    assert np.abs(spin - 5.0 * np.cos(frequency * time)).max() < 0.05
    rotation = float(final.wall_contacts.history.rolling.y[0])
    assert rotation == pytest.approx(5.0 / frequency * np.sin(frequency * time[-1]), abs=1e-4)
