"""Where the faces of a surface are near: small cubes of space, and the faces within a distance.

Cubes are half as wide as the distance, or wider where there would be too many.  A face is listed
in a cube if it comes within the distance of the ball about the cube; so a list holds all that it
should, and some more.  Spheres look their faces up there when contacts are listed.
"""

from dataclasses import dataclass
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.core.triangles import TriangleSurface, squared_distance
from jdem.core.vector import Vector


@dataclass(frozen=True, eq=False)
class Voxels:
    """Which faces are within a distance of each small cube of space, patch by patch.

    lowest (3,) and edge (m) place the cubes, `shape` counts them; `lists` (cubes + 1, most) names
    the lists of each cube, -1 for none, and none for the last, which is all space around.  A list
    is `count` of `faces` from `start` on, all of one patch.
    """

    lowest: np.ndarray
    edge: float
    shape: tuple[int, int, int]
    lists: np.ndarray
    start: np.ndarray
    count: np.ndarray
    patch: np.ndarray
    faces: np.ndarray
    frames: np.ndarray  # of the surface


MOST_VOXELS = 200_000
CHUNK = 64  # rows whose faces are looked at together


@lru_cache(maxsize=16)
def voxels_of(surface: TriangleSurface, distance: float) -> Voxels:
    """The faces within a distance (m); made once for each surface and distance."""
    low = surface.corners.min(axis=(0, 1)) - distance
    extent = surface.corners.max(axis=(0, 1)) + distance - low
    edge = 0.5 * distance
    while np.prod(np.ceil(extent / edge)) > MOST_VOXELS:
        edge *= 1.25
    across, along, up = (int(n) for n in np.ceil(extent / edge))
    shape = (across, along, up)
    cube, face = _near_cubes(surface, distance, low, edge, shape)
    order = np.lexsort((face, surface.patch[face], cube))
    cube, face = cube[order], face[order]
    both = np.stack([cube, surface.patch[face]], axis=1)
    lists, start, count = np.unique(both, axis=0, return_index=True, return_counts=True)
    first = np.searchsorted(lists[:, 0], np.arange(np.prod(shape) + 2))
    most = int(np.max(first[1:] - first[:-1]))
    number = first[:-1, None] + np.arange(most)
    table = np.where(number < first[1:, None], number, -1)
    return Voxels(
        lowest=low,
        edge=edge,
        shape=shape,
        lists=table.astype(np.int32),
        start=start.astype(np.int32),
        count=count.astype(np.int32),
        patch=lists[:, 1].astype(np.int32),
        faces=face.astype(np.int32),
        frames=surface.frames,
    )


def _near_cubes(surface: TriangleSurface, distance, low, edge, shape):
    """Pairs of a cube and a face (K,) whose distance may be below `distance`."""
    half = 0.5 * np.sqrt(3.0) * edge
    least = np.floor((surface.corners.min(axis=1) - distance - low) / edge).astype(int)
    most = np.floor((surface.corners.max(axis=1) + distance - low) / edge).astype(int)
    least, most = np.maximum(least, 0), np.minimum(most, np.array(shape) - 1)
    cubes, faces = [], []
    for face, (first, last) in enumerate(zip(least, most, strict=True)):
        index = np.stack(np.meshgrid(*map(np.arange, first, last + 1), indexing="ij"), -1)
        index = index.reshape(-1, 3)
        x, y, z = (low + (index + 0.5) * edge).T
        close = squared_distance(surface.frames[face], x, y, z, np) <= (distance + half) ** 2
        cubes.append(np.ravel_multi_index(tuple(index[close].T), shape))
        faces.append(np.full(int(close.sum()), face))
    return np.concatenate(cubes), np.concatenate(faces)


# ------------------------------------------------------------------- the search of one rebuild


