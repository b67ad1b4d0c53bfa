"""Compiling without optimising: a derivative of a few spheres compiles in a third of the time."""

import jax


def quickly(function):
    """`function` jitted as a whole and compiled without optimisation; the same to round-off."""
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})
