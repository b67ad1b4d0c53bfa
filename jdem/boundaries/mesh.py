"""A rigid surface made of triangles, the soil outside of a solid, or on both sides of a shell.

    distance = n . (r - a)     above a face            n: its normal, a: one of its corners
    distance = |r - p|         p: the closest point of an edge or a vertex
    velocity = speed axis + spin axis x (p - reference)

A sphere touches each patch of smoothly joined faces once, at its closest point
(`jdem.core.triangles` says which contacts count where patches meet); so what a contact remembers
survives all edges within a patch, and concave corners between patches act twice.  A patch that
bends around a sphere, as the inside of a narrow tube does, still touches it once.

When lists are rebuilt, the faces that can become the closest are gathered for each sphere and
patch.  Which of them, of their edges or of their vertices is touched is decided in every step, and
no derivative passes through that choice.
"""

from pathlib import Path
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.boundaries.base import (
    FAR,
    UP,
    AbstractBoundary,
    Axis,
    Listing,
    Rates,
    Room,
    Surface,
    across,
    along,
    times,
    turned,
)
from jdem.core import smooth
from jdem.core.quantity import Real
from jdem.core.triangles import (
    ALWAYS,
    IF_IN_CONE,
    SMOOTH_BELOW,
    TriangleSurface,
    read_stl,
    squared_distance,
)
from jdem.core.vector import Vector
from jdem.core.voxels import lists_met, near_faces, voxels_of

FACE, EDGE, VERTEX, NOTHING = 0, 1, 2, 3  # kinds; a code is 4 x row + kind
UNTOUCHED = -1  # a code of nothing


