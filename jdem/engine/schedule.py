"""What changes around a bed while the machine's programme runs: its laws, what the servo sees.

In the base model nothing does (`Unchanging`).  `jdem.effects` lets soils change from one test
to the next and instruments lie; the one loop only asks the questions of this contract.
"""

import abc
from typing import Any

import equinox as eqx
from jax import Array

from jdem.engine.step import Bed, BedState


class AbstractSurroundings(eqx.Module):
    """Asked once before the first sampling interval, and before and after each interval.

    `memory` is a tree of arrays that the loop carries for the surroundings; `segment` is the
    number of the segment under way.
    """

    @abc.abstractmethod
    def begin(self, dtype) -> Any:
        """The memory before the first interval."""

    @abc.abstractmethod
    def bed(self, bed: Bed, segment: Array, memory: Any) -> Bed:
        """The bed as it is during one interval."""

    @abc.abstractmethod
    def shown(self, reading: Array, memory: Any) -> Array:
        """The force (N) that the servo sees where the load cell reads `reading` (N)."""

    @abc.abstractmethod
    def later(self, memory: Any, segment: Array, before: BedState, after: BedState) -> Any:
        """The memory after one interval."""


class Unchanging(AbstractSurroundings):
    """The base model: one bed, an honest load cell."""

    def begin(self, dtype) -> tuple[()]:
        return ()

    def bed(self, bed: Bed, segment: Array, memory: Any) -> Bed:
        return bed

    def shown(self, reading: Array, memory: Any) -> Array:
        return reading

    def later(self, memory: Any, segment: Array, before: BedState, after: BedState) -> Any:
        return memory
