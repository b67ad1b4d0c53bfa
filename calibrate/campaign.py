"""Many simulations: cached on disk by content, resumable, parallel over cores.

A run is one soil on one packing.  Its key is the hash of everything that its result
depends on: parameters, packing, machine, numerics and the source of `jdem`.  Results are
written as NetCDF the moment they exist, atomically, so a killed campaign repeats nothing
and ends with the same numbers.
"""

import hashlib
import json
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from calibrate.progress import AbstractProgress, Silent
from jdem.experiments.composite import Outcome, VirtualLab
from jdem.observables import inertial_number
from jdem.packing import Packing, Specimen, load, prepare, save
from jdem.particles import Spheres
from jdem.soil import SoilParameters
from jdem.vector import Vector

NETCDF = "h5netcdf"


@dataclass(frozen=True, eq=False)
class Run:
    """One finished simulation in the units of the observables.

    Curves are arrays (points, 2) of displacement (mm) and force (N).  `failure` is empty
    or one sentence; a failed run keeps its place and its numbers.
    """

    depression_depth_mm: float
    crushing_force_n: float
    confined: np.ndarray
    unconfined: np.ndarray
    quality: dict[str, float]
    failure: str = ""

    def observables(self) -> dict[str, float]:
        return {
            "depression_depth_mm": self.depression_depth_mm,
            "crushing_force_n": self.crushing_force_n,
        }


