"""Measurements in the terms of a library of runs: features, repeats, instruments.

The i-th curves of all tests are taken for the same specimen where there are as many of each.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtri

from calibrate.core.errors import InputError
from calibrate.discrepancy.comparison.recording import AbstractChannel, Channel, LoadSteps
from calibrate.discrepancy.comparison.repeats import (
    Measured,
    from_targets,
    from_vectors,
    measured_features,
)
from calibrate.io.lab import Lab
from calibrate.labtests.diagnosis.base import Curves, Feature
from calibrate.labtests.diagnosis.confined import FIRST
from calibrate.labtests.diagnosis.contact import (
    begins_before_contact,
    force_before_contact,
    force_noise,
)
from calibrate.labtests.diagnosis.curves import (
    TARGETS,
    TEST_FEATURES,
    TESTS,
    declare_targets,
    recorded_feature_values,
)
from calibrate.labtests.measured import Target
from calibrate.labtests.reading import displacement_on_rise, rising

DISPLACEMENT_SD = 3e-3  # mm; resolution of a crosshead
LEAST_FORCE_SD = 0.1  # N
STRETCHED = (0.2, 5.0)  # of curves like the lab's, at least and at most


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a lab measured: features and which of the library's they are (`chosen`); means before
    contact (s, 2), NaN where there are none; channels and speeds (mm/s) by test; curves of the
    specimens that have any; `begun`: by test the force (N) at which records begin that hold no
    reading before contact."""

    measured: Measured
    chosen: np.ndarray
    before: np.ndarray
    channels: dict[str, AbstractChannel]
    specimens: tuple[Curves, ...]
    speeds: dict[str, float]
    begun: Mapping[str, float] = field(default_factory=dict)

    @property
    def repeats(self) -> dict[str, int]:
        """How many specimens each test was made on; a record that is given twice counts once."""
        found: dict[str, int] = {}
        for test in TESTS:
            curves = {np.array(c[test]).tobytes() for c in self.specimens if test in c}
            mine = [
                n for n, f in zip(self.measured.counts, self.measured.features, strict=True)
                if f.test == test
            ]  # fmt: skip
            if mine:
                found[test] = len(curves) or round(max(mine))
        return found

    @property
    def tared(self) -> tuple[str, ...]:
        """The tests whose forces before contact were taken off."""
        known = np.isfinite(self.before)
        return tuple(test for column, test in enumerate(TESTS) if known[:, column].any())


def specimens_of(lab: Lab) -> list[Curves]:
    """The lab's specimens with their curves in mm and N."""
    by_test = {
        test: [(c.displacement_mm, c.force_n) for c in lab.curves if c.test == test]
        for test in TESTS
    }
    if len({len(curves) for curves in by_test.values()}) == 1:
        return [
            dict(zip(by_test, pair, strict=True)) for pair in zip(*by_test.values(), strict=True)
        ]
    return [{test: curve} for test, curves in by_test.items() for curve in curves]


def read_measurements(
    lab: Lab, every: Sequence[Feature], like: Curves | None = None, from_zero: bool = False
) -> Measurements:
    """A library's features of a lab: of its curves if there are any, and the targets of tests that
    it has no curve of.  `like`: curves of a specimen like the lab's, which say how far its platen
    went before a record that begins at a preload; from_zero: records that begin at contact are
    known to begin at no force, so that they hold the first touch."""
    specimens = specimens_of(lab)
    if not specimens:
        return _targets(lab, every)
    begun = {} if from_zero else _begun(specimens)
    on_curves = [f for f in every if f.kind != "target"]
    specimens = [_from_seating(on_curves, curves, like, begun) for curves in specimens]
    before = _before(specimens, begun)
    values = np.array([
        recorded_feature_values(on_curves, curves, dict(zip(TESTS, rest, strict=True)), begun)
        for curves, rest in zip(specimens, np.nan_to_num(before), strict=True)
    ])  # fmt: skip
    known = measured_features(on_curves, specimens, values)
    if not known:
        raise InputError(lab.file, "curves", "no feature could be read from them",
                         "give whole curves: loading to the largest force and back, crushing "
                         "past the peak")  # fmt: skip
    vectors = values[:, [on_curves.index(feature) for feature in known]]
    numbers = _beside_curves(lab, specimens)
    for name in numbers:
        vectors = _below(vectors, _like(lab.targets[name]))
    features = (*known, *declare_targets(numbers))
    lacking = np.full((len(vectors) - len(before), len(TESTS)), np.nan)
    before = np.vstack([before, lacking])
    names = [f.name for f in every]
    chosen = np.array([names.index(feature.name) for feature in features])
    channels = {test: _channel(test, lab, specimens) for test in TESTS}
    speeds = {test: 1e3 * rate for test, rate in lab.pair().rates.items()}
    measured = from_vectors(features, vectors)
    return Measurements(measured, chosen, before, channels, tuple(specimens), speeds, begun)


def _beside_curves(lab: Lab, specimens: Sequence[Curves]) -> list[str]:
    """The targets of tests without curves."""
    return [
        target for test, target in zip(TESTS, TARGETS, strict=True)
        if target in lab.targets and not any(test in curves for curves in specimens)
    ]  # fmt: skip


