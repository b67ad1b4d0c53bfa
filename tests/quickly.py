"""Compiling without optimising: a derivative of a few spheres compiles in a third of the time."""

import jax


def quickly(function, **options):
    """`function` jitted as a whole and compiled without optimisation; the same to round-off."""
    cheap = {"xla_backend_optimization_level": 0}
    return jax.jit(function, compiler_options=cheap, **options)
