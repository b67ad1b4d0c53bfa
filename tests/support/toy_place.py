"""A place that computes in microseconds, so that tests of campaigns test the campaign.

Packings are random points and runs are formulas of the soil and the packing.  Every run is
noted in a file, so that processes can be counted together; it may sleep, fail, or wait.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import AbstractPlace, Campaign, Run
from calibrate.simulation.executors import MachineFailure
from calibrate.simulation.run import QUALITY
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.packing.specimen import Packing, Specimen
from tests.support.formulas import two_tests

SPECIMEN = Specimen(height=0.05, count=48)
SOIL = base_soil(load_lab(bundled_lab()))


def soils(count: int):
    """Soils that differ in their surface energy."""
    return [with_values(SOIL, {"surface_energy": 10.0 + k}) for k in range(count)]


def formula(packing: Packing, soil) -> Run:
    """Numbers that depend on everything that a run depends on."""
    energy, scale = float(soil.surface_energy), float(jnp.sum(packing.position.x))
    points = np.linspace(0.0, 1.0, 20)
    curve = np.stack([points, scale * energy * points], axis=1)
    quality = {name: 1.0 for name in QUALITY} | {"overflow": 0.0}
    return two_tests(scale, energy, curve, 2 * curve, quality)


@dataclass(frozen=True)
class Toy(AbstractPlace):
    """`notes` gets a line for each run begun; `fails` runs of it end in a machine's failure."""

    notes: Path
    seconds: float = 0.0
    fails: int = 0

    def slots(self, workers):
        return workers

    def warm_up(self, lab, packing, soil, say):
        pass

    def simulate(self, lab, specimen, packing, soil):
        self.note(f"{os.getpid()} {float(soil.surface_energy):g} {float(packing.height):g}")
        time.sleep(self.seconds)
        if len(self.noted()) <= self.fails:
            raise MachineFailure("out of memory")
        return formula(packing, soil)

    def prepare(self, specimen, seed, soil):
        rng = np.random.default_rng(seed)
        x, y, z = (jnp.asarray(row) for row in rng.uniform(size=(3, specimen.count)))
        ones = jnp.ones(specimen.count)
        return Packing(Vector(x, y, z), Spheres(ones, ones), 1.0 + seed, 1.0)

    def note(self, line: str) -> None:
        with self.notes.open("a", encoding="utf-8") as file:
            file.write(line + "\n")

    def noted(self) -> list[str]:
        return self.notes.read_text(encoding="utf-8").splitlines() if self.notes.exists() else []


def toy_campaign(folder: Path, **choices) -> Campaign:
    """A campaign in `folder`/cache with its notes in `folder`/notes."""
    lab = VirtualLab.of(
        SPECIMEN, TestSequence((ConfinedCompression(), UnconfinedCompression())), Numerics()
    )
    place = Toy(folder / "notes", **choices)
    return Campaign(lab, SPECIMEN, folder / "cache", workers=2, place=place)
