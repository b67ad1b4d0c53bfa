"""Designs equal the textbooks' tables, keep their properties, and survive a trip through CSV."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calibrate.core.errors import BadValue, InputError
from calibrate.designs import designs
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.surface import fit_surface
from calibrate.designs.terms import quadratic
from tests import DATA

PUBLISHED = DATA / "doe"


def factors(count: int) -> tuple[Factor, ...]:
    return tuple(Factor("ABCDEFGHJKLM"[j], -1, 1) for j in range(count))


def rows_of(matrix: np.ndarray) -> set[tuple[float, ...]]:
    return {tuple(row) for row in np.round(matrix, 9) + 0.0}


# ---------------------------------------------------------------- factors


@settings(deadline=None)
@given(
    coded=st.floats(-2, 2),
    low=st.floats(1e-3, 1e6),
    ratio=st.floats(1.01, 1e4),
    log=st.booleans(),
)
def test_factor_maps_there_and_back(coded: float, low: float, ratio: float, log: bool):
    factor = Factor("f", low, low * ratio, log=log)
    assert factor.natural(-1.0) == pytest.approx(low)
    assert factor.natural(1.0) == pytest.approx(low * ratio)
    assert factor.coded(factor.natural(coded)) == pytest.approx(coded, abs=1e-9)


def test_centre_is_geometric_on_a_log_scale():
    assert Factor("f", 4, 25, log=True).centre == pytest.approx(10)
    assert Factor("f", 4, 25).centre == 14.5


@pytest.mark.parametrize(
    ("name", "low", "high", "log"),
    [("a", 2, 1, False), ("a", 1, 1, False), ("a", 0, np.inf, False), ("a", 0, 1, True)]
    + [(name, 0, 1, False) for name in ("", "  ", "a,b", "a*b", "#a", "a\nb", "run", "dummy_1")],
)
def test_impossible_factor_is_refused(name: str, low: float, high: float, log: bool):
    with pytest.raises(BadValue):
        Factor(name, low, high, log=log)


# ---------------------------------------------------------------- textbook tables


def test_plackett_burman_is_the_published_one():
    """Generator of Plackett and Burman (1946) for 12 runs, ten shifts, a row of low levels."""
    generator = [{"+": 1, "-": -1}[sign] for sign in "++-+++---+-"]
    table = [np.roll(generator, shift) for shift in range(11)] + [-np.ones(11)]
    design = designs.plackett_burman(factors(11))
    assert np.array_equal(design.coded, table)


def test_plackett_burman_keeps_dummies_and_centre_points():
    design = designs.plackett_burman(factors(7), centre=3)
    assert design.coded.shape == (15, 7)
    assert design.dummies.shape == (15, 4)
    assert design.centre.tolist() == [False] * 12 + [True] * 3
    columns = np.hstack([design.coded, design.dummies])
    assert np.array_equal(columns.T @ columns, 12 * np.eye(11))
    with pytest.raises(BadValue, match="12 factors"):
        designs.plackett_burman(factors(12))


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_central_composite_has_its_corners_stars_and_centre(count: int):
    design = designs.central_composite(factors(count), centre=6)
    alpha = (2.0**count) ** 0.25
    corners = set(itertools.product([-1.0, 1.0], repeat=count))
    stars = rows_of(np.vstack([alpha * np.eye(count), -alpha * np.eye(count)]))
    assert rows_of(design.coded) == corners | stars | {(0.0,) * count}
    assert design.centre.sum() == 6
    assert len(design) == 2**count + 2 * count + 6


def test_rotatable_design_predicts_alike_in_all_directions():
    rng = np.random.default_rng(0)
    rotatable = designs.central_composite(factors(3))
    directions = rng.normal(size=(20, 3))
    sphere = 1.3 * directions / np.linalg.norm(directions, axis=1)[:, None]

    def spread(design: Design) -> float:
        surface = fit_surface(design.coded, np.arange(len(design.coded)), quadratic(3))
        return float(np.ptp([surface.leverage(x) for x in sphere]))

    assert spread(rotatable) < 1e-12
    faced = np.clip(rotatable.coded, -1, 1)
    assert spread(replace(rotatable, coded=faced)) > 0.01


def test_central_composite_has_the_levels_that_the_paper_printed():
    """Table 3 of Chen et al. 2023: stars at 0.217157, 0.782843 and 0.0343146, 1.16569."""
    pair = (Factor("restitution", 0.3, 0.7), Factor("static_friction", 0.2, 1.0))
    natural = designs.central_composite(pair).natural()
    assert len(natural) == 13
    assert natural.min(axis=0) == pytest.approx([0.217157, 0.0343146], abs=5e-7)
    assert natural.max(axis=0) == pytest.approx([0.782843, 1.16569], abs=5e-6)


def test_box_behnken_is_the_published_one():
    """The 12 midpoints of the cube's edges (Box and Behnken 1960) and the centre."""
    edges = {
        tuple(np.insert(pair, place, 0.0))
        for place in range(3)
        for pair in itertools.product([-1.0, 1.0], repeat=2)
    }
    design = designs.box_behnken(factors(3), centre=5)
    assert len(design) == 17
    assert rows_of(design.coded) == edges | {(0.0, 0.0, 0.0)}
    assert design.centre.sum() == 5
    assert [len(designs.box_behnken(factors(n), centre=3)) for n in (4, 5)] == [27, 43]
    with pytest.raises(BadValue, match="6 factors"):
        designs.box_behnken(factors(6))


