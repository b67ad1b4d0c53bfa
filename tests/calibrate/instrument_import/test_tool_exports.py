"""Exports of tests with tools, where the user names the test: vane, cone, plate and shear box.

Records are straight lines and exponentials whose numbers are known by hand:
F = 2T/D and x = phi D/2 of a vane, F = p A of a cone or a plate, F = tau A of a box.
"""

import json
import math

import numpy as np
import pytest
from openpyxl import Workbook

from calibrate.core.errors import InputError
from calibrate.inference.problem import pose
from calibrate.instrument_import.convert import read_export
from calibrate.instrument_import.measured import Units
from calibrate.instrument_import.sizes import Size, tool_sizes
from calibrate.instrument_import.toollab import tool_tests
from calibrate.instrument_import.unittext import unit_of
from calibrate.instrument_import.vocabulary import RECORDED, Quantity
from calibrate.io.lab import load_lab
from calibrate.labtests.composite import TYPES
from tests.support.machine_files import written

EXACT = 1e-9
TURN = np.arange(0, 91.0)  # degrees
TORQUE = np.where(TURN <= 30, TURN / 30 * 0.125, 0.08 + 0.045 * np.exp(-(TURN - 30) / 5))  # N m
DEPTH = np.linspace(0, 60, 121)  # mm
WAY = np.linspace(0, 8, 161)  # mm
TAU = np.where(WAY <= 2, 20 * WAY, 32 + 8 * np.exp(-(WAY - 2) * 2))  # kPa, with a peak of 40
BOX = 36e-4  # m2


def table(heads, *values, before=(), delimiter=";"):
    rows = [delimiter.join(f"{v:.12g}" for v in row) for row in zip(*values, strict=True)]
    return "\n".join([*before, delimiter.join(heads), *rows]) + "\n"


def vane(heads=("Angle (deg)", "Torque (N m)"), scale=(1, 1), before=("Vane diameter: 20 mm",)):
    return table(heads, scale[0] * TURN, scale[1] * TORQUE, before=before)


def box(heads, *more, load=TAU, before=("Box area: 36 cm2", "Height: 20 mm")):
    return table((*heads, *(head for head, _ in more)), WAY, load, *(v for _, v in more),
                 before=before)  # fmt: skip


def numbers(folder, text, test, **choices):
    """The numbers of the one test that a file holds, of its first specimen."""
    (found,) = tool_tests(read_export(written(folder, text), test, **choices))
    return {name: float(values[0]) for name, values in found.numbers.items()}, found


def refusal(folder, text, test=None, **choices):
    with pytest.raises(InputError) as refused:
        tool_tests(read_export(written(folder, text), test, **choices))
    said = str(refused.value)
    assert len(said.splitlines()) == 1 and ";" in said
    return said


# ------------------------------------------------------------------ vane


def test_a_torque_and_an_angle_become_force_and_way_at_the_rim(tmp_path):
    (specimen,) = read_export(written(tmp_path, vane()), "vane_shear").specimens
    np.testing.assert_allclose(specimen.force_n, TORQUE / 0.01, rtol=EXACT)
    np.testing.assert_allclose(specimen.displacement_mm, np.radians(TURN) * 10, rtol=EXACT)


def test_the_torques_of_a_vane_are_those_of_the_record(tmp_path):
    found, test = numbers(tmp_path, vane(), "vane_shear")
    last = TURN >= 60
    mean = np.trapezoid(TORQUE[last], TURN[last]) / 30
    assert found == pytest.approx(
        {"peak_torque_mnm": 125.0, "residual_torque_mnm": 1e3 * mean}, rel=EXACT
    )
    assert test.entries["angle"] == 90.0 and test.entries["diameter"] == "20 mm"


