"""A surface of revolution: a line in the half-plane of radius and height, turned about an axis.

    rho = |u|,  zeta = about . (r - reference)       u: the part of r - reference across `about`
    distance = least distance of (rho, zeta) from the line's legs

Cones, plates, shafts, rings and tubes are such surfaces.  They are shells: spheres touch them from
any side, at the one point that is nearest.  A re-entrant corner, where a sphere may touch two legs,
takes two boundaries.  The curvature is left out of R*, as in codes that build tools of flat facets.
"""

from collections.abc import Sequence
from typing import Self

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.boundaries.base import (
    FAR,
    AbstractBoundary,
    Axis,
    Rates,
    Surface,
    across,
    along,
    times,
    turned,
)
from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.vector import Vector

Point = tuple[Real, Real]  # radius and height, m


class Revolved(AbstractBoundary):
    """A tool or a ring.  line (points, 2) is radius (at least 0) and height, m, along `about` from
    the reference point; it moves along `axis`, by default the same."""

    reference: Vector
    rates: Rates
    axis: Axis = eqx.field(static=True)
    line: Array
    made_at: Vector
    about: Axis = eqx.field(static=True)

    @staticmethod
    def at(reference: Vector, axis: Axis, size: Real) -> "Revolved":
        """A flat disc of radius `size` (m)."""
        return Revolved.of([(0.0, 0.0), (size, 0.0)], reference, axis)

    @staticmethod
    def of(
        line: Sequence[Point], reference: Vector, axis: Axis, about: Axis | None = None
    ) -> "Revolved":
        """At rest; the points of `line` (m) in order.

        Raises:
            ValueError: fewer than two points, or a radius below 0.
        """
        if len(line) < 2:
            raise ValueError(f"a line of {len(line)} points; give two or more (radius, height)")
        if any(isinstance(radius, float | int) and radius < 0 for radius, _ in line):
            raise ValueError("a line goes beyond its axis; give radii of 0 or more")
        dtype = reference.x.dtype
        points = jnp.asarray([[jnp.asarray(part, dtype) for part in each] for each in line])
        return Revolved(reference, Rates.zero(dtype), axis, points, reference, about or axis)

    def surface(self, position: Vector) -> Surface:
        offset = position - self.reference
        radial = across(self.about, offset)
        radius, height = smooth.norm(radial), along(self.about, offset)
        off_radius, off_height, distance = self._nearest(radius, height)
        outward = radial * smooth.divide(1.0, radius)
        inverse = smooth.divide(1.0, distance)
        normal = outward * (off_radius * inverse) + times(self.about, off_height * inverse)
        arm = offset - normal * distance
        sliding = turned(self.axis, arm) * self.rates.spin
        return Surface(distance, normal, times(self.axis, self.rates.speed) + sliding)

    def distance(self, position: Vector) -> Array:
        offset = position - self.reference
        radius = smooth.norm(across(self.about, offset))
        return self._nearest(radius, along(self.about, offset))[2]

    def moved(self, time_step: Real) -> "Revolved":
        return self._at(self.reference + times(self.axis, self.rates.speed * time_step))

    def removed(self) -> "Revolved":
        away = times(self.axis, jnp.full_like(self.rates.speed, -FAR))
        return self._at(across(self.axis, self.reference) + away)

    def touching(self, position: Vector, radius: Array) -> "Revolved":
        """Along its axis, up to the first sphere that it meets; where it is if it meets none, or if
        it does not move along its own axis."""
        if self.axis != self.about:
            return self
        offset = position - self.reference
        off_axis = smooth.norm(across(self.axis, offset))
        ahead = along(self.axis, offset) - self._height_met(off_axis, radius)
        first = jnp.min(ahead)
        way = jnp.where(jnp.isfinite(first), first, 0.0)
        return self._at(self.reference + times(self.axis, way))

    def outline(self) -> list[Array]:
        """Of a surface about z: both sides of the line."""
        if abs(self.about[2]) != 1.0:
            return []
        height = self.reference.z + self.about[2] * self.line[:, 1]
        sides = [self.reference.x + sign * self.line[:, 0] for sign in (1, -1)]
        return [jnp.stack([side, height], axis=1) for side in sides]

    def travelled(self, since: Self) -> Array:
        return jnp.abs(along(self.axis, self.reference - since.reference))

    @property
    def size(self) -> Array:
        """Its largest radius."""
        return jnp.max(self.line[:, 0])

    def home(self) -> Vector:
        return self.made_at

    def driven(self, rates: Rates) -> "Revolved":
        rates = Rates(rates.speed, rates.spin, jnp.zeros_like(rates.growth))
        return eqx.tree_at(lambda b: b.rates, self, rates)

    def _legs(self) -> list[tuple[Array, Array]]:
        """Both ends of each leg of the line."""
        return [(self.line[k], self.line[k + 1]) for k in range(self.line.shape[0] - 1)]

    def _nearest(self, radius: Array, height: Array) -> tuple[Array, Array, Array]:
        """Away from the nearest point of the line: in radius, in height, and the distance."""
        chosen, *others = [_off(leg, radius, height) for leg in self._legs()]
        for other in others:
            nearer = other[2] < chosen[2]
            chosen = [jnp.where(nearer, a, b) for a, b in zip(other, chosen, strict=True)]
        off_radius, off_height, square = chosen
        positive = jnp.where(square > 0, square, 1.0)
        return off_radius, off_height, jnp.where(square > 0, jnp.sqrt(positive), 0.0)

    def _height_met(self, off_axis: Array, radius: Array) -> Array:
        """The greatest height of spheres' centres (N,) at which they touch the line; -inf: none."""
        highest = jnp.full_like(off_axis, -jnp.inf)
        for point in self.line:
            square = radius**2 - (off_axis - point[0]) ** 2
            rise = jnp.sqrt(jnp.where(square > 0, square, 1.0))
            highest = jnp.maximum(highest, jnp.where(square > 0, point[1] + rise, -jnp.inf))
        for start, end in self._legs():
            leg = (end - start) * jnp.where(end[0] < start[0], -1.0, 1.0)
            length = jnp.sqrt(leg @ leg)
            share = smooth.divide(off_axis + radius * leg[1] / length - start[0], end[0] - start[0])
            on_leg = (share >= 0) & (share <= 1) & (leg[0] > 0)
            met = start[1] + share * (end[1] - start[1]) + radius * leg[0] / length
            highest = jnp.maximum(highest, jnp.where(on_leg, met, -jnp.inf))
        return highest

    def _at(self, reference: Vector) -> "Revolved":
        return eqx.tree_at(lambda b: b.reference, self, reference)


def _off(leg: tuple[Array, Array], radius: Array, height: Array) -> list[Array]:
    """Away from the nearest point of a leg, in radius and in height, and the distance squared."""
    start, way = leg[0], leg[1] - leg[0]
    passed = (radius - start[0]) * way[0] + (height - start[1]) * way[1]
    share = jnp.clip(passed / (way[0] * way[0] + way[1] * way[1]), 0.0, 1.0)
    off = (radius - start[0] - share * way[0], height - start[1] - share * way[1])
    return [*off, off[0] * off[0] + off[1] * off[1]]
