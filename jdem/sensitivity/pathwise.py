"""Pathwise derivative: forward mode through every step of every simulation.

Exact for the simulation as computed.  Where the motion is chaotic (crushing of small
beds) the exact derivative of one path is not the slope of the response: see
docs/decisions.md, and `regression`.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity, averaged


class Pathwise(AbstractStrategy):
    """One tangent a parameter; memory of one run, cost of one to two runs a parameter."""

    def __call__(self, response: Response, point: Array) -> Sensitivity:
        def single(x):
            return response(x[None])[0]

        tangents = jnp.eye(point.shape[0], dtype=point.dtype)
        columns = [jax.jvp(single, (point,), (tangent,)) for tangent in tangents]
        slopes = jnp.stack([column[1] for column in columns], axis=-1)
        return averaged(columns[0][0], slopes)