IN_UNITS = {
    "Torque (N cm)": 100, "Drehmoment [Ncm]": 100, "Torque_Nm": 1, "torque (mN·m)": 1e3,
    "Moment (kN.m)": 1e-3, "Par de torsión (kgf cm)": 100 / 9.80665, "扭矩(N·m)": 1,
    "Couple (N.m)": 1, "Torque (in-lb)": 1 / (4.4482216152605 * 0.0254), "T (Nm)": 1,
    "Torque [kg cm]": 100 / 9.80665, "Momento torcente (Nmm)": 1e3,
}  # fmt: skip


@pytest.mark.parametrize("heading", IN_UNITS)
def test_a_torque_in_any_unit(tmp_path, heading):
    text = vane(("Rotation (°)", heading), (1, IN_UNITS[heading]))
    found, _ = numbers(tmp_path, text, "vane_shear")
    assert found["peak_torque_mnm"] == pytest.approx(125.0, rel=EXACT)


@pytest.mark.parametrize(
    ("heading", "scale"),
    [("Winkel [°]", 1), ("Angle (rad)", np.pi / 180), ("转角(度)", 1), ("Rotation (gon)", 10 / 9),
     ("Ángulo de giro (grados)", 1), ("Verdrehung", 1)],
)  # fmt: skip
def test_an_angle_in_any_unit(tmp_path, heading, scale):
    text = vane((heading, "Torque (N m)"), (scale, 1))
    _, test = numbers(tmp_path, text, "vane_shear")
    way = test.specimens[0].displacement_mm.max()
    assert way == pytest.approx(10 * math.pi / 2, rel=EXACT)
    texts = [f.text for f in test.specimens[0].findings]
    assert any("taken as degrees" in text for text in texts) == (heading == "Verdrehung")


@pytest.mark.parametrize("signs", [(-1, -1), (1, -1), (-1, 1)])
def test_a_negative_sense_of_rotation_is_turned_and_said(tmp_path, signs):
    found, test = numbers(tmp_path, vane(scale=signs), "vane_shear")
    assert found["peak_torque_mnm"] == pytest.approx(125.0, rel=EXACT)
    assert test.specimens[0].displacement_mm.max() == pytest.approx(5 * math.pi, rel=EXACT)
    said = " ".join(f.text for f in test.specimens[0].findings)
    assert ("torque is negative" in said) == (signs[1] < 0) and "sign was turned" in said


