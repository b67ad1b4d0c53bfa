"""Exports of testing machines: what they hold is found, what is wrong with them is said.

Curves are synthetic, so the depression depth and the crushing force that must come out are
known in closed form.  Malformed files are made by the hundred: each is read cleanly or refused
with one line.
"""

import importlib.util
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from openpyxl import Workbook

from calibrate.errors import InputError
from calibrate.machine import labtext
from calibrate.machine.cells import number
from calibrate.machine.convert import file_stem, read_export
from calibrate.machine.preamble import read_preamble
from calibrate.machine.recordings import Units
from calibrate.machine.textfile import decode
from calibrate.machine.vocabulary import kind_of, split_unit
from calibrate.measurements import load_lab
from calibrate.problem import pose

EXPORTS = Path(__file__).parent / "data" / "machine_exports"
_spec = importlib.util.spec_from_file_location("make_exports", EXPORTS / "make_exports.py")
assert _spec is not None and _spec.loader is not None
curves = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(curves)


def depth(at_400, exponent=2.2):
    """Travel (mm) from 200 to 400 N of the synthetic confined curve 400 (x/at_400)^exponent."""
    return at_400 * (1 - 0.5 ** (1 / exponent))


# ------------------------------------------------------------------ three exports, no option


def test_german_export_with_a_header_block(calibrate, tmp_path):
    status, out, error = calibrate("convert", EXPORTS / "decimal_comma.csv", "--json", "c.json")
    assert (status, error) == (0, "")
    result = json.loads((tmp_path / "c.json").read_text())
    (row,) = result["specimens"]
    assert (row["label"], row["test"]) == ("SL-07", "unconfined")
    assert row["rate_m_s"] == pytest.approx(1e-5, rel=1e-3)
    assert row["zero_force_n"] == pytest.approx(-1.7, abs=0.5)  # one noise width
    assert row["largest_force_n"] == pytest.approx(206, abs=2)  # the peak of 300 noisy points
    assert any("Traversenweg" in text for text in row["assumed"]) and row["warnings"] == []
    lab = load_lab(tmp_path / "results/convert/decimal_comma.toml")
    assert (lab.specimen.diameter, lab.specimen.height) == pytest.approx((0.05, 0.1))
    assert lab.density_kg_m3[0] == pytest.approx(0.3524 / (np.pi / 4 * 0.05**2 * 0.1), rel=1e-4)
    assert "SL-07: unconfined" in out


def test_chinese_export_with_tabs_and_a_row_of_units(calibrate, tmp_path):
    status, _, error = calibrate("convert", EXPORTS / "tab_units.txt", "--out", "o")
    assert (status, error) == (0, "")
    result = json.loads((tmp_path / "o/convert.json").read_text())
    (row,) = result["specimens"]
    assert (row["label"], row["test"]) == ("3-1", "confined")
    assert row["rate_m_s"] == pytest.approx(5e-4, rel=1e-3)
    # Noise of 0.4 N on slopes of 95 N/mm and more, by a running maximum: 0.02 mm.
    assert result["observables"]["depression_depth_mm"] == pytest.approx([depth(6.2)], abs=0.03)
    assert row["unloading_mm"] == pytest.approx(6.2, abs=0.4)  # contact is found in its noise


def test_workbook_with_two_specimens(calibrate, tmp_path):
    status, _, error = calibrate("convert", EXPORTS / "two_specimens.xlsx", "--out", "o")
    assert (status, error) == (0, "")
    result = json.loads((tmp_path / "o/convert.json").read_text())
    assert [row["label"] for row in result["specimens"]] == ["A-1", "A-2"]
    depths = result["observables"]["depression_depth_mm"]
    assert depths == pytest.approx([depth(5.9), depth(6.6)], abs=0.03)
    assert (tmp_path / "o/preview.png").stat().st_size > 20_000


