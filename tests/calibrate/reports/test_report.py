"""`calibrate report`: pages from folders alone, hostile text, broken files, a real browser.

Results are those of a soil of formulas; what a page shows is held against the result's JSON.
"""

import html
import json
import random
import re
import shutil
from collections import Counter
from dataclasses import replace
from functools import partial, reduce
from operator import getitem
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from calibrate import figures
from calibrate.core.errors import InputError
from calibrate.core.files import write_json
from calibrate.core.progress import Silent
from calibrate.designs.comparison import SlopePair, design
from calibrate.figures import doe, misfit
from calibrate.figures.fit import fit_figure
from calibrate.figures.misfit import misfit_figure
from calibrate.figures.panels import BANDED, FRESH, _band, _resampled
from calibrate.figures.style import DARK, MIDDLE, PANEL
from calibrate.inference.audit import audit, audit_json
from calibrate.inference.calibration import calibrate as fit
from calibrate.inference.parameters import FACTORS, space
from calibrate.labtests.measured import Curve, Target
from calibrate.records import base as records
from calibrate.records.fit import FitRecord
from calibrate.reports import kinds, study
from calibrate.simulation import specimens
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.session import Session, origin_of
from calibrate.verbs import fit as fit_verb
from calibrate.verbs import simulate
from jdem.physics import PHYSICS
from tests.support import browser
from tests.support.formulas import BASE, LAB, Capped, Formulas, specimen

pytestmark = pytest.mark.thorough

HOSTILE = (
    "</title><script>alert('x')</script><img src=http://example.org/x onerror=alert(1)>"
    ' $\\frac$ & "q"'
)

TARGETS = {
    "depression_depth_mm": Target(2.5, 0.1, 4),
    "crushing_force_n": Target(185.0, 8.0, 4),
}
MEASURED = Curve("confined", np.linspace(0, 5, 9), np.linspace(0, 410, 9), "a <b>.csv")
PRESET = PRESETS["quick"]


def session(folder: Path, **changes) -> Session:
    return Session(replace(LAB, targets=TARGETS, **changes), PRESET, folder, Silent())


def written_fit(folder: Path, free=None, **changes) -> Path:
    opened = session(folder, **changes)
    fit_verb.kept(opened, fit(opened.lab, PRESET, free, opened.soil({}), 0, Formulas()))
    return folder


def written_audit(folder: Path) -> Path:
    opened, seeds = session(folder), range(4)
    found = audit(space(LAB, (*FACTORS, "shear_modulus")), Formulas(), seeds, ["ensemble"])
    settings = {"spheres": 300, "seeds": list(seeds), "parameters": specimens.soil_json(BASE)}
    content = {**origin_of(opened), **settings, **audit_json(found)}
    write_json(folder / "audit.json", content)
    return folder


def written_study(folder: Path) -> Path:
    opened = session(folder)
    study.write(opened, design(opened.lab, PRESET, opened.soil({}), 0, Formulas()))
    return folder


WRITERS = {"fit": written_fit, "audit": written_audit, "doe": written_study}


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, Path]:
    return {kind: write(tmp_path_factory.mktemp(kind)) for kind, write in WRITERS.items()}


@pytest.fixture(scope="module")
def pages(folders) -> dict[str, str]:
    return {kind: page_of(folder) for kind, folder in folders.items()}


@pytest.fixture
def report(calibrate):
    """Runs `calibrate report` in tmp_path; returns exit status, standard output and error."""
    return partial(calibrate, "report")


def page_of(folder: Path) -> str:
    kind, file = kinds.find(folder)
    return kind.page(file).html


def text_of(page: str) -> str:
    return html.unescape(re.sub(r"<[^>]*>", " ", page))


# ------------------------------------------------------------------ what a page shows


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_a_page_stands_alone(pages, kind):
    page = pages[kind]
    for word in ("<script", "<link", "@import", "url(", 'src="http', 'href="http', "srcset"):
        assert word not in page
    pictures = re.findall(r"<img ([^>]*)>", page)
    assert len(pictures) >= 7
    for picture in pictures:
        assert 'src="data:image/svg+xml;base64,' in picture
        assert len(re.findall(r'alt="[^"]{20,}"', picture)) == 1
    assert "default-src 'none'" in page


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_a_page_shows_a_new_figure_below_its_docstring(folders, kind, monkeypatch):
    def new(found):
        """What was found, in another way."""
        return plt.figure(label=found.soil)

    monkeypatch.setattr(misfit, "new", new, raising=False)
    monkeypatch.setitem(figures.FIGURES[kind], "new", "misfit:new")
    assert "What was found, in another way." in page_of(folders[kind])