class Mesh(AbstractBoundary):
    """A tool or a container; `angle` (rad) is how far it has turned about its axis.

    `form` holds the triangles about the reference point, before any turn.  It is static: a program
    is compiled for it.
    """

    reference: Vector
    rates: Rates
    axis: Axis = eqx.field(static=True)
    angle: Array
    made_at: Vector
    form: TriangleSurface = eqx.field(static=True)

    @staticmethod
    def at(reference: Vector, axis: Axis, size: Real) -> "Mesh":
        """A cube of an edge of `size` (m) about the reference point, along x, y and z."""
        return Mesh._of(reference, axis, TriangleSurface.of(_CUBE * float(size), name="the cube"))

    @staticmethod
    def from_triangles(
        corners: np.ndarray,
        reference: tuple[float, float, float] = (0.0, 0.0, 0.0),
        axis: Axis = UP,
        *,
        two_sided: bool = False,
        smooth_below: float = SMOOTH_BELOW,
        name: str = "the mesh",
        dtype=float,
    ) -> "Mesh":
        """At rest, from corners (faces, 3, 3) in m, counter-clockwise as seen from outside.

        It moves along `axis`, a unit vector, and turns about it through `reference` (m).  An open
        surface has to be declared `two_sided`: a shell.  Faces joined by kinks below
        `smooth_below` (degrees) form one patch.  `ValueError` names what is wrong with a mesh.
        """
        if abs(np.linalg.norm(axis) - 1) > 1e-9:
            raise ValueError(f"axis {axis} has to be of length 1")
        about = np.asarray(corners, float).reshape(-1, 3, 3) - np.asarray(reference, float)
        form = TriangleSurface.of(about, two_sided=two_sided, smooth_below=smooth_below, name=name)
        place = Vector(*(jnp.asarray(part, dtype) for part in reference))
        return Mesh._of(place, axis, form)

    @staticmethod
    def from_stl(path: str | Path, unit: float = 1.0, **given) -> "Mesh":
        """From an STL file whose lengths are in `unit` (m, 1e-3 if it is in mm); all else as in
        `from_triangles`."""
        return Mesh.from_triangles(read_stl(path, unit), **{"name": str(path), **given})

    @staticmethod
    def _of(reference: Vector, axis: Axis, form: TriangleSurface) -> "Mesh":
        dtype = reference.x.dtype
        return Mesh(reference, Rates.zero(dtype), axis, jnp.zeros((), dtype), reference, form)

    @property
    def parts(self) -> int:
        return self.form.patches

    @property
    def faces(self) -> int:
        return self.form.faces

    def surface(self, position: Vector) -> Surface:
        """Of all faces; inside of a solid the distance is negative.  For few points."""
        local = self._local(jax.lax.stop_gradient(position))
        kind, row = self._feature(local, self._closest_of_all(local))
        seen = self.touched(position, 4 * row + kind)
        if self.form.two_sided:
            return seen
        sign = jnp.where(self._outside(local, kind, row), 1.0, -1.0)
        sign = jnp.where(kind == FACE, 1.0, sign)
        return eqx.tree_at(
            lambda s: (s.distance, s.normal), seen, (seen.distance * sign, seen.normal * sign)
        )

    def distance(self, position: Vector) -> Array:
        return self.surface(position).distance

    def touched(self, position: Vector, code: Array) -> Surface:
        kind, row = code & 3, jnp.clip(code >> 2, 0, 3 * self.faces - 1)
        local = self._local(position)
        corner, edge, _, normal, *_ = self._rows(row, position.x.dtype)
        offset = local - corner
        height = offset.dot(normal)
        if self.form.two_sided:
            normal, height = normal * jnp.where(height < 0, -1.0, 1.0), jnp.abs(height)
        off_edge = offset - edge * offset.dot(edge)
        apart = _chosen(kind == VERTEX, offset, off_edge)
        length = smooth.norm(apart)
        flat = (kind == FACE) | (length == 0)
        direction = _chosen(flat, normal, apart * smooth.divide(1.0, length))
        distance = jnp.where(kind == FACE, height, length)
        distance = jnp.where(kind == NOTHING, FAR, distance)
        outward = self._from_local(direction)
        arm = position - outward * distance - self.reference
        sliding = turned(self.axis, arm) * self.rates.spin
        return Surface(distance, outward, times(self.axis, self.rates.speed) + sliding)

    def met(self, position: Vector, faces: Array, most: Array) -> Array:
        local = self._local(position)
        kind, row = self._feature(local, self._closest(local, faces, most))
        return jnp.where(self._counts(local, kind, row), 4 * row + kind, UNTOUCHED)

    def listing(self, position: Vector, radius: Array, room: Room) -> Listing:
        table, local = voxels_of(self.form, room.farthest), self._local(position)
        sphere, number, used = lists_met(table, local, room.rows)
        sizes = (room.gap, room.faces)
        near, faces, most = near_faces(table, (local, radius), (sphere, number, used), *sizes)
        return Listing(sphere, jnp.asarray(table.patch)[number], near, faces, (used, most))

    def moved(self, time_step: Real) -> "Mesh":
        reference = self.reference + times(self.axis, self.rates.speed * time_step)
        angle = self.angle + self.rates.spin * time_step
        return eqx.tree_at(lambda b: (b.reference, b.angle), self, (reference, angle))

    def removed(self) -> "Mesh":
        away = times(self.axis, jnp.full_like(self.angle, -FAR))
        return self._at(across(self.axis, self.reference) + away)

    def touching(self, position: Vector, radius: Array) -> "Mesh":
        """Along its axis, up to the first sphere that it meets; where it is if it meets none."""
        local, ahead = self._local(position), Vector(*map(jnp.asarray, self.axis))

        def nearer(face, least):
            rows = self._rows(3 * face + jnp.arange(3), radius.dtype)
            corners = [jax.tree.map(lambda part, k=k: part[k], rows) for k in range(3)]
            return jnp.minimum(least, _way_to_face(local, radius, ahead, corners))

        none = jnp.full_like(radius, jnp.inf)
        way = jnp.min(jax.lax.fori_loop(0, self.faces, nearer, none))
        way = jnp.where(jnp.isfinite(way), way, 0.0)
        return self._at(self.reference + times(self.axis, way))

    def home(self) -> Vector:
        return self.made_at

    def travelled(self, since: Self) -> Array:
        shift = smooth.norm(self.reference - since.reference)
        return shift + jnp.abs(self.angle - since.angle) * self.form.radius

    @property
    def size(self) -> Array:
        return jnp.full_like(self.rates.growth, jnp.inf)

    def driven(self, rates: Rates) -> "Mesh":
        rates = Rates(rates.speed, rates.spin, jnp.zeros_like(rates.growth))
        return eqx.tree_at(lambda b: b.rates, self, rates)

    def _at(self, reference: Vector) -> "Mesh":
        return eqx.tree_at(lambda b: b.reference, self, reference)

    # ------------------------------------------------------------- in the frame of the triangles

    def _local(self, position: Vector) -> Vector:
        """Points (m) as seen from the mesh, which has turned."""
        return self._turned(position - self.reference, -1.0)

    def _from_local(self, vector: Vector) -> Vector:
        return self._turned(vector, 1.0)

    def _turned(self, vector: Vector, sense: float) -> Vector:
        cosine, sine = jnp.cos(self.angle), jnp.sin(self.angle) * sense
        kept = times(self.axis, along(self.axis, vector) * (1 - cosine))
        return vector * cosine + turned(self.axis, vector) * sine + kept

    def _rows(self, row: Array, dtype) -> list[Vector]:
        """Corner, edge, its normal into the face, the face's, pseudo-normals of edge and corner."""
        table = jnp.asarray(self.form.rows, dtype)[row]
        return [Vector(*(table[..., 3 * k + i] for i in range(3))) for k in range(6)]

    def _closest(self, local: Vector, faces: Array, most: Array) -> Array:
        """The closest of each point's faces (K, n), of the first `most` of them."""
        frames = jnp.asarray(self.form.frames, local.x.dtype)

        def better(number, best):
            face = jax.lax.dynamic_index_in_dim(faces, number, 1, False)
            return _closer(frames, local, face, best)

        begun = (jnp.full_like(local.x, jnp.inf), jnp.zeros_like(faces[:, 0]))
        return jax.lax.fori_loop(0, most, better, begun)[1]

    def _closest_of_all(self, local: Vector) -> Array:
        frames = jnp.asarray(self.form.frames, local.x.dtype)
        begun = (jnp.full_like(local.x, jnp.inf), jnp.zeros(local.x.shape, jnp.int32))
        every = jax.lax.fori_loop(0, self.faces, lambda k, b: _closer(frames, local, k, b), begun)
        return every[1]

    def _feature(self, local: Vector, face: Array) -> tuple[Array, Array]:
        """Kind and row of what is the closest of a face: itself, an edge or a vertex."""
        rows = [self._rows(3 * face + k, local.x.dtype) for k in range(3)]
        offset = [local - corner for corner, *_ in rows]
        inside = [w.dot(inward) > 0 for w, (_, _, inward, *_) in zip(offset, rows, strict=True)]
        best, kind, row = _nearest_of_edge(offset, rows, 0)
        for k in (1, 2):
            square, its_kind, its_row = _nearest_of_edge(offset, rows, k)
            closer = square < best
            kind, row = jnp.where(closer, its_kind, kind), jnp.where(closer, its_row, row)
            best = jnp.where(closer, square, best)
        above = inside[0] & inside[1] & inside[2]
        return jnp.where(above, FACE, kind), 3 * face + jnp.where(above, 0, row)

    def _counts(self, local: Vector, kind: Array, row: Array) -> Array:
        """Whether what is closest is touched from there, and by this patch."""
        rules = jnp.asarray(self.form.rules)[row]
        theirs, of_edge, of_vertex, place = (rules[..., k] for k in range(4))
        corner, _, inward, *_ = self._rows(theirs, local.x.dtype)
        beyond = (local - corner).dot(inward) <= 0
        in_cone = self._in_cone(local - self._rows(row, local.x.dtype)[0], place)
        edge = (of_edge == ALWAYS) | ((of_edge == IF_IN_CONE) & beyond)
        vertex = (of_vertex == ALWAYS) | ((of_vertex == IF_IN_CONE) & in_cone)
        counts = (kind == FACE) | ((kind == EDGE) & edge) | ((kind == VERTEX) & vertex)
        return counts if self.form.two_sided else counts & self._outside(local, kind, row)

    def _in_cone(self, offset: Vector, place: Array) -> Array:
        """Whether an offset from a vertex points away from all edges there."""
        rays = jnp.asarray(self.form.rays, offset.x.dtype)[place]
        inside = offset.x == offset.x
        for k in range(0, rays.shape[-1], 3):
            inside = inside & (offset.dot(Vector(*(rays[..., k + i] for i in range(3)))) <= 0)
        return inside

    def _outside(self, local: Vector, kind: Array, row: Array) -> Array:
        """Whether a point is on the outer side of what is closest to it."""
        corner, _, _, normal, of_edge, of_vertex = self._rows(row, local.x.dtype)
        side = _chosen(kind == FACE, normal, _chosen(kind == EDGE, of_edge, of_vertex))
        return (local - corner).dot(side) > 0


