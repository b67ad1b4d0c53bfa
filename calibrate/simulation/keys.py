"""The names under which beds and runs are kept: hashes of all that they depend on.

That is soil, packing, machine and numerics, the version of the physics (`jdem.physics`) for all
that this package computes, and by name the classes of law, tests and effects.  A class that stands
in a file of your own counts with the text of that file, as no version of ours tells of it.
"""

import hashlib
import inspect
import json
import sys
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Specimen
from jdem.physics import PHYSICS, PREPARATION

OURS = ("jdem", "calibrate")  # packages for which the version of the physics stands


def run_content(lab: VirtualLab, soil: SoilParameters) -> dict:
    """All that a run depends on, its packing apart."""
    return {
        "physics": PHYSICS,
        "soil": _numbers(soil),
        "slope_exponent": soil.slope_exponent,
        "lab": _numbers(lab),
        "effects": [type(effect).__name__ for effect in lab.effects],
        "static": repr((lab.grid, lab.capacity, lab.tests, lab.numerics)),
        "classes": classes(lab, soil),
    }


def packing_content(specimen: Specimen, seed: int, soil: SoilParameters | None) -> dict:
    """All that a packing depends on; `soil` is what it settled with (None: the neutral one)."""
    with_soil = None if soil is None else [*_numbers(soil), soil.slope_exponent, *classes(soil)]
    return {
        "beds": PREPARATION,
        "specimen": repr(specimen),
        "seed": seed,
        "preparation": with_soil,
    }


def content_hash(content: dict) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def classes(*roots) -> list[str]:
    """Names of the functions and classes inside objects; those of other packages with their module
    and the hash of its file."""
    return sorted({_name(one) for one in _each(roots)})


def _name(one) -> str:
    name = getattr(one, "__qualname__", type(one).__qualname__)
    module = str(one.__module__)
    return name if module.split(".")[0] in OURS else f"{module}.{name} {_text_hash(module)}"


def _text_hash(module: str) -> str:
    """Of a module's file; "" where it has none, as what is typed into a notebook."""
    file = getattr(sys.modules.get(module), "__file__", None)
    path = None if file is None else Path(file)
    return hashlib.sha256(path.read_bytes()).hexdigest() if path and path.is_file() else ""


def _definitions(root) -> Iterator:
    """Functions and classes in a root: itself, or the types of all that is inside it."""
    if inspect.isclass(root):
        yield root
    elif is_dataclass(root):
        yield type(root)
        yield from _each(getattr(root, field.name, None) for field in fields(root))
    elif isinstance(root, tuple | list):
        if type(root) not in (tuple, list):
            yield type(root)
        yield from _each(root)
    elif isinstance(root, dict):
        yield from _each(root.values())
    elif isinstance(root, partial):
        yield from _each((root.func, root.args, root.keywords))
    elif callable(root):
        yield inspect.unwrap(root)


def _each(roots: Iterable) -> Iterator:
    for root in roots:
        yield from _definitions(root)


def _numbers(tree) -> list[str]:
    """All array leaves as exact decimal strings, in the tree's order."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    return [repr(np.asarray(leaf).tolist()) for leaf in leaves]
