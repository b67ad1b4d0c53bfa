"""The result of `calibrate diagnose` as a record: the contract's keys, and what figures need.

`content` turns a diagnosis into plain data, `DiagnosisRecord` is that data read back.  Curves are
at the size of the library of runs, their displacement counted as features
count it (`AbstractTestFeatures.zero`).
"""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from pydantic import model_validator as check

from calibrate.discrepancy.comparison.compare import label
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.diagnosis import Diagnosis
from calibrate.labtests.diagnosis.base import BEFORE, TARGET, Curves
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, TESTS, tests_of
from calibrate.records.base import Curve, Number, Origin, Record, Test

MOST_POINTS = 300  # of a curve that is kept to be drawn
FEWEST = 3  # repeats from which their scatter is told
Status = Literal["found", "trivial", "absent", "inconclusive"]


class SegmentRow(Record):
    """Mean residual of a segment (measured minus simulated), over its standard error, and its
    share of the misfit."""

    test: Test
    segment: str
    gap: Number
    unit: str
    z: Number
    outside_band: bool
    share: Number
    share_interval: tuple[Number, Number] | None  # none where it does not hold the share
    share_by_chance: Number


class CrossTestRow(Record):
    """One test predicted from the other."""

    predicted: Test
    p_value: Number
    factor: Number
    factor_se: Number


class EffectRow(Record):
    """One effect by itself: one-step strength (SI), and whether it could have been detected."""

    name: str
    status: Status
    z: Number
    strength: Number
    standard_error: Number
    unit: str
    visibility: Number


class ComparisonRecord(Record):
    """Verdict, probabilities, classes; `reason`: why the likeliest explanation is not named."""

    verdict: str
    reason: str = ""
    probability: dict[str, Number]
    probability_by_class: dict[str, Number]
    likely_set: list[str]
    alike: list[list[str]]
    absorbed_by_calibration: list[str]
    p_gap: Number
    p_left_after_best: Number
    effects: list[EffectRow]


class ReductionRecord(Record):
    """Gap in scatters of a specimen, before and after, how much of it goes, and whether the data
    can show that much; no interval where it does not hold its value."""

    before: Number
    after: Number
    floor: Number
    shrinkage: Number
    interval: tuple[Number, Number] | None
    shown: bool = True  # files of earlier versions do not say
    shrinkage_left_out: Number
    ceiling: dict[str, Number]


class ProposalRow(Record):
    """A further test with its cost (hours, fresh specimens), what it tells (nats), the chance to
    name the right explanation with it, and how far it separates the leading ones; files of earlier
    versions have the last one only."""

    name: str
    cost: Number
    separation: Number
    specimens: int = 0
    gain_nats: Number = float("nan")
    chance: Number = float("nan")


class NextTestRecord(Record):
    """The further test that tells most; `stop`: why none need be made."""

    name: str
    gain_nats: Number = float("nan")
    chance_now: Number = float("nan")
    chance: Number = float("nan")
    stop: str = ""
    cost: Number = float("nan")
    specimens: int = 0
    entries: dict[str, str | bool] = Field(default_factory=dict)
    separation_now: Number
    separation: Number
    settles: bool
    hardest_pair: tuple[str, str]
    predicted: dict[str, list[Number]]
    all: list[ProposalRow]
    labels: list[str]
    deviation: list[Number]


class FurtherTestsRecord(Record):
    """Further tests that were taken in: probabilities before by explanation, the chance of such an
    outcome under each, and whether any of them foresaw it."""

    tests: list[str]
    before: dict[str, Number]
    chance: dict[str, Number]
    foreseen: bool


class FeatureRow(Record):
    """One location on the curves: measured mean with the scatter of one specimen, the calibrated
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


class ExplanationRow(Record):
    """A class of effects with its probability and the strengths (SI) of its best member's fit."""

    label: str
    probability: Number
    strengths: dict[str, Number]


class ParameterShift(Record):
    """Where calibration moved a base parameter: ln p over its prior deviation, and that."""

    name: str
    moved: Number
    prior_sd: Number


class DiagnosisSettings(Record):
    """How it was done."""

    library: str
    simulations: int
    packings: int
    seed: int
    repeats: dict[str, Annotated[int, Field(ge=0)]]

    @check(mode="before")
    @classmethod
    def _of_each_test(cls, given: Any) -> Any:
        """In the file, the repeats of a test stand under its name."""
        if not isinstance(given, dict):
            return given
        return {**given, "repeats": {test: given[test] for test in TESTS if test in given}}


class DiagnosisRecord(Origin):
    """Everything that figures and the report show."""

    where: list[SegmentRow]
    across_tests: list[CrossTestRow]
    which: ComparisonRecord
    how_far: ReductionRecord | None
    next_test: NextTestRecord | None
    further_tests: FurtherTestsRecord | None = None
    unused_tests: list[str] = Field(default_factory=list)
    features: list[FeatureRow]
    specimens: list[dict[Test, Curve]]
    specimen_weights: list[Number] = Field(default_factory=list)
    best: list[str]
    explanations: list[ExplanationRow]
    base_parameters: list[ParameterShift]
    beyond_library: list[str] = Field(default_factory=list)
    library_error: Number = 1.0
    records_begin: dict[Test, Number] = Field(default_factory=dict)
    scatter_over_assumed: dict[Test, Number] = Field(default_factory=dict)
    amplitudes: dict[Test, Number]
    settings: DiagnosisSettings

    @check(mode="after")
    def _has_features(self) -> "DiagnosisRecord":
        if not self.features:
            raise ValueError("features are empty")
        return self

    def names(self, explanation: str) -> bool:
        """Whether this is what the verdict says; nothing is where a reason keeps a cause from being
        named."""
        return explanation == self.which.verdict and not self.which.reason

    @property
    def targets_only(self) -> bool:
        """Whether the laboratory gave numbers without curves."""
        return all(row.kind == "target" for row in self.features)


