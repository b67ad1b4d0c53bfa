"""Single values as the user writes them: quantities with units, and parameters in their range.
The catalogue of parameters: complete, consistent, and what calibration takes from it.

Whatever the text, a quantity is a finite number or a `BadValue` with a repair.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibrate.core.errors import BadValue, InputError, suggestion
from calibrate.core.units import FORCE, LENGTH, quantity, unit_factor
from calibrate.io.lab import load_lab
from calibrate.io.labfile import PARAMETER_RANGES, PARAMETER_UNITS, check_parameter
from jdem.core.parameter import FRACTION, NOT_NEGATIVE, POSITIVE, Accepted
from jdem.materials.catalogue import CATALOGUE, LAWS, catalogue
from jdem.materials.soil import SoilParameters


def test_parameters_take_numbers_and_quantities():
    assert check_parameter("shear_modulus", "12 MPa", "cli", "--set") == pytest.approx(12e6)
    assert check_parameter("shear_modulus", "12e6", "cli", "--set") == 12e6
    assert check_parameter("surface_energy", 17, "cli", "--set") == 17.0
    assert check_parameter("plasticity_ratio", "35.8 %", "cli", "--set") == pytest.approx(0.358)
    assert check_parameter("pull_off_force", "-1 mN", "cli", "--set") == pytest.approx(-1e-3)


OUT_OF_RANGE = {
    "restitution": (0, 1), "static_friction": (-0.1,), "rolling_friction": (-0.1,),
    "surface_energy": (-1,), "plasticity_ratio": (0, 1, "1"), "tensile_exponent": (0.4, 5.1),
    "tangential_multiplier": (0,), "shear_modulus": (0, "-1 Pa"), "pull_off_force": (1e-3,),
    "slope_exponent": (1.2,), "wall_friction": (-1,), "platen_friction": (-1,),
}  # fmt: skip


@pytest.mark.parametrize("name", PARAMETER_UNITS)
def test_every_parameter_has_a_range(name):
    for value in (*OUT_OF_RANGE[name], float("nan"), float("inf"), True, None, "abc", 10**400):
        with pytest.raises(
            InputError, match=f"^cli: field '--set': .*; {PARAMETER_RANGES[name][1][:6]}"
        ):
            check_parameter(name, value, "cli", "--set")


def test_suggestion_names_the_nearest_or_all():
    assert suggestion("heigth", ["height", "width"]) == "did you mean 'height'?"
    assert suggestion("zzz", ["height", "width"]) == "known names: height, width"


def test_units_are_converted():
    assert unit_factor("kN", FORCE) == pytest.approx(1000)
    assert quantity(" +5.0e1mm ", LENGTH) == pytest.approx(0.05)


@given(st.text(max_size=20) | st.text("0123456789 .-+eE^*/()mNskgPa%µ²·", max_size=20))
def test_no_text_breaks_a_quantity(text):
    for read in (quantity, unit_factor):
        try:
            assert np.isfinite(read(text, LENGTH))
        except BadValue as bad:
            assert bad.repair


SOIL = SoilParameters()


def test_every_value_of_a_soil_has_one_entry_and_is_accepted_by_it():
    values = SOIL.values()
    assert set(values) == set(CATALOGUE)
    assert all(CATALOGUE[name].accepted(float(value)) for name, value in values.items())
    assert len({entry.symbol for entry in CATALOGUE.values()}) == len(CATALOGUE)


@pytest.mark.parametrize("law", LAWS)
def test_a_fit_looks_only_where_the_law_accepts(law):
    for entry in catalogue(law).values():
        assert entry.label and entry.symbol and entry.repair
        if entry.search is not None:
            assert entry.accepted(entry.search.low) and entry.accepted(entry.search.high)
            assert 0 < entry.search.low < entry.search.high
            assert entry.search.prior_sd > 0


def test_ends_of_a_range_belong_to_it_or_not():
    assert [POSITIVE(x) for x in (-1.0, 0.0, 1e-9)] == [False, False, True]
    assert [NOT_NEGATIVE(x) for x in (-1e-9, 0.0, 1e9)] == [False, True, True]
    assert [FRACTION(x) for x in (0.0, 0.5, 1.0)] == [False, True, False]
    assert [Accepted(choices=(1.0, 1.5))(x) for x in (1, 1.2, 1.5)] == [True, False, True]
    assert not NOT_NEGATIVE(np.nan)


# ------------------------------------------------------------------ what is meant: slips of units

LAB = """
[soil]
name = "x"
density = ["1.65 g/cm^3", "1700 kg/m^3"]
water_content = ["22.84 %"]
[specimen]
diameter = "50 mm"
height = "100 mm"
[confined]
rate = "8 mm/s"
force_low = "200 N"
force_high = "400 N"
[unconfined]
rate = "0.01 mm/s"
rest = "1 s"
[targets.depression_depth]
mean = "3.0 mm"
scatter = "0.15 mm"
repeats = 5
[targets.crushing_force]
mean = "180 N"
scatter = "12 N"
repeats = 5
[[curves]]
test = "confined"
file = "c.csv"
displacement = { column = "way", unit = "mm" }
force = { column = "force", unit = "N" }
[particles]
reference_diameter = "80 um"
[parameters]
shear_modulus = { value = "7 MPa", low = "2 MPa", high = "20 MPa" }
surface_energy = "17 J/m^2"
"""
SLIPS = {  # old, new, field, what is likely meant; the first six are those of a user
    "m for mm": ('diameter = "50 mm"', 'diameter = "50 m"', "specimen.diameter", "50 mm"),
    "mm for cm": ('height = "100 mm"', 'height = "2 mm"', "specimen.height", "2 cm"),
    "density": ('"1.65 g/cm^3"', '"1.65 kg/m^3"', "soil.density[0]", "1.65 g/cm^3"),
    "depth": ('"3.0 mm"', '"3.0 m"', "targets.depression_depth.mean", "3.0 mm"),
    "kN for N": ('high = "400 N"', 'high = "400 kN"', "confined.force_high", "400 N"),
    "flat": ('height = "100 mm"', 'height = "100 um"', "specimen.height", "100 mm"),
    "SI density": ('"1700 kg/m^3"', '"1700 g/cm^3"', "soil.density[1]", "1700 kg/m^3"),
    "share": ('"22.84 %"', '"0.2284 %"', "soil.water_content[0]", "22.84 %"),
    "um": ('"80 um"', '"80 mm"', "particles.reference_diameter", "80 um"),
    "kPa for MPa": ('value = "7 MPa"', 'value = "7 kPa"', "parameters.shear_modulus", "7 MPa"),
    "GPa": ('high = "20 MPa"', 'high = "20 GPa"', "parameters.shear_modulus.high", "20 MPa"),
    "mJ": ('"17 J/m^2"', '"17 mJ/m^2"', "parameters.surface_energy", "17 J/m^2"),
    "speed": ('"8 mm/s"', '"8 m/s"', "confined.rate", "8 mm/s"),
    "small force": ('"180 N"', '"0.180 N"', "targets.crushing_force.mean", "0.180 kN"),
    "strength": ('"180 N"', '"92 MPa"', "targets.crushing_force.mean", "92 kPa"),
    "scatter": ('"0.15 mm"', '"0.15 m"', "targets.depression_depth.scatter", "0.15 mm"),
    "scatter N": ('"12 N"', '"12 kN"', "targets.crushing_force.scatter", "12 N"),
    "years": ('"1 s"', '"3 year"', "unconfined.rest", "3 s"),
    "slender": ('diameter = "50 mm"', 'diameter = "5 mm"', "specimen.height", "diameter 5 cm"),
    "force of a curve": ('column = "force", unit = "N"', 'column = "force", unit = "kN"',
                         "curves[0].force.unit", 'unit = "N"'),
    "travel of a curve": ('column = "way", unit = "mm"', 'column = "way", unit = "m"',
                          "curves[0].displacement.unit", 'unit = "mm"'),
    "travel in um": ('column = "way", unit = "mm"', 'column = "way", unit = "um"',
                     "curves[0].displacement.unit", 'unit = "mm"'),
    "stress of a curve": ('force = { column = "force", unit = "N" }',
                          'stress = { column = "force", unit = "MPa" }',
                          "curves[0].stress.unit", 'unit = "kPa"'),
    "strain of a curve": ('displacement = { column = "way", unit = "mm" }',
                          'strain = { column = "way", unit = "dimensionless" }',
                          "curves[0].strain.unit", 'unit = "%"'),
}  # fmt: skip


def written(folder, text):
    rows = "".join(f"{0.1 * k:.1f},{10 * k}\n" for k in range(41))
    (folder / "c.csv").write_text(f"way,force\n{rows}")
    (folder / "lab.toml").write_text(text)
    return folder / "lab.toml"


def test_a_usual_lab_has_no_slip(tmp_path):
    assert load_lab(written(tmp_path, LAB)).specimen.diameter == pytest.approx(0.05)


@pytest.mark.parametrize("case", SLIPS)
def test_a_slip_of_units_is_refused_with_what_was_likely_meant(tmp_path, case):
    old, new, field, meant = SLIPS[case]
    assert old in LAB
    path = written(tmp_path, LAB.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_lab(path)
    assert caught.value.field == field
    assert f"is {meant} meant?" in caught.value.repair
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("case", SLIPS)
def test_what_is_accepted_is_read_as_it_stands(tmp_path, case):
    """The line that the refusal names lets the entry pass, or the next refusal is another's."""
    old, new, field, _ = SLIPS[case]
    text = f'accept = ["{field}"]' + LAB.replace(old, new, 1)
    try:
        load_lab(written(tmp_path, text))
    except InputError as error:
        assert "above the first table" not in error.repair or error.field != field
        assert not error.field.startswith("accept")


