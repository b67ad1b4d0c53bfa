"""Confined compression: the platen comes down in the mould to a force, holds, and returns.

The nominal rate is the laboratory's (8 mm/s in the paper); the simulated rate is faster
and explicit, and has to be shown to be quasi-static (inertial number, halved rate).
"""

import equinox as eqx

from jdem.apparatus.base import AbstractApparatus, Damping
from jdem.core.quantity import Real, quantity
from jdem.engine.loop import KEEP, LOWER, Segment

OVERSHOOT = 2.0  # servo widths


class ConfinedCompression(AbstractApparatus):
    """Loads to force_high (N) at simulated_rate (m/s), holds for `hold` (s), unloads.

    The platen slows down within servo_width (N) of its target and stops when the force
    is within `tolerance` (N) of it.  On loading the target lies OVERSHOOT widths beyond
    force_high, so that force_high is passed at full speed and no creep of the bed at
    standstill is counted as depression; stroke (m) is the farthest it may go.
    """

    simulated_rate: Real = quantity(0.1)
    nominal_rate: Real = quantity(8e-3)
    force_low: Real = quantity(200.0)
    force_high: Real = quantity(400.0)
    servo_width: Real = quantity(1.5)
    tolerance: Real = quantity(0.75)
    stroke: Real = quantity(0.025)
    hold: Real = quantity(0.0)
    damping: Damping = eqx.field(default_factory=Damping)

    @property
    def names(self):
        return ("loading", "holding", "unloading")

    @property
    def time_scales(self):
        return (self.simulated_rate / self.nominal_rate,) * 3

    def segments(self):
        return [
            self._towards(self._beyond_force_high(), self.stroke / self.simulated_rate, LOWER),
            self._holding(),
            self._towards(0.0, self.stroke / self.simulated_rate, KEEP),
        ]

    def _beyond_force_high(self):
        return self.force_high + OVERSHOOT * self.servo_width

    def _towards(self, force, duration, platen) -> Segment:
        return Segment(
            platen_speed=self.simulated_rate,
            force_target=force,
            servo_width=self.servo_width,
            tolerance=self.tolerance,
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=duration,
            platen=platen,
        )

    def _holding(self) -> Segment:
        return Segment(
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=self.hold,
        )
