"""Stress, strain, void ratio and load steps become force and displacement of a stated size.

Expected numbers are the formulas, applied to what the files hold:
F = sigma pi d^2/4, x = epsilon h, epsilon = (e0 - e)/(1 + e0), q_u = 2 s_u.
"""

import csv
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

import calibrate as package
from calibrate.core.errors import InputError
from calibrate.inference.problem import pose
from calibrate.instrument_import import labtext
from calibrate.instrument_import.convert import read_export
from calibrate.instrument_import.headings import split_heading
from calibrate.instrument_import.measured import Units
from calibrate.instrument_import.preamble import read_preamble
from calibrate.instrument_import.sizes import Size, initial_void_ratios
from calibrate.instrument_import.steps import ends_of_steps, turning_rows
from calibrate.instrument_import.vocabulary import TESTS, kind_of
from calibrate.instrument_import.vocabulary import test_named_in as named_in
from calibrate.io.lab import load_lab
from tests.support.machine_files import EXPORTS, curves, only, written
from tests.support.malformed import spoiled_bytes

TRUMAO = Path(package.__file__).parent / "soils" / "trumao_2021"
AREA = np.pi / 4 * 0.05**2  # m2; of 50 mm
SIZE = ("--diameter", "50 mm", "--height", "100 mm")
RING = ("--diameter", "50 mm", "--height", "20 mm")
TALL, LOW = Size(0.05, 0.1), Size(0.05, 0.02)


def table(folder, name):
    """A clean curve as a dict of columns."""
    rows = list(csv.DictReader((folder / name).open()))
    return {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}


def lab_of(folder, name):
    return tomllib.loads((folder / name).read_text(encoding="utf-8"))


def steps_text(heading="sigma_v (kPa);void ratio", rows=((25, 1.2), (50, 1.1), (100, 1.0))):
    lines = [heading, *(";".join(str(value) for value in row) for row in rows)]
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------ curves of stress and strain


def test_stress_and_strain_with_decimal_commas(calibrate, tmp_path):
    status, out, error = calibrate("convert", EXPORTS / "stress_strain.csv", *SIZE, "--out", "o")
    assert (status, error) == (0, "")
    (row,) = json.loads((tmp_path / "o/convert.json").read_text())["specimens"]
    _, travel, force = curves.crushing(9, points=150)
    assert row["test"] == "unconfined"
    assert row["largest_force_n"] == pytest.approx(force.max(), abs=0.6)  # its noise, as zero
    assert row["largest_displacement_mm"] + row["contact_mm"] == pytest.approx(travel[-1], abs=1e-3)
    assert row["converted"]["from"] == ["stress", "strain"]
    assert (row["converted"]["diameter_m"], row["converted"]["height_m"]) == (0.05, 0.1)
    assert "engineering strain" in out


def test_converted_curve_keeps_stress_and_strain_beside(calibrate, tmp_path):
    calibrate("convert", EXPORTS / "stress_strain.csv", *SIZE, "--out", "o")
    (name,) = (path.name for path in (tmp_path / "o").glob("*.csv"))
    curve = table(tmp_path / "o", name)
    assert list(curve) == ["displacement_mm", "force_n", "stress_kpa", "strain"]
    np.testing.assert_allclose(curve["force_n"], 1e3 * curve["stress_kpa"] * AREA, rtol=1e-6)
    np.testing.assert_allclose(curve["displacement_mm"], 100 * curve["strain"], rtol=1e-6)
    lab = lab_of(tmp_path / "o", "stress_strain.toml")
    assert lab["specimen"] == {"diameter": "50 mm", "height": "100 mm"}
    _, test = lab["tests"]
    assert (test["name"], test["type"]) == ("unconfined", "unconfined")
    (curve,) = test["curves"]
    assert curve["file"] == name and "points" not in curve
    assert curve["displacement"] == {"column": "displacement_mm", "unit": "mm"}
    assert curve["force"] == {"column": "force_n", "unit": "N"}


def test_sizes_stand_in_the_lab_file_as_comments(calibrate, tmp_path):
    calibrate("convert", EXPORTS / "stress_strain.csv", *SIZE, "--out", "o")
    text = (tmp_path / "o/stress_strain.toml").read_text()
    assert "times the initial area, 19.635 cm2 (50 mm in diameter)" in text
    assert "times the initial height, 100 mm" in text