@pytest.mark.slow
@pytest.mark.parametrize("kind", WRITERS)
def test_a_page_says_what_made_it(folders, pages, kind):
    text = text_of(pages[kind])
    _, file = kinds.find(folders[kind])
    origin = json.loads(file.read_text())
    for words in (
        origin["command"],
        origin["soil"],
        origin["preset"],
        f"physics {origin['physics']}",
    ):
        assert words in text
    assert {"python", "differentiable-soil", "jax", "numpy"} <= set(origin["versions"])
    assert all(f"{name} {version}" in text for name, version in origin["versions"].items())
    assert ", ".join(map(str, origin["seeds"])) in text


@pytest.mark.slow
def test_a_page_is_the_same_every_time(folders, pages):
    assert page_of(folders["fit"]) == pages["fit"]


@pytest.mark.slow
def test_the_page_of_a_study_is_that_of_its_command(folders, pages):
    assert pages["doe"] == (folders["doe"] / study.PAGE).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_fit_shows_its_numbers(folders, pages):
    """Fitted value and interval of every free parameter, targets, every packing in a picture."""
    text = text_of(pages["fit"])
    result = json.loads((folders["fit"] / "result.json").read_text())
    modulus = result["parameters"]["shear_modulus"]
    low, high = result["identifiability"]["interval_95"]["shear_modulus"]
    assert f"{modulus / 1e6:.4g} MPa" in text
    assert f"{low / 1e6:.3g} MPa to {high / 1e6:.3g} MPa" in text
    assert f"{result['observables']['depression_depth_mm']:.4g} ± " in text
    assert "2.5 ± 0.1 (4 repeats)" in text
    packings = result["packings"]["fitted"] + result["packings"]["fresh"]
    alt = re.findall(r'alt="(Simulated over measured[^"]*)"', pages["fit"])[0]
    for packing in packings:
        assert f"{packing['crushing_force_n'] / 185:.3g}" in alt


@pytest.mark.slow
def test_drawn_curves_keep_ends_and_shape(folders):
    result = json.loads((folders["fit"] / "result.json").read_text())
    curve = result["packings"]["fitted"][0]["curves"]["confined"]
    assert len(curve["force_n"]) == len(curve["displacement_mm"]) <= specimens.DRAWN
    assert curve["force_n"][0] == 0 and max(curve["force_n"]) == pytest.approx(400, rel=0.01)
    long = specimens.drawn(np.linspace(0, 1, 5000), np.linspace(0, 3, 5000))
    assert (len(long["force_n"]), long["force_n"][-1]) == (specimens.DRAWN, 3.0)


@pytest.mark.slow
def test_an_audit_shows_its_verdicts(folders, pages):
    text = text_of(pages["audit"])
    rows = json.loads((folders["audit"] / "audit.json").read_text())["rows"]
    judged = [row for row in rows if row["judged"]]
    assert 0 < len(judged) < len(rows)
    assert text.count("● passed") == sum(row["passed"] for row in judged)
    assert text.count("not judged") >= len(rows) - len(judged)


def test_a_simulation_keeps_its_figure(tmp_path):
    opened = session(tmp_path, curves=(MEASURED,))
    runs = Formulas().runs([BASE], range(3), "simulating")[0]
    found = simulate.kept(opened, specimens.simulation_json(runs), runs)
    assert found.failures == [] and "simulated" in repr(found)
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    assert json.loads((tmp_path / "result.json").read_text())["physics"] == PHYSICS


# ------------------------------------------------------------------ hostile and odd contents


def test_hostile_text_is_shown_as_text(tmp_path):
    """In the soil's name, a named set, a curve's file, and what a result file itself claims."""
    changes = {"name": HOSTILE, "named_sets": {HOSTILE: {}}, "curves": (MEASURED,)}
    folder = written_fit(tmp_path, **changes)
    result = json.loads((folder / "result.json").read_text())
    for name in ("command", "stopped", "strategy", "preset"):
        result[name] = HOSTILE
    result["versions"] = {HOSTILE: HOSTILE}
    result["features"][HOSTILE] = {"measured": 1, "simulated": 1, "sd": 1}
    result["parameters"][HOSTILE] = 1
    result["quality"][HOSTILE] = 1
    result["packings"]["fresh"][0]["failure"] = HOSTILE
    (folder / "result.json").write_text(json.dumps(result))
    page = page_of(folder)
    assert "<script" not in page and "<img src=http" not in page
    assert page.count("<title>") == page.count("</title>") == 1
    assert text_of(page).count("alert('x')") >= 12