@dataclass(eq=False)
class Campaign:
    """Runs soils on the packings of one specimen in one virtual laboratory.

    `folder` holds packings/ and runs/; `workers` threads share one compiled program.
    """

    lab: VirtualLab
    specimen: Specimen
    folder: Path
    progress: AbstractProgress = field(default_factory=Silent)
    workers: int = field(default_factory=lambda: cores())
    preparation: SoilParameters | None = None  # soil that beds settle with; None: neutral
    simulated: int = 0  # runs that were not in the cache
    _compiled: dict[tuple, Any] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def packings(self, seeds: Sequence[int]) -> list[Packing]:
        """The specimen's packings of these seeds, prepared if they are not on disk yet."""
        missing = [s for s in seeds if self._stored_packing(s) is None]
        if missing:
            self._prepare(missing[0])  # compiles for all of them
            self._in_parallel("preparing packings", self._prepare, missing[1:])
        packings = [self._stored_packing(seed) for seed in seeds]
        return [packing for packing in packings if packing is not None]

    def runs(
        self, soils: Sequence[SoilParameters], seeds: Sequence[int], what: str
    ) -> list[list[Run]]:
        """Every soil on every packing: a list (soils) of lists (seeds) of `Run`."""
        return self.each([[soil] * len(seeds) for soil in soils], seeds, what)

    def each(
        self, soils: Sequence[Sequence[SoilParameters]], seeds: Sequence[int], what: str
    ) -> list[list[Run]]:
        """Rows of soils, one for each packing: a list of lists (seeds) of `Run`."""
        packings = dict(zip(seeds, self._packings_while_compiling(soils, seeds), strict=True))
        keyed = [
            [
                (self.key(soil, seed), soil, packings[seed])
                for soil, seed in zip(row, seeds, strict=True)
            ]
            for row in soils
        ]
        unique = {task[0]: task for row in keyed for task in row}
        found = {key: self._stored_run(key) for key in unique}
        tasks = [task for key, task in unique.items() if found[key] is None]
        found.update(self._simulated(tasks, what))
        return [[run for key, _, _ in row if (run := found[key])] for row in keyed]

    def _packings_while_compiling(self, soils, seeds: Sequence[int]) -> list[Packing]:
        """The packings; where some must be prepared, the simulation is compiled meanwhile."""
        if all(self._stored_packing(seed) is not None for seed in seeds) or not len(soils):
            return self.packings(seeds)
        with ThreadPoolExecutor(1) as pool:
            compiled = pool.submit(self._program, self.lab, blank(self.specimen), soils[0][0])
            packings = self.packings(seeds)
            compiled.result()
        return packings

    def key(self, soil: SoilParameters, seed: int) -> str:
        """Hash of everything that the run of `soil` on packing `seed` depends on."""
        content = {
            "soil": _numbers(soil),
            "slope_exponent": soil.slope_exponent,
            "lab": _numbers(self.lab),
            "effects": [type(effect).__name__ for effect in self.lab.effects],
            "static": repr((self.lab.grid, self.lab.capacity, self.lab.tests, self.lab.numerics)),
            **self._packing_content(seed),
        }
        return _hash(content)

    def _simulated(self, tasks, what: str):
        if not tasks:
            return []
        for _, soil, packing in tasks:
            self._program(self.lab, packing, soil)
        self.simulated += len(tasks)
        return self._in_parallel(what, self._simulate, tasks)

    def _program(self, lab: VirtualLab, packing: Packing, soil: SoilParameters):
        """The compiled simulation of a laboratory; one serves all soils of one exponent."""
        kind = (soil.slope_exponent, lab.capacity)
        with self._lock:
            if kind not in self._compiled:
                begun = time.perf_counter()
                run = eqx.filter_jit(VirtualLab.run)
                self._compiled[kind] = run.lower(lab, packing, soil).compile()
                seconds = time.perf_counter() - begun
                self.progress.say(f"compiled the simulation in {seconds:.1f} s")
        return self._compiled[kind]

    def _simulate(self, task) -> tuple[str, Run]:
        """One run; once more with larger lists if they were too small."""
        key, soil, packing = task
        run = self._timed(self.lab, packing, soil)
        if run.quality["overflow"] > 0:
            run = self._timed(self.lab.roomier(self.specimen), packing, soil)
        _write_run(run, self._run_path(key))
        return key, run

    def _timed(self, lab: VirtualLab, packing: Packing, soil: SoilParameters) -> Run:
        program = self._program(lab, packing, soil)
        begun = time.perf_counter()
        outcome = jax.block_until_ready(program(lab, packing, soil))
        return summary(lab, packing, soil, outcome, time.perf_counter() - begun)

    def _prepare(self, seed: int) -> None:
        save(prepare(self.specimen, seed, self.preparation), self._packing_path(seed))

    def _in_parallel(self, what: str, function, tasks) -> list:
        if not tasks:
            return []
        self.progress.start(what, len(tasks))
        results = []
        try:
            with ThreadPoolExecutor(self.workers) as pool:
                for result in pool.map(function, tasks):
                    self.progress.advance()
                    results.append(result)
        finally:
            self.progress.finish()
        return results

    def _packing_path(self, seed: int) -> Path:
        return self.folder / "packings" / f"{_hash(self._packing_content(seed))}.npz"

    def _packing_content(self, seed: int) -> dict:
        """All that a packing depends on."""
        soil = self.preparation
        return {
            "specimen": repr(self.specimen),
            "seed": seed,
            "preparation": None if soil is None else [*_numbers(soil), soil.slope_exponent],
            "engine": engine_hash(),
        }

    def _stored_packing(self, seed: int) -> Packing | None:
        try:
            return load(self._packing_path(seed))
        except (OSError, ValueError, KeyError):
            return None

    def _run_path(self, key: str) -> Path:
        return self.folder / "runs" / f"{key}.nc"

    def _stored_run(self, key: str) -> Run | None:
        path = self._run_path(key)
        return _read_run(path) if path.exists() else None


def blank(specimen: Specimen) -> Packing:
    """A packing of the right shapes and no meaning, to compile for."""
    zeros = jnp.zeros(specimen.count)
    return Packing(Vector(zeros, zeros, zeros), Spheres(zeros, zeros), 1.0, 1.0)


