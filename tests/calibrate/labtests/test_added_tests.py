"""Two types of test beyond the pair: the oedometer by load steps, whose published data are read as
they are and answered by a simulation, and a hold at 400 N: what force is left, with and without a
soil that feels the rate.  And a number beyond those of the pair: the strain at failure.  Tests with
tools: cone, plate, shear box, lifted cylinder."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.figures.panels import compression
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.problem import pose
from calibrate.inference.verified import parts
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.base import Pace, Shown
from calibrate.labtests.composite import TYPES, label
from calibrate.labtests.direct_shear import DirectShearTest
from calibrate.labtests.measured import Cylinder
from calibrate.labtests.repose import ReposeTest
from calibrate.labtests.unconfined import FAILURE_STRAIN
from calibrate.records.base import Measured, record
from calibrate.simulation.resolution import PRESETS, Preset, specimen, virtual_lab
from calibrate.simulation.run import summary
from calibrate.simulation.specimens import _wider, campaign, measured_json, simulate
from calibrate.verbs.check import check
from calibrate.verbs.example import examples
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


# ---------------------------------------------------------------- tools

TOOLS = """[soil]
name = "x"
[specimen]
diameter = "60 mm"
height = "40 mm"
[particles]
reference_diameter = "80 um"
[parameters]
surface_energy = "2 J/m^2"
"""
CONE = """[[tests]]
type = "cone_penetration"
angle = 60.0
depth_to = "15 mm"
targets.cone_index = { mean = "50 kPa", scatter = "5 kPa", repeats = 3 }
"""
PLATE = """[[tests]]
type = "plate_sinkage"
sinkage = "4 mm"
targets.sinkage_pressure = { mean = "50 kPa", scatter = "5 kPa", repeats = 3 }
"""
SHEAR = """[[tests]]
type = "direct_shear"
normal_stress = "50 kPa"
travel = "3 mm"
targets.peak_shear_stress = { mean = "50 kPa", scatter = "5 kPa", repeats = 3 }
"""
REPOSE = """[[tests]]
type = "repose_angle"
targets.repose_angle = { mean = "30 deg", scatter = "2 deg", repeats = 3 }
"""
VANE = """[[tests]]
type = "vane_shear"
depth = "25 mm"
targets.peak_torque = { mean = "0.5 N*m", scatter = "50 mN*m", repeats = 3 }
"""
BALL = """[[tests]]
type = "ball_penetration"
depth_to = "20 mm"
targets.ball_resistance = { mean = "50 kPa", scatter = "5 kPa", repeats = 3 }
"""
UNCONFINED = """[[tests]]
type = "unconfined"
"""
REFUSED = {
    "a cone deeper than the bed": (CONE.replace("15 mm", "60 mm"), "depth_to: .* deep into a bed"),
    "a plate as wide as the mould": (
        PLATE.replace("sinkage =", 'diameter = "50 mm"\nsinkage ='), "diameter: .* has no room",
    ),
    "a shaft wider than its cone": (
        CONE.replace("angle", 'shaft = "30 mm"\nangle'), "shaft: .* wider than the cone",
    ),
    "no normal stress": (SHEAR.replace('normal_stress = "50 kPa"\n', ""), "normal_stress: missing"),
    "a box that opens too far": (SHEAR.replace("3 mm", "20 mm"), "travel: .* quarter"),
    "a tool without mould": (UNCONFINED + CONE, "unconfined opens the mould"),
    "a test on what a tool left": (SHEAR + UNCONFINED, "direct_shear leaves the soil disturbed"),
    "a protocol of a cone": (
        CONE + "protocol = [{ step = 'load', to = '1 kPa' }]\n", "protocol: .* follows no protocol",
    ),
    "a vane above the soil": (VANE.replace("25 mm", "15 mm"), "depth: .* not covered"),
    "depths in the wrong order": (BALL.replace("20 mm", "5 mm"), "depth_from: .* not above"),
    "a force for an angle": (REPOSE.replace("30 deg", "30 N"), "not a unit of angle"),
}  # fmt: skip


def lab_of(tmp_path, tests):
    path = tmp_path / "lab.toml"
    dry = TOOLS.replace("2 J/m^2", "0 J/m^2") if tests == REPOSE else TOOLS
    path.write_text(dry + tests)
    return load_lab(path)


@pytest.mark.parametrize("name", REFUSED)
def test_tools_that_cannot_be_are_named_with_their_repair(tmp_path, name):
    tests, said = REFUSED[name]
    with pytest.raises(
        InputError, match=r"field 'tests\[\d\]" if "field" in said else "."
    ) as error:
        lab_of(tmp_path, tests)
    text = str(error.value).replace("'", "")
    assert re.search(said, text), text


def test_figures_say_what_a_tool_is_pushed_or_turned_by(tmp_path):
    axis = Figure().subplots()
    for tests, along, up in ((VANE, "blades' rim (mm)", "at the rim (N)"), (CONE, "depth", "cone")):
        lab = lab_of(tmp_path, tests)
        compression(axis, lab.tests[0].called, [], record(Measured, measured_json(lab)))
        assert along in axis.get_xlabel() and up in axis.get_ylabel()


@pytest.mark.slow
@pytest.mark.parametrize(
    "tests",
    [CONE, PLATE, SHEAR, REPOSE, VANE, BALL],
    ids=["cone", "plate", "box", "heap", "vane", "ball"],
)
def test_a_tool_in_a_bed_gives_numbers_with_their_order(tmp_path, tests):
    """More friction makes the soil harder, or the heap steeper."""
    lab = lab_of(tmp_path, tests)
    small = Preset("small", 150, 0.2, 0.2, 1)
    work = campaign(lab, small, tmp_path, Silent())
    soils = [replace(base_soil(lab), static_friction=np.asarray(mu)) for mu in (0.05, 0.9)]
    results = [simulate(lab, small, soil, 0, work)[0] for soil in soils]
    found, quality = [each["observables"] for each in results], results[1]["quality"]
    (wanted,) = lab.targets
    assert 0 < found[0][wanted] < found[1][wanted]
    assert all(np.isfinite(value) for value in found[1].values())
    assert (0 < quality["inertial_number"] < 1) if tests != REPOSE else True
    ((_, curve),) = results[1]["curves"].items()
    beside = set() if tests == CONE else {c.name for c in lab.tests[0].channels}  # without shaft
    assert {*curve} == {"displacement_mm", "force_n"} | beside
    assert len({len(column) for column in curve.values()}) == 1
    if tests == VANE:  # D = 20 mm
        np.testing.assert_allclose(curve["torque_mnm"], 10 * np.array(curve["force_n"]))
        way = np.radians(curve["angle_deg"]) * 10
        np.testing.assert_allclose(way, curve["displacement_mm"], atol=1e-9)
    if tests == SHEAR:
        peak = int(np.argmax(curve["force_n"]))
        assert curve["plane_force_n"][peak] == pytest.approx(
            found[1]["plane_stress_kpa"] * np.pi / 4 * 60**2 / 1e3, rel=0.1
        )
    width = getattr(lab.tests[0], "diameter", None)
    assert quality.get("tool_across") == (
        None if width is None else pytest.approx(width / 0.06 * quality["spheres_across"])
    )
    assert (0 < quality["tool_overlap"] < 1) if width else ("tool_overlap" not in quality)


def test_shear_tests_together_give_cohesion_and_friction():
    """tau = 12 kPa + 0.7 sigma on the plane, which carries 1.2 times the lid's stress."""
    found = {
        str(lid): {
            "lid_stress_kpa": lid, "plane_stress_kpa": 1.2 * lid,
            "peak_shear_stress_kpa": 12 + 0.7 * 1.2 * lid,
        }
        for lid in (25.0, 50.0, 100.0)
    }  # fmt: skip
    said = DirectShearTest.together(found)
    assert said["cohesion_on_plane_kpa"] == pytest.approx(12)
    assert said["friction_angle_on_plane_deg"] == pytest.approx(np.degrees(np.arctan(0.7)))
    assert said["friction_angle_on_lid_deg"] == pytest.approx(np.degrees(np.arctan(0.84)))
    assert DirectShearTest.together({"25.0": found["25.0"]}) == {}
    assert label("cohesion_on_lid_kpa") == "cohesion, by the stress of the lid (kPa)"
    assert set(said) == {each.name for each in DirectShearTest.combined}


