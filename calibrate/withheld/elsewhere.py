"""Labels in our words and units, whoever made them, and how visible what they hide is.

Labels of another code state strengths of its own realisations; they are converted to ours.  How
visible effects are is computed after the seal is open, for scores by signal-to-noise only: from
the simulated changes that a label holds, else from the bank.  What scatters between specimens
(`density_scatter`) is no gap of their mean: alone it is a kind of its own, of which "no gap" is
the right answer; beside an effect it is left out.
"""

import math
from collections.abc import Callable

import numpy as np

from calibrate.bank.description import Discrepancy, Ready
from calibrate.withheld.plan import SPECIMENS, Visibility
from calibrate.withheld.scores import SCATTER

PLATEN_FRICTION, DIAMETER = 0.3, 8e-3  # of those cases: coefficient, m
THEIRS = 3  # specimens of those cases
FEWEST_CHANGES = 2  # packings from which a signal-to-noise is told

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
    """The labels with a signal-to-noise where they lack one, with the mismatch known as it is to
    the diagnosis."""
    return {
        name: label if "snr" in label else {**label, "snr": _snr(label, ready, discrepancy)}
        for name, label in labels.items()
    }


def _snr(label: dict, ready: Ready, discrepancy: Discrepancy | None) -> float:
    hidden = {h["name"]: h["strength"] for h in label["hidden"]}
    if not hidden:
        return 0.0
    ours = {n: s for n, s in hidden.items() if n in ready.bank.design.effect_names}
    soil = {n: v for n, v in label.get("soil", {}).items() if n in ready.bank.design.soil_names}
    if "changes" not in label:
        soil.pop("rolling_friction", None)  # another law's
        everywhere = {**ready.bank.design.centre, **soil}
        visible = Visibility(ready, everywhere, THEIRS, discrepancy)
        return visible.left(visible.change(ours)) if ours else 0.0
    changes = np.array(label["changes"])
    if len(changes) < FEWEST_CHANGES:
        return label["planned_snr"]
    visible = Visibility(ready, soil, SPECIMENS, discrepancy)
    predicted = visible.change(ours) if len(ours) == len(hidden) else None
    return visible.realised(changes, predicted)
