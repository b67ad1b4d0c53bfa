"""Rolling resistance: a torque up to mu_r |f_hys| R against each body's own spin.

The law gives the limit; `jdem.engine.step` applies the sum over a sphere's contacts
implicitly, as friction that can stop a spin within a step but never reverse it.
(A constant torque integrated explicitly jitters at tens of rad/s.)
"""

import equinox as eqx

from jdem.core import smooth
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractRollingLaw
from jdem.mechanics.contact import NormalForce


class ConstantTorque(AbstractRollingLaw):
    """Limit mu_r |f_hys|; rolling_friction is mu_r, dimensionless."""

    rolling_friction: Real = quantity()
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)

    def limit(self, normal: NormalForce):
        width = self.smoothing.load * normal.frictional_load
        return self.rolling_friction * smooth.absolute(normal.hysteretic, width)
