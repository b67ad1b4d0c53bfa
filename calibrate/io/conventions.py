"""Which law a lab's contacts follow, in whose conventions, and which parameters these leave.

    eepa                as published (Thakur et al. 2014)
    liggghts            LIGGGHTS 3.8: tangential tan_luding, rolling_friction luding
    liggghts_history    LIGGGHTS 3.8: tangential history, rolling_friction epsd2

`jdem.materials.conventions` has these, EEPA's, for slope exponent 1.  `tan_luding` knows the
tensile exponent 1 alone; with `history` the tangential multiplier has no effect.  Other laws
(`jdem.materials.contact_laws`) have no conventions, and one name says all: a lab keeps its law's
where it keeps its conventions', so that whoever knows conventions by name refuses laws that it
does not know.
"""

from collections.abc import Iterable, Mapping

from calibrate.core.errors import InputError, shown, suggestion
from jdem.materials.catalogue import WHOLE, needed_by, parameters_of
from jdem.materials.conventions import CONVENTIONS, DEFAULT

LAWS = (DEFAULT, *WHOLE)
HELD = {
    "liggghts": {"tensile_exponent": 1.0, "slope_exponent": 1.0},
    "liggghts_history": {"tangential_multiplier": 1.0, "slope_exponent": 1.0},
}


def chosen(law: str, conventions: str, stated: bool, file: str) -> str:
    """The name under which a lab keeps its law and its conventions, of which the latter may have
    been `stated`; `InputError` where there is no such law, or one without conventions."""
    if law not in LAWS:
        repair = f'give conventions = "{law}"' if law in CONVENTIONS else suggestion(law, LAWS)
        raise InputError(file, "particles.law", f"no law is called {shown(law)}", repair)
    if law == DEFAULT:
        return conventions
    if stated:
        problem = f"the law '{law}' has no conventions, only '{DEFAULT}' has"
        repair = f'leave them out, or give law = "{DEFAULT}"'
        raise InputError(file, "particles.conventions", problem, repair)
    return law


def said(name: str) -> str:
    """The name that a lab keeps, in words."""
    if name in (DEFAULT, *WHOLE):
        return f"the law '{name}'"
    return f"the law '{DEFAULT}' in the conventions '{name}'"


def origin(name: str) -> dict[str, str]:
    """What results say of the name that a lab keeps."""
    return {"law": name} if name in WHOLE else {"conventions": name}


def check_eepa(name: str, file: str) -> None:
    """Refuse a lab that follows another law where only EEPA will do: a library of runs."""
    if name in WHOLE:
        problem = f"the library of runs is of the law '{DEFAULT}', and knows nothing of '{name}'"
        repair = f'simulate (calibrate simulate, fit, doe), or give law = "{DEFAULT}"'
        raise InputError(file, "particles.law", problem, repair)


def check_needed(name: str, values: Mapping[str, float | None], file: str) -> None:
    """Refuse a lab file that does not state what its law needs and nothing else knows."""
    for parameter in needed_by(name):
        if values.get(parameter) is None:
            problem = f"the law '{name}' needs {parameter}, which has no usual value"
            example = parameters_of(name)[parameter].repair
            raise InputError(file, f"parameters.{parameter}", problem, example)


def check_sized(name: str, diameter: float | None, file: str) -> None:
    """Refuse a reference diameter where the law states nothing at one."""
    if diameter is not None and "reference_diameter" not in parameters_of(name):
        problem = f"the law '{name}' states nothing at a diameter"
        raise InputError(file, "particles.reference_diameter", problem, "leave it out")


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
