"""The load cell's zero wanders with its temperature.

F_shown = F + c t        t: nominal time since the cell was tared
"""

from typing import ClassVar

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class LoadCellDrift(AbstractEffect):
    """Strength: rate c, N/s of nominal time, two-sided; tared as each loading begins.

    Nothing is seen in the confined test, which lasts seconds; a slow ramp in the unconfined
    one, which lasts many minutes at the laboratory's rate.  in_servo as for the gain.
    c = 0.1 to 0.5 % of full scale an hour, 10 kN (recalled).
    """

    strength: Real = quantity(0.0)
    in_servo: Real = quantity(1.0)
    about: ClassVar[About] = About(
        quantity="rate c of nominal time",
        unit="N/s",
        typical=(-0.014, 0.014),
        one_sided=False,
        confined="none: seconds",
        unconfined="ramp c t, highest in the tail",
        confounders=("load_cell_offset", "second_test_factor", "capillary_tension"),
        source="0.1-0.5 % of 10 kN an hour (recalled)",
    )

    def force_error(self, reading, time):
        return self.strength * time

    def servo_error(self, reading, time):
        return self.in_servo * self.force_error(reading, time)
