"""A whole contact: normal law, tangential law and rolling law in their slots."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp

from jdem.core.quantity import Real, quantity
from jdem.laws.base import (
    AbstractContactLaw,
    AbstractNormalLaw,
    AbstractRollingLaw,
    AbstractTangentialLaw,
    Memory,
)
from jdem.mechanics.contact import Contact, ContactForce
from jdem.mechanics.dashpot import longest_step
from jdem.mechanics.elasticity import AbstractStiffness

SLIPPING = 2 / 7  # effective mass of slip over that of approach, for spheres
DEEPEST = 0.01  # largest overlap over R* that the time step reckons with


class ContactMemory(NamedTuple):
    """What the three parts remember, each its own."""

    normal: Memory
    tangential: Memory
    rolling: Memory


class ContactLaw(AbstractContactLaw):
    """normal -> tangential (needs the load) and rolling (needs the load).

    The tangential spring's stiffness is `tangential_multiplier` times that of
    `shear` (k1 at n = 1, 8 G* sqrt(R* d) at n = 1.5).  deepest (-) is the overlap over R* up to
    which the time step reckons with its growth.
    """

    normal: AbstractNormalLaw
    shear: AbstractStiffness
    tangential: AbstractTangentialLaw
    rolling: AbstractRollingLaw
    tangential_multiplier: Real = quantity(1.0)
    deepest: float = eqx.field(static=True, default=DEEPEST)

    def force(self, contact: Contact, history: ContactMemory):
        normal, plastic = self.normal.force(contact, history.normal)
        shear = self.shear.tangential(contact.radius, contact.overlap)
        stiffness = self.tangential_multiplier * shear
        spring, dashpot, stretch = self.tangential.force(
            contact, normal, stiffness, history.tangential
        )
        moment, rolled = self.rolling.moment(contact, normal, history.rolling)
        force = ContactForce(normal, spring, dashpot, self.rolling.limit(normal), moment)
        return force, ContactMemory(plastic, stretch, rolled)

    def longest_step(self, mass, radius):
        """The shorter one of approach and sliding.

        A force at the surface of a sphere turns it too, so that slip sees less inertia:
        1/m_t = 1/m* (1 + m r^2/I) = 7/2 1/m*.
        """
        sliding = self.tangential_multiplier * self.shear.tangential(radius, self.deepest * radius)
        return jnp.minimum(
            longest_step(mass, self.normal.stiffness_bound(radius), self.normal.damping_ratio()),
            longest_step(mass * SLIPPING, sliding, self.tangential.damping_ratio() / SLIPPING**0.5),
        )

    def reach(self, radius):
        """That of the normal force."""
        return self.normal.reach(radius)

    def memory(self, shape, dtype):
        parts = (self.normal, self.tangential, self.rolling)
        return ContactMemory(*[part.memory(shape, dtype) for part in parts])