STATED = {
    "diameter": ["Diameter;50;mm", "Height;100;mm"],
    "area": ["Area: 19.635 cm2", "Height: 10 cm"],
    "German": ["Durchmesser d0;50,0;mm", "Probenhöhe h0;100,0;mm"],
    "Spanish": ["Diámetro (mm): 50", "Altura (mm): 100"],
}


@pytest.mark.parametrize("language", STATED)
def test_a_size_above_the_table_serves(tmp_path, language):
    text = (EXPORTS / "stress_strain.csv").read_text()
    path = written(tmp_path, "\n".join([*STATED[language], "", text]))
    specimen, given = only(path), only(EXPORTS / "stress_strain.csv", size=TALL)
    np.testing.assert_allclose(specimen.force_n, given.force_n, rtol=1e-4)
    np.testing.assert_allclose(specimen.displacement_mm, given.displacement_mm, rtol=1e-6)


def test_an_option_goes_before_what_the_file_states(tmp_path):
    text = (EXPORTS / "stress_strain.csv").read_text()
    path = written(tmp_path, "Diameter;38;mm\nHeight;76;mm\n" + text)
    specimen = only(path, size=TALL)
    assert (specimen.diameter, specimen.height) == (0.05, 0.1)
    assert any("as given, not 38 mm" in finding.text for finding in specimen.findings)


def one_curve(folder, heading, per_strain, per_stress):
    _, travel, force = curves.crushing(9, points=150)
    rows = zip(travel / 100 * per_strain, force / AREA * per_stress, strict=True)
    return written(folder, steps_text(heading, [(f"{a:.9g}", f"{b:.9g}") for a, b in rows]))


UNITS = {
    "Strain (-);Stress (MPa)": (1, 1e-6),
    "Strain (mm/mm);Stress (N/mm²)": (1, 1e-6),
    "ε [%];σ [kN/m²]": (100, 1e-3),
    "Deformación (%);Esfuerzo (kg/cm2)": (100, 1 / 98066.5),
    "Stauchung [%];Spannung [kPa]": (100, 1e-3),
    "Déformation (%);Contrainte axiale (bar)": (100, 1e-5),
    "Axial strain (%);Axial stress (psi)": (100, 1 / 6894.757293),
    "Extension (mm);Stress (kPa)": (100, 1e-3),
}


@pytest.mark.parametrize("heading", UNITS)
def test_headings_and_units(tmp_path, heading):
    path = one_curve(tmp_path, heading, *UNITS[heading])
    specimen, wanted = only(path, size=TALL), only(EXPORTS / "stress_strain.csv", size=TALL)
    assert specimen.force_n.max() == pytest.approx(wanted.force_n.max(), rel=1e-4)
    assert specimen.displacement_mm.max() == pytest.approx(wanted.displacement_mm.max(), rel=1e-4)


def test_force_beside_strain_needs_the_height_only(tmp_path):
    path = one_curve(tmp_path, "Strain (%);Load (N)", 100, AREA)
    specimen = only(path, size=Size(height=0.1))
    assert specimen.diameter is None
    assert specimen.force_n.max() == pytest.approx(206, abs=2)
    with pytest.raises(InputError, match="strain without a size"):
        read_export(path)


def test_a_file_with_force_and_travel_is_read_by_them(tmp_path):
    lines = ["Extension (mm);Load (N);Strain (%);Stress (kPa)"]
    _, travel, force = curves.crushing(9, points=150)
    lines += [f"{x:.5f};{f:.5f};{x:.5f};{f:.5f}" for x, f in zip(travel, force, strict=True)]
    export = read_export(written(tmp_path, "\n".join(lines)))
    assert export.is_plain
    assert "[[curves]]" in labtext.lab_text(export)


