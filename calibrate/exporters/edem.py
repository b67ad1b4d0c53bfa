"""EDEM: a table with EDEM's own names and units for the EEPA model, as CSV.

EDEM is not at hand here: the names are those of its user interface as the literature prints
them, and the table was never loaded into it.
"""

import csv
import io

from calibrate.exporters.notes import heading, scale_up, uncertainty, warned
from calibrate.exporters.source import Found
from jdem.materials.catalogue import CATALOGUE

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
    "plasticity_ratio",
    "slope_exponent",
    "tensile_exponent",
    "tangential_multiplier",
    "wall_friction",
    "platen_friction",
)
_CAUTIONS = (
    "Slope Exp 1: k1 = {factor:.4g} E* R* was calibrated; compare one contact in EDEM with "
    "`calibrate contact` before use, because programs differ in this factor",
    "EEPA between soil and geometry: surface energy 0, other values as soil - soil",
    "Solids Density is not a fitted parameter: choose it so that the bed has your bulk density",
)


def text(found: Found) -> str:
    """The table; first what the fit warned of, last notes."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for line in warned(found):
        writer.writerow(["Warning", line, "", "", "", ""])
    for ours in _SHOWN:
        section, name = CATALOGUE[ours].names["EDEM"].split(" / ")
        factor = found.scale if ours == "surface_energy" else 1.0
        low, high = found.intervals.get(ours, (None, None))
        ends = ["" if end is None else f"{factor * end:.6g}" for end in (low, high)]
        writer.writerow([section, name, f"{factor * found[ours]:.7g}", CATALOGUE[ours].unit, *ends])
    cautions = [line.format(factor=found["stiffness_factor"]) for line in _CAUTIONS]
    for line in [*heading(found), *uncertainty(found), *scale_up(found), *cautions]:
        writer.writerow(["Note", line, "", "", "", ""])
    return out.getvalue()
