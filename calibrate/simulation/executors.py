"""Where simulations run: here, on the cores of this machine, or somewhere else.

A place computes; what is computed, cached, tried again or labelled is the campaign's affair.
"""

import abc
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TypeVar

import jax

from calibrate.core.progress import AbstractProgress
from calibrate.simulation.compiled import PROGRAMS, simulated
from calibrate.simulation.run import Run
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing, Specimen

Made = TypeVar("Made")


class MachineFailure(RuntimeError):
    """The machine, not the soil, failed (memory, a lost worker); trying again may help."""


class AbstractPlace(abc.ABC):
    """Simulates and prepares packings, `slots` at once from as many threads."""

    @abc.abstractmethod
    def slots(self, workers: int) -> int:
        """Threads of this process that hand work to the place; `workers` is what was asked."""

    @abc.abstractmethod
    def warm_up(
        self,
        lab: VirtualLab,
        packing: Packing,
        soil: SoilParameters,
        say: Callable[[str], None],
    ) -> None:
        """Gets ready for such runs, before the first of them is timed."""

    @abc.abstractmethod
    def simulate(
        self, lab: VirtualLab, specimen: Specimen, packing: Packing, soil: SoilParameters
    ) -> Run:
        """One run; raises `MachineFailure` where the machine gave up."""

    @abc.abstractmethod
    def prepare(self, specimen: Specimen, seed: int, soil: SoilParameters | None) -> Packing:
        """One packing; raises `MachineFailure`, and ValueError where it does not settle."""


@dataclass(frozen=True)
class Here(AbstractPlace):
    """Threads of this process, which share compiled programs."""

    def slots(self, workers: int) -> int:
        return workers

    def warm_up(self, lab, packing, soil, say) -> None:
        _, seconds = PROGRAMS.get(lab, packing, soil)
        if seconds > 0.1:
            say(f"compiled the simulation in {seconds:.1f} s")

    def simulate(self, lab, specimen, packing, soil) -> Run:
        return _on_this_machine(simulated, lab, specimen, packing, soil)

    def prepare(self, specimen, seed, soil) -> Packing:
        return _on_this_machine(prepare, specimen, seed, soil)


HERE = Here()


def _on_this_machine(function, *arguments):
    try:
        return function(*arguments)
    except (MemoryError, jax.errors.JaxRuntimeError) as error:
        raise MachineFailure(f"{type(error).__name__}: {str(error) or 'no memory'}") from None


def cores() -> int:
    """Processor cores that this process may use (taskset and cgroups' sets are obeyed)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def side_by_side(
    one: Callable[[int], Made], count: int, progress: AbstractProgress, what: str,
    workers: int | None = None, compiles: bool = False,
) -> list[Made]:  # fmt: skip
    """one(0) to one(count - 1), worked out in threads, in this order.

    With `compiles` one(0) goes first, alone: it compiles for all of them.
    """
    found: dict[int, Made] = {}
    progress.start(what, count)
    pool = ThreadPoolExecutor(workers or cores())
    try:
        if compiles and count:
            found[0] = pool.submit(one, 0).result()
            progress.advance()
        waiting = {pool.submit(one, n): n for n in range(count) if n not in found}
        for done in as_completed(waiting):
            found[waiting[done]] = done.result()
            progress.advance()
    finally:
        pool.shutdown(cancel_futures=True)
        progress.finish()
    return [found[number] for number in range(count)]