def test_export_with_troubles_is_read_and_says_them(calibrate, tmp_path):
    status, out, error = calibrate("convert", EXPORTS / "trouble.csv", "--out", "o")
    assert (status, error) == (0, "")
    rows = json.loads((tmp_path / "o/convert.json").read_text())["specimens"]
    said = {row["label"]: [text.split(":")[0] for text in row["warnings"]] for row in rows}
    assert said == {
        "clipped": ["saturation"],
        "with gap": ["sampling gap"],
        "kN as N": ["unit slip"],
        "good": [],
    }
    assert out.count("WARNING") == 3
    lab = load_lab(tmp_path / "o/trouble.toml")
    assert [curve.test for curve in lab.curves] == ["confined", "confined", "unconfined"]


@pytest.mark.parametrize(
    ("file", "features"),
    [("decimal_comma.csv", 7), ("tab_units.txt", 7), ("two_specimens.xlsx", 7)],
)
def test_a_fit_reads_what_was_converted(calibrate, tmp_path, file, features):
    """Seven forces on crushing up to 10 % strain; five displacements up and two down."""
    calibrate("convert", EXPORTS / file, "--out", "o")
    (lab,) = (tmp_path / "o").glob("*.toml")
    problem = pose(load_lab(lab))
    assert len(problem.features) == features
    assert np.isfinite(problem.measured).all()


def test_displacements_of_the_fit_are_those_of_the_curve(calibrate, tmp_path):
    """Counted from 2 N, as `problem` does; contact was found in noise, and it cancels."""
    calibrate("convert", EXPORTS / "tab_units.txt", "--out", "o")
    problem = pose(load_lab(tmp_path / "o/tab_units.toml"))
    forces = np.array([50, 100, 200, 300, 400])
    expected = 6.2 * ((forces / 400) ** (1 / 2.2) - (2 / 400) ** (1 / 2.2))
    np.testing.assert_allclose(problem.measured[:5], expected, atol=0.2)


def test_the_generator_makes_the_committed_text(tmp_path, monkeypatch):
    monkeypatch.setattr(curves, "HERE", tmp_path)
    for name in ("decimal_comma.csv", "tab_units.txt", "trouble.csv"):
        getattr(curves, Path(name).stem)()
        assert (tmp_path / name).read_bytes() == (EXPORTS / name).read_bytes()


# ------------------------------------------------------------------ layouts


def columns(kind="confined", points=90, **choices):
    """A small synthetic curve as a dict of columns."""
    make = curves.confined if kind == "confined" else curves.crushing
    return dict(zip("txf", make(7, points=points, **choices), strict=True))


def text_of(curve, heading, delimiter=";", decimal=".", order="txf", before=(), scale=None):
    scale = scale or {}
    rows = [
        delimiter.join(f"{curve[c][i] * scale.get(c, 1):.6f}".replace(".", decimal) for c in order)
        for i in range(len(curve["f"]))
    ]
    return "\n".join([*before, delimiter.join(heading), *rows]) + "\n"


def written(folder, text, encoding="utf-8", name="export.csv"):
    (folder / name).write_bytes(text.encode(encoding))
    return folder / name


def only(path, **choices):
    (specimen,) = read_export(path, **choices).specimens
    return specimen


NAMES = {
    "English": ("Time (s)", "Extension (mm)", "Load (N)"),
    "German": ("Zeit [s]", "Weg in mm", "Prüfkraft [N]"),
    "Spanish": ("Tiempo (s)", "Desplazamiento (mm)", "Fuerza (N)"),
    "Chinese": ("时间(s)", "位移(mm)", "负荷(N)"),
    "French": ("Temps (s)", "Déplacement (mm)", "Force (N)"),
    "Italian": ("Tempo/s", "Spostamento/mm", "Forza/N"),
    "Portuguese": ("Tempo_s", "Deslocamento_mm", "Força_N"),
    "letters": ("t", "s [mm]", "F [N]"),
}


@pytest.mark.parametrize("language", NAMES)
def test_languages(tmp_path, language):
    curve = columns()
    specimen = only(written(tmp_path, text_of(curve, NAMES[language])))
    assert specimen.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)
    assert specimen.rate == pytest.approx(5e-4, rel=1e-3)


LAYOUTS = [
    *((";", sign, code) for sign in ",." for code in ("utf-8", "utf-16", "cp1252", "utf-8-sig")),
    *(("\t", sign, code) for sign in ",." for code in ("utf-16-le", "utf-8")),
    (",", ".", "utf-8"),
    ("|", ",", "utf-8"),
    ("   ", ".", "utf-8"),
    (" ", ".", "utf-8"),
]


