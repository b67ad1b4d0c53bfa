"""Cementation: bonds grow while the specimen rests, and break for good.

    bond force = -(T/w) g(D) u        u: displacement of the contact since the bond grew,
    D = max |u|/w                        tension and shear, but no compression
    g = 1 up to D = 1,  (2 - D)/D up to D = 2,  0 beyond        T = stress d^2,  w = STRAIN d

A bilinear cohesive zone with irreversible damage: a bond carries at most T, lets go of it
between w and 2 w, and never heals.  Where it breaks is a matter of displacement alone, so its
force is proportional to the strength.
"""

from dataclasses import replace
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.effects.base import About, AbstractEffect
from jdem.laws.base import AbstractContactLaw, Memory
from jdem.laws.composite import SLIPPING
from jdem.mechanics.contact import Contact, NormalForce

STRAIN = 0.005  # of the diameter; displacement at which a bond is strongest


class Cementation(AbstractEffect):
    """Strength: stress T/d^2 of a bond, Pa, one-sided.

    Bonds join the spheres that touch in the rest between the tests (ageing of a moulded soil;
    a natural cement would be there from the start and is not this effect): compression in the mould
    is untouched; without the mould the specimen is stiffer and stronger, and softens more
    abruptly once bonds break.  The time step knows their stiffness, T/w.  Loess at rest for
    160 days got stronger "by 1.75 times" (Wei et al. 2023, abstract), read here as times 1.75;
    10 to 100 kPa for T/d^2, and STRAIN, are assumptions.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="stress T/d^2 of a bond",
        unit="Pa",
        typical=(1e4, 1e5),
        kind="soil",
        one_sided=True,
        in_mould="none: bonds grow after it",
        free="stiffer, higher peak at less strain, brittle drop",
        confounders=("surface_energy", "tensile_exponent", "second_test_factor"),
        source="stress, opening: assumptions; loess x 1.75 after 160 d (Wei et al. 2023)",
    )

    def law(self, law, stage):
        return Bonded(law, self.strength, stage.resting)


class Bond(eqx.Module):
    """What a bond remembers; all 0 where none grew."""

    grown: Array  #: 1 where there was a bond once
    origin: Array  #: m; overlap at which it grew
    shear: Vector  #: m; tangential displacement since
    damage: Array  #: -; D, largest displacement so far over w


class BondedMemory(NamedTuple):
    """What the law within remembers, and the bond."""

    inner: Memory
    bond: Bond


class Bonded(AbstractContactLaw):
    """A law with bonds of `stress` (Pa, times d^2), which grow while `growing` is 1."""

    inner: AbstractContactLaw
    stress: Real = quantity()
    growing: Real = quantity()

    def force(self, contact: Contact, history: BondedMemory):
        force, inner = once(self.inner.force(contact, history.inner))
        bond = once(self._grown(contact, self._moved(contact, history.bond)))
        opening, stiffness = once((self._opening(contact, bond), self._stiffness(contact, bond)))
        normal = NormalForce(
            force.normal.hysteretic - stiffness * opening,
            force.normal.viscous,
            force.normal.frictional_load,
        )
        tangential = force.tangential - bond.shear * stiffness
        force = eqx.tree_at(lambda f: (f.normal, f.tangential), force, (normal, tangential))
        return force, BondedMemory(inner, bond)

    def longest_step(self, mass, radius):
        bond = self.stress * 4 * radius / STRAIN  # N/m, of a whole one, in tension and in shear
        inner = self.inner.longest_step(mass, radius)
        return jnp.where(bond > 0, (inner**-2.0 + bond / (4 * SLIPPING * mass)) ** -0.5, inner)

    @property
    def bonds(self):
        return self.inner.bonds

    def joining(self, now):
        return replace(self, inner=self.inner.joining(now))

    def whole_bonds(self, history: BondedMemory):
        """Those of the law within: its own lose their strength by degrees."""
        return self.inner.whole_bonds(history.inner)

    def memory(self, shape, dtype):
        zero = jnp.zeros(shape, dtype)
        bond = Bond(zero, zero, Vector.zeros(shape, dtype), zero)
        return BondedMemory(self.inner.memory(shape, dtype), bond)

    def _moved(self, contact: Contact, bond: Bond) -> Bond:
        """The bond after this step's slip and opening."""
        shear = bond.shear.without(contact.normal) + contact.slip * contact.time_step
        shear = once(shear * bond.grown)
        opening = self._opening(contact, bond)
        square = opening * opening + shear.dot(shear)
        moved = square > 0
        length = jnp.where(moved, jnp.sqrt(jnp.where(moved, square, 1.0)), 0.0)
        damage = jnp.maximum(bond.damage, length / self._width(contact))
        return Bond(bond.grown, bond.origin, shear, damage)

    def _grown(self, contact: Contact, bond: Bond) -> Bond:
        """Fresh bonds where spheres touch while bonds grow, else the bond as it is."""
        touching = jnp.where(contact.overlap > 0, 1.0, 0.0)
        zero = jnp.zeros_like(touching)
        fresh = Bond(touching, contact.overlap * touching, Vector(zero, zero, zero), zero)
        return jax.tree.map(lambda a, b: jnp.where(self.growing > 0, a, b), fresh, bond)

    def _opening(self, contact: Contact, bond: Bond) -> Array:
        """Displacement in tension, m."""
        return bond.grown * jnp.maximum(bond.origin - contact.overlap, 0.0)

    def _stiffness(self, contact: Contact, bond: Bond) -> Array:
        """(T/w) g(D), N/m."""
        left = jnp.clip((2 - bond.damage) / jnp.maximum(bond.damage, 1.0), 0.0, 1.0)
        return self.stress * (4 * contact.radius) ** 2 / self._width(contact) * left

    def _width(self, contact: Contact) -> Array:
        """w, m."""
        return STRAIN * 4 * contact.radius
