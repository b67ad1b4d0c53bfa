"""The settled beds that ship with the package: those of bundled soils that a first command needs.

    python -m tests.support.shipped_beds            makes all of them (three minutes)
    python -m tests.support.shipped_beds --rekey    gives those that are there their present names

Which beds: all that `simulate` and `fit` take with seed 0 at the preset quick; beds of the finer
presets grow in seconds.  A bed's name is the hash of all that it depends on, of
`jdem.physics.PREPARATION` too.  Once that is raised none of them is found, beds settle as any
other's do, and tests/calibrate/simulation/test_beds.py asks for one of these commands.

The rule: `--rekey` is for a change of names that alters no number (a specimen that says more of
itself, another way to make the hash).  It settles one bed of each soil anew and renames the
files only where all of their numbers are equal bit for bit; otherwise it renames none, and the
beds have to be made again.  Round-off differs between kinds of processors, so where beds come
out differently before the change too, this is not the machine to tell.  A file is told from the
others by its spheres, their radii being drawn with the seed, and by the bed's density.
"""

import argparse
import shutil
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
from calibrate.simulation.store import SHIPPED, Store
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing, Specimen

SOILS = ("wheat_after_rice", "trumao")
Shipped = tuple[str, str, int]  # soil, preset, seed


def seeds(preset: str) -> tuple[int, ...]:
    """Seeds of the beds that ship at a preset."""
    return Seeds.of(0, PRESETS[preset].packings).scatter


WANTED: tuple[Shipped, ...] = tuple(
    (soil, preset, seed) for soil in SOILS for preset in ("quick",) for seed in seeds(preset)
)
TOLD_BY = tuple((soil, "quick", 0) for soil in SOILS)  # beds that are settled anew: the smallest


def cylinder(soil: str, preset: str) -> Specimen:
    return specimen(load_lab(bundled_lab(soil)), PRESETS[preset])


def name_of(soil: str, preset: str, seed: int) -> str:
    """The name under which a campaign looks for a bed."""
    return content_hash(packing_content(cylinder(soil, preset), seed, None))


def make() -> None:
    """Settles all beds anew."""
    shutil.rmtree(SHIPPED.folder, ignore_errors=True)
    for soil in SOILS:
        for preset in ("quick",):
            lab = load_lab(bundled_lab(soil))
            work = campaign(lab, PRESETS[preset], SHIPPED.folder, for_terminal())
            work.packings(seeds(preset))
    shutil.rmtree(SHIPPED.folder / "claims", ignore_errors=True)


def rekey(store: Store = SHIPPED, told_by: Iterable[Shipped] = TOLD_BY) -> int:
    """Renames the beds of a store to their present names; how many had another one.

    Raises ValueError, and renames nothing, where a bed is missing or settles differently.
    """
    paths = {bed: _file_of(bed, store) for bed in WANTED}
    for bed in told_by:
        kept = store.packing(paths[bed].stem)
        if kept is None or not equal(kept, prepare(cylinder(*bed[:2]), bed[2])):
            raise ValueError(f"{bed} does not settle as it did: nothing is renamed; make the beds")
    moves = {path: store.packing_path(name_of(*bed)) for bed, path in paths.items()}
    moves = {old: new for old, new in moves.items() if old != new}
    waiting = {old: old.rename(old.with_suffix(".renamed")) for old in moves}
    for old, new in moves.items():
        waiting[old].rename(new)
    return len(moves)


def equal(one: Packing, other: Packing) -> bool:
    """Whether all numbers of two beds are the same, bit for bit."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)


def _file_of(bed: Shipped, store: Store) -> Path:
    """The one file with this bed, whatever its name."""
    wanted = cylinder(*bed[:2])
    paths = sorted(store.folder.glob("packings/*.npz"))
    found = [path for path in paths if _is(store.packing(path.stem), wanted, bed[2])]
    if len(found) != 1:
        raise ValueError(f"{bed}: {len(found)} files with this bed: nothing is renamed")
    return found[0]


def _is(packing: Packing | None, wanted: Specimen, seed: int) -> bool:
    """Whether a packing is the specimen's of this seed."""
    if packing is None or packing.spheres.count != wanted.count:
        return False
    draw = np.random.default_rng(seed).uniform(1 - wanted.spread, 1 + wanted.spread, wanted.count)
    alike = np.allclose(packing.spheres.radius, wanted.mean_radius() * draw, rtol=1e-12, atol=0)
    density = float(packing.bulk_density())
    return alike and bool(np.isclose(density, wanted.density, rtol=1e-9, atol=0))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rekey", action="store_true", help="rename beds that settle as before")
    chosen = parser.parse_args()
    configure()
    if chosen.rekey:
        print(f"{rekey()} of {len(WANTED)} beds renamed")
    else:
        make()
