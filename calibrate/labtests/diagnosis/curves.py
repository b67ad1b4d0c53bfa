"""Curves of all tests as numbers: the declared features, and how they are read.

What a laboratory is free to choose drops out: each test counts displacement from a point of its
own (`AbstractTestFeatures.zero`), and a force before contact is taken off where the machine does
not act on it.  A further type of test is one file beside this one and one line in TEST_FEATURES.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from calibrate.labtests.composite import BY_NAME
from calibrate.labtests.diagnosis.base import (
    BEFORE,
    TARGET,
    AbstractTestFeatures,
    Curves,
    Feature,
    UsualSizes,
    Values,
)
from calibrate.labtests.diagnosis.confined import ConfinedFeatures
from calibrate.labtests.diagnosis.contact import force_before_contact, from_contact_on
from calibrate.labtests.diagnosis.unconfined import UnconfinedFeatures

TEST_FEATURES: dict[str, AbstractTestFeatures] = {
    test.name: test for test in (ConfinedFeatures(), UnconfinedFeatures())
}
TESTS = tuple(TEST_FEATURES)
TARGETS = tuple(test.target for test in TEST_FEATURES.values())  # scalar observables


def declare(usual: UsualSizes) -> tuple[Feature, ...]:
    """All features of all tests."""
    return tuple(f for test in TEST_FEATURES.values() for f in test.declare(usual))


def declare_targets(names: Sequence[str] = TARGETS) -> tuple[Feature, ...]:
    """Features of a soil of which only scalar targets are known (of `TARGETS`)."""
    test_of = {test.target: test.name for test in TEST_FEATURES.values()}
    return tuple(
        Feature(name, test_of[name], TARGET, TARGET, 0.0, BY_NAME[name].unit, 0.5) for name in names
    )


def declare_before_contact() -> tuple[Feature, ...]:
    """The force (N) that a machine shows before its platen touches, in each test."""
    return tuple(
        Feature(f"force before contact, {test}", test, BEFORE, BEFORE, 0.0, "N", 0.0)
        for test in TESTS
    )


def feature_values(
    features: Sequence[Feature], curves: Curves, targets: Mapping[str, float] | None = None
) -> np.ndarray:
    """Features (m,) of one specimen; NaN where its curves do not reach or are missing."""
    read = {name: _read(features, name, curves[name]) for name in TESTS if name in curves}
    given = targets or {}
    return np.array([_value(feature, read, given) for feature in features])


def recorded_feature_values(
    features: Sequence[Feature],
    curves: Curves,
    rest: Mapping[str, float] | None = None,
    begun: Collection[str] = (),
) -> np.ndarray:
    """Features (m,) of recorded curves: the force before contact itself, the others cut where the
    platen surely touches, those of `tared_rows` without that force, unless there are too few
    readings of it.

    rest: that force (N) by test, for curves that do not show it; begun: tests whose records begin
    at contact or at a preload, of which nothing is taken off, and which lack what comes before.
    """
    before = {test: curve for test, curve in curves.items() if test not in begun}
    cut = {**curves, **from_contact_on(before)}
    given_rest = rest or {}
    at_rest = {test: force_before_contact(force) for test, (_, force) in before.items()}
    at_rest |= {test: np.nan for test in curves if test in begun}
    taken = {t: b if np.isfinite(b) else given_rest.get(t, 0.0) for t, b in at_rest.items()}
    without = {test: (x, force - taken[test]) for test, (x, force) in cut.items()}
    as_read, tared = feature_values(features, cut), feature_values(features, without)
    for test, (_, force) in without.items():
        tared = np.where(TEST_FEATURES[test].beyond(features, force), np.nan, tared)
    found = np.where(tared_rows(features), tared, as_read)
    for test in (test for test in curves if test in begun):
        lacking = TEST_FEATURES[test].before_start(features, curves[test][1])
        found = np.where(lacking, np.nan, found)
    of_rest = [f.kind == BEFORE for f in features]
    return np.where(of_rest, [at_rest.get(f.test, np.nan) for f in features], found)


def tared_rows(features: Sequence[Feature]) -> np.ndarray:
    """Mask (m,) of the features that are read after the force before contact is taken off: those
    that do not know where the machine will turn."""
    kinds = {name: test.tared for name, test in TEST_FEATURES.items()}
    return np.array([(k := kinds[f.test]) is None or f.kind in k for f in features])


def tests_of(features: Sequence[Feature]) -> np.ndarray:
    """The test of each feature, shape (m,)."""
    return np.array([feature.test for feature in features])


def segments_of(features: Sequence[Feature]) -> list[tuple[str, str, np.ndarray]]:
    """(test, segment, indices of its features) in the order of declaration."""
    keys = list(dict.fromkeys((feature.test, feature.segment) for feature in features))
    return [
        (*key, np.array([i for i, f in enumerate(features) if (f.test, f.segment) == key]))
        for key in keys
    ]


def _read(features: Sequence[Feature], name: str, curve: tuple[np.ndarray, np.ndarray]) -> Values:
    test = TEST_FEATURES[name]
    mine = test.mine(features)
    return test.read(mine, *curve) if mine else {}


def _value(feature: Feature, read: Mapping[str, Values], targets: Mapping[str, float]) -> float:
    if feature.kind == TARGET:
        return float(targets.get(feature.name, np.nan))
    return float(read.get(feature.test, {}).get((feature.kind, feature.abscissa), np.nan))
