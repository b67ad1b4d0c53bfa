"""Simulating and preparing in this process, with programs compiled once for all campaigns.

One compiled program serves all laboratories, packings and soils of the same shapes and static
choices, whichever campaign or thread asks.
"""

import threading
import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from calibrate.simulation.run import Run, repeated, summary
from jdem.bodies.spheres import Spheres
from jdem.core.kernel import program
from jdem.core.vector import Vector
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing, Specimen

KEPT = 32  # compiled programs; the oldest makes room


class Programs:
    """Compiled simulations by what they were compiled for; safe for threads.

    Every program holds many regions of memory, of which a process may have 65 530 by default
    (Linux, vm.max_map_count): one that made cases of six sizes died after 14 of them with "Unable
    to allocate section memory".  So JAX's own caches, which hold what prepares beds, are
    emptied as often as this one has been filled.
    """

    def __init__(self):
        self._compiled: dict[Any, Any] = {}
        self._made = 0
        self._lock = threading.Lock()

    def get(self, lab: VirtualLab, packing: Packing, soil: SoilParameters) -> tuple[Any, float]:
        """The program, and the seconds that compiling took just now (0 if it was there)."""
        kind = kind_of(lab, packing, soil)
        if kind in self._compiled:
            return self._compiled[kind], 0.0
        with self._lock:
            begun = time.perf_counter()
            if kind not in self._compiled:
                made = program(VirtualLab.run).lower(lab, packing, soil).compile()
                for old in list(self._compiled)[: max(len(self._compiled) + 1 - KEPT, 0)]:
                    del self._compiled[old]
                self._compiled[kind] = made
                self._made += 1
                if self._made % KEPT == 0:
                    jax.clear_caches()
            return self._compiled[kind], time.perf_counter() - begun


PROGRAMS = Programs()


def simulated(lab: VirtualLab, specimen: Specimen, packing: Packing, soil: SoilParameters) -> Run:
    """One run; once more with larger lists if they were too small."""
    run = _timed(lab, packing, soil)
    if run.quality["overflow"] > 0:
        run = repeated(_timed(lab.roomier(specimen), packing, soil), run)
    return run


def blank(specimen: Specimen) -> Packing:
    """A packing of the right shapes and no meaning, to compile for."""
    zeros = jnp.zeros(specimen.count)
    return Packing(Vector(zeros, zeros, zeros), Spheres(zeros, zeros), 1.0, 1.0)


def _timed(lab: VirtualLab, packing: Packing, soil: SoilParameters) -> Run:
    compiled, _ = PROGRAMS.get(lab, packing, soil)
    begun = time.perf_counter()
    outcome = jax.block_until_ready(compiled(lab, packing, soil))
    return summary(lab, packing, soil, outcome, time.perf_counter() - begun)


def kind_of(*arguments):
    """What a program is compiled for: shapes, precisions and everything static."""
    arrays, static = eqx.partition(arguments, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    others, layout = jax.tree.flatten(static)
    shapes = tuple((leaf.shape, str(leaf.dtype)) for leaf in leaves)
    return structure, shapes, tuple(others), layout
