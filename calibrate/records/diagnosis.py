"""The result of `calibrate diagnose` as a record: the contract's keys, and what figures need.

`content` turns a diagnosis into plain data, `DiagnosisRecord` is that data read back.  Curves are
at the bank's size and aligned as features read them: confined ones from the displacement at half
the largest force on loading, unconfined ones from the seating force.
"""

from typing import Literal

import numpy as np
from pydantic import Field
from pydantic import model_validator as check
from scipy.optimize import isotonic_regression

from calibrate.discrepancy.comparison.compare import label
from calibrate.discrepancy.comparison.features import CONFINED, REFERENCE, Curves, Feature
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.discrepancy.library.further_tests import menu
from calibrate.records.base import Curve, Number, Origin, Record, Test

MOST_POINTS = 300  # of a curve that is kept to be drawn
Status = Literal["found", "trivial", "absent", "inconclusive"]


class Segment(Record):
    """Mean residual of a segment (measured minus simulated), over its standard error, and its
    share of the misfit."""

    test: Test
    segment: str
    gap: Number
    unit: str
    z: Number
    outside_band: bool
    share: Number
    share_interval: tuple[Number, Number]
    share_by_chance: Number


class Across(Record):
    """One test predicted from the other."""

    predicted: Test
    p_value: Number
    factor: Number
    factor_se: Number


class Effect(Record):
    """One effect by itself: one-step strength (SI), and whether it could have been seen."""

    name: str
    status: Status
    z: Number
    strength: Number
    standard_error: Number
    unit: str
    visibility: Number


class Which(Record):
    """Verdict, probabilities, classes."""

    verdict: str
    probability: dict[str, Number]
    probability_by_class: dict[str, Number]
    likely_set: list[str]
    alike: list[list[str]]
    absorbed_by_calibration: list[str]
    p_gap: Number
    p_left_after_best: Number
    effects: list[Effect]


class HowFar(Record):
    """Gap in scatters of a specimen, before and after, how much of it goes, and whether the data
    can show that much."""

    before: Number
    after: Number
    floor: Number
    shrinkage: Number
    interval: tuple[Number, Number]
    shown: bool = True  # files of earlier versions do not say
    shrinkage_left_out: Number
    ceiling: dict[str, Number]


class Offer(Record):
    """A further test with its cost (hours) and how far it separates the leading explanations."""

    name: str
    cost: Number
    separation: Number


class NextTest(Record):
    """The further test that separates the leading explanations best."""

    name: str
    separation_now: Number
    separation: Number
    settles: bool
    hardest_pair: tuple[str, str]
    predicted: dict[str, list[Number]]
    all: list[Offer]
    labels: list[str]
    deviation: list[Number]


class FeatureRow(Record):
    """One place on the curves: measured mean with the scatter of one specimen, the calibrated
    model without and with the best explanation, standard error of the first difference and the
    half-width of its simultaneous band; all in `unit`."""

    name: str
    test: Test
    segment: str
    kind: str
    abscissa: Number
    unit: str
    measured: Number
    scatter: Number
    base: Number
    best: Number
    error: Number
    band: Number


class Explanation(Record):
    """A class of effects with its probability and the strengths (SI) of its best member's fit."""

    label: str
    probability: Number
    strengths: dict[str, Number]


class Shift(Record):
    """Where calibration moved a base parameter: ln p over its prior deviation, and that."""

    name: str
    moved: Number
    prior_sd: Number


class Settings(Record):
    """How it was done."""

    bank: str
    simulations: int
    packings: int
    seed: int
    confined: int = Field(ge=0)
    unconfined: int = Field(ge=0)


class DiagnosisRecord(Origin):
    """Everything that figures and the report show."""

    where: list[Segment]
    across_tests: list[Across]
    which: Which
    how_far: HowFar | None
    next_test: NextTest | None
    features: list[FeatureRow]
    specimens: list[dict[Test, Curve]]
    specimen_weights: list[Number] = Field(default_factory=list)
    best: list[str]
    explanations: list[Explanation]
    base_parameters: list[Shift]
    amplitudes: dict[Test, Number]
    settings: Settings

    @check(mode="after")
    def _has_features(self) -> "DiagnosisRecord":
        if not self.features:
            raise ValueError("features are empty")
        return self

    @property
    def targets_only(self) -> bool:
        """Whether the laboratory gave numbers without curves."""
        return all(row.kind == "target" for row in self.features)


