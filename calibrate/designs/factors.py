"""A factor: a named quantity that an experiment sets between two levels.

Coded units put the low level at -1 and the high level at +1:

    natural = centre + coded * (high - low)/2            linear
    natural = sqrt(low high) * (high/low)^(coded/2)      logarithmic (geometric centre)

Values outside -1..1 are allowed: star points of a central composite design lie there.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calibrate.core.errors import BadValue, shown


@dataclass(frozen=True)
class Factor:
    """Name, low and high level in `unit`; `log` spaces the levels geometrically.

    `BadValue` if the levels are not finite and in order, or not positive with `log`, or if
    the name could not stand as a column of a CSV file.
    """

    name: str
    low: float
    high: float
    unit: str = ""
    log: bool = False

    def __post_init__(self):
        reserved = self.name in ("run", "point") or self.name.startswith("dummy_")
        if reserved or not self.name.strip() or set(self.name) & set(',;"#\n\r*^+[]'):
            repair = "use letters, digits and underscores, and not run, point or dummy_..."
            raise BadValue(f"{shown(self.name)} cannot name a factor", repair, "name")
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            problem = f"the levels of {self.name} are {self.low} and {self.high}"
            raise BadValue(problem, "give two finite numbers, the lower first", self.name)
        if self.log and self.low <= 0:
            problem = f"{self.name} has the low level {self.low} on a logarithmic scale"
            raise BadValue(problem, "give a level above 0, or a linear scale", self.name)

    @property
    def label(self) -> str:
        """Name with its unit, for axes and column headings."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def centre(self) -> float:
        """The natural value whose coded value is 0."""
        return float(self.natural(0.0))

    @property
    def scaled_centre(self) -> float:
        """Middle of the levels on the scale on which the factor is linear (its logarithm)."""
        low, high = self._scaled_levels()
        return (low + high) / 2

    @property
    def half_range(self) -> float:
        """Half the distance of the levels on the scale on which the factor is linear."""
        low, high = self._scaled_levels()
        return (high - low) / 2

    def natural(self, coded: ArrayLike) -> np.ndarray:
        """Natural values of coded ones, of any shape."""
        scaled = self.scaled_centre + np.asarray(coded, float) * self.half_range
        return np.exp(scaled) if self.log else scaled

    def coded(self, natural: ArrayLike) -> np.ndarray:
        """Coded values of natural ones, of any shape; NaN for log of what is not positive."""
        values = np.asarray(natural, float)
        if self.log:
            values = np.log(np.where(values > 0, values, np.nan))
        return (values - self.scaled_centre) / self.half_range

    def _scaled_levels(self) -> tuple[float, float]:
        if self.log:
            return math.log(self.low), math.log(self.high)
        return self.low, self.high


def natural_points(factors: tuple[Factor, ...], coded: np.ndarray) -> np.ndarray:
    """Natural values (n, p) of coded points (n, p)."""
    return np.column_stack([f.natural(column) for f, column in zip(factors, coded.T, strict=True)])
