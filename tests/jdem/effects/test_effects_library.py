"""The library of effects: single contacts in closed form, what is stated of each, settings.

Settings of the simulation are treated like effects, so that none is taken for physics.  A
setting's strength is ln of a factor, 0 in the base model.  Unlike an effect it changes how a trial
is set up, so it means another laboratory and possibly another packing.  No bed is simulated here.
"""

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.inference.parameters import FACTORS
from calibrate.simulation import Campaign
from jdem.apparatus.pair import SpherePair, drive_overlap
from jdem.core.smooth import Smoothing
from jdem.effects.base import About, AbstractEffect
from jdem.effects.capillary import CUTOFF, DECAY, CapillaryTension
from jdem.effects.cementation import STRAIN, Bonded
from jdem.effects.composite import EFFECTS, as_table
from jdem.engine.bed import Numerics
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters, particle_law
from jdem.packing.settling import neutral_soil
from jdem.packing.specimen import Specimen
from tests import ROOT
from tests.support.effect_lab import NUMERICS, SMALL, SOIL, assert_same, both_tests, lab_with

# ------------------------------------------------------------------ single contacts


@dataclass(frozen=True, eq=False)
class Trial:
    """All that a simulation of the tests starts from besides the soil and a seed.

    preparation is the soil that beds settle with (None: neutral).
    """

    specimen: Specimen
    tests: TestSequence
    numerics: Numerics
    preparation: SoilParameters | None = None

    def lab(self, effects: Sequence[AbstractEffect] = ()) -> VirtualLab:
        """The laboratory of this trial."""
        return VirtualLab.of(self.specimen, self.tests, self.numerics, effects)


class AbstractSetting(eqx.Module):
    """One numerical choice; `about` as for effects."""

    about: eqx.AbstractClassVar[About]

    @abc.abstractmethod
    def changed(self, trial: Trial, strength: float) -> Trial:
        """The trial with the setting times exp(strength)."""


class SmoothingWidth(AbstractSetting):
    """All widths of `jdem.core.smooth.Smoothing`; the laws as printed lie at -infinity."""

    about: ClassVar[About] = About(
        quantity="ln of the widths' factor",
        unit="1",
        typical=(math.log(0.25), 0.0),
        kind="numerical",
        one_sided=False,
        in_mould="any",
        free="any, friction's width most",
        confounders=("static_friction", "surface_energy"),
        source="to be measured",
    )

    def changed(self, trial: Trial, strength: float) -> Trial:
        widths = jax.tree.map(lambda w: w * math.exp(strength), trial.numerics.smoothing)
        return replace(trial, numerics=replace(trial.numerics, smoothing=widths))


class SimulatedRate(AbstractSetting):
    """The tests' simulated platen speeds; what is left of inertia lies above -infinity."""

    about: ClassVar[About] = About(
        quantity="ln of the simulated rates' factor",
        unit="1",
        typical=(math.log(0.5), 0.0),
        kind="numerical",
        one_sided=False,
        in_mould="stiffer if too fast",
        free="higher peak if too fast",
        confounders=("rate_dependence", "restitution"),
        source="to be measured",
    )

    def changed(self, trial: Trial, strength: float) -> Trial:
        return replace(trial, tests=trial.tests.at_rate(math.exp(strength)))


class SphereNumber(AbstractSetting):
    """Number of spheres in the same specimen; other beds, so compare means over packings."""

    about: ClassVar[About] = About(
        quantity="ln of the number's factor",
        unit="1",
        typical=(0.0, math.log(4)),
        kind="numerical",
        one_sided=False,
        in_mould="less deep with more spheres",
        free="less scatter with more spheres",
        confounders=("shear_modulus", "specimen_density"),
        source="to be measured",
    )

    def changed(self, trial: Trial, strength: float) -> Trial:
        specimen = trial.specimen
        other = replace(specimen, count=round(specimen.count * math.exp(strength)))
        ratio = other.mean_radius() / specimen.mean_radius()
        interval = trial.numerics.sample_time * ratio  # as the skin, which is in diameters
        numerics = replace(trial.numerics, sample_time=interval)
        tests = trial.tests.sampled(1 / ratio)
        return replace(trial, specimen=other, tests=tests, numerics=numerics)


class PreparationFriction(AbstractSetting):
    """Friction between the spheres while the bed settles; other beds from the same seeds."""

    about: ClassVar[About] = About(
        quantity="ln of the settling friction's factor",
        unit="1",
        typical=(math.log(0.5), math.log(2)),
        kind="numerical",
        one_sided=False,
        in_mould="looser fabric with more friction: softer",
        free="weaker with a looser fabric",
        confounders=("specimen_density", "shear_modulus"),
        source="to be measured",
    )

    def changed(self, trial: Trial, strength: float) -> Trial:
        soil = neutral_soil() if trial.preparation is None else trial.preparation
        friction = soil.static_friction * math.exp(strength)
        soil = eqx.tree_at(lambda s: s.static_friction, soil, friction)
        return replace(trial, preparation=soil)


class TimeStep(AbstractSetting):
    """The time step's safety factor."""

    about: ClassVar[About] = About(
        quantity="ln of the time step's factor",
        unit="1",
        typical=(math.log(0.5), 0.0),
        kind="numerical",
        one_sided=False,
        in_mould="none if small enough",
        free="none if small enough, chaos apart",
        confounders=("restitution",),
        source="to be measured",
    )

    def changed(self, trial: Trial, strength: float) -> Trial:
        safety = trial.numerics.safety * math.exp(strength)
        return replace(trial, numerics=replace(trial.numerics, safety=safety))


SETTINGS: dict[str, AbstractSetting] = {
    "smoothing_width": SmoothingWidth(),
    "simulated_rate": SimulatedRate(),
    "sphere_number": SphereNumber(),
    "preparation_friction": PreparationFriction(),
    "time_step": TimeStep(),
}


PAIR = SpherePair(2.5e-3)
DIAMETER = 5e-3
LAW = particle_law(SOIL, DIAMETER, Smoothing())


def test_capillary_tension_across_a_gap():
    """F0 at the touch and in contact, exp(-1) of it after one decay length, 0 at the cutoff."""
    stress, decay = 1e4, DECAY * DIAMETER
    law = CapillaryTension(stress).law(LAW, None)  # pyright: ignore[reportArgumentType]
    overlaps = jnp.asarray([0.0, -decay, -CUTOFF * decay, -1.0])

    @jax.jit
    @jax.vmap
    def force(overlap):
        return law.force(PAIR.contact(overlap, 0.0), law.memory((), float))[0]

    found = -force(overlaps).normal.hysteretic
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