def _chosen(first: Array, one: Vector, two: Vector) -> Vector:
    return jax.tree.map(lambda a, b: jnp.where(first, a, b), one, two)


def _closer(frames: Array, local: Vector, face: Array, best: tuple[Array, Array]):
    """The better of the best so far and of a face: square of the distance (m2), and number."""
    square = squared_distance(frames[face], local.x, local.y, local.z, jnp)
    closer = square < best[0]
    return jnp.where(closer, square, best[0]), jnp.where(closer, face, best[1])


def _nearest_of_edge(offset: list[Vector], rows: list[list[Vector]], k: int):
    """Square of the distance (m2) to edge k of a face, the kind of what is closest, its row of 3.

    `offset` are from the three corners.  Where the edge ends is decided by offsets from that end,
    so that both faces of an edge decide alike.
    """
    after, edge = (k + 1) % 3, rows[k][1]
    ahead = offset[k].dot(edge)
    before, beyond = ahead <= 0, offset[after].dot(edge) >= 0
    off = offset[k] - edge * ahead
    apart = _chosen(before, offset[k], _chosen(beyond, offset[after], off))
    kind = jnp.where(before | beyond, VERTEX, EDGE)
    return apart.dot(apart), kind, jnp.where(beyond & ~before, after, k)


# ----------------------------------------------------------------------- the way to first contact


