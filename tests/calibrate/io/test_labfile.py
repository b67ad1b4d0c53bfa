"""Lab files: a good one is read into SI, and every bad one gives one line that teaches.

The line must name the file, the field and the repair; whatever is done to the text of a lab
file, nothing but `InputError` may come out.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibrate.core.errors import BadValue, InputError, suggestion
from calibrate.core.units import FORCE, LENGTH, OFTEN, Kind, by_pint, quantity, unit_factor
from calibrate.io.choices import ParameterChoice
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.labfile import PARAMETER_RANGES, PARAMETER_UNITS, check_parameter
from calibrate.labtests.measured import Target
from jdem.core.parameter import FRACTION, NOT_NEGATIVE, POSITIVE, Accepted
from jdem.materials.catalogue import CATALOGUE, LAWS, WHOLE, catalogue, parameters_of
from jdem.materials.conventions import DEFAULT
from jdem.materials.soil import SoilParameters
from tests import DATA

SILT_LOAM = DATA / "silt_loam"
GOOD = (SILT_LOAM / "lab.toml").read_text(encoding="utf-8")
CURVE = (SILT_LOAM / "confined_1.csv").read_text(encoding="utf-8")
HEAD = '[soil]\nname = "x"\n[specimen]\ndiameter = "5 cm"\nheight = "10 cm"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the good lab file and its curve."""
    (tmp_path / "lab.toml").write_text(GOOD, encoding="utf-8")
    (tmp_path / "confined_1.csv").write_text(CURVE, encoding="utf-8")
    return tmp_path


def refusal(path: Path) -> str:
    """The message with which `path` is refused."""
    with pytest.raises(InputError) as caught:
        load_lab(path)
    message = str(caught.value)
    assert len(message.splitlines()) == 1 and message.isprintable()
    assert caught.value.problem and caught.value.repair
    return message


# ---- good files -----------------------------------------------------------------------------


def test_soil_specimen_and_protocol_are_read_into_si(folder):
    lab = load_lab(folder / "lab.toml")
    assert (lab.name, lab.source) == ("silt loam", "field 3")
    np.testing.assert_allclose(lab.density_kg_m3, [1629.4, 1959.2])
    np.testing.assert_allclose(lab.water_content, [0.22835])
    specimen, confined, unconfined = lab.specimen, *lab.tests
    assert (specimen.diameter, specimen.height) == pytest.approx((0.05, 0.1))
    assert specimen.mould_height == pytest.approx(0.15)
    np.testing.assert_allclose(
        [confined.rate, confined.force_low, confined.force_high], [8e-3, 200, 400]
    )
    np.testing.assert_allclose([unconfined.rate, unconfined.rest], [1e-5, 1])
    assert confined.greased is False


def test_targets_are_keyed_by_observable_in_mm_and_newtons(folder):
    targets = load_lab(folder / "lab.toml").targets
    depth, force = targets["depression_depth_mm"], targets["crushing_force_n"]
    np.testing.assert_allclose([depth.mean, depth.scatter, depth.repeats], [3.36, 0.25, 4])
    np.testing.assert_allclose([force.mean, force.scatter, force.repeats], [206, 15, 4])


STRAIN = '[targets.failure_strain]\nmean = "{mean}"\nscatter = "{scatter}"\nrepeats = 3\n'


@pytest.mark.parametrize(
    ("mean", "scatter"), [("6 %", "0.5 %"), ("6 mm", "0.5 mm"), ("0.6 cm", "5000 ppm")]
)
def test_a_failure_strain_is_a_target_in_per_cent(tmp_path, mean, scatter):
    """Of a specimen 10 cm high, a length is the displacement at failure."""
    path = tmp_path / "lab.toml"
    path.write_text(HEAD + STRAIN.format(mean=mean, scatter=scatter))
    lab = load_lab(path)
    target = lab.targets["failure_strain_percent"]
    assert (target.mean, target.scatter, target.repeats) == pytest.approx((6.0, 0.5, 3))
    assert [o.name for o in lab.tests[1].given][1:] == ["failure_strain_percent"]


