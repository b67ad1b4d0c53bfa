"""Exports of testing machines: what they hold is found, however it is laid out.

Curves are synthetic, so the depression depth and the crushing force that must come out are
known in closed form.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.inference.problem import pose
from calibrate.instrument_import import vocabulary
from calibrate.instrument_import.cells import number
from calibrate.instrument_import.convert import read_export
from calibrate.instrument_import.headings import split_heading
from calibrate.instrument_import.preamble import read_preamble
from calibrate.instrument_import.textfile import decode
from calibrate.instrument_import.vocabulary import kind_of
from calibrate.io.lab import load_lab
from tests.support.machine_files import (
    EXPORTS,
    HEADING,
    NAMES,
    columns,
    curves,
    only,
    text_of,
    written,
)


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
        "kN as N": ["size of the numbers"],
        "good": [],
    }
    assert out.count("WARNING") == 3
    lab = load_lab(tmp_path / "o/trouble.toml")
    assert [curve.test for curve in lab.curves] == ["confined", "unconfined"]  # 0.4 N is no curve


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
    found = split_heading(heading)
    name = found.name
    assert (found.unit.name if found.unit else None) == (None if kind == "other" else unit)
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


# ------------------------------------------------------------------ words


def vocabulary_with(folder, old, new):
    """A copy of the shipped file, one line changed."""
    text = vocabulary.FILE.read_text(encoding="utf-8")
    assert text.count(old) == 1
    (folder / "words.toml").write_text(text.replace(old, new), encoding="utf-8")
    return folder / "words.toml"


def test_a_word_added_to_the_file_makes_a_heading_readable(tmp_path, monkeypatch):
    """Dutch, which the shipped file does not know."""
    text = text_of(columns(), ("Tijd (s)", "Verplaatsing", "Load (N)"))
    path = written(tmp_path, text)
    with pytest.raises(InputError, match="no column of displacement"):
        read_export(path)
    more = vocabulary_with(
        tmp_path,
        'spanish = ["desplazamiento",',
        'dutch = ["Verplaatsing"]\nspanish = ["desplazamiento",',
    )
    monkeypatch.setattr(vocabulary, "WORDS", vocabulary.load(more))
    specimen = only(path)
    assert specimen.displacement_mm.max() == pytest.approx(6.2, abs=0.5)
    assert "'Verplaatsing'" in specimen.place


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('spanish = ["tiempo"]', 'spanish = ["ti"]', ("columns.time.spanish", "too short")),
        ('spanish = ["tiempo"]', 'spanish = ["carga"]', ("columns.time", "stands under force")),
        ('spanish = ["tiempo"]', "spanish = [3]", ("columns.time.spanish[0]", "string")),
        ('spanish = ["tiempo"]', 'spanish = ["tiempo"', ("not valid TOML", "line")),
        ("[columns.time]", "[columns.weight]", ("columns.weight", "'force'")),
        ("[tests.confined]", "[tests.triaxial]", ("tests.triaxial", "no such test")),
        ('["psi", "lbf-in2"', '["Pa", "lbf-in2"', ("units.psi", "stands under Pa")),
        ("ksi = [", "ksj = [", ("units.ksj", "pint")),
    ],
)
def test_a_slip_in_the_words_is_one_line_with_its_entry(tmp_path, old, new, words):
    with pytest.raises(InputError) as refused:
        vocabulary.load(vocabulary_with(tmp_path, old, new))
    assert len(str(refused.value).splitlines()) == 1 and "words.toml" in str(refused.value)
    assert all(word in str(refused.value) for word in words)


# ------------------------------------------------------------------ several specimens


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
