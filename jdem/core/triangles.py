"""Rigid surfaces made of triangles: what is known of them before anything moves.

A surface is a closed solid, whose normals point outward, or a shell, which has two sides.  Faces
that meet at less than `smooth_below` degrees form one patch: what touches a patch touches it once,
at its closest point.  Where patches meet, a contact at an edge or a vertex belongs to the patch of
the lowest number, and it counts only for a point p in the normal cone there,

    (p - edge) . t <= 0   for both faces' in-plane normals t of the edge, pointing into the face
    (p - vertex) . e <= 0 for all edges e that leave the vertex

(Voronoi regions of faces, edges and vertices; pseudo-normals tell in from out: Baerentzen and
Aanaes 2005, IEEE Trans. Vis. Comput. Graph. 11, 243).  Tables are numpy and enter programs
as constants: a surface is static.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

SMOOTH_BELOW = 20.0  # degrees between the normals of faces that one patch holds
FLAT = 1e-10  # of the longest edge's square; twice the area of a triangle that has none
FRAME = 17  # numbers of a face
SPLIT = 1e-9  # of an edge; how near a vertex lies to an edge that it splits
ALWAYS, IF_IN_CONE, NEVER = 0, 1, 2  # whether a contact at an edge or a vertex counts


@dataclass(frozen=True, eq=False)
class TriangleSurface:
    """Triangles about a reference point at the origin; equal if their numbers are.

    corners (faces, 3, 3) in m, counter-clockwise as seen from outside; patch (faces,) is the
    number of each one's patch; edge k of a face runs from corner k to the next.  Faces stand for
    their rows: row 3 f + k is edge k of face f, and its first corner.
    """

    name: str
    corners: np.ndarray
    patch: np.ndarray
    two_sided: bool

    @staticmethod
    def of(
        corners: np.ndarray,
        *,
        two_sided: bool = False,
        smooth_below: float = SMOOTH_BELOW,
        name: str = "the mesh",
    ) -> "TriangleSurface":
        """From corners (faces, 3, 3) in m; `ValueError` that names what is wrong with them.

        `smooth_below` (degrees) is the kink below which neighbours form one patch.
        """
        corners = np.array(corners, float).reshape(-1, 3, 3) + 0.0  # no -0
        _check_triangles(corners, name)
        edges = _edges(corners)
        _check_edges(corners, edges, two_sided, name)
        return TriangleSurface(name, corners, _patches(corners, edges, smooth_below), two_sided)

    @property
    def faces(self) -> int:
        return len(self.corners)

    @property
    def patches(self) -> int:
        return int(self.patch.max()) + 1

    @property
    def radius(self) -> float:
        """Of the sphere about the reference point that holds it, m."""
        return float(np.linalg.norm(self.corners, axis=-1).max())

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit normals (faces, 3)."""
        return _normals(self.corners)

    @cached_property
    def frames(self) -> np.ndarray:
        """Of each face (faces, 17): corner 0, unit vectors along edge 0, into the face and normal
        to it, length of edge 0, place of corner 2 in that frame, 1/length^2 of edges 1 and 2."""
        first, along, inward = self.corners[:, 0], self._directions[:, 0], self._inward[:, 0]
        tip = self.corners[:, 2] - first
        squares = np.sum((np.roll(self.corners, -1, axis=1) - self.corners) ** 2, axis=-1)
        plane = np.stack([_dot(tip, along), _dot(tip, inward)], axis=1)
        parts = [first, along, inward, self.normals, np.sqrt(squares[:, :1]), plane]
        return np.concatenate([*parts, 1 / squares[:, 1:]], axis=1)

    @cached_property
    def rows(self) -> np.ndarray:
        """Of each row (3 faces, 18): corner, direction of the edge, its normal into the face, the
        face's normal, and pseudo-normals of the edge and of the corner."""
        normal = np.repeat(self.normals[:, None], 3, axis=1)
        parts = [self.corners, self._directions, self._inward, normal, *self._pseudo_normals]
        return np.concatenate([part.reshape(-1, 3) for part in parts], axis=1)

    @cached_property
    def rules(self) -> np.ndarray:
        """Of each row (3 faces, 4): the same edge's row of the neighbour (its own if there is
        none), whether the edge counts, whether the corner counts, and its row of `rays`."""
        other, patch = self._edges.other, np.repeat(self.patch, 3)
        theirs = np.where(other < 0, patch, patch[other])
        edge = np.where(theirs == patch, ALWAYS, np.where(theirs > patch, IF_IN_CONE, NEVER))
        vertex, lowest = self._edges.vertex, np.full(self._edges.vertex.max() + 1, self.patches)
        np.minimum.at(lowest, vertex, patch)
        mixed = self._mixed[vertex]
        corner = np.where(mixed, np.where(lowest[vertex] == patch, IF_IN_CONE, NEVER), ALWAYS)
        place = np.where(mixed, np.cumsum(self._mixed)[vertex], 0)
        own = np.arange(len(other))
        return np.stack([np.where(other < 0, own, other), edge, corner, place], 1).astype(np.int32)

    @cached_property
    def rays(self) -> np.ndarray:
        """Directions of all edges that leave each vertex between patches (1 + vertices, 3 x most),
        padded with zeros; the first row is empty."""
        edges, found = self._edges, [[] for _ in range(int(self._mixed.sum()) + 1)]
        place, directions = np.cumsum(self._mixed), self._directions.reshape(-1, 3)
        for row, (start, end) in enumerate(zip(edges.vertex, edges.end, strict=True)):
            if self._mixed[start]:
                found[place[start]].append(directions[row])
            if self._mixed[end] and edges.other[row] < 0:  # nobody else knows of it
                found[place[end]].append(-directions[row])
        table = np.zeros((len(found), max(1, *map(len, found)), 3))
        for row, rays in zip(table, found, strict=True):
            row[: len(rays)] = np.reshape(rays, (-1, 3))
        return table.reshape(len(table), -1)

    @cached_property
    def _edges(self) -> "_Edges":
        return _edges(self.corners)

    @cached_property
    def _directions(self) -> np.ndarray:
        along = np.roll(self.corners, -1, axis=1) - self.corners
        return along / np.linalg.norm(along, axis=-1, keepdims=True)

    @cached_property
    def _inward(self) -> np.ndarray:
        return np.cross(self.normals[:, None], self._directions)

    @cached_property
    def _mixed(self) -> np.ndarray:
        """Whether a vertex belongs to several patches."""
        patch, vertex = np.repeat(self.patch, 3), self._edges.vertex
        lowest, highest = np.full(vertex.max() + 1, self.patches), np.zeros(vertex.max() + 1, int)
        np.minimum.at(lowest, vertex, patch)
        np.maximum.at(highest, vertex, patch)
        return lowest != highest

    @property
    def _pseudo_normals(self) -> tuple[np.ndarray, np.ndarray]:
        """Of edges: the sum of both faces' normals; of vertices: weighted by their angles."""
        normal = np.repeat(self.normals, 3, axis=0)
        other = self._edges.other
        edge = normal + np.where((other < 0)[:, None], 0.0, normal[other])
        ahead, back = self._directions, -np.roll(self._directions, 1, axis=1)
        angle = np.arccos(np.clip(_dot(ahead, back), -1.0, 1.0)).ravel()
        total = np.zeros((self._edges.vertex.max() + 1, 3))
        np.add.at(total, self._edges.vertex, normal * angle[:, None])
        return edge, total[self._edges.vertex]

    @cached_property
    def _digest(self) -> bytes:
        parts = (self.corners.tobytes(), self.patch.tobytes(), bytes([self.two_sided]))
        return hashlib.sha256(b"".join(parts)).digest()

    def __hash__(self) -> int:
        return hash(self._digest)

    def __eq__(self, other: object) -> bool:
        return type(other) is TriangleSurface and self._digest == other._digest

    def __repr__(self) -> str:
        kind = "shell" if self.two_sided else "solid"
        return f"TriangleSurface({kind}, {self.faces} faces, {self._digest.hex()[:12]})"