@pytest.mark.parametrize(
    ("name", "mean", "value"),
    [("secant_modulus", "4.5 MPa", 4500.0), ("work_to_failure", "800 mJ", 0.8)],
)
def test_modulus_and_work_are_targets_in_any_unit_of_theirs(tmp_path, name, mean, value):
    path = tmp_path / "lab.toml"
    table = f'[targets.{name}]\nmean = "{mean}"\nscatter = "{mean}"\nrepeats = 3\n'
    path.write_text(HEAD + table)
    (target,) = load_lab(path).targets.values()
    assert (target.mean, target.scatter) == pytest.approx((value, value))
    path.write_text(HEAD + table.replace(mean, "3 mm"))
    assert "'mm' is not a unit of" in refusal(path)


def test_repeats_of_failure_strain_are_a_column(tmp_path):
    (tmp_path / "r.csv").write_text("eps\n5\n6\n7\n")
    (tmp_path / "lab.toml").write_text(
        HEAD + '[targets.failure_strain]\nfile = "r.csv"\ncolumn = "eps"\nunit = "%"\n'
    )
    target = load_lab(tmp_path / "lab.toml").targets["failure_strain_percent"]
    assert (target.mean, target.scatter, target.repeats) == pytest.approx((6.0, 1.0, 3))


@pytest.mark.parametrize(
    ("mean", "said"),
    [
        ("206 N", "'N' is not a unit of strain"),
        ("0.06", "has no unit"),
        ("90 %", "outside 0.1 % to 50 %"),
        ("6 m", "60 times the specimen's height"),
    ],
)
def test_a_failure_strain_in_a_wrong_unit_is_refused_in_one_sentence(tmp_path, mean, said):
    path = tmp_path / "lab.toml"
    path.write_text(HEAD + STRAIN.format(mean=mean, scatter="0.5 %"))
    message = refusal(path)
    assert said in message and "targets.failure_strain.mean" in message


def test_parameters_particles_and_named_sets(folder):
    lab = load_lab(folder / "lab.toml")
    assert lab.parameters == {
        "plasticity_ratio": ParameterChoice(0.358, 0.1, 0.8, 0.5, True),
        "shear_modulus": ParameterChoice(12e6, None, None, None, None),
        "restitution": ParameterChoice(0.4, None, None, None, None),
    }
    assert lab.named_sets["published"]["surface_energy"] == pytest.approx(170)
    assert lab.particles.reference_diameter == pytest.approx(0.01)
    assert lab.particles.poisson_ratio == 0.25


def test_curves_are_converted_to_mm_and_newtons(folder):
    (curve,) = load_lab(folder / "lab.toml").curves
    assert (curve.test, curve.file) == ("confined", "confined_1.csv")
    np.testing.assert_allclose(curve.displacement_mm, [0, 1, 2, 3, 2])
    np.testing.assert_allclose(curve.force_n, [0, 100, 200, 350, 100])
    assert not curve.force_n.flags.writeable


def test_curves_in_a_subfolder_and_with_a_byte_order_mark(folder):
    (folder / "runs").mkdir()
    (folder / "runs" / "a.csv").write_text(CURVE, encoding="utf-8-sig")
    text = GOOD.replace('"confined_1.csv"', '"runs/a.csv"').replace('"travel"', '"time"')
    text = f'accept = ["curves[0].displacement.unit"]\n{text}'  # 1 s is no way of 1 m
    (folder / "lab.toml").write_text(text, encoding="utf-8-sig")
    (curve,) = load_lab(folder / "lab.toml").curves
    np.testing.assert_allclose(curve.displacement_mm[:2], [0, 1000])


def test_optional_sections_have_the_defaults_of_the_paper(folder):
    text = HEAD + '[targets.crushing_force]\nmean = "9 N"\nscatter = "1 N"\nrepeats = 1\n'
    (folder / "lab.toml").write_text(text)
    lab = load_lab(folder / "lab.toml")
    confined, unconfined = lab.tests
    assert (confined.rate, confined.force_high, unconfined.rate) == (8e-3, 400, 1e-5)
    assert (lab.density_kg_m3, lab.curves, lab.parameters) == ((), (), {})
    assert lab.particles.reference_diameter is None


def test_the_bundled_soil_is_that_of_the_paper():
    lab = load_lab(bundled_lab())
    assert np.mean(lab.density_kg_m3) == pytest.approx(1829.6, abs=0.05)
    assert np.mean(lab.water_content) == pytest.approx(0.2284, abs=5e-5)
    assert lab.targets["depression_depth_mm"] == Target(3.36, 0.168, 4, published_error=0.02782)
    assert lab.targets["crushing_force_n"] == Target(206.0, 10.3, 4, published_error=0.03674)
    assert lab.named_sets["paper_optimum"]["surface_energy"] == 17.158
    assert len(lab.named_sets["paper_optimum"]) == 7


