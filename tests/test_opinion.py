"""The opinion that comes with the package is that which opened verdicts gave."""

import sys
from pathlib import Path

import numpy as np
import pytest

from calibrate.diagnosis.opinion import NONE, learned

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
import opinion


def test_it_follows_from_the_archived_evidences():
    found, again = learned(), opinion.learn(opinion.cases())
    names = tuple(again.habits)
    assert found.numbers(names) == pytest.approx(again.numbers(names), abs=1e-3)
    assert 0.05 < found.sharpness < 2
    assert 0 < found.smallest < 0.5


def test_it_states_better_than_evidences_as_they_are():
    """By the logarithmic score of the cases that each fifth left out."""
    cases = opinion.cases()
    others = opinion.quality(cases, opinion.by_other_folds(cases))
    plain = opinion.quality(cases, [opinion.Opinion()] * len(cases))
    assert others["log_score"] > plain["log_score"]


def test_right_explanations_are_those_of_the_right_class():
    case = next(c for c in opinion.cases() if c.truth == NONE)
    assert case.right.tolist() == [True] + [False] * (len(case.right) - 1)
    said = case.said(learned())
    assert np.isclose(sum(said.values()), 1.0)
