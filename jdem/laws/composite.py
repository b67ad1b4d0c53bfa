"""A whole contact: normal law, tangential law and rolling law in their slots."""

from typing import NamedTuple

from jdem.core.quantity import Real, quantity
from jdem.laws.base import (
    AbstractContactLaw,
    AbstractNormalLaw,
    AbstractRollingLaw,
    AbstractTangentialLaw,
    Memory,
)
from jdem.mechanics.contact import Contact, ContactForce
from jdem.mechanics.elasticity import AbstractStiffness


class ContactMemory(NamedTuple):
    """What the three parts remember, each its own."""

    normal: Memory
    tangential: Memory
    rolling: Memory


class ContactLaw(AbstractContactLaw):
    """normal -> tangential (needs the load) and rolling (needs the load).

    The tangential spring's stiffness is `tangential_multiplier` times that of
    `shear` (k1 at n = 1, 8 G* sqrt(R* d) at n = 1.5).
    """

    normal: AbstractNormalLaw
    shear: AbstractStiffness
    tangential: AbstractTangentialLaw
    rolling: AbstractRollingLaw
    tangential_multiplier: Real = quantity(1.0)

    def force(self, contact: Contact, history: ContactMemory):
        normal, plastic = self.normal.force(contact, history.normal)
        overlap = contact.overlap.clip(0.0)
        stiffness = self.tangential_multiplier * self.shear.tangential(contact.radius, overlap)
        spring, dashpot, stretch = self.tangential.force(
            contact, normal, stiffness, history.tangential
        )
        moment, rolled = self.rolling.moment(contact, normal, history.rolling)
        force = ContactForce(normal, spring, dashpot, self.rolling.limit(normal), moment)
        return force, ContactMemory(plastic, stretch, rolled)

    def stiffness_bound(self, radius):
        return self.normal.stiffness_bound(radius)

    def memory(self, shape, dtype):
        parts = (self.normal, self.tangential, self.rolling)
        return ContactMemory(*[part.memory(shape, dtype) for part in parts])
