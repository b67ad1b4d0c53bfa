"""Exports that mean harm, and exports spoilt by the hundred.

Names in files cannot choose where something is written; a malformed file is read cleanly or
refused with one line.
"""

import io
import re
import zipfile

import numpy as np
import pytest
from openpyxl import Workbook

from calibrate.core.errors import InputError
from calibrate.instrument_import import labtext
from calibrate.instrument_import.convert import file_stem, read_export
from calibrate.io.lab import load_lab
from tests.support.machine_files import EXPORTS, HEADING, NAMES, columns, text_of, written

pytestmark = pytest.mark.thorough

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
    workbook = timeless((folder / "good.xlsx").read_bytes())
    german = text_of(columns("unconfined"), NAMES["German"], ";", ",", before=["Probe: 1"])
    chinese = text_of(columns(), NAMES["Chinese"], "\t", before=["试样直径\t50\tmm"])
    blanks = text_of(columns(), HEADING, "  ")
    two = text_of(columns(), HEADING) + "\nSpecimen: two\n" + text_of(columns(), HEADING)
    texts = (german.encode("cp1252"), chinese.encode("utf-16"), blanks.encode(), two.encode())
    return [*texts, workbook]


def timeless(workbook):
    """A workbook without the times at which it was made, so that every run harms the same bytes."""
    again = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(workbook)) as made, zipfile.ZipFile(again, "w") as archive:
        for name in made.namelist():
            content = re.sub(rb"20\d\d-\d\d-\d\dT[\d:]+Z", b"2026-01-01T00:00:00Z", made.read(name))
            archive.writestr(zipfile.ZipInfo(name), content)
    return again.getvalue()


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
            archive.writestr(zipfile.ZipInfo(part), content)
    return again.getvalue()


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_no_malformed_file_gives_a_traceback(tmp_path):
    """Each is refused in one line, or read into curves and a lab file. `fit` accepts it, or refuses
    for numbers of which the import warned."""
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
        try:
            assert load_lab(tmp_path / "lab.toml").curves
        except InputError as error:
            assert "accept" in error.repair
            findings = [f for specimen in export.specimens for f in specimen.findings]
            assert any(f.kind == "size of the numbers" for f in findings)
    assert read + refused == CASES
    assert min(read, refused) > CASES / 10  # the accidents are neither harmless nor all fatal


@pytest.mark.slow
def test_malformed_files_on_the_command_line(calibrate, tmp_path):
    """The same through the program itself, with its figure: exit status 0 or 2, one line."""
    rng = np.random.default_rng(5)
    goods = small_exports(tmp_path)
    for case in range(15):
        (tmp_path / "case.csv").write_bytes(malformed(goods[case % len(goods)], rng))
        status, _, error = calibrate("convert", "case.csv", "--out", "o")
        assert status in (0, 2)
        assert "Traceback" not in error and len(error.splitlines()) <= 1