@pytest.mark.parametrize(
    ("heading", "kind"),
    [
        ("sigma_v", "stress"),
        ("σ'v (kPa)", "stress"),
        ("Vertical load (kPa)", "force"),  # its unit makes it a stress
        ("Axial strain (%)", "strain"),
        ("Strain%", "strain"),
        ("void ratio", "void ratio"),
        ("e", "void ratio"),
        ("e (-)", "void ratio"),
        ("e M1", "void ratio"),
        ("Porenzahl e [-]", "void ratio"),
        ("Índice de vacíos", "void ratio"),
        ("Indice des vides", "void ratio"),
        ("e0", None),
        ("E-Modul", "other"),
        ("Pore pressure (kPa)", "other"),
        ("sqrt(t)", "root of time"),
        ("√t (min)", "root of time"),
        ("su", "undrained shear strength"),
        ("qu (kPa)", "compressive strength"),
        ("Load step", None),
    ],
)
def test_kinds_of_columns(heading, kind):
    assert kind_of(split_heading(heading).name)[0] == kind


def test_test_types_are_told_by_their_words():
    texts = {"Ödometerversuch": "oedometer", "UCS, clay": "unconfined", "confined": "confined"}
    texts["stress relaxation"] = "relaxation"
    assert {text: named_in(text) for text in texts} == texts
    assert set(texts.values()) == set(TESTS)


# ------------------------------------------------------------------ load steps


def test_german_oedometer_test_with_reloading(calibrate, tmp_path):
    status, out, error = calibrate("convert", EXPORTS / "load_steps.csv", "--out", "o")
    assert (status, error) == (0, "")
    curve = table(tmp_path / "o", "lehm_3_oedometer.csv")
    np.testing.assert_allclose(curve["stress_kpa"][[0, 4, 6, 9]], [12.5, 200, 25, 400])
    ratio = np.array([0.9081, 0.6071, 0.6432, 0.5318])
    np.testing.assert_allclose(curve["void_ratio"][[0, 4, 6, 9]], ratio, atol=1e-6)
    expected = 20 * (0.912 - ratio) / 1.912
    np.testing.assert_allclose(curve["displacement_mm"][[0, 4, 6, 9]], expected, rtol=1e-5)
    np.testing.assert_allclose(
        curve["force_n"], 1e3 * np.pi / 4 * 0.07**2 * curve["stress_kpa"], rtol=1e-6
    )
    np.testing.assert_allclose(curve["time_s"], 86400 * np.arange(10))
    (test,) = lab_of(tmp_path / "o", "load_steps.toml")["tests"]
    assert test["protocol"] == [
        {"step": "load", "to": "200 kPa"},
        {"step": "unload", "to": "25 kPa"},
        {"step": "reload", "to": "400 kPa"},
    ]
    assert test["curves"][0]["points"] is True
    assert "from 12.5 to 200, then to 25, then to 400 kPa" in out


def test_a_lab_file_of_load_steps_loads(calibrate, tmp_path):
    pytest.importorskip("calibrate.labtests")
    from calibrate.io.lab import load_lab

    calibrate("convert", EXPORTS / "load_steps.csv", "--out", "o")
    assert load_lab(tmp_path / "o/load_steps.toml")


def test_few_steps_without_a_name_are_recognised_by_their_void_ratio(tmp_path):
    path = written(tmp_path, "e0: 1.25\n" + steps_text())
    specimen = only(path, size=LOW)
    assert (specimen.test, specimen.points) == ("oedometer", True)
    np.testing.assert_allclose(
        specimen.displacement_mm, 20 * (1.25 - np.array([1.2, 1.1, 1.0])) / 2.25
    )


def test_few_rows_of_strain_are_load_steps_if_the_user_says_so(tmp_path):
    text = steps_text("Stress (kPa);Strain (%)", [(25, 0.5), (50, 1.0), (100, 2.0), (200, 3.5)])
    path = written(tmp_path, text)
    with pytest.raises(InputError, match="--test oedometer"):
        read_export(path, size=LOW)
    specimen = only(path, test="oedometer", size=LOW)
    np.testing.assert_allclose(specimen.displacement_mm, [0.1, 0.2, 0.4, 0.7])


