"""How curves are read: displacements at forces, forces at displacements, and where both begin.

A curve is displacement and force (n,), in the order of recording, of numpy or of JAX, which can
differentiate every reading.  The length's unit is the curve's own; forces are N.

    part of the curve          what it is                                      made by
    loading                    up to the largest force, as it was read         `loading`
    unloading                  after it, in the order of rising force          `unloading`
    rise, fall                 the closest rising curve (isotonic regression)  `rising`, `falling`

All of them are read by one function, `displacement_on_rise`.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import isotonic_regression

from jdem.observables import displacement_on_rise, running_maximum

TINY = 1e-9  # N
FEWEST = 4  # points that make a straight line
FEWEST_NEAR = 3  # points that make a mean
PEAK_WIDTH = 0.02  # share of the largest force within which the place of the peak is averaged
PEAK_PLACES = 401  # along a curve, where its peak is looked for


@dataclass(frozen=True)
class Zero:
    """Where displacement begins to count: at a force (N) on loading, straight between two rows, so
    that it does not depend on how often readings were taken; or as recorded (None).  `beyond` (mm)
    is added to it."""

    force: float | None = None
    beyond: float = 0.0

    def of(self, displacement, force):
        """Displacement at the zero of a curve's part on which force rises."""
        if self.force is None:
            return self.beyond
        return displacement_on_rise(displacement, force, self.force) + self.beyond


AS_RECORDED = Zero()


def loading(displacement, force) -> tuple[Any, Any]:
    """The curve up to its largest force; later rows are put there."""
    numbers = force.__array_namespace__()
    top = numbers.argmax(force)
    before = numbers.arange(len(force)) <= top
    way, load = (numbers.where(before, part, part[top]) for part in (displacement, force))
    return way, load


def unloading(displacement, force):
    """The curve from its largest force on, backwards: the lowest force that had been reached."""
    numbers = force.__array_namespace__()
    top = numbers.argmax(force)
    after = numbers.arange(len(force)) >= top
    way, load = (numbers.where(after, part, part[top]) for part in (displacement, force))
    return way[::-1], -running_maximum(-load)[::-1]


def rising(displacement, force, averaged: bool = True):
    """The closest rising curve, whose levels are means over the rows of a block.

    averaged: of displacements as well; else those of the rows.  What is a block is decided by the
    readings and has no derivative.
    """
    if isinstance(force, np.ndarray):
        fit = isotonic_regression(force)
        if not averaged:
            return displacement, fit.x
        edges = fit.blocks
        return np.add.reduceat(displacement, edges[:-1]) / np.diff(edges), fit.x[edges[:-1]]
    means = _block_means(force)
    return means(displacement) if averaged else displacement, means(force)


def falling(displacement, force):
    """The same for a falling curve, in the order of rising force."""
    return rising(displacement[::-1], force[::-1])


def _block_means(force: jax.Array):
    """A function that replaces the rows of an array (n,) by the means of their blocks."""

    def numbered(force: np.ndarray) -> np.ndarray:
        edges = isotonic_regression(np.asarray(force)).blocks
        return np.repeat(np.arange(len(edges) - 1), np.diff(edges)).astype(np.int32)

    shape = jax.ShapeDtypeStruct(force.shape, jnp.int32)
    still = jax.lax.stop_gradient(force)
    block = jax.pure_callback(numbered, shape, still, vmap_method="sequential")
    rows = jax.ops.segment_sum(jnp.ones_like(force), block, len(force))

    def means(part: jax.Array) -> jax.Array:
        return (jax.ops.segment_sum(part, block, len(force)) / jnp.maximum(rows, 1))[block]

    return means


def mean_of(values, chosen):
    """Mean of the chosen values, at least one."""
    if isinstance(values, np.ndarray):
        return values[chosen].mean()
    return jnp.sum(jnp.where(chosen, values, 0.0)) / jnp.sum(chosen)


