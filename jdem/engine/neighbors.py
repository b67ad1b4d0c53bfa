"""Fixed-capacity lists of pairs and of wall contacts; history travels with its pair.

Candidates come from a grid of cells as wide as the largest sphere plus the skin, and
are packed into a list sorted by a unique key.  On a rebuild each new entry takes over
the history of the old entry with the same key.  A list that is too small is reported
with the capacity that would do; it is never silent.  Keys have 32 bits where these are enough,
to 46 340 spheres, and 64 beyond.  Of boundaries made of faces, those near each sphere are listed
too (`FaceList`).
"""

from collections.abc import Callable
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.bodies.base import AbstractBodies
from jdem.boundaries.base import Listing, Room
from jdem.boundaries.composite import Boundaries, first_parts, part_count
from jdem.core.kernel import most_used
from jdem.core.vector import Vector
from jdem.laws.base import AbstractContactLaw, Memory

_FORWARD = np.array(
    [(dx, dy, dz) for dx in (-1, 0, 1) for dy in (-1, 0, 1) for dz in (-1, 0, 1)][14:]
)
BITS = 32  # of a word
_SINGLE = np.uint32(1) << np.arange(BITS, dtype=np.uint32)
Entries = tuple[Array, Array]  # the two sides of contacts


class Grid(eqx.Module):
    """Capacities of the search; static, because arrays take their shapes from it.

    `shape` counts cells along x, y, z (three at least: space is wrapped around the grid,
    so spheres may leave it); `cell` (m) is a cell's edge.  Pairs are listed up to a gap of
    `skin` + `reach` (m): spheres may move by the skin between rebuilds, and forces act across
    gaps up to the reach.  `faces` is the most that a boundary made of faces lists for a contact; it
    is no part of what a grid is known by.
    """

    shape: tuple[int, int, int] = eqx.field(static=True)
    per_cell: int = eqx.field(static=True)
    pairs: int = eqx.field(static=True)
    wall_contacts: int = eqx.field(static=True)
    cell: float = eqx.field(static=True)
    skin: float = eqx.field(static=True)
    reach: float = eqx.field(static=True, default=0.0)
    faces: int = eqx.field(static=True, default=128, repr=False)

    @property
    def farthest(self) -> float:
        """How far (m) a listed boundary may be from a sphere's centre, at most."""
        return 0.5 * (self.cell - self.skin - self.reach) + self.skin


class FaceList(eqx.Module):
    """Of one boundary made of faces, those that listed contacts with it may touch.

    entry (K,) is the contact's place in its list, faces (K, n); `used` rows stand at the beginning,
    and only the first `most` faces of a row are needed.
    """

    entry: Array
    faces: Array
    count: Array
    most: Array

    @staticmethod
    def empty(grid: Grid) -> "FaceList":
        rows, zero = grid.wall_contacts, jnp.zeros((), jnp.int32)
        entry = jnp.full(rows, rows, jnp.int32)
        return FaceList(entry, jnp.zeros((rows, grid.faces), jnp.int32), zero, zero)

    @staticmethod
    def of(listing: Listing, key: Array, listed: Array) -> "FaceList":
        """From what the boundary found, under these keys, and the keys of all that is listed."""
        assert listing.faces is not None and listing.asked is not None
        capacity, (_, most) = listed.shape[0], listing.asked
        place = jnp.minimum(jnp.searchsorted(listed, key), capacity - 1)
        there = listing.near & (listed[place] == key)
        order = jnp.argsort(~there)[:capacity]
        entry = jnp.where(there, place, capacity)[order].astype(jnp.int32)
        count = jnp.minimum(jnp.sum(there), capacity).astype(jnp.int32)
        faces = listing.faces[order]
        return FaceList(entry, faces, count, jnp.minimum(most, faces.shape[1]))

    def used(self) -> tuple[Array, Array]:
        """How many rows there are, and how many faces of each are needed."""
        return most_used(self.count), most_used(self.most)


def no_faces(grid: Grid, boundaries: Boundaries) -> tuple[FaceList | None, ...]:
    """Before the first rebuild; nothing where no boundary has faces."""
    if not any(boundary.faces for boundary in boundaries):
        return ()
    return tuple(FaceList.empty(grid) if boundary.faces else None for boundary in boundaries)


class ContactList(eqx.Module):
    """Entries sorted by key; unused ones stand at the end and have `alive` 0.

    For pairs, `second` is a sphere; for wall contacts it is the number of the boundary, or of its
    part where boundaries have several.  `faces` are those of each boundary that is made of them.
    """

    key: Array
    first: Array
    second: Array
    alive: Array
    history: Memory  #: what the law remembers of each entry
    faces: tuple[FaceList | None, ...] = ()

    def used(self) -> Array:
        """How many entries there are; they stand at the beginning."""
        return most_used(jnp.sum(self.alive > 0).astype(jnp.int32))

    @staticmethod
    def empty(capacity: int, dtype, law: AbstractContactLaw, kinds: int = 0) -> "ContactList":
        """Without entries, for contacts that follow `law`, of so many that can be told apart:
        the number of spheres times that of what they may touch."""
        zero, kind = jnp.zeros(capacity, jnp.int32), _key_type(kinds)
        key = jnp.full(capacity, _no_key(kind), kind)
        alive = jnp.zeros(capacity, dtype)
        return ContactList(key, zero, zero, alive, law.memory(capacity, dtype))


