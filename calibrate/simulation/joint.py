"""Tests on several specimens as one: every specimen is a campaign, and their runs are joined.

A soil that is tested on two specimens, one for each test, is simulated on two packings of the same
seed; what both give is one run, and what the machine gives without soil joins it.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from calibrate.core.progress import AbstractProgress
from calibrate.labtests.composite import names_observed
from calibrate.simulation.campaign import Campaign
from calibrate.simulation.run import QUALITY, Run, Runs, Soils, points_of
from jdem.apparatus.base import AbstractApparatus
from jdem.laboratory.bare_machine import BareMachine

# How the checks of several runs become one; the largest counts of those that are not named.
COMBINED = {name: np.sum for name in ("steps", "runtime_s", "repeats", "platen_work_j")}
COMBINED |= dict.fromkeys(("spheres_across", "tool_across", "time_step_s"), np.min)


class AbstractCampaign(Protocol):
    """What simulates soils on packings: one specimen's campaign, or several specimens' together."""

    @property
    def folder(self) -> Path: ...

    @property
    def progress(self) -> AbstractProgress: ...

    @property
    def simulated(self) -> int:
        """Runs that were not in the cache and were simulated."""
        ...

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        """All tests, in order."""
        ...

    def runs(self, soils: Soils, seeds: Sequence[int], what: str) -> Runs:
        """Every soil on every packing: a list (soils) of lists (seeds) of `Run`."""
        ...

    def each(self, soils: Sequence[Soils], seeds: Sequence[int], what: str) -> Runs:
        """Rows of soils, one for each packing: a list of lists (seeds) of `Run`."""
        ...


@dataclass(eq=False)
class BareCampaign:
    """What a bare machine records, asked for as of any soil; `folder` is where others' runs are.

    No soil and no packing changes it, so one run serves all and none is kept on disk.
    """

    machine: BareMachine
    folder: Path
    progress: AbstractProgress
    simulated: int = 0  # none: nothing is simulated in time

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        return self.machine.tests.apparatus

    def runs(self, soils: Soils, seeds: Sequence[int], what: str) -> Runs:
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(self, soils: Sequence[Soils], seeds: Sequence[int], what: str) -> Runs:
        return [[self._run] * len(row) for row in soils]

    @cached_property
    def _run(self) -> Run:
        begun = time.perf_counter()
        found = self.machine.run()
        observables = {
            name: factor * float(found[test].observables[source])
            for (test, source), (name, factor) in names_observed(self.apparatus).items()
        }
        curves = {name: points_of(reading.curve) for name, reading in found.items()}
        nothing = {"overflow": 0.0, "steps": 0.0, "spheres": 0.0, "repeats": 0.0}
        quality = {name: np.nan for name in QUALITY} | nothing
        return Run(observables, curves, quality | {"runtime_s": time.perf_counter() - begun})


@dataclass(frozen=True)
class JointCampaign:
    """Campaigns of specimens, and of the machine without soil: at least one, in one folder."""

    parts: tuple[Campaign, ...]
    bare: BareCampaign | None = None

    @property
    def all(self) -> tuple[AbstractCampaign, ...]:
        """Those of the specimens, then that without soil."""
        return (*self.parts, *((self.bare,) if self.bare else ()))

    @property
    def folder(self) -> Path:
        return self.all[0].folder

    @property
    def progress(self) -> AbstractProgress:
        return self.all[0].progress

    @property
    def simulated(self) -> int:
        return sum(part.simulated for part in self.parts)

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        return tuple(test for part in self.all for test in part.apparatus)

    def runs(self, soils: Soils, seeds: Sequence[int], what: str) -> Runs:
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(self, soils: Sequence[Soils], seeds: Sequence[int], what: str) -> Runs:
        """A specimen whose runs fail does not keep the others from being simulated."""
        rows = []
        for number, part in enumerate(self.all, 1):
            which = f"{what}, specimen {number} of {len(self.parts)}"
            rows.append(part.each(soils, seeds, which if len(self.parts) > 1 else what))
        return [
            [self._joined(together) for together in zip(*row, strict=True)]
            for row in zip(*rows, strict=True)
        ]

    def _joined(self, together: Sequence[Run]) -> Run:
        """The runs of one soil on all specimens as one."""
        called = names_observed(self.apparatus)
        observables, curves, channels = {}, {}, {}
        for part, run in zip(self.all, together, strict=True):
            for which, (name, _) in names_observed(part.apparatus).items():
                observables[called[which][0]] = run.observables[name]
            curves |= run.curves
            channels |= run.channels
        failures = [run.failure for run in together if run.failure]
        return Run(observables, curves, _worst(together), "; ".join(failures), channels)


def _worst(together: Sequence[Run]) -> dict[str, float]:
    """The checks of several runs as those of one."""
    found = {}
    for name in together[0].quality:
        values = np.array([run.quality[name] for run in together])
        known = values[np.isfinite(values)]
        combined = COMBINED.get(name, np.max)
        found[name] = float(combined(known)) if known.size else float("nan")
    return found
