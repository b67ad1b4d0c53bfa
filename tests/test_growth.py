"""Beds that grow to a porosity: reached for any number of spheres, even, at rest, or refused."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from jdem.packing.composite import prepare
from jdem.packing.growth import _clashing, _radii, _thrown
from jdem.packing.specimen import Specimen

WANTED = Specimen(count=250, porosity=0.47)


@pytest.fixture(scope="module")
def bed():
    return prepare(WANTED, 0)


def test_it_has_the_porosity_height_and_density_that_were_asked_for(bed):
    assert 1 - float(bed.solid_fraction()) == pytest.approx(WANTED.porosity, rel=0.01)
    assert float(bed.height) == pytest.approx(WANTED.height, rel=0.01)
    assert float(bed.bulk_density()) == pytest.approx(WANTED.density, rel=1e-9)


@pytest.mark.parametrize("porosity", [0.465, 0.49])
def test_denser_and_looser_beds_are_reached(porosity):
    found = prepare(replace(WANTED, porosity=porosity), 1)
    assert 1 - float(found.solid_fraction()) == pytest.approx(porosity, rel=0.01)


def test_it_lies_in_its_mould_and_its_spheres_hardly_overlap(bed):
    centres, radius = np.asarray(bed.position.stack()), np.asarray(bed.spheres.radius)
    outside = np.hypot(*centres.T[:2]) + radius - float(bed.mould_radius)
    assert outside.max() < 0.005 * radius.mean()
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) - radius[:, None] - radius
    np.fill_diagonal(gaps, 0.0)
    assert gaps.min() > -0.01 * radius.mean()


def test_it_is_as_dense_below_as_above(bed):
    """A density that rose by the share s from top to bottom would shift the centre by s h/12."""
    volume, height = np.asarray(bed.spheres.radius) ** 3, np.asarray(bed.position.z)
    centre = float(np.sum(volume * height) / np.sum(volume)) / float(bed.height)
    assert 12 * abs(centre - 0.5) < 0.05


def test_seeds_share_their_radii_and_nothing_else(bed):
    one, two = (_radii(WANTED, np.random.default_rng(seed)) for seed in (0, 1))
    assert np.array_equal(np.sort(one), np.sort(two)) and not np.array_equal(one, two)
    assert np.array_equal(one, bed.spheres.radius)
    solid = 4 / 3 * np.pi * np.sum(one**3) / (np.pi / 4 * WANTED.diameter**2 * WANTED.height)
    assert solid == pytest.approx(1 - WANTED.porosity, rel=1e-12)
    assert one.max() <= WANTED.max_radius()


def test_thrown_spheres_lie_apart_within_the_mould():
    rng = np.random.default_rng(3)
    radius = 0.5 * _radii(WANTED, rng)
    centres = _thrown(radius, 0.025, 0.1, rng)
    assert len(_clashing(centres, radius)) == 0
    assert np.all(np.hypot(*centres.T[:2]) + radius <= 0.025)
    assert np.all((centres[:, 2] >= radius) & (centres[:, 2] + radius <= 0.1))


@pytest.mark.parametrize(("porosity", "repair"), [(0.33, "higher"), (0.62, "lower")])
def test_a_porosity_out_of_reach_is_one_sentence(porosity, repair):
    with pytest.raises(ValueError, match=f": ask for a {repair} one") as refusal:
        prepare(replace(WANTED, porosity=porosity), 0)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("porosity", [0.0, 1.0, -0.4, 43.0])
def test_what_is_no_porosity_is_refused_at_once(porosity):
    with pytest.raises(ValueError, match="give one between 0 and 1"):
        Specimen(porosity=porosity)


def test_the_usual_porosity_rises_with_the_size_of_spheres():
    found = [Specimen(count=n).at_usual_porosity().porosity for n in (150, 1000, 20000)]
    assert found[0] > found[1] > found[2] > 0.38
    assert jnp.isfinite(Specimen(count=1000).at_usual_porosity().mean_radius())