WRONG = {
    "no torque": (("Angle (deg)", "Time (s)"), "no column of torque was found among"),
    "no angle": (("Time (s)", "Torque (N m)"), "no column of angle was found among"),
    "a force": (("Angle (deg)", "Torque (N)"), "'Torque [N]' is not one of torque"),
    "a pressure": (("Angle (deg)", "Torque (kPa)"), "'Torque [kPa]' is not one of torque"),
    "no unit of torque": (("Angle (deg)", "Torque"), 'has no unit; give --force-unit, such as'),
    "an unknown unit": (("Angle (deg)", "Torque (units)"), 'not known; give --force-unit'),
    "degrees or gradians": (("Winkel [Grad]", "Torque (N m)"), "give --displacement-unit, such as"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_record_of_a_vane_is_refused_by_name(tmp_path, case):
    heads, said = WRONG[case]
    assert said in refusal(tmp_path, vane(heads), "vane_shear")


def test_units_of_load_and_travel_may_be_insisted_on(tmp_path):
    kinds = (Quantity.TORQUE, Quantity.ANGLE)
    units = Units(force=unit_of("N cm", kinds), displacement=unit_of("deg", kinds))
    text = vane(("Winkel [Grad]", "Moment"), (1, 100))
    found, _ = numbers(tmp_path, text, "vane_shear", units=units)
    assert found["peak_torque_mnm"] == pytest.approx(125.0, rel=EXACT)
    plain = Units(force=unit_of("kN"), displacement=unit_of("deg", kinds))
    assert "kN is not a unit of torque" in refusal(tmp_path, text, "vane_shear", units=plain)


# ------------------------------------------------------------------ cone and plate

SMALL = math.pi / 4 * 12.83**2  # mm2
LENGTH = 12.83 / 2 / math.tan(math.radians(15))  # mm, of a cone of 30 degrees


@pytest.mark.parametrize(
    ("heading", "scale"),
    [("Cone resistance (MPa)", 1e-3), ("Load (N)", 1e-3 * SMALL), ("Spitzendruck [kPa]", 1),
     ("Penetration force (kN)", 1e-6 * SMALL), ("Pressure (bar)", 0.01)],
)  # fmt: skip
def test_the_cone_index_is_the_mean_over_the_depths(tmp_path, heading, scale):
    """p = 10 kPa/mm z: 300 kPa over 60 mm."""
    text = table(("Depth (mm)", heading), DEPTH, 10 * DEPTH * scale, before=["Cone base: 30 deg"])
    found, test = numbers(tmp_path, text, "cone_penetration")
    assert found["cone_index_kpa"] == pytest.approx(300.0, rel=EXACT)
    assert test.entries["depth_to"] == "60 mm" and "depth_from" not in test.entries
    assert any("ASSUMED 12.83 mm" in f.text and f.fault for f in test.specimens[0].findings)


def test_a_travel_counts_from_where_the_apex_touches(tmp_path):
    """20 mm in air; the base is less deep than the apex by the length of the cone.  Contact is
    found by a mean over nine readings, 0.05 mm apart: at most four before the touch."""
    way = np.linspace(-20, 60, 1601)
    text = table(("Travel (mm)", "Force (N)"), way + 33, np.maximum(2 * way, 0))
    _, test = numbers(tmp_path, text, "cone_penetration")
    (curve,) = test.specimens
    late = curve.displacement_mm[-1] - (60 - LENGTH)
    assert 0 <= late <= 0.2 + 1e-9
    assert curve.contact_mm == pytest.approx(33 - late + LENGTH, rel=EXACT)
    depth = float(test.entries["depth_to"].removesuffix(" mm"))
    assert curve.displacement_mm[-1] - 0.01 <= depth <= curve.displacement_mm[-1]


def test_depths_below_the_surface_begin_where_the_record_does(tmp_path):
    text = table(("Depth (cm)", "Cone index (kPa)"), 0.5 + DEPTH / 10, 500 + DEPTH)
    found, test = numbers(tmp_path, text, "cone_penetration", size=Size(tool=(0.02,)))
    assert test.entries["depth_from"] == "5 mm" and test.entries["depth_to"] == "65 mm"
    assert found["cone_index_kpa"] == pytest.approx(530.0, rel=EXACT)


def test_the_pressure_of_a_plate_is_read_at_its_sinkage(tmp_path):
    """p = 1 kPa + 6 kPa/mm z; a sinkage of half the plate's width at most."""
    before = ["Plate diameter: 50 mm"]
    text = table(("Sinkage (mm)", "Pressure (kPa)"), DEPTH, 1 + 6 * DEPTH, before=before)
    found, test = numbers(tmp_path, text, "plate_sinkage")
    assert test.entries["sinkage"] == "25 mm"
    assert found["sinkage_pressure_kpa"] == pytest.approx(151.0, rel=EXACT)
    force = np.pi / 4 * 0.05**2 * 1e3 * 361
    assert test.specimens[0].force_n.max() == pytest.approx(force, rel=EXACT)


# ------------------------------------------------------------------ shear box


@pytest.mark.parametrize(
    ("heads", "scale"),
    [
        (("Horizontal displacement (mm)", "Shear stress (kPa)"), 1),
        (("Scherweg [mm]", "Scherkraft [N]"), 1e3 * BOX),
        (("Desplazamiento horizontal (mm)", "Esfuerzo cortante (kg/cm2)"), 1 / 98.0665),
        (("Déplacement horizontal (mm)", "Contrainte de cisaillement (kPa)"), 1),
        (("剪切位移(mm)", "剪应力(kPa)"), 1),
        (("Displacement (mm)", "Load (kN)"), BOX),
    ],
)  # fmt: skip
def test_the_shear_stress_is_force_over_the_area_of_the_box(tmp_path, heads, scale):
    more = (("Vertical displacement (mm)", WAY / 50), ("Normal stress (kPa)", 0 * WAY + 50))
    found, test = numbers(tmp_path, box(heads, *more, load=scale * TAU), "direct_shear")
    last = WAY >= 0.8 * 8 - 1e-9
    residual = np.trapezoid(TAU[last], WAY[last]) / np.ptp(WAY[last])
    wanted = {"peak_shear_stress_kpa": 40.0, "residual_shear_stress_kpa": residual}
    assert found == pytest.approx(wanted, rel=EXACT)
    np.testing.assert_allclose(test.specimens[0].force_n, 1e3 * BOX * TAU, rtol=EXACT)
    assert test.entries["normal_stress"] == "50 kPa" and test.entries["travel"] == "8 mm"
    taken = [f for f in test.specimens[0].findings if "taken as the shear" in f.text]
    assert bool(taken) == ("Load (kN)" in heads)


HEADS = ("Shear displacement (mm)", "Shear stress (kPa)")
STATED = {
    "a column of force": box(HEADS, ("Normal load (N)", 0 * WAY - 50e3 * BOX)),
    "a line above": box(HEADS, before=("Box area: 36 cm2", "Normal stress: 50 kPa")),
    "a German line above": box(HEADS, before=("Normalspannung;0,05;MPa",)),
    "the specimen's name": box(HEADS, before=("Box area: 36 cm2", "Specimen: B at 50 kPa")),
}


@pytest.mark.parametrize("where", STATED)
def test_the_normal_stress_may_stand_in_several_places(tmp_path, where):
    _, test = numbers(tmp_path, STATED[where], "direct_shear")
    assert test.tool.condition == pytest.approx(50e3, rel=EXACT)


def test_a_name_says_more_than_a_line_above_another_specimen(tmp_path):
    first = box(HEADS, before=("Box area: 36 cm2", "Specimen: a", "Normal stress: 50 kPa"))
    second = box(HEADS, load=2 * TAU, before=("Specimen: b, 100 kPa",))
    export = read_export(written(tmp_path, f"{first}\n{second}"), "direct_shear")
    assert [test.name for test in tool_tests(export)] == ["50 kPa", "100 kPa"]
    areas = [test.cylinder.area for test in tool_tests(export)]
    assert areas == pytest.approx([BOX, BOX], rel=EXACT)  # stated once, above both


@pytest.mark.parametrize("tool", ["60 x 60 mm", "36 cm^2", "67.70275 mm"])
def test_a_square_box_counts_as_the_round_one_of_its_area(tmp_path, tool):
    heads = ("Shear displacement (mm)", "Shear force (N)")
    text = box(heads, load=1e3 * BOX * TAU, before=())
    size = Size(tool=tool_sizes(tool), height=0.02, normal_stresses=(5e4,))
    found, test = numbers(tmp_path, text, "direct_shear", size=size)
    near = 1e-6 if "." in tool else EXACT
    assert found["peak_shear_stress_kpa"] == pytest.approx(40.0, rel=near)
    assert not any(f.fault for f in test.specimens[0].findings)


def test_an_option_gives_the_normal_stress_that_nobody_states(tmp_path):
    assert "states the normal stress; give --normal-stress" in refusal(
        tmp_path, box(HEADS), "direct_shear"
    )
    size = Size(normal_stresses=(75e3,))
    _, test = numbers(tmp_path, box(HEADS), "direct_shear", size=size)
    assert test.entries["normal_stress"] == "75 kPa"
    size = Size(normal_stresses=(75e3, 80e3))
    assert "2 values of --normal-stress" in refusal(tmp_path, box(HEADS), "direct_shear", size=size)


def workbook(path):
    """A sheet for each normal stress, two of them repeats; the shear stress in proportion."""
    book = Workbook()
    del book["Sheet"]
    for name, share in (("50 kPa", 1.0), ("50 kPa again", 1.1), ("100 kPa", 1.8)):
        page = book.create_sheet(name)
        page.append(list(HEADS))
        for row in zip(WAY, share * TAU, strict=True):
            page.append([float(v) for v in row])
    book.save(path)


def test_normal_stresses_are_tests_on_specimens_of_their_own(calibrate, tmp_path):
    workbook(tmp_path / "box.xlsx")
    line = ("--test", "direct_shear", "--tool", "36 cm^2", "--height", "20 mm", "--out", "o")
    status, out, error = calibrate("convert", "box.xlsx", *line)
    assert (status, error) == (0, "")
    assert "50 kPa: peak shear stress 42 kPa from 2 curve(s)" in out
    lab = load_lab(tmp_path / "o/box.toml")
    assert [test.called for test in lab.tests] == ["50 kPa", "100 kPa"]
    assert [len(s.tests) for s in lab.specimens()] == [1, 1]
    assert lab.specimen.area == pytest.approx(BOX, rel=1e-5)  # of a diameter in six digits
    peak = lab.targets["50 kPa.peak_shear_stress_kpa"]
    assert peak.mean == pytest.approx(42.0, rel=EXACT) and peak.repeats == 2
    assert peak.scatter == pytest.approx(np.std([40, 44], ddof=1), rel=1e-3)
    assert lab.targets["100 kPa.peak_shear_stress_kpa"].mean == pytest.approx(72.0, rel=EXACT)
    kept = json.loads((tmp_path / "o/convert.json").read_text())["observables"]
    assert kept["50 kPa.peak_shear_stress_kpa"] == pytest.approx([40.0, 44.0], rel=EXACT)


# ------------------------------------------------------------------ lab files, sizes, options

FILES = {
    "vane_shear": vane(before=()),
    "cone_penetration": table(("Depth (mm)", "Cone resistance (kPa)"), DEPTH, 10 * DEPTH),
    "plate_sinkage": table(("Sinkage (mm)", "Pressure (kPa)"), DEPTH / 3, 1 + 6 * DEPTH),
    "direct_shear": box(HEADS, ("Normal stress (kPa)", 0 * WAY + 50), before=()),
}


@pytest.mark.parametrize("test", FILES)
def test_the_lab_file_is_one_that_check_and_fit_read(calibrate, tmp_path, test):
    written(tmp_path, FILES[test])
    status, out, error = calibrate("convert", "export.csv", "--test", test, "--out", "o")
    assert (status, error) == (0, "")
    assert "WARNING" in out and "ASSUMED" in out  # its sizes
    lab = load_lab(tmp_path / "o/export.toml")
    (curve,) = lab.curves
    assert not curve.compared and curve.test == test
    problem = pose(lab)
    assert [f.name for f in problem.features] == list(lab.targets)
    kept = json.loads((tmp_path / "o/convert.json").read_text())["observables"]
    wanted = {name: values[0] for name, values in kept.items()}
    assert {n: t.mean for n, t in lab.targets.items()} == pytest.approx(wanted, rel=EXACT)
    assert calibrate("check", "o/export.toml")[0] == 0
    assert (tmp_path / "o/preview.png").stat().st_size > 10_000


@pytest.mark.parametrize("test", FILES)
def test_without_a_test_the_refusal_names_it(tmp_path, test):
    assert f"give --test {test}" in refusal(tmp_path, FILES[test])


def test_a_curve_that_is_not_compared_measures_nothing(calibrate, tmp_path):
    written(tmp_path, FILES["vane_shear"])
    calibrate("convert", "export.csv", "--test", "vane_shear", "--out", "o")
    path = tmp_path / "o/export.toml"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith("targets")))
    with pytest.raises(InputError, match="nothing measured"):
        load_lab(path)
    path.write_text(path.read_text().replace("compared = false", "compared = true"))
    assert len(pose(load_lab(path)).features) > 2