def test_box_behnken_has_the_points_that_the_paper_printed():
    table = np.loadtxt(PUBLISHED / "paper_table_4.csv", delimiter=",", skiprows=1)[:, 1:4]
    three = (Factor("C", 4, 20), Factor("D", 0.3, 0.7), Factor("E", 0.3, 1.0))
    natural = designs.box_behnken(three).natural()
    assert sorted(map(tuple, np.round(natural, 9))) == sorted(map(tuple, table))


def test_sweep_spans_the_levels():
    design = designs.sweep(Factor("k", 0.3, 1.0))
    assert design.natural()[:, 0] == pytest.approx(np.arange(3, 11) / 10)


# ---------------------------------------------------------------- order of the runs


def test_run_order_is_random_and_fixed_by_the_seed():
    design = designs.box_behnken(factors(3))
    first, again, other = (design.randomised(seed).run_order for seed in (1, 1, 2))
    assert sorted(first) == list(range(1, 18))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert np.array_equal(design.randomised(1).coded, design.coded)


def test_replicates_repeat_the_whole_design():
    twice = designs.plackett_burman(factors(9)).replicated(2)
    assert len(twice) == 24
    assert np.array_equal(twice.coded[:12], twice.coded[12:])
    assert twice.dummies.shape == (24, 2)


# ---------------------------------------------------------------- run sheets


def sheet_design() -> Design:
    chosen = (Factor("energy", 4, 40, "J/m^2", log=True), Factor("ratio", 0.3, 0.7))
    return designs.central_composite(chosen, centre=2).randomised(3)


def filled(tmp_path: Path, edit=lambda text: text) -> Path:
    """A sheet on disk whose empty response cells hold 10 times the run's number."""
    path = tmp_path / "runs.csv"
    sheet_design().write_csv(path, ["depth_mm", "force_n"])
    lines = path.read_text().splitlines()
    done = [
        line[:-1] + f"{10 * int(line.split(',')[0])},1" if line[0].isdigit() else line
        for line in lines
    ]
    path.write_text(edit("\n".join(done) + "\n"))
    return path


def test_design_comes_back_from_csv_as_it_was(tmp_path: Path):
    design = designs.plackett_burman(factors(7), centre=2).randomised(9)
    design.write_csv(tmp_path / "runs.csv", ["y"])
    sheet = designs.read_csv(tmp_path / "runs.csv")
    assert np.array_equal(sheet.design.coded, design.coded)
    assert np.array_equal(sheet.design.dummies, design.dummies)
    assert np.array_equal(sheet.design.run_order, design.run_order)
    assert sheet.design.factors == design.factors
    assert sheet.design.kind == "Plackett-Burman"
    assert np.all(np.isnan(sheet.responses["y"]))


def test_sheet_lists_runs_in_their_order(tmp_path: Path):
    sheet_design().write_csv(tmp_path / "runs.csv")
    body = (tmp_path / "runs.csv").read_text().splitlines()[3:]
    assert body[0].startswith("run,point,energy [J/m^2],ratio,energy (coded),")
    assert [int(line.split(",")[0]) for line in body[1:]] == list(range(1, 11))


