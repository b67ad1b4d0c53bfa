"""Elastic stiffness of two spheres: the slope exponent n and how k1 follows from moduli.

    n = 1     k1 = c E* R*        c = 2 (the Edinburgh-authored LIGGGHTS code, default),
                                  c = 4/3 (LAMMPS documentation), or k1 given in N/m (Thakur 2014)
    n = 1.5   k1 = 4/3 E* sqrt(R*)    (Hertz)

The exponent is a choice of model, so it is static; moduli are numbers.
"""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.parameter import POSITIVE, Accepted, Parameter, Search
from jdem.core.quantity import Real, quantity


class AbstractStiffness(eqx.Module):
    """Virgin loading k1 d^n of one contact."""

    @abc.abstractmethod
    def normal(self, radius: Array) -> Array:
        """k1, N/m^n, at effective radius R* (m)."""

    @abc.abstractmethod
    def tangential(self, radius: Array, overlap: Array) -> Array:
        """Spring stiffness before the multiplier, N/m; overlaps may be negative."""

    @abc.abstractmethod
    def raised(self, overlap: Array) -> Array:
        """d^n for d >= 0."""

    @abc.abstractmethod
    def root(self, raised: Array) -> Array:
        """The overlap (m) whose n-th power is `raised`."""

    @abc.abstractmethod
    def damping_stiffness(self, radius: Array, overlap: Array) -> Array:
        """Stiffness (N/m) that the dashpot is matched to."""

    @abc.abstractmethod
    def bound(self, radius: Array) -> Array:
        """Largest tangent of k1 d^n (N/m) up to the overlap of one per cent of R*."""


class AbstractLinear(AbstractStiffness):
    """n = 1; a subclass says where k1 comes from."""

    def tangential(self, radius, overlap):
        return self.normal(radius)

    def raised(self, overlap):
        return overlap

    def root(self, raised):
        return raised

    def damping_stiffness(self, radius, overlap):
        return self.normal(radius)

    def bound(self, radius):
        return self.normal(radius)


class LinearStiffness(AbstractLinear):
    """n = 1, k1 = factor E* R*; contact modulus E* in Pa."""

    modulus: Real = quantity()
    factor: Real = quantity(2.0)

    def normal(self, radius):
        return self.factor * self.modulus * radius


class EdinburghStiffness(AbstractLinear):
    """n = 1 as `model edinburgh` of LIGGGHTS 3.8 has it: k1 is that of `linear`, and the tangential
    spring grows with the overlap, k1 sqrt(d/R*), which is 2 E* sqrt(R* d) at k1 = 2 E* R*."""

    linear: AbstractStiffness

    def normal(self, radius):
        return self.linear.normal(radius)

    def tangential(self, radius, overlap):
        return self.normal(radius) * square_root(overlap / radius)


DEEP = (
    0.16  # overlap over R* up to which time steps of Hertzian beds are stable: soft soil in a box
)


class HertzStiffness(AbstractStiffness):
    """n = 1.5, k1 = 4/3 E* sqrt(R*); tangential 8 G* sqrt(R* d) (Mindlin)."""

    modulus: Real = quantity()
    shear_modulus: Real = quantity()

    def normal(self, radius):
        return 4 / 3 * self.modulus * jnp.sqrt(radius)

    def tangential(self, radius, overlap):
        return 8 * self.shear_modulus * self._contact_radius(radius, overlap)

    def raised(self, overlap):
        return overlap * square_root(overlap)

    def root(self, raised):
        positive = raised > 0
        return jnp.where(positive, jnp.cbrt(jnp.where(positive, raised, 1.0)) ** 2, 0.0)

    def damping_stiffness(self, radius, overlap):
        return 2 * self.modulus * self._contact_radius(radius, overlap)

    def bound(self, radius):
        return 2 * self.modulus * self._contact_radius(radius, 0.01 * radius)

    def _contact_radius(self, radius, overlap):
        return square_root(radius * overlap)


def square_root(x):
    """sqrt(x), and 0 with slope 0 where x is not positive."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def contact_modulus(shear_modulus, poisson_ratio):
    """E* = E / (2 (1 - nu^2)) of two equal bodies with E = 2 G (1 + nu), Pa."""
    return shear_modulus / (1 - poisson_ratio)


def contact_shear_modulus(shear_modulus, poisson_ratio):
    """G* = G / (2 (2 - nu)) of two equal bodies, Pa."""
    return shear_modulus / (2 * (2 - poisson_ratio))


PARAMETERS = (
    Parameter(
        name="shear_modulus",
        symbol="G",
        label="shear modulus",
        unit="Pa",
        accepted=POSITIVE,
        repair='give a positive value, such as "12 MPa"',
        search=Search(1e6, 60e6, 1.0, calibrated_sd=0.35),
        names={"EDEM": "Bulk material / Shear Modulus", "LIGGGHTS": "youngsModulus", "Yade": "k1"},
    ),
    Parameter(
        name="slope_exponent",
        symbol="n",
        label="exponent of virgin loading",
        accepted=Accepted(choices=(1.0, 1.5)),
        repair="give 1 (linear) or 1.5 (Hertz)",
        names={"EDEM": "EEPA model soil - soil / Slope Exp", "LIGGGHTS": "overlapExponent"},
    ),
    Parameter(
        name="poisson_ratio",
        symbol="nu",
        label="Poisson's ratio",
        accepted=Accepted(0.0, 0.5, most_open=True),
        repair="run the fit again",
        free=False,
        names={"EDEM": "Bulk material / Poisson's Ratio", "LIGGGHTS": "poissonsRatio"},
    ),
    Parameter(
        name="stiffness_factor",
        symbol="c",
        label="k1 over E* R* at slope exponent 1",
        accepted=POSITIVE,
        repair="run the fit again",
        free=False,
    ),
)
