"""Beds that follow laws other than EEPA: what a soil of each holds, and what its spheres do."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.pair import SpherePair
from jdem.apparatus.repose import LiftedCylinder, tube
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.effects.base import with_contacts_scaled
from jdem.engine.bed import Numerics, plan_grid, reach_of
from jdem.engine.loads import pair_loads
from jdem.engine.loop import run
from jdem.engine.schedule import Joining, Unchanging
from jdem.engine.segment import Segment, stack
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab, simulate
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
from jdem.materials.contact_laws import BED_LAWS, BONDED_WITHIN, CONTACT_LAWS
from jdem.materials.conventions import CONVENTIONS, DEFAULT
from jdem.materials.soil import SoilParameters, particle_law, wall_law
from jdem.mechanics.contact import lens_area
from jdem.packing.composite import prepare
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

BOND = {
    "normal_stiffness": 1e9,
    "shear_stiffness": 4e8,
    "tensile_strength": 2e5,
    "shear_strength": 1.5e5,
}
NEEDED = {"gamma": 2.0, "cohesion": 5e4, "yield_strength": 5e6, **BOND}
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
    """Normal force (N) over squares at the same overlaps per radius, for spheres of this scale;
    bonds form as they touch."""
    law = particle_law(made, jnp.asarray(2 * scale * RADIUS), Smoothing.sharp())
    law = law.joining(jnp.asarray(True))
    pair, zero = SpherePair(jnp.asarray(scale * RADIUS)), jnp.asarray(0.0)
    history, found = law.memory((), float), []
    for share in (0.0, 1e-3, 2e-2, 5e-3, -1e-4):
        contact = pair.contact(jnp.asarray(share * scale * RADIUS), zero, 1e-6)
        force, history = law.force(contact, history)
        found.append(float(force.normal.hysteretic) / scale**2)
    return np.array(found)


@every_law
def test_a_bed_of_larger_spheres_is_the_same_but_for_its_scale(law):
    """Stresses stay, gamma growing with the diameter as EEPA's surface energy does, and stiffnesses
    of bonds falling with it."""
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


def test_only_jkr_and_bonds_reach_across_a_gap():
    sizes = 2 * RADIUS, 1.2 * RADIUS
    for law in BED_LAWS:
        made = SoilParameters(conventions=CONVENTIONS[law]) if law in CONVENTIONS else soil(law)
        assert (reach_of(made, *sizes) > 0) == (law in ("jkr", "parallel_bond"))
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


# ------------------------------------------------------------------ bonds

AREA = np.pi * RADIUS**2
MASS = DENSITY * 4 / 3 * np.pi * RADIUS**3
# m/s; speed of two bonded spheres apart at which all of it stretches the bond to its strength
BREAKING = BOND["tensile_strength"] * np.sqrt(AREA / BOND["normal_stiffness"] / (MASS / 2))
elastic = {"restitution": 1.0, "static_friction": 0.0, "rolling_friction": 0.0}
joined = eqx.filter_jit(eqx.debug.assert_max_traces(run, max_traces=1))


def bonded(places, speeds, steps=100):
    """Whole bonds, broken ones, and speeds (m/s) of three spheres along a line, after they were
    left to themselves for 30 samples of so many steps; places are in radii."""
    spheres = spheres_of(3)
    bed = bed_of(spheres, soil("parallel_bond", **elastic), gravity=0.0, safety=0.02)
    rows = [np.outer(each, [1.0, 0.0, 0.0]) for each in (np.array(places) * RADIUS, speeds)]
    state = state_of(bed, rows[0] + [0.0, 0.0, 9 * RADIUS], rows[1])
    programme = stack([Segment(duration=30 * steps * bed.time_step)])
    around = Joining(Unchanging(), 0)
    record = joined(bed, state, programme, jnp.asarray(steps), CAPACITY, around)
    assert not record.overflow_of(bed.grid)
    pairs, motion = record.state.pairs, record.state.motion
    whole, broken = (
        float(jnp.sum(pairs.alive * each))
        for each in (pairs.history.bond.whole(), pairs.history.bond.broken)
    )
    return whole, broken, np.asarray(motion.velocity.x), record


def test_two_spheres_part_at_the_work_that_breaks_their_bond():
    for share, holds in ((0.99, True), (1.01, False)):
        speed = share * BREAKING / 2
        whole, broken, _, record = bonded([0, 2, 9], [-speed, speed, 0.0])
        assert (whole, broken) == ((1, 0) if holds else (0, 1))
        way = np.ptp(np.asarray(record.state.motion.position.x)[:2])
        assert (way < 2.2 * RADIUS) == holds


def test_the_count_of_bonds_falls_at_the_load_that_breaks_one():
    """Two spheres swing apart: load over strength is 1.2 sin(omega t), of a step before."""
    share, steps = 1.2, 2
    speed = share * BREAKING / 2
    samples = bonded([0, 2, 9], [-speed, speed, 0.0], steps)[3].samples
    time, count = (np.asarray(each)[np.asarray(samples.segment) >= 0]
                   for each in (samples.time, samples.bonds))  # fmt: skip
    rate = np.sqrt(BOND["normal_stiffness"] * AREA / (MASS / 2))
    load = share * np.sin(rate * (time - time[0] / steps))
    held = int(count.sum())
    assert count.tolist() == [1.0] * held + [0.0] * (len(count) - held)
    assert load[held - 1] < 1 <= load[held] < load[held - 1] + 0.04


def test_bonds_form_at_once_where_spheres_are_near_and_never_later():
    """The second sphere is a hundredth of a radius away, less a little; the third one comes."""
    gap = 0.99 * BONDED_WITHIN / 2
    whole, broken, speeds, _ = bonded([0, 2 + gap, 4.1 + gap], [0.0, 0.0, -1.0])
    assert (whole, broken) == (1, 0) and speeds[2] > 0
    beyond = 1.01 * BONDED_WITHIN / 2
    assert bonded([0, 2 + beyond, 9], [0.0, 0.0, 0.0])[:2] == (0, 0)


def test_a_broken_bond_does_not_come_back():
    """Two spheres part, a third one drives the first into the second: they swap their speeds."""
    parts = 1.05 * BREAKING / 2
    left = np.sqrt(parts**2 - (BREAKING / 2) ** 2)
    whole, _, speeds, _ = bonded([0, 2, -3.5], [-parts, parts, 4.0])
    assert whole == 0
    assert speeds == pytest.approx([left, 4.0, -left], rel=1e-2)


@pytest.mark.slow
def test_a_bond_in_a_bed_is_as_wide_as_the_smaller_sphere_and_turns_with_its_pair():
    """Two spheres of different size that spin together about their line, the one shifted before:
    the force turns with them."""
    spheres = spheres_of(2, spread=0.3)
    bed = bed_of(spheres, soil("parallel_bond", **elastic), gravity=0.0, safety=0.02)
    law, spin = bed.particle_law, 0.3 * np.pi / bed.time_step
    bed = replace(bed, particle_law=law.joining(jnp.asarray(True)))
    apart = float(jnp.sum(spheres.radius))
    state = state_of(bed, [[0.0, 0.0, RADIUS], [0.0, 0.0, RADIUS + apart]])
    state = listed(bed, state)
    rows = spheres.rows(state.motion)
    sheared = rows.at[1, 3].set(1e-3).at[1, 5].set(0.0)
    turned = rows.at[:, 8].set(spin)
    _, pairs = pair_loads(bed, rows, state.pairs)
    before, pairs = pair_loads(bed, sheared, pairs)
    after, _ = pair_loads(bed, turned, pairs)
    force, later = (np.asarray(each.rows)[1, :2] for each in (before, after))
    size = float(jnp.min(spheres.radius))
    shear = BOND["shear_stiffness"] * np.pi * size**2 * 1e-3 * float(bed.time_step)
    assert -force[0] == pytest.approx(shear, rel=1e-9) and abs(force[1]) < 1e-9 * shear
    cosine, sine = np.cos(0.3 * np.pi), np.sin(0.3 * np.pi)
    assert later == pytest.approx([-shear * cosine, -shear * sine], rel=1e-9)


def test_walls_have_no_bonds():
    """Nor have spheres of a bed in which nothing lets bonds form."""
    plain, made = (soil(law) for law in ("hertz_mindlin", "parallel_bond"))
    for of in (particle_law, wall_law):
        laws = [of(each, jnp.asarray(2 * RADIUS), Smoothing()) for each in (plain, made)]
        pair, found = SpherePair(jnp.asarray(RADIUS)), []
        for law in laws:
            history, rows = law.memory((), float), []
            for share in (0.0, 1e-3, 1e-4, -1e-4):
                contact = pair.contact(jnp.asarray(share * RADIUS), jnp.asarray(0.0), 1e-6)
                force, history = law.force(contact, history)
                rows.append(float(force.normal.total()))
            found.append(rows)
        assert found[0] == pytest.approx(found[1], rel=1e-12) and found[0][3] == 0.0


TESTS = (
    ConfinedCompression(simulated_rate=0.2, force_low=20.0, force_high=60.0, stroke=0.02),
    UnconfinedCompression(simulated_rate=0.3, stroke=0.008),
)


def test_bonds_form_as_the_mould_opens_or_as_the_last_test_begins():
    confined, unconfined = TESTS
    again = replace(confined, name="again")
    tool = LiftedCylinder(tube=tube(0.04, 0.06))
    for tests, movement in (
        ((confined,), 0),
        ((unconfined,), 0),
        ((confined, unconfined), 3),
        ((confined, again), 3),
        ((confined, tool), 3),
        ((confined, unconfined, replace(unconfined, name="again")), 3),
    ):
        assert TestSequence(tests).joining == movement


@pytest.mark.slow
def test_a_bonded_specimen_is_stronger_and_loses_bonds():
    """60 spheres, pressed in their mould and crushed without it: bonds form in between, and the
    pressing does not know them.  Strong bonds hold, weak ones break and carry less, those that are
    next to nothing leave a heap."""
    specimen, sequence = Specimen(diameter=0.04, height=0.06, count=60), TestSequence(TESTS)
    packing = prepare(specimen, 0)
    strengths = (1e6, 2e5, 5e4, 1e3)
    made = [soil("parallel_bond", tensile_strength=s, shear_strength=s) for s in strengths]
    reach = 1.05 * reach_of(made[0], 2 * specimen.mean_radius(), specimen.max_radius())
    lab = VirtualLab.of(specimen, sequence, Numerics(), reach=reach)
    found = [simulate(lab, packing, each) for each in made]
    assert not any(bool(each.failed) for each in found)
    forces = [float(each.observables["unconfined"]["crushing_force"]) for each in found]
    assert forces[0] > 1.2 * forces[1] and forces[1] > 2 * forces[2] > 2 * forces[3] > 0
    depths = [float(each.observables["confined"]["depression_depth"]) for each in found]
    assert np.ptp(depths) == 0.0
    intact = [
        float(jnp.sum(pairs.alive * pairs.history.bond.whole()))
        for pairs in (each.record.state.pairs for each in found)
    ]
    assert intact[0] > intact[1] > intact[2] > intact[3] == 0
    for each, left in zip(found, intact, strict=True):
        before, counts = (counted(each, test) for test in ("confined", "unconfined"))
        assert len(before) and not before.any()
        assert np.all(np.diff(counts) <= 0) and counts[-1] == left
    assert counted(found[1], "unconfined")[0] > intact[1]


def counted(outcome, test):
    """Whole bonds at each row of a test's curve."""
    rows = np.asarray(outcome.curves[test].valid) > 0
    return np.asarray(outcome.channels[test]["intact_bonds"])[rows]
