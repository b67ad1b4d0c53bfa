"""Virtual power: values untouched, the balance closes, and slopes where the motion is given.

Two spheres side by side between two platens, half way up, without gravity and strongly damped:
forces at both ends are equal, and their centres move at half the platen's speed whatever the
parameters are.  There frozen motion is no approximation, and the derivative must be the slope of
the response, through loading, unloading and reload.  What freezing costs in a bed is the
audit's business (docs/gradients.md); a bed of 60 spheres shows here that the balance closes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effect_lab import NUMERICS, SMALL, SOIL, lab_with
from hand_made_beds import RADIUS, bed_of, soil_of, spheres_of

from calibrate.parameters import FACTORS, with_values
from jdem.bed import build_bed
from jdem.dynamics import Command, step
from jdem.effects.capillary import CapillaryTension
from jdem.effects.composite import with_strengths
from jdem.effects.gain import LoadCellGain
from jdem.energy import Ledger
from jdem.packing import prepare
from jdem.sensitivity.virtual_power import FrozenMotion, VirtualPower, force_by_power
from jdem.simulate import FAR, Segment, run, stack, start
from jdem.smooth import Smoothing
from jdem.vector import Vector
from jdem.walls import PLATEN

NAMES = (*FACTORS, "shear_modulus")
CLAY = {
    "surface_energy": 20.0,
    "plasticity_ratio": 0.5,
    "rolling_friction": 0.1,
    "restitution": 0.4,
}
HEIGHT = 2 * RADIUS
SPEED = 0.01  # m/s
STEP, STEPS, CAPACITY = 2e-6, 50, 64  # s; time steps in a sample; samples
STRONG = 1e12  # 1/s; nothing moves but with the affine motion
LEG = 10 * STEPS * STEP  # s; 2e-6 m of travel


# ------------------------------------------------------------------ given motion


def moves(*speeds):
    """The platen moves at these speeds (m/s), one leg each."""
    return [Segment(platen_speed=v, duration=LEG, damping=STRONG) for v in speeds]


@eqx.filter_jit
@eqx.debug.assert_max_traces(max_traces=5)
def pressed(log_values, programme, first):
    """Platen forces (N) on both spheres; motion frozen from segment `first` on (None: never).

    One program for each programme's length and each `first`: five in this file.
    """
    values = dict(zip(NAMES, jnp.exp(log_values), strict=True))
    soil = with_values(soil_of(), {**values, "wall_adhesion": 1.0})
    bed = bed_of(spheres_of(2), soil, gravity=0.0, smoothing=Smoothing())
    bed = eqx.tree_at(lambda b: b.time_step, bed, jnp.asarray(STEP))
    state = start(
        bed,
        Vector(*jnp.asarray([[-2 * RADIUS, 2 * RADIUS], [0.0, 0.0], [RADIUS, RADIUS]])),
        HEIGHT,
        FAR,
    )
    frozen = None if first is None else FrozenMotion(first, carried=True)
    samples = run(bed, state, programme, jnp.asarray(STEPS), CAPACITY, frozen=frozen).samples
    return samples.platen_force


def centre():
    soil = soil_of(**CLAY)
    return jnp.log(jnp.asarray([float(getattr(soil, name)) for name in NAMES]))


def slopes(programme, first):
    """Derivatives (samples, p) of the platen force (N) per unit of ln p."""
    return np.asarray(jax.jacfwd(lambda x: pressed(x, programme, first))(centre()))


def differences(programme, step=1e-6):
    point = centre()
    shifts = step * jnp.eye(len(NAMES))
    pairs = [
        (pressed(point + s, programme, None), pressed(point - s, programme, None)) for s in shifts
    ]
    return np.stack([np.asarray(up - down) / (2 * step) for up, down in pairs], axis=-1)


@pytest.fixture(scope="module")
def cycle():
    """Down, partly up, down again and further: virgin loading, unloading, reload."""
    return stack(moves(SPEED, SPEED, -0.6 * SPEED, 0.4 * SPEED, SPEED))


def test_given_motion_makes_virtual_power_exact(cycle):
    """Central differences of 1e-6 in ln p leave 1e-6 of the largest slope.

    Without the first sample of a leg: in its first step the platen has its new speed and
    the spheres have the old one, so the dashpots at both ends differ.
    """
    expected, found = differences(cycle), slopes(cycle, 0)
    rows = np.flatnonzero(np.arange(50) % 10)
    assert np.all(pressed(centre(), cycle, None)[rows] != 0)
    largest = np.abs(expected).max(axis=0)
    for number, name in enumerate(NAMES):
        error = np.abs(found - expected)[rows, number].max()
        assert error <= 1e-5 * largest[number] + 1e-9, name


def test_what_has_no_influence_has_no_slope(cycle):
    """Nothing slides or rolls here."""
    idle = [NAMES.index(name) for name in ("static_friction", "rolling_friction")]
    assert np.all(slopes(cycle, 0)[:, idle] == 0.0)


def test_a_stage_before_it_is_part_of_the_effect():
    """A servo stops at 0.1 N, at an overlap that depends on the soil; then the motion is given.

    Dropping what the first stage made of the bed gives another slope: stiffer soils would
    be stronger at the same overlap.
    """
    servo = Segment(
        platen_speed=SPEED, force_target=0.1, servo_width=0.02, tolerance=4e-3, damping=STRONG,
        duration=40 * STEPS * STEP,
    )  # fmt: skip
    programme = stack([servo, *moves(SPEED)])
    expected, found = differences(programme, 1e-7), slopes(programme, 1)
    rows = np.flatnonzero(np.asarray(pressed(centre(), programme, 1)))[-9:]
    modulus = NAMES.index("shear_modulus")
    assert found[rows] == pytest.approx(expected[rows], rel=1e-4, abs=1e-4)
    everything = slopes(programme, 0)[rows, modulus]
    assert np.all(everything > 1.5 * expected[rows, modulus])


# ------------------------------------------------------------------ a bed of 60 spheres


LAB = lab_with(CapillaryTension(), LoadCellGain())
FROZEN = VirtualPower(carried=True).laboratory(LAB)
FREE = ("surface_energy", "plasticity_ratio", "shear_modulus")
ALONG = jnp.asarray([0.3, 1.0, -0.5, 0.0, 0.0])  # a direction in ln p of FREE; no effects


def observed(lab, packing, point, time_step):
    """(H in mm, F in N) at ln p of FREE and strengths of both effects, and the last state."""
    soil = with_values(SOIL, dict(zip(FREE, jnp.exp(point[:3]), strict=True)))
    changed = eqx.tree_at(lambda v: v.effects, lab, with_strengths(lab.effects, point[3:]))
    outcome = changed.run(packing, soil, time_step)
    both = jnp.stack([1e3 * outcome.depression_depth, outcome.crushing_force])
    return both, outcome.record.state


def point_of(soil):
    logs = [jnp.log(getattr(soil, name)) for name in FREE]
    return jnp.stack([*logs, jnp.zeros(()), jnp.zeros(())])


@eqx.filter_jit
@eqx.debug.assert_max_traces(max_traces=1)
def differentiated(lab, packing, point, time_step):
    """Both observables, and their slopes in all five coordinates, by virtual power."""

    def response(points):
        return observed(lab, packing, points[0, 0], time_step)[0][None, None]

    found = VirtualPower()(response, point, 1)
    return found.values[0], found.slopes


@eqx.filter_jit
def pathwise(lab, packing, point, time_step):
    """Both observables, their derivatives along ALONG, and the last state."""

    def response(point):
        return observed(lab, packing, point, time_step)

    return jax.jvp(response, (point,), (ALONG,), has_aux=True)


@pytest.fixture(scope="module")
def packing():
    return prepare(SMALL, 0)


@pytest.fixture(scope="module")
def ordinary(packing):
    return pathwise(LAB, packing, point_of(SOIL), LAB.time_step(packing, SOIL))


@pytest.fixture(scope="module")
def estimate(packing):
    return differentiated(FROZEN, packing, point_of(SOIL), LAB.time_step(packing, SOIL))


def test_values_stay_what_they_are(ordinary, estimate):
    """Two programs round differently; 1e-6 is what chaos makes of that in a short test."""
    np.testing.assert_allclose(estimate[0], ordinary[0], rtol=1e-6)


def test_the_confined_test_is_pathwise(ordinary, estimate):
    """H's slope along one direction is that of the ordinary laboratory; F's is not."""
    depth, force = np.asarray(estimate[1] @ ALONG)
    assert depth == pytest.approx(float(ordinary[1][0]), rel=1e-5)
    assert force != pytest.approx(float(ordinary[1][1]), rel=1e-2)


def test_every_slope_is_finite(packing, estimate):
    """Parameters and strengths alike, and one compilation for all values."""
    other = with_values(SOIL, {"plasticity_ratio": 0.4, "surface_energy": 5.0})
    again = differentiated(FROZEN, packing, point_of(other), 0.9 * LAB.time_step(packing, SOIL))
    for values, slopes in (estimate, again):
        assert np.all(np.isfinite(values)) and np.all(np.isfinite(slopes))
        assert np.all(slopes[1] != 0.0)
    assert np.any(np.asarray(estimate[1]) != np.asarray(again[1]))


def in_crushing(bed, state, steps):
    """Platen force, power of contacts and rolling over speed, and force by the whole balance
    (N), at each of some steps of crushing."""
    dtype = state.time.dtype
    command = Command(*(jnp.asarray(value, dtype) for value in (-0.05, 0.0, 200.0, 4000.0)))

    def advance(state, _):
        before = eqx.tree_at(lambda s: s.energy, state, Ledger.zeros(dtype))
        after = step(bed, before, command)
        contacts = (after.energy.absorbed() - after.energy.background) / (0.05 * bed.time_step)
        return after, (after.wall_force[PLATEN], contacts, force_by_power(bed, state.motion, after))

    return jax.lax.scan(advance, state, None, length=steps)[1]


def test_the_power_balance_closes(packing, ordinary):
    """The whole balance to round-off; what contacts and rolling absorb is nearly all of it.

    Over 1500 steps (some 0.5 mm) at 50 mm/s; the rest is damping, weight and motion.
    """
    bed = build_bed(packing.spheres, SOIL, LAB.grid, NUMERICS)
    found = eqx.filter_jit(in_crushing)(bed, ordinary[2], 1500)
    force, contacts, balanced = (np.asarray(part) for part in found)
    assert force.mean() > 5.0
    assert np.abs(balanced - force).max() < 1e-6 * force.max()
    share = contacts.mean() / force.mean()
    print(f"contacts and rolling take {100 * share:.1f} % of the platen's power")
    assert share == pytest.approx(1.0, abs=0.05)
