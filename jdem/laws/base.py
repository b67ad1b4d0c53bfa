"""The contract of contact laws: scalars in, scalars out, one contact at a time.

    force(contact, history) -> (force, history)

A law never sees particle numbers, the bed or the neighbour list, so it can be
plotted in one notebook cell; `jdem.engine.step` vectorises it.  The normal law comes
first, because the tangential law needs the load that it carries.
"""

import abc

import equinox as eqx
from jax import Array

from jdem.core.vector import Vector
from jdem.mechanics.contact import Contact, ContactForce, ContactHistory, NormalForce


class AbstractNormalLaw(eqx.Module):
    """Force along the line of centres."""

    @abc.abstractmethod
    def force(
        self, contact: Contact, history: ContactHistory
    ) -> tuple[NormalForce, ContactHistory]:
        """Normal force (N) and the memory after this instant."""

    @abc.abstractmethod
    def loading_stiffness(self, contact: Contact) -> Array:
        """k1, N/m^n: virgin loading follows k1 d^n."""

    @abc.abstractmethod
    def stiffness_bound(self, radius: Array) -> Array:
        """Largest normal stiffness (N/m) at effective radius R*, for the time step."""


class AbstractTangentialLaw(eqx.Module):
    """Sliding resistance in the contact plane."""

    @abc.abstractmethod
    def force(
        self, contact: Contact, normal: NormalForce, stiffness: Array, history: ContactHistory
    ) -> tuple[Vector, Vector, ContactHistory]:
        """Spring and dashpot traction on the first body (N), and the memory after.

        `stiffness` is the tangential spring's, N/m.
        """


class AbstractRollingLaw(eqx.Module):
    """Resistance to rolling."""

    @abc.abstractmethod
    def limit(self, normal: NormalForce) -> Array:
        """Largest rolling torque divided by its lever arm, N."""


class AbstractContactLaw(eqx.Module):
    """Everything that acts in one contact."""

    @abc.abstractmethod
    def force(
        self, contact: Contact, history: ContactHistory
    ) -> tuple[ContactForce, ContactHistory]:
        """The contact's force by part and its memory after this instant."""

    @abc.abstractmethod
    def stiffness_bound(self, radius: Array) -> Array:
        """Largest stiffness (N/m) at effective radius R*, for the time step."""

    def memory(self, shape, dtype) -> tuple:
        """What a new contact remembers in `ContactHistory.extra`: nothing, unless said so."""
        return ()
