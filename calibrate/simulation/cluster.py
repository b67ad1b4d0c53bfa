"""A Dask cluster as the place where simulations run: `--dask tcp://host:8786`.

Workers compute and send numbers back; the cache on disk is this process's alone, so workers
need no common file system.  The scheduler gives the runs of a worker that died to another one.
Every worker must have the same physics and the same laws and effects of yours, or keys would lie;
one that has not is refused.
"""

import gc
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from distributed import CancelledError, Client, KilledWorker

from calibrate.core.errors import CalibrationError, InputError, one_line
from calibrate.simulation.compiled import simulated
from calibrate.simulation.executors import AbstractPlace, MachineFailure
from calibrate.simulation.keys import classes
from calibrate.simulation.run import Run
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing
from jdem.physics import PHYSICS

IN_FLIGHT = 256  # runs handed to the scheduler at once; adaptive clusters grow with the queue
PATIENCE = 20.0  # s until a scheduler must have answered


class DaskCluster(AbstractPlace):
    """Workers of the scheduler at `address`, such as tcp://10.0.0.1:8786.

    Raises `InputError` about --dask where no scheduler answers.
    """

    def __init__(self, address: str):
        self._client = _connected(address)
        self._address = address
        self._said = False

    def slots(self, workers: int) -> int:
        return IN_FLIGHT

    def warm_up(self, lab, packing, soil, say) -> None:
        if self._said:
            return
        self._said = True
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        threads = sum(worker["nthreads"] for worker in workers.values())
        waits = "" if workers else "; nothing begins before one joins"
        say(f"{self._address}: {len(workers)} workers with {threads} threads{waits}")

    def simulate(self, lab, specimen, packing, soil) -> Run:
        return self._computed(simulated, lab, specimen, packing, soil)

    def prepare(self, specimen, seed, soil) -> Packing:
        return self._computed(prepare, specimen, seed, soil)

    def close(self) -> None:
        self._client.close()

    def _computed(self, function: Callable, *arguments):
        """function(*arguments) on a worker, with this process's precision."""
        settings = {name: getattr(jax.config, name) for name in SETTINGS}
        job = (function, code_of(arguments), settings, _plain(arguments))
        try:
            result = self._client.submit(on_worker, *job, pure=False).result()
        except KilledWorker as error:
            raise MachineFailure(f"workers died with it: {one_line(str(error))}") from None
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            raise MachineFailure(f"{type(error).__name__} on a worker: {error}") from None
        except (CancelledError, OSError, UnboundLocalError) as error:  # the last: a closed loop
            lost = f"lost the Dask scheduler at {self._address} ({type(error).__name__})"
            raise CalibrationError(f"{lost}; finished runs are kept, give it again") from None
        return _on_device(result)


def _connected(address: str) -> Client:
    try:
        return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        why = one_line(str(error))[:120]
    # Raised out here, so that no traceback keeps the failed client: it would be closed by
    # whichever thread collects it, which locks up if that is the thread of a next client.
    gc.collect()
    repair = "give the address that the scheduler printed, such as tcp://host:8786"
    raise InputError(address, "--dask", f"no Dask scheduler answers ({why})", repair)


SETTINGS = (
    "jax_enable_x64",
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
)


def code_of(arguments: tuple) -> list[str]:
    """The physics, and the classes that are computed with, those of yours with their text."""
    return [f"physics {PHYSICS}", *classes(*arguments)]


def on_worker(function: Callable, code: list[str], settings: dict[str, Any], arguments: tuple):
    """What a worker does: the client's settings, then function(*arguments)."""
    here = code_of(arguments)
    if here != code:
        other = ", ".join(sorted(set(here) ^ set(code)))
        raise CalibrationError(
            "a worker has another version of jdem, or of a law or effect of yours "
            f"({other}); install the same on all machines"
        )
    for name, value in settings.items():
        jax.config.update(name, value)
    return _plain(function(*_on_device(arguments)))


def _plain(tree):
    """Arrays as NumPy's, which keep their precision on the way whatever JAX is set to."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def _on_device(tree):
    def moved(leaf):
        return jnp.asarray(leaf) if isinstance(leaf, np.ndarray) else leaf

    return jax.tree.map(moved, tree)
