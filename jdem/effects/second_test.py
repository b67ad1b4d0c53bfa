"""Between the tests the soil dries, ages, or is disturbed: the second test alone is scaled.

k1, dgamma, f0 -> (1 + e) (k1, dgamma, f0)        from the opening of the mould on
"""

from typing import ClassVar

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect, with_contacts_scaled


class SecondTestFactor(AbstractEffect):
    """Strength: relative change e of every contact force, dimensionless, two-sided, > -1.

    Stiffness and adhesion change together, so overlaps stay in balance and the whole
    unconfined curve is multiplied by 1 + e (quasi-static, weight neglected); the confined
    curve is untouched.  Stands for drying (5 to 15 % per per cent of water, recalled), ageing
    (x 1.75 in 160 days), disturbance by extrusion and trimming (-10 to -50 %, recalled): with one
    rate a test these are exactly alike.  The time step is that of e = 0 and good up to e of
    about 5.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="relative change e of contact forces",
        unit="1",
        typical=(-0.5, 0.75),
        one_sided=False,
        confined="none",
        unconfined="all forces x (1 + e)",
        confounders=("rate_dependence", "platen_friction", "cementation", "surface_energy"),
        source="drying, disturbance (recalled); loess x 1.75 after 160 d",
    )

    def soil(self, soil, stage):
        return with_contacts_scaled(soil, 1 + self.strength * stage.free)
