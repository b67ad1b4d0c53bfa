"""Dashpot of a linear spring that rebounds with a given speed ratio.

    beta = sqrt(4 m* k / (1 + (pi / ln e)^2))

Thakur et al. 2014, Granular Matter 16, 383, eq. (8).  With plastic or adhesive
springs the rebound is slower still: e is the dashpot's share only.
"""

import jax.numpy as jnp
from jax import Array

from jdem.core.parameter import FRACTION, Parameter, Search
from jdem.core.quantity import Real

HERTZIAN = (5 / 6) ** 0.5  # with this share of the dashpot, rebounds are e at every speed

# A sphere's dashpots add up, its frequencies as their squares: n contacts brake its spin n times
# as fast as one and swing sqrt(n) times as fast.  The safety of time steps reckons with the latter.
# With 1.5 single spheres of 2000 still blew up.
TOGETHER = 2.5


def dashpot_constant(restitution: Real, mass: Array, stiffness: Array) -> Array:
    """beta, N s/m, for 0 < restitution <= 1, effective mass (kg) and stiffness (N/m)."""
    log = jnp.log(jnp.asarray(restitution))
    return 2 * jnp.sqrt(mass * stiffness) * damping_ratio(log)


def hertzian_dashpot(restitution: Real, mass: Array, stiffness: Array) -> Array:
    """2 sqrt(5/6) zeta sqrt(S m*), N s/m, of a spring whose stiffness S (N/m) goes with the root of
    the overlap; 0 with zero gradient where S is 0."""
    positive = stiffness > 0
    beta = dashpot_constant(restitution, mass, jnp.where(positive, stiffness, 1.0))
    return jnp.where(positive, HERTZIAN * beta, 0.0)


def damping_ratio(log_restitution: Array) -> Array:
    """-ln e / sqrt(pi^2 + ln^2 e): fraction of critical damping, dimensionless."""
    return -log_restitution / jnp.sqrt(jnp.pi**2 + log_restitution**2)


def longest_step(mass: Array, stiffness: Array, ratio: Real) -> Array:
    """2 sqrt(m/k) (sqrt(1 + z^2) - z), s: the longest stable step of an explicit integration.

    Central differences whose dashpot sees the velocity half a step before; z is the share of
    critical damping.  Belytschko, Liu, Moran 2000, Nonlinear Finite Elements, section 6.6.
    """
    return 2 * jnp.sqrt(mass / stiffness) * (jnp.sqrt(1 + ratio * ratio) - ratio)


PARAMETERS = (
    Parameter(
        name="restitution",
        symbol="e",
        label="coefficient of restitution",
        accepted=FRACTION,
        repair="give a number above 0 and below 1, such as 0.5",
        search=Search(0.1, 0.9, 0.3, calibrated_sd=0.2),
        names={
            "EDEM": "Interaction soil - soil / Coefficient of Restitution",
            "LIGGGHTS": "coefficientRestitution",
            "Yade": "G0",
        },
    ),
)