def test_every_example_is_a_lab_file_of_the_test_that_it_is_called_after(tmp_path):
    for name, example in examples().items():
        path = tmp_path / "lab.toml"
        path.write_text(example.lab)
        lab = load_lab(path)
        assert lab.targets and example.minutes <= 15
        assert name in {test.type_name for test in lab.tests} or name not in TYPES
        assert not [said for said in check(lab).warnings if "refuses" in said], name


def test_soil_that_stands_has_no_angle_of_repose():
    test = ReposeTest()
    angle, *_, height = test.observables
    heap = {"heap_height": 37.0}
    said = test.doubt(angle, Shown(Cylinder(0.06, 0.04, None), np.zeros((0, 2)), heap))
    assert "92 % as high" in said and "stands" in said
    assert not test.doubt(height, Shown(Cylinder(0.06, 0.04, None), np.zeros((0, 2)), heap))
    assert not test.doubt(angle, Shown(Cylinder(0.06, 0.05, None), np.zeros((0, 2)), heap))


def test_a_box_beside_a_column_is_as_wide_as_it_is(tmp_path):
    """A run knows how wide its narrowest specimen is; as many spheres fill the flat box."""
    path = tmp_path / "lab.toml"
    box = 'specimen = { diameter = "61.8 mm", height = "20 mm" }\n'
    path.write_text(
        '[soil]\nname = "both"\n[specimen]\ndiameter = "50 mm"\nheight = "100 mm"\n'
        '[[tests]]\ntype = "confined"\n' + SHEAR.rstrip() + "\n" + box,
        encoding="utf-8",
    )
    lab = load_lab(path)
    column, sheared = lab.tests
    assert _wider(lab, column) == 1.0
    assert _wider(lab, sheared) == pytest.approx((0.0618 / 0.02 / 0.5) ** (1 / 3))


