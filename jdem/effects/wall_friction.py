"""The mould holds the soil back more than it is greased to.

mu_wall = wall_friction + strength        (Janssen: stress falls exponentially downwards)
"""

from typing import ClassVar

import equinox as eqx

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class WallFriction(AbstractEffect):
    """Strength: extra coefficient of friction on the mould, dimensionless; one-sided where the
    soil's own wall_friction is 0, else no lower than minus that.

    Stiffer in the mould the higher the specimen; less force reaches the base than the platen
    gives while loading, more while unloading, and force falls faster after reversal.  (On a
    rigid soil that is an abrupt drop; here the contacts' tangential springs must turn first,
    within some tenths of a millimetre.)  Crushing sees only the gradient that
    this left.  Angles on greased walls: below 1 degree with latex at 150 to 670 kPa (Tatsuoka
    et al. 1984, abstract), 16.8 degrees with Teflon and silicone grease at low stress, where
    other lubricants did worse ("Experimental Study on the Effectiveness of Lubricants in
    Reducing Sidewall Friction", ASCE, abstract): tan = 0.02 to 0.3.  Both on sand.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="extra coefficient of friction",
        unit="1",
        typical=(0.02, 0.3),
        kind="wall",
        one_sided=True,
        in_mould="stiffer, faster fall after reversal; base force below platen force",
        free="none but an inherited gradient",
        confounders=("shear_modulus", "plasticity_ratio", "static_friction", "acquisition_lag"),
        source="tan of 1 degree (grease and latex, Tatsuoka et al. 1984) to 16.8 degrees (Teflon "
        "and grease, low stress; ASCE study of sidewall lubricants)",
    )

    def soil(self, soil, stage):
        return eqx.tree_at(lambda s: s.wall_friction, soil, soil.wall_friction + self.strength)
