"""Functions whose value is one thing and whose derivative is another.

No value ever depends on what a derivative is made of: each function here returns its first
argument, or zero, whatever the others are.
"""

import jax
import jax.numpy as jnp
from jax import Array


@jax.custom_jvp
def slowed(value: Array, affine: Array, share: Array) -> Array:
    """The value; its derivative is affine' + share (value' - affine')."""
    return value


@slowed.defjvp
def _slowed_derivative(values, tangents):
    value, _, share = values
    own, affine, _ = tangents
    return value, affine + share * (own - affine)


@jax.custom_jvp
def resisted(velocity: Array, constant: Array) -> Array:
    """Zero; its derivative is that of a dashpot's force, -constant velocity'."""
    return jnp.zeros_like(velocity)


@resisted.defjvp
def _resisted_derivative(values, tangents):
    velocity, constant = values
    return jnp.zeros_like(velocity), -constant * tangents[0]


def with_derivative_of(value, other):
    """The value of one and the derivative of the other; arrays or trees of arrays."""

    def joined(a, b):
        return jax.lax.stop_gradient(a) + (b - jax.lax.stop_gradient(b))

    return jax.tree.map(joined, value, other)
