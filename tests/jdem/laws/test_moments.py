"""Moments of a law: on both bodies, against their relative spin, and in the ledger of energy."""

import equinox as eqx
import numpy as np
import pytest

from jdem.bodies.spheres import kinetic_energy
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.laws.base import AbstractRollingLaw
from tests.support.hand_made_beds import RADIUS, advanced, bed_of, soil_of, spheres_of, state_of


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
    soil = soil_of(static_friction=0.0, restitution=1.0)
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
    bed = bed_of(spheres_of(1), soil_of(platen_friction=0.0), skin=40.0)
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
