"""The contract of effects: physics or apparatus that the base model leaves out.

An effect is a file with one final class: a `strength` that is 0 in the base model, and the
hooks through which it acts.  Hooks that it does not need stay neutral:

    packing       the specimen before the tests
    soil, law     the soil's parameters, and the law between spheres, at a stage of the tests
    programme     the machine's movements
    force_error, servo_error, travel_error      what the instruments show beyond the truth

Strength 0 gives the base model bit for bit, and every hook can be differentiated there.
Errors of instruments are functions of the truth and add up, so their order does not matter.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.quantity import Real
from jdem.engine.segment import Segment
from jdem.laws.base import AbstractContactLaw
from jdem.materials.contact_laws import BONDING
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing

KINDS = ("instrument", "wall", "soil", "specimen", "numerical")


class About(NamedTuple):
    """What a table says about an effect.

    quantity and unit (SI) of its strength; `typical` strengths, from small to large;
    one_sided if the strength cannot be negative; where curves move, of specimens in_mould and of
    free ones; confounders by their names (effects, contact parameters, settings); source of the
    numbers; kind: what the effect is of, one of KINDS.
    """

    quantity: str
    unit: str
    typical: tuple[float, float]
    one_sided: bool
    in_mould: str
    free: str
    confounders: tuple[str, ...]
    source: str
    kind: str


class Stage(eqx.Module):
    """Where the tests stand, as numbers that a hook can multiply with.

    free is 1 where the specimen stands without its mould; resting is 1 while it comes to rest
    there; log_rate is log10 of the nominal axial strain rate that the soil feels over the
    nominal rate of the first test (0 as it begins).  Felt rates follow the
    machine's over a strain of FADING_STRAIN and fade as 1/time where it stands still.
    """

    free: Array
    resting: Array
    log_rate: Array


FADING_STRAIN = 0.01


class AbstractEffect(eqx.Module):
    """One effect; its docstring states the model, the strength and its source."""

    strength: eqx.AbstractVar[Real]
    about: eqx.AbstractClassVar[About]

    def packing(self, packing: Packing) -> Packing:
        """The specimen that is put into the machine."""
        return packing

    def soil(self, soil: SoilParameters, stage: Stage) -> SoilParameters:
        """The soil at this stage of the tests."""
        return soil

    def law(self, law: AbstractContactLaw, stage: Stage) -> AbstractContactLaw:
        """The law between spheres at this stage of the tests."""
        return law

    def reach(self, diameter: float) -> float:
        """Largest gap (m) across which spheres up to this diameter (m) feel each other."""
        return 0.0

    def programme(self, programme: Segment, time_scale: Array) -> Segment:
        """The machine's movements (a stack); time_scale is nominal over simulated time."""
        return programme

    def force_error(self, reading: Array, time: Array) -> Array:
        """What is recorded beyond the load cell's reading (N), at the nominal time (s) since
        the cell was tared for this test."""
        return jnp.zeros_like(reading)

    def servo_error(self, reading: Array, time: Array) -> Array:
        """The part of `force_error` that the servo acts on as well."""
        return jnp.zeros_like(reading)

    def travel_error(self, force: Array) -> Array:
        """What is recorded beyond the platen's travel (m) at the true force (N)."""
        return jnp.zeros_like(force)


# Of other laws; forces go in proportion to them.
FORCES = ("gamma", "cohesion", "yield_strength", *BONDING)


def with_contacts_scaled(soil: SoilParameters, factor: Array) -> SoilParameters:
    """The soil with all contact forces (stiffness, adhesion, pull-off) times `factor`."""
    soil = eqx.tree_at(
        lambda s: (s.shear_modulus, s.surface_energy, s.pull_off_force),
        soil,
        (soil.shear_modulus * factor, soil.surface_energy * factor, soil.pull_off_force * factor),
    )
    scaled = {n: x * factor if n in FORCES else x for n, x in soil.further.items()}
    return replace(soil, further=scaled) if scaled else soil
