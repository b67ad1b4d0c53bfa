"""LIGGGHTS 3.8: an input section for `model edinburgh`, its own EEPA, and for `model hertz`.

Types: 1 soil, 2 mould, 3 platen and base.  Include it after `create_box` (three types) or
`read_data`, before particles move; give walls the same models and their type.

The normal force is that of the calibrated law.  A soil that was calibrated with LIGGGHTS'
conventions (`jdem.materials.conventions`) is written one to one.  For others friction and rolling
are matched as far as they go: `tangential history` limits friction by mu |F_n| alone; `tan_luding`
adds the adhesive share k_adh d, which is EEPA's where the tensile exponent is 1, and its spring
takes the tangential multiplier; with slope and tensile exponent 1 it is therefore used, with the
rolling model that goes with it.

Hertz-Mindlin with and without linear cohesion is that of LIGGGHTS, one to one.
"""

from math import sqrt

from calibrate.core.errors import InputError
from calibrate.exporters.notes import (
    PRESSURE,
    comment,
    heading,
    overlap_under,
    scale_up,
    uncertainty,
)
from calibrate.exporters.source import Found
from jdem.materials.catalogue import EVERY
from jdem.materials.conventions import DEFAULT, FRICTION_VISCOSITY

NAME, FILE = "liggghts", "soil.liggghts"
HISTORY = "edinburgh tangential history rolling_friction epsd2"
LUDING = "edinburgh tangential tan_luding rolling_friction luding"
OWN = {"liggghts": LUDING, "liggghts_history": HISTORY}  # models of LIGGGHTS' own conventions
HERTZ = {  # laws that stand in the place of EEPA
    "hertz_mindlin": "hertz tangential history rolling_friction epsd2",
    "hertz_cohesion": "hertz tangential history cohesion sjkr rolling_friction epsd2",
}
TYPES = 3
KEPT = "atom_modify sort 0 0.0"  # LIGGGHTS' edinburgh loses its memory when spheres are sorted
_SOFTEST, _HARDEST = 5e6, 1e9  # Pa; beyond these LIGGGHTS wants to be told so
_LEAST_RESTITUTION = 0.05  # LIGGGHTS accepts more than this

_DIFFERENCES = {
    HISTORY: (
        "- friction is limited by mu |F_n| without the adhesive share: A COHESIVE BED IS WEAKER,",
        "  often by far; fit with --set tensile_exponent=1 if LIGGGHTS is where you want to go",
        "- the tangential spring is LIGGGHTS' own; tangential_multiplier {multiplier:.4g} has no",
        "  place",
        "- rolling resistance is a spring up to mu_r |F_n| R/2 on the relative spin; the",
        "  coefficient between particles is doubled here to give the limit mu_r |F_n| R",
    ),
    LUDING: (
        "- the tangential spring grows as sqrt(d); its factor is chosen to give it",
        "  {multiplier:.4g} k1 at the overlap under {pressure:.3g} Pa",
        "- rolling resistance is a spring on the relative spin, up to a limit that includes the",
        "  adhesive share; the coefficient between particles is doubled because LIGGGHTS' lever is",
        "  R/2",
    ),
}
_SAME = (
    "- nothing in friction and rolling: the soil was calibrated with these models",
    "- here kinks are rounded and the bed is damped a little: both are numerics",
)
_EVERY = (
    "- walls carry no surface energy, as in the calibration (unless wall_adhesion was set)",
    "coefficientAdhesionStiffness must be given but is not used (fixKc is off).",
    "Leave sorting off, and use one process: LIGGGHTS 3.8 turns the sign of edinburgh's plastic",
    "memory where two spheres change places in its lists, and the contact forgets its load.",
)
_HERTZ = (
    "- at slope exponent 1.5 LIGGGHTS' dashpot does not follow the overlap and is far stronger:",
    "  nothing rebounds",
)
_LUDING_CONSTANTS = {  # what tan_luding and luding want besides
    "FluidViscosity": 1.0,  # ratio of static to dynamic friction
    "FrictionViscosity": FRICTION_VISCOSITY,  # tangential over normal dashpot
    "coeffRollingStiffness": 1.0,  # rolling over tangential stiffness, over R*^2
    "coefficientRollingViscousDamping": 0.0,
}


def text(found: Found) -> str:
    """The input section; `InputError` for a law that LIGGGHTS has not, and for what `tan_luding`
    cannot follow."""
    found.check_law((DEFAULT, *HERTZ), NAME)
    notes = [*heading(found), "", *uncertainty(found), "", *scale_up(found), ""]
    if found.law in HERTZ:
        lines = [*_allowances(found), *_of_hertz(found)]
    else:
        _check(found)
        lines = [KEPT, *_allowances(found), *_properties(found)]
    lines += [f"pair_style gran model {model(found)}", "pair_coeff * *"]
    return comment([*notes, *_differences(found)]) + "\n".join(lines) + "\n"


def _check(found: Found) -> None:
    if found.conventions == "liggghts" and found["tensile_exponent"] != 1:
        value = f"{found['tensile_exponent']:g}"
        repair = "calibrate with 1, or without --conventions liggghts"
        raise InputError(
            found.origin, "tensile_exponent", f"{value}, but tan_luding knows 1 alone", repair
        )


def model(found: Found) -> str:
    """The contact models of the calibrated law, or those that come nearest to it."""
    if found.conventions in OWN | HERTZ:
        return (OWN | HERTZ)[found.conventions]
    linear = found["slope_exponent"] == 1 and found["tensile_exponent"] == 1
    return LUDING if linear else HISTORY


