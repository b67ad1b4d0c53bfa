"""Reading a lab file, and the parameter values that a contact law accepts.

A lab file is TOML; `calibrate.io.tables` says which tables it has.  Whatever is wrong with it
becomes one `InputError` that names file, field and repair.  `calibrate.io.lab` builds the
plain result.
"""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from calibrate.core.errors import BadValue, InputError, shown, suggestion
from calibrate.core.units import number_or_quantity
from calibrate.io.tables import LabTables

# Parameter names and the SI unit of each ("" for a pure number).
PARAMETER_UNITS: dict[str, str] = {
    "restitution": "",
    "static_friction": "",
    "rolling_friction": "",
    "surface_energy": "J/m^2",
    "plasticity_ratio": "",
    "tensile_exponent": "",
    "tangential_multiplier": "",
    "shear_modulus": "Pa",
    "pull_off_force": "N",
    "slope_exponent": "",
    "wall_friction": "",
    "platen_friction": "",
}

# For each parameter: does the law accept this value (in SI), and what to say when it does not.
PARAMETER_RANGES: dict[str, tuple[Callable[[float], bool], str]] = {
    "restitution": (lambda e: 0 < e < 1, "give a number above 0 and below 1, such as 0.5"),
    "static_friction": (lambda mu: mu >= 0, "give 0 or a positive number, such as 0.6"),
    "rolling_friction": (lambda mu: mu >= 0, "give 0 or a positive number, such as 0.3"),
    "surface_energy": (lambda g: g >= 0, 'give 0 or a positive value, such as "17 J/m^2"'),
    "plasticity_ratio": (lambda p: 0 < p < 1, "give a number above 0 and below 1, such as 0.4"),
    "tensile_exponent": (lambda x: 0.5 <= x <= 5, "give a number from 0.5 to 5, such as 2"),
    "tangential_multiplier": (lambda k: k > 0, "give a positive number, such as 0.8"),
    "shear_modulus": (lambda g: g > 0, 'give a positive value, such as "12 MPa"'),
    "pull_off_force": (lambda f: f <= 0, 'give 0 or a negative (tensile) force, such as "0 N"'),
    "slope_exponent": (lambda n: n in (1, 1.5), "give 1 (linear) or 1.5 (Hertz)"),
    "wall_friction": (lambda mu: mu >= 0, "give 0 or a positive number, such as 0.2"),
    "platen_friction": (lambda mu: mu >= 0, "give 0 or a positive number, such as 0.2"),
}


def check_parameter(name: str, value: Any, file: str, field: str) -> float:
    """The value of parameter `name` in SI units, refused if no contact law accepts it.

    `value` is a number, or a string with or without a unit; without one it is in the SI unit
    of `PARAMETER_UNITS`.  `file` and `field` are where the user wrote it, for the `InputError`.
    """
    if name not in PARAMETER_UNITS:
        repair = suggestion(name, PARAMETER_UNITS)
        raise InputError(file, field, f"unknown parameter {shown(name)}", repair)
    accepted, repair = PARAMETER_RANGES[name]
    try:
        number = number_or_quantity(value, PARAMETER_UNITS[name])
    except BadValue as bad:
        raise InputError(file, field, bad.problem, repair) from None
    if not accepted(number):
        raise InputError(file, field, f"{name} {value} is out of range", repair)
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


def read_tables(path: Path) -> LabTables:
    """The checked tables of the lab file at `path`; `InputError` for the first thing wrong."""
    try:
        return LabTables.model_validate(tomllib.loads(read_text(path)))
    except BadValue as bad:
        raise bad.at(str(path), "") from None
    except ValidationError as error:
        raise _explain(error.errors()[0]).at(str(path), "") from None
    except (ValueError, RecursionError) as error:
        reason = str(error) or "nested too deeply"
        raise InputError(str(path), "", f"not valid TOML: {reason}", "correct that line") from None


def _explain(error: ErrorDetails) -> BadValue:
    """What pydantic refused, in our words, with the dotted name of the field."""
    name = ""
    for part in error["loc"]:
        name += f"[{part}]" if isinstance(part, int) else f".{part}"
    name = name.lstrip(".")
    if error["type"] == "value_error":  # only our own `BadValue` arrives as this type
        bad = error.get("ctx", {})["error"]
        return BadValue(bad.problem, bad.repair, f"{name}.{bad.name}".strip("."))
    message = error["msg"].replace("Input should be", "it should be")
    return BadValue(f"{shown(error['input'])} is not accepted", message, name)
