"""Gaussian processes about runs: what a soil's tests show on average over packings, and how surely.

    asinh(feature/scale) = mean + sum_c loading_c y_c             c: components
    y_c(x, s) = f_c(x, s) + packing + soil block + rest

    cov f = 1 + sum_i a_i^2 x_i x_i' + sum_k s_k s_k' (b_k^2 + c_k^2 x.x'/p) + d_k^2 s_k^2 s_k'^2
          + q^2 exp(-|x - x'|^2_l / 2 - |s - s'|^2_m / 2)
          + sum_k e_k^2 s_k s_k' exp(-|x - x'|^2_n / 2)

x are base coordinates over their spread, s strengths over their limits.  In the last term soils
bend what effects do.  The inverse hyperbolic sine makes factors of force and stiffness add up and
scatter alike for weak and strong soils (Johnson 1949, SU).

Rasmussen and Williams 2006, chapter 2.  Libraries of such processes solve for the weights, or the
whole triangular system, anew with each point (tinygp's `GaussianProcess.condition`); here both are
kept, so that a value costs one pass over the runs.  What does not depend on the location is summed
beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


class Kernel(NamedTuple):
    """Logarithms of the hyperparameters; shapes (p,), (p,), (k,), (), (k,) four times, (p,), then
    scalars, then (p,): scattering, the slopes g of the logarithm of deviations with base
    coordinates."""

    linear: Any
    length: Any
    reach: Any
    curved: Any
    effect: Any
    interaction: Any
    bent: Any
    local: Any
    local_length: Any
    packing: Any
    soil_block: Any
    rest: Any
    scattering: Any

    @property
    def scatter(self) -> float:
        """Variance of one specimen about the process, at x = 0."""
        return float(np.exp(2 * self.packing) + np.exp(2 * self.soil_block) + np.exp(2 * self.rest))

    def larger(self, x):
        """Deviations (n,) at scaled points (n, p) over those at 0."""
        return jnp.exp(x @ self.scattering)


def covariance(kernel: Kernel, x, s, x2, s2) -> Array:
    """cov f between points (n, p), (n, k) and (l, p), (l, k); shape (n, l)."""
    mixed, local = (jnp.exp(2 * part) for part in (kernel.interaction, kernel.local))

    def straight(x, s):
        terms = x * jnp.exp(kernel.linear), s * jnp.exp(kernel.effect), s**2 * jnp.exp(kernel.bent)
        return jnp.hstack([jnp.ones((len(x), 1)), *terms])

    def everywhere(x, s):
        return jnp.hstack([x / jnp.exp(kernel.length), s / jnp.exp(kernel.reach)])

    found = straight(x, s) @ straight(x2, s2).T
    found = found + _nearness(everywhere(x, s), everywhere(x2, s2), 2 * kernel.curved)
    found = found + ((s * mixed / x.shape[1]) @ s2.T) * (x @ x2.T)
    near = _nearness(x / jnp.exp(kernel.local_length), x2 / jnp.exp(kernel.local_length))
    return found + ((s * local) @ s2.T) * near


def _nearness(a, b, height=0.0):
    """exp(height - |a - b|^2/2) between points (n, d) and (l, d); shape (n, l)."""

    def lifted(a, *more):
        return jnp.hstack([a, *(part * jnp.ones((len(a), 1)) for part in more)])

    off, off2 = (0.5 * (part**2).sum(1)[:, None] for part in (a, b))
    return jnp.exp(lifted(a, height - off, 1.0) @ lifted(b, 1.0, -off2).T)


@dataclass(frozen=True, eq=False)
class Component:
    """One component's process: kernel, weights (n,), and what it leaves of the rows (n,)."""

    kernel: Kernel
    weights: np.ndarray
    left: np.ndarray


