"""The contract of an apparatus: it states what the machine does, as segments.

An apparatus knows rates, forces and durations.  It does not know how a bed is advanced
(`jdem.engine.loop`) nor what soil is in it.
"""

import abc

import equinox as eqx

from jdem.core.quantity import Real, quantity
from jdem.engine.loop import Segment


class Damping(eqx.Module):
    """Background damping (1/s) while the machine loads, and while a specimen comes to rest.

    unloaded is added for spheres that carry next to no load (`jdem.engine.step`): enough to stop
    their rattling, while the loaded skeleton keeps its low damping and with it its strength.
    """

    loading: Real = quantity(200.0)
    resting: Real = quantity(500.0)
    unloaded: Real = quantity(4000.0)


class AbstractApparatus(eqx.Module):
    """One test, run on the specimen as the previous one left it."""

    @abc.abstractmethod
    def segments(self) -> list[Segment]:
        """The machine's movements in order."""

    @property
    @abc.abstractmethod
    def names(self) -> tuple[str, ...]:
        """What each segment is called in the curves."""

    @property
    @abc.abstractmethod
    def time_scales(self) -> tuple[Real, ...]:
        """Nominal over simulated time of each segment: what passes in the laboratory."""
