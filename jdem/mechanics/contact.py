"""The nouns of one contact: what a law sees and what it returns.

Signs: overlap and approach speed are positive when the bodies interpenetrate and
close in; normal forces are positive in repulsion; tangential forces and moments act on
the first body.  All numbers are SI.  Nothing here knows which bodies are in contact, nor
what a law remembers: that is its own (`jdem.laws.base`).
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.vector import Vector


class Contact(eqx.Module):
    """One contact at one instant."""

    overlap: Array  #: m; negative while the bodies are apart
    approach_speed: Array  #: m/s; rate of the overlap
    normal: Vector  #: unit vector from the second body to the first
    slip: Vector  #: m/s; velocity of the first body's surface relative to the second's, tangential
    radius: Array  #: m; effective radius R* = 1/(1/R1 + 1/R2)
    mass: Array  #: kg; effective mass m* = 1/(1/m1 + 1/m2)
    friction: Array  #: -; sliding friction coefficient of the two surfaces
    time_step: Array  #: s
    spin: Vector  #: rad/s; angular velocity of the first body relative to the second's
    smaller: Array | None = None  #: m; radius of the smaller body; None: both are 2 R*
    turning: Array | None = None  #: rad/s; mean spin of both bodies about the normal; None: 0


def smaller_radius(contact: Contact) -> Array:
    """Radius of the smaller body, m; that of equal spheres where the contact does not say it."""
    return 2 * contact.radius if contact.smaller is None else contact.smaller


def lens_area(contact: Contact) -> Array:
    """Area (m2) of the circle in which the bodies intersect, 0 while they are apart.

    a^2 = d (2r - d) (2 - d k) (2 + 2 r k - d k) / (2 + 2 r k - 2 d k)^2 with the smaller radius r
    and the larger body's curvature k: r d - d^2/4 of equal spheres, 2 r d - d^2 on a plane.
    """
    overlap, radius = jnp.maximum(contact.overlap, 0.0), smaller_radius(contact)
    curvature = 1 / contact.radius - 1 / radius
    both, depth = 2 + 2 * radius * curvature, overlap * curvature
    squares = (2 - depth) * (both - depth) / ((both - 2 * depth) * (both - 2 * depth))
    return jnp.pi * overlap * (2 * radius - overlap) * squares


class NormalForce(eqx.Module):
    """A normal force by part, in N, and the load that friction feels."""

    hysteretic: Array  #: elastic, plastic and adhesive part, f_hys
    viscous: Array  #: dashpot
    frictional_load: Array  #: |f_hys + f_min (d/d_min)^x - f0|

    def total(self) -> Array:
        return self.hysteretic + self.viscous


class ContactForce(eqx.Module):
    """The whole force of one contact by part; `tangential` and `tangential_viscous` in N.

    `moment` (N m) acts on the first body, its opposite on the second; None, and no work for
    the engine, where a law gives none.
    """

    normal: NormalForce
    tangential: Vector
    tangential_viscous: Vector
    rolling_limit: Array  #: N; the rolling torque's limit divided by the lever arm
    moment: Vector | None = None

    def traction(self) -> Vector:
        """Tangential force on the first body, N."""
        return self.tangential + self.tangential_viscous