@pytest.mark.parametrize(("delimiter", "decimal", "encoding"), LAYOUTS)
def test_delimiters_decimal_signs_and_encodings(tmp_path, delimiter, decimal, encoding):
    curve = columns()
    heading = ("Weg [mm]", "Prüfkraft [N]", "Zeit [s]")
    text = text_of(curve, heading, delimiter, decimal, order="xft", before=["Prüfer: Müller"])
    specimen = only(written(tmp_path, text, encoding))
    assert specimen.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)
    assert specimen.displacement_mm.max() == pytest.approx(6.2, abs=0.5)


def test_chinese_in_its_national_encoding(tmp_path):
    assert decode("时间,负荷,位移".encode("gb18030"))[1] == "gb18030"
    text = text_of(columns(), NAMES["Chinese"], ",")
    assert only(written(tmp_path, text, "gb18030")).test == "confined"


def test_quoted_cells_with_decimal_commas(tmp_path):
    curve = columns()
    rows = [
        ",".join(f'"{v:.4f}"'.replace(".", ",") for v in row)
        for row in zip(*curve.values(), strict=True)
    ]
    text = "\n".join(['"Time (s)","Extension (mm)","Force (N)"', *rows])
    assert only(written(tmp_path, text)).force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)


def test_units_are_converted(tmp_path):
    curve = columns()
    heading = ("Time (min)", "Extension (in)", "Load (kN)")
    scale = {"t": 1 / 60, "x": 1 / 25.4, "f": 1e-3}
    specimen = only(written(tmp_path, text_of(curve, heading, scale=scale)))
    assert specimen.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)
    assert specimen.rate == pytest.approx(5e-4, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "sign", "value"),
    [
        ("1.234,5", ",", 1234.5),
        ("1,234.5", ".", 1234.5),
        ("1 234,5", ",", 1234.5),
        ("-0,25", ",", -0.25),
        (".5", ".", 0.5),
        ("1e-3", ".", 1e-3),
        ("00:01:02.5", ".", 62.5),
        ("2024-03-12 10:00:01", ".", 36001.0),
        ("−3.5", ".", -3.5),
    ],
)
def test_numbers_as_machines_write_them(text, sign, value):
    assert number(text, sign) == pytest.approx(value)


@pytest.mark.parametrize(
    "text", ["", "-", ".", "1.2.3", "nan", "inf", "1e999", "0x10", "1_000", "5 N"]
)
def test_what_is_no_number(text):
    assert np.isnan(number(text, "."))


@pytest.mark.parametrize(
    ("heading", "kind", "unit"),
    [
        ("Compressive stress (MPa)", "stress", "MPa"),
        ("Standardkraft [N]", "force", "N"),
        ("Load_kN", "force", "kN"),
        ("Extension rate (mm/min)", "other", None),
        ("Stauchung [%]", "displacement", "%"),
        ("试验力 kN", "force", "kN"),
        ("Fuerza máxima (N)", "force", "N"),
    ],
)
def test_headings(heading, kind, unit):
    name, found = split_unit(heading)
    assert (found[1] if found else None) == unit
    if "máxima" not in heading:
        assert kind_of(name)[0] == kind
    else:
        assert kind_of(name)[0] == "other"


def test_preamble_states_sizes_speed_and_name():
    rows = [
        ["Specimen ID", "B 7"],
        ["Durchmesser d0", "50,0", "mm"],
        ["Height: 10 cm"],
        ["Masse", "352.4", "g"],
        ["Speed", "0.6", "mm/min"],
        ["Sampling rate", "50", "Hz"],
        ["Test", "Unconfined compression"],
    ]
    stated = read_preamble(rows)
    assert (stated.label, stated.test) == ("B 7", "unconfined")
    assert stated.quantities == pytest.approx(
        {"diameter": 0.05, "height": 0.1, "mass": 0.3524, "speed": 1e-5}
    )


# ------------------------------------------------------------------ several specimens

HEADING = ("Time (s)", "Extension (mm)", "Load (N)")


