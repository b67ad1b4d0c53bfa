"""`calibrate diagnose` on a library of formulas: what it writes, shows, escapes and refuses."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import matplotlib.pyplot as plt
import numpy as np
import pytest

from calibrate import figures
from calibrate.core.errors import InputError
from calibrate.discrepancy import infill
from calibrate.discrepancy.comparison import naming
from calibrate.discrepancy.comparison.compare import Comparison, compare, prepare
from calibrate.discrepancy.comparison.naming import BEYOND, FEW, NO_SHRINKAGE, Grounds
from calibrate.discrepancy.comparison.next_test import why_stop
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.reduction import Reduction
from calibrate.discrepancy.comparison.verdict import how_far
from calibrate.discrepancy.diagnosis import beyond_library
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.lab_size import soil_prior_for
from calibrate.discrepancy.library.measurements import read_measurements
from calibrate.figures import misfit
from calibrate.io.lab import load_lab
from calibrate.records.base import read
from calibrate.records.diagnosis import DiagnosisRecord
from calibrate.reports import diagnosis as report
from calibrate.reports.diagnosis_words import caution, shrinkage, verdict
from calibrate.reports.effects import PLAIN, plain, strength, title
from jdem.effects.composite import EFFECTS
from studies.sealed.baselines import strength_of
from tests.support import diagnosis_world, toy_library
from tests.support.toy_library import call

pytestmark = pytest.mark.thorough

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


def test_a_soil_at_the_edge_of_the_library_is_told(done):
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
    assert set(figures.FIGURES["diagnose"]) == drawn
    for path in (done / "figures").glob("*.svg"):
        assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_a_new_figure_is_shown_on_the_page(done, monkeypatch):
    def new(found, words):
        """Which effects were found."""
        return plt.figure(label=words(found.best[0]))

    monkeypatch.setattr(misfit, "new", new, raising=False)
    monkeypatch.setitem(figures.FIGURES["diagnose"], "new", "misfit:new")
    assert "Which effects were found." in report.page(done / "result.json").html


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
    assert settings["simulations"] == len(toy_library.library().rows.values)
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


# ------------------------------------------------------------------ what keeps a cause unnamed


def shrinking(value: float, low: float, high: float, left_out: float | None, before: float = 1.5):
    """A reduction of the gap by a share with its interval; the library's own error makes 1.2."""
    return Reduction(before, 1.1, 1.0, value, low, high, left_out, {}, own_error=1.2)


@pytest.fixture(scope="module")
def strongly():
    """A made-up laboratory in which the second effect is strong: sample and comparison."""
    known = diagnosis_world.description()
    prepared = prepare(known, diagnosis_world.PLAN, seed=1, draws=60)
    strength = strength_of(prepared.generator, 1, 12.0)
    measured = diagnosis_world.case(0, strength * known.effect_slopes[:, 1])
    found = compare(prepared, measured)
    assert "e1" in found.verdict.split(" / ")
    return prepared, measured, found


def unnamed_because(strongly, monkeypatch, grounds: Grounds, of_gap: Reduction) -> Comparison:
    monkeypatch.setattr(naming, "estimate_reduction", lambda *_: of_gap)
    prepared, measured, found = strongly
    return naming.named(prepared.description, measured, found, grounds, 0)[0]


MUCH = shrinking(0.9, 0.7, 0.95, 0.8)


@pytest.mark.parametrize(
    ("specimens", "reason"),
    [({"confined": 1, "unconfined": 1}, FEW), ({"confined": 2, "unconfined": 2}, FEW),
     ({"confined": 4, "unconfined": 1}, FEW), ({"confined": 2, "unconfined": 9}, FEW),
     ({"confined": 2}, FEW), ({"unconfined": 1}, FEW),
     ({"confined": 3, "unconfined": 3}, ""), ({"confined": 3}, "")],
)  # fmt: skip
def test_one_or_two_specimens_of_a_test_name_no_cause(strongly, monkeypatch, specimens, reason):
    said = unnamed_because(strongly, monkeypatch, Grounds(specimens), MUCH)
    assert said.reason == reason and (said.verdict == NONE) == bool(reason)
    assert bool(said.best) == (not reason)
    assert why_stop(said, []) in ([reason] if reason else ["sure", "nothing helps"])
    assert said.by_class == strongly[2].by_class  # what was weighed stays


