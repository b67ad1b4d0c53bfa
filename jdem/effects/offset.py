"""The load cell was not tared, or carries the platen's weight.

F_shown = F + b
"""

from typing import ClassVar

import jax.numpy as jnp

from jdem.core.quantity import Real, quantity
from jdem.effects.base import About, AbstractEffect


class LoadCellOffset(AbstractEffect):
    """Strength: offset b, N, two-sided; the same in both tests.

    The baseline and the peak shift by b; slopes stay, H changes by the curve's curvature, and
    force does not return to zero.  in_servo as for the gain.  b up to 10 N: zero errors are at
    most 0.1 % in class 1 of ISO 7500-1 (2018; read second-hand), taken of 10 kN, the cell's
    full scale, by assumption.
    """

    strength: Real = quantity(0.0)
    in_servo: Real = quantity(1.0)
    about: ClassVar[About] = About(
        quantity="offset b",
        unit="N",
        typical=(-10.0, 10.0),
        kind="instrument",
        one_sided=False,
        in_mould="baseline shifted, also after release; H by curvature only",
        free="all forces shifted by b",
        confounders=("load_cell_drift", "surface_energy"),
        source="0.1 % in class 1 of ISO 7500-1:2018 (second-hand), of 10 kN: assumption",
    )

    def force_error(self, reading, time):
        return self.strength * jnp.ones_like(reading)

    def servo_error(self, reading, time):
        return self.in_servo * self.force_error(reading, time)
