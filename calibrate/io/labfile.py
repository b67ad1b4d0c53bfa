"""Reading a lab file, and the parameters and values that its contact law accepts.

A lab file is TOML; `calibrate.io.tables` says which tables it has.  Whatever is wrong with it
becomes one `InputError` that names file, field and repair.  `calibrate.io.stated` finds its tests,
`calibrate.io.lab` builds the plain result.
"""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.core.units import number_or_quantity
from jdem.core.parameter import Parameter
from jdem.materials.catalogue import EVERY, parameters_of
from jdem.materials.conventions import CONVENTIONS, DEFAULT

Checked = TypeVar("Checked", bound=BaseModel)
_FREE = {name: entry for name, entry in EVERY.items() if entry.free}

# Parameter names of all laws and the SI unit of each ("" for a pure number).
PARAMETER_UNITS: dict[str, str] = {name: entry.unit for name, entry in _FREE.items()}

# For each parameter: does its law accept this value (in SI), and what to say when it does not.
PARAMETER_RANGES: dict[str, tuple[Callable[[float], bool], str]] = {
    name: (entry.accepted, entry.repair) for name, entry in _FREE.items()
}


def entry_of(name: str, file: str, field: str, law: str = DEFAULT) -> Parameter:
    """What is known of a parameter that a user sets, refused where the law (a name of
    `jdem.materials.contact_laws.BED_LAWS`) does not have it; `file` and `field` are where it is
    written."""
    known = {each: entry for each, entry in parameters_of(law).items() if entry.free}
    if name in known:
        return known[name]
    if name not in _FREE:
        raise InputError(file, field, f"unknown parameter {shown(name)}", suggestion(name, known))
    called = DEFAULT if law in CONVENTIONS else law
    problem = f"the law '{called}' has no {name}"
    raise InputError(file, field, problem, f"leave it out; it has {', '.join(known)}")


def check_parameter(name: str, value: Any, file: str, field: str, law: str = DEFAULT) -> float:
    """The value of parameter `name` in SI units, refused if the law does not accept it.

    `value` is a number, or a string with or without a unit; without one it is in the SI unit
    of `PARAMETER_UNITS`.  `file` and `field` are where the user wrote it, for the `InputError`.
    """
    entry = entry_of(name, file, field, law)
    try:
        number = number_or_quantity(value, entry.unit)
    except BadValue as bad:
        raise InputError(file, field, bad.problem, entry.repair) from None
    if not entry.accepted(number):
        raise InputError(file, field, f"{name} {value} is out of range", entry.repair)
    return number


def read_text(path: Path) -> str:
    """The text of a regular UTF-8 file (a byte order mark is allowed), or a `BadValue`."""
    try:
        if path.is_dir():
            raise BadValue("this is a folder", "give the path of a file inside it")
        if not path.is_file():
            raise BadValue("no such file", "check the path for a typing error")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise BadValue("this is not UTF-8 text", "save it as plain text in UTF-8") from None
    except OSError as error:
        raise BadValue(f"it cannot be read ({error.strerror})", "check its permissions") from None


def read_file(path: Path) -> str:
    """The same, or an `InputError` that names the file."""
    try:
        return read_text(path)
    except BadValue as bad:
        raise bad.at(str(path), "") from None


def read_toml(path: Path) -> dict[str, Any]:
    """What the lab file at `path` says, unchecked; `InputError` where it is no TOML."""
    try:
        return tomllib.loads(read_file(path))
    except (ValueError, RecursionError) as error:
        reason = str(error) or "nested too deeply"
        raise InputError(str(path), "", f"not valid TOML: {reason}", "correct that line") from None


def validated(kind: type[Checked], raw: Any, file: str, field: str = "") -> Checked:
    """A table of a lab file; `InputError` for the first thing wrong."""
    try:
        return kind.model_validate(raw)
    except BadValue as bad:
        raise bad.at(file, field) from None
    except ValidationError as error:
        raise _explain(error.errors()[0]).at(file, field) from None


def _explain(error: ErrorDetails) -> BadValue:
    """What pydantic refused, in our words, with the dotted name of the field."""
    name = ""
    for part in error["loc"]:
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    name = name.lstrip(".")
    if error["type"] == "value_error":  # only our own `BadValue` arrives as this type
        bad = error.get("ctx", {})["error"]
        joint = "" if bad.name.startswith("[") else "."
        return BadValue(bad.problem, bad.repair, f"{name}{joint}{bad.name}".strip("."))
    message = error["msg"].replace("Input should be", "it should be")
    return BadValue(f"{shown(error['input'])} is not accepted", message, name)
