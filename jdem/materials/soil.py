"""The soil's parameters under the names that the field (and EDEM) uses, and its laws.

    dgamma(d) = surface_energy d / reference_diameter

Strength of a cohesive packing scales as dgamma/d (Rumpf 1962), so spheres that are
coarser than the soil's own grains carry more surface energy: `surface_energy` keeps
its meaning at `reference_diameter` while the spheres are of any size.
"""

import equinox as eqx
from jax import Array

from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractContactLaw
from jdem.laws.composite import ContactLaw
from jdem.laws.coulomb import CoulombSpring
from jdem.laws.eepa import EEPA
from jdem.laws.rolling import ConstantTorque
from jdem.mechanics.elasticity import (
    AbstractStiffness,
    HertzStiffness,
    LinearStiffness,
    contact_modulus,
    contact_shear_modulus,
)


class SoilParameters(eqx.Module):
    """Contact parameters of one soil; SI units, defaults are those of the bundled soil.

    restitution, static_friction, rolling_friction, plasticity_ratio, tensile_exponent
    and tangential_multiplier are dimensionless; surface_energy in J/m2 at
    reference_diameter (m); shear_modulus in Pa; pull_off_force in N (<= 0);
    wall_friction and platen_friction belong to the mould and to the platens.
    slope_exponent (1 or 1.5) chooses the law, so it is static.
    """

    restitution: Real = quantity(0.322)
    static_friction: Real = quantity(0.676)
    rolling_friction: Real = quantity(0.1)
    surface_energy: Real = quantity(17.158)
    plasticity_ratio: Real = quantity(0.7)
    tensile_exponent: Real = quantity(2.0)
    tangential_multiplier: Real = quantity(0.8)
    shear_modulus: Real = quantity(7e6)
    pull_off_force: Real = quantity(0.0)
    wall_friction: Real = quantity(0.1)
    platen_friction: Real = quantity(0.3)
    poisson_ratio: Real = quantity(0.3)
    reference_diameter: Real = quantity(8e-5)
    wall_adhesion: Real = quantity(0.0)
    stiffness_factor: Real = quantity(2.0)
    slope_exponent: float = eqx.field(static=True, default=1.0)

    def __check_init__(self):
        if self.slope_exponent not in (1.0, 1.5):
            raise ValueError(f"slope_exponent is {self.slope_exponent}; give 1 or 1.5")


def particle_law(
    soil: SoilParameters, mean_diameter: Array, smoothing: Smoothing
) -> AbstractContactLaw:
    """Law between spheres of `mean_diameter` (m)."""
    return _law(soil, soil.surface_energy * mean_diameter / soil.reference_diameter, smoothing)


def wall_law(
    soil: SoilParameters, mean_diameter: Array, smoothing: Smoothing
) -> AbstractContactLaw:
    """Law between a sphere and a wall of the same modulus; adhesion x `wall_adhesion`."""
    scaled = soil.surface_energy * mean_diameter / soil.reference_diameter
    return _law(soil, soil.wall_adhesion * scaled, smoothing)


def elasticity(soil: SoilParameters) -> AbstractStiffness:
    """k1 and its slope exponent from shear modulus and Poisson's ratio."""
    modulus = contact_modulus(soil.shear_modulus, soil.poisson_ratio)
    if soil.slope_exponent == 1.0:
        return LinearStiffness(modulus, soil.stiffness_factor)
    return HertzStiffness(modulus, contact_shear_modulus(soil.shear_modulus, soil.poisson_ratio))


def _law(soil: SoilParameters, surface_energy: Array, smoothing: Smoothing) -> ContactLaw:
    stiffness = elasticity(soil)
    normal = EEPA(
        stiffness=stiffness,
        restitution=soil.restitution,
        surface_energy=surface_energy,
        plasticity_ratio=soil.plasticity_ratio,
        tensile_exponent=soil.tensile_exponent,
        pull_off_force=soil.pull_off_force,
        smoothing=smoothing,
    )
    return ContactLaw(
        normal=normal,
        shear=stiffness,
        tangential=CoulombSpring(soil.restitution, smoothing),
        rolling=ConstantTorque(soil.rolling_friction, smoothing),
        tangential_multiplier=soil.tangential_multiplier,
    )