def test_blocks_below_each_other(tmp_path):
    first, second = columns(at_400=6.0), columns(at_400=7.0)
    text = text_of(first, HEADING, before=["Specimen: one"]) + "\n"
    text += text_of(second, HEADING, before=["Specimen: two"])
    one, two = read_export(written(tmp_path, text)).specimens
    assert (one.label, two.label) == ("one", "two")
    assert two.displacement_mm.max() - one.displacement_mm.max() == pytest.approx(1.0, abs=0.1)


def test_columns_side_by_side_of_unequal_length(tmp_path):
    first, second = columns(points=90), columns(points=60, at_400=7.0)
    lines = ["Specimen 1;;;Specimen 2;;", ";".join(HEADING * 2)]
    for i in range(len(first["f"])):
        left = ";".join(f"{first[c][i]:.5f}" for c in "txf")
        right = ";".join(f"{second[c][i]:.5f}" for c in "txf") if i < len(second["f"]) else ";;"
        lines.append(f"{left};{right}")
    one, two = read_export(written(tmp_path, "\n".join(lines))).specimens
    assert (one.label, two.label) == ("Specimen 1", "Specimen 2")
    assert len(two.force_n) < len(one.force_n)
    assert (one.findings, two.findings) != ((), ())
    assert not any(f.kind == "missing values" for f in two.findings)


def test_several_forces_over_one_displacement(tmp_path):
    curve = columns("unconfined")
    lines = ["Extension (mm);Force 1 (N);Force 2 (N);Force 3 (N)"]
    lines += [
        ";".join(f"{value:.5f}" for value in (x, f, 1.1 * f + 0.2 * np.sin(x), 0.9 * f + 0.1 * x))
        for x, f in zip(curve["x"], curve["f"], strict=True)
    ]
    export = read_export(written(tmp_path, "\n".join(lines)))
    assert [s.label for s in export.specimens] == ["specimen 1", "specimen 2", "specimen 3"]
    assert all(s.rate is None for s in export.specimens)


def test_the_same_force_in_two_units_is_one_specimen(tmp_path):
    curve = columns()
    lines = ["Extension (mm);Load (N);Load (kN)"]
    lines += [
        f"{x:.5f};{f:.6f};{f / 1000:.9f}" for x, f in zip(curve["x"], curve["f"], strict=True)
    ]
    specimen = only(written(tmp_path, "\n".join(lines)))
    assert specimen.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)


def test_a_clock_that_starts_again_begins_a_specimen(tmp_path):
    curve = columns()
    twice = {name: np.concatenate([values, values]) for name, values in curve.items()}
    export = read_export(written(tmp_path, text_of(twice, HEADING)))
    assert len(export.specimens) == 2


def test_one_broken_specimen_does_not_hide_the_others(tmp_path):
    good, idle = columns(), columns()
    idle["f"] = np.zeros_like(idle["f"])
    text = text_of(good, HEADING, before=["Specimen: good"]) + "\n"
    export = read_export(
        written(tmp_path, text + text_of(idle, HEADING, before=["Specimen: idle"]))
    )
    assert [s.label for s in export.specimens] == ["good"]
    (sentence,) = export.skipped
    assert "'idle'" in sentence and "never changes" in sentence


def test_an_event_line_does_not_end_a_table(tmp_path):
    lines = text_of(columns(), HEADING).splitlines()
    whole = only(written(tmp_path, "\n".join(lines)))
    lines.insert(40, "Event: ramp 2")
    again = only(written(tmp_path, "\n".join(lines)))
    np.testing.assert_array_equal(again.force_n, whole.force_n)


# ------------------------------------------------------------------ what can be wrong with a curve


def findings(path, kind, **choices):
    return [f for f in only(path, **choices).findings if f.kind == kind]


def test_kilonewtons_taken_for_newtons(tmp_path):
    """As written, 400 N would be 0.4 N on 50 mm: less than the soil's own weight."""
    curve = columns()
    path = written(tmp_path, text_of(curve, HEADING, scale={"f": 1e-3}))
    specimen = only(path)
    assert specimen.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)
    (found,) = findings(path, "unit slip")
    assert found.fault and "--force-unit" in found.text
    kept = only(path, units=Units(force="N"))
    assert kept.force_n.max() == pytest.approx(curve["f"].max() / 1000, rel=1e-2)


