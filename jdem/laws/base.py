"""The contract of contact laws: scalars in, scalars out, one contact at a time.

    force(contact, history) -> (force, history)

A law never sees particle numbers, the bed or the neighbour list, so it can be
plotted in one notebook cell; `jdem.engine.step` vectorises it.  The normal law comes
first, because the tangential law needs the load that it carries.

Every law owns what it remembers: `memory` states it as a tree of arrays, all zero in a
contact that has just been listed, and `force` takes and returns that tree and no other.
The engine carries it as long as the pair is listed and never looks into it: whether it
outlives a separation is the law's decision.
"""

import abc
from typing import Any

import equinox as eqx
from jax import Array

from jdem.core.quantity import Real
from jdem.core.vector import Vector
from jdem.mechanics.contact import Contact, ContactForce, NormalForce

Memory = Any  # a tree of arrays that one law owns


class AbstractNormalLaw(eqx.Module):
    """Force along the line of centres."""

    @abc.abstractmethod
    def force(self, contact: Contact, history: Memory) -> tuple[NormalForce, Memory]:
        """Normal force (N) and the memory after this instant."""

    @abc.abstractmethod
    def stiffness_bound(self, radius: Array) -> Array:
        """Largest normal stiffness (N/m) at effective radius R*, for the time step."""

    def damping_ratio(self) -> Real:
        """The dashpot's share of critical damping, for the time step: 0 unless said so."""
        return 0.0

    def reach(self, radius: Array) -> Real:
        """The gap (m) across which it acts at effective radius R* (m): 0 unless said so."""
        return 0.0

    def memory(self, shape, dtype) -> Memory:
        """What new contacts remember, zeros of this shape: nothing, unless said so."""
        return ()


class AbstractTangentialLaw(eqx.Module):
    """Sliding resistance in the contact plane."""

    @abc.abstractmethod
    def force(
        self, contact: Contact, normal: NormalForce, stiffness: Array, history: Memory
    ) -> tuple[Vector, Vector, Memory]:
        """Spring and dashpot traction on the first body (N), and the memory after.

        `stiffness` is the tangential spring's, N/m.
        """

    def damping_ratio(self) -> Real:
        """The dashpot's share of critical damping, for the time step: 0 unless said so."""
        return 0.0

    def memory(self, shape, dtype) -> Memory:
        """What new contacts remember, zeros of this shape: nothing, unless said so."""
        return ()


class AbstractRollingLaw(eqx.Module):
    """Resistance to rolling: a limit that the engine applies implicitly, or a moment, or both."""

    @abc.abstractmethod
    def limit(self, normal: NormalForce) -> Array:
        """Largest rolling torque divided by its lever arm, N."""

    def moment(
        self, contact: Contact, normal: NormalForce, history: Memory
    ) -> tuple[Vector | None, Memory]:
        """Moment on the first body (N m), or None, and the memory after: none, unless said so.

        `contact.spin` is what it works against.
        """
        return None, history

    def memory(self, shape, dtype) -> Memory:
        """What new contacts remember, zeros of this shape: nothing, unless said so."""
        return ()


class AbstractContactLaw(eqx.Module):
    """Everything that acts in one contact."""

    @abc.abstractmethod
    def force(self, contact: Contact, history: Memory) -> tuple[ContactForce, Memory]:
        """The contact's force by part and its memory after this instant."""

    @abc.abstractmethod
    def longest_step(self, mass: Array, radius: Array) -> Array:
        """Longest time step (s) at which two bodies in contact are stable, of effective mass m*
        (kg) and radius R* (m)."""

    def reach(self, radius: Array) -> Real:
        """The gap (m) across which the bodies act on each other at effective radius R* (m), up to
        which lists must hold them: 0 unless said so."""
        return 0.0

    @property
    def bonds(self) -> bool:
        """Whether it has bonds, which form where it is `joining`: no, unless said so.  Contacts
        then say their smaller radius and how both bodies turn together."""
        return False

    def joining(self, now: Array) -> "AbstractContactLaw":
        """The law where bonds form (`now` is true) or do not: itself, unless it has bonds."""
        return self

    def whole_bonds(self, history: Memory) -> Real:
        """1 where a contact that remembers this has a whole bond, 0 elsewhere: 0 unless said so."""
        return 0.0

    def memory(self, shape, dtype) -> Memory:
        """What new contacts remember, zeros of this shape: nothing, unless said so."""
        return ()
