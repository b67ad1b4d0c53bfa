"""Water between grains pulls across a gap: a tension that outlasts the contact.

    f = -F0 (exp(-s/s0) - exp(-c))/(1 - exp(-c))    0 <= s < c s0,  s0 = DECAY d,  c = CUTOFF
    f = -F0 in contact                              F0 = stress d^2

s is the gap between the surfaces, d = 4 R* the spheres' diameter.  The form stands for the
liquid-bridge force of Willett et al. 2000, which falls from contact to rupture; at the soil's
saturation it is phenomenological.  As F0 grows with d^2, `stress` is about the tensile
strength that it gives a bed of any sphere size (Rumpf 1962: 1.05 F/d^2 at a solid fraction of
0.55 and six contacts).
"""

import math
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect
from jdem.laws.base import AbstractContactLaw, Memory
from jdem.mechanics.contact import Contact, NormalForce

DECAY = 0.02  # of the diameter
CUTOFF = 4.0  # decay lengths; pairs are listed that far apart


class CapillaryTension(AbstractEffect):
    """Strength: stress F0/d^2, Pa, one-sided.

    Hardly anything in the mould but a longer recovery below zero force; a higher and later
    peak, slower softening and more residual force without it.  Friction feels it only through
    the larger overlaps.  1 to 10 kPa, DECAY and CUTOFF are assumptions.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="stress F0/d^2",
        unit="Pa",
        typical=(1e3, 1e4),
        kind="soil",
        one_sided=True,
        in_mould="next to none; longer recovery at the end",
        free="peak higher and later, slower softening, higher residual",
        confounders=("surface_energy", "tensile_exponent", "load_cell_drift"),
        source="1-10 kPa, decay length: assumptions; form: after Willett et al. 2000",
    )

    def law(self, law, stage):
        return AcrossGaps(law, self.strength)

    def reach(self, diameter):
        return CUTOFF * DECAY * diameter


class AcrossGaps(AbstractContactLaw):
    """A law with a tension (Pa, times d^2) added in contact and across the gap."""

    inner: AbstractContactLaw
    stress: Real = quantity()

    def force(self, contact: Contact, history: Memory):
        force, history = once(self.inner.force(contact, history))
        normal = force.normal
        pulled = NormalForce(
            normal.hysteretic - self.tension(contact), normal.viscous, normal.frictional_load
        )
        return eqx.tree_at(lambda f: f.normal, force, pulled), history

    def tension(self, contact: Contact) -> Array:
        """The attraction, N."""
        diameter = 4 * contact.radius
        lengths = jnp.maximum(-contact.overlap, 0.0) / (DECAY * diameter)
        share = (jnp.exp(-lengths) - math.exp(-CUTOFF)) / (1 - math.exp(-CUTOFF))
        return self.stress * diameter**2 * jnp.maximum(share, 0.0)

    def longest_step(self, mass, radius):
        return self.inner.longest_step(mass, radius)

    @property
    def bonds(self):
        return self.inner.bonds

    def joining(self, now):
        return replace(self, inner=self.inner.joining(now))

    def whole_bonds(self, history: Memory):
        return self.inner.whole_bonds(history)

    def memory(self, shape, dtype):
        return self.inner.memory(shape, dtype)
