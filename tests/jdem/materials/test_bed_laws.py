"""Beds that follow laws other than EEPA: what a soil of each holds, and what its spheres do."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.pair import SpherePair
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.effects.base import with_contacts_scaled
from jdem.engine.bed import Numerics, plan_grid, reach_of
from jdem.engine.loop import run
from jdem.engine.segment import Segment, stack
from jdem.laws.composite import ContactLaw
from jdem.laws.jkr import JKR
from jdem.materials.catalogue import (
    EVERY,
    REFERENCE_DIAMETER,
    WHOLE,
    law_of,
    needed_by,
    own_values,
    parameters_of,
    soil_of,
)
from jdem.materials.contact_laws import BED_LAWS, CONTACT_LAWS
from jdem.materials.conventions import CONVENTIONS, DEFAULT
from jdem.materials.soil import SoilParameters, particle_law, wall_law
from jdem.mechanics.contact import lens_area
from jdem.packing.specimen import Specimen
from tests.support.hand_made_beds import (
    CAPACITY,
    DENSITY,
    GRAVITY,
    RADIUS,
    bed_of,
    last,
    listed,
    spheres_of,
    state_of,
)

NEEDED = {"gamma": 2.0, "cohesion": 5e4, "yield_strength": 5e6}
every_law = pytest.mark.parametrize("law", WHOLE)


def soil(law, **values):
    known = parameters_of(law)
    given = {"shear_modulus": 2e6, "rolling_friction": 0.1, "platen_friction": 0.5, **NEEDED}
    return soil_of(law, **{name: x for name, x in given.items() if name in known} | values)


# ------------------------------------------------------------------ which law has what


def test_every_law_of_beds_has_its_own_parameters():
    assert set(WHOLE) == set(BED_LAWS) - set(CONVENTIONS)
    for law in WHOLE:
        names = set(parameters_of(law))
        assert {entry.name for entry in CONTACT_LAWS[law].parameters} <= names <= set(EVERY)
        assert not names & {
            "surface_energy",
            "plasticity_ratio",
            "slope_exponent",
            "pull_off_force",
        }
        assert set(needed_by(law)) <= set(NEEDED) & names
    assert set(parameters_of(DEFAULT)) == set(SoilParameters().values())
    assert all(parameters_of(name) is parameters_of(DEFAULT) for name in CONVENTIONS)
    assert "shear_modulus" not in parameters_of("hysteretic_cohesion")


@every_law
def test_a_soil_has_the_parameters_of_its_law_alone(law):
    made = soil(law)
    assert law_of(made) == law
    assert set(own_values(made)) == set(parameters_of(law))
    assert all(parameters_of(law)[n].accepted(float(x)) for n, x in own_values(made).items())
    with pytest.raises(ValueError, match=f"{law} has no surface_energy"):
        soil(law, surface_energy=1.0)
    for name in needed_by(law):
        with pytest.raises(ValueError, match=f"{law} needs {name}"):
            soil_of(law, **{other: NEEDED[other] for other in needed_by(law) if other != name})


def test_a_law_of_ones_own_counts_as_eepa():
    own = SoilParameters(conventions=lambda parts: CONVENTIONS[DEFAULT](parts))
    assert law_of(own) is None and own_values(own) == own.values()
    assert law_of(SoilParameters()) == DEFAULT


@every_law
def test_a_fit_looks_only_where_the_law_accepts(law):
    for entry in parameters_of(law).values():
        if entry.search is not None:
            assert entry.accepted(entry.search.low) and entry.accepted(entry.search.high)


@every_law
def test_the_exponent_of_eepa_has_no_say(law):
    """Nor have the other parameters that the law has not."""
    made = soil(law)
    other = eqx.tree_at(lambda s: (s.surface_energy, s.plasticity_ratio), made, (1e3, 0.1))
    other = eqx.tree_at(lambda s: s.stiffness_factor, other, 7.0)
    other = SoilParameters(**{**vars(other), "slope_exponent": 1.5})
    for of in (particle_law, wall_law):
        laws = [of(each, jnp.asarray(5e-3), Smoothing()) for each in (made, other)]
        assert eqx.tree_equal(*laws)


# ------------------------------------------------------------------ size, reach, areas


def forces(made, scale):
    """Normal force (N) over squares at the same overlaps per radius, for spheres of this scale."""
    law = particle_law(made, jnp.asarray(2 * scale * RADIUS), Smoothing.sharp())
    pair, zero = SpherePair(jnp.asarray(scale * RADIUS)), jnp.asarray(0.0)
    history, found = law.memory((), float), []
    for share in (0.0, 1e-3, 2e-2, 5e-3, -1e-4):
        contact = pair.contact(jnp.asarray(share * scale * RADIUS), zero, 1e-6)
        force, history = law.force(contact, history)
        found.append(float(force.normal.hysteretic) / scale**2)
    return np.array(found)


@every_law
def test_a_bed_of_larger_spheres_is_the_same_but_for_its_scale(law):
    """Stresses stay, gamma growing with the diameter as EEPA's surface energy does."""
    made = soil(law)
    assert np.any(forces(made, 1.0) != 0)
    assert forces(made, 3.0) == pytest.approx(forces(made, 1.0), rel=1e-9, abs=1e-12)