def test_unloading_to_the_same_stresses_tells_load_steps(tmp_path):
    up = [(25, 0.4), (50, 0.9), (100, 1.7), (200, 2.9), (400, 4.4)]
    down = [(200, 4.2), (100, 4.0), (50, 3.8), (25, 3.6)]
    path = written(tmp_path, steps_text("Stress (kPa);Strain (%)", up + down))
    assert (only(path, size=LOW).test, only(path, size=LOW).points) == ("oedometer", True)
    with pytest.raises(InputError, match="which test it is"):  # nine points of a curve
        read_export(path, size=LOW, points=False)


def test_several_columns_of_void_ratio_are_several_specimens(tmp_path):
    rows = [(25, 1.20, 1.10, 0.9), (50, 1.15, 1.06, 0.88), (100, 1.0, 0.97, 0.85)]
    path = written(tmp_path, steps_text("stress (kPa);e M1;e M2;e M3", rows))
    export = read_export(path, size=Size(0.05, 0.02, (1.25, 1.15, 0.95)))
    assert [s.label for s in export.specimens] == ["M1", "M2", "M3"]
    last = [s.displacement_mm[-1] for s in export.specimens]
    assert last == pytest.approx([20 * 0.25 / 2.25, 20 * 0.18 / 2.15, 20 * 0.1 / 1.95])


def test_readings_of_many_steps_are_reduced_to_their_last(tmp_path):
    """Thirty readings a step, the clock starting again with each."""
    stresses = [25.0, 50.0, 100.0, 200.0, 50.0]
    minutes = np.linspace(0, 1440, 30)
    rows = []
    for number, stress in enumerate(stresses):
        settled = number + 1 - 0.5 * np.exp(-minutes / 60)
        rows += [(m, stress, s) for m, s in zip(minutes, settled, strict=True)]
    text = steps_text("Time (min);Vertical stress (kPa);Axial strain (%)", rows)
    specimen = only(written(tmp_path, "Oedometer test\n" + text), size=LOW)
    np.testing.assert_allclose(specimen.force_n, 1e3 * AREA * np.array(stresses))
    np.testing.assert_allclose(specimen.displacement_mm, 0.2 * np.arange(1, 6))
    assert specimen.time_s is None and any("starts again" in f.text for f in specimen.findings)


def test_a_strain_without_unit_is_judged_over_all_specimens(tmp_path):
    rows = [(25, 0.5, "A"), (50, 0.7, "A"), (100, 0.9, "A")]
    rows += [(25, 2.0, "B"), (50, 4.0, "B"), (100, 8.0, "B")]
    path = written(tmp_path, steps_text("stress;strain;sample", rows))
    first, second = read_export(path, "oedometer", size=LOW).specimens
    assert first.displacement_mm[-1] == pytest.approx(0.18)
    assert second.displacement_mm[-1] == pytest.approx(1.6)


def test_swelling_under_a_rising_load_is_warned_of(tmp_path):
    text = steps_text(rows=((25, 1.2), (50, 1.1), (100, 1.3), (200, 1.0)))
    specimen = only(written(tmp_path, text), size=Size(0.05, 0.02, (1.25,)))
    (warning,) = (f.text for f in specimen.findings if f.fault)
    assert warning == "the soil swells under a rising load in step 3"


def test_steps_from_their_numbers():
    load = np.array([25.0, 50.0, 50.1, 100.0, 50.0, 25.0, 200.0])
    assert turning_rows(load) == [3, 5, 6]
    assert ends_of_steps(load).tolist() == [0, 2, 3, 4, 5, 6]


# ------------------------------------------------------------------ the trumao files


def test_trumao_oedometer(calibrate, tmp_path):
    """Three specimens, thirteen steps each, strain from the first step on."""
    path = TRUMAO / "oedometer.csv"
    status, out, error = calibrate("convert", path, *RING, "--void-ratio", "first", "--out", "o")
    assert (status, error) == (0, "")
    assert out.count("column 'stress' has no unit: taken as kPa") == 3
    ratios = {}
    for row in csv.DictReader(path.open()):
        ratios.setdefault(row["sample"], []).append(float(row["e"]))
    for sample, e in ratios.items():
        curve = table(tmp_path / "o", f"{sample.lower()}_oedometer.csv")
        np.testing.assert_allclose(curve["void_ratio"], e, rtol=1e-6)
        strain = (e[0] - np.array(e)) / (1 + e[0])
        np.testing.assert_allclose(curve["displacement_mm"], 20 * strain, rtol=1e-5, atol=1e-9)
        assert curve["force_n"].max() == pytest.approx(1.2e6 * AREA)
    (test,) = lab_of(tmp_path / "o", "oedometer.toml")["tests"]
    assert len(test["curves"]) == 3 and test["type"] == "oedometer"
    assert [step["to"] for step in test["protocol"]] == ["1200 kPa", "25 kPa"]


