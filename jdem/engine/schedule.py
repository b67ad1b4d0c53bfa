"""What changes around a bed while the machine's programme runs: its laws, what the servo sees.

In the base model nothing does (`Unchanging`).  `jdem.effects` lets soils change from one test
to the next and instruments lie; the one loop only asks the questions of this contract.
"""

import abc
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
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


class Joining(AbstractSurroundings):
    """What `others` do, and bonds between spheres, which form as segment number `at` begins.

    They form within its first sampling interval, and at no other time.
    """

    others: AbstractSurroundings
    at: int = eqx.field(static=True)

    def begin(self, dtype) -> tuple[Any, Array]:
        """Theirs, and the segment of the interval before: none."""
        return self.others.begin(dtype), jnp.full((), -1, jnp.int32)

    def bed(self, bed: Bed, segment: Array, memory: tuple[Any, Array]) -> Bed:
        others, before = memory
        bed = self.others.bed(bed, segment, others)
        now = (segment == self.at) & (before != self.at)
        return replace(bed, particle_law=bed.particle_law.joining(now))

    def shown(self, reading: Array, memory: tuple[Any, Array]) -> Array:
        return self.others.shown(reading, memory[0])

    def later(self, memory, segment: Array, before: BedState, after: BedState):
        return self.others.later(memory[0], segment, before, after), segment
