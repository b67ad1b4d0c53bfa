"""Hysteretic spring with linear cohesion, normal direction (Walton and Braun 1986).

    f = K1 d            loading, while K1 d < K2 (d - d0)
        K2 (d - d0)     unloading and reloading, d > d0            - k_c A
        0               d <= d0
    K1 = 5 R* Y         K2 = K1/e^2         A = pi (R d - d^2/4),  R = 2 R*

d0 is the residual overlap: (1 - K1/K2) d while loading, d where d <= d0.  Both rules are one,

    d0 -> min( max(d0, (1 - K1/K2) d) , d ),      and then f = K2 (d - d0)

Walton and Braun 1986, Journal of Rheology 30, 949; K1 and K2 as in EDEM's "Hysteretic Spring"
(Walton 2006), with its "Linear Cohesion": energy density k_c times the contact's area.  Friction
feels the spring's force without the cohesion, as in EEPA.  Separation clears the memory.  From
k_c = 5/(2 pi) Y on cohesion is stiffer than the spring, and spheres sink into each other.
"""

from collections.abc import Mapping

import jax.numpy as jnp
from jax import Array

from jdem.core import smooth
from jdem.core.fusion import once
from jdem.core.parameter import NOT_NEGATIVE, POSITIVE, Accepted, Parameter, Search
from jdem.core.quantity import Real, quantity
from jdem.core.smooth import Smoothing
from jdem.laws.base import AbstractNormalLaw
from jdem.mechanics.contact import Contact, NormalForce
from jdem.mechanics.dashpot import damping_ratio, dashpot_constant
from jdem.mechanics.elasticity import AbstractStiffness


class HystereticSpring(AbstractNormalLaw):
    """yield_strength Y in Pa; restitution is e in (0, 1]; cohesion k_c in J/m3; damping_factor
    (dimensionless) is the share of the dashpot of e that acts besides; onset as in `Smoothing`.
    """

    yield_strength: Real = quantity()
    restitution: Real = quantity()
    cohesion: Real = quantity(0.0)
    damping_factor: Real = quantity(0.0)
    onset: Real = quantity(1e-4)

    @staticmethod
    def of(
        values: Mapping[str, Real],
        diameter: Real,
        adhesion: Real,
        stiffness: AbstractStiffness,
        smoothing: Smoothing,
    ) -> "HystereticSpring":
        """The law of a soil (`jdem.materials.soil`); its elastic moduli are the shear spring's."""
        return HystereticSpring(
            yield_strength=values["yield_strength"],
            restitution=values["restitution"],
            cohesion=adhesion * values["cohesion"],
            damping_factor=values["damping_factor"],
            onset=smoothing.onset,
        )

    def force(self, contact: Contact, history: Array):
        overlap = jnp.maximum(contact.overlap, 0.0)
        touching = jnp.where(contact.overlap > 0, 1.0, 0.0)
        residual = once(self._residual(overlap, history))
        spring = self.unloading_stiffness(contact.radius) * (overlap - residual)
        cohesion = self.cohesion * contact_area(2 * contact.radius, overlap)
        force = NormalForce(
            hysteretic=touching * (spring - cohesion),
            viscous=self._viscous(contact, overlap),
            frictional_load=touching * spring,
        )
        return once((force, residual * touching))

    def memory(self, shape, dtype):
        """Residual overlap d0, m."""
        return jnp.zeros(shape, dtype)

    def loading_stiffness(self, radius: Array):
        """K1, N/m, at effective radius R* (m)."""
        return 5 * radius * self.yield_strength

    def unloading_stiffness(self, radius: Array):
        """K2, N/m."""
        return self.loading_stiffness(radius) / self.restitution**2

    def stiffness_bound(self, radius: Array):
        """K2; cohesion's slope lowers it."""
        return self.unloading_stiffness(radius) + 2 * jnp.pi * self.cohesion * radius

    def damping_ratio(self):
        return self.damping_factor * damping_ratio(jnp.log(self.restitution))

    def _residual(self, overlap, before):
        """d0 after this instant, m."""
        plastic = (1 - self.restitution**2) * overlap
        return jnp.minimum(jnp.maximum(before, plastic), overlap)

    def _viscous(self, contact: Contact, overlap):
        beta = dashpot_constant(
            self.restitution, contact.mass, self.loading_stiffness(contact.radius)
        )
        onset = smooth.step(overlap, self.onset * contact.radius)
        return self.damping_factor * beta * contact.approach_speed * onset


def contact_area(radius, overlap):
    """Area of the circle in which two equal spheres intersect, pi (R d - d^2/4), m2."""
    return jnp.pi * (radius * overlap - 0.25 * overlap * overlap)


PARAMETERS = (
    Parameter(
        name="yield_strength",
        symbol="Y",
        label="yield strength",
        unit="Pa",
        accepted=POSITIVE,
        repair='give a positive value, such as "10 MPa"',
        # As stiff as shear moduli of 1 to 60 MPa and more make EEPA: K1 = 5 Y R* for 2 E* R*.
        search=Search(1e6, 1e8, 1.0),
        names={"EDEM": "Hysteretic Spring soil - soil / Yield Strength"},
    ),
    Parameter(
        name="cohesion",
        symbol="k_c",
        label="cohesion energy density",
        unit="J/m^3",
        accepted=NOT_NEGATIVE,
        repair='give 0 or a positive value, such as "1e5 J/m^3"',
        # A contact 1 % of d deep pulls with k_c pi/200 on d^2: 16 Pa to 8 kPa, and more as it
        # deepens.  From 5/(2 pi) of a low yield strength on, spheres sink into each other.
        search=Search(1e3, 5e5, 1.0),
        names={
            "EDEM": "Linear Cohesion soil - soil / Energy Density",
            "LIGGGHTS": "cohesionEnergyDensity",
        },
    ),
    Parameter(
        name="damping_factor",
        symbol="b_n",
        label="share of the dashpot that acts besides",
        accepted=Accepted(0.0, 1.0),
        repair="give a number from 0 to 1, such as 0",
        names={"EDEM": "Hysteretic Spring soil - soil / Damping Factor"},
    ),
)
