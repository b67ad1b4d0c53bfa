"""Pathwise derivative: forward mode through every step of every simulation.

Exact for the simulation as computed.  Where the motion is chaotic (crushing of small
beds) the exact derivative of one path is not the slope of the response: see
docs/gradients.md, and `ensemble`.
"""

import equinox as eqx
from jax import Array

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity, forward_mode


class Pathwise(AbstractStrategy):
    """One tangent a parameter, all in one pass; the response must be traceable by JAX.

    cost is that of one tangent in forward runs (benchmarks/results/speed.md).
    """

    cost: float = eqx.field(static=True, default=1.5)

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        return forward_mode(response, point, packings)

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + self.cost * parameters

    def describe(self) -> str:
        return "pathwise: forward mode through every step"
