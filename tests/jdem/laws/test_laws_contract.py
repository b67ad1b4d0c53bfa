"""What every normal law of the catalogue owes, whatever it is: the contract of `jdem.laws.base`.

Each law is tried with soils at both ends of where fits look for each of its own parameters.  What
is particular to EEPA is in test_laws.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jdem.apparatus.pair import collide, overlap_path
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.materials.catalogue import LAWS, soil_with
from tests.support.law_cases import (
    MOST,
    PAIR,
    POINTS,
    RADIUS,
    contact_at,
    drive,
    law_of,
    row_of,
    stacked,
)

pytestmark = [pytest.mark.thorough, pytest.mark.usefixtures("cheaply_compiled")]

SMOOTHINGS = {"sharp": Smoothing.sharp(), "default": Smoothing()}
every_law = pytest.mark.parametrize("name", LAWS)
every_smoothing = pytest.mark.parametrize("smoothing", SMOOTHINGS.values(), ids=SMOOTHINGS)


@cache
def corner_soils(name):
    """One soil in the middle, and one at either end of each of the law's own parameters."""
    fitted = [entry for entry in LAWS[name].parameters if entry.search is not None]
    ends = [{e.name: end} for e in fitted for end in (e.search.low, e.search.high)]
    given = {"reference_diameter": 2 * RADIUS}
    return [soil_with(name, **given), *(soil_with(name, **given, **end) for end in ends)]


def path():
    """Zero, loading, unloading in part and whole, reload, separation, loading again."""
    loading = [-1e-6, 0.0, 1e-16, 1e-9, 0.31 * MOST, 0.57 * MOST, MOST]
    turning = [0.93 * MOST, 0.61 * MOST, 0.23 * MOST, 0.11 * MOST, 0.43 * MOST, 0.17 * MOST]
    ending = [1.2 * MOST, 0.5 * MOST, 1e-9, 1e-16, 0.0, 0.0, -1e-6, 0.2 * MOST]
    return jnp.asarray([*loading, *turning, *ending])


def forces_along(soil, smoothing, overlaps):
    """Rows of force parts, and every number of the memory, along a path with steady slip."""
    law = law_of(soil, smoothing)

    def advance(history, overlap):
        force, history = law.force(contact_at(overlap), history)
        leaves = jax.tree.leaves(history)
        return history, (row_of(force), jnp.stack([jnp.asarray(x, float) for x in leaves]))

    return jax.lax.scan(advance, law.memory((), overlaps.dtype), overlaps)[1]


@eqx.filter_jit
def rows(soils, smoothing, overlaps):
    return jax.vmap(forces_along, (0, None, None))(soils, smoothing, overlaps)


@eqx.filter_jit
def slopes(soils, smoothing, overlaps):
    """Of every row: by the soil's numbers, and by every overlap before."""

    def one(soil):
        by = jax.jacfwd(lambda s, d: forces_along(s, smoothing, d)[0], (0, 1))
        return by(soil, overlaps)

    return jax.vmap(one)(soils)


@every_law
@every_smoothing
def test_no_force_without_overlap(name, smoothing):
    apart = jnp.asarray([1e-5, MOST, 0.5 * MOST, 0.0, *-np.geomspace(1e-12, 1.0, 17)])
    forces, _ = rows(stacked(corner_soils(name)), smoothing, apart)
    assert not np.any(forces[:, 3:])
    assert np.all(np.abs(forces[:, 1, 0]) > 0)


@pytest.mark.slow
@every_law
@every_smoothing
def test_values_and_gradients_are_finite_through_every_kink(name, smoothing):
    soils = stacked(corner_soils(name))
    by_soil, by_overlap = slopes(soils, smoothing, path())
    for leaf in jax.tree.leaves((rows(soils, smoothing, path()), by_soil, by_overlap)):
        assert np.isfinite(leaf).all()
    for entry in LAWS[name].parameters:
        if entry.search is not None:  # each is felt somewhere on the path
            values = by_soil.further if entry.name in by_soil.further else vars(by_soil)
            assert np.any(values[entry.name]), entry.name


