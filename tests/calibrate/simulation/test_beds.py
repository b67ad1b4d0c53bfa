"""Beds that ship with the package: all there, of this preparation, and like those that settle here.
Beds that grow to a porosity: reached for any number of spheres, even, at rest, or refused."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation import Campaign
from calibrate.simulation.executors import Here
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.store import SHIPPED, Archive
from jdem.packing.composite import prepare
from jdem.packing.growth import _clashing, _radii, _thrown
from jdem.packing.specimen import Specimen
from tests.support import shipped_beds
from tests.support.shipped_beds import WANTED, cylinder, name_of, seeds

pytestmark = pytest.mark.thorough

GROWN = Specimen(count=250, porosity=0.47)
COMMAND = "python -m tests.support.shipped_beds"


def test_every_bed_that_first_commands_need_is_there_and_no_other():
    wanted = {name_of(*bed) for bed in WANTED}
    assert {*SHIPPED.names()} == wanted, (
        f"beds have other names: `{COMMAND}`; --rekey if none has changed"
    )


@pytest.mark.parametrize(("soil", "preset", "seed"), WANTED)
def test_a_shipped_bed_fills_its_mould(soil, preset, seed):
    wanted, bed = cylinder(soil, preset), SHIPPED.packing(name_of(soil, preset, seed))
    assert bed is not None
    assert bed.spheres.count == wanted.count
    assert float(bed.bulk_density()) == pytest.approx(wanted.density, rel=1e-9)
    assert float(bed.height) == pytest.approx(wanted.height, rel=0.1)
    across = jnp.hypot(bed.position.x, bed.position.y) + bed.spheres.radius
    assert float(across.max()) < 1.01 * float(bed.mould_radius)


def test_beds_of_one_specimen_have_centres_of_their_own():
    found = [SHIPPED.packing(name_of("trumao", "quick", seed)) for seed in seeds("quick")]
    tops = [float(bed.position.z.max()) for bed in found if bed is not None]
    assert len(set(tops)) == len(seeds("quick"))


@pytest.mark.slow
def test_a_bed_that_settles_here_is_like_the_shipped_one():
    """Not the same bit for bit: on another processor round-off grows while spheres fall."""
    wanted = cylinder("wheat_after_rice", "quick")
    here, shipped = prepare(wanted, 0), SHIPPED.packing(name_of("wheat_after_rice", "quick", 0))
    assert shipped is not None
    assert np.array_equal(here.spheres.radius, shipped.spheres.radius)  # drawn, not settled
    assert float(here.height) == pytest.approx(float(shipped.height), rel=0.03)


class NeverSettles(Here):
    """A place at which no bed may be made."""

    def prepare(self, specimen, seed, soil):
        raise AssertionError("a bed was settled")


def test_a_campaign_takes_shipped_beds_and_keeps_them(tmp_path):
    lab = load_lab(bundled_lab())
    preset = PRESETS["quick"]
    work = Campaign(virtual_lab(lab, preset), specimen(lab, preset), tmp_path, place=NeverSettles())
    assert len(work.packings((0, 1, 2))) == 3
    assert len(list(tmp_path.glob("packings/*.npz"))) == 3
    with pytest.raises(AssertionError, match="a bed was settled"):
        work.packings((100,))


# ------------------------------------------------------------------ names after a change


@pytest.fixture
def renamed(tmp_path):
    """The shipped beds under names of another preparation."""
    store = Archive(tmp_path / "beds.zip")
    shipped = sorted(SHIPPED.content().items())
    store.keep({f"{number:032x}": data for number, (_, data) in enumerate(shipped)})
    return store


def settles(monkeypatch, factor):
    """Beds settle as they did, with all masses times a factor."""

    def again(wanted, seed):
        names = {cylinder(*bed[:2]): name_of(*bed) for bed in WANTED if bed[2] == seed}
        bed = SHIPPED.packing(names[wanted])
        return eqx.tree_at(lambda p: p.spheres.mass, bed, factor * bed.spheres.mass)

    monkeypatch.setattr(shipped_beds, "prepare", again)


def test_beds_get_their_names_back_if_they_settle_as_they_did(renamed, monkeypatch):
    settles(monkeypatch, 1.0)
    assert shipped_beds.rekey(renamed) == len(WANTED)
    assert renamed.content() == SHIPPED.content()
    assert shipped_beds.rekey(renamed) == 0


@pytest.mark.parametrize("factor", [np.nextafter(1.0, 2.0), float("nan")])
def test_no_bed_is_renamed_if_one_settles_differently(renamed, monkeypatch, factor):
    settles(monkeypatch, factor)
    before = renamed.content()
    with pytest.raises(ValueError, match="does not settle as it did"):
        shipped_beds.rekey(renamed)
    assert renamed.content() == before


def test_no_bed_is_renamed_if_one_is_missing_or_double(renamed, monkeypatch):
    settles(monkeypatch, 1.0)
    content = renamed.content()
    first = f"{5:032x}"
    for changed, said in (
        ({**content, "f" * 32: content[first]}, "2 entries with this bed"),
        ({name: data for name, data in content.items() if name != first}, "0 entries"),
    ):
        renamed.keep(changed)
        with pytest.raises(ValueError, match=said):
            shipped_beds.rekey(renamed)
        assert renamed.content() == changed


def test_a_damaged_bed_is_not_taken(renamed):
    content = renamed.content()
    name, data = next(iter(content.items()))
    spoilt = data[:100] + bytes([data[100] ^ 1]) + data[101:]
    renamed.keep({**content, name: spoilt})
    assert renamed.packing(name) is None and renamed.packing("nobody") is None
    renamed.path.write_bytes(b"no archive")
    assert renamed.packing(name) is None


# ---------------------------------------------------------------- beds that grow


@pytest.fixture(scope="module")
def grown():
    return prepare(GROWN, 0)


@pytest.mark.slow
def test_a_grown_bed_has_the_porosity_height_and_density_that_were_asked_for(grown):
    assert 1 - float(grown.solid_fraction()) == pytest.approx(GROWN.porosity, rel=0.01)
    assert float(grown.height) == pytest.approx(GROWN.height, rel=0.01)
    assert float(grown.bulk_density()) == pytest.approx(GROWN.density, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("porosity", [0.465, 0.49])
def test_denser_and_looser_grown_beds_are_reached(porosity):
    found = prepare(replace(GROWN, porosity=porosity), 1)
    assert 1 - float(found.solid_fraction()) == pytest.approx(porosity, rel=0.01)


@pytest.mark.slow
def test_a_grown_bed_lies_in_its_mould_and_its_spheres_hardly_overlap(grown):
    centres, radius = np.asarray(grown.position.stack()), np.asarray(grown.spheres.radius)
    outside = np.hypot(*centres.T[:2]) + radius - float(grown.mould_radius)
    assert outside.max() < 0.005 * radius.mean()
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) - radius[:, None] - radius
    np.fill_diagonal(gaps, 0.0)
    assert gaps.min() > -0.01 * radius.mean()


@pytest.mark.slow
def test_a_grown_bed_is_as_dense_below_as_above(grown):
    """A density that rose by the share s from top to bottom would shift the centre by s h/12."""
    volume, height = np.asarray(grown.spheres.radius) ** 3, np.asarray(grown.position.z)
    centre = float(np.sum(volume * height) / np.sum(volume)) / float(grown.height)
    assert 12 * abs(centre - 0.5) < 0.05


@pytest.mark.slow
def test_grown_beds_share_their_radii_and_nothing_else(grown):
    one, two = (_radii(GROWN, np.random.default_rng(seed)) for seed in (0, 1))
    assert np.array_equal(np.sort(one), np.sort(two)) and not np.array_equal(one, two)
    assert np.array_equal(one, grown.spheres.radius)
    solid = 4 / 3 * np.pi * np.sum(one**3) / (np.pi / 4 * GROWN.diameter**2 * GROWN.height)
    assert solid == pytest.approx(1 - GROWN.porosity, rel=1e-12)
    assert one.max() <= GROWN.max_radius()


def test_thrown_spheres_lie_apart_within_the_mould():
    rng = np.random.default_rng(3)
    radius = 0.5 * _radii(GROWN, rng)
    centres = _thrown(radius, 0.025, 0.1, rng)
    assert len(_clashing(centres, radius)) == 0
    assert np.all(np.hypot(*centres.T[:2]) + radius <= 0.025)
    assert np.all((centres[:, 2] >= radius) & (centres[:, 2] + radius <= 0.1))


@pytest.mark.slow
@pytest.mark.parametrize(("porosity", "repair"), [(0.33, "higher"), (0.62, "lower")])
def test_a_porosity_out_of_reach_is_one_sentence(porosity, repair):
    with pytest.raises(ValueError, match=f": ask for a {repair} one") as refusal:
        prepare(replace(GROWN, porosity=porosity), 0)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("porosity", [0.0, 1.0, -0.4, 43.0])
def test_what_is_no_porosity_is_refused_at_once(porosity):
    with pytest.raises(ValueError, match="give one between 0 and 1"):
        Specimen(porosity=porosity)


def test_the_usual_porosity_rises_with_the_size_of_spheres():
    found = [Specimen(count=n).at_usual_porosity().porosity for n in (150, 1000, 20000)]
    assert found[0] > found[1] > found[2] > 0.38
    assert jnp.isfinite(Specimen(count=1000).at_usual_porosity().mean_radius())


@pytest.mark.slow
def test_a_flat_bed_stands_also_where_the_platen_has_just_met_it():
    """Six layers of spheres: the platen's first touch moves a large share of them."""
    flat = Specimen(diameter=0.0618, height=0.02, count=2000).at_usual_porosity()
    bed = prepare(flat, 2)
    assert float(bed.height) == pytest.approx(flat.height, rel=0.01)
    assert 1 - float(bed.solid_fraction()) == pytest.approx(flat.porosity, abs=0.005)