def test_sizes_are_those_of_the_option_then_of_the_file(tmp_path):
    text = vane(before=("Vane diameter: 16 mm", "Vane height: 32 mm", "Sample diameter: 90 mm"))
    _, test = numbers(tmp_path, text, "vane_shear")
    assert (test.entries["diameter"], test.entries["height"]) == ("16 mm", "32 mm")
    assert test.cylinder.diameter == pytest.approx(0.08)  # five times the vane
    _, test = numbers(tmp_path, text, "vane_shear", size=Size(tool=(0.02,), diameter=0.09))
    assert (test.entries["diameter"], test.entries["height"]) == ("20 mm", "20 mm")
    assert test.cylinder.diameter == 0.09
    said = refusal(tmp_path, text, "vane_shear", size=Size(tool=(0.02,), diameter=0.03))
    assert "has no room in a mould of 30 mm" in said


@pytest.mark.parametrize(
    ("text", "sizes"),
    [("20 mm", [0.02]), ("20 x 40 mm", [0.02, 0.04]), ("2 cm × 40 mm", [0.02, 0.04]),
     ("36 cm^2", [math.sqrt(4 * 36e-4 / math.pi)])],
)  # fmt: skip
def test_sizes_of_a_tool_as_they_are_written(text, sizes):
    assert tool_sizes(text) == pytest.approx(sizes, rel=EXACT)


