"""The contract of boundaries: what stands around a bed, how it moves, and what it feels.

    surface(r) -> distance, normal, velocity of the nearest surface, as seen from the point r

A boundary has a reference point and a fixed axis.  It moves along the axis with `speed`, turns
about it with `spin`, and may grow with `growth` (a cylinder's radius); each of the three is
driven by the machine or by a servo on the force or torque that resists it:

    against speed   -F . axis       F: force on the boundary, N
    against spin    -T . axis       T: torque on it about its reference point, N m
    for growth       push           sum of normal forces, N, which growth gives way to

The bed holds a static tuple of boundaries.  All of them share one list of contacts and one
kernel: for each contact every kind is asked, and the contact's own is chosen.

A sphere touches a boundary once, or once each of its `parts`.  A kind that is made of faces also
lists the faces near each sphere (`listing`); in every step it says which of them, of their edges
or of their vertices is touched (`met`), and then what is seen there (`touched`).
"""

import abc
from typing import Self

import equinox as eqx
import jax.numpy as jnp
from jax import Array

from jdem.core.quantity import Real
from jdem.core.vector import Vector

FAR = 10.0  # m; where a boundary is put that has been taken away
Axis = tuple[float, float, float]  # a unit vector, static: its zeros cost nothing
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


class Surface(eqx.Module):
    """The nearest surface of a boundary as seen from one point."""

    distance: Array  #: m; from the point to the surface
    normal: Vector  #: unit vector from the surface to the point
    velocity: Vector  #: m/s; of the surface
    curvature: Array | None = None  #: 1/m; 1/R of a convex surface that spheres touch, None: flat


class Room(eqx.Module):
    """What a boundary may list: spheres within `gap` (m), whose centres are within `farthest` (m),
    in at most `rows` rows of at most `faces` faces."""

    gap: float = eqx.field(static=True)
    farthest: float = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    faces: int = eqx.field(static=True)


class Listing(eqx.Module):
    """Spheres and parts (K,), whether they are near each other, and the faces of each row.

    faces (K, most) are None of boundaries that have none; there `asked` counts the rows and the
    faces that all of them would take.
    """

    sphere: Array
    part: Array
    near: Array
    faces: Array | None = None
    asked: tuple[Array, Array] | None = None


class Rates(eqx.Module):
    """How a boundary moves: along its axis (m/s), about it (rad/s), and its growth (m/s)."""

    speed: Array
    spin: Array
    growth: Array

    @staticmethod
    def zero(dtype) -> "Rates":
        none = jnp.zeros((), dtype)
        return Rates(none, none, none)


class AbstractBoundary(eqx.Module):
    """One rigid boundary; scalars of shape (), and `position` a Vector of any shape."""

    reference: eqx.AbstractVar[Vector]
    rates: eqx.AbstractVar[Rates]
    axis: eqx.AbstractVar[Axis]

    @staticmethod
    @abc.abstractmethod
    def at(reference: Vector, axis: Axis, size: Real) -> "AbstractBoundary":
        """A boundary at rest, of a size (m) if its kind has one."""

    @abc.abstractmethod
    def surface(self, position: Vector) -> Surface:
        """The nearest surface as seen from `position` (m)."""

    @abc.abstractmethod
    def distance(self, position: Vector) -> Array:
        """The distance (m) alone, for the neighbour search."""

    @abc.abstractmethod
    def moved(self, time_step: Real) -> "AbstractBoundary":
        """One time step (s) later, at the same rates."""

    @abc.abstractmethod
    def removed(self) -> "AbstractBoundary":
        """Taken away: FAR from any soil."""

    @abc.abstractmethod
    def touching(self, position: Vector, radius: Array) -> "AbstractBoundary":
        """Moved, or grown, until it touches the nearest of these spheres (m)."""

    @abc.abstractmethod
    def travelled(self, since: Self) -> Array:
        """The farthest (m) that any point of the surface came nearer to the soil since then."""

    @property
    @abc.abstractmethod
    def size(self) -> Array:
        """What growth changes, m: a radius; without limit where there is none."""

    def driven(self, rates: Rates) -> "AbstractBoundary":
        """The same at other rates."""
        return eqx.tree_at(lambda b: b.rates, self, rates)

    def home(self) -> Vector | None:
        """Where its reference point was as it was made (m); None: a kind that is not brought back
        there."""
        return None

    def outline(self) -> list[Array]:
        """Lines (points, 2) in x and z, m, in which it cuts the plane y = 0, for pictures: none,
        unless said so."""
        return []

    def near(self, position: Vector, radius: Array, gap: float) -> Array:
        """Whether spheres come within `gap` (m) of it, shape (N,)."""
        return self.distance(position) - radius < gap

    @property
    def parts(self) -> int:
        """How many contacts a sphere may have with it at once, at most."""
        return 1

    @property
    def faces(self) -> int:
        """How many faces it is made of: none, unless said so."""
        return 0

    def listing(self, position: Vector, radius: Array, room: Room) -> Listing:
        """Spheres that are near its parts, as far as there is room."""
        count = radius.shape[0]
        near = self.near(position, radius, room.gap)
        return Listing(jnp.arange(count), jnp.zeros(count, jnp.int32), near)

    def met(self, position: Vector, faces: Array, most: Array) -> Array:
        """Codes (K,) of what is touched from each point, of the first `most` of `faces` (K, n)."""
        return jnp.zeros(faces.shape[0], jnp.int32)

    def touched(self, position: Vector, code: Array) -> Surface:
        """The surface of what has this code, as seen from `position` (m)."""
        return self.surface(position)


def along(axis: Axis, vector: Vector) -> Array:
    """The component along a static axis."""
    return _sum_of(axis, (vector.x, vector.y, vector.z))


def across(axis: Axis, vector: Vector) -> Vector:
    """The part perpendicular to a static axis."""
    if 1.0 in map(abs, axis):
        parts = zip(axis, (vector.x, vector.y, vector.z), strict=True)
        return Vector(*[jnp.zeros_like(c) if a else c for a, c in parts])
    return vector - times(axis, along(axis, vector))


def times(axis: Axis, length: Array) -> Vector:
    """A vector of this length along a static axis."""
    return Vector(*[_sum_of((a,), (length,)) for a in axis])


def turned(axis: Axis, vector: Vector) -> Vector:
    """axis x vector for a static axis."""
    (a, b, c), v = axis, vector
    return Vector(
        _sum_of((b, -c), (v.z, v.y)), _sum_of((c, -a), (v.x, v.z)), _sum_of((a, -b), (v.y, v.x))
    )


def _sum_of(factors: tuple[float, ...], terms: tuple[Array, ...]) -> Array:
    """sum of factor x term, without the terms whose factor is 0."""
    parts = [
        term if factor == 1 else -term if factor == -1 else factor * term
        for factor, term in zip(factors, terms, strict=True)
        if factor
    ]
    return sum(parts[1:], start=parts[0]) if parts else jnp.zeros_like(terms[0])


def point(x: Real, y: Real, z: Real, dtype) -> Vector:
    """A reference point (m)."""
    return Vector(*[jnp.asarray(part, dtype) for part in (x, y, z)])
