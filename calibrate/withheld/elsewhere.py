"""Labels in our words and units, whoever made them, and how visible what they hide is.

Labels of another code state strengths of its own realisations; they are converted to ours.  How
visible effects are is computed after the seal is open, for scores by signal-to-noise only: from
the simulated changes that a label holds, else from the bank.  What scatters between specimens
(`density_scatter`) is no gap of their mean: alone it is a kind of its own, of which "no gap" is
the right answer; beside an effect it is left out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.bank.description import Discrepancy, Ready
from calibrate.withheld.plan import SPECIMENS, Visibility, share_of
from calibrate.withheld.scores import SCATTER

PLATEN_FRICTION, DIAMETER = 0.3, 8e-3  # of those cases: coefficient, m
THEIRS = 3  # specimens of those cases
FEWEST_CHANGES = 2  # packings from which a signal-to-noise is told
FEWEST_POOLED = 5  # cases with an effect that tell its share

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
    seen = {
        name: _Seen.of(label, ready, discrepancy)
        for name, label in labels.items() if "snr" not in label and label["hidden"]
    }  # fmt: skip
    shares = _shares([one for one in seen.values() if one.pooled])
    told = {name: one.snr(shares) for name, one in seen.items()}
    return {
        name: label if "snr" in label else {**label, "snr": told.get(name, 0.0)}
        for name, label in labels.items()
    }


@dataclass(frozen=True, eq=False)
class _Seen:
    """What a label says of its effects' change: simulated with and without (n, m), as the bank
    predicts it (m,) if it knows them all, and as it was planned."""

    names: tuple[str, ...]
    visible: Visibility
    changes: np.ndarray
    predicted: np.ndarray | None
    planned: float

    @staticmethod
    def of(label: dict, ready: Ready, discrepancy: Discrepancy | None) -> "_Seen":
        strengths = {h["name"]: h["strength"] for h in label["hidden"]}
        design = ready.bank.design
        soil = {n: v for n, v in label.get("soil", {}).items() if n in design.soil_names}
        if "changes" not in label:
            soil.pop("rolling_friction", None)  # another law's
            strengths = {n: s for n, s in strengths.items() if n in design.effect_names}
        specimens = SPECIMENS if "changes" in label else THEIRS
        visible = Visibility(ready, {**design.centre, **soil}, specimens, discrepancy)
        known = bool(strengths) and set(strengths) <= set(design.effect_names)
        predicted = visible.change(strengths) if known else None
        changes = np.array(label.get("changes", []))
        return _Seen(tuple(sorted(strengths)), visible, changes, predicted,
                     label.get("planned_snr", 0.0))  # fmt: skip

    @property
    def pooled(self) -> bool:
        """Whether its simulated change helps to tell a share."""
        return self.predicted is not None and len(self.changes) >= FEWEST_CHANGES

    @property
    def effects(self) -> str:
        """With what cases it is pooled: the effect, or that there are two."""
        return self.names[0] if len(self.names) == 1 else "two"

    def snr(self, shares: dict[str, float]) -> float:
        if self.predicted is None:
            enough = len(self.changes) >= FEWEST_CHANGES
            return self.visible.realised(self.changes) if enough else self.planned
        if self.pooled:
            return self.visible.told(self.changes, self.predicted, shares[self.effects])
        return self.planned if len(self.changes) else self.visible.left(self.predicted)


def _shares(pooled: Sequence[_Seen]) -> dict[str, float]:
    """`share_of` by effects; that of all where few cases have them."""
    sums = [
        (one.effects, one.visible.scatter(one.changes), one.visible.away(one.changes, change))
        for one in pooled if (change := one.predicted) is not None
    ]  # fmt: skip
    found = {}
    for name in {name for name, _, _ in sums}:
        mine = [row for row in sums if row[0] == name]
        _, scatter, away = zip(*(mine if len(mine) >= FEWEST_POOLED else sums), strict=True)
        found[name] = share_of(scatter, away)
    return found
