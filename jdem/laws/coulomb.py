"""Tangential spring with a Coulomb limit that includes adhesion.

    f_t = -k_t u sat(s)/s       s = k_t |u| / (mu N)
    N = |f_hys + f_min (d/d_min)^x - f0|            (Thakur et al. 2014, eq. 11)

u is the stretch of the spring; it follows the slip and stops growing where sat
reaches 1, so the force depends on u alone and a closed cycle of u without slip costs
no energy.  The dashpot fades as the spring saturates: sliding friction is mu N.
"""

import equinox as eqx
import jax.numpy as jnp

from jdem import smooth
from jdem.contact import Contact, ContactHistory, NormalForce
from jdem.damping import dashpot_constant
from jdem.laws.base import AbstractTangentialLaw
from jdem.quantity import Real, quantity
from jdem.smooth import Smoothing


class CoulombSpring(AbstractTangentialLaw):
    """Spring, slider and dashpot; `restitution` sets the dashpot as in the normal law."""

    restitution: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def force(self, contact: Contact, normal: NormalForce, stiffness, history: ContactHistory):
        limit = contact.friction * normal.frictional_load
        stretch = history.stretch.without(contact.normal) + contact.slip * contact.time_step
        load = smooth.divide(stiffness * smooth.norm(stretch), limit)
        longest = 1 + self.smoothing.slip
        stretch = stretch * jnp.where(load > longest, longest / jnp.maximum(load, longest), 1.0)
        stretch = stretch * jnp.where(limit > 0, 1.0, 0.0)
        load = jnp.minimum(load, longest)
        secant = jnp.where(
            load > 0, smooth.divide(smooth.saturate(load, self.smoothing.slip), load), 1.0
        )
        spring = stretch * (-stiffness * secant)
        beta = dashpot_constant(self.restitution, contact.mass, jnp.maximum(stiffness, _TINY))
        sticking = smooth.saturate_slope(load, self.smoothing.slip) * jnp.where(limit > 0, 1.0, 0.0)
        dashpot = contact.slip * (-beta * sticking)
        return spring, dashpot, ContactHistory(history.max_overlap, history.low_overlap, stretch)


_TINY = 1e-30  # N/m; keeps the square root's gradient finite where nothing touches