class Demand(eqx.Module):
    """Largest capacity that any rebuild so far asked for."""

    pairs: Array
    wall_contacts: Array
    per_cell: Array
    faces: Array

    @staticmethod
    def none() -> "Demand":
        zero = jnp.zeros((), jnp.int32)
        return Demand(zero, zero, zero, zero)

    def including(self, other: "Demand") -> "Demand":
        return jax.tree.map(jnp.maximum, self, other)

    def exceeds(self, grid: Grid) -> Array:
        """True where a list was too small."""
        return (
            (self.pairs > grid.pairs)
            | (self.wall_contacts > grid.wall_contacts)
            | (self.per_cell > grid.per_cell)
            | (self.faces > grid.faces)
        )


def _key_type(kinds: int) -> type[np.signedinteger]:
    """Integers that tell so many entries apart, and none of them from `_no_key`."""
    return np.int32 if kinds < np.iinfo(np.int32).max else np.int64


def _no_key(kind) -> int:
    """The key of unused entries: the largest, so that they stand at the end."""
    return np.iinfo(kind).max


def rebuild(
    grid: Grid,
    bodies: AbstractBodies,
    boundaries: Boundaries,
    position: Vector,
    pairs: ContactList,
    contacts: ContactList,
) -> tuple[ContactList, ContactList, Demand]:
    """Both lists for the spheres' present places, with the histories of the old lists."""
    pair, valid, fullest = _near_each_other(grid, bodies, position)
    new_pairs, pair_count = _packed(pair, valid, bodies.count, grid.pairs, pairs)
    walls = _wall_contacts if any(b.faces for b in boundaries) else _smooth_wall_contacts
    new_contacts, wall_count, faces = walls(grid, bodies, boundaries, position, contacts)
    return new_pairs, new_contacts, Demand(pair_count, wall_count, fullest, faces)


