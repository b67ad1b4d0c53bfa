"""The load cell's zero wanders with its temperature.

F_shown = F + c t        t: nominal time since the cell was tared
"""

from typing import ClassVar

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class LoadCellDrift(AbstractEffect):
    """Strength: rate c, N/s of nominal time, two-sided; tared as each loading begins.

    Nothing is seen in the mould, where a test lasts seconds; a slow ramp in the free
    one, which lasts many minutes at the laboratory's rate.  in_servo as for the gain.
    c = 0.014 N/s, 0.5 % of 10 kN an hour, is an assumption: a cell whose data sheet gives a
    zero of 0.05 % of full scale per 10 K (Octogon FRB) does a tenth of it at 10 K an hour.
    """

    strength: Real = quantity(0.0)
    in_servo: Real = quantity(1.0)
    about: ClassVar[About] = About(
        quantity="rate c of nominal time",
        unit="N/s",
        typical=(-0.014, 0.014),
        kind="instrument",
        one_sided=False,
        in_mould="none: seconds",
        free="ramp c t, highest in the tail",
        confounders=("load_cell_offset", "second_test_factor", "capillary_tension"),
        source="0.5 % of 10 kN an hour: assumption; zero 0.05 % per 10 K (Octogon FRB, data sheet)",
    )

    def force_error(self, reading, time):
        return self.strength * time

    def servo_error(self, reading, time):
        return self.in_servo * self.force_error(reading, time)
