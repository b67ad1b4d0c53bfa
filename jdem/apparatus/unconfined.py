"""Unconfined compression: mould opened and removed, rest, then crushing past the peak.

The mould opens slowly (an abrupt removal rings), the platen is taken away, and the rest
lasts until the kinetic energy is gone; the platen is then lowered onto the specimen.
"""

import equinox as eqx
import jax.numpy as jnp

from jdem.apparatus.base import AbstractApparatus, Damping
from jdem.core.quantity import Real, quantity
from jdem.engine.loop import KEEP, LOWER, REMOVE, Segment


class UnconfinedCompression(AbstractApparatus):
    """Crushes at simulated_rate (m/s) through `stroke` (m).

    The mould opens by `opening` (m) at opening_rate (m/s); `rest` (s) is the simulated
    rest, which is shorter than the laboratory's nominal_rest because damping takes the
    kinetic energy out faster; times in s.
    """

    simulated_rate: Real = quantity(0.05)
    nominal_rate: Real = quantity(1e-5)
    nominal_rest: Real = quantity(1.0)
    stroke: Real = quantity(0.010)
    opening: Real = quantity(1e-3)
    opening_rate: Real = quantity(0.02)
    rest: Real = quantity(0.05)
    damping: Damping = eqx.field(default_factory=Damping)

    @property
    def names(self):
        return ("opening", "resting", "crushing")

    @property
    def time_scales(self):
        rest = self.nominal_rest / jnp.maximum(self.rest, 1e-9)
        return (1.0, rest, self.simulated_rate / self.nominal_rate)

    def segments(self):
        return [self._opening(), self._resting(), self._crushing()]

    def _opening(self) -> Segment:
        return Segment(
            mould_speed=self.opening_rate,
            damping=self.damping.resting,
            unloaded_damping=self.damping.unloaded,
            duration=self.opening / self.opening_rate,
            platen=REMOVE,
        )

    def _resting(self) -> Segment:
        return Segment(
            damping=self.damping.resting,
            unloaded_damping=self.damping.unloaded,
            duration=self.rest,
            platen=KEEP,
            mould=REMOVE,
        )

    def _crushing(self) -> Segment:
        return Segment(
            platen_speed=self.simulated_rate,
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=self.stroke / self.simulated_rate,
            platen=LOWER,
            mould=REMOVE,
        )
