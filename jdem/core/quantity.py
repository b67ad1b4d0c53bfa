"""Physical numbers as array fields, so that changing a value never compiles anew.

Use `radius: Array = quantity()` in an `eqx.Module`; values are SI and pass this one
converter.  `cast` brings a whole tree to the precision that a simulation runs in.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

Real = jax.Array | float  # what a scalar quantity may be given as; it becomes an array


def as_quantity(value) -> jax.Array:
    """A floating-point array in the default precision (float64 if JAX has it enabled)."""
    if eqx.is_array(value) and jnp.issubdtype(value.dtype, jnp.floating):
        return jnp.asarray(value, dtype=value.dtype)  # the same, but never weakly typed
    if eqx.is_array_like(value) or isinstance(value, np.ndarray):
        return jnp.asarray(value, dtype=jnp.result_type(float))
    return value  # placeholders that JAX's own tree transformations put into fields


def quantity(default: Any = None) -> Any:
    """Field of an `eqx.Module` that holds a physical number in SI units."""
    if default is None:
        return eqx.field(converter=as_quantity)
    return eqx.field(converter=as_quantity, default=default)


def cast(tree, dtype):
    """All floating-point arrays of `tree` in `dtype`; everything else untouched."""

    def to_dtype(leaf):
        floating = eqx.is_array(leaf) and jnp.issubdtype(leaf.dtype, jnp.floating)
        return leaf.astype(dtype) if floating else leaf

    return jax.tree.map(to_dtype, tree)


def check_precision(dtype) -> None:
    """`ValueError` where JAX would silently round to single what is to be computed in double."""
    if jnp.dtype(dtype) == jnp.dtype("float64") and not jax.config.read("jax_enable_x64"):
        raise ValueError(
            "JAX is in single precision: call jax.config.update('jax_enable_x64', True) before "
            "anything else"
        )
