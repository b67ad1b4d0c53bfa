"""The catalogue of parameters: every entry of every law, by name, and the normal laws by name.

A law's entries stand in its own file; those of walls, which have no law of their own, stand
here.  A new normal law is one file in `jdem/laws` and one line in LAWS.  Whatever lists, reads,
bounds or exports parameters takes it from here.
"""

from typing import Any, NamedTuple

from jdem.core.parameter import NOT_NEGATIVE, POSITIVE, Parameter, Search
from jdem.core.quantity import Real, as_quantity
from jdem.laws import eepa, friction, hysteretic
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
    found = {entry.name: entry for entry in entries}
    known = [name for name in _ORDER if name in found]
    return {name: found[name] for name in [*known, *(n for n in found if n not in _ORDER)]}


CATALOGUE = catalogue()


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
