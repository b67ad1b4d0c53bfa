"""Many specimens at once on an accelerator: `--batch N`.

Threads of a campaign hand in single specimens and wait.  Those that one program serves (the same
shapes and static choices, as in `calibrate.simulation.compiled`) are stacked along a new axis and
simulated together.  A batch lasts as long as its longest specimen, so it is made of those whose
steps are alike.  All else, as preparing packings, stays on the processor.
"""

import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import numpy as np

from calibrate.simulation.compiled import kind_of, simulated
from calibrate.simulation.executors import HERE, AbstractPlace, MachineFailure, cores
from calibrate.simulation.run import Run, repeated, summary
from jdem.laboratory.virtual_lab import Outcome, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing, Specimen

SETTLED = 1.0  # s without a new specimen, after which a batch is not waited for any more
QUEUE = 3  # batches that threads may hand in at once: what is alike is chosen among these
SMALLER = 4  # times: the size of batches for what is left over, unless below FEWEST
FEWEST = 8
LOOK = 0.05  # s between looks at what waits

Arguments = tuple[VirtualLab, Packing, SoilParameters]


@dataclass(eq=False)
class _Waiting:
    """A specimen that somebody waits for; its time step in s."""

    arguments: Arguments
    time_step: float
    outcome: "Future[tuple[Outcome, float]]" = field(default_factory=Future)


@dataclass(eq=False)
class _Queue:
    """Specimens of one kind, and the programs that serve them: one tells a time step, the others
    simulate batches, by their size."""

    time_step: Future
    together: Mapping[int, Future]
    waiting: list[_Waiting] = field(default_factory=list)


class InBatches(AbstractPlace):
    """Simulates up to `size` specimens at once on the first accelerator; on the processor where
    there is none, in the same batches."""

    def __init__(self, size: int):
        self._size = size
        self._sizes = (size, size // SMALLER) if size // SMALLER >= FEWEST else (size,)
        self._device = jax.devices()[0]
        self._processor = jax.devices("cpu")[0]
        jax.config.update("jax_default_device", self._processor)
        self._preparing = threading.Semaphore(cores())
        self._compiling = ThreadPoolExecutor(cores())
        self._queues: dict[Any, _Queue] = {}
        self._changed = threading.Condition()
        self._latest = 0.0  # when the last specimen came
        self._said = False
        threading.Thread(target=self._serve, daemon=True).start()

    def slots(self, workers: int) -> int:
        return QUEUE * self._size

    def warm_up(self, lab, packing, soil, say) -> None:
        if not self._said:
            self._said = True
            say(f"simulating {self._size} at once on {self._device.device_kind}")

    def simulate(self, lab, specimen: Specimen, packing, soil) -> Run:
        given = (lab, packing, soil)
        queue = self._queue(given)
        one = _Waiting(given, float(queue.time_step.result()(*given)))
        with self._changed:
            queue.waiting.append(one)
            self._latest = time.perf_counter()
            self._changed.notify()
        outcome, seconds = one.outcome.result()
        run = summary(lab, packing, soil, outcome, seconds)
        if run.quality["overflow"] > 0:  # a few, with longer lists of their own
            with self._preparing:
                run = repeated(simulated(lab.roomier(specimen), specimen, packing, soil), run)
        return run

    def prepare(self, specimen, seed, soil) -> Packing:
        with self._preparing:
            return HERE.prepare(specimen, seed, soil)

    # ---- programs

    def _queue(self, given: Arguments) -> _Queue:
        """The queue of such specimens; all kinds compile side by side."""
        kind = kind_of(*given)
        with self._changed:
            if kind not in self._queues:
                self._queues[kind] = _Queue(
                    self._compiled(_time_step, given),
                    {s: self._compiled(_together, self._placed([given] * s)) for s in self._sizes},
                )
            return self._queues[kind]

    def _compiled(self, function: Any, given: Arguments) -> Future:
        return self._compiling.submit(lambda: function.lower(*given).compile())

    def _placed(self, batch: Sequence[Arguments]) -> Arguments:
        """What specimens are simulated from, stacked, on the accelerator."""
        return jax.device_put(_stacked(batch), self._device)

    # ---- the one thread that runs batches

    def _serve(self) -> None:
        while True:
            queue, batch = self._next()
            try:
                self._run(queue, batch)
            except Exception as error:
                failure = MachineFailure(f"{type(error).__name__}: {str(error) or 'no memory'}")
                for one in batch:
                    one.outcome.set_exception(failure)

    def _next(self) -> tuple[_Queue, list[_Waiting]]:
        """The next batch: of the longest queue whose program is compiled the specimens with the
        smallest time steps, once they are enough or no more come."""
        with self._changed:
            while True:
                ready = [q for q in self._queues.values() if q.together[self._size].done()]
                longest = max(ready, key=lambda q: len(q.waiting), default=None)
                still = time.perf_counter() - self._latest > SETTLED
                if longest and len(longest.waiting) >= (1 if still else self._size):
                    longest.waiting.sort(key=lambda one: one.time_step)
                    batch = longest.waiting[: self._size]
                    del longest.waiting[: self._size]
                    return longest, batch
                self._changed.wait(LOOK if any(q.waiting for q in self._queues.values()) else None)

    def _run(self, queue: _Queue, batch: Sequence[_Waiting]) -> None:
        size = min(size for size in self._sizes if size >= len(batch))
        padded = [*batch, *[batch[-1]] * (size - len(batch))]
        given = self._placed([one.arguments for one in padded])
        program = queue.together[size].result()
        begun = time.perf_counter()
        outcomes = jax.device_get(program(*given))
        seconds = (time.perf_counter() - begun) / len(batch)
        for number, one in enumerate(batch):
            one.outcome.set_result((_part(outcomes, number), seconds))


_time_step = eqx.filter_jit(VirtualLab.time_step)
_together = eqx.filter_jit(eqx.filter_vmap(VirtualLab.run))


def _stacked(items: Sequence[Arguments]) -> Arguments:
    """Arguments of one kind as one with a leading axis."""

    def stack(*leaves):
        return np.stack([np.asarray(leaf) for leaf in leaves])

    arrays = [eqx.filter(item, eqx.is_array) for item in items]
    return eqx.combine(jax.tree.map(stack, *arrays), items[0])


def _part(outcomes: Outcome, number: int) -> Outcome:
    """One of stacked outcomes."""
    return jax.tree.map(lambda leaf: leaf[number] if eqx.is_array_like(leaf) else leaf, outcomes)
