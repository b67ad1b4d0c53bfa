"""The parallel bond of Potyondy and Cundall: a disk of glue between two bodies, until it breaks.

    dF_n = k_n A du_n     dF_s = -k_s A du_s     dM_n = -k_s J dtheta_n     dM_s = -k_n I dtheta_s
    A = pi r^2            I = pi r^4/4           J = pi r^4/2               r = lambda min(R1, R2)

    breaks where  -F_n/A + beta |M_s| r/I >= sigma_c   or   |F_s|/A + beta |M_n| r/J >= tau_c

Potyondy and Cundall 2004, Int. J. Rock Mech. 41, 1329; EDEM "Bonding V2" is the same with beta = 1.
Later PFC has the share beta of the moments and tau_c = c + tan(phi) sigma_n.  F_n is taken over
the whole elongation since the bond formed, the rest by increments: what was gained turns with the
pair as a rigid body, and keeps its length.  LAMMPS' `bpm/rotational` adds all four shares of the
limits to one; YADE's `CohFrictMat` has no limit of moments (beta = 0).

It acts in addition to the contact law within, and not instead.  The end moments F_s L/2 of a
sheared bond are the engine's lever arms; neither criterion counts them.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.parameter import NOT_NEGATIVE, POSITIVE, Accepted, Parameter, Search
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.laws.base import AbstractContactLaw, Memory
from jdem.mechanics.contact import Contact, ContactForce, NormalForce, smaller_radius

SLIPPING = 2 / 7  # effective mass of slip over that of approach, for spheres
TURNING = 8 / 5  # effective inertia of relative spin over m* R*^2, for equal spheres


class Bond(eqx.Module):
    """What one bond remembers; all 0 where none has formed."""

    formed: Array  #: 1 once there was a bond, until the pair leaves the list
    broken: Array  #: 1 for good once it broke
    origin: Array  #: m; overlap at which it formed
    shear: Vector  #: m; tangential displacement since
    bend: Vector  #: rad; relative rotation across the line of centres
    twist: Array  #: rad; relative rotation about it

    def whole(self) -> Array:
        """1 where a bond holds, 0 elsewhere."""
        return self.formed * (1 - self.broken)


class BondedMemory(NamedTuple):
    """What the law within remembers, and the bond."""

    inner: Memory
    bond: Bond


class Disk(NamedTuple):
    """Size of a bond: radius (m), area (m2), second moments about a diameter and the axis (m4)."""

    radius: Array
    area: Array
    bending: Array
    polar: Array


class ParallelBond(AbstractContactLaw):
    """A contact law with a bond beside it.

    normal_stiffness k_n and shear_stiffness k_s in N/m3, strengths in Pa, radius_ratio lambda,
    internal_friction tan(phi) and moment_share beta dimensionless.  Bonds form where bodies
    are nearer than `within` R* while `forming` is 1; one that broke does not form again as long as
    its pair is listed.  None holds bodies that are farther apart than `longest` R*, as in EDEM,
    where it ends with the overlap of contact radii.  Breaking is a jump, which derivatives do not
    see.
    """

    inner: AbstractContactLaw
    normal_stiffness: Real = quantity()
    shear_stiffness: Real = quantity()
    tensile_strength: Real = quantity()
    shear_strength: Real = quantity()
    radius_ratio: Real = quantity(1.0)
    internal_friction: Real = quantity(0.0)
    moment_share: Real = quantity(1.0)
    forming: Real = quantity(1.0)
    within: Real = quantity(1e-6)
    longest: Real = quantity(jnp.inf)

    def force(self, contact: Contact, history: BondedMemory):
        force, inner = once(self.inner.force(contact, history.inner))
        bond = self._moved(contact, self._formed(contact, history.bond))
        bond = once(self._broken(contact, bond))
        whole, disk = bond.whole(), self.disk(smaller_radius(contact))
        normal = NormalForce(
            force.normal.hysteretic + whole * self._push(contact, bond, disk),
            force.normal.viscous,
            force.normal.frictional_load,
        )
        spring = bond.shear * (-whole * self.shear_stiffness * disk.area)
        moment = self._moment(contact, bond, disk) * whole
        moment = moment if force.moment is None else moment + force.moment
        tangential = force.tangential + spring
        parts = (force.tangential_viscous, force.rolling_limit, moment)
        return once((ContactForce(normal, tangential, *parts), BondedMemory(inner, bond)))

    def memory(self, shape, dtype):
        zero, still = jnp.zeros(shape, dtype), Vector.zeros(shape, dtype)
        bond = Bond(zero, zero, zero, still, still, zero)
        return BondedMemory(self.inner.memory(shape, dtype), bond)

    def disk(self, radius: Array) -> Disk:
        """The bond between bodies of which the smaller one has this radius, m."""
        size = self.radius_ratio * radius
        bending = jnp.pi * size**4 / 4
        return Disk(size, jnp.pi * size**2, bending, 2 * bending)

    def energy(self, contact: Contact, bond: Bond) -> Array:
        """Elastic energy of the bond, J."""
        disk = self.disk(smaller_radius(contact))
        pull = bond.origin - contact.overlap
        normal = disk.area * pull**2 + disk.bending * bond.bend.dot(bond.bend)
        shear = disk.area * bond.shear.dot(bond.shear) + disk.polar * bond.twist**2
        return bond.whole() * (self.normal_stiffness * normal + self.shear_stiffness * shear) / 2

    def reach(self, radius):
        """Where pure tension breaks a bond that formed across the widest gap, or the law within
        ends, if that is farther."""
        broken = self.within * radius + self.tensile_strength / self.normal_stiffness
        ends = jnp.minimum(broken, self.longest * radius)
        return jnp.maximum(ends, self.inner.reach(radius))

    @property
    def bonds(self):
        """They are what it is for."""
        return True

    def joining(self, now):
        """With bonds that form, or do not."""
        dtype = jnp.asarray(self.forming).dtype
        return replace(self, forming=jnp.where(now, 1.0, 0.0).astype(dtype))

    def whole_bonds(self, history: BondedMemory):
        """Those that formed and did not break."""
        return history.bond.whole()

    def longest_step(self, mass, radius):
        """The law's own and the bond's, whose rates (1/s2) of approach, slip, bending and twist
        are added; 1/m + r^2/I of slip and spin are those of equal spheres."""
        inner, disk = self.inner.longest_step(mass, radius), self.disk(2 * radius)
        moved = self.normal_stiffness * disk.area + self.shear_stiffness * disk.area / SLIPPING
        turned = self.normal_stiffness * disk.bending + self.shear_stiffness * disk.polar
        rates = (moved + turned / (TURNING * radius**2)) / mass
        return (inner**-2.0 + rates / 4) ** -0.5

    def _formed(self, contact: Contact, bond: Bond) -> Bond:
        """A fresh bond where there was none and the bodies are near."""
        near = (contact.overlap > -self.within * contact.radius) & (self.forming > 0)
        fresh = near & (bond.formed == 0)
        formed = jnp.where(near, 1.0, bond.formed)
        origin = jnp.where(fresh, contact.overlap, bond.origin)
        return eqx.tree_at(lambda b: (b.formed, b.origin), bond, (formed, origin))

    def _moved(self, contact: Contact, bond: Bond) -> Bond:
        """The bond after this step's slip and relative rotation, turned with the pair."""
        whole, step = bond.whole(), contact.time_step
        shear = _turned(bond.shear, contact) + contact.slip * step
        bend = _turned(bond.bend, contact) + contact.spin.without(contact.normal) * step
        twist = bond.twist + contact.spin.dot(contact.normal) * step
        moved = (shear * whole, bend * whole, twist * whole)
        return eqx.tree_at(lambda b: (b.shear, b.bend, b.twist), bond, moved)

    def _broken(self, contact: Contact, bond: Bond) -> Bond:
        """The bond, marked as broken where it is stressed beyond a strength."""
        tension, shear = self.stresses(contact, bond)
        push = self._push(contact, bond, self.disk(smaller_radius(contact)))
        area = self.disk(smaller_radius(contact)).area
        strength = self.shear_strength + self.internal_friction * jnp.maximum(push, 0.0) / area
        breaks = (tension >= self.tensile_strength) | (shear >= strength)
        breaks = breaks | (contact.overlap < -self.longest * contact.radius)
        broken = jnp.where(breaks & (bond.whole() > 0), 1.0, bond.broken)
        return eqx.tree_at(lambda b: b.broken, bond, broken)

    def stresses(self, contact: Contact, bond: Bond) -> tuple[Array, Array]:
        """Largest tensile and shear stress in a whole bond, Pa."""
        disk = self.disk(smaller_radius(contact))
        share = self.moment_share * disk.radius
        bending = self.normal_stiffness * share * smooth.norm(bond.bend)
        twisting = self.shear_stiffness * share * jnp.abs(bond.twist)
        tension = -self._push(contact, bond, disk) / disk.area + bending
        return tension, self.shear_stiffness * smooth.norm(bond.shear) + twisting

    def _push(self, contact: Contact, bond: Bond, disk: Disk) -> Array:
        """F_n, N; tension is negative."""
        return self.normal_stiffness * disk.area * (contact.overlap - bond.origin)

    def _moment(self, contact: Contact, bond: Bond, disk: Disk) -> Vector:
        """M_s and M_n on the first body, N m."""
        bending = bond.bend * (-self.normal_stiffness * disk.bending)
        return bending - contact.normal * (self.shear_stiffness * disk.polar * bond.twist)


