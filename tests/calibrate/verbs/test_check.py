"""`calibrate check`: what a lab file holds, before anything is simulated."""

import json
import shutil

import pytest

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.verbs.check import check

GOOD = bundled_lab().read_text()


def test_it_says_what_a_fit_compares(calibrate, tmp_path):
    status, out, error = calibrate("check", "--json", "check.json")
    assert (status, error) == (0, "")
    assert "confined: a specimen 50 mm wide, 100 mm high, 0 curves, 1 target" in out
    assert "crushing force (N)" in out and "2 numbers fix as many parameters at most" in out
    assert "names no effect, since the lab file has no curves" in out
    found = json.loads((tmp_path / "check.json").read_text())
    assert found["numbers"] == {
        "depression_depth_mm": {"measured": 3.36, "repeats": 4},
        "crushing_force_n": {"measured": 206.0, "repeats": 4},
    }
    assert [path.name for path in tmp_path.iterdir()] == ["check.json"]


def test_numbers_of_curves_are_means_over_them():
    found = check(bundled_lab("trumao_curves"))
    rows = found.content["numbers"]
    assert {row["repeats"] for name, row in rows.items() if "displacement" in name} == {3}
    assert rows["displacement at 392.7 N, loading"]["measured"] == pytest.approx(1.688, abs=5e-4)
    assert len(found.warnings) == 1 and "begins at a load of 49.09 N" in found.warnings[0]
    assert found.content["diagnosis"] == "takes it"


def test_what_the_lab_file_frees_and_holds(tmp_path):
    path = tmp_path / "lab.toml"
    marks = "[parameters.shear_modulus]\nvalue = '7 MPa'\nfree = true\n"
    held = "[parameters.restitution]\nvalue = 0.3\nfree = false\n"
    kept = [line for line in GOOD.splitlines() if not line.startswith(("shear_modulus", "restit"))]
    path.write_text("\n".join(kept) + "\n" + marks + held)
    found = check(load_lab(path))
    assert found.content["free"] == ["shear_modulus"] and found.content["held"] == ["restitution"]
    assert found.content["parameters"]["restitution"] == 0.3
    assert "a fit frees shear_modulus" in repr(found)


def test_a_test_that_prepares_is_not_in_vain_and_one_that_ends_unmeasured_is(tmp_path):
    source = bundled_lab("trumao_oedometer")
    assert not [w for w in check(source).warnings if "in vain" in w]
    shutil.copytree(source.parent, tmp_path / "soils")
    path = tmp_path / "soils" / source.name
    path.write_text(path.read_text() + '\n[[tests]]\ntype = "unconfined"\nname = "again"\n')
    assert [w for w in check(path).warnings if "in vain" in w] == [
        "again has neither a target nor a curve: a fit simulates it in vain"
    ]
    assert check(path).content["diagnosis"].startswith("refuses it: a library of runs holds")


@pytest.mark.parametrize("text", ["", "[soil\nname", GOOD.replace('"100 mm"', '"-100 mm"')])
def test_a_wrong_lab_file_is_refused(calibrate, tmp_path, text):
    (tmp_path / "lab.toml").write_text(text)
    status, out, error = calibrate("check", "lab.toml")
    assert (status, out, error.count("\n")) == (2, "", 1) and "lab.toml" in error
