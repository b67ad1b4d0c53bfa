"""Rows: sentences with measured numbers, the results they rest on, and what is said of them."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.inference.posterior import FromRuns
from jdem.physics import PHYSICS
from tests import ROOT
from verification import __main__ as engine
from verification import beside, other_tests, quick, reference_beds, reporting, shear_boxes
from verification.reporting import Cell, Row, Script
from verification.rows import README, ROWS, SURE
from verification.scripts import SCRIPTS

NAMES = [row.name for row in ROWS]
PAGES = ("README.md", "docs/howto/how-sure.md", "docs/howto/how-long.md", "docs/doe.md",
         "docs/reliability.md", "docs/derivatives.md", "docs/howto/posterior.md")  # fmt: skip


@pytest.fixture
def copied(tmp_path) -> Path:
    """The result pages and the pages with sentences, to be changed."""
    for name in ("verification", "studies"):
        (tmp_path / name / "results").mkdir(parents=True)
        for page in (ROOT / name / "results").glob("*.md"):
            shutil.copy(page, tmp_path / name / "results")
    for name in PAGES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def changed(path: Path, before: str, after: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), encoding="utf-8")


# ------------------------------------------------------------------ every row


def test_names_and_scripts_are_known():
    assert len(set(NAMES)) == len(ROWS) > 15
    assert {row.page for row in ROWS} == set(PAGES)
    assert {row.script for row in ROWS} <= set(SCRIPTS)


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_its_results_exist_and_its_page_says_them(row: Row):
    """Files, keys, the rule, and the sentence to the last digit."""
    assert quick.faults(row) == []


@pytest.mark.parametrize("row", ROWS, ids=NAMES)
def test_its_rule_can_be_broken(row: Row):
    """Numbers without sense break the rule: all of them enormous, or none."""
    numbers = row.numbers()
    tries = [dict.fromkeys(numbers, value) for value in (1e9, -1e9, 0.0)]
    rising = dict(zip(numbers, range(len(numbers)), strict=True))
    falling = dict(zip(numbers, range(len(numbers), 0, -1), strict=True))
    assert not all(row.holds(wrong) for wrong in [*tries, rising, falling])


def test_numbers_of_readme_and_how_sure_are_in_rows():
    """A paragraph that names a script has a row; each bullet of the README's results too."""
    sure = (ROOT / SURE).read_text(encoding="utf-8").partition("## What has been checked")[2]
    paragraphs = [" ".join(text.split()) for text in sure.split("\n\n")]
    named = [text for text in paragraphs if re.search(r"`python -m (verification|studies)", text)]
    bullets = (ROOT / README).read_text(encoding="utf-8").partition("## How well it works")[2]
    bullets = [b for b in bullets.partition("## ")[0].split("\n") if b.startswith("- ")]
    assert len(named) > 8 and len(bullets) == 4
    said = [part.format(**row.numbers()) for row in ROWS for part in row.says]
    assert not [text for text in (*named, *bullets) if not any(part in text for part in said)]
    for part in sorted(said, key=len, reverse=True):
        named, bullets = ([text.replace(part, "") for text in texts] for texts in (named, bullets))
    measured = re.compile(r"\d (%|N|mm|processor)|\d of (the )?\d")
    assert not [text for text in (*named, *bullets) if measured.search(text)]


def test_commands_of_scripts_write_what_they_say():
    for name, script in SCRIPTS.items():
        folder = ROOT / script.folder
        for command in script.commands:
            module = command.removeprefix("python -m ").split()[0].replace(".", "/")
            path = ROOT / f"{module}.py"
            assert path.exists(), name
        assert (folder / "results").is_dir()


# ------------------------------------------------------------------ what is told of them


WRITTEN = r'reporting\.write(?:_page|_section)?\(\s*"(\w+)"'


@pytest.mark.parametrize("name", [n for n, s in SCRIPTS.items() if s.folder == "verification"])
def test_a_script_writes_the_page_that_rows_rest_on(name):
    module = re.search(r"python -m verification\.(\w+)", SCRIPTS[name].commands[0])
    assert module is not None
    source = (ROOT / "verification" / f"{module[1]}.py").read_text(encoding="utf-8")
    assert SCRIPTS[name].page in re.findall(WRITTEN, source)


def test_the_page_of_states_is_up_to_date():
    page = ROOT / "verification" / "results" / "status.md"
    written = page.read_text(encoding="utf-8")
    assert written == engine.status(ROWS, SCRIPTS), "run `python -m verification --status`"
    assert all(f"\n| {name} | " in written for name in (*NAMES, *SCRIPTS))


def test_readme_says_which_rows_stand_on_the_present_physics():
    assert engine.standing(ROWS, SCRIPTS) in (ROOT / README).read_text(encoding="utf-8")


