"""How the paper's published figures are judged: the rule, the tables as data, page and command.

What became of the figures is in test_reproduction_figures.
"""

import json
import runpy
from functools import partial

import numpy as np
import pytest

from calibrate import cli
from calibrate.designs import designs
from calibrate.designs.factors import Factor
from calibrate.reports.html import number, render
from studies.chen_2023 import (
    depth,
    force,
    levels,
    paper,
    report,
)
from studies.chen_2023.tables import FOLDER, Range, equation, printed, table
from studies.chen_2023.verdict import (
    Attempt,
    Verdict,
    judge,
    judge_words,
    rounded,
    without_data,
)

REPRODUCED, CORRECTED, NOT = Verdict


@pytest.fixture(scope="module")
def result():
    return paper.reproduce()


# ------------------------------------------------------------------ the rule


@pytest.mark.parametrize(
    ("text", "value", "reach"),
    [("3.36", 3.36, 0.005), ("1.062e5", 106200, 50), ("0.0343146", 0.0343146, 5e-8), ("4", 4, 0.5)],
)
def test_a_printed_number_stands_for_half_a_unit_of_its_last_digit(text, value, reach):
    assert printed(text).value == value
    assert printed(text).reach == pytest.approx(reach, rel=1e-12)


def test_rounding_of_inputs_is_the_worst_case():
    """Of a weighted sum it is the sum of |weight| times half unit."""
    weights, half = np.array([2.0, -3.0, 0.5]), np.array([0.1, 0.2, 0.0])
    found = rounded(lambda x: {"sum": float(weights @ x)}, np.array([1.0, 2.0, 3.0]), half)
    assert found["sum"].value == pytest.approx(-2.5)
    assert found["sum"].reach == pytest.approx(2 * 0.1 + 3 * 0.2)


def test_no_rounding_of_the_depths_moves_an_entry_out_of_its_range():
    """Random depths that print as Table 3 does give entries within the stated ranges, but for
    the second-order part that is left out (2 % of the reach)."""
    ranges = depth.anova_ranges()[""]
    noise = np.random.default_rng(1).uniform(-1, 1, (50, 13)) * depth.half_units()
    for shift in noise:
        found = depth.analysis(depth.depths() + shift)
        entries = {
            "model.sum_of_squares": found["Model"].sum_of_squares,
            "model.f_value": found["Model"].f,
        }
        for entry, value in entries.items():
            assert abs(value - ranges[entry].value) <= 1.02 * ranges[entry].reach


@pytest.mark.parametrize(
    ("computed", "correction", "verdict"),
    [(2.005, "", REPRODUCED), (2.0051, "", NOT), (2.005, "halved", CORRECTED)],
)
def test_the_verdict_turns_where_the_ranges_part(computed, correction, verdict):
    figure = judge("T", "n", "2.00", [Attempt(Range(computed, 1e-9), correction)])
    assert figure.verdict is verdict


def test_the_first_attempt_that_agrees_is_taken():
    attempts = [Attempt(Range(5.0)), Attempt(Range(2.0), "first"), Attempt(Range(2.0), "second")]
    figure = judge("T", "n", "2.00", attempts, "remark")
    assert (figure.verdict, figure.correction) == (CORRECTED, "first")
    nowhere = judge("T", "n", "9.00", attempts, "remark")
    assert (nowhere.verdict, nowhere.correction) == (NOT, "second; remark")


def test_a_misprint_is_judged_by_its_reading():
    attempts = [Attempt(Range(7.0), "read as 7", printed("7"))]
    assert judge("T", "n", "9.00", attempts).verdict is CORRECTED


def test_words_and_missing_data():
    assert judge_words("T", "n", "a > b", "a > b").verdict is REPRODUCED
    assert judge_words("T", "n", "a > b", "b > a").verdict is NOT
    assert without_data("T", "n", "93.5", "why").as_json()["computed"] is None


# ------------------------------------------------------------------ the tables as data


def test_every_cell_of_the_tables_is_a_number():
    for n in range(1, 11):
        source = table(n)
        for row in source.rows:
            for column in source.columns[1:]:
                if source.text(row, column):
                    assert np.isfinite(source.cell(row, column).value)
    assert len(list(FOLDER.glob("table_*.csv"))) == 10
    assert "CC BY 4.0" in (FOLDER / "README.md").read_text(encoding="utf-8")


def as_set(points):
    return sorted(tuple(np.round(row, 5)) for row in points)


