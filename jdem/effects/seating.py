"""Bedding: gaps and loose crumbs between platen and specimen close as the force sets in.

d_shown = d + s (1 - exp(-F/F_s))        F >= 0
"""

from typing import ClassVar

import jax.numpy as jnp

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class SeatingGap(AbstractEffect):
    """Strength: gap s, m, one-sided; closing_force is F_s (N).

    A long toe below some 3 F_s in both tests; H and peak force stay, the strain at peak grows
    by s.  The gap opens again on unloading (the curve's tail).  Displacement counts from a
    seating force as ever, which hides the part of s that is closed there.  s = 0.1 to 1 mm,
    F_s and one s for both tests of a specimen are assumptions.  That bedding matters: up to
    80 % of the axial deformation between lubricated ends (Sarsby et al. 1982, abstract), and
    an effect on stiffness in plate tests (Barnard and Heymann 2015, abstract).
    """

    strength: Real = quantity(0.0)
    closing_force: Real = quantity(15.0)
    about: ClassVar[About] = About(
        quantity="gap s",
        unit="m",
        typical=(1e-4, 1e-3),
        kind="instrument",
        one_sided=True,
        in_mould="long toe below 50 N and tail after unloading; H unchanged",
        free="long toe, peak later by s, same peak force",
        confounders=("acquisition_lag", "specimen_density"),
        source="0.1-1 mm: assumption; bedding errors: Sarsby et al. 1982, Barnard and Heymann 2015",
    )

    def travel_error(self, force):
        return -self.strength * jnp.expm1(-jnp.maximum(force, 0.0) / self.closing_force)
