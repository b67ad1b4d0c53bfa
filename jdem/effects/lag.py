"""The force reading is late: filter, sampling, controller.

tau dR/dt = F - R        R: what the servo acts on and the record stores
"""

from typing import ClassVar

import equinox as eqx

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect
from jdem.engine.segment import Segment


class AcquisitionLag(AbstractEffect):
    """Strength: time constant tau, s of nominal time, one-sided.

    The machine reverses late: readings on loading lie v tau further, the true force overshoots
    by v tau S (S the soil's slope), the reading goes on rising while the platen turns and forms
    a loop.  Nothing at the slow rate of crushing.  Solved in the loop, in nominal time,
    so a faster simulation has the same v tau.  tau = 20 to 100 ms (10 to 48 N at 8 mm/s) is an
    assumption; the 15 to 30 samples a second that a maker calls the least (IQC Test, company
    page) are 33 to 67 ms apart.
    """

    strength: Real = quantity(0.0)
    about: ClassVar[About] = About(
        quantity="time constant tau",
        unit="s",
        typical=(0.02, 0.1),
        kind="instrument",
        one_sided=True,
        in_mould="loading shifted by v tau, force beyond the target, rounded reversal, loop",
        free="none: slow; the specimen was pressed harder",
        confounders=("seating_gap", "wall_friction", "rate_dependence"),
        source="20-100 ms: assumption; samples 33-67 ms apart (IQC Test, company page)",
    )

    def programme(self, programme: Segment, time_scale):
        return eqx.tree_at(lambda p: p.lag, programme, programme.lag + self.strength / time_scale)