class Means(eqx.Module):
    """Means (c,) of processes about the same points x (n, p), s (n, k), evaluated together."""

    x: Array
    s: Array
    weights: Array  #: (c, n)
    every: Kernel  #: of all components: each of its parts has one axis more, the first
    straight: tuple[Array, ...]  #: sums over the points, of the terms that are polynomials
    height: Array  #: (c, n), of the logarithms of curved terms at the origin
    local_height: Array

    @staticmethod
    def of(components: Sequence[Component], x: np.ndarray, s: np.ndarray) -> "Means":
        every = Kernel(
            *(np.array(part, float) for part in zip(*(c.kernel for c in components), strict=True))
        )
        weights = np.array([c.weights for c in components])
        linear, effect, mixed, bent = (
            np.exp(2 * logarithm)
            for logarithm in (every.linear, every.effect, every.interaction, every.bent)
        )
        shared = np.einsum("cn,np,nk->cpk", weights, x, s, optimize=True) / x.shape[1]
        straight = (
            weights.sum(axis=1), linear * (weights @ x), effect * (weights @ s),
            bent * (weights @ s**2), mixed[:, None, :] * shared,
        )  # fmt: skip
        near = np.exp(-2 * np.hstack([every.length, every.reach]))
        height = 2 * every.curved[:, None] - 0.5 * near @ (np.hstack([x, s]) ** 2).T
        local_height = -0.5 * np.exp(-2 * every.local_length) @ (x**2).T
        parts = (x, s, weights, every, straight, height, local_height)
        return Means(*jax.device_put(parts))

    @property
    def parts(self) -> tuple:
        """What differs between components."""
        return self.weights, self.every, self.straight, self.height, self.local_height

    def __call__(self, x: Array, s: Array) -> Array:
        """At a point (p,), (k,)."""
        return self.along(x, s, jnp.zeros_like(x))[0]

    def along(self, x: Array, s: Array, direction: Array) -> tuple[Array, Array]:
        """Means (c,) at a point, and their slopes (c,) there along a direction (p,) of the first
        coordinates; JAX takes no slopes of these slopes."""
        return _means(self, x, s, direction)

    def holding(self, x: Array) -> "HeldMeans":
        """The same without effects and where the last coordinates (h,) keep these values, at an
        eighth of the cost: runs that differ in these and in effects alone are summed beforehand."""
        q = self.x.shape[1] - len(x)
        level, linear, *_ = self.straight
        near = jnp.exp(-2 * self.every.length)
        pulled = near[:, q:] * x
        every = np.asarray(self.height + pulled @ self.x[:, q:].T - 0.5 * (pulled @ x)[:, None])
        points, of = np.unique(np.asarray(self.x[:, :q]), axis=0, return_inverse=True)
        height = np.full((len(every), len(points)), -np.inf)
        weights = np.zeros_like(height)
        for c, own in enumerate(every):
            np.maximum.at(height[c], of, own)
            np.add.at(weights[c], of, np.asarray(self.weights[c]) * np.exp(own - height[c][of]))
        parts = points, weights, near[:, :q], height, level + linear[:, q:] @ x, linear[:, :q]
        return HeldMeans(*map(jnp.asarray, parts))

    def covariances(self, x: Array, s: Array) -> tuple[Array, Array]:
        """Of processes at a point (p,), (k,) with those at their own points (c, n), and variances
        (c,) there before any run is known."""
        at = x[None], s[None]

        def one(kernel: Kernel) -> tuple[Array, Array]:
            return covariance(kernel, *at, self.x, self.s)[0], covariance(kernel, *at, *at)[0, 0]

        return jax.vmap(one)(self.every)

    def covariances_of_slopes(self, x: Array, s: Array) -> tuple[Array, Array]:
        """Of the slopes of processes with x, at a point (p,), (k,): with the processes at their own
        points (c, n, p), and with each other (c, p, p) before any run is known."""

        def one(kernel: Kernel) -> tuple[Array, Array]:
            def with_runs(x):
                return covariance(kernel, x[None], s[None], self.x, self.s)[0]

            def with_itself(x, x2):
                return covariance(kernel, x[None], s[None], x2[None], s[None])[0, 0]

            return jax.jacfwd(with_runs)(x), jax.jacfwd(jax.grad(with_itself), 1)(x, x)

        return jax.vmap(one)(self.every)


