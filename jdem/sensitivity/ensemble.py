"""Ensemble regression: all parameters at once, another direction on every packing.

Pairs of runs at x + s d and x - s d, with the signs d in {-1, 1}^p taken from the rows of a
Hadamard matrix, dealt out over the packings.  Half the difference of a pair,

    [f(x + s d) - f(x - s d)] / 2 = (s d) . slope + odd orders of s + noise,

is free of the packing's own level and of all even orders (curvature and interactions of two
parameters), so one least-squares line through the pairs of all packings gives every slope
from every run.  A one-at-a-time difference uses two runs of each packing for a slope; here
each slope uses them all: the standard error is smaller by sqrt(p) at equal cost, and a few runs
a packing are enough for any number of parameters.

Third orders remain: a slope that depends on another parameter's curvature (x_i x_j^2) is
biased by it.  Steps should therefore be short in parameters on which the response bends, and
values that are positive throughout are regressed as logarithms, in which products of powers
do not interact at all.

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
    """`steps` in the coordinates' units, one for all or one for each; `pairs` of antithetic
    runs on each packing.

    Where pairs x packings would not exceed the number of parameters, more pairs are taken.
    """

    steps: float | tuple[float, ...] = eqx.field(static=True, default=0.2)
    pairs: int = eqx.field(static=True, default=2)

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        signs = self.signs(point.shape[0], packings)
        shift = jnp.asarray(signs * np.asarray(self.steps))
        centre = everywhere(jnp.asarray(point)[None], packings)
        probes = jnp.concatenate([centre, centre + shift, centre - shift])
        values = np.asarray(response(probes))
        scaled, unit = _logarithms(values)
        pairs = len(signs)
        halves = (scaled[1 : pairs + 1] - scaled[pairs + 1 :]) / 2
        slopes, errors = _line(np.asarray(shift).reshape(-1, point.shape[0]), halves)
        unit = unit[:, None]
        return Sensitivity(
            jnp.asarray(values[0]), jnp.asarray(unit * slopes), jnp.asarray(unit * errors)
        )

    def signs(self, parameters: int, packings: int) -> np.ndarray:
        """Directions (pairs, packings, p)."""
        pairs = self._pairs(parameters, packings)
        order = 1 << max(parameters - 1, 1).bit_length()
        dealt = np.arange(packings)[None] * pairs + np.arange(pairs)[:, None]
        return hadamard(order)[dealt % order, -parameters:].astype(float)

    def runs(self, parameters: int, packings: int) -> float:
        return 1 + 2.0 * self._pairs(parameters, packings)

    def describe(self) -> str:
        steps = sorted(set(np.atleast_1d(self.steps).tolist()))
        return (
            f"ensemble: {self.pairs} antithetic pairs of runs a packing, all parameters moved "
            f"together by +-{' or '.join(f'{step:.3g}' for step in steps)} in ln p, common random "
            "numbers"
        )

    def _pairs(self, parameters: int, packings: int) -> int:
        return max(self.pairs, -(-(parameters + 1) // packings))


def _logarithms(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (k, n, m), columns without a value below or at zero as logarithms, and what a
    slope of each column is to be multiplied with: its mean at the centre, or 1."""
    positive = np.all((values > 0) | np.isnan(values), axis=(0, 1))
    logarithm = np.log(np.where(positive, values, 1.0))
    counted = np.maximum(np.sum(np.isfinite(values[0]), axis=0), 1)
    unit = np.where(positive, np.nansum(values[0], axis=0) / counted, 1.0)
    return np.where(positive, logarithm, values), unit


def _line(shifts: np.ndarray, halves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares slopes (m, p) and standard errors from half differences (pairs, n, m).

    Pairs with a failed run (NaN) are left out; NaN comes back where too few are left.
    """
    rows = halves.reshape(len(shifts), -1)
    used = np.all(np.isfinite(rows), axis=1)
    shifts, rows = shifts[used], rows[used]
    count, parameters = shifts.shape
    if count < parameters or np.linalg.matrix_rank(shifts) < parameters:
        unknown = np.full((halves.shape[-1], parameters), np.nan)
        return unknown, unknown
    slopes = np.linalg.lstsq(shifts, rows, rcond=None)[0]
    rest = rows - shifts @ slopes
    variance = np.sum(rest**2, axis=0) / max(count - parameters, 1)
    spread = np.diag(np.linalg.inv(shifts.T @ shifts))
    return slopes.T, np.sqrt(np.outer(variance, spread))
