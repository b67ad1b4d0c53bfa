"""EDEM: a table with EDEM's own names and units for the soil's contact model, as CSV.

EDEM is not at hand here: the names are those of its user interface as the literature prints
them, and the table was never loaded into it.
"""

import csv
import io

from calibrate.exporters.notes import heading, scale_up, uncertainty, warned
from calibrate.exporters.source import Found
from jdem.materials.catalogue import parameters_of
from jdem.materials.conventions import DEFAULT

NAME, FILE = "edem", "soil_edem.csv"
COLUMNS = ("Section", "Parameter", "Value", "Unit", "Low 95 %", "High 95 %")

_SHOWN = (  # rows in EDEM's order
    "poisson_ratio",
    "shear_modulus",
    "restitution",
    "static_friction",
    "rolling_friction",
    "pull_off_force",
    "surface_energy",
    "gamma",
    "cohesion",
    "normal_stiffness",
    "shear_stiffness",
    "tensile_strength",
    "shear_strength",
    "radius_ratio",
    "yield_strength",
    "damping_factor",
    "plasticity_ratio",
    "slope_exponent",
    "tensile_exponent",
    "tangential_multiplier",
    "wall_friction",
    "platen_friction",
)
_DENSITY = (
    "Solids Density is not a fitted parameter: choose it so that the bed has your bulk density"
)
_ROLLING = "rolling is resisted here by a spring up to mu_r R* N, and in EDEM by a torque mu_r R N"
_BONDS = (
    "bonds form here once, before the mould opens or the last test begins, across gaps up to a "
    "hundredth of a radius, and hold up to a fifth: a contact radius of 1.1 radii comes near",
    "internal_friction and moment_share have no counterpart in Bonding V2: keep them at 0 and 1",
)
_OTHER = {  # laws beside EEPA: EDEM's model, and what differs
    "hertz_mindlin": ("Hertz-Mindlin (no slip)", _ROLLING),
    "hertz_cohesion": ("Hertz-Mindlin (no slip) and Linear Cohesion", _ROLLING),
    "hysteretic_cohesion": ("Hysteretic Spring and Linear Cohesion", _ROLLING),
    "jkr": (
        "Hertz-Mindlin with JKR V2",
        _ROLLING,
        "friction is limited here by mu (F_n + 2 F_c), and in EDEM by mu times the repulsive part",
    ),
    "parallel_bond": ("Hertz-Mindlin (no slip) with Bonding V2", _ROLLING, *_BONDS),
}
_CAUTIONS = (
    "Slope Exp 1: k1 = {factor:.4g} E* R* was calibrated; compare one contact in EDEM with "
    "`calibrate contact` before use, because programs differ in this factor",
    "EEPA between soil and geometry: surface energy 0, other values as soil - soil",
    _DENSITY,
)


def text(found: Found) -> str:
    """The table; first what the fit warned of, last notes."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for line in warned(found):
        writer.writerow(["Warning", line, "", "", "", ""])
    known = parameters_of(found.conventions)
    for ours in (name for name in _SHOWN if name in known):
        section, name = known[ours].names["EDEM"].split(" / ")
        factor = found.at_size(ours)
        low, high = found.intervals.get(ours, (None, None))
        ends = ["" if end is None else f"{factor * end:.6g}" for end in (low, high)]
        writer.writerow([section, name, f"{factor * found[ours]:.7g}", known[ours].unit, *ends])
    for line in [*heading(found), *uncertainty(found), *scale_up(found), *_cautions(found)]:
        writer.writerow(["Note", line, "", "", "", ""])
    return out.getvalue()


def _cautions(found: Found) -> list[str]:
    """What to know of EDEM's model, and what differs from ours."""
    if found.law == DEFAULT:
        return [line.format(factor=found["stiffness_factor"]) for line in _CAUTIONS]
    model, *differences = _OTHER[found.law]
    walls = "between soil and geometry no adhesion acts; the other values are as soil - soil"
    return [f"EDEM's model: {model}", *differences, walls, _DENSITY]