def test_a_row_made_with_another_physics_is_told_apart(copied):
    [row] = [row for row in ROWS if row.name == "codes"]
    page = copied / "studies" / "results" / "codes.md"
    assert engine.state(row, SCRIPTS, copied) == ("holds", False)
    changed(page, f"physics {PHYSICS}.", f"physics {PHYSICS + 1}.")
    told, bad = engine.state(row, SCRIPTS, copied)
    assert f"not made with physics {PHYSICS} yet" in told and not bad
    assert engine.standing([row], SCRIPTS, copied).endswith("; codes do not yet")
    page.unlink()
    assert engine.state(row, SCRIPTS, copied) == ("no numbers yet", False)


# ------------------------------------------------------------------ faults are found

MEASURED = {  # made-up readings that hold; no output of `python -m verification.quick`
    "contact": {name: [1e-7] * 4 for name in ("linear", "hertz", "exponent_1", "capped")},
    "files": {"lab": [0.0], "curve": [0.0], "export": [0.0]},
    "small": {"H": [3.2, 3.3, 3.0, 3.4, 3.1, 3.3], "F": [180, 200, 150, 220, 190, 185]},
    "specimens": {"H": [2.7, 2.6, 2.8, 2.75], "F": [190, 200, 210, 180],
                  "dH": [0.002, 0.001, 0.003, 0.002], "dF": [-2, 5, -6, 1],
                  "energy": [0.002, 0.0024, 0.0021, 0.0019]},
    "soils": {"failed": [0.0], "changes": [0.0003, 0.002]},
    "calibration": {"inside": [1.0, 1.0], "shear_modulus": [5.6e6], "surface_energy": [19.0]},
}  # fmt: skip


def test_with_numbers_as_measured_every_row_holds():
    readings, bad = quick.judged(MEASURED)
    assert bad == {} and len(readings) > 15 and all(r.holds() for r in readings)
    assert {row for check in quick.CHECKS.values() for row in check.rows} <= set(NAMES)
    assert set(MEASURED) == set(quick.CHECKS)


@pytest.mark.parametrize(
    ("page", "column", "where", "row"),
    [
        ("convergence", "H (mm) ± scatter", {"variant": "as the preset"}, "convergence"),
        ("convergence", "energy balance", {"variant": "as the preset"}, "convergence"),
        ("convergence", "ΔH ± s.e.", {"variant": "time step halved"}, "convergence"),
        ("resolution", "H (mm)", {"beds": "usual porosity", "spheres": "150"}, "number of spheres"),
        ("convergence", "failed", {"spheres": "500"}, "any plausible soil"),
        ("recovery", "fitted", {"under": re.compile("two"), "start": "base soil",
                                "parameter": "shear_modulus"}, "recovery"),
        ("reliability", "traceback or other status", {"file": "lab"}, "malformed files"),
        ("fresh_packings", "error", {"soil": "trumao", "observable": "crushing force (N)"},
         "fresh packings, one by one"),
        ("fresh_packings", "error", {"test": "confined"}, "whole curves"),
    ],
)  # fmt: skip
def test_a_stored_number_that_is_changed_is_named(copied, page, column, where, row):
    """Also where no sentence repeats it: then the smaller form contradicts."""
    path = Cell(page).path(copied)
    before = Cell(page, column, where).read(copied)
    lines = path.read_text(encoding="utf-8").splitlines()
    plain = [value for value in where.values() if isinstance(value, str)]
    for number, line in enumerate(lines):
        cells = line.split("|")
        header = next((h for h in lines[number::-1] if f" {column} " in h), "").split("|")
        place = [k for k, cell in enumerate(header) if cell.strip() == column]
        if place and len(cells) == len(header) and all(f"| {v} |" in line for v in plain):
            new = f"{3 * before + 1:.6g}"
            cells[place[0]] = re.sub(reporting.NUMBER, new, cells[place[0]], count=1)
            lines[number] = "|".join(cells)
            break
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert Cell(page, column, where).read(copied) != before
    _, bad = quick.judged(MEASURED, copied)
    assert row in bad


def test_a_measurement_that_differs_is_named():
    worse = MEASURED | {"contact": MEASURED["contact"] | {"hertz": [1e-4] * 4}}
    _, bad = quick.judged(worse)
    assert list(bad) == ["one contact in LIGGGHTS"]


def test_a_missing_page_is_named(copied):
    Cell("convergence").path(copied).unlink()
    _, bad = quick.judged(MEASURED, copied)
    assert set(bad) == {"any plausible soil", "convergence", "number of spheres"}
    assert all("missing" in why for why in bad.values())


