"""No number of an export is silently wrong: units in every place, other tests, several specimens.

Curves are synthetic with known numbers: read right to 1e-6, or refused by a sentence that names the
column and the option.  `support.lab_curves` writes random files.
"""

import json

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.inference.problem import pose
from calibrate.instrument_import.convert import read_export
from calibrate.instrument_import.headings import split_heading
from calibrate.instrument_import.measured import Units
from calibrate.instrument_import.sizes import Size
from calibrate.instrument_import.unittext import unit_of
from calibrate.io.lab import load_lab
from tests.support import lab_curves
from tests.support.machine_files import columns, text_of, written

TALL = Size(0.05, 0.1)
AREA = lab_curves.AREA
TRAVEL = np.linspace(0, 12, 61)  # mm
PEAK = 186.4  # N, at 4.4 mm
LOAD = PEAK * TRAVEL / 4.4 * np.exp(1 - TRAVEL / 4.4)


def curve_file(folder, headings, *values, delimiter=",", before=(), after=()):
    rows = [delimiter.join(f"{v:.9g}" for v in row) for row in zip(*values, strict=True)]
    return written(folder, "\n".join([*before, delimiter.join(headings), *rows, *after]) + "\n")


def peak_and_reach(path, **choices):
    (specimen,) = read_export(path, **choices).specimens
    return specimen.force_n.max() + specimen.zero_n, np.ptp(specimen.raw.displacement_mm)


def refusal(path, **choices):
    with pytest.raises(InputError) as refused:
        read_export(path, **choices)
    return str(refused.value)


# ------------------------------------------------------------------ units

WRITTEN = [
    (kind, unit, place)
    for kind, units in lab_curves.KNOWN.items()
    for unit in units
    for place in lab_curves.PLACES
]
NAME = {"force": "Axial load", "displacement": "Displacement", "stress": "Axial stress"}
NAME |= {"strain": "Axial strain", "time": "Time"}


def test_every_unit_in_every_place_is_read_or_not_understood():
    """Never another size, and never "no unit" in brackets, after a blank or in snake_case."""
    read, lost = 0, []
    for kind, unit, place in WRITTEN:
        text = lab_curves.PLACES[place](NAME[kind], unit)
        found = split_heading(text)
        if found.unit is not None:
            assert found.unit.kind == kind, text
            assert found.unit.factor == pytest.approx(lab_curves.KNOWN[kind][unit], rel=1e-9), text
            read += 1
        elif not found.not_understood:
            lost.append((place, unit))
    assert read > 0.95 * len(WRITTEN)
    assert {place for place, unit in lost if unit != "-"} <= {"camel", "snake", "under", "stop"}


def test_every_unit_in_a_row_of_its_own():
    for _, units in lab_curves.KNOWN.items():
        for unit, factor in units.items():
            found = unit_of(unit)
            assert found is not None and found.factor == pytest.approx(factor, rel=1e-9), unit


@pytest.mark.parametrize(
    ("headings", "scales", "peak"),
    [
        (("test_time_s", "platen_travel_mm", "axial_load_kN"), (1, 1, 1e-3), PEAK),
        (("test_time_s", "ram_travel_in", "axial_load_lbf"), (1, 1 / 25.4, 1 / 4.44822162), PEAK),
        (("test_time_min", "ram_travel_cm", "ram_load_kgf"), (1 / 60, 0.1, 1 / 9.80665), PEAK),
        (("timeMin", "displacementMm", "axialLoadKN"), (1 / 60, 1, 1e-3), PEAK),
        (("Zeit_min", "Weg_cm", "Kraft_daN"), (1 / 60, 0.1, 0.1), PEAK),
        (("t.min", "disp.mm", "load.kN"), (1 / 60, 1, 1e-3), PEAK),
        (("tiempo_s", "recorrido_pulgadas", "carga_kg"), (1, 1 / 25.4, 1 / 9.80665), PEAK),
    ],
)  # fmt: skip
def test_units_at_the_end_of_names(tmp_path, headings, scales, peak):
    values = (2.0 * np.arange(61), TRAVEL, LOAD)
    scaled = (v * s for v, s in zip(values, scales, strict=True))
    path = curve_file(tmp_path, headings, *scaled)
    assert peak_and_reach(path) == pytest.approx((LOAD.max(), 12.0), rel=1e-6)
    (specimen,) = read_export(path).specimens
    assert specimen.rate == pytest.approx(1e-4, rel=1e-3)  # 0.2 mm in 2 s


