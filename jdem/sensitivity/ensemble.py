"""Ensemble regression: all parameters at once, another direction on every packing.

Pairs of runs at x + s d and x - s d, with the signs d in {-1, 1}^p taken from the rows of a
Hadamard matrix, dealt out over the packings.  Half the difference of a pair,

    [f(x + s d) - f(x - s d)] / (2 s) = d . slope + odd orders of s + noise,

is free of the packing's own level and of all even orders (curvature and interactions of two
parameters), so one least-squares line through the pairs of all packings gives every slope
from every run.  A one-at-a-time difference uses two runs of each packing for a slope; here
each slope uses them all: the standard error is smaller by sqrt(p) at equal cost, and a few runs
a packing are enough for any number of parameters.

Common random numbers and antithetic steps: Glasserman 2003, Monte Carlo Methods in
Financial Engineering, section 7.1; foldover two-level designs: Box, Hunter and Hunter
2005, Statistics for Experimenters, chapters 5 and 6.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import hadamard

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity, everywhere


class Ensemble(AbstractStrategy):
    """`step` in the coordinate's unit; `pairs` of antithetic runs on each packing.

    Where pairs x packings would not exceed the number of parameters, more pairs are taken.
    """

    step: float = eqx.field(static=True, default=0.2)
    pairs: int = eqx.field(static=True, default=2)

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        signs = self.signs(point.shape[0], packings)
        shift = self.step * jnp.asarray(signs)
        centre = everywhere(jnp.asarray(point)[None], packings)
        values = jnp.asarray(response(jnp.concatenate([centre, centre + shift, centre - shift])))
        pairs = len(signs)
        halves = (values[1 : pairs + 1] - values[pairs + 1 :]) / (2 * self.step)
        slopes, errors = _line(signs.reshape(-1, point.shape[0]), np.asarray(halves))
        return Sensitivity(values[0], jnp.asarray(slopes), jnp.asarray(errors))

    def signs(self, parameters: int, packings: int) -> np.ndarray:
        """Directions (pairs, packings, p)."""
        pairs = self._pairs(parameters, packings)
        order = 1 << max(parameters - 1, 1).bit_length()
        dealt = np.arange(packings)[None] * pairs + np.arange(pairs)[:, None]
        return hadamard(order)[dealt % order, -parameters:].astype(float)

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + 2.0 * self._pairs(parameters, packings)

    def describe(self) -> str:
        return (
            f"ensemble: {self.pairs} antithetic pairs of runs a packing, all parameters moved "
            f"together by +-{self.step:g} in ln p, common random numbers"
        )

    def _pairs(self, parameters: int, packings: int) -> int:
        return max(self.pairs, -(-(parameters + 1) // packings))


def _line(signs: np.ndarray, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares slopes (m, p) and standard errors from half differences (pairs, n, m).

    Pairs with a failed run (NaN) are left out; NaN comes back where too few are left.
    """
    rows = halves.reshape(len(signs), -1)
    used = np.all(np.isfinite(rows), axis=1)
    signs, rows = signs[used], rows[used]
    count, parameters = signs.shape
    if count < parameters or np.linalg.matrix_rank(signs) < parameters:
        unknown = np.full((halves.shape[-1], parameters), np.nan)
        return unknown, unknown
    slopes = np.linalg.lstsq(signs, rows, rcond=None)[0]
    rest = rows - signs @ slopes
    variance = np.sum(rest**2, axis=0) / max(count - parameters, 1)
    spread = np.diag(np.linalg.inv(signs.T @ signs))
    return slopes.T, np.sqrt(np.outer(variance, spread))