def test_trumao_oedometer_with_an_initial_void_ratio_of_each(tmp_path):
    size = Size(0.05, 0.02, initial_void_ratios("2.60, 2.45, 2.50"))
    specimens = read_export(TRUMAO / "oedometer.csv", size=size).specimens
    assert [s.raw.size.void_ratio for s in specimens] == [2.60, 2.45, 2.50]
    assert specimens[0].displacement_mm[0] == pytest.approx(20 * (2.60 - 2.5537523) / 3.60)


def test_trumao_consolidation(calibrate, tmp_path):
    """Degree of consolidation over the root of minutes; the name holds the step."""
    settled = ("--settlement", "0.2 mm, 1 %, 0.9 mm")
    status, _, error = calibrate("convert", TRUMAO / "cv.csv", *RING, *settled, "--out", "o")
    assert (status, error) == (0, "")
    rows = json.loads((tmp_path / "o/convert.json").read_text())["specimens"]
    assert [row["label"] for row in rows] == ["25-50.UA1", "100-200.UA1", "800-1200.UA1"]
    assert [row["points"] for row in rows] == [20, 20, 18]
    assert [row["largest_displacement_mm"] for row in rows] == pytest.approx([0.2, 0.2, 0.9])
    curve = table(tmp_path / "o", "25-50_ua1_oedometer.csv")
    assert curve["time_s"][-1] == pytest.approx(60 * 65.72670690061993**2)
    assert curve["stress_kpa"][:2] == pytest.approx([25, 50])
    assert curve["displacement_mm"][1] == pytest.approx(0.2 * 0.6849315068493151)
    document = lab_of(tmp_path / "o", "cv.toml")
    assert document["parameters"]["shear_modulus"] == "12 MPa"  # ten times the largest stress
    tests = document["tests"]
    assert [test["protocol"][0]["to"] for test in tests] == ["50 kPa", "200 kPa", "1200 kPa"]
    assert len({test["name"] for test in tests}) == 3
    assert all("specimen" in test for test in tests[1:])


def test_of_a_consolidation_the_whole_settlement_is_fitted_and_nothing_of_its_course(
    calibrate, tmp_path
):
    refused = calibrate("convert", TRUMAO / "cv.csv", "--out", "o")[2]
    assert "drainage of pore water, which the model does not have" in refused
    assert len(refused.splitlines()) == 1 and "--settlement" in refused
    settled = ("--settlement", "0.2 mm, 1 %, 0.9 mm")
    _, out, _ = calibrate("convert", TRUMAO / "cv.csv", *RING, *settled, "--out", "o")
    assert "a fit compares its end alone: its course in time is drainage of pore water" in out
    lab = load_lab(tmp_path / "o/cv.toml")
    assert [len(curve.force_n) for curve in lab.curves] == [2, 2, 2]
    problem = pose(lab)
    assert problem.measured == pytest.approx([0.2, 0.2, 0.9])


def test_a_crushing_test_of_a_new_specimen_is_pressed_before(calibrate, tmp_path):
    """Forces of one stress, 204 kPa, whatever the diameter."""
    calibrate("convert", EXPORTS / "stress_strain.csv", "--diameter", "100 mm",
              "--height", "200 mm", "--out", "o")  # fmt: skip
    pressed = lab_of(tmp_path / "o", "stress_strain.toml")["tests"][0]
    assert (pressed["force_low"], pressed["force_high"]) == ("800 N", "1600 N")
    (both,) = load_lab(tmp_path / "o/stress_strain.toml").specimens()
    assert [test.called for test in both.tests] == ["preparation", "unconfined"]