def lists_met(table: Voxels, local: Vector, room: int):
    """Spheres and lists of faces that stand in one voxel, room for `room` of them or some more, and
    how many there are; `local` are the spheres' centres (m)."""
    room = -(-room // CHUNK) * CHUNK
    places = zip((local.x, local.y, local.z), table.lowest, table.shape, strict=True)
    flat, within = jnp.zeros(local.x.shape, jnp.int32), True
    for place, low, count in places:
        index = jnp.floor((place - low) / table.edge).astype(jnp.int32)
        flat, within = flat * count + index, within & (index >= 0) & (index < count)
    lists = jnp.asarray(table.lists)[jnp.where(within, flat, len(table.lists) - 1)]
    found = (lists >= 0).ravel()
    slot = jnp.where(found, jnp.cumsum(found) - 1, room)
    spheres = jnp.broadcast_to(jnp.arange(lists.shape[0], dtype=jnp.int32)[:, None], lists.shape)
    none = jnp.zeros(room, jnp.int32)
    sphere = none.at[slot].set(spheres.ravel(), mode="drop")
    number = none.at[slot].set(lists.ravel(), mode="drop")
    return sphere, number, jnp.sum(found).astype(jnp.int32)


def near_faces(table: Voxels, spheres, lists, gap: float, room: int):
    """Whether each sphere is within `gap` (m) of the faces of its list (K,), those that may become
    the closest (K, room), and how many of them there are at most.

    `spheres` are centres and radii (m), `lists` what `lists_met` found.  Between rebuilds all
    distances change by less than the gap; so a face can become the closest only from within twice
    the gap of the closest one.
    """
    (local, radius), (sphere, number, used) = spheres, lists
    capacity = sphere.shape[0]

    def chunk(k, made):
        *lists, most = made
        here = k * CHUNK + jnp.arange(CHUNK)
        near = (local.at(sphere[here]), radius[sphere[here]])
        *found, some = _examined(table, *near, number[here], here < used, gap, room)
        lists = [
            jax.lax.dynamic_update_slice_in_dim(whole, part, k * CHUNK, 0)
            for whole, part in zip(lists, found, strict=True)
        ]
        return *lists, jnp.maximum(most, some)

    blank = jnp.zeros((capacity, room), jnp.int32)
    begun = (jnp.zeros(capacity, bool), blank, jnp.zeros((), jnp.int32))
    chunks = jnp.minimum((used + CHUNK - 1) // CHUNK, capacity // CHUNK)
    return jax.lax.fori_loop(0, chunks, chunk, begun)


def _examined(table: Voxels, local: Vector, radius: Array, number: Array, used, gap, room):
    """The same of a few rows."""
    listed = jnp.arange(int(table.count.max()))
    place = jnp.asarray(table.start)[number][:, None] + listed
    faces = jnp.asarray(table.faces)[jnp.minimum(place, len(table.faces) - 1)]
    frames = jnp.asarray(table.frames, radius.dtype)[faces]
    x, y, z = (part[:, None] for part in (local.x, local.y, local.z))
    distance = jnp.sqrt(squared_distance(frames, x, y, z, jnp))
    in_list = listed < jnp.asarray(table.count)[number][:, None]
    distance = jnp.where(in_list, distance, jnp.inf)
    nearest = jnp.min(distance, axis=1)
    near = (nearest - radius < gap) & used
    limit = jnp.minimum(nearest + 2 * gap, radius + gap)
    kept = (distance <= limit[:, None]) & near[:, None]
    rank = jnp.where(kept, jnp.cumsum(kept, axis=1) - 1, room)
    row = jnp.broadcast_to(jnp.arange(rank.shape[0])[:, None], rank.shape)
    closest = jnp.take_along_axis(faces, jnp.argmin(distance, axis=1)[:, None], axis=1)
    chosen = jnp.broadcast_to(closest, (rank.shape[0], room))
    chosen = chosen.at[row, rank].set(faces, mode="drop")
    return near, chosen, jnp.max(jnp.sum(kept, axis=1)).astype(jnp.int32)
