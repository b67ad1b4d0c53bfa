"""What a simulation depends on, hashed: soil, packing, machine, numerics, and the source reached.

Of the source of `jdem` counts what is reached from the functions that compute, and from the
types of everything that they are given (`calibrate.simulation.dependencies`): a moved file, a
comment, a law or an effect that a run does not have make no bed and no run anew.
"""

import hashlib
import inspect
import json
import sys
import threading
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache, partial
from pathlib import Path

import equinox as eqx
import jax
import numpy as np

from calibrate.simulation.definitions import Sources
from calibrate.simulation.dependencies import Dependencies
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.observables import inertial_number
from jdem.packing.composite import prepare
from jdem.packing.specimen import Specimen

OURS = ("jdem", "calibrate")  # packages whose definitions are followed
SETTLES = (prepare,)
_PARSING = threading.Lock()  # the parser of Python 3.11 fails where two threads enter it
RUNS = (VirtualLab, inertial_number)  # the latter for the checks that are kept with a run


def run_content(lab: VirtualLab, soil: SoilParameters) -> dict:
    """All that a run depends on, its packing apart."""
    return {
        "soil": _numbers(soil),
        "slope_exponent": soil.slope_exponent,
        "lab": _numbers(lab),
        "effects": [type(effect).__name__ for effect in lab.effects],
        "static": repr((lab.grid, lab.capacity, lab.tests, lab.numerics)),
        "running": source_hash(*RUNS, lab, soil),
    }


def packing_content(specimen: Specimen, seed: int, soil: SoilParameters | None) -> dict:
    """All that a packing depends on; `soil` is what it settled with (None: the neutral one)."""
    return {
        "specimen": repr(specimen),
        "seed": seed,
        "preparation": None if soil is None else [*_numbers(soil), soil.slope_exponent],
        "settling": source_hash(*SETTLES, specimen, soil),
    }


def content_hash(content: dict) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def engine_hash(*given) -> str:
    """Hash of the source of the plain virtual laboratory: of how it makes beds and runs.

    With objects `given` (a laboratory with effects, a soil), of what `jdem` and `calibrate`
    define of the things inside them as well.  How responses are differentiated
    (`jdem.sensitivity`) is not part of it.
    """
    names = _names(*SETTLES, *RUNS, *given)
    with _PARSING:
        return _source_hash(frozenset(name for name in names if _package(name) in OURS))[:16]


def source_hash(*roots) -> str:
    """Hash of the source that functions, classes, and everything inside objects depend on."""
    with _PARSING:
        return _source_hash(_names(*roots))


@cache
def _source_hash(names: frozenset[tuple[str, str]]) -> str:
    """A source that cannot be found, as that of a class typed into a notebook, counts by name."""
    dependencies = _dependencies(frozenset(map(_package, names)))
    known = {name for name in names if dependencies.sources.module(name[0]) is not None}
    return content_hash({"known": dependencies.hash_of(known), "else": sorted(names - known)})


@cache
def _dependencies(packages: frozenset[str]) -> Dependencies:
    """Of these packages, ours among them; each file is parsed once a process."""
    found = {name: _place(name) for name in sorted({*packages, *OURS})}
    return Dependencies(Sources({name: place for name, place in found.items() if place}))


def _place(package: str) -> Path | None:
    """The folder of a package, or the file of a module that is not in one; others' are not read."""
    file = getattr(sys.modules.get(package), "__file__", None)
    if file is None or not file.endswith(".py"):
        return None
    path = Path(file)
    if package not in OURS and "site-packages" in path.parts:
        return None
    return path.parent if path.name == "__init__.py" else path


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


def _names(*roots) -> frozenset[tuple[str, str]]:
    return frozenset(_name(one) for one in _each(roots))


def _package(name: tuple[str, str]) -> str:
    return name[0].split(".")[0]


def _name(definition) -> tuple[str, str]:
    """Module and name in it."""
    kind = type(definition).__qualname__
    return str(definition.__module__), getattr(definition, "__qualname__", kind)


def _numbers(tree) -> list[str]:
    """All array leaves as exact decimal strings, in the tree's order."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    return [repr(np.asarray(leaf).tolist()) for leaf in leaves]
