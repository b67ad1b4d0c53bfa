"""JSON: every parameter with unit and interval, and the surface energy at the wanted size."""

import json

from calibrate.exporters.notes import scale_up
from calibrate.exporters.source import UNITS, Found, in_order
from jdem.materials.conventions import DEFAULT

NAME, FILE = "json", "soil.json"
LAW = "EEPA (Thakur et al. 2014, Granular Matter 16, 383); docs/theory.md has the equations"

OTHER = "docs/parameters.md says whose it is"


def content(found: Found) -> dict:
    """The export as plain data."""
    return {
        "soil": found.soil,
        "origin": found.origin,
        "warnings": list(found.warnings),
        "met": not found.missed,
        "law": LAW if found.law == DEFAULT else f"{found.law}; {OTHER}",
        "parameters": {name: _parameter(found, name) for name in in_order(found.values)},
        "particles": {
            "diameter_m": found.diameter,
            "calibrated_with_diameter_m": found.fitted_diameter,
            **_derived(found),
        },
        "scale_up": " ".join(line.strip() for line in scale_up(found)),
    }


def _derived(found: Found) -> dict[str, float]:
    """What follows from the parameters that the law has."""
    derived = {}
    if found.sized is not None:
        derived["surface_energy_j_m2"] = found.surface_energy
    if "shear_modulus" in found.values:
        derived["young_modulus_pa"] = found.young
    if "plasticity_ratio" in found.values:
        derived["unloading_over_loading_stiffness"] = found.stiffness_ratio
    return derived


def text(found: Found) -> str:
    """The export as JSON text."""
    return json.dumps(content(found), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _parameter(found: Found, name: str) -> dict:
    low, high = found.intervals.get(name, (None, None))
    return {
        "value": found[name],
        "unit": UNITS[name],
        "low_95": low,
        "high_95": high,
        "fitted": name in found.intervals,
    }
