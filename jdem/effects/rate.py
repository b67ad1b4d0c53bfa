"""Viscosity: contact forces go with the logarithm of the strain rate, and fade at standstill.

    k1, dgamma, f0 -> m (k1, dgamma, f0)      m = exp(rho log10(v/v_c)) = 1 + rho log10(v/v_c) + ...
    dv/dt = v (v_machine - v)/A               A = FADING_STRAIN

v is the nominal axial strain rate that the soil feels, v_c that of the first test.  Where
the machine stops, v fades as A/t and forces relax with log t; where it goes on, v has
followed after a strain A.  v_machine is constant in a segment: that a simulated platen slows
down just before its target does not count.  Simulated rates do not enter: the base model has none.
"""

from typing import ClassVar

import jax.numpy as jnp

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect, with_contacts_scaled


class RateDependence(AbstractEffect):
    """Strength: rho, relative change of contact forces per decade of rate; one-sided.

    Compression in the mould is the reference and hardly moves while it loads; force falls in a hold
    and in the rest; crushing at 0.01 mm/s is weaker by some 3 rho (2.9 decades
    between the tests' speeds).  With one rate a test and no hold it is exactly alike to a
    factor on the second test.  rho = 0.09 from 5 to 50 % an hour on Boston blue clay, less and
    down to 0 at slower rates and high overconsolidation (Sheahan et al. 1996, abstract); linear
    over five decades on sensitive clays ("Rate effects and cyclic loading of sensitive clays",
    abstract).  The range 0.05 to 0.15, its use at these faster rates and on unsaturated soil,
    and FADING_STRAIN are assumptions.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="rho, relative change per decade of rate",
        unit="1",
        typical=(0.05, 0.15),
        kind="soil",
        one_sided=True,
        in_mould="force falls in a hold; next to none without one",
        free="all forces lower, by 3 rho at 2.9 decades; more right after the rest",
        confounders=("second_test_factor", "platen_friction", "acquisition_lag", "restitution"),
        source="9 % per decade, saturated clay, fastest rates (Sheahan et al. 1996); 5-15 %: "
        "assumption",
    )

    def soil(self, soil, stage):
        return with_contacts_scaled(soil, jnp.exp(self.strength * stage.log_rate))
