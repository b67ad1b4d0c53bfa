"""Labels of cases whose reality another code computed, in our words and units.

Such labels state strengths of that code's own realisations.  They are converted to ours, and how
visible they are is computed from the bank after the seal is open: for scores by
signal-to-noise only.  What scatters between specimens (`density_scatter`) is no gap of their mean:
alone it is a kind of its own, of which "no gap" is the right answer; beside an effect it is
left out.
"""

import math
from collections.abc import Callable

from calibrate.bank.description import Discrepancy, Ready
from calibrate.bank.design import LIMITS
from calibrate.withheld.plan import Visibility
from calibrate.withheld.scores import SCATTER

PLATEN_FRICTION, DIAMETER = 0.3, 8e-3  # of those cases: coefficient, m
SPECIMENS = 3

# their name -> our name, and their strength in our unit
OURS: dict[str, tuple[str, Callable[[float], float]]] = {
    "frame_compliance": ("load_frame_compliance", lambda mm_per_kn: 1e-6 * mm_per_kn),
    "seating": ("seating_gap", lambda mm: 1e-3 * mm),
    "load_cell_drift": ("load_cell_drift", lambda n_per_h: n_per_h / 3600),
    "platen_friction": ("platen_friction", lambda factor: PLATEN_FRICTION * (factor - 1)),
    "capillary_tension": ("capillary_tension", lambda n_per_m: n_per_m / DIAMETER),
    "cementation": ("cementation", lambda n: n / DIAMETER**2),
    "second_test_strength": ("second_test_factor", math.expm1),
}
KINDS = {"library": "single"}


def in_our_words(label: dict) -> dict:
    """A label with the keys that scoring reads, whoever made it."""
    hidden = [_ours(entry) for entry in label.get("hidden") or label.get("effects", [])]
    kind = KINDS.get(label["kind"], label["kind"])
    moving = [entry for entry in hidden if entry["name"] != "density_scatter"]
    if len(moving) < len(hidden):
        kind = "single" if moving else SCATTER
    return {**label, "kind": kind, "hidden": moving or hidden}


def _ours(entry: dict) -> dict:
    name, convert = OURS.get(entry["name"], (entry["name"], float))
    if "unit" not in entry:  # a label of our own
        return dict(entry)
    return {"name": name, "strength": convert(entry["strength"])}


def with_visibility(
    labels: dict[str, dict], ready: Ready, discrepancy: Discrepancy | None
) -> dict[str, dict]:
    """The labels with a signal-to-noise where they lack one."""
    missing = [n for n, label in labels.items() if "snr" not in label]
    if not missing:
        return labels
    return {
        name: label if "snr" in label else {**label, "snr": _snr(label, ready, discrepancy)}
        for name, label in labels.items()
    }


def _snr(label: dict, ready: Ready, discrepancy: Discrepancy | None) -> float:
    strengths = {h["name"]: h["strength"] for h in label["hidden"] if h["name"] in LIMITS}
    if not strengths:
        return 0.0
    soil = {**ready.bank.design.centre}
    known = {
        n: v for n, v in label.get("soil", {}).items() if n in soil and n != "rolling_friction"
    }
    return Visibility(ready, {**soil, **known}, SPECIMENS, discrepancy).snr(strengths)
