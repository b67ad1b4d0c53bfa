"""Overdamped derivatives: no value changes, and at rest they are those of equilibrium.

    one sphere      pressed by s:  k = k1/2, so F = k1 s/2
    a chain         n spheres in line, contacts in series: 1/k = 2/k_wall + (n - 1)/k_pair
    a packing       K dx = -df solved directly, K by jax.jacfwd of the engine's own forces
    a turn          at a given force F = k s, so s goes with 1/k

Spheres are elastic and without friction, so an equilibrium is a function of the parameters.
"""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.resolution import PRESETS, virtual_lab
from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries.base import FAR
from jdem.boundaries.composite import PLATEN
from jdem.core.vector import Vector
from jdem.effects.gain import LoadCellGain
from jdem.engine.equilibrium import Carried, Stretch, _balance, _dragged, _motion
from jdem.engine.loads import pair_loads, wall_loads
from jdem.engine.loop import run, start
from jdem.engine.segment import cell_segment, stack
from jdem.engine.state import TangentDrag
from jdem.engine.stiffness import System
from jdem.observables import Curve, displacement_at
from jdem.sensitivity.base import Traced
from jdem.sensitivity.overdamped import Overdamped, OverdampedMotion
from tests.support.hand_made_beds import RADIUS, bed_of, listed, quickly, soil_of, spheres_of

pytestmark = pytest.mark.thorough

TRAVEL, SPEED = 2e-4, 0.05  # m, m/s
STEPS, SAMPLES, CAPACITY = 100, 160, 256  # of rest; capacity of the record
DRAG = TangentDrag(1.0, 1e-6)  # little: an elastic bed without friction holds itself
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
    way = OverdampedMotion(DRAG, turning=())

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


@pytest.mark.rare
@pytest.mark.slow
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


@pytest.mark.rare
@pytest.mark.slow
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


@pytest.mark.rare
@pytest.mark.slow
def test_the_system_is_the_derivative_of_the_balance():
    """Of a bed with friction, adhesion and rolling resistance, spheres moving at random."""
    position, height, mould = rings(3)
    soil = soil_of(surface_energy=2.0, plasticity_ratio=0.4, rolling_friction=0.3)
    bed = bed_of(spheres_of(len(position), 0.02), soil)
    bed = replace(bed, drag=TangentDrag(500.0, 0.15))
    place = position * jnp.asarray([0.999, 0.999, 0.998])
    state = listed(bed, start(bed, Vector.from_rows(place), 0.998 * height, 0.999 * mould))
    rates = jax.random.normal(jax.random.key(0), (2, len(position), 6)) * jnp.asarray([1e-3] * 6)
    histories = (state.pairs.history, state.wall_contacts.history)
    carried = Carried(state.motion.position, jnp.zeros_like(rates[0]), *histories, state.loads)
    velocity, spin = map(Vector.from_rows, jnp.split(rates[0], 2, axis=1))
    stretch = Stretch(20 * bed.time_step, velocity, spin, state.pairs, state.wall_contacts)

    def balance(rates):
        found, limit = _balance(_dragged(bed, stretch), state.boundaries, carried, rates, stretch)
        return found[0], limit

    _, expected, limit = jax.jvp(balance, (rates[0],), (rates[1],), has_aux=True)
    motion, lists = _motion(carried, rates[0], stretch), (state.pairs, state.wall_contacts)
    system = System.of(_dragged(bed, stretch), state.boundaries, motion, lists, limit)
    found = system.answer((rates[1] / system.scale)[:, :, None])[:, :, 0] / system.scale
    for part in (slice(0, 3), slice(3, 6)):
        size = np.linalg.norm(expected[:, part])
        assert size > 0
        assert np.linalg.norm(found[:, part] - expected[:, part]) < 1e-5 * size


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("coordinate", ["ln k", "gain"])
def test_a_turn_at_a_force(coordinate):
    """F = k s, and the machine sees (1 + g) F: at the force G that it sees, F = G/(1 + g) and the
    platen stands higher by s, per unit of ln k as per unit of g."""
    position, height = row()
    target, width = 8.0, 0.5
    direction = jnp.eye(3)[[MODULUS, 2][coordinate == "gain"]]

    def simulated(x):
        bed = bed_at(x[:2], position.shape[0], 0.0)
        state = start(bed, Vector.from_rows(position), height, FAR)
        loading = cell_segment(
            platen_speed=SPEED, force_target=target, servo_width=width, tolerance=width,
            duration=1.0, damping=500.0,
        )  # fmt: skip
        legs = [loading, cell_segment(duration=40 * bed.time_step, damping=500.0)]
        way = OverdampedMotion(DRAG, (LoadCellGain(x[2]),), turning=(0,))
        record = run(bed, state, stack(legs), jnp.asarray(20), CAPACITY, derivative=way)
        return record.samples.reading, record.samples.platen_height, record.samples.segment

    values, slopes = taken(simulated, jnp.zeros(3), direction)
    (force, height_now, segment), (force_slope, height_slope, _) = values, slopes
    held, pressed_by = np.asarray(segment) == 1, height - float(height_now[segment == 1][-1])
    assert held.sum() >= 2
    np.testing.assert_allclose(force[held], target, atol=2 * width)
    expected = -target if coordinate == "gain" else 0.0
    np.testing.assert_allclose(force_slope[held], expected, atol=0.02 * target)  # dashpots act
    np.testing.assert_allclose(height_slope[held], pressed_by, rtol=0.02)