def read_stl(path: str | Path, unit: float = 1.0) -> np.ndarray:
    """Corners (faces, 3, 3) in m of an STL file, text or binary, whose lengths are in `unit` (m).

    `ValueError` where the file is none.  Normals are those of the corners' order; what the file
    says of them is not used.
    """
    from meshio import ReadError, stl  # slow to import, and few need it

    if not Path(path).is_file():
        raise ValueError(f"{path}: no such file; give the path of an STL file")
    try:
        with np.errstate(all="ignore"):  # it takes text for numbers before it sees that it is text
            mesh = stl.read(str(path))
        cells = mesh.get_cells_type("triangle")
    except (ReadError, ValueError, IndexError, TypeError, AttributeError) as problem:
        raise ValueError(f"{path}: not an STL file; export it as text or binary STL") from problem
    if not len(cells):
        raise ValueError(f"{path}: there is no triangle in it; export the part's surface")
    return np.asarray(mesh.points, float)[cells] * unit


@dataclass(frozen=True, eq=False)
class _Edges:
    """Of each row: the vertex at its corner and at its end, and the neighbour's row or -1."""

    vertex: np.ndarray
    end: np.ndarray
    other: np.ndarray
    uses: np.ndarray  # how many faces have the edge


def _edges(corners: np.ndarray) -> _Edges:
    """Vertices are the same where their coordinates are, to the last bit."""
    _, vertex = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    vertex = vertex.reshape(-1)
    end = np.roll(vertex.reshape(-1, 3), -1, axis=1).ravel()
    both = np.sort(np.stack([vertex, end], axis=1), axis=1)
    _, edge, count = np.unique(both, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    order = np.argsort(edge, kind="stable")
    other = np.full(len(vertex), -1)
    twice = edge[order][1:] == edge[order][:-1]
    one, two = order[:-1][twice], order[1:][twice]
    other[one], other[two] = two, one
    return _Edges(vertex, end, other, count[edge])


def _normals(corners: np.ndarray) -> np.ndarray:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return across / np.linalg.norm(across, axis=-1, keepdims=True)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def _patches(corners: np.ndarray, edges: _Edges, smooth_below: float) -> np.ndarray:
    """The number of each face's patch (faces,), in the order of their first faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    normal = np.repeat(_normals(corners), 3, axis=0)
    shared = np.flatnonzero(edges.other >= 0)
    one, two = normal[shared], normal[edges.other[shared]]
    kink = np.degrees(np.arctan2(np.linalg.norm(np.cross(one, two), axis=-1), _dot(one, two)))
    smooth = shared[kink < max(smooth_below, COPLANAR)]
    links = (np.ones(len(smooth)), (smooth // 3, edges.other[smooth] // 3))
    count = len(corners)
    found = connected_components(coo_array(links, shape=(count, count)), directed=False)[1]
    _, first, number = np.unique(found, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number].astype(np.int64)


COPLANAR = 1e-3  # degrees; coplanar faces are one patch, whatever is asked for


# ------------------------------------------------------------------------------ what is refused


def _check_triangles(corners: np.ndarray, name: str) -> None:
    """Finite, not empty, each with an area, and no two the same."""
    if not len(corners):
        raise ValueError(f"{name}: there is no triangle in it; export the part's surface")
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    _refuse(name, bad, "not finite", "export the part again")
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.max(np.sum(sides * sides, axis=-1), axis=1)
    twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
    _refuse(name, twice <= FLAT * longest, "without area", "remove them, or repair the mesh")
    vertex = np.sort(_edges(corners).vertex.reshape(-1, 3), axis=1)
    _, which, count = np.unique(vertex, axis=0, return_inverse=True, return_counts=True)
    _refuse(name, count[which.reshape(-1)] > 1, "there more than once", "keep one of each")


def _check_edges(corners: np.ndarray, edges: _Edges, two_sided: bool, name: str) -> None:
    """Two faces at an edge (one, of a shell), which agree about what is outside."""
    crowded = "at edges of more than two"
    _refuse_rows(name, edges.uses > 2, crowded, "keep two at each edge, or separate the parts")
    open_edges = edges.uses == 1
    if not two_sided:
        closing = "close it, or declare it a shell (two_sided=True)"
        _refuse_rows(name, open_edges, "at the edges of holes", closing)
    same = (edges.other >= 0) & (edges.vertex == edges.vertex[edges.other])
    agreeing = "orient all faces alike (`unify normals`)"
    _refuse_rows(name, same, "turned against their neighbours", agreeing)
    if two_sided:
        splitting = "give both faces the vertex (repair T-junctions)"
        _refuse_rows(name, _split(corners, edges), "at edges split by a vertex", splitting)
    elif (volume := _volume(corners)) <= 0:
        raise ValueError(
            f"{name}: inside out, its volume is {volume:.3g} m3; turn its normals outward"
        )


def _refuse_rows(name: str, bad: np.ndarray, what: str, repair: str) -> None:
    _refuse(name, bad.reshape(-1, 3).any(axis=1), what, repair)


def _refuse(name: str, bad, what: str, repair: str) -> None:
    """`ValueError` where a face is bad."""
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise ValueError(
            f"{name}: {int(bad.sum())} of {len(bad)} triangles are {what} "
            f"(the first is number {first}); {repair}"
        )


def _volume(corners: np.ndarray) -> float:
    """Signed, m3, of a closed surface; about its middle, for the digits."""
    a, b, c = np.moveaxis(corners - corners.reshape(-1, 3).mean(axis=0), 1, 0)
    return float(np.sum(_dot(a, np.cross(b, c))) / 6)


def _split(corners: np.ndarray, edges: _Edges) -> np.ndarray:
    """Which open edges have a vertex of an open edge within them (3 faces,)."""
    rows = np.flatnonzero(edges.uses == 1)
    split = np.zeros(len(edges.uses), bool)
    places = corners.reshape(-1, 3)
    ends = np.roll(corners, -1, axis=1).reshape(-1, 3)
    for row in rows:
        side = ends[row] - places[row]
        offset = places[rows] - places[row]
        along = offset @ side / (side @ side)
        apart = np.linalg.norm(offset - along[:, None] * side, axis=-1) / np.linalg.norm(side)
        split[row] = np.any((apart < SPLIT) & (along > SPLIT) & (along < 1 - SPLIT))
    return split


def squared_distance(frame, x, y, z, numpy):
    """Square of the distance (m2) of points to the triangles of `frame` (..., 17), in one of two
    libraries, `numpy` or `jax.numpy`; arrays of one shape, or of shapes that broadcast."""
    ox, oy, oz, ux, uy, uz, vx, vy, vz, wx, wy, wz, length, tip_u, tip_v, second, third = (
        frame[..., k] for k in range(FRAME)
    )
    x, y, z = x - ox, y - oy, z - oz
    u, v, w = x * ux + y * uy + z * uz, x * vx + y * vy + z * vz, x * wx + y * wy + z * wz
    on_first = u - numpy.minimum(numpy.maximum(u, 0.0), length)
    first = on_first * on_first + v * v
    of_second, beyond_second = _from_edge(u - length, v, tip_u - length, tip_v, second, numpy)
    of_third, beyond_third = _from_edge(u - tip_u, v - tip_v, -tip_u, -tip_v, third, numpy)
    outside = (v < 0) | beyond_second | beyond_third
    nearest = numpy.minimum(first, numpy.minimum(of_second, of_third))
    return w * w + numpy.where(outside, nearest, 0.0)


def _from_edge(u, v, side_u, side_v, inverse, numpy):
    """Square of the distance in the plane from an edge that begins at the origin, and whether the
    point lies beyond it; `inverse` is 1/length^2."""
    share = numpy.minimum(numpy.maximum((u * side_u + v * side_v) * inverse, 0.0), 1.0)
    du, dv = u - share * side_u, v - share * side_v
    return du * du + dv * dv, side_u * v - side_v * u < 0
