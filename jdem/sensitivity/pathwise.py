"""Pathwise derivative: forward mode through every step of every simulation.

Exact for the simulation as computed.  Where the motion is chaotic (crushing of small
beds) the exact derivative of one path is not the slope of the response: see
docs/derivatives.md, and `ensemble`.
"""

import equinox as eqx

from jdem.sensitivity.base import AbstractTraced


class Pathwise(AbstractTraced):
    """One tangent a parameter, all in one pass; the response must be traceable by JAX.

    cost is that of one tangent in forward runs (benchmarks/results/README.md).
    """

    cost: float = eqx.field(static=True, default=1.5)

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + self.cost * parameters

    def describe(self) -> str:
        return "pathwise: forward mode through every step"