def test_few_points_from_contact_on_start_at_contact(tmp_path):
    rows = [(0, 0), (0.5, 18.4), (1, 41.7), (1.5, 66.2), (2, 85.9), (3, 103.1), (4, 102.2), (6, 70)]
    lines = [f"{a:.1f};{b:.1f}".replace(".", ",") for a, b in rows]
    path = written(tmp_path, "\n".join(["Axial strain (%);Stress (kPa)", *lines]))
    texts = [finding.text for finding in only(path, size=TALL).findings]
    assert any("holds no reading before contact" in text for text in texts)
    assert not any("first contact is missing" in text for text in texts)


def test_trumao_strengths(calibrate, tmp_path):
    """The numbers of the bundled trumao.toml: 142.7 +- 33.1 N of nine specimens."""
    status, out, error = calibrate(
        "convert", TRUMAO / "UCT.csv", "--diameter", "50 mm", "--out", "o"
    )
    assert (status, error) == (0, "")
    pressed, test = lab_of(tmp_path / "o", "uct.toml")["tests"]
    assert [each["type"] for each in (pressed, test)] == ["confined", "unconfined"]
    assert (pressed["name"], pressed["force_high"]) == ("preparation", "400 N")
    assert test["targets"]["crushing_force_n"] == {
        "mean": "142.7 N",
        "scatter": "33.1 N",
        "repeats": 9,
    }
    result = json.loads((tmp_path / "o/convert.json").read_text())
    strengths = [float(row["su"]) for row in csv.DictReader((TRUMAO / "UCT.csv").open())]
    forces = 2e3 * np.array(strengths) * AREA
    np.testing.assert_allclose(result["observables"]["crushing_force_n"], forces)
    assert "twice the undrained one" in out
    assert (tmp_path / "o/preview.png").stat().st_size > 10_000


def test_compressive_strengths_are_taken_as_they_are(tmp_path):
    text = "Specimen;qu (kPa);strain at failure (%)\nA-1;49,6;3\nA-2;52,1;4\nA-3;47,0;3,5\n"
    strengths = read_export(written(tmp_path, text), size=TALL).strengths
    assert strengths.labels == ("A-1", "A-2", "A-3")
    np.testing.assert_allclose(strengths.stress_kpa, [49.6, 52.1, 47.0])
    assert strengths.height is None or strengths.height == 0.1


# ------------------------------------------------------------------ what is refused


