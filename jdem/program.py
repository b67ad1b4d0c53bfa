"""Compiling a simulation so that cores share what does not depend on each other in a step.

XLA orders a CPU program for the least memory, which makes most of a time step wait for
something else.  Ordered for concurrency instead, both halves of the pair list and the wall
contacts run at the same time (docs/decisions.md has the timings).  The order changes no digit.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx

OPTIONS: dict[str, Any] = {
    "compiler_options": {"xla_cpu_enable_concurrency_optimized_scheduler": True}
}  # of jax.jit


def program(function: Callable) -> Any:
    """`equinox.filter_jit` of a function that simulates, with `OPTIONS`."""
    return eqx.filter_jit(function, **OPTIONS)