@pytest.mark.parametrize(
    ("across", "gap", "said"),
    [(9.9, {}, "9.9 spheres wide (ASTM D3080 asks for 10)"), (10.0, {}, "10.0 spheres wide: "),
     (59.0, {}, "strengths read high"), (60.0, {}, ""),
     (60.0, {"gap": "0.3 mm"}, "0.29 of a sphere"), (60.0, {"gap": "0.5 mm"}, "")],
)  # fmt: skip
def test_a_shear_box_that_is_narrow_or_catches_spheres_is_doubted(across, gap, said):
    test = DirectShearTest.model_validate({"normal_stress": "50 kPa", **gap})
    peak, residual, on_plane = test.given
    way = np.linspace(0, 6, 100)
    flat = np.stack([way, 100 * np.minimum(way, 1)], axis=1)
    shown = Shown(Cylinder(0.0618, 0.02, None), flat, {}, across)
    for strength in (peak, residual):
        assert said in test.doubt(strength, shown)
        assert bool(test.doubt(strength, shown)) == bool(said)
    assert not test.doubt(on_plane, shown)


def test_the_halves_of_a_box_stand_half_a_sphere_apart_unless_stated():
    usual = DirectShearTest.model_validate({"normal_stress": "50 kPa"})
    stated = DirectShearTest.model_validate({"normal_stress": "50 kPa", "gap": "2 mm"})
    ring, pace = Cylinder(0.0618, 0.02, None), Pace(0.05, 0.05, 1e-3, sphere=4e-3)
    assert eqx.tree_equal(usual.apparatus(ring, pace), stated.apparatus(ring, pace))
    large = replace(pace, sphere=6e-3)
    assert not eqx.tree_equal(usual.apparatus(ring, large), stated.apparatus(ring, large))
    assert eqx.tree_equal(stated.apparatus(ring, large), stated.apparatus(ring, pace))


def test_a_simulated_box_knows_its_spheres(tmp_path):
    """The machine of the lab file's test is that of a gap of half the mean sphere."""
    lab, preset = lab_of(tmp_path, SHEAR), replace(PRESETS["quick"], spheres=1500)
    filled = specimen(lab, preset)
    gap = f"{1e3 * filled.mean_radius():.12g} mm"
    stated = lab_of(tmp_path, SHEAR.replace("travel =", f'gap = "{gap}"\ntravel ='))
    machines = (virtual_lab(each, preset).tests.apparatus for each in (lab, stated))
    half, same = (jax.tree.leaves(eqx.filter(each, eqx.is_inexact_array)) for each in machines)
    assert all(np.allclose(a, b, rtol=1e-9) for a, b in zip(half, same, strict=True))


# ---------------------------------------------------------------- some fitted, others verified

OWN = 'specimen = { diameter = "60 mm", height = "40 mm" }\n'
SEVERAL = (
    '[[tests]]\ntype = "confined"\n' + CONE
    + SHEAR.replace("travel", OWN + "travel") + PLATE.replace("sinkage =", OWN + "sinkage =")
)  # fmt: skip


def test_a_fit_sees_its_tests_and_what_prepares_them(tmp_path):
    lab = lab_of(tmp_path, SEVERAL)
    fitted, held_back = parts(lab, ["cone_penetration"], ["direct_shear"])
    assert [test.called for test in fitted.tests] == ["confined", "cone_penetration"]
    assert set(fitted.targets) == {"cone_index_kpa"}
    assert held_back is not None
    assert [test.called for test in held_back.tests] == ["direct_shear"]
    assert set(held_back.targets) == {"peak_shear_stress_kpa"}
    rest, nothing = parts(lab, [], ["plate_sinkage"])
    assert set(rest.targets) == {"cone_index_kpa", "peak_shear_stress_kpa"}
    assert parts(lab, [], [])[0].targets == lab.targets and nothing is not None
    with pytest.raises(InputError, match="nothing is measured in confined"):
        parts(lab, ["confined"], [])
    with pytest.raises(InputError, match="no test is called 'cone'"):
        parts(lab, ["cone"], [])
    with pytest.raises(InputError, match="is in both"):
        parts(lab, ["plate_sinkage"], ["plate_sinkage"])
