"""The oedometer by load steps: published data are read as they are, a simulation answers them."""

import csv
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.progress import Silent
from calibrate.inference.problem import pose
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation.resolution import Preset
from calibrate.simulation.specimens import campaign

LAB = load_lab(bundled_lab("trumao_oedometer"))
TINY = Preset("tiny", 48, 0.2, 0.4, 1)


def test_measured_settlements_are_those_of_the_published_void_ratios():
    """Strain (e25 - e)/(1 + e25) of 50 mm, mean of three samples, at every load step."""
    path = Path(LAB.file).parent / "trumao_2021" / "oedometer.csv"
    rows = list(csv.DictReader(path.open()))
    ratio = np.array([float(row["e"]) for row in rows]).reshape(3, 13)
    travel = 50.0 * (ratio[:, :1] - ratio) / (1 + ratio[:, :1])
    problem = pose(LAB)
    assert [f.test for f in problem.features] == ["", *["oedometer"] * 12]
    assert problem.measured[1:] == pytest.approx(travel[:, 1:].mean(axis=0))
    assert list(problem.repeats) == [0, *[3] * 12]


def test_a_simulation_settles_while_loading_and_springs_back(tmp_path):
    work = campaign(LAB, TINY, tmp_path, Silent())
    (run,) = work.runs([base_soil(LAB)], [0], "oedometer")[0]
    assert not run.failure
    assert set(run.curves) == {"oedometer", "preparation", "unconfined"}
    assert set(run.observables) == {"settlement_mm", "depression_depth_mm", "crushing_force_n"}
    values = pose(LAB).simulated([run])[0][1:]
    loading, unloading = values[:6], values[6:]
    assert np.all(np.diff(loading) > 0) and np.all(np.diff(unloading) < 0)
    assert run.observables["settlement_mm"] > loading[-1] > unloading[0]
    top = np.pi / 4 * 0.05**2 * 1200e3  # N
    assert run.curves["oedometer"][:, 1].max() == pytest.approx(top, rel=2e-3)