@every_law
@every_smoothing
def test_tangents_equal_central_differences_away_from_kinks(name, smoothing):
    """By the overlap at the end of a path, in each of its legs; steps far below their distance
    from a kink.  Points without contact come first: all paths have as many as `path`."""
    soils, step = stacked(corner_soils(name)), 1e-5 * MOST
    for turns in ([0.37], [1.0, 0.91], [1.0, 0.83, 0.95], [0.7, 0.52, 1.3]):
        apart = [-1.0] * (len(path()) - len(turns))
        places = jnp.asarray([*apart, *turns]) * MOST

        def last(change, places=places):
            return rows(soils, smoothing, places.at[-1].add(change))[0][:, -1, 0]

        slope = slopes(soils, smoothing, places)[1][:, -1, 0, -1]
        difference = (last(step) - last(-step)) / (2 * step)
        scale = np.abs(np.asarray(difference)).max()
        np.testing.assert_allclose(slope, difference, rtol=1e-4, atol=1e-4 * scale)


bounce = eqx.filter_jit(collide)


@every_law
@every_smoothing
@settings(max_examples=30, deadline=None)
@given(
    turns=st.lists(st.floats(-0.1 * MOST, MOST), min_size=6, max_size=6), corner=st.integers(0, 99)
)
def test_no_energy_is_gained_over_a_closed_cycle_of_overlap(name, smoothing, turns, corner):
    soils = corner_soils(name)
    law = law_of(soils[corner % len(soils)], smoothing)
    overlaps = overlap_path(jnp.asarray([*turns, 0.0]), POINTS)
    force = np.concatenate([[0.0], drive(law, overlaps)])
    change = np.diff(np.concatenate([[0.0], overlaps]))
    work = -np.sum(0.5 * (force[1:] + force[:-1]) * change)
    assert work <= 0.5 * np.sum(np.abs(np.diff(force)) * np.abs(change))


@every_law
def test_separation_makes_a_new_contact(name):
    law = law_of(corner_soils(name)[0])
    fresh = drive(law, overlap_path([0.5 * MOST], POINTS))
    again = drive(law, overlap_path([MOST, -0.01 * MOST, 0.0, 0.5 * MOST], POINTS))
    np.testing.assert_allclose(again[-POINTS:], fresh, rtol=1e-12)


@every_law
def test_a_collision_rebounds_no_faster_than_it_came(name):
    for soil in corner_soils(name):
        law = law_of(soil)
        longest = law.longest_step(PAIR.effective_mass(), PAIR.effective_radius())
        step = jnp.asarray(0.02 * float(longest))
        assert abs(float(bounce(law, PAIR, 0.5, step, 4000))) <= 1.0  # about 0 where they stick


@every_law
def test_the_stiffness_bound_holds_up_to_one_per_cent_of_the_radius(name):
    for soil in corner_soils(name):
        law = law_of(soil, Smoothing.sharp())
        most = 0.01 * float(PAIR.effective_radius())
        overlaps = overlap_path(jnp.asarray([most, 0.8 * most]), POINTS)
        slope = np.abs(np.diff(drive(law, overlaps)) / np.diff(overlaps)).max()
        assert slope <= 1.0001 * float(law.normal.stiffness_bound(PAIR.effective_radius()))


@every_law
@every_smoothing
def test_float32_agrees_with_float64(name, smoothing):
    """On legs that end off the kinks: 300 roundings of the largest force, as for EEPA."""
    soils = stacked(corner_soils(name))
    overlaps = overlap_path(jnp.asarray([MOST, 0.9 * MOST, 0.97 * MOST, 1.1 * MOST]), POINTS)
    wide = np.asarray(rows(soils, smoothing, overlaps)[0])
    narrow = np.asarray(rows(*cast((soils, smoothing, overlaps), jnp.float32))[0])
    largest = np.abs(wide).max(axis=(0, 1))
    used = largest > 0
    error = np.abs(narrow - wide).max(axis=(0, 1))[used] / largest[used]
    assert (error < 300 * np.finfo(np.float32).eps).all(), error
