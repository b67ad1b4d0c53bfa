"""Settings of the simulation, treated like effects so that none is taken for physics.

A setting's strength is ln of a factor, 0 in the base model.  Unlike an effect it changes how
a trial is set up, so it means another laboratory and possibly another packing: its slope is
the difference of two simulations.  A new setting is one class and one line in SETTINGS.
"""

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import equinox as eqx
import jax

from jdem.effects.base import About, AbstractEffect
from jdem.engine.bed import Numerics
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.settling import neutral_soil
from jdem.packing.specimen import Specimen


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
