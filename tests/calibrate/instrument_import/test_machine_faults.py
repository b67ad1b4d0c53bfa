"""What is wrong with a testing machine's export is said, and a hopeless one is refused.

Units taken for others, clipped forces, gaps, missing values, records that start under load; then
files that hold no test at all, and workbooks that would unpack to gigabytes.
"""

import zipfile

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.instrument_import import labtext
from calibrate.instrument_import.convert import read_export
from calibrate.instrument_import.recordings import Units
from calibrate.instrument_import.unittext import unit_of
from tests.support.machine_files import EXPORTS, HEADING, columns, only, text_of, written

# ------------------------------------------------------------------ what can be wrong with a curve


def findings(path, kind, **choices):
    return [f for f in only(path, **choices).findings if f.kind == kind]


def test_a_written_unit_is_never_overruled(tmp_path):
    """0.4 N on 50 mm is less than the soil's own weight: said, and kept."""
    curve = columns()
    path = written(tmp_path, text_of(curve, HEADING, scale={"f": 1e-3}))
    assert only(path).force_n.max() == pytest.approx(curve["f"].max() / 1000, rel=1e-3)
    (found,) = findings(path, "size of the numbers")
    assert found.fault and "--force-unit" in found.text and "ASSUMED" in found.text
    right = only(path, units=Units(force=unit_of("kN")))
    assert right.force_n.max() == pytest.approx(curve["f"].max(), rel=1e-3)


def test_what_a_size_would_make_possible_is_said(tmp_path):
    """200 MPa on 50 mm, and a strain of 7e-5."""
    heading = ("Time (s)", "Extension (mm)", "Load (kN)")
    path = written(tmp_path, text_of(columns(), heading, scale={"x": 1e-3}))
    texts = [found.text for found in findings(path, "size of the numbers")]
    assert [text.split()[0] for text in texts] == ["force", "displacement"]
    assert only(path).force_n.max() == pytest.approx(400e3, rel=0.01)
    assert "160 mm" in texts[0]  # sqrt(4 x 400 kN/(20 MPa pi))


@pytest.mark.parametrize(
    ("heading", "scale", "option"),
    [
        ("Extension (mm);Load", {"f": 1e-3}, "--force-unit kN"),
        ("Extension;Load (N)", {"x": 1e-3}, "--displacement-unit m"),
        ("Extension (mm);Load", {"f": 1e3}, "--force-unit"),
    ],
)
def test_a_unit_that_nobody_wrote_and_cannot_be_is_refused(tmp_path, heading, scale, option):
    path = written(tmp_path, text_of(columns(), [heading], scale=scale, order="xf"))
    with pytest.raises(InputError) as refused:
        read_export(path)
    assert "has no unit" in str(refused.value) and option in str(refused.value)


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
    assert found.fault and "begins under" in found.text


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
        "stress without a size",
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