def force_near(displacement, force, wanted, half_width: float = 0.0):
    """Force at `wanted` displacements: the mean over the rows within `half_width` of it.

    Straight between two rows where fewer than three lie there, and with no half-width, where
    `wanted` may be an array (m,).
    """
    numbers = force.__array_namespace__()
    between = numbers.interp(wanted, displacement, force)
    if half_width == 0:
        return between
    near = abs(displacement - wanted) <= half_width
    enough = near.sum() >= FEWEST_NEAR
    return numbers.where(enough, mean_of(force, near | ~enough), between)


def mean_force(displacement: np.ndarray, force: np.ndarray, low: float, high: float) -> float:
    """Mean of the force between two displacements (low < high) of a curve that goes on, straight
    between its rows and level beyond them."""
    inside = (displacement > low) & (displacement < high)
    way = np.concatenate([[low], displacement[inside], [high]])
    ends = np.interp([low, high], displacement, force)
    load = np.concatenate([ends[:1], force[inside], ends[1:]])
    return float(np.trapezoid(load, way) / (high - low))


def averaged(travel, force, locations, half_width):
    """Force at `locations` (m,) from a straight line through the points within `half_width`.

    Where fewer than four points lie there: straight between the neighbours.
    """
    numbers = force.__array_namespace__()
    offset = travel[None, :] - locations[:, None]
    weight = (abs(offset) <= half_width).astype(float)
    count = weight.sum(axis=1)
    enough = count >= FEWEST
    safe = numbers.where(enough, count, 1.0)
    middle = (weight * offset).sum(axis=1) / safe
    level = weight @ force / safe
    spread = (weight * offset**2).sum(axis=1) / safe - middle**2
    joint = (weight * offset) @ force / safe - middle * level
    slope = joint / numbers.where(spread > 0, spread, 1.0)
    order = numbers.argsort(travel, stable=True)
    between = numbers.interp(locations, travel[order], force[order])
    return numbers.where(enough & (spread > 0), level - slope * middle, between)


def peak_displacement(displacement, force, half_width: float):
    """Displacement at the peak of the force, once it is averaged over `half_width` to either side.

        u = sum u_k w_k / sum w_k,    w_k = exp((F_k/F_max - 1)/PEAK_WIDTH)

    over places at equal distances along the curve.  So noise on a flat peak moves it by little, the
    middle of a symmetric peak is met exactly, and it has a derivative in the forces.
    """
    numbers = force.__array_namespace__()
    places = numbers.linspace(displacement.min(), displacement.max(), PEAK_PLACES)
    along = averaged(displacement, force, places, half_width)
    highest = numbers.maximum(along.max(), TINY)
    weight = numbers.exp((along / highest - 1) / PEAK_WIDTH)
    return (weight * places).sum() / weight.sum()


def passing(displacement, force, row, wanted: float, rising: bool, tolerance: float):
    """Row and displacement at which the curve first passes a force, from `row` on.

    Where it never does: its nearest row, and NaN unless that is within `tolerance` (N).
    """
    numbers = force.__array_namespace__()
    sign = 1.0 if rising else -1.0
    ahead = numbers.arange(len(force)) >= row
    rest = numbers.where(ahead, sign * force, -numbers.inf)
    reached = rest >= sign * wanted
    nearest, at = numbers.argmax(rest), numbers.argmax(reached)
    close = abs(rest[nearest] - sign * wanted) <= tolerance
    before = numbers.maximum(at - 1, row)
    change = force[at] - force[before]
    safe = numbers.where(change == 0, 1.0, change)
    share = numbers.where(change == 0, 1.0, (wanted - force[before]) / safe)
    way = displacement[at] - displacement[before]
    passed = displacement[before] + numbers.clip(share, 0.0, 1.0) * way
    never = numbers.where(close, displacement[nearest], numbers.nan)
    found = reached.any()
    return numbers.where(found, at, nearest), numbers.where(found, passed, never)
