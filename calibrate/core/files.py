"""Files that results are written to: whole or not at all, JSON without NaN."""

import json
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from calibrate.core.errors import COMMAND_LINE, InputError


def make_folder(out: Path, option: str = "--out") -> None:
    """Creates the folder for results, and says so in one line where that is impossible."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = part_of(out / ".write")
        probe.touch()
        probe.unlink()
    except OSError as error:
        problem = error.strerror or str(error)
        repair = "give a folder that can be written to"
        raise InputError(str(out), option, problem, repair) from None


def check_writable(path: Path | None) -> None:
    """Refuses a `--json` path that cannot be written, before anything is simulated."""
    if path is None:
        return
    if path.is_dir():
        raise InputError(COMMAND_LINE, "--json", f"{path} is a folder", "give the name of a file")
    if not _special(path):
        make_folder(path.parent, "--json")


@contextmanager
def whole(path: Path, suffix: str = "") -> Iterator[Path]:
    """Where to write what becomes the file `path` at the end of the block, whole or not at all.

    Every writer gets a name of its own, so that two processes, or two threads, may write the same
    file at once: the last one's stays.  `suffix` is for writers that go by the end of a name.
    A device or a pipe, such as /dev/null, is written to as it is: nothing may take its place.
    """
    if _special(path):
        yield path
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    part = part_of(path, suffix)
    try:
        yield part
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _special(path: Path) -> bool:
    """Whether a path is there and is neither a file nor a folder, but a device or a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


def part_of(path: Path, suffix: str = "") -> Path:
    """A name beside `path` that no other writer has."""
    return path.with_name(f"{path.name}.{os.getpid()}-{uuid.uuid4().hex[:12]}.part{suffix}")


def write_text(path: Path, text: str) -> None:
    """Writes a file whole or not at all."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file whole or not at all."""
    with whole(path) as part:
        part.write_bytes(content)


def write_json(path: Path, content: dict | list, indent: int | None = 1) -> None:
    """Strict JSON: NaN and infinities become null."""
    write_text(path, as_json(content, indent))


def as_json(content: dict | list, indent: int | None = 1) -> str:
    """Strict JSON: NaN and infinities become null; without indentation all in one line."""
    return json.dumps(_finite(content), indent=indent, allow_nan=False) + "\n"


def _finite(value):
    """The value with NaN and infinities replaced by None."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    return value