def _way_to_face(local: Vector, radius: Array, ahead: Vector, corners: list[list[Vector]]) -> Array:
    """The way (m) along `ahead`, from far behind, to where a face first touches each sphere."""
    offset = [local - corner for corner, *_ in corners]
    normal = corners[0][3]
    facing = normal.dot(ahead)
    height = offset[0].dot(normal) - jnp.where(facing > 0, radius, -radius)
    way = smooth.divide(height, facing)
    inside = [
        (w - ahead * way).dot(inward) >= 0
        for w, (_, _, inward, *_) in zip(offset, corners, strict=True)
    ]
    inside = inside[0] & inside[1] & inside[2] & (facing != 0)
    ways = [jnp.where(inside, way, jnp.inf)]
    for k, (_, edge, *_) in enumerate(corners):
        following = offset[(k + 1) % 3]
        way = _way_to_line(offset[k], radius, ahead, edge)
        on = ((offset[k] - ahead * way).dot(edge) >= 0) & ((following - ahead * way).dot(edge) <= 0)
        ways.append(jnp.where(jnp.isfinite(way) & on, way, jnp.inf))
        ways.append(_way_to_line(offset[k], radius, ahead, edge * 0.0))
    return jnp.min(jnp.stack(ways), axis=0)


def _way_to_line(offset: Vector, radius: Array, ahead: Vector, edge: Vector) -> Array:
    """The way (m) to where a line along `edge`, or a point if that is zero, touches; or inf."""
    across_edge = ahead - edge * ahead.dot(edge)
    apart = offset - edge * offset.dot(edge)
    square, product = across_edge.dot(across_edge), apart.dot(across_edge)
    root = product * product - square * (apart.dot(apart) - radius * radius)
    met = (root > 0) & (square > 1e-24)
    root = jnp.sqrt(jnp.where(met, root, 1.0))
    return jnp.where(met, (product - root) / jnp.where(met, square, 1.0), jnp.inf)


_QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
_CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_CUBE = _CUBE[np.concatenate([_QUADS[:, [0, 1, 2]], _QUADS[:, [0, 2, 3]]])]
