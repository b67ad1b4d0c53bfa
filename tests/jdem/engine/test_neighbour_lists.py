"""Lists of neighbours against a search by force: complete, with their history, or flagged.

A cloud of spheres of several sizes between base, mould and platen; nothing is integrated.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.boundaries.composite import cell
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics
from jdem.engine.neighbors import ContactList, Grid, rebuild
from jdem.laws.base import AbstractContactLaw
from jdem.packing.specimen import Specimen
from tests.support.hand_made_beds import RADIUS, spheres_of

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("cheaply_compiled")]

CLOUD = 60


def cloud(seed, jitter=0.0):
    rng = np.random.default_rng(seed)
    place = rng.uniform([-0.012, -0.012, 0.0], [0.012, 0.012, 0.03], (CLOUD, 3))
    return place + np.random.default_rng(seed + 1).normal(0.0, 1.0, place.shape) * jitter


def cloud_grid(**capacities):
    sizes = {"per_cell": 30, "pairs": 800, "wall_contacts": 120, **capacities}
    return Grid(shape=(4, 3, 5), cell=2 * RADIUS * 1.2 + 1e-3, skin=1e-3, **sizes)


CLOUD_SPHERES = spheres_of(CLOUD, 0.2)
CLOUD_WALLS = cell(0.03, 0.014, float)
relisted = eqx.filter_jit(rebuild)


class Keeper(AbstractContactLaw):
    """No force; remembers a number and an integer, so that any tree of arrays is tried."""

    def force(self, contact, history):
        raise NotImplementedError

    def longest_step(self, mass, radius):
        raise NotImplementedError

    def memory(self, shape, dtype):
        return {"mark": jnp.zeros(shape, dtype), "more": (jnp.zeros(shape, jnp.int32),)}


def empty_lists(grid):
    return [ContactList.empty(n, float, Keeper()) for n in (grid.pairs, grid.wall_contacts)]


def listed(grid, place, lists):
    return relisted(grid, CLOUD_SPHERES, CLOUD_WALLS, Vector.from_rows(jnp.asarray(place)), *lists)


def entries(contacts):
    """{(first, second): what the history remembers} of the live entries, each listed once."""
    live = np.flatnonzero(contacts.alive)
    history = contacts.history
    columns = (contacts.first, contacts.second, history["mark"], history["more"][0])
    rows = zip(*(np.asarray(column)[live].tolist() for column in columns), strict=True)
    found = {(i, j): (most, stretch) for i, j, most, stretch in rows}
    assert len(found) == len(live)
    return found


def pairs_by_force(place, reach):
    radius = np.asarray(CLOUD_SPHERES.radius)
    distance = np.linalg.norm(place[:, None] - place[None], axis=-1)
    near = distance < radius[:, None] + radius[None] + reach
    return {(i, j) for i in range(CLOUD) for j in range(i + 1, CLOUD) if near[i, j]}


def walls_by_force(place, reach):
    off_axis = np.hypot(place[:, 0], place[:, 1])
    distance = np.stack([place[:, 2], 0.03 - place[:, 2], 0.014 - off_axis], axis=1)
    near = distance - np.asarray(CLOUD_SPHERES.radius)[:, None] < reach
    return {(int(i), int(w)) for i, w in np.argwhere(near)}


def mark_of(first, second):
    return 1.0 + 1000 * first + second


def marked(contacts):
    """Each entry remembers its own key."""
    mark = mark_of(contacts.first, contacts.second) * contacts.alive
    history = {"mark": mark, "more": (-mark.astype(jnp.int32),)}
    return eqx.tree_at(lambda c: c.history, contacts, history)


@pytest.mark.parametrize("seed", range(5))
def test_lists_hold_all_neighbours_and_history_travels_with_them(seed):
    grid = cloud_grid()
    before, after = cloud(seed), cloud(seed, jitter=1e-3)
    lists = [marked(c) for c in listed(grid, before, empty_lists(grid))[:2]]
    relists = listed(grid, after, lists)
    for old, new, brute in zip(lists, relists, (pairs_by_force, walls_by_force), strict=False):
        were, are = entries(old), entries(new)
        assert set(were) == brute(before, grid.skin)
        assert set(are) == brute(after, grid.skin)
        kept = were.keys() & are.keys()
        assert 10 < len(kept) < len(are)
        for key, remembered in are.items():
            mark = mark_of(*key) if key in kept else 0.0
            assert remembered == (mark, -mark)


def test_a_sphere_may_leave_the_grid():
    """Space is wrapped around the grid: far away, and across zero, neighbours are the same."""
    grid, shift = cloud_grid(), np.array([3.7, -8.1, 40.0])
    found = listed(grid, cloud(0) + shift, empty_lists(grid))[0]
    assert set(entries(found)) == pairs_by_force(cloud(0), grid.skin)


@pytest.mark.parametrize("names", [("pairs", "wall_contacts"), ("per_cell",)])
def test_an_overflow_is_detected_with_the_capacity_that_would_do(names):
    small = cloud_grid(**dict.fromkeys(names, 3))
    demand = listed(small, cloud(0), empty_lists(small))[2]
    assert demand.exceeds(small)
    needed = {name: int(getattr(demand, name)) for name in names}
    for name, capacity in needed.items():
        assert capacity > 3
        assert demand.exceeds(cloud_grid(**{**needed, name: capacity - 1}))
    enough = cloud_grid(**needed)
    pairs, contacts, demand = listed(enough, cloud(0), empty_lists(enough))
    assert not demand.exceeds(enough)
    assert set(entries(pairs)) == pairs_by_force(cloud(0), enough.skin)
    assert set(entries(contacts)) == walls_by_force(cloud(0), enough.skin)


def test_an_overflowing_list_keeps_only_true_neighbours():
    small = cloud_grid(pairs=20)
    pairs = listed(small, cloud(0), empty_lists(small))[0]
    assert len(entries(pairs)) == 20
    assert set(entries(pairs)) <= pairs_by_force(cloud(0), small.skin)


def test_rebuilding_twice_changes_nothing():
    grid = cloud_grid()
    once = [marked(c) for c in listed(grid, cloud(3), empty_lists(grid))[:2]]
    again = listed(grid, cloud(3), once)[:2]
    for a, b in zip(jax.tree.leaves(once), jax.tree.leaves(list(again)), strict=True):
        assert np.array_equal(a, b)


def test_wide_keys_list_the_same_and_carry_history():
    """Lists of beds beyond 46 340 spheres, made here of a few."""
    grid = cloud_grid()
    sizes = (grid.pairs, grid.wall_contacts)
    wide = [ContactList.empty(n, float, Keeper(), 2**40) for n in sizes]
    found = []
    for lists in (empty_lists(grid), wide):
        before = [marked(c) for c in listed(grid, cloud(1), lists)[:2]]
        found.append((before, listed(grid, cloud(1, jitter=1e-3), before)[:2]))
    for narrow, broad in zip(*found, strict=True):
        for one, other in zip(narrow, broad, strict=True):
            assert (one.key.dtype, other.key.dtype) == (jnp.int32, jnp.int64)
            assert entries(one) == entries(other)


def test_fifty_thousand_spheres_are_told_apart():
    """37^3 spheres on a cubic lattice, all but touching: each has its neighbours along the axes."""
    side, pitch = 37, 2.01 * RADIUS
    place = np.stack(np.meshgrid(*3 * [np.arange(side)], indexing="ij"), -1).reshape(-1, 3)
    spheres, pairs = spheres_of(side**3), 3 * side**2 * (side - 1)
    skin = 0.1 * RADIUS
    grid = Grid((45, 45, 45), 9, pairs + 5, 2 * side**2 + 5, 2 * RADIUS + skin, skin)
    walls = cell(1.0, 1.0, float)
    bed = [ContactList.empty(n, float, Keeper(), side**6) for n in (grid.pairs, grid.wall_contacts)]
    at = Vector.from_rows(jnp.asarray(place * pitch + [0, 0, 1.01 * RADIUS]))
    found, base, demand = relisted(grid, spheres, walls, at, *bed)
    assert not demand.exceeds(grid)
    assert {first for first, _ in entries(base)} == set(np.flatnonzero(place[:, 2] == 0).tolist())
    listed_pairs = np.array(list(entries(found)))
    steps = place[listed_pairs[:, 1]] - place[listed_pairs[:, 0]]
    assert len(steps) == pairs
    assert np.all(np.abs(steps).sum(axis=1) == 1)


@pytest.mark.parametrize("height", [0.2, 0.1, 0.025, 0.0125])
def test_lists_have_room_for_a_layer_of_spheres_on_all_walls(height):
    """A sphere on each square of a diameter, on base, platen and mould; an oedometer's ring needed
    0.9 of them (2000 spheres, 200 kPa)."""
    specimen = Specimen(diameter=0.0635, height=height, count=2000)
    area = np.pi * specimen.diameter * (specimen.diameter / 2 + specimen.height)
    layer = area / (2 * specimen.mean_radius()) ** 2
    assert specimen.grid(Numerics()).wall_contacts > 0.95 * layer
