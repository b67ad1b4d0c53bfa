"""The contract of sensitivity strategies.

A response maps points (k, n, p), one for each of k runs on each of n packings, to values
(k, n, m): m numbers read from a run.  Coordinates are whatever the response takes: ln p of
contact parameters, strengths of effects, settings of the machine.  A strategy returns the
values at one point and the slopes of their mean over the packings.
"""

import abc
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

Response = Callable[[Array], Array]


class Sensitivity(eqx.Module):
    """Values (n, m) on each packing, slopes (m, p) of their mean, standard errors (m, p)."""

    values: Array
    slopes: Array
    standard_error: Array


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
    return Sensitivity(values, jnp.nanmean(slopes, axis=0), error)


def everywhere(points: Array, packings: int) -> Array:
    """The same points (k, p) on every packing, shape (k, n, p)."""
    return jnp.broadcast_to(points[:, None], (points.shape[0], packings, points.shape[1]))
