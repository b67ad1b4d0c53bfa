"""Another unit of force: modulus, surface energy, masses and the machine's forces times one factor.

Nothing moves differently, so a force's derivative in the logarithm of the factor is the force.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hand_made_beds import RADIUS, bed_of, quickly, soil_of, spheres_of, state_of

from jdem.core.smooth import Smoothing
from jdem.engine.loop import run
from jdem.engine.segment import LOWER, cell_segment, stack

TARGET = 0.5  # N
HEAP = RADIUS * np.array([[0, 0, 1.0], [2.02, 0, 1.0], [1.01, 1.75, 1.0], [1.01, 0.58, 2.65]])


@eqx.filter_jit
def pressed(log_unit):
    """Force and height, and the segment, of samples of four spheres pressed up to a force, then on
    without a target."""
    unit = jnp.exp(log_unit)
    spheres = spheres_of(4)
    soil = soil_of(shear_modulus=1e6 * unit, surface_energy=5.0 * unit, plasticity_ratio=0.3)
    step = bed_of(spheres, soil_of(shear_modulus=1e6, plasticity_ratio=0.3)).time_step
    bed = bed_of(spheres, soil, smoothing=Smoothing())
    bed = eqx.tree_at(lambda b: b.spheres.mass, bed, spheres.mass * unit)
    bed = eqx.tree_at(lambda b: b.time_step, bed, step)
    common = {"platen_speed": 0.02, "servo_width": 0.05 * unit, "damping": 200.0}
    programme = stack(
        [
            cell_segment(
                **common,
                force_target=TARGET * unit,
                tolerance=0.1 * unit,
                duration=1.0,
                platen=jnp.asarray(LOWER),
            ),
            cell_segment(**common, duration=0.01),
        ]
    )
    samples = run(bed, state_of(bed, HEAP), programme, jnp.asarray(50), 400).samples
    return (samples.platen_force, samples.platen_height), samples.segment


def test_forces_go_with_the_unit_and_displacements_do_not():
    pushed = quickly(lambda u, t: jax.jvp(pressed, (u,), (t,), has_aux=True))
    values, slopes, segment = pushed(0.0, 1.0)
    force, height = map(np.asarray, values)
    segment = np.asarray(segment)
    assert set(segment) == {-1, 0, 1}, "both movements ended"
    assert force[segment == 0].max() > 0.8 * TARGET
    assert force[segment == 1].max() > 2 * TARGET
    np.testing.assert_allclose(slopes[0], force, rtol=1e-6, atol=1e-6 * force.max())
    np.testing.assert_allclose(slopes[1], 0.0, atol=1e-9 * height[0])