def _like(target: Target) -> np.ndarray:
    """As many values (n, 1) as there were repeats, with their mean and scatter: normal order
    statistics."""
    count = max(target.repeats, 1)
    score = ndtri((np.arange(count) + 0.5) / count)
    spread = score.std(ddof=1) if count > 1 else 1.0
    return (target.mean + target.scatter * score / spread)[:, None]


def _below(above: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Specimens (s, m) and others (r, k) with other features: (s + r, m + k), NaN where a specimen
    lacks one."""
    (s, m), (r, k) = above.shape, below.shape
    found = np.full((s + r, m + k), np.nan)
    found[:s, :m], found[s:, m:] = above, below
    return found


def _begun(specimens: Sequence[Curves]) -> dict[str, float]:
    """By test the force (N) at which records begin, of tests whose records hold no reading before
    contact."""
    of_test = {test: [c[test] for c in specimens if test in c] for test in TESTS}
    return {
        test: float(np.median([np.median(force[:FIRST]) for _, force in curves]))
        for test, curves in of_test.items()
        if curves and not begins_before_contact(curves)
    }


def _from_seating(
    features: Sequence[Feature], curves: Curves, like: Curves | None, begun: Collection[str]
) -> Curves:
    """Curves with a first point at the seating force from which displacement counts, where a record
    begins beyond it: as far before the record as the curves `like` it say."""
    found = dict(curves)
    for test in (test for test in curves if test in begun and like is not None):
        force = 0.0 if TEST_FEATURES[test].read_at_forces else _seating(features, test)
        displacement, recorded = curves[test]
        first = float(np.median(recorded[:FIRST]))
        if like is not None and 0 < force < first:
            way = way_between(like[test], curves[test], force, first)
            found[test] = (
                np.concatenate([[np.median(displacement[:FIRST]) - way], displacement]),
                np.concatenate([[force], recorded]),
            )
    return found


def _seating(features: Sequence[Feature], test: str) -> float:
    """Force (N) from which the displacements of a test count; 0 without features."""
    return max((f.zero.force or 0.0 for f in features if f.test == test), default=0.0)


def way_between(
    like: tuple[np.ndarray, np.ndarray], curve: tuple[np.ndarray, np.ndarray], low: float,
    high: float,
) -> float:  # fmt: skip
    """The way (mm) from one force (N) to another on a curve, told by another one `like` it,
    stretched so that both have one peak and rise alike between a fifth and three fifths of it."""
    (x, force), (own_x, own) = like, curve
    wider = own.max() / force.max()
    shares = np.array([0.2, 0.6])
    of_like, of_own = (_rise_at(a, f, shares * f.max()) for a, f in ((x, force), (own_x, own)))
    longer = np.clip(np.diff(of_own) / np.diff(of_like), *STRETCHED)[0]
    ends = _rise_at(x, force, np.array([low, high]) / wider)
    return float(max(ends[1] - ends[0], 0.0) * longer)


def _rise_at(displacement: np.ndarray, force: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Displacements (mm) at forces (N) on a curve's rise to its peak."""
    top = int(np.argmax(force)) + 1
    return displacement_on_rise(*rising(displacement[:top], force[:top], averaged=False), levels)


def _before(specimens: Sequence[Curves], begun: Collection[str] = ()) -> np.ndarray:
    """Forces before contact (s, 2) in the order of TESTS; a curve that does not show its own is
    given the mean of the others; NaN where none shows it, or there is no curve."""
    found = np.array([
        [
            force_before_contact(curves[test][1]) if test in curves and test not in begun
            else np.nan
            for test in TESTS
        ]
        for curves in specimens
    ])  # fmt: skip
    for column, test in enumerate(TESTS):
        has = np.array([test in curves for curves in specimens])
        known = np.isfinite(found[:, column])
        if known.any():
            found[has & ~known, column] = found[known, column].mean()
    return found


def _targets(lab: Lab, every: Sequence[Feature]) -> Measurements:
    names = [name for name in TARGETS if name in lab.targets]
    if not names:
        problem = f"there is no curve, and a diagnosis knows no target {', '.join(lab.targets)}"
        raise InputError(lab.file, "targets", problem, f"add curves, or {' or '.join(TARGETS)}")
    features = declare_targets(names)
    given = [lab.targets[name] for name in names]
    values = {n: (t.mean, t.scatter, t.repeats) for n, t in zip(names, given, strict=True)}
    chosen = np.array([[f.name for f in every].index(name) for name in names])
    return Measurements(from_targets(features, values), chosen, np.empty((0, 2)), {}, (), {})


def _channel(test: str, lab: Lab, specimens: Sequence[Curves]) -> AbstractChannel:
    """How a test was recorded: at load steps, or travel between readings and the noise of force."""
    curves = [curves[test] for curves in specimens if test in curves]
    if not curves:
        return Channel(0.05, LEAST_FORCE_SD, DISPLACEMENT_SD)
    if all(curve.points for curve in lab.curves if curve.test == test):
        displacement, force = curves[0]
        return LoadSteps(force[: int(np.argmax(displacement)) + 1], DISPLACEMENT_SD)
    spacing = np.median([np.median(np.abs(np.diff(x))) for x, _ in curves])
    noise = force_noise([force for _, force in curves])
    return Channel(max(float(spacing), 1e-3), max(noise, LEAST_FORCE_SD), DISPLACEMENT_SD)
