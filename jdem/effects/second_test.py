"""Between the tests the soil dries, ages, or is disturbed: the second test alone is scaled.

k1, dgamma, f0 -> (1 + e) (k1, dgamma, f0)        from the opening of the mould on
"""

from typing import ClassVar

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect, with_contacts_scaled


class SecondTestFactor(AbstractEffect):
    """Strength: relative change e of every contact force, dimensionless, two-sided, > -1.

    Stiffness and adhesion change together, so overlaps stay in balance and the whole
    second curve is multiplied by 1 + e (quasi-static, weight neglected); the first
    curve is untouched.  Stands for drying, ageing, and disturbance by extrusion and trimming:
    with one rate a test these are exactly alike.  Drying: strength grows by a factor of about
    35 from liquid to plastic limit (Vardanega and Haigh 2014, abstract), so by 5 to 15 % per
    per cent of water at plasticity indices of 71 to 24 %.  Ageing: times 1.75 in 160 days
    (loess; Wei et al. 2023, abstract).  Disturbance: lower (Horng et al. 2011, abstract);
    by 10 to 50 % is an assumption.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="relative change e of contact forces",
        unit="1",
        typical=(-0.5, 0.75),
        kind="specimen",
        one_sided=False,
        in_mould="none",
        free="all forces x (1 + e)",
        confounders=("rate_dependence", "platen_friction", "cementation", "surface_energy"),
        source="drying 5-15 % per % of water (from Vardanega and Haigh 2014); loess x 1.75 after "
        "160 d (Wei et al. 2023); disturbance -50 %: assumption",
    )

    def soil(self, soil, stage):
        return with_contacts_scaled(soil, 1 + self.strength * stage.free)