IN_BRACKETS = {
    "Load (kg)": 1 / 9.80665, "Carga (kg)": 1 / 9.80665, "Load (lbs.)": 1 / 4.4482216152605,
    "Load (pounds)": 1 / 4.4482216152605, "Load (kip)": 1 / 4448.2216152605,
    "Axial stress (psf)": 1 / 0.04788025898 / AREA / 1e3,
    "Axial stress (tsf)": 1e-3 / 95.76051796 / AREA,
    "Axial stress (ksf)": 1e-3 / 47.88025898 / AREA,
    "Axial stress (ksi)": 1e-3 / 6894.757293168 / AREA,
    "Axial stress (N/cm2)": 1e-4 / AREA, "Axial stress (t/m2)": 1 / 9806.65 / AREA,
    "Stress (kg per sq cm)": 1e-4 / 9.80665 / AREA, "Load (KGF)": 1 / 9.80665, "Load [x10 N]": 0.1,
}  # fmt: skip


@pytest.mark.parametrize("heading", IN_BRACKETS)
def test_units_in_brackets_of_a_load(tmp_path, heading):
    path = curve_file(tmp_path, ("Displacement (mm)", heading), TRAVEL, LOAD * IN_BRACKETS[heading])
    assert peak_and_reach(path, size=TALL) == pytest.approx((LOAD.max(), 12.0), rel=1e-6)
    texts = [f.text for f in read_export(path, size=TALL).specimens[0].findings]
    assert not any("has no unit" in text for text in texts)
    by_weight = any(word in heading for word in ("kg)", "lbs", "pounds", "t/m2", "kg per"))
    assert any("is a weight" in text for text in texts) == by_weight


@pytest.mark.parametrize(
    ("heading", "scale"),
    [("mils", 1 / 0.0254), ("0.01 mm", 100), ("10^-2 mm", 100), ("in", 1 / 25.4)],
)  # fmt: skip
def test_units_in_brackets_of_a_travel(tmp_path, heading, scale):
    path = curve_file(tmp_path, (f"Displacement ({heading})", "Load (N)"), TRAVEL * scale, LOAD)
    assert peak_and_reach(path) == pytest.approx((LOAD.max(), 12.0), rel=1e-6)


@pytest.mark.parametrize(
    ("heading", "written"),
    [
        ("Load (V)", "V"), ("Load (cell)", "cell"), ("Load (ton)", "ton"), ("Load [gr]", "gr"),
        ("Load (10 kN)", "10 kN"), ("Load_mV", "mV"), ("load_tonf", "tonf"), ("Force kN/m", "kN/m"),
        ("stress_mn_m2", "mn m2"), ("Axial load (bits)", "bits"), ("Load 50 kN", "50 kN"),
    ],
)  # fmt: skip
def test_what_is_no_unit_is_refused_by_name(tmp_path, heading, written):
    path = curve_file(tmp_path, ("Displacement (mm)", heading), TRAVEL, LOAD)
    text = refusal(path, size=TALL)
    assert f"'{written}'" in text and "-unit" in text
    insisted = Units(force=unit_of("N"), stress=unit_of("kPa"))
    assert len(read_export(path, size=TALL, units=insisted).specimens) == 1


def test_two_units_that_differ_are_refused(tmp_path):
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (kN)"), TRAVEL, LOAD, after=())
    text = path.read_text().replace("Load (kN)", "Load (kN)\nmm,N", 1)
    assert "two units" in refusal(written(tmp_path, text))


