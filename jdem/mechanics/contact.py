"""The nouns of one contact: what a law sees, what it remembers, what it returns.

Signs: overlap and approach speed are positive when the bodies interpenetrate and
close in; normal forces are positive in repulsion; tangential forces act on the
first body.  All numbers are SI.  Nothing here knows which bodies are in contact.
"""

import equinox as eqx
import jax
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


class ContactHistory(eqx.Module):
    """What a contact remembers; all zero while the bodies are apart.

    `extra` holds what laws beyond the base model remember (`AbstractContactLaw.memory`); it
    outlasts separation, and the base model's laws neither see nor return it.
    """

    max_overlap: Array  #: m; largest overlap, which carries the plastic memory
    low_overlap: Array  #: m; smallest overlap since, from which adhesive reload starts
    stretch: Vector  #: m; elastic stretch of the tangential spring
    extra: tuple = ()  #: trees of arrays

    @staticmethod
    def zeros(shape, dtype, extra: tuple = ()) -> "ContactHistory":
        stretch = Vector.zeros(shape, dtype)
        return ContactHistory(stretch.x, stretch.x, stretch, extra)

    def kept_while(self, touching) -> "ContactHistory":
        """This history where `touching` is 1, and zeros where it is 0."""
        return jax.tree.map(lambda leaf: leaf * touching, self)


class NormalForce(eqx.Module):
    """A normal force by part, in N, and the load that friction feels."""

    hysteretic: Array  #: elastic, plastic and adhesive part, f_hys
    viscous: Array  #: dashpot
    frictional_load: Array  #: |f_hys + f_min (d/d_min)^x - f0|

    def total(self) -> Array:
        return self.hysteretic + self.viscous


class ContactForce(eqx.Module):
    """The whole force of one contact by part; `tangential` and `tangential_viscous` in N."""

    normal: NormalForce
    tangential: Vector
    tangential_viscous: Vector
    rolling_limit: Array  #: N; the rolling torque's limit divided by the lever arm

    def traction(self) -> Vector:
        """Tangential force on the first body, N."""
        return self.tangential + self.tangential_viscous
