"""A whole contact: normal law, tangential law and rolling law in their slots."""

from jdem.core.quantity import Real, quantity
from jdem.laws.base import (
    AbstractContactLaw,
    AbstractNormalLaw,
    AbstractRollingLaw,
    AbstractTangentialLaw,
)
from jdem.mechanics.contact import Contact, ContactForce, ContactHistory
from jdem.mechanics.elasticity import AbstractStiffness


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

    def force(self, contact: Contact, history: ContactHistory):
        normal, history = self.normal.force(contact, history)
        overlap = contact.overlap.clip(0.0)
        stiffness = self.tangential_multiplier * self.shear.tangential(contact.radius, overlap)
        spring, dashpot, history = self.tangential.force(contact, normal, stiffness, history)
        force = ContactForce(normal, spring, dashpot, self.rolling.limit(normal))
        return force, history

    def stiffness_bound(self, radius):
        return self.normal.stiffness_bound(radius)
