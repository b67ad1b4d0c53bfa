"""Virtual power: values untouched, the balance closes, and slopes where the motion is given.

Two spheres side by side between two platens, half way up, without gravity and strongly damped:
forces at both ends are equal, and their centres move at half the platen's speed whatever the
parameters are.  There frozen motion is no approximation, and the derivative must be the slope of
the response, through loading, unloading and reload.  What freezing costs in a bed is the
audit's business (docs/derivatives.md).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.inference.parameters import FACTORS
from calibrate.io.soil import with_values
from jdem.boundaries.base import FAR
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.loop import run, start
from jdem.engine.segment import cell_segment, stack
from jdem.sensitivity.virtual_power import FrozenMotion
from tests.support.hand_made_beds import RADIUS, bed_of, quickly, soil_of, spheres_of

pytestmark = pytest.mark.thorough

NAMES = (*FACTORS, "shear_modulus")
CLAY = {
    "surface_energy": 20.0,
    "plasticity_ratio": 0.5,
    "rolling_friction": 0.1,
    "restitution": 0.4,
}
HEIGHT = 2 * RADIUS
SPEED = 0.01  # m/s
STEP, STEPS, CAPACITY = 2e-6, 50, 96  # s; time steps in a sample; samples
STRONG = 1e12  # 1/s; nothing moves but with the affine motion
LEG = 10 * STEPS * STEP  # s; 2e-6 m of travel


# ------------------------------------------------------------------ given motion


def moves(*speeds, duration=LEG):
    """The platen moves at these speeds (m/s), one leg each."""
    return [cell_segment(platen_speed=v, duration=duration, damping=STRONG) for v in speeds]


STILL = moves(0.0, duration=STEPS * STEP)  # one sample in which nothing happens


@eqx.filter_jit
@eqx.debug.assert_max_traces(max_traces=2)
def pressed(log_values, programme, freezes):
    """Platen forces (N) on both spheres; `freezes`: the motion is frozen from segment 1 on.

    Two programs, because all programmes of this file have six segments.
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
    frozen = FrozenMotion(1, carried=True) if freezes else None
    samples = run(bed, state, programme, jnp.asarray(STEPS), CAPACITY, derivative=frozen).samples
    return samples.platen_force


def centre():
    soil = soil_of(**CLAY)
    return jnp.log(jnp.asarray([float(getattr(soil, name)) for name in NAMES]))


@quickly
def frozen(log_values, programme):
    """Slopes and values of the platen force, motion frozen."""

    def both(x):
        force = pressed(x, programme, True)
        return force, force

    return jax.jacfwd(both, has_aux=True)(log_values)


def slopes(programme):
    """Derivatives (samples, p) of the platen force (N) per unit of ln p, motion frozen; values are
    checked to be those of a motion that is not, but for round-off of another program."""
    slope, force = frozen(centre(), programme)
    np.testing.assert_allclose(force, pressed(centre(), programme, False), rtol=1e-12, atol=1e-15)
    return np.asarray(slope)


def differences(programme, step=1e-6):
    point = centre()
    shifts = step * jnp.eye(len(NAMES))
    pairs = [
        (pressed(point + s, programme, False), pressed(point - s, programme, False)) for s in shifts
    ]
    return np.stack([np.asarray(up - down) / (2 * step) for up, down in pairs], axis=-1)


@pytest.fixture(scope="module")
def cycle():
    """Down, partly up, down again and further: virgin loading, unloading, reload."""
    return stack([*STILL, *moves(SPEED, SPEED, -0.6 * SPEED, 0.4 * SPEED, SPEED)])


@pytest.mark.rare
@pytest.mark.slow
def test_given_motion_makes_virtual_power_exact(cycle):
    """Central differences of 1e-6 in ln p leave 1e-6 of the largest slope.

    Without the first sample of a leg: in its first step the platen has its new speed and
    the spheres have the old one, so the dashpots at both ends differ.
    """
    expected, found = differences(cycle), slopes(cycle)
    rows = 1 + np.flatnonzero(np.arange(50) % 10)  # after the still one
    assert np.all(pressed(centre(), cycle, False)[rows] != 0)
    largest = np.abs(expected).max(axis=0)
    for number, name in enumerate(NAMES):
        error = np.abs(found - expected)[rows, number].max()
        assert error <= 1e-5 * largest[number] + 1e-9, name


@pytest.mark.rare
@pytest.mark.slow
def test_what_has_no_influence_has_no_slope(cycle):
    """Nothing slides or rolls here."""
    idle = [NAMES.index(name) for name in ("static_friction", "rolling_friction")]
    assert np.all(slopes(cycle)[:, idle] == 0.0)


@pytest.mark.rare
@pytest.mark.slow
def test_a_stage_before_it_is_part_of_the_effect():
    """A servo stops at 0.1 N, at an overlap that depends on the soil; then the motion is given.

    Dropping what the first stage made of the bed gives another slope: stiffer soils would
    be stronger at the same overlap.  So does freezing the motion before the servo moves, which
    a still sample ahead of it brings about.
    """
    servo = cell_segment(
        platen_speed=SPEED, force_target=0.1, servo_width=0.02, tolerance=4e-3, damping=STRONG,
        duration=40 * STEPS * STEP,
    )  # fmt: skip
    programme = stack([servo, *moves(*[SPEED] * 5)])
    expected, found = differences(programme, 1e-7), slopes(programme)
    rows = np.flatnonzero(np.asarray(pressed(centre(), programme, False)))[-49:-40]
    modulus = NAMES.index("shear_modulus")
    assert found[rows] == pytest.approx(expected[rows], rel=1e-4, abs=1e-4)
    everything = slopes(stack([*STILL, servo, *moves(*[SPEED] * 4)]))[rows + 1, modulus]
    assert np.all(everything > 1.5 * expected[rows, modulus])
