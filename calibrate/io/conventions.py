"""Whose conventions a lab's contact law follows, and which parameters these leave no choice.

    eepa                as published (Thakur et al. 2014)
    liggghts            LIGGGHTS 3.8: tangential tan_luding, rolling_friction luding
    liggghts_history    LIGGGHTS 3.8: tangential history, rolling_friction epsd2

`jdem.materials.conventions` has the laws, for slope exponent 1.  `tan_luding` knows the tensile
exponent 1 alone; with `history` the tangential multiplier has no effect.
"""

from collections.abc import Iterable, Mapping

from calibrate.core.errors import InputError, suggestion
from jdem.materials.conventions import CONVENTIONS

HELD = {
    "liggghts": {"tensile_exponent": 1.0, "slope_exponent": 1.0},
    "liggghts_history": {"tangential_multiplier": 1.0, "slope_exponent": 1.0},
}


def held_by(name: str, file: str, field: str) -> dict[str, float]:
    """What the conventions of this name hold; `InputError` where there are none."""
    if name not in CONVENTIONS:
        repair = suggestion(name, CONVENTIONS)
        raise InputError(file, field, f"no conventions are called '{name}'", repair)
    return HELD.get(name, {})


def check_values(name: str, values: Mapping[str, float | None], file: str, field: str) -> None:
    """Refuse values by name that these conventions do not leave (None: none is stated); `field`
    comes before the parameter's name."""
    for parameter, only in HELD.get(name, {}).items():
        if values.get(parameter) not in (None, only):
            raise _contradiction(name, parameter, only, file, field)


def check_free(name: str, free: Iterable[str], file: str, field: str) -> None:
    """Refuse to fit what these conventions hold."""
    names = tuple(free)
    for parameter, only in HELD.get(name, {}).items():
        if parameter in names:
            raise _contradiction(name, parameter, only, file, field)


def _contradiction(name: str, parameter: str, only: float, file: str, field: str) -> InputError:
    problem = f"conventions '{name}' leave {only:g} as the only value"
    return InputError(file, f"{field}{parameter}", problem, f"give {only:g}, or leave it out")