@pytest.mark.slow
def test_a_failed_packing_is_named(tmp_path, folders):
    result = json.loads((folders["fit"] / "result.json").read_text())
    failed = result["packings"]["fresh"][1]
    failed |= {"failure": "the bed exploded", "crushing_force_n": None, "curves": {}}
    (tmp_path / "result.json").write_text(json.dumps(result))
    assert f"packing {failed['seed']} failed: the bed exploded" in text_of(page_of(tmp_path))


def test_curves_without_targets_have_a_page(tmp_path):
    opened = session(tmp_path, curves=(MEASURED,))
    opened = replace(opened, lab=replace(opened.lab, targets={}))
    found = fit(opened.lab, PRESET, ("shear_modulus",), opened.soil({}), 0, Formulas())
    fit_verb.kept(opened, found)
    text = text_of(page_of(tmp_path))
    assert re.search(r"\d of \d numbers read from curves lie within 2 s\.d\.", text)
    assert "targets are met" not in text


BROKEN = {
    "no JSON": lambda r: "{",
    "a list": lambda r: "[]",
    "deep": lambda r: "[" * 100_000,
    "another file": lambda r: json.dumps({"free": [], "history": []}),
    "no seeds": lambda r: json.dumps({k: v for k, v in r.items() if k != "seeds"}),
    "unknown parameter": lambda r: json.dumps({**r, "free": ["$\\bad$"]}),
    "text for a number": lambda r: json.dumps({**r, "simulations": "many"}),
    "number for text": lambda r: json.dumps({**r, "soil": 3}),
    "no evaluation": lambda r: json.dumps({**r, "history": []}),
    "no correlation": lambda r: json.dumps(
        {**r, "identifiability": {**r["identifiability"], "correlation": []}}
    ),
    "an interval below zero": lambda r: json.dumps(
        {
            **r,
            "identifiability": {
                **r["identifiability"],
                "interval_95": {key: [-1, 0] for key in r["free"]},
            },
        }
    ),
    "a target of zero": lambda r: json.dumps(
        {
            **r,
            "measured": {
                **r["measured"],
                "targets": {"crushing_force_n": {"mean": 0, "scatter": 0, "repeats": 0}},
            },
        }
    ),
    "not UTF-8": lambda r: b"\xff\xfe\x00{",
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_result_is_refused(report, folders, tmp_path, case):
    content = BROKEN[case](json.loads((folders["fit"] / "result.json").read_text()))
    data = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "result.json").write_bytes(data)
    status, out, error = report(tmp_path)
    assert (status, out) == (2, "")
    assert error.count("\n") == 1 and "Traceback" not in error
    assert str(tmp_path) in error
    assert not (tmp_path / "report.html").exists()


@pytest.mark.slow
def test_a_broken_study_is_refused(report, folders, tmp_path):
    """A design without its responses, and one whose points and responses differ in number."""
    result = json.loads((folders["doe"] / "result.json").read_text())
    for change in ({}, {"depression_depth_mm": [[1.0]], "crushing_force_n": [[1.0]]}):
        result["designs"]["force"]["responses"] = change
        (tmp_path / "result.json").write_text(json.dumps(result))
        status, _, error = report(tmp_path)
        assert (status, error.count("\n")) == (2, 1)
        assert "designs.force" in error


NASTY = [None, -1, 0, 1e308, -1e308, "x", "<b>", [], {}, True, 1e-320, [1, 2], {"a": 1}]


def places(content, path=()):
    """Paths to every entry of a JSON document, three of each list."""
    pairs = content.items() if isinstance(content, dict) else enumerate(content[:3])
    for key, value in pairs:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", ["fit", "audit"])
def test_a_damaged_result_is_shown_or_refused(folders, tmp_path, monkeypatch, kind):
    """One entry replaced or taken away, 60 times: a page, or one sentence; no other end."""
    found, file = kinds.find(folders[kind])
    monkeypatch.setattr("calibrate.figures.style.svg", drawn_only)
    monkeypatch.setattr("calibrate.reports.audit.svg", drawn_only)
    rng, text = random.Random(kind), file.read_text()
    every, ends = list(places(json.loads(text))), Counter()
    for _ in range(60):
        content = json.loads(text)
        *path, last = rng.choice(every)
        part = reduce(getitem, path, content)
        if rng.random() < 0.2:
            del part[last]
        else:
            part[last] = rng.choice(NASTY)
        (tmp_path / file.name).write_text(json.dumps(content))
        try:
            assert kinds.page_of(found, tmp_path / file.name).html
            ends["shown"] += 1
        except InputError as error:
            assert str(tmp_path) in str(error) and "\n" not in str(error)
            ends["refused"] += 1
    assert min(ends["shown"], ends["refused"]) > 5


