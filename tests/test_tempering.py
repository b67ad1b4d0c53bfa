"""How stated probabilities are bent to what they turned out to be worth."""

import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from calibrate.diagnosis.tempering import Tempering, fitted_tempering, learned_tempering

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
import tempering

NAMES = ("none", "unknown", "wall_friction", "seating_gap + wall_friction")


def forecasts(true_one: Tempering, count: int = 4000) -> tuple[list[dict], list[str]]:
    """What somebody states whose probabilities this tempering sets right, and what is true."""
    rng = np.random.default_rng(1)
    stated = [
        dict(zip(NAMES, p, strict=True)) for p in rng.dirichlet([0.7] * len(NAMES), count).tolist()
    ]
    return stated, [str(rng.choice(NAMES, p=list(true_one.of(p).values()))) for p in stated]


@pytest.mark.parametrize("power", [0.5, 1.0, 1.6])
def test_power_and_odds_are_found_again(power):
    true_one = Tempering(power, none=0.6, unknown=-0.3, pair=-1.2)
    found = fitted_tempering(*forecasts(true_one))
    assert astuple(found) == pytest.approx(astuple(true_one), rel=0.06, abs=0.12)


def test_the_power_keeps_the_order_and_the_sum():
    stated = {"none": 0.6, "unknown": 0.0, "wall_friction": 0.4}
    for power in (0.3, 1.0, 2.0):
        bent = Tempering(power).of(stated)
        assert list(bent) == list(stated)
        assert sum(bent.values()) == pytest.approx(1)
        assert bent["none"] > bent["wall_friction"] > bent["unknown"] >= 0
    assert Tempering().of(stated)["none"] == pytest.approx(0.6, abs=1e-6)
    assert Tempering(0.5).of(stated)["none"] < 0.6 < Tempering(2.0).of(stated)["none"]


def test_odds_move_their_own_kind():
    stated = dict.fromkeys(NAMES, 0.25)
    for kind, name in zip(("none", "unknown", "pair"), (*NAMES[:2], NAMES[3]), strict=True):
        bent = Tempering(**{kind: 1.0}).of(stated)
        assert bent[name] == pytest.approx(np.e / (np.e + 3))
        assert max(bent, key=lambda n: bent[n]) == name


def test_a_case_that_nobody_foresaw_does_not_decide():
    stated, truths = forecasts(Tempering())
    never = fitted_tempering([*stated, {"none": 1.0}], [*truths, "something else"])
    assert astuple(never) == pytest.approx(astuple(fitted_tempering(stated, truths)), abs=0.02)


def test_the_learned_one_follows_from_the_archived_verdicts():
    found, again = learned_tempering(), fitted_tempering(*tempering.cases())
    assert astuple(found) == pytest.approx(astuple(again), abs=1e-3)
    assert 0.5 < found.power < 1
