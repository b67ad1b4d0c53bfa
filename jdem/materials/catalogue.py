"""The catalogue of parameters: every entry of every law, by name, and which law has which.

A law's entries stand in its own file; those of walls, which have no law of their own, stand
here.  A new normal law is one file in `jdem/laws` and one line in LAWS; a law that stands in the
place of all of EEPA is one of `contact_laws.BED_LAWS`.  Whatever lists, reads, bounds or exports
parameters takes it from here.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from jdem.core.parameter import NOT_NEGATIVE, POSITIVE, Parameter, Search
from jdem.core.quantity import Real, as_quantity
from jdem.laws import eepa, friction, hysteretic
from jdem.materials.contact_laws import ATTRACTING, BED_LAWS, CONTACT_LAWS, SHRINKING, SIZED
from jdem.materials.conventions import CONVENTIONS
from jdem.materials.soil import NormalLaw, SoilParameters
from jdem.mechanics import dashpot, elasticity


class Listed(NamedTuple):
    """A normal law that a soil may choose, and its own parameters."""

    law: NormalLaw
    parameters: tuple[Parameter, ...]


LAWS: dict[str, Listed] = {
    "eepa": Listed(eepa.EEPA, eepa.PARAMETERS),
    "hysteretic": Listed(hysteretic.HystereticSpring, hysteretic.PARAMETERS),
}

WALLS = (
    Parameter(
        name="wall_friction",
        symbol="mu_w",
        label="friction on the mould",
        accepted=NOT_NEGATIVE,
        repair="give 0 or a positive number, such as 0.2",
        search=Search(0.01, 1.0, 1.0),
        names={
            "EDEM": "Interaction soil - mould / Coefficient of Static Friction",
            "LIGGGHTS": "coefficientFriction",
        },
    ),
    Parameter(
        name="platen_friction",
        symbol="mu_p",
        label="friction on platen and base",
        accepted=NOT_NEGATIVE,
        repair="give 0 or a positive number, such as 0.2",
        search=Search(0.01, 1.5, 1.0),
        names={
            "EDEM": "Interaction soil - platen, base / Coefficient of Static Friction",
            "LIGGGHTS": "coefficientFriction",
        },
    ),
    Parameter(
        name="wall_adhesion",
        symbol="w",
        label="adhesion on walls over that of the soil",
        accepted=NOT_NEGATIVE,
        repair="run the fit again",
        free=False,
    ),
)
SIZES = (
    Parameter(
        name="reference_diameter",
        symbol="d_0",
        label="diameter at which the surface energy is stated",
        unit="m",
        accepted=POSITIVE,
        repair="run the fit again",
        free=False,
    ),
)

_ORDER = (  # of tables; what is not named here comes after it
    "restitution",
    "static_friction",
    "rolling_friction",
    "surface_energy",
    "gamma",
    "cohesion",
    "tensile_strength",
    "shear_strength",
    "internal_friction",
    "moment_share",
    "normal_stiffness",
    "shear_stiffness",
    "radius_ratio",
    "yield_strength",
    "damping_factor",
    "plasticity_ratio",
    "tensile_exponent",
    "tangential_multiplier",
    "shear_modulus",
    "pull_off_force",
    "slope_exponent",
    "wall_friction",
    "platen_friction",
    "poisson_ratio",
    "reference_diameter",
    "wall_adhesion",
)


def catalogue(law: str = "eepa") -> dict[str, Parameter]:
    """All entries of a soil with this normal law (a key of LAWS), by name."""
    shared = (dashpot, friction, elasticity)
    entries = [*LAWS[law].parameters, *WALLS, *SIZES]
    entries += [entry for module in shared for entry in module.PARAMETERS]
    return _in_order(entries)


def _in_order(entries: Iterable[Parameter]) -> dict[str, Parameter]:
    """Entries by name, in the order of tables."""
    found = {entry.name: entry for entry in entries}
    known = [name for name in _ORDER if name in found]
    return {name: found[name] for name in [*known, *(n for n in found if n not in _ORDER)]}


CATALOGUE = catalogue()


# ---------------------------------------------------------------- whole laws

WHOLE = tuple(name for name in BED_LAWS if name not in CONVENTIONS)  # in the place of all of EEPA
# At which gamma and stiffnesses of bonds are stated unless said otherwise: publications have
# spheres of 2 to 10 mm.
REFERENCE_DIAMETER = 5e-3  # m
SOIL = SoilParameters.__dataclass_fields__  # what every soil has a value of
_OF_BONDS = replace(SIZES[0], label="diameter at which stiffnesses of bonds are stated")


def parameters_of(law: str) -> dict[str, Parameter]:
    """All entries of a soil that follows a law of `BED_LAWS`, by name: EEPA's in any of its
    conventions, or a whole law's own and those of walls."""
    if law in CONVENTIONS:
        return CATALOGUE
    own = [*CONTACT_LAWS[law].parameters]
    names = [entry.name for entry in own]
    own += [CATALOGUE[n] for n in ("wall_friction", "platen_friction")]
    if "yield_strength" not in names:  # which stands for the elastic constants
        own += [CATALOGUE[n] for n in ("shear_modulus", "poisson_ratio")]
    own += [CATALOGUE["wall_adhesion"]] * any(name in names for name in ATTRACTING)
    own += [CATALOGUE["reference_diameter"]] * any(name in names for name in SIZED)
    own += [_OF_BONDS] * any(name in names for name in SHRINKING)
    return _in_order(own)


