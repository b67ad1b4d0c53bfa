"""`calibrate diagnose` on a library of formulas: what it writes, shows, escapes and refuses."""

import html
import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import jax
import numpy as np
import pytest
import toy_library

from calibrate import cli
from calibrate.core.errors import InputError
from calibrate.discrepancy import infill
from calibrate.records.base import read
from calibrate.records.diagnosis import DiagnosisRecord
from calibrate.reports import diagnosis as report
from calibrate.reports.diagnosis_words import caution, shrinkage, verdict
from calibrate.reports.effects import PLAIN, plain, strength, title
from jdem.effects.composite import EFFECTS

HOSTILE = "</title><script>alert(1)</script><img src=http://example.org/x> $\\\\frac$ & more"
OFFSET = 10.0  # N
CONTRACT = {
    "where": {"test", "segment", "gap", "unit", "z", "share"},
    "which": {"verdict", "probability", "alike"},
    "how_far": {"before", "after", "interval", "floor", "ceiling"},
    "next_test": {"name", "separation", "predicted"},
}


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with library.nc and a laboratory whose load cell reads OFFSET too much."""
    folder = tmp_path_factory.mktemp("diagnose")
    toy_library.write_library(folder / "library.nc")
    toy_library.write_lab(folder / "lab", HOSTILE, OFFSET)
    return folder


def call(*arguments: object) -> int:
    """Exit status of a command line run in this process."""
    settings = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: getattr(jax.config, name) for name in settings}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["calibrate", *map(str, arguments)])
        try:
            cli.main()
        except SystemExit as end:
            return int(end.code or 0)
        finally:
            for name, value in before.items():
                jax.config.update(name, value)
    return 0


@pytest.fixture(scope="module")
def done(place) -> Path:
    """The folder that a diagnosis wrote."""
    out, library = place / "out", place / "library.nc"
    options = ("--library", library, "--out", out, "--json", place / "copy.json")
    assert call("diagnose", place / "lab" / "lab.toml", *options) == 0
    return out


def result(done: Path) -> dict:
    return json.loads((done / "result.json").read_text())


def test_result_has_the_contract_s_keys(done):
    found = result(done)
    for key, names in CONTRACT.items():
        part = found[key][0] if key == "where" else found[key]
        assert names <= set(part), key
    assert {"none", "unknown"} <= set(found["which"]["probability"])
    assert json.loads((done.parent / "copy.json").read_text()) == found


def test_probabilities_add_up(done):
    found = result(done)["which"]
    assert sum(found["probability_by_class"].values()) == pytest.approx(1.0)


def test_the_hidden_error_is_localised(done):
    """The offset shows before contact in both tests, within four of its standard errors."""
    rows = [s for s in result(done)["where"] if s["segment"] == "before contact"]
    assert [s["test"] for s in rows] == ["confined", "unconfined"]
    for segment in rows:
        assert segment["outside_band"]
        assert abs(segment["gap"] - OFFSET) < 4 * abs(segment["gap"] / segment["z"])


def test_curves_are_drawn_as_features_read_them(done):
    """Half the largest force is at zero displacement on loading, in every specimen."""
    for curves in result(done)["specimens"]:
        x, force = (np.array(v) for v in curves["confined"].values())
        top = int(np.argmax(x))
        crossing = np.interp(200.0, force[: top + 1], x[: top + 1])
        step = np.diff(x[: top + 1]).max()
        assert abs(crossing) < step


def test_page_is_self_contained_and_escapes_names(done):
    page = (done / report.PAGE).read_text()
    assert "<script" not in page and "<img src=http" not in page
    assert html.escape(HOSTILE.replace("\\\\", "\\")).split("$")[0] in page
    assert set(re.findall(r'(?:src|href)="([^",]*)', page)) == {"data:image/svg+xml;base64"}


def test_page_says_verdict_and_every_effect(done):
    found = read(done / "result.json", DiagnosisRecord)
    page = html.unescape((done / report.PAGE).read_text())
    assert report.sentence(found) in page
    for effect in found.which.effects:
        assert plain(effect.name).name in page
    assert report.page(done / "result.json").html == (done / report.PAGE).read_text()


def test_an_odd_specimen_is_named(done):
    found = read(done / "result.json", DiagnosisRecord)
    assert found.specimen_weights == result(done)["specimen_weights"]
    odd = found.model_copy(update={"specimen_weights": [1.0, 1.0, 0.25, 0.9]})
    said = caution(odd)
    assert "Specimen 3 lies far from the others and counts for 25 % of one." in said
    assert said.count("Specimen") == 1


def test_a_soil_beyond_the_library_is_named(done):
    found = read(done / "result.json", DiagnosisRecord)
    far = found.model_copy(update={"beyond_library": ["surface_energy"]})
    assert "beyond those of the library (surface energy)" in caution(far)
    assert "beyond those" not in caution(found.model_copy(update={"beyond_library": []}))


def test_repeats_that_scatter_more_than_assumed_are_named(done):
    found = read(done / "result.json", DiagnosisRecord)
    assert set(found.scatter_over_assumed) <= {"confined", "unconfined"}
    assert all(0.2 < ratio < 3 for ratio in found.scatter_over_assumed.values())
    wide = found.model_copy(update={"scatter_over_assumed": {"confined": 2.04, "unconfined": 1.2}})
    assert "Repeats of the confined test scatter 2 times as much" in caution(wide)
    assert "crushing test scatter" not in caution(wide)


def test_figures_are_drawings_with_units(done):
    drawn = {path.stem for path in (done / "figures").glob("*.svg")}
    assert {"where_confined", "where_unconfined", "probability", "effects", "next_test"} == drawn
    for path in (done / "figures").glob("*.svg"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_every_effect_of_the_library_has_plain_words():
    assert set(PLAIN) == set(EFFECTS)
    assert title("load_cell_gain / seating_gap + none").count(" or ") == 1
    assert strength("load_frame_compliance", 1e-6) == "1 mm/kN"


@pytest.mark.parametrize(
    "wrong", ["no library", "no lab", "lab as library", "library as lab", "other shape"]
)
def test_wrong_input_is_one_sentence(place, capfd, wrong):
    lab, library = place / "lab" / "lab.toml", place / "library.nc"
    if wrong == "other shape":
        text = lab.read_text().replace('height = "100 mm"', 'height = "60 mm"')
        (place / "lab" / "short.toml").write_text(text)
    pair = {
        "no library": (lab, place / "missing.nc"),
        "no lab": (place / "missing.toml", library),
        "lab as library": (lab, lab),
        "library as lab": (library, library),
        "other shape": (place / "lab" / "short.toml", library),
    }[wrong]
    status = call("diagnose", pair[0], "--library", pair[1], "--out", place / "refused")
    said = capfd.readouterr().err
    assert status == 2
    last = said.strip().splitlines()[-1]
    assert last.startswith("error: ") and "Traceback" not in said
    assert pair[0].name in last or pair[1].name in last


@pytest.mark.slow
def test_infill_runs_join_the_library(place, monkeypatch):
    monkeypatch.setattr(infill, "run_points", toy_library.run_points)
    out, library = place / "infill", place / "library.nc"
    lab = place / "lab" / "lab.toml"
    assert call("diagnose", lab, "--library", library, "--simulate", 4, "--out", out) == 0
    settings = result(out)["settings"]
    assert settings["simulations"] == len(toy_library.library().values)
    assert settings["simulated_about_this_lab"] >= 4 * 3  # none, an effect, a pair


def test_numbers_without_curves_are_called_mute(place, capsys):
    out = place / "numbers"
    lab = place / "lab" / "numbers.toml"
    text = (place / "lab" / "lab.toml").read_text().split("[[curves]]")[0]
    targets = """
