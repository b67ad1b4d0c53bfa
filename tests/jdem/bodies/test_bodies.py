"""The seam for bodies of several spheres, tried with a kind of two that no library has."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jdem.bodies.base import AbstractBodies
from jdem.bodies.spheres import Motion
from jdem.boundaries.composite import cell
from jdem.core.vector import Vector
from jdem.engine.neighbors import ContactList, Grid, rebuild
from jdem.laws.base import AbstractContactLaw
from tests.support.hand_made_beds import RADIUS, spheres_of

COUNT = 12
ARM = 0.5 * RADIUS  # m; from a body's centre to those of its two spheres, along x


class Dumbbells(AbstractBodies):
    """Two spheres each, which overlap; they do not turn here."""

    radius: jnp.ndarray
    mass: jnp.ndarray

    @property
    def members(self):
        return 2

    @property
    def inertia(self):
        return 0.8 * self.mass * RADIUS**2

    def positions(self, motion):
        centre = motion.position
        x = jnp.stack([centre.x - ARM, centre.x + ARM], axis=-1).ravel()
        return Vector(x, jnp.repeat(centre.y, 2), jnp.repeat(centre.z, 2))

    def rows(self, motion):
        place, spin = self.positions(motion), motion.spin
        arms = Vector(place.x - jnp.repeat(motion.position.x, 2), 0.0 * place.y, 0.0 * place.z)
        twice = [Vector(*[jnp.repeat(c, 2) for c in v.stack().T]) for v in (motion.velocity, spin)]
        velocity = twice[0] + twice[1].cross(arms)
        columns = [place.stack(), velocity.stack(), twice[1].stack()]
        more = jnp.stack([self.radius, jnp.repeat(self.mass, 2)], axis=-1)
        return jnp.concatenate([*columns, more], axis=-1)

    def collected(self, loads, motion):
        arms = Vector(jnp.tile(jnp.array([-ARM, ARM]), len(self.mass)), 0.0, 0.0)
        turning = arms.cross(Vector.from_rows(loads[:, 0:3])).stack()
        return loads.at[:, 3:6].add(turning).reshape(-1, 2, 8).sum(axis=1)


class Silent(AbstractContactLaw):
    """Neither force nor memory."""

    def force(self, contact, history):
        raise NotImplementedError

    def longest_step(self, mass, radius):
        raise NotImplementedError


def bodies():
    return Dumbbells(jnp.full(2 * COUNT, RADIUS), jnp.full(COUNT, 1e-4))


def motion():
    place = np.random.default_rng(0).uniform(0, 6 * RADIUS, (COUNT, 3))
    return Motion.at_rest(Vector.from_rows(jnp.asarray(place)))


def test_members_of_one_body_are_never_listed_as_a_pair():
    grid = Grid((3, 3, 3), per_cell=30, pairs=400, wall_contacts=100, cell=3 * RADIUS, skin=1e-4)
    lists = [ContactList.empty(n, float, Silent()) for n in (grid.pairs, grid.wall_contacts)]
    position = bodies().positions(motion())
    relisted = eqx.filter_jit(rebuild)
    pairs, _, demand = relisted(grid, bodies(), cell(1.0, 1.0, float), position, *lists)
    assert not demand.exceeds(grid)
    alive = np.flatnonzero(pairs.alive)
    found = {(int(pairs.first[k]), int(pairs.second[k])) for k in alive}
    place = np.asarray(position.stack())
    apart = np.linalg.norm(place[:, None] - place[None], axis=-1)
    near = apart < 2 * RADIUS + grid.skin
    every = {(i, j) for i in range(2 * COUNT) for j in range(i + 1, 2 * COUNT) if near[i, j]}
    own = {(2 * k, 2 * k + 1) for k in range(COUNT)}
    assert own < every
    assert found == every - own


def test_single_spheres_are_asked_nothing():
    spheres = spheres_of(3)
    assert spheres.members == 1 and spheres.count == 3
    assert spheres.one_body(jnp.arange(3), jnp.arange(3)) is None
    loads, still = jnp.ones((3, 8)), Motion.at_rest(Vector.zeros(3, float))
    assert spheres.collected(loads, still) is loads
    assert spheres.positions(still) is still.position


def test_forces_on_members_add_up_and_turn_their_body():
    """A couple of forces on the two spheres is a torque and no force."""
    loads = jnp.zeros((2 * COUNT, 8)).at[0, 1].set(-2.0).at[1, 1].set(2.0).at[2, 2].set(1.0)
    found = bodies().collected(loads, motion())
    np.testing.assert_allclose(found[0, :6], [0, 0, 0, 0, 0, 4.0 * ARM])
    np.testing.assert_allclose(found[1, :6], [0, 0, 1.0, 0, ARM, 0])
    spun = eqx.tree_at(lambda m: m.spin.z, motion(), jnp.full(COUNT, 3.0))
    rows = bodies().rows(spun)
    np.testing.assert_allclose(rows[:2, 4], [-3.0 * ARM, 3.0 * ARM])
    assert rows.shape == (2 * COUNT, 11)
