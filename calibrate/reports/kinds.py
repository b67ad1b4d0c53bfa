"""The kinds of results of which `calibrate report` makes a page.

A new kind is one function, from the path of a result's JSON file to a `Page`, and one line in
`KINDS`: its name, the file that its command writes, keys that only this file has, the function.
"""

import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calibrate.core.errors import InputError
from calibrate.io.labfile import read_file
from calibrate.records.base import RUN_AGAIN
from calibrate.reports import audit, diagnosis, fit, study_page
from calibrate.reports.html import Page


@dataclass(frozen=True)
class Kind:
    """One kind of result; `keys` tell its file from that of another kind."""

    name: str
    file: str
    keys: frozenset[str]
    page: Callable[[Path], Page]


KINDS = (
    Kind("fit", "result.json", frozenset({"free", "history"}), fit.page),
    Kind("doe", "result.json", frozenset({"designs", "comparison"}), study_page.page),
    Kind("audit", "audit.json", frozenset({"strategies", "curves"}), audit.page),
    Kind("diagnose", "result.json", frozenset({"which", "where", "features"}), diagnosis.page),
)
NAMES = ", ".join(kind.name for kind in KINDS)


def find(place: Path) -> tuple[Kind, Path]:
    """The kind of result in a folder, or in one JSON file, and the file; `InputError` if none."""
    if not place.exists():
        raise InputError(str(place), "", "no such folder", "check the path for a typing error")
    files = {place / kind.file for kind in KINDS} if place.is_dir() else {place}
    found = [(kind, file) for file in sorted(files) if file.exists() for kind in _kinds_of(file)]
    if not found:
        repair = f"give the folder that one of these wrote: {NAMES}"
        raise InputError(str(place), "", "nothing here to report on", repair)
    if len(found) > 1:
        names = ", ".join(file.name for _, file in found)
        raise InputError(str(place), "", f"several results ({names})", "give the path of one file")
    return found[0]


def page_of(kind: Kind, file: Path) -> Page:
    """The page of a result's file; `InputError` also where its numbers make no picture.

    Numbers that are not known leave gaps in pictures, which no warning has to tell.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return kind.page(file)
    except (ArithmeticError, LookupError, ValueError) as error:
        problem = f"what it holds cannot be shown ({error})"
        raise InputError(str(file), "", problem, RUN_AGAIN) from error


def _kinds_of(file: Path) -> list[Kind]:
    """The kinds whose keys are in a JSON file."""
    try:
        content = json.loads(read_file(file))
    except (ValueError, RecursionError) as error:
        problem = f"not valid JSON: {error}"
        raise InputError(str(file), "", problem, "run the command that wrote it again") from None
    keys = set(content) if isinstance(content, dict) else set()
    return [kind for kind in KINDS if kind.keys <= keys]