def content(diagnosis: Diagnosis, origin: dict) -> dict:
    """Plain data of a diagnosis; `origin` has the keys of `Origin` and `settings` with library,
    simulations, packings and seed."""
    found = diagnosis.as_json()
    comparison, d = diagnosis.comparison, diagnosis.prepared.description
    moved = comparison.base.delta / d.prior_sd
    repeats = {test: diagnosis.found.repeats.get(test, 0) for test in TESTS}
    return {
        **origin,
        **found,
        "unused_tests": list(diagnosis.unused),
        "features": _features(diagnosis),
        "specimens": [
            _aligned(diagnosis, curves, rest)
            for curves, rest in zip(diagnosis.found.specimens, diagnosis.found.before, strict=False)
        ],
        "specimen_weights": diagnosis.measured.weight.tolist(),
        "best": [d.effect_names[k] for k in comparison.best],
        "explanations": _explanations(diagnosis),
        "base_parameters": [
            {"name": name, "moved": float(by), "prior_sd": float(sd)}
            for name, by, sd in zip(d.base_names, moved, d.prior_sd, strict=True)
        ],
        "beyond_library": list(diagnosis.beyond),
        "library_error": diagnosis.library_error,
        "records_begin": dict(diagnosis.found.begun),
        "scatter_over_assumed": _scatter_over_assumed(diagnosis),
        "amplitudes": {str(test): float(a) for test, a in comparison.noise.amplitudes.items()},
        "settings": {**origin["settings"], **repeats},
    }


def _scatter_over_assumed(diagnosis: Diagnosis) -> dict[str, float]:
    """Deviation of the repeats of each test over that of the noise, their median over features of
    curves; of tests with enough repeats."""
    measured, noise = diagnosis.measured, diagnosis.comparison.noise
    assumed, found = np.sqrt(np.diag(noise.specimen)), {}
    curves = np.array([f.kind not in (BEFORE, TARGET) for f in measured.features])
    for test in TESTS:
        mine = curves & (tests_of(measured.features) == test)
        rows = measured.specimens[:, mine]
        rows = rows[np.isfinite(rows).all(axis=1)]
        if mine.any() and len(rows) >= FEWEST:
            found[test] = float(np.median(rows.std(axis=0, ddof=1) / assumed[mine]))
    return found


def _features(diagnosis: Diagnosis) -> list[dict]:
    comparison, localisation = diagnosis.comparison, diagnosis.localisation
    base = comparison.base.values
    fits, named = comparison.refits, comparison.best
    best = fits[named].values if named else np.full(len(base), np.nan)
    scatter = np.sqrt(np.diag(comparison.noise.specimen))
    error, band = localisation.deviation, localisation.band
    columns = (diagnosis.measured.mean, scatter, base, best, error, band)
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
    comparison, classes = diagnosis.comparison, diagnosis.prepared.classes
    names, value = diagnosis.prepared.description.effect_names, comparison.summary.evidence.by_key()
    best: dict[str, Refit] = {}
    for key in sorted(comparison.refits, key=lambda key: -value[key]):
        best.setdefault(label(classes, tuple(names[k] for k in key)), comparison.refits[key])
    order = sorted(comparison.by_class, key=lambda name: -comparison.by_class[name])
    return [
        {
            "label": name,
            "probability": comparison.by_class[name],
            "strengths": _strengths(diagnosis, best[name]) if name in best else {},
        }
        for name in order
    ]


def _strengths(diagnosis: Diagnosis, fit: Refit) -> dict[str, float]:
    effects = diagnosis.prepared.description.effects
    return {effects[k].name: float(fit.strengths[k] * effects[k].typical) for k in fit.chosen}


def _aligned(diagnosis: Diagnosis, curves: Curves, rest: np.ndarray) -> dict[str, dict]:
    """A specimen's curves as features see them, thinned: where all features of a test are read
    without the force before contact, `rest` (N) by test, so are these."""
    drawn, at_rest = {}, dict(zip(TESTS, np.nan_to_num(rest).tolist(), strict=True))
    for test, (displacement, recorded) in curves.items():
        mine = [f for f in diagnosis.measured.features if f.test == test]
        force = recorded - (at_rest[test] if TEST_FEATURES[test].tared is None else 0.0)
        if mine:
            travel = displacement - TEST_FEATURES[test].zero(mine[0], displacement, force)
            drawn[test] = {"displacement_mm": _thinned(travel), "force_n": _thinned(force)}
    return drawn


def _thinned(values: np.ndarray) -> list[float]:
    step = max(1, -(-len(values) // MOST_POINTS))
    return [float(value) for value in values[::step]]
