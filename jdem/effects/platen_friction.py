"""The platens hold the specimen's ends together more than the base model says.

mu_platen = platen_friction + strength
"""

from typing import ClassVar

import equinox as eqx

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class PlatenFriction(AbstractEffect):
    """Strength: extra coefficient of friction on base and platen, dimensionless; one-sided
    where the soil's own platen_friction is 0, else no lower than minus that.

    Stronger and more ductile without the mould (barrelling), hardly anything in it.  Strength
    falls with height over diameter, steeply below 1 (Gueneyli and Ruesen 2016);
    extra coefficients of 0.1 to 0.5 (recalled).
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="extra coefficient of friction",
        unit="1",
        typical=(0.1, 0.5),
        one_sided=True,
        confined="next to none",
        unconfined="peak higher and later, softer decline",
        confounders=("surface_energy", "static_friction", "second_test_factor"),
        source="0.1-0.5 (recalled); height effect: Gueneyli and Ruesen 2016",
    )

    def soil(self, soil, stage):
        return eqx.tree_at(lambda s: s.platen_friction, soil, soil.platen_friction + self.strength)