def test_the_unit_of_a_strong_specimen_is_kept_and_the_assumed_diameter_said(calibrate, tmp_path):
    """60 kN of a core of 100 mm whose diameter is not stated; sealed case 07."""
    curve_file(tmp_path, ("Displacement (mm)", "Load (kN)"), TRAVEL / 7.5, LOAD * 60 / LOAD.max())
    status, out, error = calibrate("convert", "export.csv", "--out", "o")
    assert (status, error) == (0, "")
    (row,) = json.loads((tmp_path / "o/convert.json").read_text())["specimens"]
    assert row["largest_force_n"] == pytest.approx(60e3, rel=1e-6)
    assert "ASSUMED" in out and "61.8 mm" in out  # sqrt(4 x 60 kN/(20 MPa pi))


# ------------------------------------------------------------------ which test, which column


@pytest.mark.parametrize(
    ("headings", "extra"),
    [
        (("axial_strain", "deviator_stress_kPa", "confining_pressure_kPa"), 50.0),
        (("Axial strain (%)", "Axial stress (kPa)", "Cell Pressure (kPa)"), 100.0),
        (("Axial strain (%)", "Axial stress (kPa)", "PorePressure [kPa]"), 20.0),
        (("strain %", "stress kPa", "sigma_3 (kPa)"), 200.0),
        (("Dehnung [%]", "Spannung [kPa]", "Zelldruck [kPa]"), 50.0),
        (("Axial strain (%)", "Axial stress (kPa)", "back_pressure_kPa"), 70.0),
        (("Axial strain (%)", "Axial stress (kPa)", "ConfP (psi)"), 70.0),
        (("axial strain", "q (kPa)", "p' (kPa)"), 80.0),
    ],
)
def test_a_specimen_under_pressure_is_refused_and_warned_of(tmp_path, headings, extra):
    values = (TRAVEL / 100, LOAD / AREA / 1e3, np.full(61, extra))
    path = curve_file(tmp_path, headings, *values)
    assert "not simulated" in refusal(path, size=TALL)
    if "q (kPa)" not in headings:
        (specimen,) = read_export(path, "unconfined", size=TALL).specimens
        assert any(f.fault and "not simulated" in f.text for f in specimen.findings)


def test_a_pressure_of_nought_is_no_sign(tmp_path):
    heads = ("Axial strain (%)", "Axial stress (kPa)", "Cell pressure (kPa)")
    path = curve_file(tmp_path, heads, TRAVEL, LOAD / AREA / 1e3, np.zeros(61))
    assert peak_and_reach(path, size=TALL) == pytest.approx((LOAD.max(), 12.0), rel=1e-6)


@pytest.mark.parametrize(
    "line",
    [
        "Test type: Triaxial CU", "Direct shear test", "Ensayo: Corte directo", "CBR soaked",
        "Prüfung: Zugversuch", "Cell pressure (kPa),100", "Norma: EN 14651 Viga", "Brazilian test",
    ],
)  # fmt: skip
def test_other_tests_named_above_the_table(tmp_path, line):
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), TRAVEL, LOAD, before=[line])
    assert "not simulated" in refusal(path)


def test_a_set_value_is_no_load(tmp_path):
    heads = ("Displacement (mm)", "Load Sollwert (N)", "Load (N)", "Load command (N)")
    path = curve_file(tmp_path, heads, TRAVEL, 2 * LOAD, LOAD, 3 * LOAD)
    assert peak_and_reach(path)[0] == pytest.approx(LOAD.max(), rel=1e-6)


def test_columns_called_m_and_h_are_no_units(tmp_path):
    stress, void = (
        (0, 12.5, 25, 50, 100, 200, 400, 0),
        (0.71, 0.705, 0.697, 0.68, 0.66, 0.63, 0.59, 0.64),
    )
    rows = (np.arange(8.0), np.zeros(8), stress, 20 - np.arange(8.0) / 10, void)
    path = curve_file(tmp_path, ("m", "zi", "sigma_v", "h", "e"), *rows)
    (specimen,) = read_export(path, size=Size(0.065, 0.02, "first")).specimens
    assert specimen.force_n.max() == pytest.approx(400e3 * np.pi / 4 * 0.065**2, rel=1e-6)
    assert specimen.displacement_mm[6] == pytest.approx((0.71 - 0.59) / 1.71 * 20, rel=1e-6)