def summary(
    lab: VirtualLab, packing: Packing, soil: SoilParameters, outcome: Outcome, seconds: float
) -> Run:
    """A run's numbers in mm and N, with the checks that say whether to believe them."""
    record, tests = outcome.record, lab.tests
    samples = int(np.sum(np.asarray(record.samples.segment) >= 0))
    steps = samples * round(lab.numerics.sample_time / float(lab.time_step(packing, soil)))
    energy = record.state.energy
    pressure = float(tests.confined.force_low) / (np.pi * float(packing.mould_radius) ** 2)
    density = float(packing.bulk_density() / packing.solid_fraction())
    rest = np.flatnonzero(np.asarray(record.samples.segment) == tests.names.index("resting"))
    kinetic = np.asarray(record.samples.kinetic_energy)
    quality = {
        "inertial_number": float(
            inertial_number(
                tests.confined.simulated_rate,
                packing.height,
                packing.mean_diameter(),
                density,
                pressure,
            )
        ),
        "overflow": float(_overflowed(lab, outcome)),
        "energy_balance": float(abs(energy.integration) / abs(energy.platen)),
        "kinetic_energy_after_rest_j": float(kinetic[rest[-1]]) if rest.size else np.nan,
        "platen_work_j": float(energy.platen),
        "time_step_s": float(lab.time_step(packing, soil)),
        "steps": float(steps),
        "spheres": float(packing.spheres.count),
        "runtime_s": seconds,
    }
    return Run(
        depression_depth_mm=1e3 * float(outcome.depression_depth),
        crushing_force_n=float(outcome.crushing_force),
        confined=_points(outcome.confined),
        unconfined=_points(outcome.unconfined),
        quality=quality,
        failure=_failure(lab, outcome),
    )


def _overflowed(lab: VirtualLab, outcome: Outcome) -> bool:
    return bool(outcome.record.overflow_of(lab.grid))


def _failure(lab: VirtualLab, outcome: Outcome) -> str:
    if not bool(outcome.failed):
        return ""
    if _overflowed(lab, outcome):
        return "a contact list was too small: " + outcome.record.explain_overflow(lab.grid)
    if not bool(outcome.record.finished):
        return "the tests took longer than their capacity of samples"
    if not (np.isfinite(outcome.depression_depth) and np.isfinite(outcome.crushing_force)):
        return "a number is not finite: the time step is too large or a parameter is extreme"
    force = float(lab.tests.confined.force_high)
    return f"the platen did not reach {force:.0f} N within its stroke: the soil is too soft"


def _points(curve) -> np.ndarray:
    rows = np.asarray(curve.valid) > 0
    columns = (1e3 * np.asarray(curve.displacement), np.asarray(curve.force))
    return np.stack(columns, axis=1)[rows].astype(float)


def _numbers(tree) -> list[str]:
    """All array leaves as exact decimal strings, in the tree's order."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    return [repr(np.asarray(leaf).tolist()) for leaf in leaves]


def _hash(content: dict) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def cores() -> int:
    """Processor cores that this process may use (taskset and cgroups' sets are obeyed)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def engine_hash() -> str:
    """Hash of the source of `jdem`: a changed engine never meets old results.

    How responses are differentiated (`jdem.sensitivity`) is not part of a run.
    """
    root = Path(str(resources.files("jdem")))
    files = sorted(path for path in root.rglob("*.py") if path.parent.name != "sensitivity")
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


def _write_run(run: Run, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    data = xr.Dataset(
        {
            "confined": (("confined_point", "column"), run.confined),
            "unconfined": (("unconfined_point", "column"), run.unconfined),
        },
        coords={"column": ["displacement_mm", "force_n"]},
        attrs={**run.observables(), **run.quality, "failure": run.failure},
    )
    part = path.with_suffix(f".{os.getpid()}-{id(run)}.part")
    data.to_netcdf(part, engine=NETCDF)
    part.replace(path)


def _read_run(path: Path) -> Run | None:
    """What `_write_run` wrote, or None for a damaged file (it is simulated again)."""
    try:
        with xr.open_dataset(path, engine=NETCDF) as data:
            attributes = {str(k): v for k, v in data.attrs.items()}
            confined, unconfined = data["confined"].values, data["unconfined"].values
        depth = float(attributes.pop("depression_depth_mm"))
        force = float(attributes.pop("crushing_force_n"))
        failure = str(attributes.pop("failure"))
    except (OSError, KeyError, ValueError):
        return None
    quality = {name: float(value) for name, value in attributes.items()}
    return Run(depth, force, confined, unconfined, quality, failure)
