"""The library of effects: single contacts in closed form, what is stated of each, settings.

No bed is simulated here.
"""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.inference.parameters import FACTORS
from calibrate.simulation import Campaign
from jdem.apparatus.pair import SpherePair, drive_overlap
from jdem.core.smooth import Smoothing
from jdem.effects.capillary import CUTOFF, DECAY, CapillaryTension
from jdem.effects.cementation import STRAIN, Bonded
from jdem.effects.composite import EFFECTS, as_table
from jdem.materials.soil import particle_law
from tests import ROOT
from tests.support.effect_lab import NUMERICS, SMALL, SOIL, assert_same, both_tests, lab_with
from tests.support.settings import SETTINGS, Trial

# ------------------------------------------------------------------ single contacts

PAIR = SpherePair(2.5e-3)
DIAMETER = 5e-3
LAW = particle_law(SOIL, DIAMETER, Smoothing())


def test_capillary_tension_across_a_gap():
    """F0 at the touch and in contact, exp(-1) of it after one decay length, 0 at the cutoff."""
    stress, decay = 1e4, DECAY * DIAMETER
    law = CapillaryTension(stress).law(LAW, None)  # pyright: ignore[reportArgumentType]
    overlaps = jnp.asarray([0.0, -decay, -CUTOFF * decay, -1.0])
    found = -jax.vmap(lambda d: law.force(PAIR.contact(d, 0.0), law.memory((), float)))(overlaps)[
        0
    ].normal.hysteretic
    tail = math.exp(-CUTOFF)
    shares = [1.0, (math.exp(-1) - tail) / (1 - tail), 0.0, 0.0]
    np.testing.assert_allclose(found, stress * DIAMETER**2 * np.array(shares), atol=1e-15)
    reach = CapillaryTension().reach(DIAMETER)
    assert reach == pytest.approx(CUTOFF * decay)
    assert lab_with(CapillaryTension()).grid.reach > 0.0


def bond_path(stress, openings):
    """Tension (N) of a bond beyond the law's own force along a path of openings (m).

    The bond grows at an overlap of 10 um.
    """
    grown = 1e-5
    overlaps = jnp.concatenate([jnp.asarray([grown]), grown - jnp.asarray(openings)])
    growing = jnp.arange(len(overlaps)) == 0

    def advance(history, step):
        overlap, growing = step
        law = Bonded(LAW, stress, growing.astype(float))
        force, history = law.force(PAIR.contact(overlap, 0.0 * overlap), history)
        return history, force.normal.total()

    zeros = Bonded(LAW, stress, 0.0).memory((), float)
    forces = jax.lax.scan(advance, zeros, (overlaps, growing))[1]
    return np.asarray(drive_overlap(LAW, PAIR, overlaps) - forces)[1:]


def test_a_bond_breaks_for_good():
    """Linear to T at w, back along the damaged line, nothing after 2 w, nothing in compression."""
    stress, width = 5e4, STRAIN * DIAMETER
    strength = stress * DIAMETER**2
    path = np.array([0.5, 1.0, 1.5, 0.75, -0.2, 1.5, 2.0, 0.5, 1.0]) * width
    damaged = (2 - 1.5) / 1.5
    shares = [0.5, 1.0, 1.5 * damaged, 0.75 * damaged, 0.0, 1.5 * damaged, 0.0, 0.0, 0.0]
    found = bond_path(stress, path)
    np.testing.assert_allclose(found, strength * np.array(shares), atol=1e-12)


# ------------------------------------------------------------------ library and settings


def test_confounders_are_known_names_and_never_the_effect_itself():
    known = {*EFFECTS, *SETTINGS, *FACTORS, "shear_modulus", "pull_off_force", "slope_exponent"}
    for name, entry in [*EFFECTS.items(), *SETTINGS.items()]:
        assert set(entry.about.confounders) <= known - {name}
        assert entry.about.typical[0] < entry.about.typical[1]


def test_a_campaign_tells_effects_of_equal_strength_apart(tmp_path):
    labs = [lab_with(EFFECTS[name](0.1)) for name in ("wall_friction", "platen_friction")]
    keys = [Campaign(lab, SMALL, tmp_path).key(SOIL, 0) for lab in labs]
    assert keys[0] != keys[1]


def test_the_documented_table_is_the_librarys():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    for library in (EFFECTS, SETTINGS):
        assert as_table({name: entry.about for name, entry in library.items()}) in page


@pytest.mark.parametrize("name", SETTINGS)
def test_a_setting_changes_what_it_says_and_nothing_at_strength_zero(name):
    trial = Trial(SMALL, both_tests(), NUMERICS)
    setting = SETTINGS[name]
    same, doubled = (setting.changed(trial, s) for s in (0.0, math.log(2.0)))
    assert same.specimen == trial.specimen
    assert_same((same.tests, same.numerics.smoothing), (trial.tests, trial.numerics.smoothing))
    assert same.numerics.safety == trial.numerics.safety
    assert same.lab().grid == trial.lab().grid
    read = {
        "smoothing_width": lambda t: float(t.numerics.smoothing.slip),
        "simulated_rate": lambda t: float(t.tests["confined"].simulated_rate),
        "sphere_number": lambda t: t.specimen.count,
        "preparation_friction": lambda t: float(t.preparation.static_friction),
        "time_step": lambda t: t.numerics.safety,
    }[name]
    assert read(doubled) == pytest.approx(2 * read(same))
    assert replace(doubled, preparation=None).lab().capacity > 0