def test_an_unknown_bundled_soil_names_the_near_one():
    with pytest.raises(InputError, match="did you mean 'wheat_after_rice'"):
        bundled_lab("wheat_after_rise")


# ---- bad lab files --------------------------------------------------------------------------

BAD_ENTRIES = [
    # old text, new text, field, problem or repair
    ('height = "100 mm"', 'height = "-30 mm"', "specimen.height", 'negative length -30 mm; give a'),
    ('height = "100 mm"', 'height = "0 mm"', "specimen.height", 'positive length such as "100 mm"'),
    ('height = "100 mm"', 'height = "nan mm"', "specimen.height", "finite number"),
    ('height = "100 mm"', 'height = "1e999 mm"', "specimen.height", "too large"),
    ('height = "100 mm"', 'height = "100 N"', "specimen.height", "not a unit of length"),
    ('height = "100 mm"', 'height = "100 parsnips"', "specimen.height", "not known"),
    ('height = "100 mm"', 'height = "100"', "specimen.height", "no unit"),
    ('height = "100 mm"', "height = 100", "specimen.height", 'such as "100 mm"'),
    ('height = "100 mm"', 'height = "1,5 mm"', "specimen.height", "not understood"),
    ('height = "100 mm"', 'height = "9**9**9 mm"', "specimen.height", "not understood"),
    ('height = "100 mm"', 'height = "5 NAN"', "specimen.height", "not understood"),
    ('height = "100 mm"', 'height = "5 m^9^9^9"', "specimen.height", "not understood"),
    ('height = "100 mm"', 'heigth = "100 mm"', "specimen.heigth", "did you mean 'height'?"),
    ('height = "100 mm"', "", "specimen.height", 'add height = "100 mm"'),
    ('height = "100 mm"', 'height = "200 mm"', "specimen.height", "higher than its mould"),
    ('name = "silt loam"', "", "soil.name", "add name"),
    ('name = "silt loam"', 'name = ""', "soil.name", "at least 1 character"),
    ('"1629.4 kg/m^3"', '"-1 kg/m^3"', "soil.density[0]", "positive density"),
    ('"22.835 %"', '"22.835"', "soil.water_content[0]", "22.84 %"),
    ('rate = "8 mm/s"', 'rate = "8 mm"', "confined.rate", "not a unit of speed"),
    ("greased = false", 'greased = "no"', "confined.greased", "boolean"),
    ('force_high = "400 N"', 'force_high = "150 N"', "confined.force_high", "higher force"),
    ('rest = "1 s"', 'rest = "-1 s"', "unconfined.rest", "0 or a positive time"),
    ('scatter = "15 N"', 'scatter = "0 N"', "targets.crushing_force.scatter", "positive force"),
    ('scatter = "15 N"\nrepeats = 4', 'scatter = "15 N"\nrepeats = 0',
     "targets.crushing_force.repeats", "greater than or equal to 1"),
    ("[targets.crushing_force]", "[targets.crush_force]", "targets.crush_force", "did you mean"),
    ('test = "confined"', 'test = "triaxial"', "curves[0].test", "'unconfined'"),
    ('file = "confined_1.csv"', 'file = "gone.csv"', "curves[0].file", "no such file"),
    ('unit = "kN"', 'unit = "mm"', "curves[0].force.unit", "not a unit of force"),
    ('unit = "kN"', "unit = 3", "curves[0].force.unit", "200 N"),
    ('delimiter = ";"', 'delimiter = "::"', "curves[0].delimiter", "it should be"),
    ("poisson_ratio = 0.25", "poisson_ratio = 0.5", "particles.poisson_ratio", "less than 0.5"),
    ("poisson_ratio = 0.25", "poisson_ratio = nan", "particles.poisson_ratio", "finite"),
    ("restitution = 0.4", "restitution = nan", "parameters.restitution", "above 0 and below 1"),
    ("restitution = 0.4", "restitution = []", "parameters.restitution", "not a number"),
    ("restitution = 0.4", "restituton = 0.4", "parameters.restituton", "mean 'restitution'"),
    ('"12 MPa"', '"12 kg"', "parameters.shear_modulus", '"12 MPa"'),
    ("value = 0.358", "value = 1", "parameters.plasticity_ratio", "above 0 and below 1"),
    ("low = 0.1", "low = 0.5", "parameters.plasticity_ratio", "low <= value <= high"),
    ("low = 0.1", "lo = 0.1", "parameters.plasticity_ratio.lo", "did you mean 'low'?"),
    ("prior_sd = 0.5", "prior_sd = 0", "parameters.plasticity_ratio.prior_sd", "greater than 0"),
    ('"17 mJ/cm^2"', '"-1 J/m^2"', "named_sets.published.surface_energy", "0 or a positive"),
    ("[particles]", "[partikles]", "partikles", "did you mean 'particles'?"),
    ("[soil]", '["so\\nil"]', "so il", "did you mean 'soil'?"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "field", "words"), BAD_ENTRIES)
