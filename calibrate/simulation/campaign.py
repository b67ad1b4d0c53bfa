"""From soils and seeds to runs: what is on disk is read, what is missing is simulated.

A run is one soil on one packing.  Its key is the hash of everything that its result depends
on.  Results are written the moment they exist, so a killed campaign repeats nothing and ends
with the same numbers; two processes on one folder share the work.  A run that the machine
could not finish is tried again, and at last a labelled row like any other failure.
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from calibrate.core.errors import CalibrationError, one_line
from calibrate.core.progress import AbstractProgress, Silent
from calibrate.io.soil import soil_at
from calibrate.simulation.compiled import blank
from calibrate.simulation.executors import AbstractPlace, Here, MachineFailure, cores
from calibrate.simulation.keys import content_hash, packing_content, run_content
from calibrate.simulation.run import Run, Runs, Soils, completed, not_simulated
from calibrate.simulation.store import SHIPPED, Store
from jdem.apparatus.base import AbstractApparatus
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing, Specimen

TRIES = 3  # of a run that the machine does not finish

Task = tuple[str, SoilParameters, Packing]
Made = TypeVar("Made")


@dataclass(eq=False)
class Campaign:
    """Runs soils on the packings of one specimen in one virtual laboratory, as an
    `AbstractCampaign` (`calibrate.simulation.joint`) does.

    `folder` holds packings/ and runs/; `workers` threads share one compiled program, or hand
    their work to another `place`.
    """

    lab: VirtualLab
    specimen: Specimen
    folder: Path
    progress: AbstractProgress = field(default_factory=Silent)
    workers: int = field(default_factory=lambda: cores())
    preparation: SoilParameters | None = None  # soil that beds settle with; None: neutral
    moisture: float | None = None  # of the specimen, where parameters differ with it
    simulated: int = 0  # runs that were not in the cache and were simulated for this campaign
    place: AbstractPlace = field(default_factory=Here)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def apparatus(self) -> tuple[AbstractApparatus, ...]:
        return self.lab.tests.apparatus

    def packings(self, seeds: Sequence[int]) -> list[Packing]:
        """The specimen's packings of these seeds, prepared if they are not on disk yet."""
        stored = {seed: self._stored_packing(seed) for seed in seeds}
        found = {seed: packing for seed, packing in stored.items() if packing is not None}
        missing = [seed for seed in stored if seed not in found]
        if missing:
            self._prepare(missing[0], patient=True)  # compiles for all of them
            self._shared("preparing packings", self._prepare, missing[1:])
        found |= {seed: self._prepared(seed) for seed in missing}
        return [found[seed] for seed in seeds]

    def runs(self, soils: Soils, seeds: Sequence[int], what: str) -> Runs:
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(self, soils: Sequence[Soils], seeds: Sequence[int], what: str) -> Runs:
        soils = [[soil_at(soil, self.moisture) for soil in row] for row in soils]
        packings = dict(zip(seeds, self._packings_while_compiling(soils, seeds), strict=True))
        keyed = [
            [
                (self.key(soil, seed), soil, packings[seed])
                for soil, seed in zip(row, seeds, strict=True)
            ]
            for row in soils
        ]
        unique = {task[0]: task for row in keyed for task in row}
        found = {key: self.store.run(key) for key in unique}
        tasks = [task for key, task in unique.items() if found[key] is None]
        found.update(self._simulated(tasks, what))
        return [
            [completed(run, packing) for key, _, packing in row if (run := found[key])]
            for row in keyed
        ]

    def key(self, soil: SoilParameters, seed: int) -> str:
        """Hash of everything that the run of `soil` on packing `seed` depends on."""
        own = soil_at(soil, self.moisture)
        return content_hash({**run_content(self.lab, own), **self._packing_content(seed)})

    # ---- simulating

    def _simulated(self, tasks: Sequence[Task], what: str) -> dict[str, Run]:
        """Runs of all tasks by key."""
        if not tasks:
            return {}
        self.store.sweep()
        damaged = sum(self.store.run_path(key).exists() for key, _, _ in tasks)
        if damaged:
            self.progress.say(f"{damaged} damaged entries of the cache are simulated again")
        for _, soil, packing in tasks:
            self.place.warm_up(self.lab, packing, soil, self.progress.say)
        return dict(self._shared(what, self._simulate, tasks))

    def _simulate(self, task: Task, patient: bool) -> tuple[str, Run] | None:
        """One run, simulated or found; None if another process has it in hand."""
        key, soil, packing = task
        with self.store.claim(key, patient) as ours:
            if not ours:
                return None
            run = self.store.run(key)
            return key, self._new(key, soil, packing) if run is None else run

    def _new(self, key: str, soil: SoilParameters, packing: Packing) -> Run:
        """A run, simulated and kept; where the machine gives up, a labelled row that is not."""
        try:
            run = self._tried(lambda: self.place.simulate(self.lab, self.specimen, packing, soil))
        except MachineFailure as failure:
            reason = f"not simulated, tried {TRIES} times: {one_line(str(failure))}"
            return not_simulated(self.lab, reason)
        self.store.keep_run(key, run)
        with self._lock:
            self.simulated += 1
        return run

    def _tried(self, attempt: Callable[[], Made]) -> Made:
        for number in range(1, TRIES):
            try:
                return attempt()
            except MachineFailure as failure:
                self.progress.say(f"trying again ({number} of {TRIES - 1}): {failure}")
        return attempt()

    # ---- packings

    def _packings_while_compiling(self, soils, seeds: Sequence[int]) -> list[Packing]:
        """The packings; where some must be prepared, the simulation is compiled meanwhile."""
        if all(self._packing_path(seed).exists() for seed in seeds) or not len(soils):
            return self.packings(seeds)
        with ThreadPoolExecutor(1) as pool:
            warm_up, bed = self.place.warm_up, blank(self.specimen)
            compiled = pool.submit(warm_up, self.lab, bed, soils[0][0], self.progress.say)
            packings = self.packings(seeds)
            compiled.result()
        return packings

    def _prepare(self, seed: int, patient: bool) -> int | None:
        """The seed, once its packing is on disk; None if another process has it in hand."""
        name = self._packing_name(seed)
        with self.store.claim(name, patient) as ours:
            if not ours:
                return None
            if self.store.packing(name) is None:
                self.store.keep_packing(name, self._settled(seed))
            return seed

    def _settled(self, seed: int) -> Packing:
        """The bed that ships with the package, or one that settles now."""
        shipped = SHIPPED.packing(self._packing_name(seed))
        if shipped is not None:
            return shipped
        specimen, soil = self.specimen, self.preparation
        try:
            return self._tried(lambda: self.place.prepare(specimen, seed, soil))
        except (MachineFailure, ValueError) as error:
            raise CalibrationError(f"packing {seed}: {one_line(str(error))}") from None

    def _prepared(self, seed: int) -> Packing:
        packing = self._stored_packing(seed)
        if packing is None:
            raise CalibrationError(f"{self._packing_path(seed)}: cannot be read back")
        return packing

    # ---- sharing work

    def _shared(self, what: str, function: Callable, tasks: Sequence) -> list:
        """Results of function(task, patient): ours first, then those that others had begun."""
        results, taken = self._in_parallel(what, function, tasks, patient=False)
        if taken:
            self.progress.say(f"{what}: waiting for {len(taken)} that another process began")
            results += self._in_parallel(what, function, taken, patient=True)[0]
        return results

    def _in_parallel(
        self, what: str, function: Callable, tasks: Sequence, patient: bool
    ) -> tuple[list, list]:
        """Results in the order in which they come, and tasks that gave None."""
        results, taken = [], []
        if not tasks:
            return results, taken
        self.progress.start(what, len(tasks))
        pool = ThreadPoolExecutor(min(len(tasks), self.place.slots(self.workers)))
        try:
            futures = {pool.submit(function, task, patient): task for task in tasks}
            for future in as_completed(futures):
                if future.result() is None:
                    taken.append(futures[future])
                else:
                    results.append(future.result())
                    self.progress.advance()
        finally:
            pool.shutdown(cancel_futures=True)
            self.progress.finish()
        return results, taken

    # ---- places on disk

    @property
    def store(self) -> Store:
        """What is kept."""
        return Store(self.folder)

    def _packing_content(self, seed: int) -> dict:
        return packing_content(self.specimen, seed, self.preparation)

    def _packing_name(self, seed: int) -> str:
        return content_hash(self._packing_content(seed))

    def _packing_path(self, seed: int) -> Path:
        return self.store.packing_path(self._packing_name(seed))

    def _stored_packing(self, seed: int) -> Packing | None:
        return self.store.packing(self._packing_name(seed))