class HeldMeans(eqx.Module):
    """Means (c,) of processes without effects, of which only the first coordinates vary, about
    points (n, q) of these."""

    points: Array
    weights: Array  #: (c, n)
    near: Array  #: (c, q), one over the squares of lengths
    height: Array  #: (c, n), of the logarithms of curved terms at the origin
    level: Array  #: (c,)
    linear: Array  #: (c, q)

    def __call__(self, x: Array, s: Array) -> Array:
        """At a point (q,); strengths are not asked for: they are 0."""

        def one(weights, near, height, level, linear):
            return level + linear @ x + _weighed(x, self.points, near, height) @ weights

        return jax.vmap(one)(self.weights, self.near, self.height, self.level, self.linear)


def _mean(of: tuple, x, s, points, strengths):
    """The mean of one component."""
    weights, kernel, (level, linear, along, bent, mixed), height, local_height = of
    near = jnp.exp(-2 * jnp.hstack([kernel.length, kernel.reach]))
    curved = _weighed(jnp.hstack([x, s]), jnp.hstack([points, strengths]), near, height)
    local = _weighed(x, points, jnp.exp(-2 * kernel.local_length), local_height)
    bending = strengths @ (jnp.exp(2 * kernel.local) * s)
    polynomial = level + linear @ x + along @ s + bent @ s**2 + x @ mixed @ s
    return polynomial + (curved + local * bending) @ weights


def _weighed(at, points, near, height):
    """exp(-|at - point|^2/2) (n,) for points (n, d) and one (d,)."""
    pulled = near * at
    return jnp.exp(height - 0.5 * pulled @ at + points @ pulled)


@eqx.filter_custom_jvp
def _means(means: Means, x, s, direction):
    values, (by_x, _) = _means_and_slopes(means, x, s)
    return values, by_x @ direction


@_means.def_jvp
def _slopes_of_means(primals, tangents):
    """Forward, but for one sweep back through each component: it has one value and many inputs."""
    means, x, s, direction = primals
    values, slopes = _means_and_slopes(means, x, s)
    moved = [g @ t for g, t in zip(slopes, tangents[1:3], strict=True) if t is not None]
    none = jnp.zeros_like(values)
    return (values, slopes[0] @ direction), (sum(moved, none), none)


def _means_and_slopes(means: Means, x, s):
    one = jax.vmap(jax.value_and_grad(_mean, (1, 2)), (0, None, None, None, None))
    return one(means.parts, x, s, means.x, means.s)


class SoilResponse(eqx.Module):
    """Features (m,) of a soil as a machine without errors reads them, the mean over packings.

    mean (m,) of warped features and what components of one deviation change in them, carried
    (m, c); scale (m,) by which warped features are read in their own units, for the mean of
    specimens and not the median; always (a,): strengths of the last columns of the runs' points,
    which nobody asks for.
    """

    means: Means | HeldMeans
    mean: Array
    carried: Array
    scale: Array
    always: Array

    def components(self, x: Array, s: Array) -> Array:
        """Standardised components (c,) at a scaled point (p,), (k,)."""
        return self.means(x, jnp.append(s, self.always))

    def warped(self, x: Array, s: Array) -> Array:
        """Warped features (m,)."""
        return self.mean + self.carried @ self.components(x, s)

    def of_warped(self, warped: Array) -> Array:
        """Features (m,) of warped ones."""
        return self.scale * jnp.sinh(warped)

    def steepness(self, x: Array, s: Array) -> Array:
        """d feature / d warped feature (m,) at a point."""
        return jax.grad(lambda warped: self.of_warped(warped).sum())(self.warped(x, s))

    def along(self, x: Array, s: Array, direction: Array) -> tuple[Array, Array]:
        """Features (m,) and their slopes (m,) along a direction (p,) of the scaled point; JAX takes
        no slopes of these slopes."""
        assert isinstance(self.means, Means)
        components, rising = self.means.along(x, jnp.append(s, self.always), direction)
        warped = self.mean + self.carried @ components
        still = jax.lax.stop_gradient(warped)
        return self.of_warped(warped), jax.jvp(self.of_warped, (still,), (self.carried @ rising,))[
            1
        ]

    def __call__(self, x: Array, s: Array) -> Array:
        return self.of_warped(self.warped(x, s))

    def holding(self, x: Array) -> "SoilResponse":
        """The same as a function of the first coordinates alone: the last ones keep the scaled
        values (h,), and no effect is at work."""
        assert isinstance(self.means, Means) and not len(self.always)
        return replace(self, means=self.means.holding(x))