def test_quick_says_what_fails_and_exits_with_1(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["quick", "--only", "contact"])
    monkeypatch.setattr(reporting, "configure", lambda *given: None)
    monkeypatch.setitem(
        quick.CHECKS, "contact",
        replace(quick.CHECKS["contact"], measure=lambda folder: {"linear": [1.0] * 4}),
    )  # fmt: skip
    with pytest.raises(SystemExit) as end:
        quick.main()
    printed = capsys.readouterr().out
    assert end.value.code == 1 and "DOES NOT HOLD: one contact in LIGGGHTS" in printed
    assert "not measured here" in printed and "whole curves: about" in printed


@pytest.mark.slow
def test_one_contact_is_measured_and_holds(tmp_path):
    found = {"contact": quick.contact(tmp_path)}
    readings, bad = quick.judged(found)
    assert not bad and len(readings) == 4
    assert max(r.now for r in readings) > 0.0


# ------------------------------------------------------------------ made again


def page_of(physics) -> str:
    table = reporting.table(("what", "number"), [["one", "2.5 ± 0.1"]])
    made = f"Made on 2026-11-29 by `python -m verification.one` on 2 cores; physics {physics}."
    return f"# One\n\n{table}\n{made}\n"


@pytest.fixture
def two(tmp_path):
    """Two scripts, the dearer first, what runs them, and what was run; one was made before."""
    scripts = {
        "dear": Script(("python -m verification.dear",), 9, "dear"),
        "cheap": Script(("python -m verification.cheap --all", "python -m verification.cheap"), 1,
                        "cheap"),
    }  # fmt: skip
    called: list[str] = []
    (tmp_path / "verification" / "results").mkdir(parents=True)
    Cell("dear").path(tmp_path).write_text(page_of("before 1, engine 0"), encoding="utf-8")

    def run(command: str) -> int:
        called.append(command)
        page = command.rpartition(".")[2].split()[0]
        Cell(page).path(tmp_path).write_text(page_of(PHYSICS), encoding="utf-8")
        return 0

    return scripts, run, called


@pytest.fixture(autouse=True)
def no_status(monkeypatch):
    monkeypatch.setattr(engine, "write_status", lambda root: None)


def test_the_cheapest_is_made_first_and_nothing_twice(two, tmp_path, capsys):
    scripts, run, called = two
    became = engine.made(scripts, list(scripts), 100, False, tmp_path, run)
    assert called == [*scripts["cheap"].commands, *scripts["dear"].commands]
    assert became == {"cheap": "made", "dear": "made"}
    assert "1 of 2: cheap, about 1 processor minutes" in capsys.readouterr().out
    again = engine.made(scripts, list(scripts), 100, False, tmp_path, run)
    assert len(called) == 3 and set(again.values()) == {"up to date"}
    engine.made(scripts, ["dear"], 100, True, tmp_path, run)
    assert called[3:] == list(scripts["dear"].commands)


def test_a_script_that_is_stopped_is_begun_again_and_the_others_are_not(two, tmp_path):
    scripts, run, called = two

    def killed(command: str) -> int:
        if "dear" in command:
            raise KeyboardInterrupt
        return run(command)

    with pytest.raises(KeyboardInterrupt):
        engine.made(scripts, list(scripts), 100, False, tmp_path, killed)
    engine.made(scripts, list(scripts), 100, False, tmp_path, run)
    assert called == [*scripts["cheap"].commands, *scripts["dear"].commands]


def test_a_script_that_fails_is_told_and_the_others_run(two, tmp_path):
    scripts, run, called = two
    became = engine.made(
        scripts, list(scripts), 100, False, tmp_path, lambda c: "cheap" in c or run(c)
    )
    assert became["cheap"] == "failed: python -m verification.cheap --all"
    assert became["dear"] == "made" and len(called) == 1


def test_what_is_dear_or_lacks_a_program_is_left(two, tmp_path):
    scripts, run, called = two
    scripts["cheap"] = replace(scripts["cheap"], needs=("no_such_program",))
    became = engine.made(scripts, list(scripts), 5, False, tmp_path, run)
    assert not called
    assert became == {"dear": "left: takes 9 processor minutes", "cheap": "needs no_such_program"}


# ------------------------------------------------------------------ result pages


def test_cells_of_pages(tmp_path):
    path = Cell("one").path(tmp_path)
    path.parent.mkdir(parents=True)
    path.write_text(page_of(3) + "\n# Two\n\n- value 7\n", encoding="utf-8")
    cell = Cell("one", "number", {"what": "one"})
    assert cell.read(tmp_path) == 2.5
    assert replace(cell, part=1).read(tmp_path) == 0.1
    assert replace(cell, where={"under": re.compile("O")}).read(tmp_path) == 2.5
    assert Cell("one", line=r"value (\d)").read(tmp_path) == 7
    for wrong in (replace(cell, column="other"), replace(cell, where={"what": "two"})):
        with pytest.raises(LookupError, match=r"one\.md has no"):
            wrong.read(tmp_path)
    assert reporting.origin_of(path, "One") == reporting.Origin(
        "python -m verification.one", "3", "2026-11-29"
    )
    assert reporting.origin_of(path, "Two") is reporting.origin_of(path, "Three") is None


