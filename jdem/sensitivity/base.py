"""The contract of sensitivity strategies.

A response maps points (k, n, p), one for each of k runs on each of n packings, to values
(k, n, m): m numbers read from a run.  Coordinates are whatever the response takes: ln p of
contact parameters, strengths of effects, settings of the machine.  A strategy returns the
values at one point and the slopes of their mean over the packings.

Strategies that differentiate the simulation itself are given it, not a response.  A tangent that
has grown beyond all forces, or that leaves the specimen out of balance, is no derivative of a
slowly loaded bed, so they also say for each test and parameter, over the test's largest force and
for samples in which the platen carries more than LOADED of it:

    growth       root mean square of dF/dp along the test
    imbalance    that of d(sum of all boundaries' axial forces)/dp, which is zero at rest
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jdem.laboratory.virtual_lab import Outcome, VirtualLab

Response = Callable[[Array], Array]
Simulate = Callable[[VirtualLab, Array], Outcome]  # at coordinates (p,)
Read = Callable[[Outcome], Array]  # numbers (m,)

AXIAL = 2  # column of a boundary's loads
LOADED = 0.01  # of a test's largest force; below, the platen is about to leave the specimen


class Sensitivity(eqx.Module):
    """Values (n, m) on each packing, slopes (m, p) of their mean, standard errors (m, p), and
    slopes (n, m, p) on each packing where the strategy has them."""

    values: Array
    slopes: Array
    standard_error: Array
    by_packing: Array | None = None


class AbstractStrategy(eqx.Module):
    """One way to get from a response to its slopes."""

    @abc.abstractmethod
    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        """Values and slopes of `response` at `point` (p,) over `packings` packings."""

    @abc.abstractmethod
    def runs(self, parameters: int, packings: int) -> float:
        """Forward runs a packing that it costs, values at the point included."""

    @abc.abstractmethod
    def describe(self) -> str:
        """One line for a report."""


def forward_mode(response: Response, point: Array, packings: int) -> Sensitivity:
    """One tangent a coordinate, all in one pass; the response must be traceable by JAX."""

    def single(x):
        return response(everywhere(x[None], packings))[0]

    def push(tangent):
        return jax.jvp(single, (point,), (tangent,))

    tangents = jnp.eye(point.shape[0], dtype=point.dtype)
    values, slopes = jax.vmap(push, out_axes=(None, -1))(tangents)
    return averaged(values, slopes)


def averaged(values: Array, slopes: Array) -> Sensitivity:
    """From slopes (n, m, p) on each packing to their mean and its standard error.

    NaN on a packing (a run that failed) leaves that packing out.
    """
    count = jnp.sum(jnp.isfinite(slopes), axis=0)
    error = jnp.nanstd(slopes, axis=0, ddof=1) / jnp.sqrt(count)
    return Sensitivity(values, jnp.nanmean(slopes, axis=0), error, slopes)


def everywhere(points: Array, packings: int) -> Array:
    """The same points (k, p) on every packing, shape (k, n, p)."""
    return jnp.broadcast_to(points[:, None], (points.shape[0], packings, points.shape[1]))


class Traced(eqx.Module):
    """Values (m,) and slopes (m, p) of one run; growth and imbalance (-) of shape (tests, p)."""

    values: Array
    slopes: Array
    growth: Array
    imbalance: Array


class AbstractTraced(AbstractStrategy):
    """A strategy that differentiates runs of `laboratory(lab)`."""

    def laboratory(self, lab: VirtualLab) -> VirtualLab:
        """The laboratory that is to run: values are those of `lab`."""
        return lab

    def traced(self, lab: VirtualLab, simulate: Simulate, read: Read, point: Array) -> Traced:
        """What `read` finds in a run of `lab` (as `laboratory` returns it), and its slopes."""
        return forward(lab, lambda x: (simulate(lab, x), jnp.zeros(0)), read, point)

    def refusals(self, lab: VirtualLab, found: Traced) -> list[list[str]]:
        """For each test and parameter why its slopes are not believed; "" where they are."""
        return [["" for _ in row] for row in found.growth]

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        return forward_mode(response, point, packings)


def forward(
    lab: VirtualLab,
    simulated: Callable[[Array], tuple[Outcome, Array]],
    read: Read,
    point: Array,
    further: int = 0,
) -> Traced:
    """One tangent a coordinate, all in one pass.

    The last `further` coordinates are no parameters: they keep as many numbers constant, the
    second result of `simulated`.
    """

    def everything(x: Array):
        outcome, kept = simulated(x)
        samples = outcome.record.samples
        total = jnp.sum(samples.loads[..., AXIAL], axis=-1)
        return (read(outcome), kept, samples.platen_force, total), samples.segment

    def push(tangent: Array):
        return jax.jvp(everything, (point,), (tangent,), has_aux=True)

    tangents = jnp.eye(point.shape[0], dtype=point.dtype)
    values, slopes, segment = jax.vmap(push, out_axes=(None, -1, None))(tangents)
    count = point.shape[0] - further
    implied = _implied(slopes[1][:, :count], slopes[1][:, count:])
    found, _, force, total = (part[..., :count] + part[..., count:] @ implied for part in slopes)
    test = _test_of(lab, segment)
    chosen = [test == number for number in range(len(lab.tests.apparatus))]
    size = jnp.abs(values[2])
    largest = [jnp.max(size * rows) for rows in chosen]
    chosen = [rows & (size > LOADED * most) for rows, most in zip(chosen, largest, strict=True)]
    growth, imbalance = (
        [_size(part, rows) / most for rows, most in zip(chosen, largest, strict=True)]
        for part in (force, total)
    )
    return Traced(values[0], found, jnp.stack(growth), jnp.stack(imbalance))


def _implied(by_parameter: Array, by_further: Array) -> Array:
    """Slopes (further, p) of the further coordinates that keep their numbers constant."""
    return -jnp.linalg.solve(by_further, by_parameter)


def _test_of(lab: VirtualLab, segment: Array) -> Array:
    """Number of the test that each sample belongs to; -1: none."""
    test = lab.tests.timetable().test
    return jnp.where(segment >= 0, test[jnp.maximum(segment, 0)], -1)


def _size(slopes: Array, rows: Array) -> Array:
    """Root mean square of slopes (samples, p) over the chosen samples."""
    squares = jnp.where(rows[:, None], slopes, 0.0) ** 2
    return jnp.sqrt(jnp.sum(squares, axis=0) / jnp.maximum(jnp.sum(rows), 1))


def stands_free(lab: VirtualLab) -> list[bool]:
    """For each test whether its specimen stands without a mould at some time."""
    return [any(movement.free for movement in test.movements()) for test in lab.tests.apparatus]