def test_table_2_is_a_plackett_burman_design():
    coded = levels.coded(table(2), levels.FACTORS)
    assert coded.shape == (12, 7)
    np.testing.assert_array_equal(coded.T @ coded, 12 * np.eye(7))
    np.testing.assert_array_equal(coded.sum(axis=0), np.zeros(7))


def test_table_3_is_a_rotatable_central_composite():
    factors = (Factor("A", 0.3, 0.7), Factor("B", 0.2, 1.0))
    design = designs.central_composite(factors, centre=5)
    coded = np.column_stack([f.coded(x) for f, x in zip(factors, depth.points().T, strict=True)])
    np.testing.assert_allclose(np.sort(coded, axis=0), np.sort(design.coded, axis=0), atol=2e-5)


def test_table_4_is_a_box_behnken_design():
    factors = (Factor("C", 4, 20), Factor("D", 0.3, 0.7), Factor("E", 0.3, 1.0))
    design = designs.box_behnken(factors, 5)
    coded = np.column_stack([f.coded(x) for f, x in zip(factors, force.points().T, strict=True)])
    assert as_set(coded) == as_set(design.coded)


# ------------------------------------------------------------------ the report


def test_the_page_stands_alone(result):
    page = report.page(result)
    for word in ("<script", "<link", "@import", "url(", 'src="http', 'href="http', "srcset"):
        assert word not in page
    assert page.count('<img src="data:image/svg+xml;base64,') == 4
    assert page.count("alt=") == 4
    assert "default-src 'none'" in page
    assert 'name="viewport"' in page
    for source in result.counts():
        assert source in page


def test_the_page_is_the_same_every_time(result):
    assert report.page(result) == report.page(result)


def test_text_is_escaped(result):
    bad = without_data("<i>T", "<script>alert(1)</script>", "1", 'a & "b" <img src=x>')
    page = report.page(paper.Reproduction((bad,), (), (), ()))
    assert "<script>" not in page
    assert "<img src=x>" not in page
    assert "&lt;script&gt;alert(1)" in page


def test_a_template_that_lacks_a_value_is_refused():
    with pytest.raises(Exception, match="undefined"):
        render(report.TEMPLATE)


@pytest.mark.parametrize(
    ("value", "words"),
    [(None, "–"), (-0.25, "−0.25"), (1234567.0, "1234600"), (3.0, "3"), (2e-5, "2e−05")],
)
def test_numbers_for_reading(value, words):
    assert number(value) == words


@pytest.fixture
def reproduce(calibrate, monkeypatch):
    """Runs `python -m studies.chen_2023` in tmp_path: exit status, standard output and error."""
    module = partial(runpy.run_module, "studies.chen_2023", run_name="__main__")
    monkeypatch.setattr(cli, "main", module)
    return calibrate


def test_the_command_writes_page_and_json(reproduce, tmp_path):
    status, out, error = reproduce("--out", "here", "--json", "there/r.json")
    assert (status, error) == (0, "")
    content = json.loads((tmp_path / "there" / "r.json").read_text())
    assert {"table", "name", "published", "computed", "verdict", "correction"} <= set(
        content["figures"][0]
    )
    assert len(content["figures"]) >= 120
    assert {figure["verdict"] for figure in content["figures"]} == set(map(str, Verdict))
    assert sum(content["counts"].values()) == len(content["figures"])
    assert json.loads((tmp_path / "here" / "reproduction.json").read_text()) == content
    assert (tmp_path / "here" / "reproduction.html").read_text().startswith("<!doctype html>")
    assert all(words in out for words in ("Table 10", "not reproduced", "Force equation"))
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith(".part")]


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_a_place_that_cannot_be_written_is_refused(reproduce, tmp_path, option):
    (tmp_path / "file").write_text("in the way")
    for place in ("file/below", "/proc/nowhere/x"):
        status, out, error = reproduce(option, place)
        assert (status, out) == (2, "")
        assert error.count("\n") == 1
        assert option in error
        assert "Traceback" not in error


def test_a_wrong_option_is_refused_in_one_line(reproduce):
    status, out, error = reproduce("--outt", "here")
    assert (status, out) == (2, "") and error.count("\n") == 1
    assert "--outt" in error and "see python -m studies.chen_2023 --help" in error


def test_help_names_the_options(reproduce):
    status, out, error = reproduce("--help")
    assert (status, error) == (0, "")
    assert all(option in out for option in ("--out", "--json"))


def test_equations_have_all_their_printed_terms():
    assert len(equation("depth")) == 9
    assert len(equation("force")) == 13
