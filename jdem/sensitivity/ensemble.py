"""Ensemble regression: groups of parameters moved together, other directions on every packing.

The parameters are dealt into groups.  For each group one antithetic pair of runs on each packing,
at x + s d and x - s d, moves the group's parameters together, with signs d in {-1, 1} taken
from the rows of a Hadamard matrix, dealt out over the packings.  Half the difference of a pair,

    [f(x + s d) - f(x - s d)] / 2 = (s d) . slope + odd orders of s + noise,

is free of the packing's own level and of all even orders (curvature and interactions of two
parameters), so a least-squares line through a group's pairs on all packings gives the group's
slopes.  Every slope uses one pair on every packing, as it does when one parameter is moved at
a time, and the number of runs is that of the groups, not of the parameters.

Two errors grow with the size of a group: third orders (a slope that depends on another
parameter's square) bias it, and a packing's own slope in one parameter leaks into the others.
Parameters that matter should therefore stand in different groups: the coordinates come in
the order in which they are dealt out, the first into the first group, and so on
(docs/derivatives.md has the errors of both).

Common random numbers and antithetic steps: Glasserman 2003, Monte Carlo Methods in
Financial Engineering, section 7.1; foldover and group screening designs: Box, Hunter and
Hunter 2005, Statistics for Experimenters, chapters 5 and 6; Watson 1961, Technometrics 3, 371.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import hadamard

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity, everywhere


class Ensemble(AbstractStrategy):
    """`steps` in the coordinates' units, one for all or one for each.

    `groups` are lists of coordinates that are moved together; None puts all into one group.
    `pairs` is the number of antithetic pairs of runs for each group and packing; a group that
    would have fewer pairs than coordinates gets more.  Standard errors are NaN where no pair
    is left over.
    """

    steps: float | tuple[float, ...] = eqx.field(static=True, default=0.2)
    groups: tuple[tuple[int, ...], ...] | None = eqx.field(static=True, default=None)
    pairs: int = eqx.field(static=True, default=1)

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        count = point.shape[0]
        groups = self._groups(count)
        steps = np.broadcast_to(np.asarray(self.steps, float), count)
        shifts = [self._shifts(group, steps, packings) for group in groups]
        every = jnp.asarray(np.concatenate(shifts))
        centre = everywhere(jnp.asarray(point)[None], packings)
        values = np.asarray(response(jnp.concatenate([centre, centre + every, centre - every])))
        half = _half_differences(values, len(every))
        ends = np.cumsum([len(shift) for shift in shifts])[:-1]
        slopes = np.empty((values.shape[-1], count))
        errors = np.empty_like(slopes)
        for group, shift, rows in zip(groups, shifts, np.split(half, ends), strict=True):
            found = _line(shift[..., group].reshape(-1, len(group)), rows)
            slopes[:, group], errors[:, group] = found
        return Sensitivity(*(jnp.asarray(part) for part in (values[0], slopes, errors)))

    def runs(self, parameters: int, packings: int) -> float:
        groups = self._groups(parameters)
        return 1 + 2.0 * sum(self._pairs(len(group), packings) for group in groups)

    def freedom(self, parameters: int, packings: int) -> list[int]:
        """Degrees of freedom of each slope's standard error."""
        found = [0] * parameters
        for group in self._groups(parameters):
            for coordinate in group:
                found[coordinate] = self._pairs(len(group), packings) * packings - len(group)
        return found

    def describe(self) -> str:
        steps = sorted(set(np.atleast_1d(self.steps).tolist()))
        sizes = "all parameters moved together"
        if self.groups is not None:
            lengths = sorted({len(group) for group in self.groups})
            each = " to ".join(str(n) for n in (lengths[0], lengths[-1])[: len(lengths)])
            sizes = f"{len(self.groups)} groups of {each} parameters moved together"
        return (
            f"ensemble: {sizes}, {self.pairs} antithetic pair{'s' * (self.pairs > 1)} of runs a "
            f"group and packing, by +-{' or '.join(f'{step:.3g}' for step in steps)} in ln p, "
            "common random numbers"
        )

    def _groups(self, parameters: int) -> list[list[int]]:
        if self.groups is None:
            return [list(range(parameters))]
        return [list(group) for group in self.groups]

    def _pairs(self, size: int, packings: int) -> int:
        return max(self.pairs, -(-size // packings))

    def _shifts(self, group: Sequence[int], steps: np.ndarray, packings: int) -> np.ndarray:
        """Shifts (pairs, packings, p) of one group; zero for all other coordinates."""
        pairs, size = self._pairs(len(group), packings), len(group)
        order = 1 << max(size - 1, 1).bit_length()
        dealt = np.arange(packings)[None] * pairs + np.arange(pairs)[:, None]
        shifts = np.zeros((pairs, packings, len(steps)))
        shifts[..., group] = hadamard(order)[dealt % order, -size:] * steps[group]
        return shifts


def dealt(parameters: int, groups: int) -> tuple[tuple[int, ...], ...]:
    """Coordinates 0, 1, 2, ... dealt out in turn."""
    return tuple(tuple(range(first, parameters, groups)) for first in range(groups))


def _half_differences(values: np.ndarray, pairs: int) -> np.ndarray:
    """Half of each pair's difference, (pairs, n, m), from (1 + 2 pairs, n, m)."""
    return (values[1 : pairs + 1] - values[pairs + 1 :]) / 2


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
    left = count - parameters
    variance = np.sum(rest**2, axis=0) / left if left else np.full(rows.shape[1], np.nan)
    spread = np.diag(np.linalg.inv(shifts.T @ shifts))
    return slopes.T, np.sqrt(np.outer(variance, spread))
