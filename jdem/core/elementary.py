"""ln x and x^(1/3) in arithmetic that vectorises: for these XLA's CPU compiler calls the C library,
number by number, and contact laws ask for millions a second.

The logarithm takes the exponent's bits apart:

    x = 2^k m with m in [sqrt(1/2), sqrt(2)],   ln x = k ln 2 + 2 artanh s,   s = (m - 1)/(m + 1)

artanh s = s + s^3/3 + ... up to s^21, as |s| < 0.172.  Within 4e-16 of ln x, relative or, near
x = 1, absolute (timings in docs/decisions/2026-11-24-beds.md).

The cube root takes one of Halley's steps, which makes an error e of 2/3 e^3:

    c <- c (c^3 + 2 x)/(2 c^3 + x)

It begins at exp(ln(x)/3) in single precision, which is right to 1e-6, and so ends at the last
digits of a double.
"""

import jax
import jax.numpy as jnp
from jax import Array

_LN2 = 0.6931471805599453
_ROOT_HALF = 0x3FE6A09E00000000  # bits of sqrt(1/2), rounded down to 20 bits of its fraction
_FRACTION = 52  # bits of a double behind its exponent


@jax.custom_jvp
def logarithm(x: Array) -> Array:
    """ln x for normal x > 0; NaN where x is infinite or NaN.  Other types than float64 as they are
    in JAX, whose logarithm of float32 does vectorise."""
    return _of_double(x) if x.dtype == jnp.float64 else jnp.log(x)


@jax.jit
def _of_double(x: Array) -> Array:
    bits = jax.lax.bitcast_convert_type(x, jnp.int64)
    exponent = (bits - _ROOT_HALF) >> _FRACTION
    part = jax.lax.bitcast_convert_type(bits - (exponent << _FRACTION), x.dtype)
    s = (part - 1) / (part + 1)
    square = s * s
    series = jnp.zeros_like(s)
    for power in range(21, 1, -2):
        series = series * square + 2 / power
    passed_on = 0.0 * x  # NaN where x is no number
    return exponent.astype(x.dtype) * _LN2 + (2 * s + s * square * series) + passed_on


@logarithm.defjvp
def _slope_of_logarithm(primals, tangents):
    (x,), (tangent,) = primals, tangents
    return logarithm(x), tangent / x


@jax.custom_jvp
def cube_root(x: Array) -> Array:
    """x^(1/3) for x > 0 within the range of single precision, 1e-38 to 1e38."""
    x = jnp.asarray(x)
    single = x.astype(jnp.float32)
    begun = jnp.exp(jnp.log(single) / 3).astype(x.dtype)
    cube = begun**3
    return begun * ((cube + 2 * x) / (2 * cube + x))


@cube_root.defjvp
def _slope_of_root(primals, tangents):
    """dc/dx = c/(3 x), of the root and not of the way to it."""
    (x,), (tangent,) = primals, tangents
    root = cube_root(x)
    return root, root / (3 * x) * tangent
