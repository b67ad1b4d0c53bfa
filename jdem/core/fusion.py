"""A fusion boundary: what must be computed once, although several results need it.

XLA's CPU compiler fuses by repetition: an intermediate quantity of a contact is computed
again in the loop of every output that needs it, and an `optimization_barrier` is gone
before that happens.  A call that must not be inlined stays, so the identity behind one
keeps what is before it apart from what follows, without copying anything (an always-true
conditional does so too, but copies every array; timings in docs/decisions/2026-11-24-beds.md).

Laws say `once(...)` without knowing why; the engine opens `fenced` around a time step.
Outside of it, as for a single contact, `once` does nothing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

import jax
from jax.experimental.xla_metadata import set_xla_metadata

Tree = TypeVar("Tree")

_bounded: ContextVar[bool] = ContextVar("bounded", default=False)


@contextmanager
def fenced() -> Iterator[None]:
    """Makes `once` a boundary while a step is traced.

    Elsewhere than on a CPU there are no boundaries: other backends fuse several outputs
    into one loop by themselves.
    """
    token = _bounded.set(jax.default_backend() == "cpu")
    try:
        yield
    finally:
        _bounded.reset(token)


def bounded() -> bool:
    """Whether a step is being traced for a CPU."""
    return _bounded.get()


def once(tree: Tree) -> Tree:
    """The tree of arrays, computed exactly once."""
    if not bounded():
        return tree
    with set_xla_metadata(inlineable="false"):
        return _kept(tree)


BOUNDARY = "_kept"  # what a program calls it


@jax.jit
def _kept(tree):
    """The tree; the barrier keeps JAX from seeing that nothing happens here."""
    return jax.lax.optimization_barrier(tree)