@pytest.mark.parametrize(
    "heads", ["stress,void_ratio", "stress_kPa,VoidRatio", "sigma [kPa],void.ratio"]
)
def test_void_ratios_in_any_spelling(tmp_path, heads):
    stress = np.array([110, 240, 505, 1010, 1990, 3990, 7990, 2000, 500.0])
    void = np.array([0.812, 0.775, 0.741, 0.702, 0.641, 0.56, 0.481, 0.5, 0.52])
    path = curve_file(tmp_path, heads.split(","), stress, void)
    (specimen,) = read_export(path, size=Size(0.05, 0.02, "first")).specimens
    assert specimen.force_n.max() == pytest.approx(7990e3 * AREA, rel=1e-6)
    assert specimen.displacement_mm.max() == pytest.approx((0.812 - 0.481) / 1.812 * 20, rel=1e-6)


def test_strengths_in_snake_case(tmp_path):
    text = "sample,undrained_shear_strength_kPa\nA1,41.2\nA2,38.8\nA3,44.1\nA4,40.0\n"
    found = read_export(written(tmp_path, text), size=TALL).strengths
    assert found is not None
    assert found.force_n.mean() == pytest.approx(2 * 41.025e3 * AREA, rel=1e-6)


@pytest.mark.parametrize(
    "heads",
    [
        "# t u F\n# s mm N", "#t u F\n#s mm N", "% t u F\n% s mm N", "// time_s travel_mm load_N",
        "# rig 4, operator X\n# time(s) displacement(mm) force(N)", "! t[s] u[mm] F[N]",
    ],
)  # fmt: skip
def test_headings_behind_the_sign_of_a_comment(tmp_path, heads):
    rows = [f"{6 * i} {x:.6f} {f:.6f}" for i, (x, f) in enumerate(zip(TRAVEL, LOAD, strict=True))]
    path = written(tmp_path, "\n".join([heads, *rows]) + "\n")
    assert peak_and_reach(path, test="unconfined") == pytest.approx((LOAD.max(), 12.0), rel=1e-6)


def test_a_history_of_a_dem_program_without_units_names_its_columns(tmp_path):
    rows = [
        f"{i} 0 0 {-f:.5f} 0 0 {-x / 1000:.6f}"
        for i, (x, f) in enumerate(zip(TRAVEL, LOAD, strict=True))
    ]
    path = written(tmp_path, "\n".join(["# step Fx Fy Fz Dx Dy Dz", *rows]) + "\n")
    text = refusal(path)
    assert "'Fz'" in text and "'Dz'" in text and "--displacement-unit m" in text
    metres = Units(displacement=unit_of("m"))
    assert peak_and_reach(path, units=metres) == pytest.approx((LOAD.max(), 12.0), rel=1e-4)


# ------------------------------------------------------------------ where records begin and end


@pytest.mark.parametrize(
    "name", ["replicate", "Run", "Test No.", "RepeatID", "specimen_id", "trial", "Core", None]
)
def test_repeats_below_each_other(tmp_path, name):
    scales = (0.9, 1.0, 1.12)
    number = np.repeat([1, 2, 3], 61)
    travel, load = np.tile(TRAVEL, 3), np.concatenate([s * LOAD for s in scales])
    heads = ("Displacement (mm)", "Load (N)")
    path = (
        curve_file(tmp_path, heads, travel, load)
        if name is None
        else curve_file(tmp_path, (name, *heads), number, travel, load)
    )
    found = read_export(path, "unconfined").specimens
    assert [s.force_n.max() for s in found] == pytest.approx([s * LOAD.max() for s in scales])
    assert [len(s.raw.force_n) for s in found] == [61] * 3


