"""Beds that ship with the package: all there, of this engine, and like those that settle here."""

import jax.numpy as jnp
import numpy as np
import pytest
from support import shipped_beds

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation import Campaign
from calibrate.simulation.executors import Here
from calibrate.simulation.keys import content_hash, packing_content
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from calibrate.simulation.store import SHIPPED
from jdem.packing.settling import prepare

WANTED = [
    (soil, preset, seed)
    for soil in shipped_beds.SOILS
    for preset in ("quick", "standard")
    for seed in shipped_beds.seeds(preset)
]


def cylinder(soil: str, preset: str):
    return specimen(load_lab(bundled_lab(soil)), PRESETS[preset])


def name_of(soil: str, preset: str, seed: int) -> str:
    return content_hash(packing_content(cylinder(soil, preset), seed, None))


def test_every_bed_that_first_commands_need_is_there_and_no_other():
    there = {path.stem for path in SHIPPED.folder.glob("packings/*.npz")}
    wanted = {name_of(*bed) for bed in WANTED}
    assert there == wanted, "the engine or a soil has changed: run `python benchmarks/beds.py`"


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
    seeds = shipped_beds.seeds("quick")
    found = [SHIPPED.packing(name_of("trumao", "quick", seed)) for seed in seeds]
    tops = [float(bed.position.z.max()) for bed in found if bed is not None]
    assert len(set(tops)) == len(seeds)


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