def test_newtons_taken_for_kilonewtons_and_metres_for_millimetres(tmp_path):
    heading = ("Time (s)", "Extension (mm)", "Load (kN)")
    path = written(tmp_path, text_of(columns(), heading, scale={"x": 1e-3}))
    texts = [found.text for found in findings(path, "unit slip")]
    assert [text.split()[0] for text in texts] == ["force", "displacement"]  # 200 MPa, 7e-5
    specimen = only(path)
    assert specimen.force_n.max() == pytest.approx(400, rel=0.01)
    assert specimen.displacement_mm.max() == pytest.approx(6.2, abs=0.5)


def test_force_clipped_at_the_limit_of_the_load_cell(tmp_path):
    curve = columns("unconfined", points=300)
    curve["f"] = np.minimum(curve["f"], 150.0)
    path = written(tmp_path, text_of(curve, HEADING))
    (found,) = findings(path, "saturation", test="unconfined")
    assert found.fault and "150" in found.text
    specimen = only(path, test="unconfined")
    assert specimen.clipped and specimen.force_n[-1] == pytest.approx(150, abs=1)
    assert labtext.observables(read_export(path, "unconfined"))["crushing_force_n"] == []


def test_a_clipped_curve_is_kept_out_of_the_lab_file_where_others_are_whole(tmp_path):
    whole, clipped = columns("unconfined", points=300), columns("unconfined", points=300)
    clipped["f"] = np.minimum(clipped["f"], 150.0)
    text = text_of(whole, HEADING) + "\nSpecimen: two\n" + text_of(clipped, HEADING)
    export = read_export(written(tmp_path, text))
    assert [s.clipped for s in export.specimens] == [False, True]
    assert labtext.fitted(export) == [export.specimens[0]]
    assert "is not listed: it ends at the load cell's limit" in labtext.lab_text(export)


@pytest.mark.parametrize("resolution", [0.001, 0.5, 1.0])
def test_a_natural_summit_is_no_limit(tmp_path, resolution):
    curve = columns("unconfined", points=300, noise=0.0)
    curve["f"] = resolution * np.round(curve["f"] / resolution)
    path = written(tmp_path, text_of(curve, HEADING))
    assert findings(path, "saturation") == [] and not only(path).clipped


def test_a_servo_that_holds_its_force_is_no_limit(tmp_path):
    curve = columns()
    top = int(np.argmax(curve["f"]))
    held = np.full(40, curve["f"][top])
    curve = {
        "t": np.concatenate([curve["t"][: top + 1], curve["t"][top] + 0.1 * np.arange(1, 41)]),
        "x": np.concatenate([curve["x"][: top + 1], np.full(40, curve["x"][top])]),
        "f": np.concatenate([curve["f"][: top + 1], held]),
    }
    path = written(tmp_path, text_of(curve, HEADING))
    assert findings(path, "saturation", test="confined") == []


def test_gaps_in_the_sampling(tmp_path):
    curve = {name: np.delete(values, slice(50, 62)) for name, values in columns().items()}
    (found,) = findings(written(tmp_path, text_of(curve, HEADING)), "sampling gap")
    assert found.fault and "1 gap(s)" in found.text
    assert findings(written(tmp_path, text_of(columns(), HEADING)), "sampling gap") == []


def test_rows_out_of_order_in_time(tmp_path):
    curve = columns()
    straight = only(written(tmp_path, text_of(curve, HEADING)))
    for values in curve.values():
        values[[30, 31, 32]] = values[[32, 30, 31]]
    path = written(tmp_path, text_of(curve, HEADING))
    (found,) = findings(path, "time order")
    assert found.fault and "2 rows" in found.text
    np.testing.assert_array_equal(only(path).force_n, straight.force_n)


def test_a_record_that_starts_under_load(tmp_path):
    curve = {name: values[30:] for name, values in columns().items()}
    (found,) = findings(written(tmp_path, text_of(curve, HEADING)), "start of contact")
    assert found.fault and "under a load" in found.text


def test_missing_values_are_counted(tmp_path):
    lines = text_of(columns(), HEADING).splitlines()
    lines[20] = ";".join([*lines[20].split(";")[:2], ""])
    (found,) = findings(written(tmp_path, "\n".join(lines)), "missing values")
    assert found.fault and found.text.startswith("1 rows")


