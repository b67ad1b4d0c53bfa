"""One parameter at a time: slopes over a usable range, with common random numbers.

Antithetic steps +-s along each coordinate, the same packings at every point, and a
straight line through each packing's values:

    slope = sum_s s f(x + s) / sum_s s^2

The line averages over the roughness that chaos puts on a single packing's response.  It
assumes nothing about interactions, costs two runs a parameter and step, and is what
other strategies are audited against.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity, averaged, everywhere


class Regression(AbstractStrategy):
    """`steps` are the positive half of the antithetic steps, in the coordinate's unit."""

    steps: tuple[float, ...] = eqx.field(static=True, default=(0.15, 0.3))

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        offsets = self.offsets()
        count = point.shape[0]
        shifts = np.concatenate([offset * np.eye(count) for offset in offsets])
        probes = np.concatenate([np.asarray(point)[None], np.asarray(point) + shifts])
        values = jnp.asarray(response(everywhere(jnp.asarray(probes), packings)))
        probed = values[1:].reshape(len(offsets), count, *values.shape[1:])
        weight = jnp.asarray(offsets) / np.sum(offsets**2)
        slopes = jnp.einsum("s,spnm->nmp", weight, probed)
        return averaged(values[0], slopes)

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + 2.0 * len(self.steps) * parameters

    def describe(self) -> str:
        steps = ", ".join(f"{step:g}" for step in self.steps)
        return f"regression over antithetic steps of +-{steps} in ln p, one parameter at a time"

    def offsets(self) -> np.ndarray:
        """All steps, positive and negative."""
        positive = np.asarray(self.steps)
        return np.concatenate([positive, -positive])
