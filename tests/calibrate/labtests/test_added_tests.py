"""Two types of test beyond the pair: the oedometer by load steps, whose published data are read as
they are and answered by a simulation, and a hold at 400 N: what force is left, with and without a
soil that feels the rate.  And a number beyond those of the pair: the strain at failure."""

import csv
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

from calibrate.core.progress import Silent
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.problem import pose
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.unconfined import FAILURE_STRAIN
from calibrate.simulation.resolution import Preset, specimen, virtual_lab
from calibrate.simulation.run import summary
from calibrate.simulation.specimens import campaign, simulate
from jdem.effects.rate import RateDependence
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare

pytestmark = pytest.mark.thorough

TINY = Preset("tiny", 48, 0.2, 0.4, 1)
OEDOMETER = load_lab(bundled_lab("trumao_oedometer"))
HOLD = """[soil]
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


def test_measured_settlements_are_those_of_the_published_void_ratios():
    """Strain (e25 - e)/(1 + e25) of 50 mm, mean of three samples, at every load step."""
    path = Path(OEDOMETER.file).parent / "trumao_2021" / "oedometer.csv"
    rows = list(csv.DictReader(path.open()))
    ratio = np.array([float(row["e"]) for row in rows]).reshape(3, 13)
    travel = 50.0 * (ratio[:, :1] - ratio) / (1 + ratio[:, :1])
    problem = pose(OEDOMETER)
    assert [f.test for f in problem.features] == ["", *["oedometer"] * 12]
    assert problem.measured[1:] == pytest.approx(travel[:, 1:].mean(axis=0))
    assert list(problem.repeats) == [0, *[3] * 12]


@pytest.mark.slow
def test_a_simulation_settles_while_loading_and_springs_back(tmp_path):
    work = campaign(OEDOMETER, TINY, tmp_path, Silent())
    (run,) = work.runs([base_soil(OEDOMETER)], [0], "oedometer")[0]
    assert not run.failure
    assert set(run.curves) == {"oedometer", "preparation", "unconfined"}
    assert set(run.observables) == {"settlement_mm", "depression_depth_mm", "crushing_force_n"}
    values = pose(OEDOMETER).simulated([run])[0][1:]
    loading, unloading = values[:6], values[6:]
    assert np.all(np.diff(loading) > 0) and np.all(np.diff(unloading) < 0)
    assert run.observables["settlement_mm"] > loading[-1] > unloading[0]
    top = np.pi / 4 * 0.05**2 * 1200e3  # N
    assert run.curves["oedometer"][:, 1].max() == pytest.approx(top, rel=2e-3)


@pytest.mark.slow
def test_a_simulation_gives_the_failure_strain_that_a_lab_file_asks_for(tmp_path):
    """It is read in the run as it is off the curve of the run, and a fit, an audit and a study
    compare it like the other numbers; those are as without it."""
    plain = load_lab(bundled_lab())
    text = Path(plain.file).read_text(encoding="utf-8")
    wanted = '\n[targets.failure_strain]\nmean = "5 %"\nscatter = "0.5 %"\nrepeats = 4\n'
    (tmp_path / "lab.toml").write_text(text + wanted, encoding="utf-8")
    asking, found = load_lab(tmp_path / "lab.toml"), []
    for lab in (plain, asking):
        work = campaign(lab, TINY, tmp_path, Silent())
        found.append(simulate(lab, TINY, base_soil(lab), 0, work)[0]["observables"])
    known, strain = found[1], found[1]["failure_strain_percent"]
    assert {name: known[name] for name in found[0]} == found[0]
    assert set(known) - set(found[0]) == {"failure_strain_percent"}
    (run,) = work.runs([base_soil(asking)], [0], "again")[0]
    read = FAILURE_STRAIN.feature(asking.specimen).of_curve(*run.curves["unconfined"].T)
    assert strain == pytest.approx(read, rel=1e-6) and 0 < strain < 16
    assert CurvePoints.of(work).observables == tuple(known)
    assert pose(asking).simulated([run])[0][-1] == strain


# ---------------------------------------------------------------- a hold


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    (folder / "c.csv").write_text("mm,N\n0,0\n1,100\n2,200\n3,300\n4,400\n4,370\n4,350\n")
    (folder / "lab.toml").write_text(HOLD)
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


@pytest.mark.slow
def test_force_stays_without_an_effect_and_falls_with_the_rate(lab, runs):
    """In five minutes instead of the seconds of loading the felt rate falls by decades."""
    still, felt = runs
    assert not still.failure and not felt.failure
    assert still.curves["relaxation"][:, 1].max() == pytest.approx(400, abs=2.0)
    assert 380 < still.observables["force_left_n"] <= 401
    assert felt.observables["force_left_n"] < still.observables["force_left_n"] - 10
    for run in runs:
        assert pose(lab).simulated([run])[0][-1] == pytest.approx(run.observables["force_left_n"])
