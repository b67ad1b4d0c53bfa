"""Rolling resistance: a torque up to mu_r |f_hys| R against each body's own spin.

The law gives the limit; `jdem.engine.step` applies the sum over a sphere's contacts
implicitly, as friction that can stop a spin within a step but never reverse it.
(A constant torque integrated explicitly jitters at tens of rad/s.)
"""

import equinox as eqx

from jdem.core import smooth
from jdem.core.parameter import NOT_NEGATIVE, Parameter, Search
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


PARAMETERS = (
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
