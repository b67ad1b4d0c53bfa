"""The paper's published figures: how each is judged, page and command, then every finding.

Expected values are the paper's printed ones, or are computed here in another way (plain least
squares by numpy, sums by hand); none is copied from the program's output.
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
    equations,
    findings,
    force,
    inside,
    levels,
    paper,
    report,
    screening,
    sweep,
)
from studies.chen_2023.tables import FILE, Range, equation, in_text, printed, table
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
    assert FILE.read_text(encoding="utf-8").count("# table_") == 10
    assert "CC BY 4.0" in FILE.with_suffix(".md").read_text(encoding="utf-8")


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


# ------------------------------------------------------------------ findings


@pytest.fixture(scope="module")
def figures(result):
    return {(figure.table, figure.name): figure for figure in result.figures}


def named(figures, table_name):
    return {name: figure for (source, name), figure in figures.items() if source == table_name}


# ------------------------------------------------------------------ the whole


def test_more_than_120_published_numbers_have_a_verdict(result):
    numbers = [figure for figure in result.figures if not isinstance(figure.published, str)]
    assert len({(figure.table, figure.name) for figure in numbers}) == len(numbers) >= 120
    assert sum(result.total().values()) == len(result.figures)
    assert all(result.total()[verdict] for verdict in Verdict)


def test_every_figure_says_why(result):
    """A correction where one was needed, a reason where nothing helped, neither otherwise."""
    for figure in result.figures:
        assert bool(figure.correction) == (figure.verdict is not REPRODUCED), figure


def test_every_printed_entry_of_the_result_tables_is_judged(figures):
    for n in (7, 8, 9, 10):
        source = table(n)
        cells = [source.text(row, column) for row in source.rows for column in source.columns[1:]]
        judged = [
            f for f in named(figures, source.title).values() if not isinstance(f.published, str)
        ]
        assert sorted(f.printed_as for f in judged) == sorted(cell for cell in cells if cell)


def test_figures_that_agree_lie_within_their_tolerance(result):
    for figure in result.figures:
        if figure.verdict is REPRODUCED and figure.tolerance is not None:
            assert abs(figure.published - figure.computed) <= figure.tolerance


# ------------------------------------------------------------------ screening: Tables 7 and 8


def test_table_7_does_not_come_from_table_2(figures):
    y = table(2).values("depression_depth_mm")
    total = np.sum((y - y.mean()) ** 2)
    assert total == pytest.approx(2.61, abs=0.005)
    assert screening.screening("depression_depth").total_sum_of_squares == pytest.approx(total)
    np.testing.assert_allclose(screening.implied_total("depression_depth"), 14.2, atol=0.005)
    assert not any(f.verdict is REPRODUCED for f in named(figures, "Table 7").values())
    contribution = figures["Table 7", "static friction, contribution"]
    assert round(contribution.computed) == 4 and round(contribution.published) == 24


def test_table_7_is_not_three_times_table_2_either():
    """Beyond 0.03 mm, which is what the rounding of three times the depths can do."""
    tripled = screening.screening("depression_depth", 3.0)
    for name in levels.FACTORS:
        assert abs(tripled[name].effect - table(7).cell(name, "effect").value) > 0.03


def test_no_factor_is_significant_for_depth():
    found = screening.screening("depression_depth")
    p = {name: found[name].p for name in levels.FACTORS}
    assert min(p, key=lambda name: p[name]) == "restitution"
    assert min(p.values()) == pytest.approx(0.135, abs=0.0005)


def test_table_8_has_contributions_like_those_of_table_2_and_other_effects(figures):
    rows = named(figures, "Table 8")
    for name in levels.FACTORS:
        words = name.replace("_", " ")
        share, effect = rows[f"{words}, contribution"], rows[f"{words}, effect"]
        assert abs(share.computed - share.published) < 4  # percentage points
        assert abs(effect.computed - effect.published) > 10  # newtons
        assert share.verdict is effect.verdict is NOT
    assert rows["order of contributions"].verdict is REPRODUCED


# ------------------------------------------------------------------ depth: Tables 3 and 9


def test_table_9_belongs_to_three_times_the_depth(figures):
    rows = named(figures, "Table 9")
    assert all(f.verdict is not NOT for f in rows.values() if not isinstance(f.published, str))
    for name in ("model", "restitution", "static friction", "residual", "total"):
        figure = rows[f"{name}, sum of squares"]
        assert figure.verdict is CORRECTED
        assert "three times" in figure.correction
    assert rows["model, F"].verdict is REPRODUCED  # a ratio does not see the factor


def test_the_residual_of_table_9_is_the_pure_error():
    y = 3 * depth.depths()
    centre = y[[2, 4, 5, 6, 11]]
    pure = np.sum((centre - centre.mean()) ** 2)
    found = depth.analysis(y)
    assert (found["Pure error"].df, found["Residual"].df) == (4, 5)
    assert found["Pure error"].sum_of_squares == pytest.approx(pure)
    assert table(9).cell("residual", "sum_of_squares").value == pytest.approx(pure, rel=0.02)


def test_the_depth_equation_is_three_times_table_3_at_every_point():
    a, b = 0.7, 0.2  # run 9, by hand
    by_hand = (
        21.587 - 37.179 * a - 39.749 * b + 128.190 * a * b + 19.993 * a**2 + 25.887 * b**2
        - 71.561 * a**2 * b - 78.735 * a * b**2 + 42.199 * a**2 * b**2
    )  # fmt: skip
    assert depth.equation_values()["run 9"].value == pytest.approx(by_hand)
    assert len(depth.equation_values()) == 9
    for name, measured in depth.depth_at_points().items():
        value = depth.equation_values()[name]
        assert Range(3 * measured.value, 3 * measured.reach).meets(value), name
        assert not measured.meets(value)


def test_the_factor_of_the_depth_equation_is_three():
    factor, agreeing = equations.common_factor(depth.equation_values(), depth.depth_at_points())
    assert Range(1 / 3).meets(factor)
    assert factor.reach < 1e-3
    assert len(agreeing) == 9


def test_the_depth_optimum_misses_its_target(figures):
    found = depth.predictions_at_optimum()
    cubics = (found["cubic"].value, found["cubic with A^2*B^2"].value)
    assert min(cubics) == pytest.approx(3.32, abs=0.005)
    assert max(cubics) == pytest.approx(3.34, abs=0.005)
    assert found["quadratic"].value == pytest.approx(3.50, abs=0.005)
    assert figures["Optimum", "depression depth at the optimum"].verdict is NOT


# ------------------------------------------------------------------ force: Tables 4 and 10


def least_squares_residual(y):
    c, d, e = force.points().T
    rows = np.column_stack([c**0, c, d, e, c * d, c * e, d * e, c**2, d**2, e**2])
    return np.sum((y - rows @ np.linalg.lstsq(rows, y)[0]) ** 2)


def test_the_analysis_of_variance_of_table_4():
    found, y = force.analysis(force.forces()), force.forces()
    residual = least_squares_residual(y)
    assert (round(residual), found["Residual"].df) == (18012, 7)
    assert found["Residual"].sum_of_squares == pytest.approx(residual)
    assert (round(found["Pure error"].sum_of_squares), found["Pure error"].df) == (16825, 4)
    model = found["Model"]
    assert model.sum_of_squares == pytest.approx(np.sum((y - y.mean()) ** 2) - residual)
    assert model.sum_of_squares == pytest.approx(1.062e5, abs=50)
    assert model.df == 9
    assert model.f == pytest.approx(4.58, abs=0.01)
    assert model.p == pytest.approx(0.0287, abs=2e-4)


def test_table_10_follows_within_a_third_of_a_percent():
    assert 0.001 < findings.largest_deviation_of_table_10() < 0.003


def test_two_responses_changed_by_a_fifth_of_a_newton_give_all_of_table_10(figures):
    rows = named(figures, "Table 10")
    assert all(f.verdict is not NOT for f in rows.values() if not isinstance(f.published, str))
    changed = [f for f in rows.values() if force.ANALYSED_WORDS in f.correction]
    assert len(changed) >= 8  # more than rounding: the printed responses do not give these
    difference = force.forces(force.ANALYSED) - force.forces()
    assert np.count_nonzero(difference) == 2
    assert np.max(np.abs(difference)) < 0.21


def test_the_sum_of_squares_of_the_plasticity_ratio_has_two_wrong_digits(figures):
    """Two digits differ from the mean square beside it; they are not merely exchanged."""
    squares, mean = (
        table(10).text("plasticity_ratio", c) for c in ("sum_of_squares", "mean_square")
    )
    assert sum(a != b for a, b in zip(squares, mean, strict=True)) == 2
    assert sorted(squares) != sorted(mean)
    figure = figures["Table 10", "plasticity ratio, sum of squares"]
    assert figure.verdict is CORRECTED
    assert figure.computed == pytest.approx(printed(mean).value, abs=50)


def test_the_residual_row_of_table_10_is_the_pure_error(figures):
    for words in ("sum of squares", "degrees of freedom", "mean square"):
        figure = figures["Table 10", f"residual, {words}"]
        assert figure.verdict is CORRECTED
        assert "pure error" in figure.correction


def test_the_force_equation_is_not_in_newtons():
    c, d, e = 4, 0.7, 0.65  # run 12, by hand
    by_hand = (
        -1.763 + 0.024 * c + 7.037 * d + 5.257 * e - 0.783 * c * d + 0.138 * c * e
        - 4.429 * d * e + 0.026 * c**2 + 3.494 * d**2 + 0.424 * e**2 - 0.037 * c**2 * d
        - 0.014 * c**2 * e + 1.636 * c * d**2
    )  # fmt: skip
    assert force.equation_values()["run 12"].value == pytest.approx(by_hand)
    factor, agreeing = force.unit_of_equation()
    assert abs(factor.value - 40.25) <= factor.reach
    assert set(force.equation_values()) - set(agreeing) == {"run 12"}


def test_exchanged_digits_bring_run_12_to_the_equation_and_away_from_table_10():
    assert sorted("331.61") == sorted("313.61")
    factor, _ = force.unit_of_equation()
    value = force.equation_values()["run 12"]
    of_run = force.forces(force.OF_EQUATION)[11]
    assert value.meets(Range(of_run / factor.value, of_run * factor.reach / factor.value**2))
    model = force.analysis(force.forces(force.OF_EQUATION))["Model"]
    assert not printed("1.062e5").meets(Range(model.sum_of_squares, 60))


def test_the_force_optimum_was_solved_for_the_abstract(figures):
    predicted = force.force_at_optimum()
    assert predicted.value == pytest.approx(210.0, abs=0.05)
    assert figures["Optimum", "crushing force at the optimum (abstract)"].verdict is REPRODUCED
    assert figures["Optimum", "crushing force at the optimum (section 3.3.3)"].verdict is NOT
    _, low, high = force.interval_at("optimum.tangential_multiplier")
    assert (high - low) / 2 == pytest.approx(139, abs=0.5)


def test_the_centre_points_fall_in_two_groups():
    values = findings.centre_points().values
    assert (values["in_low_group"], values["in_high_group"]) == (2, 3)
    assert values["low_group_largest_n"] == 180.40
    assert values["high_group_least_n"] == 286.42


def test_the_multiplier_acts_in_opposite_directions():
    values = findings.multiplier().values
    assert values["effect_in_table_4_n"] > 0 > values["effect_in_table_5_n"]


def test_only_one_factor_is_significant_for_force_by_the_papers_own_p(figures):
    figure = figures["Table 10", "significant at 0.05"]
    assert (figure.verdict, figure.computed) == (NOT, "plasticity_ratio")
    for name in ("surface_energy", "tangential_multiplier"):
        assert table(10).cell(name, "p_value").value > 0.05


# ------------------------------------------------------------------ the rest of the paper


def test_levels_and_held_values(figures):
    assert figures["Table 2", "plasticity ratio, low level"].computed == 0.2
    held = [f for name, f in named(figures, "Table 3").items() if "held" in name]
    assert [f.verdict for f in held] == [NOT] * 5
    assert all(f.verdict is REPRODUCED for n, f in named(figures, "Table 3").items() if "star" in n)


def test_means_of_table_6(figures):
    assert all(figure.verdict is REPRODUCED for figure in named(figures, "Table 6").values())


def test_the_best_multiplier_and_the_errors_of_the_verification(figures):
    assert figures["Table 5", "multiplier of least error in both responses"].computed == 0.8
    confined = figures["Verification", "error of the confined test"]
    assert confined.computed == pytest.approx(100 * (1 - 3.30 / 3.36))
    assert confined.verdict is NOT
    assert sweep.final_row("crushing_force").value == 201.0


def test_the_abstract_contradicts_the_body_on_the_force(figures):
    assert figures["Text", "measured crushing force (abstract)"].verdict is NOT
    assert figures["Text", "measured depression depth (abstract)"].verdict is REPRODUCED
    assert (in_text("abstract.crushing_force"), in_text("measured.crushing_force")) == (
        "210",
        "206",
    )


def test_p_inside_the_tables_needs_the_true_residual():
    checks = {(check.table, check.name): check for check in inside.checks()}
    for source, df in (("Table 9", 5), ("Table 10", 7)):
        right = checks[source, f"model: p with total - model = {df} degrees of freedom"]
        wrong = checks[source, "model: p by the printed residual"]
        assert (right.verdict, wrong.verdict) == (REPRODUCED, NOT)
        assert checks[source, "total: degrees of freedom of model and residual"].verdict is NOT


def test_findings_print_the_numbers_they_hold(result):
    for finding in result.findings:
        assert "{" not in finding.statement
        assert all(np.isfinite(value) for value in finding.values.values())


def test_statistics_that_the_paper_leaves_out(result):
    rows = {row["model"]: row for row in result.unprinted}
    y = force.forces()
    r2 = 1 - least_squares_residual(y) / np.sum((y - y.mean()) ** 2)
    assert rows["Table 4, quadratic"]["r2"] == pytest.approx(r2)
    assert rows["Table 3, cubic"]["lack_of_fit_df"] == "1, 4"
