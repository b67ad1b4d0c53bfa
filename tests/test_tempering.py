"""How stated probabilities are bent to what they turned out to be worth."""

import sys
from pathlib import Path

import numpy as np
import pytest

from calibrate.diagnosis.tempering import fitted_power, learned_power, tempered

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))
import tempering

NAMES = ("none", "unknown", "wall_friction", "seating_gap + wall_friction")


def forecasts(power: float, count: int = 4000) -> tuple[list[dict], list[str]]:
    """What somebody states who raises the true probabilities to 1/power, and what is true."""
    rng = np.random.default_rng(1)
    true = rng.dirichlet([0.7] * len(NAMES), count)
    stated = [tempered(dict(zip(NAMES, p, strict=True)), 1 / power) for p in true]
    return stated, [str(rng.choice(NAMES, p=p)) for p in true]


@pytest.mark.parametrize("power", [0.5, 1.0, 1.6])
def test_the_power_is_found_again(power):
    assert fitted_power(*forecasts(power)) == pytest.approx(power, rel=0.05)


def test_tempering_keeps_the_order_and_the_sum():
    stated = {"none": 0.6, "unknown": 0.0, "wall_friction": 0.4}
    for power in (0.3, 1.0, 2.0):
        bent = tempered(stated, power)
        assert list(bent) == list(stated)
        assert sum(bent.values()) == pytest.approx(1)
        assert bent["none"] > bent["wall_friction"] > bent["unknown"] >= 0
    assert tempered(stated, 1.0)["none"] == pytest.approx(0.6, abs=1e-6)
    assert tempered(stated, 0.5)["none"] < 0.6 < tempered(stated, 2.0)["none"]


def test_a_case_that_nobody_foresaw_does_not_decide():
    stated, truths = forecasts(1.0)
    never = fitted_power([*stated, {"none": 1.0}], [*truths, "something else"])
    assert never == pytest.approx(fitted_power(stated, truths), abs=0.02)


def test_the_learned_power_follows_from_the_archived_verdicts():
    assert learned_power() == pytest.approx(fitted_power(*tempering.cases()), abs=1e-4)
    assert 0.5 < learned_power() < 1