@every_law
def test_effects_scale_all_forces_of_the_law(law):
    """At the same displacements, whatever the law's parameters are called."""
    harder = with_contacts_scaled(soil(law), jnp.asarray(1.7))
    assert forces(harder, 1.0) == pytest.approx(1.7 * forces(soil(law), 1.0), rel=1e-9)


def test_gamma_is_stated_at_the_reference_diameter():
    """Pull-off 3 pi gamma R*, of two spheres 5 mm wide."""
    law = particle_law(soil("jkr"), jnp.asarray(REFERENCE_DIAMETER), Smoothing())
    assert isinstance(law, ContactLaw) and isinstance(law.normal, JKR)
    most = law.normal.stiffness.pull_off(jnp.asarray(REFERENCE_DIAMETER / 4))
    assert float(most) == pytest.approx(3 * np.pi * NEEDED["gamma"] * REFERENCE_DIAMETER / 4)


def test_only_jkr_reaches_across_a_gap():
    sizes = 2 * RADIUS, 1.2 * RADIUS
    for law in BED_LAWS:
        made = SoilParameters(conventions=CONVENTIONS[law]) if law in CONVENTIONS else soil(law)
        assert (reach_of(made, *sizes) > 0) == (law == "jkr")
    work, modulus, radius = 2 * NEEDED["gamma"], 2e6 / 0.7, 0.6 * RADIUS  # reference is 2 RADIUS
    torn = np.cbrt(np.pi * work * radius**2 / (8 * modulus))
    assert reach_of(soil("jkr"), *sizes) == pytest.approx(3 * torn**2 / radius, rel=1e-6)


def test_lists_hold_what_jkr_holds_across_a_gap():
    """Two spheres that touched, nine tenths of the way to where they tear off: the list is rebuilt,
    and the contact pulls on; without the law's reach it would be lost."""
    spheres, made = spheres_of(2), soil("jkr")
    reach = reach_of(made, 2 * RADIUS, RADIUS)
    for listed_to, holds in ((reach, True), (0.0, False)):
        size = 2, RADIUS, RADIUS, (8 * RADIUS, 8 * RADIUS)
        grid = plan_grid(*size, Numerics(skin=1e-4), reach=listed_to)
        bed = replace(bed_of(spheres, made), grid=grid)
        apart = [[0.0, 0.0, 5 * RADIUS], [0.0, 0.0, 7 * RADIUS + 0.9 * reach]]
        state = state_of(bed, [[0.0, 0.0, 5 * RADIUS], [0.0, 0.0, 6.99 * RADIUS]])
        state = listed(bed, state)
        touched = eqx.tree_at(lambda s: s.pairs.history.normal, state, jnp.ones(grid.pairs))
        moved = Vector.from_rows(jnp.asarray(apart))
        moved = eqx.tree_at(lambda s: s.motion.position, touched, moved)
        kept = listed(bed, moved).pairs
        assert bool(np.any(np.asarray(kept.alive * kept.history.normal) > 0)) == holds


def test_two_r_star_is_right_enough_an_area_for_spheres_of_a_bed():
    """Radii that differ by all of a specimen's spread, against the circle of intersection."""
    spread = Specimen.__dataclass_fields__["spread"].default
    one, two = (1 + spread) * RADIUS, (1 - spread) * RADIUS
    effective = one * two / (one + two)
    for share, error in ((0.01, 3e-4), (0.03, 8e-4), (0.1, 3e-3)):
        overlap = share * 2 * effective
        apart = one + two - overlap
        along = (apart**2 + one**2 - two**2) / (2 * apart)
        contact = SpherePair(jnp.asarray(RADIUS)).contact(jnp.asarray(overlap), 0.0, 1e-6)
        contact = eqx.tree_at(lambda c: c.radius, contact, jnp.asarray(effective))
        area = float(lens_area(cast(contact, jnp.float64)))
        assert area == pytest.approx(np.pi * (one**2 - along**2), rel=error)


# ------------------------------------------------------------------ beds


@pytest.mark.slow
@every_law
def test_the_base_carries_the_weight_of_what_rests_on_it(law):
    """Three spheres and one on top of them, after they have come to rest."""
    angle = 2 * np.pi * np.arange(3) / 3
    ring = 2.02 * RADIUS / np.sqrt(3)
    below = [(ring * np.cos(a), ring * np.sin(a), 1.001 * RADIUS) for a in angle]
    spheres = spheres_of(4)
    bed = bed_of(spheres, soil(law), smoothing=Smoothing())
    state = state_of(bed, [*below, (0.0, 0.0, 2.7 * RADIUS)])
    programme = stack([Segment(duration=60 * 100 * bed.time_step, damping=100.0)])
    record = eqx.filter_jit(run)(bed, state, programme, jnp.asarray(100), CAPACITY)
    assert not record.overflow_of(bed.grid)
    weight = 4 * DENSITY * 4 / 3 * np.pi * RADIUS**3 * GRAVITY
    assert last(record.samples).base_force == pytest.approx(weight, rel=1e-3)
    assert last(record.samples).kinetic_energy < 1e-6 * weight * RADIUS
    assert record.state.motion.position.z[3] > 2 * RADIUS  # still on top