def test_tension_positive_machines_and_falling_crossheads(tmp_path):
    curve = columns()
    straight = only(written(tmp_path, text_of(curve, HEADING)))
    path = written(tmp_path, text_of(curve, HEADING, scale={"f": -1, "x": -1}))
    turned = only(path)
    np.testing.assert_allclose(turned.force_n, straight.force_n, atol=1e-9)
    np.testing.assert_allclose(turned.displacement_mm, straight.displacement_mm, atol=1e-9)
    assert sum("sign was turned" in f.text for f in turned.findings) == 2


def test_unloading_ends_an_unconfined_curve(tmp_path):
    curve = columns("unconfined")
    back = np.linspace(curve["x"][-1], 0, 20)[1:]
    curve = {
        "t": np.concatenate([curve["t"], curve["t"][-1] + np.arange(1, 20)]),
        "x": np.concatenate([curve["x"], back]),
        "f": np.concatenate([curve["f"], np.zeros(19)]),
    }
    specimen = only(written(tmp_path, text_of(curve, HEADING)))
    assert specimen.test == "unconfined" and specimen.unloading_mm is None
    assert np.all(np.diff(specimen.displacement_mm) > 0)


@pytest.mark.parametrize("kind", ["confined", "unconfined"])
def test_the_test_is_told_by_the_curve_and_overruled_by_the_user(tmp_path, kind):
    path = written(tmp_path, text_of(columns(kind), HEADING))
    assert only(path).test == kind
    other = "confined" if kind == "unconfined" else "unconfined"
    assert only(path, test=other).test == other


def test_a_low_confined_test_lowers_the_forces_of_the_depth(tmp_path):
    curve = columns()
    export = read_export(written(tmp_path, text_of(curve, HEADING, scale={"f": 0.6})))
    forces = labtext.loading_forces(export)
    assert (forces.low, forces.high) == (120.0, 240.0) and "240" in forces.note


# ------------------------------------------------------------------ refusals

