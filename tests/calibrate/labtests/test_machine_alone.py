"""A run of the machine without soil: closed forms of what its instruments show, in a lab, in a fit.

Base model: rigid, so the curve is vertical.  Compliance C: displacement C F.  Gap s: s (1 -
exp(-F/F_s)).  Lag tau on a ramp of r N/s: the reading is r tau behind.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.inference.audit import traces
from calibrate.inference.problem import pose
from calibrate.io.lab import Lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.records.base import Measured, record
from calibrate.simulation.resolution import Preset, bare_machine
from calibrate.simulation.session import Session
from calibrate.simulation.specimens import campaign, measured_json, rates_json, simulate
from jdem.apparatus.base import Reading
from jdem.apparatus.platen_on_base import PlatenOnBase
from jdem.effects.base import AbstractEffect
from jdem.effects.compliance import LoadFrameCompliance
from jdem.effects.composite import EFFECTS
from jdem.effects.drift import LoadCellDrift
from jdem.effects.gain import LoadCellGain
from jdem.effects.lag import AcquisitionLag
from jdem.effects.offset import LoadCellOffset
from jdem.effects.seating import SeatingGap
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence

pytestmark = pytest.mark.thorough

TINY = Preset("tiny", 48, 0.2, 0.4, 2)
FORCE, LOADING = 300.0, 60.0
HEAD = """[soil]
name = "x"
[specimen]
diameter = "50 mm"
height = "50 mm"
"""
MACHINE = """[[tests]]
type = "machine"
force = "300 N"
loading = "1 min"
[tests.targets]
deflection = { mean = "0.05 mm", scatter = "0.01 mm", repeats = 3 }
[[tests.curves]]
file = "m.csv"
displacement = { column = "mm", unit = "mm" }
force = { column = "N", unit = "N" }
"""
SOIL = """[[tests]]
type = "confined"
force_low = "25 N"
force_high = "50 N"
[tests.targets]
depression_depth = { mean = "1 mm", scatter = "0.1 mm", repeats = 3 }
"""
CURVE = "mm,N\n0,0\n0.01,60\n0.02,120\n0.03,180\n0.05,300\n0.02,100\n0,0\n"


def shown(*effects: AbstractEffect) -> Reading:
    """What a machine with these effects records."""
    test = PlatenOnBase(force=FORCE, loading=LOADING)
    return BareMachine(TestSequence((test,)), effects).run()["machine"]


def of(name: str, strength: Any) -> AbstractEffect:
    """The effect of this name."""
    kind: Any = EFFECTS[name]
    return kind(strength)


def lab_of(folder, text: str) -> Lab:
    (folder / "m.csv").write_text(CURVE)
    (folder / "lab.toml").write_text(text)
    return load_lab(folder / "lab.toml")


@pytest.mark.parametrize("name", EFFECTS)
def test_without_strength_the_curve_is_vertical_and_reaches_the_force(name):
    found = shown(of(name, 0.0))
    assert not np.any(found.curve.displacement)
    assert float(found.curve.force.max()) == FORCE
    assert float(found.curve.force[-1]) == float(found.observables["deflection"]) == 0.0


def test_a_compliant_frame_shows_c_times_f():
    found = shown(LoadFrameCompliance(1e-6))
    np.testing.assert_allclose(found.curve.displacement, 1e-6 * found.curve.force, atol=1e-15)
    assert float(found.observables["deflection"]) == pytest.approx(1e-6 * FORCE)


def test_a_gap_closes_and_opens_by_its_own_law():
    found = shown(SeatingGap(5e-4, closing_force=20.0))
    wanted = 5e-4 * -np.expm1(-np.asarray(found.curve.force) / 20.0)
    np.testing.assert_allclose(found.curve.displacement, wanted, atol=1e-15)


@pytest.mark.parametrize("in_servo", [0.0, 1.0])
def test_a_load_cell_that_is_off_turns_the_machine_where_the_servo_sees_the_force(in_servo):
    """The frame tells the true force: F/(1 + g) where the servo reads the same cell."""
    found = shown(LoadCellGain(0.03, in_servo), LoadFrameCompliance(1e-6))
    true = FORCE / (1 + 0.03 * in_servo)
    assert float(found.observables["deflection"]) == pytest.approx(1e-6 * true)
    assert float(found.curve.force.max()) == pytest.approx(1.03 * true)


def test_offset_and_drift_stay_when_the_machine_is_unloaded():
    found = shown(LoadCellOffset(8.0, 0.0), LoadCellDrift(0.01, 0.0))
    assert float(found.curve.force[0]) == 8.0
    assert float(found.curve.force[-1]) == pytest.approx(8.0 + 0.01 * 2 * LOADING)
    assert float(shown(LoadCellOffset(8.0)).curve.force.max()) == pytest.approx(FORCE)


def test_a_late_reading_lets_the_force_overshoot_and_makes_a_loop():
    lag, rate = 2.0, FORCE / LOADING  # s, N/s
    found = shown(AcquisitionLag(lag), LoadFrameCompliance(1e-6))
    true = 1e6 * np.asarray(found.curve.displacement)
    behind = true - np.asarray(found.curve.force)
    assert float(found.observables["deflection"]) == pytest.approx(
        1e-6 * (FORCE + rate * lag), rel=2e-3
    )
    assert behind[150] == pytest.approx(rate * lag, rel=0.05) == -behind[350]


@pytest.mark.parametrize("name", EFFECTS)
def test_the_base_model_can_be_differentiated(name):
    def deflection(strength):
        return shown(of(name, strength)).observables["deflection"]

    slope = float(jax.grad(deflection)(jnp.asarray(0.0)))
    wanted = {"load_frame_compliance": FORCE, "seating_gap": 1.0}
    assert slope == pytest.approx(wanted.get(name, 0.0), abs=1e-6)


# ---- in a lab file ----------------------------------------------------------------------------


def test_it_stands_in_a_lab_file_and_takes_no_specimen(tmp_path):
    lab = lab_of(tmp_path, HEAD + SOIL + MACHINE)
    assert [[test.called for test in s.tests] for s in lab.specimens()] == [["confined"]]
    machine = bare_machine(lab)
    assert machine is not None and machine.tests["machine"].observables == ("deflection",)
    assert lab.targets["deflection_mm"].mean == pytest.approx(0.05)
    assert bare_machine(lab.on_soil()) is None


@pytest.mark.slow
def test_no_soil_changes_it_so_a_fit_compares_nothing_of_it(tmp_path):
    lab = lab_of(tmp_path, HEAD + MACHINE + SOIL)
    problem = pose(lab)
    assert [feature.name for feature in problem.features] == ["depression_depth_mm"]
    work, soil = campaign(lab, TINY, tmp_path, Silent()), base_soil(lab)
    result, runs = simulate(lab, TINY, with_values(soil, {"shear_modulus": 5e6}), 0, work)
    assert [run.failure for run in runs] == ["", ""]
    assert result["observables"]["deflection_mm"] == 0.0 == result["spread"]["deflection_mm"]
    assert result["observables"]["depression_depth_mm"] > 0
    assert set(rates_json(work)) == {"confined"}
    (softer,) = work.runs([soil], [0], "again")[0]
    np.testing.assert_array_equal(softer.curves["machine"], runs[0].curves["machine"])
    assert record(Measured, measured_json(lab)).tests["machine"].guides_n == [FORCE]


def test_a_lab_of_the_machine_alone_is_simulated_and_not_fitted(tmp_path):
    lab = lab_of(tmp_path, HEAD + MACHINE)
    work = campaign(lab, TINY, tmp_path, Silent())
    result, _ = simulate(lab, TINY, base_soil(lab), 0, work)
    assert result["observables"] == {"deflection_mm": 0.0} and result["failures"] == []
    assert result["quality"]["spheres"] == work.simulated == 0
    with pytest.raises(InputError, match=r"measured on soil.*add a test of soil"):
        pose(lab)


def test_what_takes_one_specimen_takes_that_of_the_soil(tmp_path):
    lab = lab_of(tmp_path, HEAD + MACHINE + SOIL)
    session = Session(lab, TINY, tmp_path, Silent())
    assert [t.name for t in session.campaign_of_one(tmp_path).apparatus] == ["confined"]
    assert traces(["fit", "pathwise"]) and not traces(["fit", "ensemble", "regression"])


BAD = {
    'force = "300 N"': ('force = "0 N"', "tests[0].force", "zero force"),
    'loading = "1 min"': ('loading = "0 s"', "tests[0].loading", "no time"),
    "[tests.targets]": ('protocol = [{ step = "load", to = "9 N" }]\n[tests.targets]',
                        "tests[0].protocol", "no protocol"),
    'type = "machine"': ('type = "machine"\nspecimen = { diameter = "9 mm", height = "9 mm" }',
                         "tests[0].specimen", "no specimen"),
    "deflection =": ("settlement =", "tests[0].targets.settlement", "deflection_mm"),
}  # fmt: skip


@pytest.mark.parametrize("old", BAD)
def test_what_it_cannot_be_is_one_line(old, tmp_path):
    new, field, words = BAD[old]
    with pytest.raises(InputError) as caught:
        lab_of(tmp_path, HEAD + MACHINE.replace(old, new, 1))
    assert caught.value.field == field and words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
