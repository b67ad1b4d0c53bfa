"""The hysteretic spring with linear cohesion against its closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.pair import collide, drive_overlap, overlap_path
from jdem.boundaries.composite import BASE
from jdem.core.smooth import Smoothing
from jdem.materials.catalogue import soil_with
from jdem.materials.soil import wall_law
from tests.support.hand_made_beds import advanced, bed_of, spheres_of, state_of
from tests.support.law_cases import MOST, PAIR, RADIUS, law_of

YIELD, RESTITUTION, COHESION = 8e6, 0.4, 2e5
K1 = 5 * RADIUS / 2 * YIELD
K2 = K1 / RESTITUTION**2
RESIDUAL = (1 - RESTITUTION**2) * MOST  # m, after loading to MOST


def law(**values):
    known = {"yield_strength": YIELD, "restitution": RESTITUTION, "cohesion": 0.0}
    return law_of(soil_with("hysteretic", reference_diameter=2 * RADIUS, **{**known, **values}))


def force_at_end(turns, **values):
    return float(drive_overlap(law(**values), PAIR, overlap_path(jnp.asarray(turns), 50))[-1])


@pytest.mark.parametrize(
    ("turns", "expected"),
    [
        ([MOST], K1 * MOST),
        ([MOST, 0.9 * MOST], K2 * (0.9 * MOST - RESIDUAL)),
        ([MOST, RESIDUAL], 0.0),
        ([MOST, 0.5 * RESIDUAL], 0.0),
        ([MOST, 0.5 * RESIDUAL, 0.5 * RESIDUAL + 1e-6], K2 * 1e-6),  # d0 followed the overlap
        ([MOST, 0.9 * MOST, 0.95 * MOST], K2 * (0.95 * MOST - RESIDUAL)),
        ([MOST, 0.9 * MOST, 1.3 * MOST], K1 * 1.3 * MOST),  # back on the loading line
    ],
)
def test_the_spring_follows_its_lines(turns, expected):
    assert force_at_end(turns) == pytest.approx(expected, rel=1e-9, abs=1e-9 * K1 * MOST)


def test_cohesion_is_its_density_times_the_area():
    pulled = force_at_end([MOST, RESIDUAL], cohesion=COHESION)
    area = np.pi * (RADIUS * RESIDUAL - RESIDUAL**2 / 4)
    assert pulled == pytest.approx(-COHESION * area, rel=1e-9)
    soil = soil_with("hysteretic", cohesion=COHESION, wall_adhesion=0.25)
    assert float(wall_law(soil, 1e-3, Smoothing()).normal.cohesion) == 0.25 * COHESION


@pytest.mark.parametrize("restitution", [0.3, 0.7, 0.95])
def test_a_collision_rebounds_with_the_coefficient_of_restitution(restitution):
    """Whatever its speed: that is what K2 = K1/e^2 is for (Walton and Braun 1986)."""
    fast = law(restitution=restitution)
    step = 0.005 * float(np.sqrt(PAIR.effective_mass() / (K1 / restitution**2)))
    for speed in (0.02, 0.3):
        found = float(jax.jit(collide, static_argnums=4)(fast, PAIR, speed, step, 3000))
        assert found == pytest.approx(restitution, rel=5e-3)


def test_the_dashpot_acts_besides():
    step = 0.01 * float(np.sqrt(PAIR.effective_mass() / K2))
    damped = float(collide(law(damping_factor=1.0), PAIR, 0.1, step, 3000))
    assert damped < 0.7 * RESTITUTION


def test_a_bed_of_it_comes_to_rest():
    soil = soil_with("hysteretic", yield_strength=1e6, platen_friction=0.5, cohesion=1e3)
    bed = bed_of(spheres_of(2), soil, skin=20.0)
    state = state_of(bed, [[0.0, 0.0, 1.0 * RADIUS], [0.0, 0.0, 3.001 * RADIUS]])
    final, _ = advanced(bed, state, 3000, 300.0)
    weight = 9.81 * float(jnp.sum(bed.spheres.mass))
    assert float(final.wall_force[BASE]) == pytest.approx(weight, rel=1e-2)
    assert float(final.pairs.history.normal.max()) > 0
