"""Labels in one vocabulary and unit, whoever made them, and the visibility of what they hide.

Labels of another code state strengths of its own realisations; they are converted to ours.  How
visible effects are is computed after the seal is open, for scores by signal-to-noise only: from
the simulated changes that a label holds, else from the library.  What scatters between specimens
(`density_scatter`) is no gap of their mean: alone it is a kind of its own, of which "no gap" is
the right answer; beside an effect it is left out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from studies.sealed.plan import (
    SPECIMENS,
    USUAL,
    SpecimenSize,
    Visibility,
    relative_error,
)
from studies.sealed.scores import SCATTER

PLATEN_FRICTION, DIAMETER = 0.3, 8e-3  # of those cases: coefficient, m
THEIRS = 3  # specimens of those cases
FEWEST_CHANGES = 2  # packings from which a signal-to-noise is estimated
FEWEST_POOLED = 5  # cases with an effect from which the error of its prediction is estimated

# their name -> our name, and their strength in our unit
CONVERSIONS: dict[str, tuple[str, Callable[[float], float]]] = {
    "frame_compliance": ("load_frame_compliance", lambda mm_per_kn: 1e-6 * mm_per_kn),
    "seating": ("seating_gap", lambda mm: 1e-3 * mm),
    "load_cell_drift": ("load_cell_drift", lambda n_per_h: n_per_h / 3600),
    "platen_friction": ("platen_friction", lambda factor: PLATEN_FRICTION * (_times(factor) - 1)),
    "capillary_tension": ("capillary_tension", lambda n_per_m: n_per_m / DIAMETER),
    "cementation": ("cementation", lambda n: n / DIAMETER**2),
    "second_test_strength": ("second_test_factor", math.expm1),
}
KINDS = {"library": "single"}
PAIR = "two"  # of cases with two effects, pooled whatever these are


def normalised(label: dict) -> dict:
    """A label with the keys that scoring reads, whoever made it."""
    hidden = [_ours(entry) for entry in label.get("hidden") or label.get("effects", [])]
    kind = KINDS.get(label["kind"], label["kind"])
    moving = [entry for entry in hidden if entry["name"] != "density_scatter"]
    if len(moving) < len(hidden):
        kind = "single" if moving else SCATTER
    return {**label, "kind": kind, "hidden": moving or hidden}


def _ours(entry: dict) -> dict:
    name, convert = CONVERSIONS.get(entry["name"], (entry["name"], float))
    if "unit" not in entry:  # a label of our own
        return dict(entry)
    return {"name": name, "strength": convert(entry["strength"])}


def _times(factor: float) -> float:
    """What a factor of theirs multiplies by: below 0 it says how many times less."""
    return factor if factor > 0 else -1 / factor


def with_visibility(
    labels: dict[str, dict], emulated: EmulatedLibrary, discrepancy: ModelDiscrepancy | None
) -> dict[str, dict]:
    """The labels with a signal-to-noise where they lack one, with the model discrepancy that the
    diagnosis uses."""
    changes_by_case = {
        name: EffectChange.of(label, emulated, discrepancy)
        for name, label in labels.items() if "snr" not in label and label["hidden"]
    }  # fmt: skip
    errors = errors_of([one for one in changes_by_case.values() if one.both])
    expected_snr = {name: one.snr(errors) for name, one in changes_by_case.items()}
    return {
        name: label if "snr" in label else {**label, "snr": expected_snr.get(name, 0.0)}
        for name, label in labels.items()
    }


@dataclass(frozen=True, eq=False)
class EffectChange:
    """The change by a label's effects, of the features that all its simulations have: simulated
    with and without (n, m), and as the library of runs predicts it (m,) if it holds them all;
    planned: signal-to-noise, none in labels of another code."""

    effects: str
    visible: Visibility
    changes: np.ndarray
    predicted: np.ndarray | None
    planned: float | None

    @staticmethod
    def of(
        label: dict, emulated: EmulatedLibrary, discrepancy: ModelDiscrepancy | None
    ) -> "EffectChange":
        strengths, own = {h["name"]: h["strength"] for h in label["hidden"]}, "changes" in label
        size = SpecimenSize(**label["size"]) if "size" in label else USUAL
        if "conventions" in label:
            emulated = emulated.for_lab(size.lab().following(label["conventions"]))
        design, soil = emulated.library.design, label.get("soil", {})
        if not own:  # another code's: without conventions, its rolling friction is another law's
            other = () if "conventions" in label else ("rolling_friction",)
            alike = [n for n in design.soil_names if n in soil and n not in other]
            soil = {**design.centre, **{n: soil[n] for n in alike}}
            strengths = {n: s for n, s in strengths.items() if n in design.effect_names}
        soil = {n: soil[n] for n in design.soil_names}
        changes, seen = _on_shared_features(np.array(label.get("changes", []), float))
        visible = Visibility(emulated, soil, SPECIMENS if own else THEIRS, discrepancy, size, seen)
        in_library = bool(strengths) and set(strengths) <= set(design.effect_names)
        return EffectChange(
            PAIR if len(strengths) > 1 else "".join(strengths), visible,
            changes, visible.change(strengths) if in_library else None,
            label.get("planned_snr"),
        )  # fmt: skip

    @property
    def both(self) -> bool:
        """Whether the error of the prediction can be estimated."""
        return self.predicted is not None and len(self.changes) >= FEWEST_CHANGES

    def parts(self) -> tuple[float, float, float]:
        """Squared lengths of the predicted change, of what packings scatter its mean by, and of the
        mean less the prediction."""
        predicted = np.asarray(self.predicted)
        away = self.visible.length(self.changes.mean(axis=0) - predicted)
        return self.visible.length(predicted), self.visible.scatter(self.changes), away

    def snr(self, errors: dict[str, float]) -> float:
        """Signal-to-noise; without enough simulations as planned, else as predicted."""
        if len(self.changes) >= FEWEST_CHANGES:
            if self.predicted is None:
                return self.visible.realised(self.changes)
            return self.visible.expected_snr(self.changes, self.predicted, errors[self.effects])
        if self.planned is not None:
            return self.planned
        return 0.0 if self.predicted is None else self.visible.left(self.predicted)


def _on_shared_features(changes: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Changes (n, m) of the features that all of them have, and which of the m these are (None:
    there are no changes)."""
    if not changes.size:
        return changes, None
    seen = np.asarray(np.isfinite(changes).all(axis=0))
    return (changes[:, seen], seen) if seen.any() else (np.zeros((0, 0)), None)


def errors_of(changes_by_case: Sequence[EffectChange]) -> dict[str, float]:
    """`relative_error` by effect; that of all where few cases have it, none where these are few."""
    parts = [(one.effects, one.parts()) for one in changes_by_case]
    found = {}
    for name in {name for name, _ in parts}:
        mine = [part for other, part in parts if other == name]
        some = mine if len(mine) >= FEWEST_POOLED else [part for _, part in parts]
        enough = len(some) >= FEWEST_POOLED
        found[name] = relative_error(*zip(*some, strict=True)) if enough else 0.0
    return found
