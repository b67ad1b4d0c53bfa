"""Specimens are not filled alike: more or less soil in the same volume.

r -> (1 + e/3) r,  m -> (1 + e/3)^3 m        density changes by e to first order
"""

from typing import ClassVar

import equinox as eqx

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class SpecimenDensity(AbstractEffect):
    """Strength: relative change e of density, dimensionless, two-sided, |e| up to 0.02.

    Every sphere grows where it lies, in the same mould at the same height: the fabric stays,
    gaps close or open everywhere.  A denser specimen is stiffer from the start and stronger; a
    looser one has a toe.  It differs from specimen to specimen with mean 0, so it shows in the
    scatter of repeats rather than in their mean.  Fabric scatter (another packing, other
    friction at filling) is another thing: see the preparation setting in `numerical`.
    The paper's five samples from the field scatter by 17.6 % (standard deviation over mean of
    its table 6); that a laboratory fills to 2 % is an assumption.  Beyond |e| = 0.02 overlaps
    are no longer small.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="relative change e of density",
        unit="1",
        typical=(-0.02, 0.02),
        kind="specimen",
        one_sided=False,
        in_mould="denser: no toe, stiffer; looser: toe",
        free="denser: stronger",
        confounders=("seating_gap", "shear_modulus", "preparation_friction"),
        source="2 %: assumption, and as far as the realisation holds; field samples 17.6 % "
        "(Chen et al. 2023, table 6)",
    )

    def packing(self, packing):
        growth = 1 + self.strength / 3
        spheres = packing.spheres
        return eqx.tree_at(
            lambda p: (p.spheres.radius, p.spheres.mass),
            packing,
            (spheres.radius * growth, spheres.mass * growth**3),
        )