def content(diagnosis: Diagnosis, origin: dict) -> dict:
    """Plain data of a diagnosis; `origin` has the keys of `Origin` and `settings` with bank,
    simulations, packings and seed."""
    found = diagnosis.as_json()
    which, d = diagnosis.which, diagnosis.prepared.description
    moved = which.base.delta / d.prior_sd
    return {
        **origin,
        **found,
        "next_test": _labelled(diagnosis, found["next_test"]),
        "features": _features(diagnosis),
        "specimens": [_aligned(diagnosis, curves) for curves in diagnosis.found.specimens],
        "specimen_weights": diagnosis.measured.weight.tolist(),
        "best": [d.effect_names[k] for k in which.best],
        "explanations": _explanations(diagnosis),
        "base_parameters": [
            {"name": name, "moved": float(by), "prior_sd": float(sd)}
            for name, by, sd in zip(d.base_names, moved, d.prior_sd, strict=True)
        ],
        "amplitudes": {str(test): float(a) for test, a in which.noise.amplitudes.items()},
        "settings": {**origin["settings"], **_repeats(diagnosis)},
    }


def _repeats(diagnosis: Diagnosis) -> dict[str, int]:
    counts, features = diagnosis.found.measured.counts, diagnosis.found.measured.features
    return {
        test: int(
            max((c for c, f in zip(counts, features, strict=True) if f.test == test), default=0)
        )
        for test in ("confined", "unconfined")
    }


def _labelled(diagnosis: Diagnosis, found: dict | None) -> dict | None:
    """The proposed test with labels of what it would show, and their deviations."""
    if found is None:
        return None
    best = diagnosis.proposals[0]
    tests = menu(diagnosis.prepared.description, diagnosis.which.noise)
    labels = next((list(test.labels) for test in tests if test.name == best.name), [])
    return {**found, "labels": labels, "deviation": best.deviation.tolist()}


def _features(diagnosis: Diagnosis) -> list[dict]:
    which, place = diagnosis.which, diagnosis.where
    base = which.base.values
    best = which.refits[which.best].values if which.best else np.full(len(base), np.nan)
    scatter = np.sqrt(np.diag(which.noise.specimen))
    columns = (diagnosis.measured.mean, scatter, base, best, place.deviation, place.band)
    names = ("measured", "scatter", "base", "best", "error", "band")
    return [
        {
            **{
                key: getattr(feature, key)
                for key in ("name", "test", "segment", "kind", "abscissa")
            },
            "unit": feature.unit,
            **{name: float(column[i]) for name, column in zip(names, columns, strict=True)},
        }
        for i, feature in enumerate(diagnosis.measured.features)
    ]


def _explanations(diagnosis: Diagnosis) -> list[dict]:
    """Classes and pairs of classes, likeliest first, each with the strengths of the fit of its
    member (or pair) with the largest evidence, none where nothing was refitted."""
    which, classes = diagnosis.which, diagnosis.prepared.classes
    names, value = diagnosis.prepared.description.effect_names, which.facts.evidence.by_key()
    best: dict[str, Refit] = {}
    for key in sorted(which.refits, key=lambda key: -value[key]):
        best.setdefault(label(classes, tuple(names[k] for k in key)), which.refits[key])
    order = sorted(which.by_class, key=lambda name: -which.by_class[name])
    return [
        {
            "label": name,
            "probability": which.by_class[name],
            "strengths": _strengths(diagnosis, best[name]) if name in best else {},
        }
        for name in order
    ]


def _strengths(diagnosis: Diagnosis, fit: Refit) -> dict[str, float]:
    effects = diagnosis.prepared.description.effects
    return {effects[k].name: float(fit.strengths[k] * effects[k].typical) for k in fit.chosen}


def _aligned(diagnosis: Diagnosis, curves: Curves) -> dict[str, dict]:
    """A specimen's curves as features see them, thinned."""
    drawn = {}
    for test, (displacement, force) in curves.items():
        mine = [f for f in diagnosis.measured.features if f.test == test]
        if mine:
            travel = displacement - _zero(mine, displacement, force)
            drawn[test] = {"displacement_mm": _thinned(travel), "force_n": _thinned(force)}
    return drawn


def _zero(features: list[Feature], displacement: np.ndarray, force: np.ndarray) -> float:
    """Displacement (mm) on a curve that its test's features count from."""
    if features[0].test == CONFINED:
        level, top = REFERENCE * features[0].scale, int(np.argmax(displacement))
    else:
        level, top = features[0].force, int(np.argmax(force))
    rising = isotonic_regression(force[: top + 1]).x
    return float(np.interp(level, rising, displacement[: top + 1]))


def _thinned(values: np.ndarray) -> list[float]:
    step = max(1, -(-len(values) // MOST_POINTS))
    return [float(value) for value in values[::step]]