def test_responses_come_back_in_standard_order_whatever_the_spreadsheet_did(tmp_path: Path):
    def shuffle(text: str) -> str:
        lines = text.splitlines()
        padded = [line + ",,," if line[0] == "#" else line for line in lines]
        return "\ufeff" + "\r\n".join(padded[:4] + padded[:3:-1]) + "\r\n,,,\r\n"

    sheet = designs.read_csv(filled(tmp_path, shuffle))
    design = sheet_design()
    assert np.array_equal(sheet.response("depth_mm"), 10 * design.run_order)
    assert sheet.design.coded == pytest.approx(design.coded, abs=1e-11)
    assert sheet.design.factors == design.factors


def test_a_missing_response_is_named_when_it_is_needed(tmp_path: Path):
    sheet = designs.read_csv(filled(tmp_path, lambda text: text.replace(",40,1", ",,1")))
    assert np.isnan(sheet.responses["depth_mm"]).sum() == 1
    with pytest.raises(InputError, match=r"runs\.csv: field 'depth_mm': 1 of 10 .* \(runs 4\)"):
        sheet.response("depth_mm")
    with pytest.raises(InputError, match="did you mean 'force_n'"):
        sheet.response("force")
    assert sheet.response("force_n") == pytest.approx(np.ones(10))


def change_cell(text: str, run: int, column: str, value: str) -> str:
    lines = text.splitlines()
    place = lines[3].split(",").index(column)
    for number, line in enumerate(lines):
        cells = line.split(",")
        if cells[0] == str(run):
            cells[place] = value
            lines[number] = ",".join(cells)
    return "\n".join(lines)


def test_an_emptied_coded_cell_is_computed_from_what_was_set(tmp_path: Path):
    def set_otherwise(text: str) -> str:
        return change_cell(change_cell(text, 5, "ratio", "0.45"), 5, "ratio (coded)", "")

    design = designs.read_csv(filled(tmp_path, set_otherwise)).design
    assert design.coded[design.run_order == 5, 1] == pytest.approx([-0.25])


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda t: t.replace("#factor", "factor"), "no line describes a factor"),
        (lambda t: t.replace(",", ";"), "no line describes a factor"),
        (lambda t: t.replace(",log", ",cubic"), "field '#factor energy': the scale is 'cubic'"),
        (lambda t: t.replace("4.0,40.0", "40.0,4.0"), "the levels of energy are 40.0 and 4.0"),
        (lambda t: t.replace("4.0,40.0", "low,40.0"), "the levels are 'low' and '40.0'"),
        (lambda t: t.replace("run,point", "run,points"), "'point': this column is missing"),
        (lambda t: t.replace("ratio (coded)", "ratios"), "'ratio (coded)': this column is mis"),
        (lambda t: t.replace("force_n", "depth_mm"), "two columns have this name"),
        (lambda t: "\n".join(t.splitlines()[:-1]), "the numbers are not 1 to 9, each once"),
        (lambda t: t + t.splitlines()[-1] + "\n", "the numbers are not 1 to 11, each once"),
        (lambda t: "\n".join(t.splitlines()[:4]), "there are no runs"),
        (lambda t: change_cell(t, 3, "depth_mm", "n/a"), "'depth_mm': run 3 has 'n/a'"),
        (lambda t: change_cell(t, 3, "depth_mm", "nan"), "'depth_mm': run 3 has 'nan'"),
        (lambda t: change_cell(t, 3, "force_n", "inf"), "'force_n': run 3 has 'inf'"),
        (lambda t: change_cell(t, 3, "force_n", "1,5"), "decimal points, not decimal commas"),
        (lambda t: change_cell(t, 3, "ratio", "0.66"), "'ratio': in run 3 0.66 is 0.8 coded"),
        (lambda t: change_cell(t, 3, "energy [J/m^2]", "-1"), "run 3 has no usable value"),
        (lambda t: change_cell(t, 3, "energy [J/m^2]", ""), "run 3 has no usable value"),
        (lambda t: change_cell(t, 3, "run", "x"), "'run': row 3 has 'x'"),
    ],
)
def test_a_spoilt_sheet_is_refused_in_one_sentence(tmp_path: Path, edit, says: str):
    designs.read_csv(filled(tmp_path))  # as it was written it is fine
    with pytest.raises(InputError) as refused:
        designs.read_csv(filled(tmp_path, edit))
    message = str(refused.value)
    assert says in message
    assert message.startswith(str(tmp_path / "runs.csv"))
    assert "\n" not in message


def test_a_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match="no such file"):
        designs.read_csv(tmp_path / "runs.csv")
