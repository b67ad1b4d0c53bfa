"""Pure functions of a curve: depression depth, crushing force, stiffness.

A curve has a fixed number of rows of which some are masked, so that the functions can
be compiled once, vectorised and differentiated.
"""

import abc
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.core import smooth
from jdem.core.quantity import Real, cast, quantity
from jdem.core.tangents import with_derivative_of


class Curve(eqx.Module):
    """Platen displacement (m, downward) and force (N); rows count where `valid` is 1.

    A derivative is taken over `window` (-), a width in ln(force) to either side of a force.
    """

    displacement: Array
    force: Array
    valid: Array
    window: float = eqx.field(static=True, default=0.0)

    def filled(self) -> "Curve":
        """Masked rows replaced by the nearest valid row before them (or the first after)."""
        rows = jnp.arange(self.force.shape[0])
        last = jax.lax.cummax(jnp.where(self.valid > 0, rows, -1))
        source = jnp.where(last < 0, jnp.argmax(self.valid), last)
        ones = jnp.ones_like(self.valid)
        return Curve(self.displacement[source], self.force[source], ones, self.window)


def displacement_on_rise(displacement, force, wanted, window: float = 0.0):
    """Displacement at which the rising force reaches `wanted`: the one reading of its kind.

    Linear interpolation of the running maximum of the force; beyond it the last row's displacement,
    below it the first row's.  Arrays (n,) of numpy or JAX in any units, `wanted` a number or an
    array (m,) in that of the force.  JAX differentiates it, over a `window` as in `Curve` where
    there is one: between two neighbouring rows the slope of a curve is mostly roughness.
    """
    numbers = force.__array_namespace__()
    travel = numbers.interp(wanted, running_maximum(force), displacement)
    if window == 0:
        return travel
    stretched = jnp.vectorize(lambda one: _stretched(displacement, force, one, window))(wanted)
    return with_derivative_of(travel, jax.lax.stop_gradient(travel) * stretched)


def running_maximum(force):
    """The largest force so far, at each row of an array (n,) of numpy or JAX.

    JAX is told at which rows a new maximum stands, and differentiates the choice of rows: the
    derivative of its own running maximum is eight times as long a program.
    """
    if isinstance(force, np.ndarray):
        return np.maximum.accumulate(force)
    still = jax.lax.stop_gradient(force)
    new = still >= jax.lax.cummax(still)
    return force[jax.lax.cummax(jnp.where(new, jnp.arange(len(force)), 0))]


def displacement_at(loading: Curve, force) -> Array:
    """Displacement (m) at which the loading curve first reaches `force` (N)."""
    curve = loading.filled()
    return displacement_on_rise(curve.displacement, curve.force, force, curve.window)


def _stretched(displacement, force, wanted, window: float) -> Array:
    """1, with the derivative of ln(displacement) at a force: over the window, of a power law.

    F ~ u^n there, so d ln u = mean(d ln u_k - d ln F_k / n) + d ln F / n over its rows k.
    """
    rows = jnp.arange(force.shape[0])
    known = (force > 0) & (displacement > 0) & (rows <= jnp.argmax(force))
    travels, forces = (jnp.where(known, part, 1.0) for part in (displacement, force))
    x, y = jnp.log(travels), jnp.log(forces)
    away = jnp.where(known, jnp.abs(y - jnp.log(wanted)), jnp.inf)
    chosen = away <= jnp.maximum(window, jnp.min(away))
    weight = jax.lax.stop_gradient(chosen / jnp.sum(chosen))
    dx, dy = (part - jnp.sum(weight * part) for part in (x, y))
    exponent = smooth.divide(jnp.sum(weight * dx * dy), jnp.sum(weight * dx * dx))
    exponent = jax.lax.stop_gradient(jnp.where(exponent > 0, exponent, 1.0))
    changes = jnp.sum(weight * (x - y / exponent)) + jnp.log(wanted) / exponent
    return 1 + changes - jax.lax.stop_gradient(changes)


def depression_depth(loading: Curve, force_low, force_high) -> Array:
    """H (m): displacement between force_low and force_high (N) on loading."""
    return displacement_at(loading, force_high) - displacement_at(loading, force_low)


def crushing_force(crushing: Curve, width) -> Array:
    """F (N): smoothed maximum of the crushing curve.

    sum F_i w_i / sum w_i with w_i = exp(F_i / width); `width` (N) -> 0 gives the maximum.
    """
    force = jnp.where(crushing.valid > 0, crushing.force, -jnp.inf)
    weight = jnp.exp((force - jax.lax.stop_gradient(jnp.max(force))) / width)
    return jnp.sum(weight * crushing.force * crushing.valid) / jnp.sum(weight)


def running_mean(curve: Curve, rows: int) -> Curve:
    """The curve with its force averaged over an odd number of neighbouring rows."""
    kernel = jnp.ones(rows, curve.force.dtype)
    total = jnp.convolve(curve.force * curve.valid, kernel, mode="same")
    count = jnp.convolve(curve.valid, kernel, mode="same")
    return replace(curve, force=total / jnp.maximum(count, 1.0))


def inertial_number(rate, height, diameter, density, pressure) -> Array:
    """I = (rate/height) d sqrt(density/pressure), dimensionless (MiDi 2004)."""
    return rate / height * diameter * jnp.sqrt(density / pressure)


class AbstractGauge(eqx.Module):
    """One observable of a whole curve; `name` is what it is called in results."""

    name: eqx.AbstractVar[str]

    @abc.abstractmethod
    def of(self, curve: Curve, movement: Array) -> Array:
        """The number, SI; `movement` (samples,) is the number of the movement under way."""

    def sampled(self, ratio: float) -> "AbstractGauge":
        """The same gauge where samples are `ratio` times as dense."""
        return self


class DepressionDepth(AbstractGauge):
    """Displacement (m) between two forces (N), each where it is first reached."""

    force_low: Real = quantity(200.0)
    force_high: Real = quantity(400.0)
    name: str = eqx.field(static=True, default="depression_depth")

    def of(self, curve: Curve, movement: Array) -> Array:
        return depression_depth(curve, *cast((self.force_low, self.force_high), curve.force.dtype))


class CrushingForce(AbstractGauge):
    """Largest force (N), averaged over `rows` samples (odd) and smoothed over `width` (N)."""

    rows: int = eqx.field(static=True, default=5)
    width: float = eqx.field(static=True, default=2.0)
    name: str = eqx.field(static=True, default="crushing_force")

    def of(self, curve: Curve, movement: Array) -> Array:
        return crushing_force(running_mean(curve, self.rows), self.width)

    def sampled(self, ratio: float) -> "CrushingForce":
        return replace(self, rows=2 * int(self.rows * ratio / 2) + 1)


class LargestDisplacement(AbstractGauge):
    """The farthest that the platen went, m."""

    name: str = eqx.field(static=True, default="settlement")

    def of(self, curve: Curve, movement: Array) -> Array:
        return jnp.max(jnp.where(curve.valid > 0, curve.displacement, -jnp.inf))


class ForceLeft(AbstractGauge):
    """Force (N) at the end of movement `held`."""

    held: int = eqx.field(static=True)
    name: str = eqx.field(static=True, default="force_left")

    def of(self, curve: Curve, movement: Array) -> Array:
        rows = jnp.arange(curve.force.shape[0])
        return curve.force[jnp.max(jnp.where(movement == self.held, rows, 0))]