@pytest.mark.parametrize(
    ("of_gap", "named"),
    [(shrinking(-1.0, 0.71, 0.99, -0.3), False),  # the bundled clay's
     (shrinking(0.0, -0.1, 0.2, 0.4), False), (shrinking(-0.4, -0.6, -0.1, 0.5), False),
     (shrinking(0.2, -0.2, 0.6, -0.1), False), (shrinking(0.2, -0.2, 0.6, None), False),
     (shrinking(0.2, -0.2, 0.6, 0.3), True), (shrinking(0.6, 0.4, 0.8, None), True)],
)  # fmt: skip
def test_what_does_not_shrink_the_gap_is_neither_named_nor_drawn(
    strongly, monkeypatch, of_gap, named
):
    said = unnamed_because(strongly, monkeypatch, Grounds(), of_gap)
    assert said.reason == ("" if named else NO_SHRINKAGE)
    assert bool(said.best) == named and (said.verdict != NONE) == named


def test_of_a_gap_within_the_library_s_own_error_it_is_not_said_how_far_it_shrinks(
    strongly, monkeypatch
):
    hidden = shrinking(-0.4, -0.1, 0.6, -0.2, before=1.15)
    monkeypatch.setattr(naming, "estimate_reduction", lambda *_: hidden)
    prepared, measured, found = strongly
    said, far = naming.named(prepared.description, measured, found, Grounds(), 0)
    assert (said.verdict, said.best, far) == (found.verdict, (), None)


@pytest.mark.parametrize(
    ("at_base", "at_named", "of_gap", "named"),
    [(("surface_energy",), ("surface_energy",), MUCH, False),
     (("stated error",), ("stated error",), MUCH, False),
     (("surface_energy",), ("stated error",), MUCH, False),
     (("surface_energy",), (), shrinking(0.6, -0.1, 0.8, 0.6), False),
     (("surface_energy",), (), shrinking(0.6, 0.1, 0.8, 0.6), True),
     (("surface_energy",), (), shrinking(0.6, 0.4, 0.8, 0.6, before=1.1), False),
     (("surface_energy",), (), shrinking(-0.6, 0.7, 0.8, 0.6), False),
     (("surface_energy",), (), MUCH, True), ((), ("surface_energy",), MUCH, True)],
)  # fmt: skip
def test_a_soil_beyond_the_runs_names_no_cause(
    strongly, monkeypatch, at_base, at_named, of_gap, named
):
    """Unless the cause brings it back among the runs, and the gap surely shrinks."""
    _, _, found = strongly
    base = found.base.delta
    grounds = Grounds(beyond=lambda delta: at_base if delta is base else at_named)
    said = unnamed_because(strongly, monkeypatch, grounds, of_gap)
    assert said.reason == ("" if named else BEYOND)
    assert why_stop(said, []) in (["sure", "nothing helps"] if named else [BEYOND])


def test_something_that_no_effect_explains_is_not_drawn_as_one(strongly, monkeypatch):
    prepared, measured, found = strongly
    other = replace(found, verdict=UNKNOWN, by_class={UNKNOWN: 0.99, NONE: 0.01})
    monkeypatch.setattr(naming, "estimate_reduction", lambda *_: shrinking(-1.0, 0.7, 0.9, None))
    said, far = naming.named(prepared.description, measured, other, Grounds(), 0)
    assert (said.verdict, said.reason, said.best, far) == (UNKNOWN, "", (), None)
    assert why_stop(said, []) == UNKNOWN  # and not: as good as certain


@pytest.mark.parametrize(
    ("value", "low", "high", "shown"),
    [(-1.0, 0.71, 0.99, False), (0.5, 0.6, 0.7, False), (0.8, 0.6, 0.7, False),
     (0.65, 0.6, 0.7, True), (0.6, 0.6, 0.7, True), (0.0, -0.2, 0.1, True)],
)  # fmt: skip
def test_an_interval_holds_its_value_or_is_not_shown(value, low, high, shown):
    far = how_far(shrinking(value, low, high, None))
    assert far is not None
    assert far["interval"] == ([low, high] if shown else None)
    assert not far["shown"] or shown


def test_intervals_of_shares_of_the_misfit_hold_them(done):
    for segment in result(done)["where"]:
        ends = segment["share_interval"]
        assert ends is None or ends[0] <= segment["share"] <= ends[1]


def test_one_effect_has_one_strength(done):
    """The table of effects and the list of explanations take it from the same fit."""
    found = read(done / "result.json", DiagnosisRecord)
    listed = {e.label: e.strengths for e in found.explanations}
    for effect in found.which.effects:
        if effect.name in listed:
            assert listed[effect.name][effect.name] == pytest.approx(effect.strength)


RATIOS = [
    (-0.172, 0.17, "no factor"), (-3.0, 0.1, "no factor"), (0.1, 0.2, "not told from none"),
    (0.3, 0.16, "not told from none"), (1.2, 0.1, ""), (0.5, 0.01, ""),
]  # fmt: skip


