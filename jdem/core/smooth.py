"""The only place where a kink is rounded.

Every rounding is a fillet: it differs from the sharp function only within
`width` of the kink, is continuously differentiable, and tends to the sharp
function as `width` -> 0 (width 0 is allowed and gives the sharp function).
`width` has the unit of the quantity that is rounded; the docstrings state the
value and the slope at the kink.  Guards are double-`where`: neither values nor
gradients become NaN at zero.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.elementary import logarithm
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector


class Smoothing(eqx.Module):
    """Widths of all roundings, each a fraction of the quantity named, or in its unit.

    | field | rounds | unit of the width |
    |---|---|---|
    | branch | corner of unloading line and adhesive branch | x f_min, N |
    | cap | switch to the capped adhesion | x cap, N |
    | reload | hand-over of the plastic memory on adhesive reload | x d_p, m |
    | slip | stick to slip of the tangential spring | x friction limit, N |
    | roll | onset of the rolling torque with the spin | rad/s |
    | load | sign of the normal force in the rolling limit | x friction's load, N |
    | onset | switching on of the dashpot with the overlap | x R*, m |
    """

    branch: Real = quantity(0.2)
    cap: Real = quantity(0.2)
    reload: Real = quantity(0.02)
    slip: Real = quantity(0.05)
    roll: Real = quantity(0.01)
    load: Real = quantity(0.05)
    onset: Real = quantity(1e-4)

    @staticmethod
    def sharp() -> "Smoothing":
        """All widths zero: the laws as they are printed."""
        return Smoothing(*[0.0] * 7)


def divide(numerator, denominator) -> Array:
    """numerator / denominator, and 0 with zero gradient where the denominator is 0."""
    safe = jnp.where(denominator == 0, 1.0, denominator)
    return jnp.where(denominator == 0, 0.0, numerator / safe)


def ramp(x, width) -> Array:
    """max(x, 0); at the kink: value width/4, slope 1/2."""
    size = jnp.maximum(x, -x)  # |x| with slope 0 at 0, where JAX's abs has 1
    inside = jnp.maximum(width - size, 0.0)
    return jnp.maximum(x, 0.0) + divide(inside * inside, 4 * width)


def maximum(a, b, width) -> Array:
    """max(a, b); at a = b: value a + width/4, slopes 1/2 and 1/2."""
    return b + ramp(a - b, width)


def minimum(a, b, width) -> Array:
    """min(a, b); at a = b: value a - width/4, slopes 1/2 and 1/2."""
    return b - ramp(b - a, width)


def absolute(x, width) -> Array:
    """|x|; at the kink: value width/2, slope 0."""
    return ramp(x, width) + ramp(-x, width)


def step(x, width) -> Array:
    """0 for x <= 0, 1 for x >= width; between: cubic, slopes 0 at both ends."""
    t = jnp.clip(divide(x, width), 0.0, 1.0)
    return jnp.where(width > 0, t * t * (3 - 2 * t), jnp.where(x > 0, 1.0, 0.0))


def saturate(s, width) -> Array:
    """min(s, 1) for s >= 0; reaches 1 at s = 1 + width with slope 0, at s = 1: 1 - width/4."""
    return minimum(s, 1.0, width)


def saturate_slope(s, width) -> Array:
    """d saturate / d s: 1 before the fillet, 1/2 at s = 1, 0 from s = 1 + width."""
    sharp = jnp.where(s < 1.0, 1.0, 0.0)
    return jnp.where(width > 0, jnp.clip(divide(1 + width - s, 2 * width), 0.0, 1.0), sharp)


def limited(spring: Vector, load, width) -> tuple[Vector, Array]:
    """A spring whose force over its limit is `load`, cut to where it reaches the limit for good,
    and the share of its force that acts: force = k spring share, at most the limit.  At load = 1:
    share 1 - width/4."""
    longest = 1 + width
    spring = spring * jnp.where(load > longest, longest / jnp.maximum(load, longest), 1.0)
    load = jnp.minimum(load, longest)
    return spring, jnp.where(load > 0, divide(saturate(load, width), load), 1.0)


def norm(vector: Vector) -> Array:
    """|vector|, with zero gradient at zero."""
    square = vector.dot(vector)
    return jnp.where(square == 0, 0.0, jnp.sqrt(jnp.where(square == 0, 1.0, square)))


def power(base, exponent, floor) -> Array:
    """base**exponent for base >= 0 with a finite slope at 0.

    Below `floor` (unit of `base`) the curve is the chord from the origin to
    (floor, floor**exponent): value 0 and slope floor**(exponent - 1) at zero.
    """
    above = jnp.maximum(base, floor)
    curve = jnp.exp(exponent * logarithm(above))
    chord = base * jnp.exp((exponent - 1) * jnp.log(floor))
    return jnp.where(base < floor, chord, curve)
