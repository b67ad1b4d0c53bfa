"""The beds that ship with the package: those of bundled soils that a first command needs.

    python -m tests.support.shipped_beds            makes all of them (ten minutes of a core)
    python -m tests.support.shipped_beds --rekey    gives those that are there their present names

Which beds: all that `simulate` and `fit` take with seed 0, at the preset quick, and at standard for
the soil that both take by default.  A bed's name is the hash of all that it depends on, of
`jdem.physics.PREPARATION` too.  Once that is raised none of them is found, beds settle as any
other's do, and tests/calibrate/simulation/test_beds.py asks for one of these commands.

The rule: `--rekey` is for a change of names that alters no number (a specimen that says more of
itself, another way to make the hash).  It settles one bed of each soil anew and renames
beds only where all of their numbers are equal bit for bit; otherwise it renames none, and the
beds have to be made again.  Round-off differs between kinds of processors, so where beds come
out differently before the change too, this is not the machine to tell.  A bed is told from the
others by its spheres, their radii being drawn with the seed, and by the bed's density.
"""

import argparse
import tempfile
from collections.abc import Iterable
from pathlib import Path

import jax
import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.core.runtime import configure
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation.keys import content_hash, packing_content
from calibrate.simulation.resolution import PRESETS, specimen
from calibrate.simulation.specimens import Seeds, campaign
from calibrate.simulation.store import SHIPPED, Archive
from jdem.packing.composite import prepare
from jdem.packing.growth import _radii
from jdem.packing.specimen import Packing, Specimen

OF_SOIL = {"wheat_after_rice": ("quick", "standard"), "trumao": ("quick",)}
Shipped = tuple[str, str, int]  # soil, preset, seed


def seeds(preset: str) -> tuple[int, ...]:
    """Seeds of the beds that ship at a preset."""
    known = PRESETS[preset]
    found = Seeds.of(0, known.packings, known.fresh)
    return tuple(sorted({*found.fitted, *found.fresh, *found.scatter}))


WANTED: tuple[Shipped, ...] = tuple(
    (soil, preset, seed)
    for soil, presets in OF_SOIL.items()
    for preset in presets
    for seed in seeds(preset)
)
TOLD_BY = tuple((soil, "quick", 0) for soil in OF_SOIL)  # beds that are settled anew: the smallest


def cylinder(soil: str, preset: str) -> Specimen:
    return specimen(load_lab(bundled_lab(soil)), PRESETS[preset])


def name_of(soil: str, preset: str, seed: int) -> str:
    """The name under which a campaign looks for a bed."""
    return content_hash(packing_content(cylinder(soil, preset), seed, None))


def make() -> None:
    """Settles all beds anew."""
    made = {}
    for soil, presets in OF_SOIL.items():
        for preset in presets:
            with tempfile.TemporaryDirectory() as folder:
                lab = load_lab(bundled_lab(soil))
                work = campaign(lab, PRESETS[preset], Path(folder), for_terminal())
                work.packings(seeds(preset))
                for path in Path(folder).glob("packings/*.npz"):
                    made[path.stem] = path.read_bytes()
    SHIPPED.keep(made)


def rekey(store: Archive = SHIPPED, told_by: Iterable[Shipped] = TOLD_BY) -> int:
    """Gives the beds of a store their present names; how many had another one.

    Raises ValueError, and renames nothing, where a bed is missing or settles differently.
    """
    names = {bed: _name_in(bed, store) for bed in WANTED}
    for bed in told_by:
        kept = store.packing(names[bed])
        if kept is None or not equal(kept, prepare(cylinder(*bed[:2]), bed[2])):
            raise ValueError(f"{bed} does not settle as it did: nothing is renamed; make the beds")
    content = store.content()
    renamed = {name_of(*bed): content[old] for bed, old in names.items()}
    store.keep(renamed)
    return len(renamed.keys() - content.keys())


def equal(one: Packing, other: Packing) -> bool:
    """Whether all numbers of two beds are the same, bit for bit."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)


def _name_in(bed: Shipped, store: Archive) -> str:
    """The name of the one entry that holds this bed."""
    wanted = cylinder(*bed[:2])
    found = [name for name in store.names() if _is(store.packing(name), wanted, bed[2])]
    if len(found) != 1:
        raise ValueError(f"{bed}: {len(found)} entries with this bed: nothing is renamed")
    return found[0]


def _is(packing: Packing | None, wanted: Specimen, seed: int) -> bool:
    """Whether a packing is the specimen's of this seed."""
    if packing is None or packing.spheres.count != wanted.count:
        return False
    alike = np.allclose(packing.spheres.radius, _drawn(wanted, seed), rtol=1e-12, atol=0)
    density = float(packing.bulk_density())
    return alike and bool(np.isclose(density, wanted.density, rtol=1e-9, atol=0))


def _drawn(wanted: Specimen, seed: int) -> np.ndarray:
    """Radii (n,), m, of the spheres of a bed that falls, or that grows."""
    rng = np.random.default_rng(seed)
    if wanted.porosity is not None:
        return _radii(wanted, rng)
    return wanted.mean_radius() * rng.uniform(1 - wanted.spread, 1 + wanted.spread, wanted.count)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rekey", action="store_true", help="rename beds that settle as before")
    chosen = parser.parse_args()
    configure()
    if chosen.rekey:
        print(f"{rekey()} of {len(WANTED)} beds renamed")
    else:
        make()