REFUSED = {
    "a tool of compression": (("--test", "confined", "--tool", "20 mm"), "says nothing of a conf"),
    "a stress on a vane": (("--test", "vane_shear", "--normal-stress", "5 kPa"), "direct_shear"),
    "steps of a vane": (("--test", "vane_shear", "--points"), "has no load steps"),
    "a size without unit": (("--test", "vane_shear", "--tool", "20"), "has no unit"),
    "a force of a torque": (("--test", "vane_shear", "--force-unit", "mm"), "not a unit of force"),
    "three sizes": (("--test", "vane_shear", "--tool", "2x2x2 cm"), "diameter x height"),
    "a vane of metres": (("--test", "vane_shear", "--tool", "20 m"), "outside 2 mm to 300 mm"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_options_that_do_not_fit_are_refused_in_one_line(calibrate, tmp_path, case):
    line, said = REFUSED[case]
    written(tmp_path, vane(before=()))
    status, _, error = calibrate("convert", "export.csv", *line, "--out", "o")
    assert status == 2 and said in error and len(error.splitlines()) == 1


SHORT = {
    "a vane hardly turned": (
        table(("Angle (deg)", "Torque (N m)"), TURN / 30, TORQUE), "vane_shear", "3 degrees only",
    ),
    "a cone above the soil": (
        table(("Travel (mm)", "Force (N)"), DEPTH / 6, DEPTH), "cone_penetration", "base of the",
    ),
    "an impossible cone index": (
        table(("Depth (mm)", "Cone index (MPa)"), DEPTH, 9 * DEPTH), "cone_penetration",
        "cone index would be 2.7e+05 kPa, where 1 kPa to 20 MPa is usual",
    ),
    "a box hardly moved": (
        box(HEADS).replace("(mm)", "(um)"), "direct_shear", "move by 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SHORT)
def test_records_that_say_nothing_of_the_test_are_refused(tmp_path, case):
    text, test, said = SHORT[case]
    assert said in refusal(tmp_path, text, test, size=Size(normal_stresses=(5e4,)))


def test_a_torque_that_still_rises_has_no_peak(tmp_path):
    text = table(("Angle (deg)", "Torque (N m)"), TURN, TURN / 300)
    found, test = numbers(tmp_path, text, "vane_shear")
    assert list(found) == ["peak_torque_mnm"]
    assert any("no peak" in f.text and f.fault for f in test.specimens[0].findings)


# ------------------------------------------------------------------ what the tests declare


@pytest.mark.parametrize("test", RECORDED)
def test_kinds_of_columns_are_known_and_usual_tools_have_room(test):
    record = RECORDED[test]
    assert {Quantity(kind) for kind in record.kinds}
    if record.own_bed:
        return
    for width in (0.005, 0.0127, 0.02, 0.05, 0.08):
        made = TYPES[test].model_validate({"type": test, **record.entries((width,))[0]})
        made.check_on(record.bed(made))
