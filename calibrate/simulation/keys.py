"""What a simulation depends on, hashed: soil, packing, machine, numerics, source of `jdem`."""

import hashlib
import json
from functools import cache
from importlib import resources
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.settling import Specimen


def run_content(lab: VirtualLab, soil: SoilParameters) -> dict:
    """All that a run depends on, its packing apart."""
    return {
        "soil": _numbers(soil),
        "slope_exponent": soil.slope_exponent,
        "lab": _numbers(lab),
        "effects": [type(effect).__name__ for effect in lab.effects],
        "static": repr((lab.grid, lab.capacity, lab.tests, lab.numerics)),
    }


def packing_content(specimen: Specimen, seed: int, soil: SoilParameters | None) -> dict:
    """All that a packing depends on; `soil` is what it settled with (None: the neutral one)."""
    return {
        "specimen": repr(specimen),
        "seed": seed,
        "preparation": None if soil is None else [*_numbers(soil), soil.slope_exponent],
        "engine": engine_hash(),
    }


def content_hash(content: dict) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


@cache
def engine_hash() -> str:
    """Hash of the source of `jdem`: a changed engine never meets old results.

    How responses are differentiated (`jdem.sensitivity`) is not part of a run.
    """
    root = Path(str(resources.files("jdem")))
    files = sorted(path for path in root.rglob("*.py") if path.parent.name != "sensitivity")
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


def _numbers(tree) -> list[str]:
    """All array leaves as exact decimal strings, in the tree's order."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    return [repr(np.asarray(leaf).tolist()) for leaf in leaves]