def test_a_bad_entry_is_named_with_its_repair(folder, old, new, field, words):
    assert old in GOOD
    (folder / "lab.toml").write_text(GOOD.replace(old, new, 1), encoding="utf-8")
    message = refusal(folder / "lab.toml")
    assert message.startswith(f"{folder / 'lab.toml'}: field '{field}': ")
    assert words in message


def test_the_message_reads_as_promised(folder, monkeypatch):
    monkeypatch.chdir(folder)
    Path("lab.toml").write_text(GOOD.replace('"100 mm"', '"-30 mm"'), encoding="utf-8")
    assert refusal(Path("lab.toml")) == (
        "lab.toml: field 'specimen.height': negative length -30 mm; "
        'give a positive length such as "100 mm"'
    )


BAD_FILES = {
    "syntax": (b"[soil\n", "line 1"),
    "latin": ('[soil]\nname = "sol argileux humide \xe9"'.encode("latin-1"), "UTF-8"),
    "binary": (bytes(range(256)) * 8, "UTF-8"),
    "nested": (b"a = " + b"[" * 5000, "TOML"),
    "digits": (b"a = " + b"1" * 9000, "TOML"),
    "empty": (b"", "add a table [soil]"),
    "no_specimen": (b'[soil]\nname = "x"', "add a table [specimen]"),
    "nothing_measured": (HEAD.encode(), "[targets.depression_depth]"),
    "not_a_table": (b'soil = 3\nspecimen = "x"', "TOML table"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_file_that_is_no_lab_file_is_refused(tmp_path, name):
    content, words = BAD_FILES[name]
    path = tmp_path / f"{name}.toml"
    path.write_bytes(content)
    message = refusal(path)
    assert message.startswith(str(path)) and words in message


def test_a_missing_file_a_folder_and_an_impossible_name_are_refused(tmp_path):
    assert "no such file" in refusal(tmp_path / "lab.toml")
    assert "this is a folder" in refusal(tmp_path)
    assert "check" in refusal(tmp_path / ("x" * 4000))
    assert "no such file" in refusal(tmp_path / "nul\0.toml")


# ---- bad curves -----------------------------------------------------------------------------

BAD_CURVES = [
    # content, field ("" for the whole file), problem or repair
    ("", "", "points"),
    ("time;travel;load\n", "", "at least 5 points"),
    (CURVE.replace("4;0.002;0.1\n", ""), "", "4 points below the header are too few"),
    (CURVE.replace("0.35", "nan"), "load", "line 6: 'nan' is not a finite number"),
    (CURVE.replace("0.35", "1e400"), "load", "remove it"),
    (CURVE.replace("0.35", "0,35"), "load", "decimal point"),
    (CURVE.replace("0.35", ""), "load", "line 6: ''"),
    (CURVE.replace(";0.35", ""), "load", "line 6: ''"),
    (CURVE.replace("load", "Load (kN)"), "load", "name one of ['time', 'travel', 'Load (kN)']"),
    (CURVE.replace("time", "load"), "load", "2 columns"),
    (CURVE.replace(";", ","), "travel", "check the delimiter"),
    (CURVE.replace(";0.", ";-0."), "load", "positive numbers"),
    ("time;travel;load\n" + '"' + "x" * 200_000, "", "CSV"),
]


@pytest.mark.parametrize(("content", "field", "words"), BAD_CURVES)
def test_a_bad_curve_is_named_with_its_repair(folder, content, field, words):
    (folder / "confined_1.csv").write_text(content)
    message = refusal(folder / "lab.toml")
    where = f": field '{field}'" if field else ""
    assert message.startswith(f"{folder / 'confined_1.csv'}{where}: ")
    assert words in message


@pytest.mark.parametrize("content", [bytes(range(256)), b"\x00\x01" * 500, b"\xff\xfe" * 99])
def test_a_binary_curve_is_refused(folder, content):
    (folder / "confined_1.csv").write_bytes(content)
    assert "confined_1.csv" in refusal(folder / "lab.toml")


@pytest.mark.parametrize(
    "written",
    ["../outside.csv", "a/../../outside.csv", "/etc/passwd", "a\\\\..\\\\b.csv", "C:/a.csv",
     ".", "link.csv", "\\u0000", "x" * 999, "lab.toml/x.csv"],
)  # fmt: skip
def test_a_curve_outside_the_folder_is_refused(folder, tmp_path_factory, written):
    outside = tmp_path_factory.mktemp("elsewhere") / "outside.csv"
    outside.write_text(CURVE)
    (folder / "link.csv").symlink_to(outside)
    text = GOOD.replace('file = "confined_1.csv"', f'file = "{written}"')
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    assert "field 'curves[0].file'" in refusal(folder / "lab.toml")


def test_the_same_curve_twice_is_no_repeat(folder):
    table = GOOD[GOOD.index("[[curves]]") : GOOD.index("[particles]")]
    (folder / "lab.toml").write_text(GOOD + table, encoding="utf-8")
    assert "field 'curves[1].file'" in refusal(folder / "lab.toml")


# ---- mutations of the text ------------------------------------------------------------------

PIECES = st.one_of(
    st.text(max_size=6),
    st.sampled_from(["nan", "inf", "[", "]]", '"""', "= ", "\n", "\x00", "..", "1e999", "{}", "-"]),
    st.sampled_from(re.findall(r"\S+", GOOD)),
)
EDITS = st.lists(
    st.tuples(st.integers(0, len(GOOD)), st.integers(0, 12), PIECES), min_size=1, max_size=4
)


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(EDITS)
def test_mutations_load_or_are_refused_in_one_line(folder, edits):
    text = GOOD
    for start, length, piece in edits:
        text = text[:start] + piece + text[start + length :]
    (folder / "lab.toml").write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        assert type(load_lab(folder / "lab.toml")) is Lab
    except InputError as error:
        assert len(str(error).splitlines()) == 1


# ------------------------------------------------------------------ single values


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
    "gamma": (0, "-1 J/m^2"), "cohesion": (-1,), "yield_strength": (0,), "damping_factor": (1.1,),
    "normal_stiffness": (0, "-1 N/m^3"), "shear_stiffness": (-1,), "tensile_strength": (0,),
    "shear_strength": (0, "-1 kPa"), "radius_ratio": (0,), "internal_friction": (-0.1,),
    "moment_share": (-0.1, 1.1),
}  # fmt: skip


@pytest.mark.parametrize("name", PARAMETER_UNITS)
def test_every_parameter_has_a_range(name):
    law = next(law for law in (DEFAULT, *WHOLE) if name in parameters_of(law))
    for value in (*OUT_OF_RANGE[name], float("nan"), float("inf"), True, None, "abc", 10**400):
        with pytest.raises(
            InputError, match=f"^cli: field '--set': .*; {PARAMETER_RANGES[name][1][:6]}"
        ):
            check_parameter(name, value, "cli", "--set", law)


def test_suggestion_names_the_nearest_or_all():
    assert suggestion("heigth", ["height", "width"]) == "did you mean 'height'?"
    assert suggestion("zzz", ["height", "width"]) == "known names: height, width"


def test_units_are_converted():
    assert unit_factor("kN", FORCE) == pytest.approx(1000)
    assert quantity(" +5.0e1mm ", LENGTH) == pytest.approx(0.05)


@pytest.mark.parametrize("stored", OFTEN)
def test_units_of_most_lab_files_are_those_of_pint(stored):
    kind = Kind("kind", stored, "1")
    for unit in filter(None, OFTEN):
        known, own = (_answer(read, unit, kind) for read in (by_pint, unit_factor))
        same = own == known if isinstance(own, str) else np.isclose(own, known, 1e-15, 0.0)
        assert same, unit  # or both refuse it in the same words


def _answer(read, *given):
    try:
        return read(*given)
    except BadValue as bad:
        return str(bad.problem)


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
