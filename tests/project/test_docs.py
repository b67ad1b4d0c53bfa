"""What the documentation says exists: links, commands, options, paths, names, examples that run.

Pages keep their lengths and their words, and every page has its place in the site.  Nothing here
needs the site's generator.
"""

import ast
import json
import re
import shlex
import shutil
import sys
from collections.abc import Iterable, Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

from calibrate import cli
from calibrate.inference.evaluation import Calibration
from calibrate.inference.parameters import space
from calibrate.inference.problem import Problem
from calibrate.inference.sampling import Plan, sampled
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import with_values
from calibrate.labtests.base import Pace
from calibrate.labtests.features import ScalarTarget
from calibrate.labtests.measured import Cylinder
from calibrate.reports.effects import PLAIN
from calibrate.verbs import VERBS
from calibrate.verbs.command import command_of
from tests import ROOT
from tests.support import toy_library
from tests.support.formulas import BASE, in_place_of_spheres, specimen

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
CODE = re.compile(r"^ *```.*?^ *```|^ {4}.*?$|`[^`]*`", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^( *)```(\w+)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
HISTORY = ("docs/decisions.md", "docs/decisions/", "CHANGELOG.md")  # pages that tell what was
LONGEST = 1500  # words of a page
LONGEST_README = 1000
PATH = re.compile(
    r"(?<![\w/.-])((?:jdem|calibrate|studies|benchmarks|verification|tests|notebooks)/[\w./-]*\w)"
)
# Words that only this project used, and what the field says.
PRIVATE = {
    r"banks?": "library of runs",
    r"opinions?": "probability calibration",
    r"nearby": "infill runs",
    r"kin": "blocks",
    r"twins?": "blocks",
    r"mismatch": "model discrepancy",
    r"left[-_]out": "cross-validation",
    r"late readings?": "load-cell lag",
    r"habits?": "class bias",
    r"rehears\w+": "a simulated calibration",
    r"upkeep": "list update",
}
OF_CODE = {  # beside those of pages, words that no identifier has
    r"bench": "setup",
    r"learned": "belief",
    r"asking": "policy",
}
TELLING = (
    r"\b2\d Nov",
    r"\bcommit [0-9a-f]{7}",
    r"\bnowadays\b",
    r"\ba day earlier\b",
    r"\bno longer\b",
)


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path, language: str) -> list[str]:
    """Blocks of code in a language, without their common indentation."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [re.sub(f"^{indent}", "", code, flags=re.M) for indent, kind, code in found
            if kind == language]  # fmt: skip


def commands(page: Path) -> list[list[str]]:
    lines = "\n".join(blocks(page, "sh")).splitlines()
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == "calibrate"]


def prose(page: Path) -> str:
    """A page without its code and without the targets of its links."""
    return LINK.sub("", CODE.sub("", page.read_text(encoding="utf-8")))


def tells_history(page: Path) -> bool:
    return name_of(page).startswith(HISTORY)


NOW = [page for page in PAGES if not tells_history(page)]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        if not target.startswith(("http://", "https://", "#")):
            assert (page.parent / target.partition("#")[0]).exists(), target


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name_of)
def test_commands_and_their_options_exist(page):
    for verb, *arguments in commands(page):
        assert verb in VERBS, verb
        known = {o for p in command_of(verb).params for o in (*p.opts, *p.secondary_opts)}
        given = {word.partition("=")[0] for word in arguments if word.startswith("--")}
        assert given <= known, (verb, given - known)


# ------------------------------------------------------------------ commands, run in their order

HOURS = ("library", "discrepancy")  # small ones run in the tests of each
# need a cluster (test_cluster), a measured answer (test_next_test), more runs (test_diagnose_verb)
ELSEWHERE = {"--dask", "--further", "--simulate"}


def without_out(line: list[str]) -> str:
    """A command without the place of its results."""
    place = line.index("--out") if "--out" in line else len(line)
    return shlex.join(line[:place] + line[place + 2 :])


RUN: dict[str, list[str]] = {}  # in the order of pages, the first of each
for page in NOW:
    for line in commands(page):
        if line[0] not in HOURS and not ELSEWHERE & set(line):
            RUN.setdefault(without_out(line), line)


def export(path: Path) -> None:
    """Three specimens in the mould, a fifth stiffer than the bundled soil, by formulas."""
    stiffer = with_values(BASE, {"shear_modulus": 1.2 * float(BASE.shear_modulus)})
    rows = ["Specimen,Displacement (mm),Force (N)"]
    for number in range(1, 4):
        curve = specimen(stiffer, 900 + number).curves["confined"]
        rows += [f"{number},{way:.5f},{force:.4f}" for way, force in curve]
    path.write_text("\n".join(rows), encoding="utf-8")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs commands, with formulas in place of spheres, in a folder with what pages take for
    granted: exports, a lab file, results of earlier commands; exit status."""
    folder = tmp_path_factory.mktemp("pages")
    for place in ("calibrate/soils", "tests/data/machine_exports"):
        shutil.copytree(ROOT / place, folder / place)
    export(folder / "export.csv")
    turned = "".join(f"{angle},{0.12 * min(angle, 30) / 30}\n" for angle in range(91))
    (folder / "vane.csv").write_text(f"Angle (deg),Torque (N m)\n{turned}", encoding="utf-8")
    (folder / "path.csv").write_text("z_um,x_um\n0,0\n-10,0\n-10,5\n20,5\n", encoding="utf-8")
    shutil.copy(ROOT / "calibrate/soils/trumao_2021/oedometer.csv", folder)
    for name in ("my_soil.toml", "other_test.toml"):
        shutil.copy(bundled_lab(), folder / name)
    with pytest.MonkeyPatch.context() as monkeypatch:
        in_place_of_spheres(monkeypatch)
        toy_library.write_library(folder / "library.nc")
        monkeypatch.setattr("calibrate.discrepancy.infill.run_points", toy_library.run_points)
        few = partial(sampled, plan=Plan(chains=2, warm_up=50, draws=50, most=50, chunk=50))
        monkeypatch.setattr("calibrate.verbs.posterior.sampled", few)
        monkeypatch.setattr(cli, "_configure", lambda: None)
        monkeypatch.chdir(folder)

        def call(*words: str) -> int:
            monkeypatch.setattr(sys, "argv", ["calibrate", *words])
            try:
                cli.main()
            except SystemExit as end:
                return int(end.code or 0)
            return 0

        assert call("fit", "--out", "results/calibrate", "--json", "my_result.json") == 0
        assert call("audit", "--packings", "4", "--out", "results/audit") == 0
        shutil.copytree("results/calibrate", "results/fit")
        yield call


SMALLER = {  # a view draws spheres, not a formula; a diagnosis by the bundled library takes minutes
    "view": ["--preset", "quick", "--frames", "6"],
    "diagnose": ["--library", "library.nc"],
    "next": ["--library", "library.nc"],
}


@pytest.mark.slow
@pytest.mark.parametrize("line", list(RUN.values()), ids=shlex.join)
def test_commands_of_pages_run(run, line, capfd):
    whole = "calibrate/soils" in shlex.join(line) or "--posterior" in line
    smaller = [] if whole else SMALLER.get(line[0], [])
    assert run(*line, *smaller) == 0, capfd.readouterr().err


def test_every_verb_is_documented():
    text = "\n".join(page.read_text(encoding="utf-8") for page in NOW)
    missing = {verb for verb in VERBS if not re.search(rf"calibrate {verb}\b", text)}
    assert not missing


def test_targets_of_make_exist():
    made = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for page in PAGES:
        asked = set(re.findall(r"`make (\w+)`|^make (\w+)", page.read_text("utf-8"), re.MULTILINE))
        assert {a or b for a, b in asked} <= set(made), page


@pytest.mark.parametrize("page", NOW, ids=name_of)
def test_paths_exist(page):
    for path in PATH.findall(page.read_text(encoding="utf-8")):
        assert (ROOT / path).exists() or path.isupper() or "NAME" in path, path


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_pages_are_short(page):
    longest = LONGEST_README if page == ROOT / "README.md" else LONGEST
    assert len(page.read_text(encoding="utf-8").split()) <= longest


@pytest.mark.parametrize("page", NOW, ids=name_of)
def test_pages_speak_the_fields_language(page):
    text = prose(page)
    for word, better in PRIVATE.items():
        found = re.search(rf"\b{word}\b", text, re.IGNORECASE)
        assert not found, f"{found and found[0]}: write {better}"


def identifiers(source: str) -> Iterator[str]:
    """Names that a file gives: classes, functions, arguments and variables."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def banned_in(names: Iterable[str]) -> list[str]:
    """Names with a banned word, CapWords and under_scores being read as words."""
    words = re.compile("|".join(rf"\b{word}\b" for word in {**PRIVATE, **OF_CODE}), re.IGNORECASE)
    between = re.compile(r"(?<=[a-z])(?=[A-Z])|_")
    return [n for n in names if any(words.search(between.sub(gap, n)) for gap in " -")]


@pytest.mark.parametrize("package", ["calibrate", "jdem"])
def test_identifiers_use_the_words_of_pages(package):
    """A word that pages may not have, no file, class, function, argument or variable has."""
    files = sorted((ROOT / package).rglob("*.py"))
    found = {path.name: banned_in([path.stem, *identifiers(path.read_text())]) for path in files}
    assert {name: banned for name, banned in found.items() if banned} == {}


def test_the_rule_on_identifiers_catches():
    source = "class BenchTop: ...\ndef left_out(twin):\n    upkeep = 1\n"
    assert banned_in(identifiers(source)) == ["BenchTop", "left_out", "twin", "upkeep"]
    assert banned_in(["benchmark", "kind", "banking"]) == []


@pytest.mark.parametrize("page", NOW, ids=name_of)
def test_pages_tell_no_history(page):
    text = page.read_text(encoding="utf-8")
    assert not [found[0] for sign in TELLING if (found := re.search(sign, text))]


# ------------------------------------------------------------------ the site


def leaves(nav: Any) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    entries = nav.values() if isinstance(nav, dict) else nav
    return [leaf for entry in entries for leaf in leaves(entry)]


def test_every_page_has_its_place_in_the_site():
    """Pages of docs/ are in the navigation; what is there and not in docs/ is made."""
    nav = leaves(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    made = ("reference/", "tutorials/", "results/", "changelog.md", "contributing.md")
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    assert pages - {"json.md"} == {leaf for leaf in nav if not leaf.startswith(made)}
    books = {f"tutorials/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert books == {leaf for leaf in nav if leaf.startswith("tutorials/")}


def test_what_is_left_out_of_the_site_is_named_from_its_root():
    """A bare name would leave out a made page of the same name in any folder."""
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    assert all(line.startswith("/") for line in config["exclude_docs"].split())


def test_the_page_of_the_lab_file_has_every_entry():
    import lab_file_page

    text = lab_file_page.page()
    for path, model in lab_file_page.tables():
        names = [field.alias or name for name, field in model.model_fields.items()]
        assert all(f"| `{name}` |" in text for name in names), path
    fields = [f for _, m in lab_file_page.tables() for f in m.model_fields.items()]
    units = {name: lab_file_page.kind_of(field) for name, field in fields}
    assert units["diameter"].unit == "m" and units["force_low"].unit == "N"


def test_the_page_of_parameters_has_the_catalogue():
    import lab_file_page

    page = (ROOT / "docs" / "parameters.md").read_text(encoding="utf-8")
    rows, known = lab_file_page.catalogue_rows(), page.splitlines()
    assert len(rows) > 12 and not [row for row in rows if row not in known]


def test_meanings_on_the_page_of_the_lab_file_are_of_entries_that_exist():
    import lab_file_page

    known = {
        f"{kind.__name__}.{name}"
        for _, model in lab_file_page.tables()
        for kind in model.__mro__
        for name in getattr(kind, "model_fields", {})
    }
    assert set(lab_file_page.MEANING) <= known


def test_what_pages_call_effects_is_documented():
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert all(f"| {name} | {plain.name} |" in page for name, plain in PLAIN.items())


def test_the_page_of_commands_has_every_verb_and_option():
    import commands_page

    text = commands_page.page()
    assert set(re.findall(r"^## (\S+)", text, re.MULTILINE)) == set(VERBS)
    assert "`--preset`" in text and "`[LAB.toml]`" in text


def test_the_page_of_json_keys_has_the_keys_of_a_fit():
    import json_page

    text = json_page.page()
    given = json.loads((ROOT / "tests/data/fit_result/result.json").read_text(encoding="utf-8"))
    kind = json_page.records()["fit"]
    assert all(f"| `{key}` |" in text for key in kind.model_fields)
    assert all(f"`{key}`" in text for key in given)


def strings(node: ast.AST) -> str:
    """A string of a program without what is filled in; "" of anything else."""
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    return "".join(str(p.value) for p in parts if isinstance(p, ast.Constant))


def test_messages_on_the_page_of_failures_are_those_of_the_program():
    page = (ROOT / "docs" / "howto" / "when-it-fails.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| ")]
    messages = [text for row in rows for text in re.findall(r"`([^`]+)`", row)]
    files = [p for name in OURS for p in (ROOT / name).rglob("*.py")]
    nodes = [n for p in files for n in ast.walk(ast.parse(p.read_text(encoding="utf-8")))]
    known = "\n".join(map(strings, nodes))
    parts = [part.strip() for text in messages for part in text.split("...")]
    assert len(messages) > 60 and not [part for part in parts if part not in known]


OURS = ("jdem", "calibrate")


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name_of)
def test_names_in_examples_exist(page):
    """Ours; a page may show a library that only a cluster needs."""
    for code in blocks(page, "python"):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith(OURS):
                module = import_module(str(node.module))
                for alias in node.names:
                    assert hasattr(module, alias.name) or import_module(
                        f"{node.module}.{alias.name}"
                    )


# ------------------------------------------------------------------ examples of the how-to pages


@pytest.fixture(scope="module")
def examples() -> dict[str, type]:
    """Everything that the examples define, each run as a module of its own."""
    found: dict[str, type] = {}
    pages = [*sorted((ROOT / "docs" / "howto").glob("add-*.md")), ROOT / "docs" / "walk.md"]
    for number, code in enumerate(code for page in pages for code in blocks(page, "python")):
        names: dict = {"__name__": f"example_{number}"}
        exec(compile(code, names["__name__"], "exec"), names)
        found.update(names)
    return found


def test_the_law_is_a_rolling_law(examples):
    from jdem.mechanics.contact import NormalForce

    law = examples["AdhesiveRolling"](0.1)
    normal = NormalForce(jnp.asarray(2.0), jnp.asarray(0.0), jnp.asarray(5.0))
    assert float(law.limit(normal)) == pytest.approx(0.5)


def test_the_effect_is_nothing_at_strength_0(examples):
    effect = examples["LoadCellBend"]
    reading = jnp.array([0.0, 200.0, 400.0])
    assert not np.any(effect(0.0).force_error(reading, reading))
    np.testing.assert_allclose(effect(1e-5).force_error(reading, reading), [0, 0.4, 1.6])


def test_the_test_states_its_movements(examples):
    stated = examples["Relaxation"](force="80 N")
    test = stated.apparatus(Cylinder(0.05, 0.1), Pace(0.05, 0.05, 1e-3))
    loading, holding = test.movements()
    assert test.names == ("load", "hold")
    assert float(loading.segment.force_target) == 80.0
    assert float(holding.segment.platen_speed) == 0.0
    assert float(holding.time_scale * holding.segment.duration) == pytest.approx(60.0)


def test_the_strategy_finds_the_slopes_of_a_plane(examples):
    slopes = jnp.array([[1.0, -2.0], [0.5, 3.0]])

    def response(points):
        return points @ slopes.T + jnp.arange(points.shape[1])[None, :, None]

    strategy = examples["OneSided"]()
    found = strategy(response, jnp.array([0.3, -0.1]), 3)
    np.testing.assert_allclose(found.slopes, slopes, rtol=1e-6)
    assert found.values.shape == (3, 2)
    assert strategy.runs(2, 3) == 3 and eqx.is_array(found.standard_error)


def test_the_rule_stops_at_its_cost(examples):
    def state(cost):
        return SimpleNamespace(best=SimpleNamespace(cost=cost))

    assert examples["good_enough"](state(2.5)) == ""
    assert [rule(state(1.5)) for rule in examples["settings"].stopping[:1]] == [
        "the cost is below 2"
    ]
    assert len(examples["settings"].stopping) == 7


def test_the_density_of_a_straight_response_is_highest_where_it_meets_data_and_prior(examples):
    """One number and one parameter of prior deviation s: with slope b = d/s, d the deviation of
    the number, half way to the data."""
    free = space(load_lab(bundled_lab()), ("shear_modulus",))
    (prior,) = free.prior_sd()
    problem = Problem((ScalarTarget("depth", "mm", ""),), np.ones(1), np.array([0.04]), np.zeros(1))
    work: Any = None
    case = Calibration(problem, free, work, range(3), np.zeros((1, 1)), 8)
    density = examples["straight"](case, jnp.array([0.6]), jnp.array([[0.2 / prior]]))
    best = jnp.log(free.start()) + 1.0 * prior
    np.testing.assert_allclose(jax.grad(density)(best), 0.0, atol=1e-9)


def test_the_step_of_the_diagnosis_shares_out_a_residual(examples):
    from calibrate.discrepancy.comparison.projection import Projected

    fields = Projected.__dataclass_fields__
    given = {"residual": np.array([3.0, 4.0]), "effects": np.eye(2)}
    design = Projected(**{name: given.get(name) for name in fields})
    np.testing.assert_allclose(examples["shares"](design).share, [9 / 25, 16 / 25])