# All entries of all laws; one that EEPA has too is EEPA's.
EVERY = _in_order(e for law in (*WHOLE, "eepa") for e in parameters_of(law).values())


def needed_by(law: str) -> tuple[str, ...]:
    """Parameters of a law of `BED_LAWS` that have no usual value."""
    if law in CONVENTIONS:
        return ()
    return tuple(CONTACT_LAWS[law].missing({name: 0.0 for name in SOIL}))


def soil_of(law: str, **values: Real) -> SoilParameters:
    """A soil that follows a law.

    Args:
        law: a name of `BED_LAWS`.
        values: parameters by name, SI; those that every soil has may be left out.

    Returns:
        The soil.  `gamma` and stiffnesses of bonds are stated at `reference_diameter`, 5 mm unless
        given.

    Raises:
        ValueError: a parameter is not the law's, or one is missing.

    Example:
        >>> soil = soil_of("jkr", gamma=2.0, shear_modulus=5e6)
    """
    known, given = parameters_of(law), dict(values)
    if strange := [name for name in given if name not in known]:
        raise ValueError(f"{law} has no {strange[0]}; give some of {', '.join(known)}")
    if missing := [name for name in needed_by(law) if name not in given]:
        raise ValueError(f"{law} needs {missing[0]}; give a value")
    if law in CONVENTIONS:
        shared: dict[str, Any] = given
        return SoilParameters(conventions=BED_LAWS[law], **shared)
    usual = {name: x for name, x in CONTACT_LAWS[law].defaults.items() if name not in SOIL}
    if "reference_diameter" in known:
        usual = {**usual, "reference_diameter": REFERENCE_DIAMETER}
    every = {**usual, **given}
    further = {name: as_quantity(every.pop(name)) for name in known if name not in SOIL}
    shared = every
    return SoilParameters(conventions=BED_LAWS[law], further=further, **shared)


def law_of(soil: SoilParameters) -> str | None:
    """The name of a soil's law in `BED_LAWS`; None where it has none there."""
    return next((name for name, build in BED_LAWS.items() if build is soil.conventions), None)


def own_values(soil: SoilParameters) -> Mapping[str, Real]:
    """A soil's parameters by name (SI), those alone that its law has."""
    law, values = law_of(soil), soil.values()
    return {name: values[name] for name in parameters_of(law)} if law in WHOLE else values


def soil_with(law: str, **values: Real) -> SoilParameters:
    """A soil with this normal law (a key of LAWS) and these values, by name, SI.

    Parameters of the law that a soil without it has not are in the middle of where a fit looks
    for them unless given, or 0 where it never does.
    """
    fields = SoilParameters.__dataclass_fields__
    own = [entry for entry in LAWS[law].parameters if entry.name not in fields]
    further = {e.name: as_quantity(values.pop(e.name, _middle(e))) for e in own}
    shared: dict[str, Any] = values
    return SoilParameters(law=LAWS[law].law, further=further, **shared)


def _middle(entry: Parameter) -> float:
    return 0.0 if entry.search is None else (entry.search.low * entry.search.high) ** 0.5
