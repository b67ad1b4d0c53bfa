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
    falls with height over diameter, steeply just above 1, less so from 1.25 to 2.5 (Gueneyli
    and Ruesen 2016, abstract; four clays).  Steel on soil: tan(delta) = 0.2 for sandy silt to
    0.4 for gravel (US Navy 1982, in Carter and Bentley 2016, table 11.1); 0.1 to 0.5 as
    extra coefficients are an assumption around that.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="extra coefficient of friction",
        unit="1",
        typical=(0.1, 0.5),
        kind="wall",
        one_sided=True,
        in_mould="next to none",
        free="peak higher and later, softer decline",
        confounders=("surface_energy", "static_friction", "second_test_factor"),
        source="0.1-0.5: assumption around 0.2-0.4 for steel on soil (US Navy 1982, in Carter "
        "and Bentley 2016); height effect: Gueneyli and Ruesen 2016",
    )

    def soil(self, soil, stage):
        return eqx.tree_at(lambda s: s.platen_friction, soil, soil.platen_friction + self.strength)
