"""What takes seconds at every start and never changes: kept beside the compiled programs.

    @kept
    def values(response, at): ...

JAX keeps what it compiles, but traces and lowers a program anew at every start, which for many
formulas takes longer than all else.  So the lowered program lies in the same folder
(`jax.export`), under a digest of all that it depends on: the source of the packages here, the
versions of the libraries, shapes of arrays, and whatever of the arguments is no array.
Arrays that take long to work out are kept in the same way (`arrays`); of one kind of them the
oldest go when together they need too much room.

Whatever cannot be read, or is not what was written, is made again.
"""

import functools
import hashlib
import io
import re
import threading
from collections.abc import Callable, Sequence
from importlib import metadata, resources
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.export
import numpy as np
from jax.core import Tracer

from calibrate.core.files import whole

R = TypeVar("R")
PACKAGES = ("calibrate", "jdem")
LIBRARIES = ("jax", "jaxlib", "equinox", "numpy", "scipy")
FORMAT = "flatbuffers"  # the library that JAX writes programs with
ADDRESS = re.compile(" at 0x")  # in the text of an object that another start does not have
# What another version of jaxlib may call otherwise; here the version is part of the digest.
UNSTABLE = (jax.export.DisabledSafetyCheck.custom_call("lapack_dormqr_ffi"),)
DIGEST = hashlib.sha256().digest_size
ROOM = 1 << 30  # bytes, for arrays of one kind


def kept(function: Callable[..., R]) -> Callable[..., R]:
    """A function of trees of arrays (and what is no array, which is part of the program), compiled
    as by `jax.jit`, whose lowered program is kept between starts."""
    known: dict[tuple, Callable] = {}
    compiled, alone = eqx.filter_jit(function), threading.Lock()

    @functools.wraps(function)
    def called(*args, **kwargs) -> R:
        leaves, tree = jax.tree.flatten(args)
        if kwargs or any(isinstance(leaf, Tracer) for leaf in leaves):
            return compiled(*args, **kwargs)  # within another program
        numbers = [leaf for leaf in leaves if _is_array(leaf)]
        rest = tuple(None if _is_array(leaf) else leaf for leaf in leaves)
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in numbers)
        key = (tree, rest, shapes)
        if key not in known:
            with alone:  # one thread traces for all
                if key not in known:
                    known[key] = _program(function, tree, rest, shapes)
        return known[key](*numbers)

    return called


def _is_array(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array | np.ndarray | np.generic)


def _program(function: Callable, tree, rest: tuple, shapes: tuple) -> Callable:
    """The compiled program for arguments of this kind, traced if none is kept."""

    def of_numbers(*numbers):
        given = iter(numbers)
        leaves = [next(given) if leaf is None else leaf for leaf in rest]
        return function(*jax.tree.unflatten(tree, leaves))

    called = f"{function.__module__}.{function.__qualname__}"
    place = jax.default_backend(), jax.config.read("jax_enable_x64")
    what = "\n".join(map(str, (called, *place, _text(tree), rest, shapes)))
    path = None if ADDRESS.search(what) else _path("program", [what.encode()])
    if path is None or find_spec(FORMAT) is None:
        return jax.jit(of_numbers)
    exported = _read(path, lambda data: jax.export.deserialize(bytearray(data)))
    if exported is None:
        specs = [jax.ShapeDtypeStruct(*shape) for shape in shapes]
        exported = jax.export.export(jax.jit(of_numbers), disabled_checks=UNSTABLE)(*specs)
        _write(path, bytes(exported.serialize()))
    return jax.jit(exported.call)


def _text(tree: Any) -> str:
    """A tree without its leaves: every class with what it holds beside them."""
    kind, beside = tree.node_data() or ("leaf", None)
    return f"{kind} {_named(beside)} [{', '.join(map(_text, tree.children()))}]"


def _named(part: Any) -> str:
    """What is no array, as text; a module's function by its place."""
    if isinstance(part, tuple):
        return f"({', '.join(map(_named, part))})"
    if isinstance(part, FunctionType) and part.__qualname__.isidentifier():
        return f"{part.__module__}.{part.__qualname__}"
    return repr(part)


def arrays(
    what: str, inputs: Sequence[np.ndarray], make: Callable[[], np.ndarray], again: bool = True
) -> np.ndarray:
    """The array that `make` works out from inputs, kept under `what` it is and theirs; again: it is
    asked for at other starts as well."""
    if not again:
        return make()
    parts = [np.asarray(one) for one in inputs]
    known = [f"{one.shape}{one.dtype}".encode() + one.tobytes() for one in parts]
    path = _path(what, known)
    found = None if path is None else _read(path, lambda data: np.load(io.BytesIO(data)))
    if found is None:
        found = make()
        if path is not None:
            data = io.BytesIO()
            np.save(data, found, allow_pickle=False)
            _write(path, data.getvalue())
            _make_room(path.parent, f"kept-{what}-*")
    return found


def _make_room(folder: Path, pattern: str) -> None:
    """Removes the oldest of such files until all of them fit into ROOM."""
    try:
        found = [(file.stat(), file) for file in folder.glob(pattern)]
        used = sum(state.st_size for state, _ in found)
        for state, file in sorted(found, key=lambda each: each[0].st_mtime):
            if used > ROOM:
                file.unlink(missing_ok=True)
                used -= state.st_size
    except OSError:
        pass  # another process was faster


def _path(what: str, parts: Sequence[bytes]) -> Path | None:
    """Where something that depends on these parts is kept; None where nothing is."""
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if not folder:
        return None
    digest = hashlib.sha256(_state())
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return Path(folder) / f"kept-{what}-{digest.hexdigest()}"


@functools.cache
def _state() -> bytes:
    """A digest of the source of the packages and of the versions of the libraries."""
    digest = hashlib.sha256()
    for name in LIBRARIES:
        digest.update(f"{name} {metadata.version(name)}\n".encode())
    for package in PACKAGES:
        root = Path(str(resources.files(package)))
        for file in sorted(root.rglob("*.py")):
            digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    return digest.digest()


def _read(path: Path, understood: Callable[[bytes], Any]) -> Any:
    """What a file holds; None where there is none, or it is not as it was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    if hashlib.sha256(data[DIGEST:]).digest() != data[:DIGEST]:
        return None
    return understood(data[DIGEST:])


def _write(path: Path, data: bytes) -> None:
    """Keeps data whole or not at all; a folder that cannot be written to keeps nothing."""
    try:
        with whole(path) as part:
            part.write_bytes(hashlib.sha256(data).digest() + data)
    except OSError:
        pass
