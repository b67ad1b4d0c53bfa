"""Runs of the machine without soil, as a campaign beside those of the specimens.

No soil and no packing changes them, so one run serves all and none is kept on disk.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from calibrate.core.progress import AbstractProgress
from calibrate.labtests.composite import names
from calibrate.simulation.run import QUALITY, Run, points_of
from jdem.apparatus.base import AbstractApparatus
from jdem.laboratory.bare_machine import BareMachine
from jdem.materials.soil import SoilParameters


@dataclass(eq=False)
class BareCampaign:
    """What a bare machine records, asked for as of any soil; `folder` is where others' runs are."""

    machine: BareMachine
    folder: Path
    progress: AbstractProgress
    simulated: int = 0  # none: nothing is simulated in time

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        """The tests, in order."""
        return self.machine.tests.apparatus

    def runs(
        self, soils: Sequence[SoilParameters], seeds: Sequence[int], what: str
    ) -> list[list[Run]]:
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(
        self, soils: Sequence[Sequence[SoilParameters]], seeds: Sequence[int], what: str
    ) -> list[list[Run]]:
        return [[self._run] * len(row) for row in soils]

    @cached_property
    def _run(self) -> Run:
        begun = time.perf_counter()
        found = self.machine.run()
        called = names(
            (test.name, source) for test in self.apparatus for source in test.observables
        )
        observables = {
            name: factor * float(found[test].observables[source])
            for (test, source), (name, factor) in called.items()
        }
        curves = {name: points_of(reading.curve) for name, reading in found.items()}
        nothing = {"overflow": 0.0, "steps": 0.0, "spheres": 0.0, "repeats": 0.0}
        quality = {name: np.nan for name in QUALITY} | nothing
        return Run(observables, curves, quality | {"runtime_s": time.perf_counter() - begun})