@pytest.mark.rare
@pytest.mark.slow
def test_nothing_is_followed_beyond_the_last_movement():
    """Derivatives are those of a run that follows everything, and then zero."""
    position, height = row()

    def simulated(last, x):
        bed = bed_at(x, position.shape[0], 0.0)
        state = start(bed, Vector.from_rows(position), height, FAR)
        leg = cell_segment(platen_speed=SPEED, duration=60 * bed.time_step, damping=500.0)
        way = OverdampedMotion(DRAG, turning=(), last=last)
        record = run(bed, state, stack([leg, leg]), jnp.asarray(20), CAPACITY, derivative=way)
        return record.samples.loads, record.state.motion, record.samples.segment

    point, direction = jnp.zeros(2), jnp.eye(2)[MODULUS]
    (loads, _, segment), (slopes, _, _) = taken(partial(simulated, None), point, direction)
    (same, _, _), (until, motion, _) = taken(partial(simulated, 1), point, direction)
    assert np.array_equal(loads, same)
    assert np.array_equal(slopes[segment == 0], until[segment == 0])
    assert np.abs(slopes[segment == 1]).max() > 0
    assert max(np.abs(leaf).max() for leaf in jax.tree.leaves((until[segment == 1], motion))) == 0


def test_slopes_are_refused_from_the_first_test_whose_specimen_stands_free():
    """The confined test's movements are followed, those of the unconfined one are not."""
    preset = PRESETS["quick"]
    lab, strategy = virtual_lab(load_lab(bundled_lab()), preset), Overdamped()
    followed_until = strategy.laboratory(lab).derivative.last
    movements = lab.tests.movements()
    assert [movement.free for movement in movements[:followed_until]] == [False] * followed_until
    assert movements[followed_until].free
    small = jnp.full((2, 3), 1e-3)
    found = Traced(jnp.zeros(1), jnp.zeros((1, 3)), small, small)
    refused = strategy.refusals(lab, found)
    assert refused[0] == ["", "", ""]
    assert all("stands free" in reason for reason in refused[1])
    grown = replace(found, growth=small.at[0, 1].set(2.0))
    assert all("grew to 2" in reason for reason in strategy.refusals(lab, grown)[0])


def taken(simulated, point, direction):
    return quickly(lambda x, t: jax.jvp(simulated, (x,), (t,)))(point, direction)


@pytest.mark.rare
@pytest.mark.slow
def test_a_curve_is_differentiated_as_a_power_law():
    """u = (F/k)^(1/n): du/d ln k = -u/n, however rough the recorded force is."""
    travel = jnp.linspace(0.0, 5e-3, 400)
    rough = 1 + 0.02 * jnp.sin(2e4 * travel)

    def reached(x, window):
        force = jnp.exp(x) * 4e5 * travel**1.4 * rough
        return displacement_at(Curve(travel, force, jnp.ones(400), window), 100.0)

    expected = -float(reached(0.0, 0.0)) / 1.4
    assert abs(float(jax.grad(reached)(0.0, 0.25)) / expected - 1) < 0.03
    assert abs(float(jax.grad(reached)(0.0, 0.0)) / expected - 1) > 0.1
