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

from calibrate.core.errors import InputError
from calibrate.io.lab import Lab, ParameterChoice, bundled_lab, load_lab
from calibrate.labtests.measured import Target

SILT_LOAM = Path(__file__).parent / "data" / "silt_loam"
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
