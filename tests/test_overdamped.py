"""Overdamped derivatives: no value changes, and at rest they are those of equilibrium.

    one sphere      pressed by s:  k = k1/2, so F = k1 s/2
    a chain         n spheres in line, contacts in series: 1/k = 2/k_wall + (n - 1)/k_pair
    a packing       K dx = -df solved directly, K by jax.jacfwd of the engine's own forces

Spheres are elastic and without friction, so an equilibrium is a function of the parameters.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_made_beds import RADIUS, bed_of, listed, quickly, soil_of, spheres_of

from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries.base import FAR
from jdem.boundaries.composite import PLATEN
from jdem.core.vector import Vector
from jdem.engine.loads import pair_loads, wall_loads
from jdem.engine.loop import run, start
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import TangentDrag
from jdem.sensitivity.overdamped import OverdampedMotion

TRAVEL, SPEED = 2e-4, 0.05  # m, m/s
STEPS, SAMPLES, CAPACITY = 200, 40, 128  # of rest; capacity of the record
DRAG = TangentDrag(0.04, 0.12)
ELASTIC = {
    "static_friction": 0.0,
    "platen_friction": 0.0,
    "wall_friction": 0.0,
    "plasticity_ratio": 1e-10,
}
MODULUS, MIDDLE = 0, 1  # coordinates: ln of the shear modulus, ln of one sphere's radius


def bed_at(x, count, spread):
    """Elastic spheres without weight, with a modulus and the middle one's radius times exp(x)."""
    spheres = spheres_of(count, spread)
    step = bed_of(spheres, soil_of(**ELASTIC), gravity=0.0).time_step
    radius = jnp.asarray(spheres.radius).at[count // 2].multiply(jnp.exp(x[MIDDLE]))
    soil = soil_of(**ELASTIC, shear_modulus=1e6 * jnp.exp(x[MODULUS]))
    bed = bed_of(Spheres(radius, spheres.mass), soil, gravity=0.0)
    return eqx.tree_at(lambda b: b.time_step, bed, step)


@eqx.filter_jit
def pressed(x, position, height, mould, spread, derivative=None):
    """Forces on all boundaries (N) and positions after a travel of the platen and a rest."""
    bed = bed_at(x, position.shape[0], spread)
    state = start(bed, Vector.from_rows(position), height, mould)
    legs = (cell_segment(platen_speed=SPEED, duration=TRAVEL / SPEED, damping=500.0),
            cell_segment(duration=SAMPLES * STEPS * bed.time_step, damping=500.0))  # fmt: skip
    way = None if derivative is None else derivative
    record = run(bed, state, stack(list(legs)), jnp.asarray(STEPS), CAPACITY, derivative=way)
    return record.state.loads[:, 6], record.state.motion.position.stack(), record


@partial(quickly, static_argnames="spread")
def slopes(x, position, height, mould, spread):
    """Values and derivatives (p last) of `pressed`'s forces and positions."""
    way = OverdampedMotion(DRAG, jnp.zeros(0), turning=())

    def both(x):
        force, place, _ = pressed(x, position, height, mould, spread, way)
        return (force, place), (force, place)

    return jax.jacfwd(both, has_aux=True)(x)


def column():
    """Four spheres in line that just touch each other, the base and the platen."""
    z = RADIUS * jnp.asarray([1.0, 3.0, 5.0, 7.0])
    return jnp.stack([0 * z, 0 * z, z], axis=-1), 8 * RADIUS


def row():
    """Four spheres apart from each other, each between the platens."""
    x = RADIUS * jnp.asarray([-6.0, -2.0, 2.0, 6.0])
    return jnp.stack([x, 0 * x, 0 * x + RADIUS], axis=-1), 2 * RADIUS


@pytest.mark.parametrize("arranged", [row, column])
def test_a_sphere_and_a_chain_between_platens(arranged):
    """At a given travel F is proportional to the modulus, and no sphere moves."""
    position, height = arranged()
    (force_slope, place_slope), (force, _) = slopes(jnp.zeros(2), position, height, FAR, 0.0)
    assert float(force[PLATEN]) > 0
    assert abs(float(force_slope[PLATEN, MODULUS] / force[PLATEN]) - 1) < 1e-6
    assert np.abs(np.asarray(place_slope[..., MODULUS])).max() < 1e-6 * TRAVEL


def rings(layers):
    """Layers of seven spheres of two per cent different sizes, squeezed into a mould."""
    angle = jnp.pi / 3 * jnp.arange(6)
    ring = 2.0 * RADIUS * jnp.stack([jnp.cos(angle), jnp.sin(angle)], axis=-1)
    layer = jnp.concatenate([jnp.zeros((1, 2)), ring])
    z = jnp.repeat((2 * jnp.arange(layers) + 1.0) * RADIUS, 7)
    position = jnp.concatenate([jnp.tile(layer, (layers, 1)), z[:, None]], axis=-1)
    return position, 2 * layers * RADIUS, 2.95 * RADIUS


def net_forces(place, x, state, spread):
    """Force on every sphere (3 N,) and on the platen (N), spheres at rest at places (N, 3)."""
    bed = bed_at(x, place.shape[0], spread)
    motion = Motion.at_rest(Vector.from_rows(place))
    state = listed(bed, eqx.tree_at(lambda s: s.motion, state, motion))
    rows = bed.spheres.rows(motion)
    loads, _ = pair_loads(bed, rows, state.pairs)
    loads, _, felt = wall_loads(bed, rows, state.boundaries, state.wall_contacts, loads)
    return loads.rows[:, :3].ravel(), felt[PLATEN, 6]


def test_a_packing_at_rest_solves_for_equilibrium():
    """Motion frozen or not: K dx = -df, whatever the drag was on the way."""
    position, height, mould = rings(3)
    given, spread = (position, height, mould, 0.02), 0.02
    (found, _), _ = slopes(jnp.zeros(2), *given[:3], spread)
    _, place, record = pressed(jnp.zeros(2), *given[:3], spread)
    state = jax.lax.stop_gradient(record.state)

    def residual(place, x):
        return net_forces(place.reshape(-1, 3), x, state, spread)

    at = (place.ravel(), jnp.zeros(2))
    (stiffness, by_parameter), (felt, felt_by_parameter) = jax.jacfwd(residual, (0, 1))(*at)
    moved = jnp.linalg.lstsq(stiffness, -by_parameter)[0]
    expected = felt @ moved + felt_by_parameter
    force = float(record.state.loads[PLATEN, 6])
    assert force > 0.1
    assert np.abs(np.asarray(residual(*at)[0])).max() < 1e-7 * force
    assert np.abs(np.asarray(found[PLATEN] - expected)).max() < 1e-6 * force
    assert abs(float(expected[MIDDLE])) > 0.1 * force
    assert np.abs(np.asarray(moved[:, MIDDLE])).max() > 0.1 * RADIUS  # equilibrium moves