def test_a_section_is_replaced_and_the_others_stay(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reporting, "RESULTS", tmp_path)
    for text in ("# A\n\n1\n", "# B\n\n2\n", "# A\n\n3\n"):
        reporting.write_section("page", text)
    assert (tmp_path / "page.md").read_text("utf-8") == "# A\n\n3\n\n# B\n\n2\n"


def test_footers_have_command_day_and_physics():
    origin = reporting.provenance()
    [found] = re.findall(reporting.MADE, reporting.footer(origin))
    assert found == (origin["date"], origin["command"], str(PHYSICS))


def test_runs_beside_a_soil_mend_a_slope_that_is_wrong():
    """A library that is off by 2 % and says so; runs at soils beside show by how much."""
    rng, truth, names = np.random.default_rng(0), np.array([0.3, -0.2]), 2
    centre = np.zeros(names)
    space = SimpleNamespace(log_bounds=lambda: (centre - 1, centre + 1))
    logs = np.log(beside.beside(space, centre, 32))  # pyright: ignore[reportArgumentType]
    assert np.abs(logs).max() <= beside.REACH
    own, distance, noise = 0.2, np.full(names, 1.5), 1e-3
    apart = logs @ truth + noise * rng.normal(size=len(logs))
    alike = np.exp(-0.5 * (((logs[:, None] - logs) / distance) ** 2).sum(axis=2))
    inverse = np.linalg.inv(own**2 * alike + noise**2 * np.eye(len(logs)))
    arrays = (logs, distance, (own * inverse @ apart)[None], (own**2 * inverse)[None])
    density = SimpleNamespace(
        runs=FromRuns(*map(jnp.asarray, arrays)),
        features=lambda values: jnp.ones(1),
        error=lambda logs: jnp.full((1, 1), own),
    )
    density.shown = lambda values: (
        jnp.exp(own * density.runs(jnp.log(values))[0]),
        jnp.ones((1, 1)),
    )
    slopes, errors = beside.slopes_of(density, centre)  # pyright: ignore[reportArgumentType]
    assert np.all(errors < 0.1 * own / distance)
    np.testing.assert_allclose(slopes[0], truth, atol=3 * errors.max() + 0.01)
    assert all(len(soil["rows"]) > 3 for soil in beside.references())


@pytest.mark.slow
def test_a_plate_is_as_hard_as_another_code_says(tmp_path):
    """On two of the six beds; a time step that forgot how many dashpots a sphere has gave half."""
    found = [reference_beds.simulated("plate", 1, bed, 1.0, tmp_path)["plate"] for bed in (1, 2)]
    ratio = sum(found) / reference_beds.data()["plate_1"][:2].sum()
    assert 0.8 < ratio < 1.6


def test_lines_through_peaks_of_boxes_and_of_biaxial_tests_say_the_same_of_a_soil():
    """Of tau = c + sigma tan(phi), where sigma_1 = 2 c sqrt(K) + K sigma_3 as well."""
    c, phi = 20.0, np.radians(40.0)
    passive = (1 + np.sin(phi)) / (1 - np.sin(phi))
    boxes = [{"plane": s, "peak_shear": c + s * np.tan(phi)} for s in (15.0, 28.0, 55.0)]
    planes = {
        f"{low:g}": {"vertical": 1.1 * low, "peak": 2e3 * c * passive**0.5 / (1.1 * low) + passive}
        for low in shear_boxes.STRESSES
    }
    strength = 2 * c * passive**0.5
    assert shear_boxes.mohr_coulomb(boxes) == pytest.approx((c, phi, strength))
    points, *said = shear_boxes.of_planes(planes)
    assert said == pytest.approx([strength, c, phi])
    assert points[0][0] == pytest.approx(1.1e-3 * shear_boxes.STRESSES[0])


def test_an_interval_of_a_test_that_took_no_part_is_of_one_specimen():
    """t of two degrees of freedom, 2.92, times sd sqrt(1 + 1/3); a run without numbers is left."""
    rows = [{"f": value} for value in (9.0, 10.0, 11.0)] + [{}]
    found = other_tests.compared(rows, [{"f": 13.0}, {"f": 13.5}])["f"]
    assert found["measured"]["half_width"] == pytest.approx(2.92 * (4 / 3) ** 0.5, rel=1e-3)
    assert (found["soils"], found["measured"]["holds"]) == (3, True)
    assert other_tests.compared(rows[:1] + rows[3:], [{"f": 9.0}]) == {}
