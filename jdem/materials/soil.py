"""The soil's parameters under the names that the field (and EDEM) uses, and its laws.

    dgamma(d) = surface_energy d / reference_diameter

Strength of a cohesive packing scales as dgamma/d (Rumpf 1962), so spheres that are
coarser than the soil's own grains carry more surface energy: `surface_energy` keeps
its meaning at `reference_diameter` while the spheres are of any size.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import equinox as eqx
from jax import Array

from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractContactLaw, AbstractNormalLaw
from jdem.laws.eepa import EEPA
from jdem.materials.conventions import Parts, eepa
from jdem.mechanics.elasticity import (
    AbstractStiffness,
    HertzStiffness,
    LinearStiffness,
    contact_modulus,
    contact_shear_modulus,
)


class NormalLaw(Protocol):
    """A class of normal laws that a soil can choose; `jdem.materials.catalogue` lists them."""

    __name__: str

    def of(
        self,
        values: Mapping[str, Real],
        diameter: Real,
        adhesion: Real,
        stiffness: AbstractStiffness,
        smoothing: Smoothing,
    ) -> AbstractNormalLaw:
        """The law from a soil's parameters by name, for bodies of a mean `diameter` (m), with
        `adhesion` times the soil's own (1 between spheres)."""
        ...


_CHOICES = ("law", "conventions", "further")  # fields of a soil that are no numbers


class SoilParameters(eqx.Module):
    """Contact parameters of one soil; SI units, defaults are those of the bundled soil.

    restitution, static_friction, rolling_friction, plasticity_ratio, tensile_exponent
    and tangential_multiplier are dimensionless; surface_energy in J/m2 at
    reference_diameter (m); shear_modulus in Pa; pull_off_force in N (<= 0);
    wall_friction and platen_friction belong to the mould and to the platens.
    slope_exponent (1 or 1.5) chooses the law, so it is static; so is `law`, the normal law, whose
    parameters beyond these are in `further`, by name; so are `conventions`, what stands beside the
    normal law, or a whole law in its place (one of `jdem.materials.contact_laws.BED_LAWS`, most
    easily by `jdem.materials.catalogue.soil_of`), which reads its own parameters alone.
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
    law: NormalLaw = eqx.field(static=True, default=EEPA)
    conventions: Callable[[Parts], AbstractContactLaw] = eqx.field(static=True, default=eepa)
    further: dict[str, Array] = eqx.field(default_factory=dict)

    def __check_init__(self):
        if self.slope_exponent not in (1.0, 1.5):
            raise ValueError(f"slope_exponent is {self.slope_exponent}; give 1 or 1.5")

    def values(self) -> dict[str, Real]:
        """All parameters by name, SI."""
        names = (name for name in self.__dataclass_fields__ if name not in _CHOICES)
        return {**{name: getattr(self, name) for name in names}, **self.further}


def particle_law(
    soil: SoilParameters, mean_diameter: Array, smoothing: Smoothing
) -> AbstractContactLaw:
    """The contact law between spheres of a soil.

    Args:
        soil: its parameters, SI.
        mean_diameter: of the spheres, m, to which surface energy is scaled.
        smoothing: widths over which the law's corners are rounded.

    Returns:
        The law, with normal force, tangential force and rolling resistance.

    Example:
        >>> law = jdem.particle_law(jdem.SoilParameters(), 5e-3, jdem.Smoothing())
    """
    return _law(soil, mean_diameter, 1.0, smoothing)


def wall_law(
    soil: SoilParameters, mean_diameter: Array, smoothing: Smoothing
) -> AbstractContactLaw:
    """Law between a sphere and a wall of the same modulus; adhesion x `wall_adhesion`."""
    return _law(soil, mean_diameter, soil.wall_adhesion, smoothing)


def elasticity(soil: SoilParameters) -> AbstractStiffness:
    """k1 and its slope exponent from shear modulus and Poisson's ratio."""
    modulus = contact_modulus(soil.shear_modulus, soil.poisson_ratio)
    if soil.slope_exponent == 1.0:
        return LinearStiffness(modulus, soil.stiffness_factor)
    return HertzStiffness(modulus, contact_shear_modulus(soil.shear_modulus, soil.poisson_ratio))


def _law(
    soil: SoilParameters, mean_diameter: Array, adhesion: Real, smoothing: Smoothing
) -> AbstractContactLaw:
    stiffness, values = elasticity(soil), soil.values()
    normal = soil.law.of(values, mean_diameter, adhesion, stiffness, smoothing)
    size = mean_diameter / soil.reference_diameter
    return soil.conventions(Parts(values, normal, stiffness, smoothing, adhesion, size))
