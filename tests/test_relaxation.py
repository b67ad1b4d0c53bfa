"""A hold at 400 N: what force is left, with and without a soil that feels the rate."""

from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from calibrate.inference.problem import pose
from calibrate.io.lab import load_lab
from calibrate.simulation.resolution import Preset, specimen, virtual_lab
from calibrate.simulation.run import summary
from jdem.effects.rate import RateDependence
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare

TINY = Preset("tiny", 48, 0.2, 0.4, 1)
TEXT = """[soil]
name = "x"
[specimen]
diameter = "50 mm"
height = "50 mm"
[[tests]]
type = "relaxation"
hold = "5 min"
[tests.targets]
force_left_n = { mean = "350 N", scatter = "10 N", repeats = 3 }
[[tests.curves]]
file = "c.csv"
displacement = { column = "mm", unit = "mm" }
force = { column = "N", unit = "N" }
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    (folder / "c.csv").write_text("mm,N\n0,0\n1,100\n2,200\n3,300\n4,400\n4,370\n4,350\n")
    (folder / "lab.toml").write_text(TEXT)
    return load_lab(folder / "lab.toml")


@pytest.fixture(scope="module")
def runs(lab):
    """Without rate dependence, and with 5 % a decade; strength 0 is the base model bit for bit
    (test_effects)."""
    plain = virtual_lab(lab, TINY)
    packing, soil = prepare(specimen(lab, TINY), 0), SoilParameters()
    found, run = [], eqx.filter_jit(VirtualLab.run)
    for strength in (0.0, 0.05):
        lab_with = replace(plain, effects=(RateDependence(strength),))
        outcome = run(lab_with, packing, soil)
        found.append(summary(lab_with, packing, soil, outcome, 1.0))
    return found


def test_measured_numbers_are_the_way_up_and_the_force_at_the_end(lab):
    problem = pose(lab)
    assert problem.features[0].name == "force_left_n"
    np.testing.assert_allclose(problem.measured, [350.0, 0.98, 1.98, 2.98, 350.0])


def test_force_stays_without_an_effect_and_falls_with_the_rate(lab, runs):
    """In five minutes instead of the seconds of loading the felt rate falls by decades."""
    still, felt = runs
    assert not still.failure and not felt.failure
    assert still.curves["relaxation"][:, 1].max() == pytest.approx(400, abs=2.0)
    assert 380 < still.observables["force_left_n"] <= 401
    assert felt.observables["force_left_n"] < still.observables["force_left_n"] - 10
    for run in runs:
        assert pose(lab).simulated([run])[0][-1] == pytest.approx(run.observables["force_left_n"])
