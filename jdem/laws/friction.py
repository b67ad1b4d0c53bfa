"""Sliding and rolling friction of EEPA as published.

Sliding: a tangential spring with a Coulomb limit that includes adhesion.

    f_t = -(k_t u + beta v) sat(s)/s       s = |k_t u + beta v| / (mu N)
    N = |f_hys + f_min (d/d_min)^x - f0|            (Thakur et al. 2014, eq. 11)

u is the stretch of the spring and v the slip velocity; u follows the slip and stops growing
where the spring alone saturates, so without a dashpot a closed cycle of u without slip costs
no energy.  Spring and dashpot share the limit: a dashpot beside it gives lightly loaded
contacts kicks of many times mu N, and every rattling sphere then spoils all derivatives
(docs/decisions/2026-11-21-contact-law.md).  The law remembers the stretch, and forgets it where it
carries no load.

Rolling: a torque up to mu_r |f_hys| R against each body's own spin.  The law gives the limit;
`jdem.engine.step` applies the sum over a sphere's contacts implicitly, as friction that can stop
a spin within a step but never reverse it.  (A constant torque integrated explicitly jitters at tens
of rad/s.)
"""

import equinox as eqx
import jax.numpy as jnp

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.parameter import NOT_NEGATIVE, POSITIVE, Parameter, Search
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.laws.base import AbstractRollingLaw, AbstractTangentialLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import damping_ratio, dashpot_constant


class CoulombSpring(AbstractTangentialLaw):
    """Spring, slider and dashpot; `restitution` sets the dashpot as in the normal law."""

    restitution: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def force(self, contact: Contact, normal: NormalForce, stiffness, history: Vector):
        limit = contact.friction * normal.frictional_load
        loaded = jnp.where(limit > 0, 1.0, 0.0)
        stretch = history.without(contact.normal) + contact.slip * contact.time_step
        stretch = once(stretch)
        stretch = once(self._shortened(stretch, stiffness, limit) * loaded)
        beta = dashpot_constant(self.restitution, contact.mass, jnp.maximum(stiffness, _TINY))
        trial = stretch * stiffness + contact.slip * beta
        load = smooth.divide(smooth.norm(trial), limit)
        saturated = smooth.saturate(load, self.smoothing.slip)
        share = jnp.where(load > 0, smooth.divide(saturated, load), 1.0) * loaded
        share = once(share)
        return stretch * (-stiffness * share), contact.slip * (-beta * share), stretch

    def damping_ratio(self):
        return damping_ratio(jnp.log(self.restitution))

    def memory(self, shape, dtype):
        """Elastic stretch of the spring, m."""
        return Vector.zeros(shape, dtype)

    def _shortened(self, stretch, stiffness, limit):
        """The stretch cut to where the spring alone reaches the limit for good."""
        load = smooth.divide(stiffness * smooth.norm(stretch), limit)
        longest = 1 + self.smoothing.slip
        return stretch * jnp.where(load > longest, longest / jnp.maximum(load, longest), 1.0)


class ConstantTorque(AbstractRollingLaw):
    """Limit mu_r |f_hys|; rolling_friction is mu_r, dimensionless."""

    rolling_friction: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def limit(self, normal: NormalForce):
        width = self.smoothing.load * normal.frictional_load
        return self.rolling_friction * smooth.absolute(normal.hysteretic, width)


_TINY = 1e-30  # N/m; keeps the square root's gradient finite where nothing touches


PARAMETERS = (
    Parameter(
        name="static_friction",
        symbol="mu",
        label="coefficient of sliding friction",
        accepted=NOT_NEGATIVE,
        repair="give 0 or a positive number, such as 0.6",
        search=Search(0.1, 1.5, 0.5, calibrated_sd=0.2),
        names={
            "EDEM": "Interaction soil - soil / Coefficient of Static Friction",
            "LIGGGHTS": "coefficientFriction",
            "Yade": "frictionAngle",
        },
    ),
    Parameter(
        name="tangential_multiplier",
        symbol="k_tm",
        label="tangential over normal stiffness",
        accepted=POSITIVE,
        repair="give a positive number, such as 0.8",
        search=Search(0.1, 2.0, 0.4, calibrated_sd=0.2),
        names={
            "EDEM": "EEPA model soil - soil / Tangential Stiff Multiplier",
            "LIGGGHTS": "coeffFrictionStiffness",
            "Yade": "ks",
        },
    ),
    Parameter(
        name="rolling_friction",
        symbol="mu_r",
        label="coefficient of rolling friction",
        accepted=NOT_NEGATIVE,
        repair="give 0 or a positive number, such as 0.3",
        search=Search(0.05, 1.0, 0.5, calibrated_sd=0.3),
        names={
            "EDEM": "Interaction soil - soil / Coefficient of Rolling Friction",
            "LIGGGHTS": "coefficientRollingFriction",
        },
    ),
)