def test_a_ratio_that_is_none_gets_a_word(done):
    found = read(done / "result.json", DiagnosisRecord)
    ratio = found.across_tests[0]
    rows = [ratio.model_copy(update={"factor": f, "factor_se": se}) for f, se, _ in RATIOS]
    page = report.of(found.model_copy(update={"across_tests": rows})).html
    cells = re.findall(r" ± [\d.]+([^<]*)<", page.partition("measured over predicted")[2])
    assert len(cells) >= len(RATIOS)
    for cell, (_, _, word) in zip(cells, RATIOS, strict=False):
        assert ("no factor" in cell) == (word == "no factor")
        assert ("not told from none" in cell) == (word == "not told from none")


@pytest.fixture(scope="module")
def one(place) -> Path:
    """What both commands write of one specimen, whose load cell is not tared by 10 N."""
    toy_library.write_lab(place / "single", "one specimen", OFFSET, specimens=1)
    for verb in ("diagnose", "next"):
        options = ("--library", place / "library.nc", "--out", place / "single" / verb)
        assert call(verb, place / "single" / "lab.toml", *options) == 0
    return place / "single"


def test_of_one_specimen_both_commands_name_nothing_and_ask_for_more(one, capfd):
    asked = json.loads((one / "next" / "next.json").read_text())
    found = read(one / "diagnose" / "result.json", DiagnosisRecord)
    assert asked["verdict"] == found.which.verdict == NONE
    assert asked["reason"] == asked["stop"] == found.which.reason == FEW
    assert asked["tests"] == [] and found.next_test is None and found.best == []
    said = report.page(one / "diagnose" / "result.json")
    assert said.sentence.startswith("No cause is named") and "at least 3 specimens" in said.sentence
    assert "◀ verdict" not in said.html
    assert not (one / "next" / "next_lab.toml").exists()


def test_a_record_that_is_given_thrice_is_one_specimen(one):
    lab = one / "lab.toml"
    head, *curves = lab.read_text().split("[[curves]]")
    copies = [c.replace("_1.csv", f"_1{n}.csv") for c in curves for n in ("", "_copy", "_again")]
    for test in ("confined", "unconfined"):
        for name in ("_copy", "_again"):
            (one / f"{test}_1{name}.csv").write_text((one / f"{test}_1.csv").read_text())
    (one / "thrice.toml").write_text("[[curves]]".join([head, *copies]))
    emulated = EmulatedLibrary.of(toy_library.library())
    found = read_measurements(load_lab(one / "thrice.toml"), emulated.library.features)
    assert len(found.specimens) == 3 and set(found.repeats.values()) == {1}


@pytest.mark.slow
@pytest.mark.parametrize("preload", [0.0, 1.5, 3.5, 6.0, 10.0])
def test_no_cause_is_named_of_a_preload_at_which_records_begin(place, preload):
    """Four specimens, whose records begin at contact or later.  Formulas are no runs, so the whole
    records are "unknown": cut ones stay so, and no untared load cell is named."""
    folder = place / f"sound_{preload:g}"
    toy_library.write_lab(folder, "sound", 0.0)
    for path in folder.glob("*.csv"):
        first, *rows = path.read_text().split()
        force = np.array([float(row.split(",")[1]) for row in rows])
        path.write_text("\n".join([first, *rows[int(np.argmax(force > preload)) :]]))
    options = ("--library", place / "library.nc", "--out", folder / "out")
    assert call("diagnose", folder / "lab.toml", *options) == 0
    found = read(folder / "out" / "result.json", DiagnosisRecord)
    assert found.which.verdict == UNKNOWN
    if preload > 1.0:  # sooner, readings in the air are left
        assert set(found.records_begin) == {"confined", "unconfined"}
        assert "load_cell_offset" not in {e.name for e in found.which.effects}
        assert "before contact" not in {row.segment for row in found.features}
        assert "without a reading before contact" in report.sentence(found)


def test_a_library_reaches_as_far_as_its_runs_and_those_that_were_added():
    emulated = EmulatedLibrary.of(toy_library.library())
    lab = load_lab(Path(toy_library.LAB.file))
    prior = soil_prior_for(lab, emulated.library).offset
    sd = np.array([*toy_library.DESIGN.soil_sd.values()])
    for away, beyond in ((2.0, False), (2.45, False), (2.6, True), (4.0, True), (-4.0, True)):
        delta = np.zeros(len(prior))
        delta[0] = away * sd[0] - prior[0]
        assert (beyond_library(lab, emulated, delta) == ("shear_modulus",)) == beyond
    base = emulated.library.rows.base.copy()
    base[:4, 0] = 3.9 * sd[0]
    rows = replace(emulated.library.rows, base=base)
    more = EmulatedLibrary.of(replace(emulated.library, rows=rows))
    delta[0] = 4.0 * sd[0] - prior[0]
    assert beyond_library(lab, more, delta) == ()
