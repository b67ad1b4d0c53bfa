"""Unconfined compression: mould opened and removed, rest, then crushing past the peak.

The mould opens slowly (an abrupt removal rings), the platen is taken away, and the rest
lasts until the kinetic energy is gone; the platen is then lowered onto the specimen.
"""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.apparatus.base import AbstractApparatus, Damping, Movement, Reading, Readings, curve_of
from jdem.core.quantity import Real, quantity
from jdem.engine.segment import KEEP, LOWER, REMOVE, Segment, cell_segment
from jdem.observables import crushing_force, running_mean


class UnconfinedCompression(AbstractApparatus):
    """Crushes at simulated_rate (m/s) through `stroke` (m).

    The mould opens by `opening` (m) at opening_rate (m/s); `rest` (s) is the simulated
    rest, which is shorter than the laboratory's nominal_rest because damping takes the
    kinetic energy out faster; times in s.  The crushing force is the maximum, smoothed over
    peak_width (N), of the force averaged over peak_rows samples.  `further` movements may
    follow.
    """

    simulated_rate: Real = quantity(0.05)
    nominal_rate: Real = quantity(1e-5)
    nominal_rest: Real = quantity(1.0)
    stroke: Real = quantity(0.010)
    opening: Real = quantity(1e-3)
    opening_rate: Real = quantity(0.02)
    rest: Real = quantity(0.05)
    damping: Damping = eqx.field(default_factory=Damping)
    peak_width: float = eqx.field(static=True, default=2.0)
    peak_rows: int = eqx.field(static=True, default=5)
    name: str = eqx.field(static=True, default="unconfined")
    further: tuple[Movement, ...] = ()

    def movements(self) -> list[Movement]:
        rest = self.nominal_rest / jnp.maximum(self.rest, 1e-9)
        scale = self.simulated_rate / self.nominal_rate
        return [
            Movement("opening", self._opening(), 1.0, testing=False, free=True),
            Movement("resting", self._resting(), rest, testing=False, free=True, resting=True),
            Movement("crushing", self._crushing(), scale, free=True),
            *self.further,
        ]

    def read(self, readings: Readings, movement: Array) -> Reading:
        crushing = curve_of(readings, movement == 2)
        force = crushing_force(running_mean(crushing, self.peak_rows), self.peak_width)
        whole = curve_of(readings, (movement >= 2) & (movement < len(self.names)))
        return Reading(whole, {"crushing_force": force}, jnp.isfinite(force))

    @property
    def observables(self) -> tuple[str, ...]:
        return ("crushing_force",)

    def at_rate(self, factor: float) -> "UnconfinedCompression":
        return replace(self, simulated_rate=self.simulated_rate * factor).sampled(1 / factor)

    def sampled(self, ratio: float) -> "UnconfinedCompression":
        """With the peak averaged over `ratio` times as many rows (an odd number)."""
        return replace(self, peak_rows=2 * int(self.peak_rows * ratio / 2) + 1)

    def _opening(self) -> Segment:
        return cell_segment(
            mould_speed=self.opening_rate,
            damping=self.damping.resting,
            unloaded_damping=self.damping.unloaded,
            duration=self.opening / self.opening_rate,
            platen=REMOVE,
        )

    def _resting(self) -> Segment:
        return cell_segment(
            damping=self.damping.resting,
            unloaded_damping=self.damping.unloaded,
            duration=self.rest,
            platen=KEEP,
            mould=REMOVE,
        )

    def _crushing(self) -> Segment:
        return cell_segment(
            platen_speed=self.simulated_rate,
            damping=self.damping.loading,
            unloaded_damping=self.damping.unloaded,
            duration=self.stroke / self.simulated_rate,
            platen=LOWER,
            mould=REMOVE,
        )