def _near_each_other(grid: Grid, bodies: AbstractBodies, position: Vector):
    """Each sphere beside those within its cell and in half of the neighbours: the entries at some
    places, whether these spheres are near (M,), and the fullest cell.

    What stands in a cell is gathered once, and empty places of it are infinitely far away.
    """
    count, most = bodies.count, grid.per_cell
    index = _cell_index(grid, position)
    own = _flat(grid, index)
    table, fullest = _table(grid, own)
    shift = (index[:, None, :] + _FORWARD[None]) % np.array(grid.shape)
    cells = jnp.concatenate([own[:, None], _flat(grid, shift)], axis=1)
    rows = jnp.concatenate([position.stack(), bodies.radius[:, None]], axis=1)
    filled = jnp.concatenate([rows, jnp.full((1, 4), jnp.inf, rows.dtype)])
    there = jax.lax.optimization_barrier(filled[table])[cells]
    offset = rows[:, None, None, :3] - there[..., :3]
    reach = rows[:, None, None, 3] + there[..., 3] + (grid.skin + grid.reach)
    near = jnp.sum(offset * offset, axis=-1) < reach * reach
    later = table[own] > jnp.arange(count)[:, None]
    near = jnp.concatenate([near[:, :1] & later[:, None], near[:, 1:]], axis=1)
    together = bodies.one_body(jnp.arange(count)[:, None, None], table[cells])
    near = near if together is None else near & ~together

    def pair(place: Array) -> Entries:
        one, slot = place // (cells.shape[1] * most), place % most
        other = table[cells.ravel()[place // most], slot]
        return jnp.minimum(one, other), jnp.maximum(one, other)

    return pair, near.ravel(), fullest


def _table(grid: Grid, own: Array):
    """The spheres in each cell (cells, per_cell), the number of all where there is none, and how
    many the fullest cell holds; `own` (N,) is each sphere's cell."""
    count, cells = len(own), int(np.prod(grid.shape))
    order = jnp.argsort(own)
    sorted_cells = own[order]
    start = jnp.searchsorted(sorted_cells, jnp.arange(cells + 1)).astype(jnp.int32)
    rank = jnp.arange(count) - start[sorted_cells]
    table = jnp.full((cells, grid.per_cell), count, jnp.int32)
    table = table.at[sorted_cells, rank].set(order.astype(jnp.int32), mode="drop")
    return table, jnp.max(start[1:] - start[:-1])


def _cell_index(grid: Grid, position: Vector):
    """Cell of each point on the wrapped grid, shape (N, 3)."""
    return jnp.floor(position.stack() / grid.cell).astype(jnp.int32) % np.array(grid.shape)


def _flat(grid: Grid, place):
    return (place[..., 0] * grid.shape[1] + place[..., 1]) * grid.shape[2] + place[..., 2]


def _smooth_wall_contacts(
    grid: Grid, bodies: AbstractBodies, boundaries: Boundaries, position: Vector, old: ContactList
):
    """Contacts with boundaries that have no faces, how many, and no face."""
    near = [b.near(position, bodies.radius, grid.skin) for b in boundaries]
    valid, stride = jnp.stack(near, axis=-1).ravel(), len(boundaries)

    def touching(place: Array) -> Entries:
        return place // stride, place % stride

    contacts, count = _packed(touching, valid, stride, grid.wall_contacts, old)
    return contacts, count, jnp.zeros((), jnp.int32)


def _wall_contacts(
    grid: Grid, bodies: AbstractBodies, boundaries: Boundaries, position: Vector, old: ContactList
):
    """Contacts with boundaries of any kind, the room they take, and the most faces of one."""
    room = Room(grid.skin, grid.farthest, grid.wall_contacts, grid.faces)
    position, radius, boundaries = jax.lax.stop_gradient((position, bodies.radius, boundaries))
    found = [boundary.listing(position, radius, room) for boundary in boundaries]
    parts = [f.part + first for f, first in zip(found, first_parts(boundaries), strict=True)]
    stride = part_count(boundaries)
    spheres, every = jnp.concatenate([f.sphere for f in found]), jnp.concatenate(parts)
    near = jnp.concatenate([f.near for f in found])

    def touching(place: Array) -> Entries:
        return spheres[place], every[place]

    contacts, count = _packed(touching, near, stride, grid.wall_contacts, old)
    keys = [
        _keys((f.sphere, part), stride, contacts.key.dtype)
        for f, part in zip(found, parts, strict=True)
    ]
    faces = tuple(
        None if f.faces is None else FaceList.of(f, key, contacts.key)
        for f, key in zip(found, keys, strict=True)
    )
    asked = [f.asked for f in found if f.asked is not None]
    count = jnp.max(jnp.stack([count, *(rows for rows, _ in asked)]))
    return replace(contacts, faces=faces), count, jnp.max(jnp.stack([most for _, most in asked]))


def _keys(entries, stride, kind):
    """Of entries (first, second): integers of a kind that has room for them."""
    first, second = entries
    return first.astype(kind) * stride + second.astype(kind)


def _packed(
    entries: Callable[[Array], Entries], valid, stride: int, capacity: int, old: ContactList
):
    """Valid candidates sorted by key in a list of fixed length, and how many there were; `entries`
    gives the two sides of those that stand at some places."""
    kind = old.key.dtype
    none = _no_key(kind)
    place, count = _places(valid, capacity)
    listed = jnp.arange(capacity) < count
    key = jnp.sort(jnp.where(listed, _keys(entries(place), stride, kind), none))
    alive = (key != none).astype(old.alive.dtype)
    used = jnp.where(key != none, key, 0)
    first, second = (part.astype(jnp.int32) for part in (used // stride, used % stride))
    return ContactList(key, first, second, alive, inherited(key, old)), count


def _places(valid, capacity: int):
    """Where the first `capacity` of these (M,) are true, and how many are; any place beyond.

    Thirty-two of them share a word: a running sum over all of them, for their places in the list,
    took longer than the search for them.
    """
    words = jnp.pad(valid, (0, -len(valid) % BITS)).reshape(-1, BITS)
    words = jnp.sum(jnp.where(words, _SINGLE, jnp.uint32(0)), axis=1, dtype=jnp.uint32)
    held = jax.lax.population_count(words).astype(jnp.int32)
    until, wanted = jnp.cumsum(held), jnp.arange(capacity, dtype=jnp.int32)
    word = jnp.minimum(jnp.searchsorted(until, wanted, side="right"), len(words) - 1)
    bit = _nth_bit(words[word], wanted - (until - held)[word])
    return jnp.minimum(BITS * word + bit, len(valid) - 1).astype(jnp.int32), until[-1]


def _nth_bit(word, number):
    """Which bit of each word (uint32) is the one of this number among those that are set."""
    place = jnp.zeros_like(number)
    for half in (16, 8, 4, 2, 1):
        low = jax.lax.population_count(word & jnp.uint32(2**half - 1)).astype(number.dtype)
        higher = number >= low
        number, place = jnp.where(higher, number - low, number), place + half * higher
        word = jnp.where(higher, word >> half, word)
    return place


def inherited(key, old: ContactList) -> Memory:
    """Histories of the old entries with the same keys, zero for new entries."""
    place = jnp.clip(jnp.searchsorted(old.key, key), 0, old.key.shape[0] - 1)
    same = (old.key[place] == key) & (key != _no_key(key.dtype))
    return jax.tree.map(lambda leaf: jnp.where(same, leaf[place], 0), old.history)