[targets.depression_depth]
mean = "2.5 mm"
scatter = "0.1 mm"
repeats = 3
"""
    lab.write_text(text + targets)
    assert call("diagnose", lab, "--library", place / "library.nc", "--out", out) == 0
    said = report.page(out / "result.json").sentence
    assert said.startswith("One number without curves")
    assert "record force and displacement" in said


def test_an_effect_that_shrinks_nothing_is_not_credited(done):
    found = read(done / "result.json", DiagnosisRecord)
    assert found.how_far is not None
    for removed, shown, said in (
        (0.6, True, "removes 60 % of the gap"),
        (0.6, False, "the data cannot show (60 % here, 90 % interval 50 % to 70 %"),
        (-0.4, True, "does not shrink the gap"),
    ):
        interval = (removed - 0.1, removed + 0.1)
        far = found.how_far.model_copy(
            update={"shrinkage": removed, "interval": interval, "shown": shown}
        )
        assert said in shrinkage(found.model_copy(update={"how_far": far}))


def nothing_named(done: Path, p_gap: float, probability: dict[str, float]) -> str:
    """What the page says where none is the verdict."""
    found = read(done / "result.json", DiagnosisRecord)
    order = sorted(probability, key=lambda name: -probability[name])
    which = {"verdict": "none", "p_gap": p_gap, "probability_by_class": probability}
    explanations = [
        found.explanations[0].model_copy(update={"label": name, "probability": probability[name]})
        for name in order
    ]
    return verdict(found.model_copy(
        update={"which": found.which.model_copy(update=which), "explanations": explanations}
    ))  # fmt: skip


def test_that_nothing_is_named_has_three_reasons(done):
    """No gap; a gap that may be scatter; a likeliest cause that is not likely enough."""
    quiet = nothing_named(done, 0.4, {"none": 0.7, "wall_friction": 0.3})
    assert quiet.startswith("No gap was found") and "70 %" in quiet
    odd = nothing_named(done, 0.02, {"none": 0.7, "wall_friction": 0.3})
    assert "likelier than any explanation" in odd and "2 %" in odd
    vague = nothing_named(done, 0.02, {"none": 0.3, "unknown": 0.3, "wall_friction": 0.4})
    assert title("wall_friction") in vague and "40 %" in vague and "30 %" in vague
    other = nothing_named(done, 0.2, {"none": 0.4, "unknown": 0.6})
    assert "something that the library of effects does not hold" in other


def test_of_a_pair_that_is_named_both_effects_count(done):
    found = read(done / "result.json", DiagnosisRecord)
    assert found.how_far is not None
    far = found.how_far.model_copy(update={"shrinkage": 0.6, "interval": (0.5, 0.7), "shown": True})
    pair = ["wall_friction", "seating_gap"]
    which = found.which.model_copy(update={"verdict": "seating_gap + wall_friction"})
    for best, alone in ((pair, False), (pair[:1], True)):
        drawn_from = found.model_copy(update={"which": which, "how_far": far, "best": best})
        assert ("second effect is not counted" in shrinkage(drawn_from)) == alone


def test_a_damaged_result_is_refused(done, tmp_path):
    broken = {**result(done), "features": []}
    (tmp_path / "result.json").write_text(json.dumps(broken))
    with pytest.raises(InputError, match="features are empty"):
        report.page(tmp_path / "result.json")


def test_tests_that_the_library_does_not_know_are_named(done):
    found = read(done / "result.json", DiagnosisRecord)
    more = found.model_copy(update={"unused_tests": ["oedometer"]})
    assert "not in the library: oedometer." in caution(more)
    assert "Not used" not in caution(found)