def young_modulus(found: Found) -> float:
    """Young's modulus that gives LIGGGHTS the calibrated k1, Pa.

    At n = 1 LIGGGHTS has k1 = 2 E* R*; another `stiffness_factor` c makes it c/2 of E.
    """
    if found.law in HERTZ:
        return found.young
    factor = found["stiffness_factor"] / 2 if found["slope_exponent"] == 1 else 1.0
    return factor * found.young


def friction_stiffness(found: Found) -> float:
    """coeffFrictionStiffness: the multiplier itself where that is what it was fitted as; else
    multiplier x sqrt(R*/d) at the overlap d under PRESSURE, so that the factor times
    2 E* sqrt(R* d) is the multiplier times 2 E* R* there."""
    if found.conventions in OWN:
        return found["tangential_multiplier"]
    radius = found.diameter / 4  # effective
    return found["tangential_multiplier"] * sqrt(radius / overlap_under(PRESSURE, found))


def _allowances(found: Found) -> list[str]:
    young = young_modulus(found)
    if young < _SOFTEST:
        return ["soft_particles yes"]
    return ["hard_particles yes"] if young > _HARDEST else []


def _of_hertz(found: Found) -> list[str]:
    """The properties of `model hertz`."""
    sliding = tuple(found[n] for n in ("static_friction", "wall_friction", "platen_friction"))
    of_pairs = {
        _called("restitution"): (max(found["restitution"], 1.001 * _LEAST_RESTITUTION),) * TYPES,
        _called("static_friction"): sliding,
        _called("rolling_friction"): (found["rolling_friction"],) * TYPES,
    }
    if found.law == "hertz_cohesion":
        of_pairs[_called("cohesion")] = (found["cohesion"], 0.0, 0.0)
    return [
        _property(_called("shear_modulus"), "peratomtype", [found.young] * TYPES),
        _property(_called("poisson_ratio"), "peratomtype", [found["poisson_ratio"]] * TYPES),
        *(_per_pair(name, values) for name, values in of_pairs.items()),
    ]


def _properties(found: Found) -> list[str]:
    """One `fix property/global` for each property."""
    restitution = max(found["restitution"], 1.001 * _LEAST_RESTITUTION)
    rolling = found["rolling_friction"]
    between = rolling if found.conventions in OWN else 2 * rolling
    of_pairs = {
        _called("restitution"): (restitution,) * TYPES,
        _called("static_friction"): (
            found["static_friction"],
            found["wall_friction"],
            found["platen_friction"],
        ),
        _called("rolling_friction"): (between, rolling, rolling),
        _called("plasticity_ratio"): (found.stiffness_ratio,) * TYPES,
        "coefficientAdhesionStiffness": (0.0,) * TYPES,
        _called("pull_off_force"): (found["pull_off_force"],) * TYPES,
        _called("surface_energy"): (found.surface_energy, 0.0, 0.0),
    }
    if model(found) == LUDING:
        of_pairs[_called("tangential_multiplier")] = (friction_stiffness(found),) * TYPES
        of_pairs |= {name: (value,) * TYPES for name, value in _LUDING_CONSTANTS.items()}
    return [
        _property(_called("shear_modulus"), "peratomtype", [young_modulus(found)] * TYPES),
        _property(_called("poisson_ratio"), "peratomtype", [found["poisson_ratio"]] * TYPES),
        *(_per_pair(name, values) for name, values in of_pairs.items()),
        _property(_called("slope_exponent"), "scalar", [found["slope_exponent"]]),
        _property(_called("tensile_exponent"), "scalar", [found["tensile_exponent"]]),
    ]


def _called(name: str) -> str:
    """LIGGGHTS' property that a parameter decides."""
    return EVERY[name].names["LIGGGHTS"]


def _per_pair(name: str, with_type: tuple[float, ...]) -> str:
    """A symmetric matrix: soil with soil, mould, platen; walls never meet, so their entries
    repeat those of the soil with that wall."""
    soil, mould, platen = with_type
    matrix = [soil, mould, platen, mould, mould, mould, platen, mould, platen]
    return _property(name, f"peratomtypepair {TYPES}", matrix)


def _property(name: str, kind: str, values: list[float]) -> str:
    numbers = " ".join(f"{value:.7g}" for value in values)
    return f"fix soil_{name} all property/global {name} {kind} {numbers}"


def _differences(found: Found) -> list[str]:
    """What the section does not carry over, and how walls are written."""
    chosen = model(found)
    return [
        "What differs from the law that was calibrated (docs/export.md has the numbers):",
        *_told(found, chosen),
        "Types: 1 soil, 2 mould, 3 platen and base. Walls, for example:",
        f"  fix base all wall/gran model {chosen} primitive type 3 zplane 0.0",
        f"  fix mould all wall/gran model {chosen} primitive type 2 zcylinder 0.025 0. 0.",
    ]


def _told(found: Found, chosen: str) -> list[str]:
    """What differs, one line each."""
    if found.law in HERTZ:
        return [*_SAME, "- walls carry no cohesion, as in the calibration"]
    multiplier = found["tangential_multiplier"]
    known = _SAME if found.conventions in OWN else _DIFFERENCES[chosen]
    lines = [line.format(multiplier=multiplier, pressure=PRESSURE) for line in known]
    return [*lines, *(_HERTZ if found["slope_exponent"] == 1.5 else ()), *_EVERY]