def drawn_only(figure) -> str:
    """Lays a figure out without writing it, which takes most of the time."""
    figure.draw_without_rendering()
    plt.close(figure)
    return "<svg/>"


# ------------------------------------------------------------------ the command


@pytest.mark.slow
def test_the_command_writes_a_page_and_a_summary(report, folders, tmp_path):
    status, out, error = report(folders["fit"], "--out", "here", "--json", "there/s.json")
    assert (status, error) == (0, "")
    page = (tmp_path / "here" / "report.html").read_text(encoding="utf-8")
    summary = json.loads((tmp_path / "there" / "s.json").read_text())
    assert summary["kind"] == "fit"
    assert summary["summary"] in text_of(page) and summary["summary"] in out
    assert not (folders["fit"] / "report.html").exists()


@pytest.mark.slow
def test_a_single_file_will_do(report, folders, tmp_path):
    shutil.copy(folders["audit"] / "audit.json", tmp_path / "mine.json")
    assert report("mine.json")[0] == 0
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")


@pytest.mark.parametrize("place", ["nowhere", "empty"])
def test_a_folder_without_result_is_refused(report, tmp_path, place):
    (tmp_path / "empty").mkdir()
    status, out, error = report(place)
    assert (status, out, error.count("\n")) == (2, "", 1)
    assert place in error


@pytest.mark.slow
def test_two_results_in_a_folder_are_asked_about(report, folders, tmp_path):
    for kind, name in (("fit", "result.json"), ("audit", "audit.json")):
        shutil.copy(folders[kind] / name, tmp_path / name)
    status, _, error = report(tmp_path)
    assert status == 2
    assert "audit.json, result.json" in error


# ------------------------------------------------------------------ a real browser


@pytest.mark.slow
@pytest.mark.skipif(browser.program() is None, reason="no Chromium is installed")
def test_pages_in_a_browser(pages, tmp_path):
    """No word on the console, no request, nothing wider than the screen, at both widths."""
    for kind, text in pages.items():
        (tmp_path / f"{kind}.html").write_text(text, encoding="utf-8")
    found = browser.program()
    assert found is not None
    with browser.Browser(found) as opened:
        for page in sorted(tmp_path.glob("*.html")):
            for width in browser.WIDTHS:
                seen = browser.look(opened, page, width)
                assert seen.problems() == [], (page.name, width)


@pytest.mark.skipif(browser.program() is None, reason="no Chromium is installed")
def test_the_browser_check_sees_what_is_wrong(tmp_path):
    """A page that asks, fails, speaks and is too wide does not pass."""
    page = tmp_path / "bad.html"
    page.write_text(
        "<title>bad</title><p style='width:3000px'>wide</p><img src='http://127.0.0.1:9/x.png'>"
        "<script>console.error('spoken'); nothing.there()</script>"
    )
    found = browser.program()
    assert found is not None
    with browser.Browser(found) as opened:
        problems = "\n".join(browser.look(opened, page, 390).problems())
    for words in ("spoken", "127.0.0.1", "wide", "broken", "wordless"):
        assert words in problems


# ---- a fit that missed, in every place that shows it


@pytest.fixture(scope="module")
def missed_fit(tmp_path_factory):
    """A user's choice of parameters that cannot meet a curve three times as strong."""
    folder = tmp_path_factory.mktemp("missed")
    opened = session(folder)
    strong = Curve("unconfined", *(specimen(BASE, 7).curves["unconfined"] * [1.0, 3.0]).T, "s.csv")
    opened = replace(opened, lab=replace(opened.lab, targets={}, curves=(strong,)))
    fit_verb.kept(opened, fit(opened.lab, PRESET, ("restitution",), opened.soil({}), 0, Formulas()))
    return folder


def test_what_a_fit_warns_of_stands_in_result_and_page(missed_fit):
    result = json.loads((missed_fit / "result.json").read_text())
    text = " ".join(text_of(page_of(missed_fit)).split())
    assert not result["met"] and len(result["warnings"]) > 3
    for sentence in result["warnings"]:
        assert sentence in text
    assert "The fit missed its data" in text and "fixed by the data" not in text
    assert "did not move" in text and "would help" in text