ROWS = text_of(columns(), HEADING)
NO_NAMES = "\n".join(ROWS.splitlines()[1:])
LINE = "\n".join(f"{i};{i};{10 * i}" for i in range(30))
REFUSED = {
    "results only": ((EXPORTS / "hopeless_report.txt").read_bytes(), "only text or results"),
    "empty": (b"", "empty"),
    "blank": (b"  \n\n", "empty"),
    "prose": (b"The specimen failed at 206 N.\nSee the photographs.\n", "only text or results"),
    "PDF": (b"%PDF-1.7\n" + bytes(range(256)), "PDF"),
    "old Excel": (b"\xd0\xcf\x11\xe0" + bytes(500), ".xlsx"),
    "noise": (np.random.default_rng(0).bytes(5000), "neither text nor"),
    "half a zip": (b"PK\x03\x04" + bytes(300), "damaged"),
    "no names": (NO_NAMES.encode(), "have no names"),
    "stress and strain": (
        ROWS.replace("Load (N)", "Stress (MPa)").replace("Extension (mm)", "Strain (%)").encode(),
        "no column of force or displacement",
    ),
    "force in millimetres": (ROWS.replace("Load (N)", "Load (mm)").encode(), "unit of column"),
    "comma twice": (
        text_of(columns(), HEADING, ",", ",").encode(),
        "comma separates columns and decimals alike",
    ),
    "neither test": (f"Time (s);Travel (mm);Force (N)\n{LINE}\n".encode(), "--test confined"),
    "force at rest": (
        ("Travel (mm);Force (N)\n" + "\n".join(f"{i};5" for i in range(30))).encode(),
        "force never changes",
    ),
    "backwards": (
        ("Travel (mm);Force (N)\n" + "\n".join(f"{i};{300 - i}" for i in range(30))).encode(),
        "",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_hopeless_file_is_refused_with_a_useful_sentence(calibrate, tmp_path, case):
    content, words = REFUSED[case]
    (tmp_path / "bad.csv").write_bytes(content)
    status, out, error = calibrate("convert", "bad.csv")
    assert status == 2 and out == ""
    assert error.startswith("error: bad.csv: ") and len(error.splitlines()) == 1
    assert words in error and ";" in error  # what is wrong; what to do
    assert not (tmp_path / "results").exists()


def test_paths_that_are_no_files(calibrate, tmp_path):
    assert calibrate("convert", tmp_path / "none.csv")[0] == 2
    assert calibrate("convert", tmp_path)[0] == 2
    assert calibrate("convert", EXPORTS / "tab_units.txt", "--test", "sideways")[0] == 2
    assert calibrate("convert", EXPORTS / "tab_units.txt", "--force-unit", "mm")[0] == 2


def test_a_workbook_that_would_unpack_to_gigabytes(tmp_path):
    path = tmp_path / "bomb.xlsx"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", "<workbook/>")
        archive.writestr("xl/worksheets/sheet1.xml", bytes(301_000_000))
    assert path.stat().st_size < 400_000
    with pytest.raises(InputError, match="300 MB"):
        read_export(path)


def test_a_workbook_of_nested_entities(tmp_path):
    """Ten entities of ten entities each, six deep, would be a million words."""
    levels = "".join(f'<!ENTITY e{n + 1} "{f"&e{n};" * 10}">' for n in range(6))
    book = f'<!DOCTYPE x [<!ENTITY e0 "spam">{levels}]><workbook>&e6;</workbook>'
    path = tmp_path / "laughs.xlsx"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("[Content_Types].xml", book)
        archive.writestr("xl/workbook.xml", book)
    with pytest.raises(InputError, match="damaged"):
        read_export(path)


# ------------------------------------------------------------------ abuse


NASTY = [
    "../../evil",
    "/etc/passwd",
    "..\\..\\evil",
    "C:\\x",
    "a\nb",
    "con",
    "\x00",
    "[x]\ny=1",
    '"',
]


@pytest.mark.parametrize("name", NASTY)
def test_names_in_files_stay_inside_the_output_folder(calibrate, tmp_path, name):
    (tmp_path / "in").mkdir()
    written(tmp_path / "in", text_of(columns(), HEADING, before=[f"Specimen: {name}"]))
    status, _, _ = calibrate("convert", "in/export.csv", "--out", "deep/out")
    assert status == 0
    outside = [p for p in tmp_path.rglob("*") if p.is_file() and "deep/out" not in str(p)]
    assert outside == [tmp_path / "in" / "export.csv"]
    assert load_lab(tmp_path / "deep/out/export.toml").curves


def test_sheet_names_cannot_escape_either(tmp_path):
    book = Workbook()
    page = book.active
    page.title = "..;rm -rf"
    page.append(list(HEADING))
    for row in zip(*columns().values(), strict=True):
        page.append([float(v) for v in row])
    book.save(tmp_path / "b.xlsx")
    export = read_export(tmp_path / "b.xlsx")
    assert all("/" not in name and ".." not in name for name in labtext.curve_files(export))


def test_file_stems_hold_only_harmless_characters():
    assert file_stem("../Ünï côde/…") == "uni_code"
    assert file_stem("试样") == "specimen"


def test_an_output_folder_that_cannot_be_written(calibrate, tmp_path):
    (tmp_path / "blocked").write_text("a file")
    status, _, error = calibrate("convert", EXPORTS / "tab_units.txt", "--out", "blocked/out")
    assert status == 2 and "--out" in error


# ------------------------------------------------------------------ malformed by the hundred

CASES = 600


def small_exports(folder):
    """Good exports of some 90 rows, as bytes."""
    book = Workbook()
    page = book.active
    page.append(list(HEADING))
    for row in zip(*columns(points=60).values(), strict=True):
        page.append([float(v) for v in row])
    book.save(folder / "good.xlsx")
    german = text_of(columns("unconfined"), NAMES["German"], ";", ",", before=["Probe: 1"])
    chinese = text_of(columns(), NAMES["Chinese"], "\t", before=["试样直径\t50\tmm"])
    blanks = text_of(columns(), HEADING, "  ")
    two = text_of(columns(), HEADING) + "\nSpecimen: two\n" + text_of(columns(), HEADING)
    texts = (german.encode("cp1252"), chinese.encode("utf-16"), blanks.encode(), two.encode())
    return [*texts, (folder / "good.xlsx").read_bytes()]


WORDS = [
    b"nan",
    b"1e999",
    b'"',
    b";;;;",
    b"\x00",
    b"\xff\xfe",
    b"#DIV/0!",
    b"=1+1",
    b"-",
    b"9" * 400,
]


def malformed(good, rng):
    """A good export after one to four accidents to its bytes or lines."""
    data = bytearray(good)
    for _ in range(rng.integers(1, 5)):
        place = int(rng.integers(0, max(len(data), 1)))
        length = int(rng.integers(1, 60))
        accident = rng.integers(0, 8)
        if accident == 0:
            del data[place:]  # the transfer broke off
        elif accident == 1:
            del data[place : place + length]
        elif accident == 2:
            data[place : place + length] = rng.bytes(length)
        elif accident == 3:
            data[place:place] = WORDS[rng.integers(len(WORDS))]
        elif accident == 4:
            old, new = rng.choice(np.frombuffer(b";,.\t \n0", np.uint8), 2)
            data = bytearray(bytes(data).replace(bytes([old]), bytes([new])))
        elif accident == 5:
            lines = bytes(data).split(b"\n")
            rng.shuffle(lines)
            data = bytearray(b"\n".join(lines))
        elif accident == 6:
            lines = bytes(data).split(b"\n")
            cut = int(rng.integers(0, len(lines)))
            data = bytearray(b"\n".join(lines[:cut] + lines[cut + length :]))
        else:
            data = data * int(rng.integers(2, 4))
    return bytes(data)


def malformed_sheet(good, rng):
    """A workbook whose archive is sound and whose first worksheet had the accidents."""
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    name = "xl/worksheets/sheet1.xml"
    start = parts[name].index(b"<sheetData>")
    if rng.random() < 0.7:  # keep the XML sound, spoil values and types of cells
        body = parts[name][start:]
        for old in (b't="n"', b"<v>1", b"<v>0.", b'r="B'):
            new = [b't="s"', b't="b"', b't="e"', b"<v>x", b"<v>", b'r="ZZ', b"<v>-9e9"]
            if rng.random() < 0.4:
                body = body.replace(old, new[rng.integers(len(new))], int(rng.integers(1, 60)))
        parts[name] = parts[name][:start] + body
    else:
        parts[name] = malformed(parts[name], rng)
    again = io.BytesIO()
    with zipfile.ZipFile(again, "w") as archive:
        for part, content in parts.items():
            archive.writestr(part, content)
    return again.getvalue()


@pytest.mark.filterwarnings("error")
def test_no_malformed_file_gives_a_traceback(tmp_path):
    """Each is refused in one line, or read into curves and a lab file that `fit` accepts."""
    rng = np.random.default_rng(20240312)
    goods = small_exports(tmp_path)
    read = refused = 0
    for case in range(CASES):
        path, good = tmp_path / "case", goods[case % len(goods)]
        spoil = malformed_sheet if good.startswith(b"PK") and rng.random() < 0.7 else malformed
        path.write_bytes(spoil(good, rng))
        try:
            export = read_export(path)
        except InputError as error:
            assert len(str(error).splitlines()) == 1 and error.problem and error.repair
            refused += 1
            continue
        read += 1
        if not labtext.fitted(export):
            continue
        for name, specimen in labtext.curve_files(export).items():
            (tmp_path / name).write_text(labtext.curve_text(specimen))
        (tmp_path / "lab.toml").write_text(labtext.lab_text(export), encoding="utf-8")
        assert load_lab(tmp_path / "lab.toml").curves
    assert read + refused == CASES
    assert min(read, refused) > CASES / 10  # the accidents are neither harmless nor all fatal


def test_malformed_files_on_the_command_line(calibrate, tmp_path):
    """The same through the program itself, with its figure: exit status 0 or 2, one line."""
    rng = np.random.default_rng(5)
    goods = small_exports(tmp_path)
    for case in range(15):
        (tmp_path / "case.csv").write_bytes(malformed(goods[case % len(goods)], rng))
        status, _, error = calibrate("convert", "case.csv", "--out", "o")
        assert status in (0, 2)
        assert "Traceback" not in error and len(error.splitlines()) <= 1
