"""Conventions: what programs put beside the same normal law, and call EEPA all the same.

                      friction feels    tangential spring    rolling
    eepa              N                 k_tm k1              torque mu_r |f_hys| r, own spins
    liggghts          |N + f_damp|      k_tm k_t             spring k_t R*^2, limit mu_r R* load
    liggghts_history  |f_n|             k_t                  spring k_t R*^2, limit mu_r R* load

N is the load with the adhesive share (Thakur et al. 2014, eq. 11), k_t = k1 sqrt(d/R*).

`eepa` is Thakur et al. 2014.  The others are those of LIGGGHTS 3.8, `model edinburgh`: with
`tan_luding` and `luding`, and with `history` and `epsd2`.  There tangential_multiplier is
coeffFrictionStiffness and rolling_friction coefficientRollingFriction, one to one.
"""

from collections.abc import Mapping
from typing import NamedTuple

import jax.numpy as jnp

from jdem.core.quantity import Real
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractNormalLaw
from jdem.laws.composite import DEEPEST, ContactLaw
from jdem.laws.friction import ConstantTorque, CoulombSpring
from jdem.laws.liggghts import LudingSpring, RollingSpring, WholeLoad
from jdem.mechanics.elasticity import AbstractStiffness, EdinburghStiffness

# Tangential over normal dashpot with `tan_luding`, its FrictionViscosity.  Quasi-static tests
# hardly feel it, and long time steps do not bear all of it.
FRICTION_VISCOSITY = 0.3


class Parts(NamedTuple):
    """What a soil states: parameters by name (SI), normal law, elasticity, widths of roundings,
    how much of its adhesion acts (1 between spheres), and the spheres' mean diameter over that at
    which surface energies are stated."""

    values: Mapping[str, Real]
    normal: AbstractNormalLaw
    stiffness: AbstractStiffness
    smoothing: Smoothing
    adhesion: Real = 1.0
    size: Real = 1.0


def eepa(parts: Parts) -> ContactLaw:
    """Thakur et al. 2014, Granular Matter 16, 383."""
    values, smoothing = parts.values, parts.smoothing
    return ContactLaw(
        normal=parts.normal,
        shear=parts.stiffness,
        tangential=CoulombSpring(values["restitution"], smoothing),
        rolling=ConstantTorque(values["rolling_friction"], smoothing),
        tangential_multiplier=values["tangential_multiplier"],
    )


def liggghts(parts: Parts) -> ContactLaw:
    """LIGGGHTS 3.8: `edinburgh tangential tan_luding rolling_friction luding`."""
    multiplier = parts.values["tangential_multiplier"]
    return _edinburgh(parts, WholeLoad(parts.normal), multiplier, FRICTION_VISCOSITY)


def liggghts_history(parts: Parts) -> ContactLaw:
    """LIGGGHTS 3.8: `edinburgh tangential history rolling_friction epsd2`."""
    one = jnp.ones_like(parts.values["tangential_multiplier"])
    return _edinburgh(parts, WholeLoad(parts.normal, adhesive=False), one, 1.0)


def _edinburgh(
    parts: Parts, normal: AbstractNormalLaw, multiplier: Real, viscosity: float
) -> ContactLaw:
    if parts.values["slope_exponent"] != 1.0:
        raise ValueError("slope_exponent is 1.5, but LIGGGHTS' conventions are for 1; give 1")
    shear = EdinburghStiffness(parts.stiffness)
    restitution, rolling = (parts.values[name] for name in ("restitution", "rolling_friction"))
    softest = multiplier * DEEPEST**0.5
    share = viscosity * jnp.ones_like(multiplier)
    return ContactLaw(
        normal=normal,
        shear=shear,
        tangential=LudingSpring(parts.stiffness, restitution, share, softest, parts.smoothing),
        rolling=RollingSpring(shear, rolling, parts.smoothing),
        tangential_multiplier=multiplier,
    )


DEFAULT = "eepa"
CONVENTIONS = {
    "eepa": eepa,
    "liggghts": liggghts,
    "liggghts_history": liggghts_history,
}
