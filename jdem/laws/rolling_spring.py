"""Rolling resistance as an elastic spring with a limit, against the relative spin.

    M = -k_r phi            k_r = k_t R*^2        |M| <= mu_r N R*

phi is the relative rotation across the line of centres.  Iwashita and Oda 1998, Journal of
Engineering Mechanics 124, 285; Ai et al. 2011, Powder Technology 206, 269, model C without its
dashpot.  This is `rolling_friction epsd2` of LIGGGHTS 3.8 with N = |f_n|, and `rolling_friction
luding` with `coeffRollingStiffness 1` and no viscous damping where N holds the adhesive share.
The lever arm R* is r/2 between equal spheres and r at a wall, where `ConstantTorque` has r both
times.  Separation clears phi.
"""

import equinox as eqx
import jax.numpy as jnp

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractRollingLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.elasticity import AbstractStiffness


class RollingSpring(AbstractRollingLaw):
    """rolling_friction is mu_r (-); k_t is the tangential stiffness of `shear`, whatever multiplier
    sliding has."""

    shear: AbstractStiffness
    rolling_friction: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def limit(self, normal: NormalForce):
        """None: all of it is in the moment."""
        return jnp.zeros_like(normal.hysteretic)

    def moment(self, contact: Contact, normal: NormalForce, history: Vector):
        overlap = jnp.maximum(contact.overlap, 0.0)
        sliding = self.shear.tangential(contact.radius, overlap)
        stiffness = sliding * contact.radius * contact.radius
        limit = self.rolling_friction * normal.frictional_load * contact.radius
        turn = history + contact.spin.without(contact.normal) * (stiffness * contact.time_step)
        turn = once(turn.without(contact.normal) * jnp.where(limit > 0, 1.0, 0.0))
        load = smooth.divide(smooth.norm(turn), limit)
        turn, share = once(smooth.limited(turn, load, self.smoothing.slip))
        return once((turn * -share, turn))

    def memory(self, shape, dtype):
        """The spring's moment before it is rounded, N m."""
        return Vector.zeros(shape, dtype)
