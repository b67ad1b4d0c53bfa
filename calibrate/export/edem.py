"""EDEM: a table with EDEM's own names and units for the EEPA model, as CSV.

EDEM is not at hand here: the names are those of its user interface as the literature prints
them, and the table was never loaded into it.
"""

import csv
import io

from calibrate.export.notes import heading, scale_up, uncertainty
from calibrate.export.source import Found

COLUMNS = ("Section", "Parameter", "Value", "Unit", "Low 95 %", "High 95 %")

_SOIL, _MODEL = "Interaction soil - soil", "EEPA model soil - soil"
_ROWS = (  # section, EDEM's name, ours, unit
    ("Bulk material", "Poisson's Ratio", "poisson_ratio", ""),
    ("Bulk material", "Shear Modulus", "shear_modulus", "Pa"),
    (_SOIL, "Coefficient of Restitution", "restitution", ""),
    (_SOIL, "Coefficient of Static Friction", "static_friction", ""),
    (_SOIL, "Coefficient of Rolling Friction", "rolling_friction", ""),
    (_MODEL, "Constant Pull-Off Force", "pull_off_force", "N"),
    (_MODEL, "Surface Energy", "surface_energy", "J/m^2"),
    (_MODEL, "Contact Plasticity Ratio", "plasticity_ratio", ""),
    (_MODEL, "Slope Exp", "slope_exponent", ""),
    (_MODEL, "Tensile Exp", "tensile_exponent", ""),
    (_MODEL, "Tangential Stiff Multiplier", "tangential_multiplier", ""),
    ("Interaction soil - mould", "Coefficient of Static Friction", "wall_friction", ""),
    ("Interaction soil - platen, base", "Coefficient of Static Friction", "platen_friction", ""),
)
_CAUTIONS = (
    "Slope Exp 1: k1 = {factor:.4g} E* R* was calibrated; compare one contact in EDEM with "
    "`calibrate contact` before use, because programs differ in this factor",
    "EEPA between soil and geometry: surface energy 0, other values as soil - soil",
    "Solids Density is not a fitted parameter: choose it so that the bed has your bulk density",
)


def text(found: Found) -> str:
    """The table; its last rows are notes."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for section, name, ours, unit in _ROWS:
        factor = found.scale if ours == "surface_energy" else 1.0
        low, high = found.intervals.get(ours, (None, None))
        ends = ["" if end is None else f"{factor * end:.6g}" for end in (low, high)]
        writer.writerow([section, name, f"{factor * found[ours]:.7g}", unit, *ends])
    cautions = [line.format(factor=found["stiffness_factor"]) for line in _CAUTIONS]
    for line in [*heading(found), *uncertainty(found), *scale_up(found), *cautions]:
        writer.writerow(["Note", line, "", "", "", ""])
    return out.getvalue()
