"""What a simulation depends on, hashed: soil, packing, machine, numerics, and the simulator.

Of the simulator's source only the definitions count that a run or a packing reaches
(`calibrate.simulation.dependencies`): a moved file or a comment makes nothing anew.
"""

import hashlib
import json
from functools import cache
from importlib import resources
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from calibrate.simulation.dependencies import Sources, places_of, types_in
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.settling import Packing, Specimen, prepare


def run_content(lab: VirtualLab, soil: SoilParameters) -> dict:
    """All that a run depends on, its packing apart."""
    return {
        "soil": _numbers(soil),
        "slope_exponent": soil.slope_exponent,
        "lab": _numbers(lab),
        "effects": [type(effect).__name__ for effect in lab.effects],
        "static": repr((lab.grid, lab.capacity, lab.tests, lab.numerics)),
        "simulator": _sources().hash(places_of({VirtualLab, *types_in((lab, soil))})),
    }


def packing_content(specimen: Specimen, seed: int, soil: SoilParameters | None) -> dict:
    """All that a packing depends on; `soil` is what it settled with (None: the neutral one)."""
    return {
        "specimen": repr(specimen),
        "seed": seed,
        "preparation": None if soil is None else [*_numbers(soil), soil.slope_exponent],
        "simulator": _sources().hash([*places_of([Packing]), (prepare.__module__, "prepare")]),
    }


def content_hash(content: dict) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


@cache
def engine_hash() -> str:
    """Hash of the simulator's definitions that any run reaches, effects apart: results state it."""
    return _sources().hash(places_of([VirtualLab]))


@cache
def _sources() -> Sources:
    return Sources.of(Path(str(resources.files("jdem"))))


def _numbers(tree) -> list[str]:
    """All array leaves as exact decimal strings, in the tree's order."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    return [repr(np.asarray(leaf).tolist()) for leaf in leaves]