STEPS = steps_text()
UCS = (EXPORTS / "stress_strain.csv").read_text()
REFUSED = {
    "stress without a size": (UCS, (), "stress without a size, in column 'Stress [kPa]'"),
    "what to give": (UCS, (), '--diameter "50 mm", --height "100 mm"'),
    "strain without a height": (UCS, SIZE[:2], "strain without a size"),
    "void ratio without e0": (STEPS, RING, "void ratio without the initial one (e0)"),
    "strengths without a size": ("su;sample\n50;1\n40;2\n45;3\n", (), "stress without a size"),
    "degree without settlement": (
        "sample;t;degree of consolidation\n" + "".join(f"25-50;{i};{i / 5}\n" for i in range(6)),
        RING,
        "--settlement",
    ),
    "settlement without a load": (
        "sample;t;degree of consolidation\n" + "".join(f"A;{i};{i / 5}\n" for i in range(6)),
        RING,
        "load is not stated",
    ),
    "empty points": ("Stress (kPa);void ratio\n", RING, "no table"),
    "empty columns": ("e0: 1.2\nStress (kPa);void ratio\n25;\n;1.1\n50;\n;1.0\n", RING, ";"),
    "two points": (steps_text(rows=((25, 1.2), (50, 1.1))), RING, "no table"),
    "strain above 100 %": (
        UCS,
        (*SIZE, "--strain-unit", "-"),
        "above 100 %",
    ),
    "void ratio above all": (
        steps_text(rows=((25, 120), (50, 110), (100, 100))),
        (*RING, "--void-ratio", "1.2"),
        "a void ratio of 120 cannot be",
    ),
    "negative area": ("Area;-19.6;cm2\nHeight;100;mm\n" + UCS, (), "area is not above zero"),
    "negative diameter": (UCS, ("--diameter", "-50 mm", "--height", "1 m"), "--diameter"),
    "no height": (UCS, ("--diameter", "5 cm", "--height", "0 mm"), "--height"),
    "a size without unit": (UCS, ("--diameter", "50"), "no unit"),
    "area and diameter at odds": (
        "Diameter;50;mm\nHeight;100;mm\nArea;50;cm2\n" + UCS,
        (),
        "contradict each other",
    ),
    "unit of another kind": (UCS.replace("(kPa)", "(mm)"), SIZE, "is not one of stress"),
    "two units": (UCS.replace("\n", "\n%;MPa\n", 1), SIZE, "has two units"),
    "option of another kind": (UCS, (*SIZE, "--stress-unit", "mm"), "--stress-unit"),
    "e0 of another count": (STEPS, (*RING, "--void-ratio", "1.2,1.3"), "for 1 specimens"),
    "e0 below zero": (STEPS, (*RING, "--void-ratio", "-1"), "--void-ratio"),
    "settlement of zero": (STEPS, (*RING, "--settlement", "0 mm"), "--settlement"),
    "strength below zero": ("su;sample\n50;1\n-4;2\n45;3\n", SIZE, "not above zero"),
    "a load that stays": (
        steps_text(rows=((50, 1.2), (50, 1.1), (50, 1.0))),
        (*RING, "--void-ratio", "1.3"),
        "load never changes",
    ),
    "no such test": (
        UCS,
        (*SIZE, "--test", "triaxial"),
        "confined, oedometer, relaxation, unconfined",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_in_one_line(calibrate, tmp_path, case):
    content, options, words = REFUSED[case]
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    status, out, error = calibrate("convert", "bad.csv", *options)
    assert (status, out) == (2, "")
    assert len(error.splitlines()) == 1 and ";" in error
    assert words in error
    assert "bad.csv" in error or "command line" in error


def test_preamble_states_area_and_initial_void_ratio():
    stated = read_preamble([["Probe01", "2,5"], ["Area", "31.2", "cm²"], ["Initial e0 = 0.85"]])
    assert stated.quantities == pytest.approx({"area": 31.2e-4, "void_ratio": 0.85})


@pytest.mark.filterwarnings("error")
def test_no_malformed_file_gives_a_traceback(tmp_path):
    """Each is refused in one line, or read into curves and a lab file that is TOML."""
    rng = np.random.default_rng(26)
    files = [EXPORTS / "stress_strain.csv", EXPORTS / "load_steps.csv", *TRUMAO.glob("*.csv")]
    size = Size(0.05, 0.02, "first", ("1 %",))
    read = refused = 0
    for case in range(300):
        path = tmp_path / "case.csv"
        path.write_bytes(spoiled_bytes(files[case % len(files)].read_bytes(), rng))
        try:
            export = read_export(path, units=Units(), size=size)
        except InputError as error:
            assert len(str(error).splitlines()) == 1 and error.problem and error.repair
            refused += 1
            continue
        read += 1
        for specimen in export.specimens:
            assert len(labtext.curve_text(specimen).splitlines()) == len(specimen.force_n) + 1
        assert tomllib.loads(labtext.lab_text(export))["soil"]
    assert min(read, refused) > 30


def test_a_few_readings_that_begin_at_contact_are_a_curve(calibrate, tmp_path):
    """31 readings with decimal commas, the first at no strain; the peak is theirs."""
    strain = np.linspace(0, 7.5, 31)
    stress = 110 * -np.expm1(-strain) * np.where(strain < 4, 1, np.exp(-(strain - 4) / 3))
    rows = [f"{x:.3f};{y:.3f}".replace(".", ",") for x, y in zip(strain, stress, strict=True)]
    text = "\n".join(["Axial strain (%);Stress (kPa)", *rows])
    (tmp_path / "ucs.csv").write_text(text, encoding="utf-8")
    sizes = ("--diameter", "50 mm", "--height", "100 mm")
    assert calibrate("convert", "ucs.csv", *sizes, "--out", "o")[0] == 0
    (curve,) = load_lab(tmp_path / "o/ucs.toml").curves
    assert curve.test == "unconfined"
    assert curve.force_n.max() == pytest.approx(1e3 * np.pi / 4 * 0.05**2 * stress.max(), rel=1e-3)
    assert curve.displacement_mm[-1] == pytest.approx(7.5)