def test_the_figure_of_a_fit_shows_its_warnings_and_no_empty_panel(missed_fit):
    found = records.read(missed_fit / "result.json", FitRecord)
    figure = fit_figure(found)
    said = " ".join(text.get_text() for text in figure.texts)
    said += figure._supxlabel.get_text()
    assert "Warning: the fit did not meet" in said
    for axis in figure.axes:
        assert not axis.axison or axis.lines or axis.collections or axis.patches
        assert not axis.axison or len(axis.lines) > 1
    plt.close(figure)


def test_the_misfit_of_a_fit_marks_what_it_warns_of(missed_fit):
    found = records.read(missed_fit / "result.json", FitRecord)
    axis = misfit_figure(found).axes[0]
    points = {line.get_color(): list(line.get_xdata()) for line in axis.lines[1:]}
    off = [(each.simulated - each.measured) / each.sd for each in found.features.values()]
    assert points[MIDDLE] == [each for each in off if abs(each) > 3] != []
    assert points[DARK] == [each for each in off if abs(each) <= 3]
    assert "which the fit warns of" in page_of(missed_fit)
    assert (missed_fit / "misfit.png").stat().st_size > 10_000
    plt.close("all")


def test_what_a_wider_round_freed_is_shown_with_its_start(tmp_path):
    """Depth halved and strength doubled: written whole, table and history too."""
    opened = session(tmp_path)
    values = {"depression_depth_mm": Target(1.2, 0.05, 4), "crushing_force_n": Target(420, 20, 4)}
    opened = replace(opened, lab=replace(opened.lab, targets=values))
    found = fit_verb.kept(opened, fit(opened.lab, PRESET, None, opened.soil({}), 0, Capped()))
    result = json.loads((tmp_path / "result.json").read_text())
    assert len(result["rounds"]) > 1
    assert page_of(tmp_path)
    said = repr(found)
    assert all(name in said for name in result["free"])
    lines = (tmp_path / "history.csv").read_text().splitlines()
    assert len(lines) == 1 + len(result["history"])
    assert set(result["free"]) <= set(lines[0].split(","))


def test_names_of_slopes_do_not_lie_on_each_other():
    pairs = [
        SlopePair("screening", name, "f", y, 0.01, 9, x, 0.01, 9, True)
        for name, x, y in (
            ("plasticity_ratio", 0.70, 0.98), ("static_friction", 0.71, 0.97),
            ("rolling_friction", 0.69, 0.99), ("surface_energy", 0.72, 1.0),
            ("shear_modulus", -1.9, -1.95), ("restitution", 0.7, 0.96),
        )
    ]  # fmt: skip
    figure, axis = plt.subplots(figsize=PANEL, layout="constrained")
    doe.slopes(axis, pairs, "depth")
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axis.texts]
    assert len(boxes) == 6
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)
    plt.close(figure)


# ---- mean and band of several curves, also of curves that turn back


def there_and_back(top=8.0, force=400.0):
    """A straight line up to `top` (mm) and a steeper one back to half of it."""
    travel = np.concatenate([np.linspace(0, top, 50), np.linspace(top, top / 2, 30)[1:]])
    load = np.concatenate([np.linspace(0, force, 50), np.linspace(force, 0, 30)[1:]])
    return records.Curve(displacement_mm=travel.tolist(), force_n=load.tolist())


def drawn(curves):
    figure, axis = plt.subplots()
    _band(axis, curves, FRESH)
    (line,), (patch,) = axis.lines, axis.patches
    plt.close(figure)
    return line.get_xydata(), patch.get_xy()


def test_a_curve_is_read_at_equal_shares_of_its_way():
    found = _resampled(there_and_back(), points=13)
    assert np.abs(np.diff(found[:, 0])) == pytest.approx(np.full(12, 1.0))
    assert found[8] == pytest.approx([8.0, 400.0])


def test_equal_curves_have_themselves_as_mean_and_no_band():
    mean, band = drawn([there_and_back()] * BANDED)
    assert mean[:, 1].max() == pytest.approx(400.0, rel=0.01)
    assert band[: len(mean)] == pytest.approx(mean, abs=1e-9)


def test_the_band_is_as_wide_as_the_scatter():
    """Forces of 0.9 and 1.1 times the mean: halfway up, at 200 N, the deviation is 20 N times
    sqrt(6/5); measured across a slope of 45 degrees, in units of the axes, it is 0.71 of that."""
    curves = [there_and_back(force=400 * f) for f in (0.9, 1.1) * (BANDED // 2)]
    mean, band = drawn(curves)
    half = int(np.argmin(np.abs(mean[:80, 1] - 200)))
    offset = (band[half] - mean[half]) / np.ptp(mean, axis=0)
    assert np.linalg.norm(offset) == pytest.approx(20 * 1.095 / 400 * 0.71, rel=0.1)
