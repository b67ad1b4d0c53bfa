"""Derivatives of a kernel: values by the kernel itself, tangents by a second one.

XLA compiles a kernel that computes values and tangents together in another way than one of
the values alone, and their last bits differ.  So values come from the same program whether
tangents are wanted or not, and tangents from a program that takes the same arguments and
hands out nothing else.
"""

from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jdem.core.fusion import fenced
from jdem.core.linear import narrowed, pushed_forward


def differentiable(
    kernels: Sequence[Callable], fixed: Any, function: Callable, *arguments: Any
) -> Any:
    """kernel(fixed, function, *arguments), which is function(*arguments), with its tangents.

    Those are kernel(fixed, g, *doubled), where each of `doubled` holds an argument's arrays and
    those of its tangent; no derivative passes through `fixed`.  The first of the two kernels is
    for values, the second for tangents.
    """
    for_values, for_tangents = kernels
    arrays, static = eqx.partition(arguments, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    sizes = [part.num_leaves for part in structure.children()]

    def by_leaves(*parts):
        leaves = list(chain(*parts))
        return function(*eqx.combine(jax.tree.unflatten(structure, leaves), static))

    @jax.custom_jvp
    def values(fixed, *leaves):
        with fenced():
            return for_values(fixed, by_leaves, *_split(leaves, sizes))

    def derivative(primals, tangents):
        (fixed, *leaves), (_, *slopes) = primals, tangents
        found = values(fixed, *leaves)
        moving = [not isinstance(slope, SymbolicZero) for slope in slopes]
        changes = []
        if any(moving):
            known, moved = _told_apart(leaves, moving)
            slopes = [narrowed(leaf) for leaf in _told_apart(slopes, moving)[1]]
            parts = (_split(part, sizes) for part in (known, moved, slopes))
            with fenced():
                changes = for_tangents(fixed, _pushed(by_leaves), *zip(*parts, strict=True))
        return found, _as_tangent(found, changes)

    values.defjvp(derivative, symbolic_zeros=True)
    return values(fixed, *leaves)


def _pushed(function: Callable) -> Callable:
    """Tangents of the function's floating-point results, from its doubled arguments."""

    def pushed(*doubled):
        known, moved, slopes = (list(chain(*part)) for part in zip(*doubled, strict=True))

        def results(moved):
            both = [a if b is None else b for a, b in zip(known, moved, strict=True)]
            return [leaf for leaf in jax.tree.leaves(function(both)) if _floating(leaf)]

        return pushed_forward(results, moved, slopes)

    return pushed


def _split(leaves, sizes: list[int]) -> list[list]:
    """The leaves of each argument."""
    rest = iter(leaves)
    return [[next(rest) for _ in range(size)] for size in sizes]


def _told_apart(leaves, moving: list[bool]) -> tuple[list, list]:
    """Those that do not move and those that do, each with None in place of the others."""
    pairs = list(zip(leaves, moving, strict=True))
    return [None if m else leaf for leaf, m in pairs], [leaf if m else None for leaf, m in pairs]


def _as_tangent(found, changes: list):
    """A tangent of the results from `changes` of the floating-point ones; None and no list are
    zero."""
    leaves, structure = jax.tree.flatten(found)
    rest = iter(changes or [None] * len(leaves))
    tangents = [_changed(leaf, next(rest)) if _floating(leaf) else _still(leaf) for leaf in leaves]
    return jax.tree.unflatten(structure, tangents)


def _changed(leaf, change):
    return jnp.zeros_like(leaf) if change is None else change.astype(leaf.dtype)


def _still(leaf):
    return np.zeros(leaf.shape, jax.dtypes.float0)


def _floating(leaf) -> bool:
    return jnp.issubdtype(leaf.dtype, jnp.inexact)


# ---- values that have the derivative of something else: no value depends on it


@jax.custom_jvp
def resisted(velocity: Array, constant: Array) -> Array:
    """Zero; its derivative is that of a dashpot's force, -constant velocity'."""
    return jnp.zeros_like(velocity)


@resisted.defjvp
def _resisted_derivative(values, tangents):
    velocity, constant = values
    return jnp.zeros_like(velocity), -constant * tangents[0]


def with_derivative_of(value, other):
    """The value of one and the derivative of the other; arrays or trees of arrays.

    Arrays of the other may be smaller: they are repeated, as numpy does it.
    """

    def joined(value: Array, other: Array) -> Array:
        return _joined(value, jnp.broadcast_to(other, jnp.shape(value)))

    return jax.tree.map(joined, value, other)


@jax.custom_jvp
def _joined(value: Array, other: Array) -> Array:
    """The value alone: in value + (other - other), the two others may be rounded differently."""
    return value


@_joined.defjvp
def _joined_derivative(values, tangents):
    return values[0], tangents[1].astype(values[0].dtype)