@pytest.mark.parametrize("every", [7, 20, 40])
@pytest.mark.parametrize("clock", [True, False])
def test_a_heading_repeated_on_every_page_is_one_record(tmp_path, every, clock):
    head = "Time (s),Displacement (mm),Load (N)" if clock else "Displacement (mm),Load (N)"
    lines = []
    for i, (x, f) in enumerate(zip(TRAVEL, LOAD, strict=True)):
        lines += [head] if i % every == 0 else []
        lines.append(",".join([*([f"{6 * i}"] if clock else []), f"{x:.6f}", f"{f:.6f}"]))
    (specimen,) = read_export(written(tmp_path, "\n".join(lines) + "\n")).specimens
    assert len(specimen.raw.force_n) == 61
    assert specimen.force_n.max() == pytest.approx(LOAD.max(), rel=1e-5)


def test_a_clock_that_starts_again_under_load_begins_no_specimen(tmp_path):
    time = np.concatenate([np.arange(30), np.arange(31)])
    path = curve_file(tmp_path, ("Time (s)", "Displacement (mm)", "Load (N)"), time, TRAVEL, LOAD)
    (specimen,) = read_export(path).specimens
    assert len(specimen.raw.force_n) == 61 and specimen.rate is None
    assert any("clock starts again" in f.text for f in specimen.findings)


def test_pages_that_are_only_numbered_are_one_record(tmp_path):
    page = 1 + np.arange(61) // 20
    path = curve_file(tmp_path, ("Run", "Displacement (mm)", "Load (N)"), page, TRAVEL, LOAD)
    (specimen,) = read_export(path).specimens
    assert len(specimen.raw.force_n) == 61


def test_a_gauge_that_stands_still_begins_no_specimens(tmp_path):
    still = np.tile([0.0, 2e-4, -1e-4, 1e-4, -2e-4], 8)
    travel, load = np.concatenate([still, TRAVEL]), np.concatenate([0 * still, LOAD])
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), travel, load)
    assert len(read_export(path).specimens) == 1


def test_lines_without_numbers_are_counted(tmp_path):
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), TRAVEL, LOAD)
    lines = path.read_text().splitlines()
    for row in (50, 40, 30, 20, 10):
        lines.insert(row, "Err,Err")
    (specimen,) = read_export(written(tmp_path, "\n".join(lines) + "\n")).specimens
    assert len(specimen.raw.force_n) == 61
    assert any(f.fault and "5 lines" in f.text for f in specimen.findings)


def test_a_cyclic_record_says_so_and_keeps_its_first_loading(tmp_path):
    up, load = TRAVEL[:30], LOAD[:30]
    travel = np.concatenate([up, up[::-1], up + 0.01, up[::-1], up + 0.02])
    force = np.concatenate([load, load[::-1], 0.9 * load, load[::-1], 0.8 * load])
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), travel, force)
    (specimen,) = read_export(path, "unconfined").specimens
    assert len(specimen.force_n) == 30
    assert any(f.fault and "cyclic" in f.text for f in specimen.findings)


def test_a_platen_that_turns_before_contact_is_refused_in_one_line(tmp_path):
    """The first loading of a cyclic record ends before there is any force."""
    search = np.concatenate([np.linspace(0, 4, 40), np.linspace(4, 1, 30), np.linspace(1, 6, 50)])
    travel = np.concatenate([search, 6 + TRAVEL])
    path = curve_file(
        tmp_path, ("Displacement (mm)", "Load (N)"), travel, np.concatenate([0 * search, LOAD])
    )
    assert "only 0 points from contact" in refusal(path, test="unconfined")


def test_a_confined_record_of_several_cycles_gets_its_protocol(calibrate, tmp_path):
    up = np.linspace(0, 6, 60)
    load = 400 * (up / 6) ** 2
    back = np.linspace(6, 5.2, 30)[1:]
    low = 400 - (6 - back) / 0.8 * 360
    again = np.linspace(5.2, 6.1, 30)[1:]
    high = 40 + (again - 5.2) / 0.9 * 360
    travel = np.concatenate([up, back, again, 6.1 - (6 - back)])
    force = np.concatenate([load, low, high, low])
    curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), travel, force)
    status, _, error = calibrate("convert", "export.csv", "--test", "confined", "--out", "o")
    assert (status, error) == (0, "")
    lab = load_lab(tmp_path / "o/export.toml")
    steps = [step.step for step in lab.tests[0].protocol]
    assert steps == ["load", "unload", "reload", "unload"]
    assert pose(lab).features  # a fit takes it