def test_an_accepted_number_is_the_one_that_is_written(tmp_path):
    text = LAB.replace('"50 mm"', '"0.6 m"').replace("400 N", "60 kN").replace("180 N", "20 kN")
    text = text.replace('"12 N"', '"1 kN"').replace('unit = "N"', 'unit = "kN"')
    text = text.replace('height = "100 mm"', 'height = "1 m"')
    with pytest.raises(InputError, match="diameter"):
        load_lab(written(tmp_path, text))
    lab = load_lab(written(tmp_path, 'accept = ["specimen.diameter"]' + text))
    assert lab.specimen.diameter == pytest.approx(0.6)


@pytest.mark.parametrize("name", ["specimen.diametre", "soil.name", "x", "curves[7].force.unit"])
def test_what_cannot_be_accepted_is_refused(tmp_path, name):
    with pytest.raises(InputError, match=r"accept\[0\].*no entry of this file"):
        load_lab(written(tmp_path, f'accept = ["{name}"]' + LAB))


LISTED = """
[soil]
name = "x"
[specimen]
diameter = "50 mm"
height = "20 mm"
[[tests]]
type = "oedometer"
protocol = [{ step = "load", to = "200 kPa", rate = "1 %/min" }, { step = "hold", for = "1 h" },
            { step = "unload", to = "2 N" }]
[tests.targets]
settlement_mm = { mean = "2 mm", scatter = "5 %", repeats = 3 }
[[tests]]
type = "relaxation"
specimen = { diameter = "100 mm", height = "100 mm" }
force = "2 kN"
[[tests]]
type = "machine"
force = "400 N"
weight = "200 N"
reads = "198 N"
"""
LISTED_SLIPS = {
    "stress": ('"200 kPa"', '"200 MPa"', "tests[0].protocol[0].to", "200 kPa"),
    "rate": ('"1 %/min"', '"8 m/s"', "tests[0].protocol[0].rate", "8 mm/s"),
    "way": ('"200 kPa"', '"50 mm"', "tests[0].protocol[0].to", "50 um"),
    "hold": ('for = "1 h"', 'for = "10 year"', "tests[0].protocol[1].for", "10 s"),
    "target": ('"2 mm"', '"2 m"', "tests[0].targets.settlement_mm.mean", "2 mm"),
    "own size": ('diameter = "100 mm"', 'diameter = "100 cm"', "tests[1].specimen.diameter",
                 "100 mm"),
    "on its own area": ('"2 kN"', '"2 N"', "tests[1].force", "2 kN"),
    "without soil": ('weight = "200 N"', 'weight = "200 kN"', "tests[2].weight", "200 N"),
}  # fmt: skip


@pytest.mark.parametrize("case", LISTED_SLIPS)
def test_slips_in_listed_tests_are_refused(tmp_path, case):
    assert len(load_lab(written(tmp_path, LISTED)).tests) == 3
    old, new, field, meant = LISTED_SLIPS[case]
    assert old in LISTED
    with pytest.raises(InputError) as caught:
        load_lab(written(tmp_path, LISTED.replace(old, new, 1)))
    assert caught.value.field == field
    assert f"is {meant} meant?" in caught.value.repair
