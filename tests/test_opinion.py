"""The opinion that comes with the package is that which opened verdicts gave."""

import pytest
from support import evidences

from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.compare import named
from calibrate.discrepancy.comparison.probability_calibration import (
    NAMED_BELOW,
    NONE,
    Opinion,
    hypotheses,
    learned,
)


def test_it_follows_from_the_archived_evidences():
    found, again = learned(), evidences.learn(evidences.cases())
    names = tuple(again.habits)
    assert found.numbers(names) == pytest.approx(again.numbers(names), abs=1e-3)
    assert 0 < found.smallest < 0.5


def test_it_states_better_than_evidences_as_they_are():
    """By the logarithmic score of the cases that each fifth left out."""
    cases = evidences.cases()
    others = evidences.quality(cases, evidences.by_other_folds(cases))
    plain = evidences.quality(cases, [Opinion()] * len(cases))
    assert others["log_score"] > plain["log_score"]


def named_right(case: evidences.Known) -> set[tuple[str, ...]]:
    every = hypotheses(case.facts)
    return {h for h, right in zip(every, case.right, strict=True) if right}


def test_right_explanations_are_those_of_the_right_class():
    cases = evidences.cases()
    nothing = next(c for c in cases if c.truth == NONE)
    assert named_right(nothing) == {(NONE,)}
    joined = next(c for c in cases if JOINED in c.truth and TOGETHER not in c.truth)
    members = set(joined.truth.split(JOINED))
    assert {(name,) for name in members} <= named_right(joined)
    assert all(set(h) <= members for h in named_right(joined))
    pair = next(c for c in cases if TOGETHER in c.truth and JOINED not in c.truth)
    assert [set(h) for h in named_right(pair)] == [set(pair.truth.split(TOGETHER))]
    for case in (nothing, joined, pair):
        assert sum(case.said(learned()).values()) == pytest.approx(1.0)


def test_something_is_named_where_none_is_unlikely_enough():
    less, more = NAMED_BELOW - 0.01, NAMED_BELOW + 0.01
    assert named({NONE: less, "wall_friction": 0.7}) == "wall_friction"
    assert named({NONE: more, "wall_friction": 0.7}) == NONE
    assert named({NONE: less, "a": 0.2, "b": 0.2, "c": 0.2}) == NONE