@pytest.mark.parametrize("preload", [0.0, 1.0, 3.0, 5.0, 10.0])
def test_a_record_that_begins_under_a_preload_says_so_and_changes_nothing(tmp_path, preload):
    kept = (preload <= LOAD) | (TRAVEL > 4.4)
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), TRAVEL[kept], LOAD[kept])
    (specimen,) = read_export(path).specimens
    assert not specimen.approach and specimen.zero_n == 0
    assert specimen.begins_n == pytest.approx(LOAD[kept][0], abs=1e-6)
    assert specimen.displacement_mm[0] == 0 and len(specimen.force_n) == kept.sum()
    assert any("holds no reading before contact" in f.text for f in specimen.findings)


@pytest.mark.parametrize("held", [2.0, 5.0, 20.0])
def test_a_preload_that_is_held_is_no_zero_of_the_force(tmp_path, held):
    travel = np.concatenate([np.zeros(30), TRAVEL[1:]])
    load = np.concatenate([np.full(30, held), held + LOAD[1:]])
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), travel, load)
    (specimen,) = read_export(path, "unconfined").specimens
    assert specimen.zero_n == 0 and not specimen.approach
    assert specimen.force_n.max() == pytest.approx(held + LOAD.max(), rel=1e-6)


def test_a_coarse_steep_curve_is_not_turned_upside_down(tmp_path):
    path = curve_file(tmp_path, ("Displacement (mm)", "Load (N)"), TRAVEL[::4], LOAD[::4])
    (specimen,) = read_export(path, "unconfined").specimens
    assert specimen.raw.force_n.max() == pytest.approx(LOAD[::4].max(), rel=1e-6)


def test_two_exports_are_joined(calibrate, tmp_path):
    written(tmp_path, text_of(columns(), ("Time (s)", "Extension (mm)", "Load (N)")), name="a.csv")
    curve = columns("unconfined")
    written(tmp_path, text_of(curve, ("Time (s)", "Extension (mm)", "Load (N)")), name="b.csv")
    status, _, error = calibrate("convert", "a.csv", "b.csv", "--out", "o")
    assert (status, error) == (0, "")
    found = json.loads((tmp_path / "o/convert.json").read_text())["specimens"]
    assert [row["test"] for row in found] == ["confined", "unconfined"]
    assert len({row["file"] for row in found}) == 2


# ------------------------------------------------------------------ random files


def read_right_or_refused(folder, seeds):
    """How many of the files were read, and the wrong ones."""
    read, wrong = 0, []
    for seed in seeds:
        made = lab_curves.made_file(np.random.default_rng(seed))
        path = written(folder, made.text)
        try:
            found = read_export(path, made.test, size=TALL).specimens
        except InputError as refused:
            assert "\n" not in str(refused)
            continue
        read += 1
        if len(found) != len(made.force) or not all(
            len(s.raw.force_n) == len(force)
            and np.allclose(s.raw.force_n, force, rtol=1e-6, atol=1e-6 * force.max())
            and np.allclose(s.raw.displacement_mm, travel, rtol=1e-6, atol=1e-6 * travel.max())
            for s, force, travel in zip(found, made.force, made.travel, strict=True)
        ):
            wrong.append((seed, made.choices))
    return read, wrong


def test_a_few_random_files_are_read_right_or_refused(tmp_path):
    read, wrong = read_right_or_refused(tmp_path, range(150))
    assert wrong == [] and read > 140


@pytest.mark.slow
@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(range(10_000, 10_800), id="800"),
        pytest.param(range(10_800, 15_000), id="4200", marks=pytest.mark.rare),
    ],
)
def test_random_files_are_read_right_or_refused(tmp_path, seeds):
    read, wrong = read_right_or_refused(tmp_path, seeds)
    assert wrong == [] and read > 0.95 * len(seeds)
