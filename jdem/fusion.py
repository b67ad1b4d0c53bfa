"""A fusion boundary: what must be computed once, although several results need it.

XLA's CPU compiler fuses by repetition: an intermediate quantity of a contact is computed
again in the loop of every output that needs it, and an `optimization_barrier` is gone
before that happens.  A conditional stays, so the identity inside an always-true one keeps
what is before it apart from what follows (docs/decisions.md has the timings).

Laws say `once(...)` without knowing why; the engine opens `boundaries` around a time step.
Outside of it, as for a single contact, `once` does nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import Array

Tree = TypeVar("Tree")

_always: ContextVar[Array | None] = ContextVar("always", default=None)


@contextmanager
def boundaries(always: Array) -> Iterator[None]:
    """Makes `once` a boundary while a step is traced.

    `always` is a scalar that is true at run time, which the compiler must not find out: let
    it depend on what a loop carries.  Elsewhere than on a CPU there are no boundaries, because
    a conditional would wait for the host.
    """
    token = _always.set(always if jax.default_backend() == "cpu" else None)
    try:
        yield
    finally:
        _always.reset(token)


def once(tree: Tree) -> Tree:
    """The tree of arrays, computed exactly once."""
    always = _always.get()
    if always is None:
        return tree
    return jax.lax.cond(
        always, lambda kept: kept, lambda kept: jax.tree.map(jnp.zeros_like, kept), tree
    )
