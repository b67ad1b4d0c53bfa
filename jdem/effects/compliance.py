"""The testing machine yields: frame, load cell and platens are a spring behind the platen.

d_shown = d + F/K
"""

from typing import ClassVar

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class LoadFrameCompliance(AbstractEffect):
    """Strength: compliance 1/K, m/N, one-sided; K does not depend on the force.

    Slopes change by 1/(1 + S/K), S being the soil's: the steepest part, unloading, suffers
    most; H grows by (F_high - F_low)/K, forces stay.  K = 1 to 20 kN/mm is an assumption for a
    small screw-driven machine; a fatigue frame of 100 kN alone has 260 kN/mm (MTS 318.10,
    manual, p. 22: 0.38 mm at 100 kN).  That the platen itself then moves a little slower is
    left out.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="compliance 1/K",
        unit="m/N",
        typical=(5e-8, 1e-6),
        kind="instrument",
        one_sided=True,
        in_mould="every slope flatter, unloading most; H up by 200 N/K",
        free="pre-peak flatter, peak later by F/K, same peak force",
        confounders=("shear_modulus", "plasticity_ratio"),
        source="K of 1-20 kN/mm: assumption",
    )

    def travel_error(self, force):
        return self.strength * force
