"""The contract of sensitivity strategies.

A response maps points (k, p) to values (k, n, m): m observables on each of n packings.
A strategy returns the values at one point and their slopes, averaged over packings,
with the standard error that the packings' scatter leaves.
"""

import abc
from collections.abc import Callable

import equinox as eqx
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
    def __call__(self, response: Response, point: Array) -> Sensitivity:
        """Values and slopes of `response` at `point` (p,)."""


def averaged(values: Array, slopes: Array) -> Sensitivity:
    """From slopes (n, m, p) on each packing to their mean and its standard error.

    NaN on a packing (a run that failed) leaves that packing out.
    """
    count = jnp.sum(jnp.isfinite(slopes), axis=0)
    error = jnp.nanstd(slopes, axis=0, ddof=1) / jnp.sqrt(count)
    return Sensitivity(values, jnp.nanmean(slopes, axis=0), error)