def _turned(vector: Vector, contact: Contact) -> Vector:
    """A vector across the line of centres after the pair turned as one: its length stays."""
    flat = vector.without(contact.normal)
    length = smooth.norm(flat)
    flat = flat * jnp.where(length > 0, smooth.divide(smooth.norm(vector), length), 1.0)
    if contact.turning is None:
        return flat
    angle = contact.turning * contact.time_step
    return flat * jnp.cos(angle) + contact.normal.cross(flat) * jnp.sin(angle)


PARAMETERS = (
    Parameter(
        name="normal_stiffness",
        symbol="k_n",
        label="normal stiffness of a bond per area",
        unit="N/m^3",
        accepted=POSITIVE,
        repair='give a positive value, such as "1e9 N/m^3"',
        search=Search(1e8, 1e10, 1.0),
        names={"EDEM": "Bonding V2 soil - soil / Normal Stiffness per unit area"},
    ),
    Parameter(
        name="shear_stiffness",
        symbol="k_s",
        label="shear stiffness of a bond per area",
        unit="N/m^3",
        accepted=NOT_NEGATIVE,
        repair='give 0 or a positive value, such as "4e8 N/m^3"',
        search=Search(1e7, 1e10, 1.0),
        names={"EDEM": "Bonding V2 soil - soil / Shear Stiffness per unit area"},
    ),
    Parameter(
        name="tensile_strength",
        symbol="sigma_c",
        label="tensile strength of a bond",
        unit="Pa",
        accepted=POSITIVE,
        repair='give a positive value, such as "200 kPa"',
        search=Search(1e4, 2e6, 1.0),
        names={"EDEM": "Bonding V2 soil - soil / Normal Strength"},
    ),
    Parameter(
        name="shear_strength",
        symbol="tau_c",
        label="shear strength of a bond",
        unit="Pa",
        accepted=POSITIVE,
        repair='give a positive value, such as "150 kPa"',
        search=Search(1e4, 2e6, 1.0),
        names={"EDEM": "Bonding V2 soil - soil / Shear Strength"},
    ),
    Parameter(
        name="radius_ratio",
        symbol="lambda",
        label="radius of a bond over that of the smaller body",
        accepted=POSITIVE,
        repair="give a positive number, such as 1",
        names={"EDEM": "Bonding V2 soil - soil / Bonded Disk Scale"},
    ),
    Parameter(
        name="internal_friction",
        symbol="tan phi",
        label="rise of a bond's shear strength with compression",
        accepted=NOT_NEGATIVE,
        repair="give 0 or a positive number, such as 0.5",
    ),
    Parameter(
        name="moment_share",
        symbol="beta",
        label="share of moments in what breaks a bond",
        accepted=Accepted(0.0, 1.0),
        repair="give a number from 0 to 1",
    ),
)
