"""Tangential spring of LIGGGHTS 3.8 (`tan_luding`, and `history`): the spring alone has the limit.

    f_t = -k_t u - beta v        while k_t |u| < mu N
    f_t = -mu N u/|u|            beyond, without dashpot; u is cut to mu N/k_t
    beta = 2 b zeta sqrt(m* k1)

Luding 2008, Granular Matter 10, 235, section 2.3, with equal static and dynamic friction.  The
dashpot is a share b of the normal one's, k1 its virgin stiffness.  N is the load that the normal
law gives.
`CoulombSpring` differs in that spring and dashpot share the limit and that its dashpot goes with
k_t.  Separation clears the stretch u.
"""

import equinox as eqx
import jax.numpy as jnp

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractTangentialLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import damping_ratio, dashpot_constant
from jdem.mechanics.elasticity import AbstractStiffness

# A sphere's dashpots add up, its frequencies as their squares: n contacts brake its spin n times
# as fast as one and swing sqrt(n) times as fast.  The safety of time steps reckons with the latter.
# With 1.5 single spheres of 2000 still blew up.
TOGETHER = 2.5


class LudingSpring(AbstractTangentialLaw):
    """Spring and slider, and a dashpot while it sticks.

    `restitution` and `stiffness` are those of the normal law, `viscosity` (-) is b; `softest` (-)
    is the least tangential over normal stiffness that the time step reckons with.
    """

    stiffness: AbstractStiffness
    restitution: Real = quantity()
    viscosity: Real = quantity(1.0)
    softest: Real = quantity(1.0)
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def force(self, contact: Contact, normal: NormalForce, stiffness, history: Vector):
        limit = contact.friction * normal.frictional_load
        loaded = jnp.where(limit > 0, 1.0, 0.0)
        stretch = history.without(contact.normal) + contact.slip * contact.time_step
        stretch = once(stretch * loaded)
        load = smooth.divide(stiffness * smooth.norm(stretch), limit)
        stretch, share = once(smooth.limited(stretch, load, self.smoothing.slip))
        sticks = loaded * smooth.saturate_slope(load, self.smoothing.slip)
        normal_stiffness = self.stiffness.damping_stiffness(contact.radius, contact.overlap)
        beta = self.viscosity * dashpot_constant(self.restitution, contact.mass, normal_stiffness)
        spring = stretch * (-stiffness * share)
        return once((spring, contact.slip * (-beta * sticks), stretch))

    def damping_ratio(self):
        """TOGETHER times beta/(2 sqrt(m* k_t)) = b zeta sqrt(k1/k_t)."""
        ratio = self.viscosity * damping_ratio(jnp.log(self.restitution))
        return TOGETHER * ratio / jnp.sqrt(self.softest)

    def memory(self, shape, dtype):
        """Elastic stretch of the spring, m."""
        return Vector.zeros(shape, dtype)
