"""Notebooks and scripts, which nothing else executes: they run, and are as they should be.

Every notebook is executed, every cell of it, in a quick form (JDEM_NOTEBOOK_QUICK: few spheres) and
in a copy of its folder, so that nothing it writes lands in the repository.  Every script says what
it is, takes the command lines that pages and its own head give, and some run to the end with
formulas in place of spheres.
"""

import argparse
import contextlib
import importlib.util
import json
import re
import runpy
import shlex
import shutil
import sys
from pathlib import Path

import nbformat
import pytest
import typer

from calibrate import cli
from tests import ROOT
from tests.support.formulas import in_place_of_spheres
from verification import reporting

pytestmark = pytest.mark.thorough

FOLDER = ROOT / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
PROSE = (0.4, 0.7)  # of the words
CODE_LINES = (30, 190)
ABSOLUTE_PATH = re.compile(r"(?<![\w.:/])/(?:home|root|work|tmp|usr|opt|var|Users)/|[A-Z]:\\\\")

_spec = importlib.util.spec_from_file_location("execute", FOLDER / "execute.py")
assert _spec and _spec.loader
execute = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(execute)


def cells(path: Path, kind: str) -> list:
    return [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == kind]


def sources(path: Path, kind: str) -> str:
    return "\n".join(cell.source for cell in cells(path, kind))


def outputs(path: Path) -> list:
    return [output for cell in cells(path, "code") for output in cell.outputs]


COMPILING = ("07_posterior_and_prediction",)  # pages whose programs hardly run
FEW_DRAWS = """
from functools import partial
from calibrate.inference import draws, sampling
from calibrate.verbs import posterior

plan = sampling.Plan(chains=2, warm_up=50, draws=100, most=100, chunk=50)
posterior.sampled = partial(sampling.sampled, plan=plan)
draws.RHAT, draws.ESS = 10.0, 0.0  # so few do not mix
"""  # what every kernel begins with


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A folder beside copies of what notebooks read, with one cache of compiled programs."""
    shutil.copytree(FOLDER / "data", tmp_path / "notebooks" / "data")
    startup = tmp_path / "ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "few_draws.py").write_text(FEW_DRAWS)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    monkeypatch.setenv("JDEM_NOTEBOOK_QUICK", "1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(ROOT / ".jax_cache"))
    return tmp_path / "notebooks"


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 6


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_runs(path, copied, monkeypatch):
    if path.stem in COMPILING:
        monkeypatch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    done = execute.executed(path, copied)
    assert all(cell.execution_count for cell in done.cells if cell.cell_type == "code")


@pytest.mark.slow
def test_a_notebook_that_fails_is_named_and_stays_as_it_was(tmp_path, monkeypatch, capsys):
    """The others are run all the same."""
    made = {"fails": "assert 1 > 2, 'one is more than two'", "runs": "print(6 * 7)"}
    for name, code in made.items():
        book = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(code)])
        nbformat.write(book, tmp_path / f"{name}.ipynb")
    paths = [tmp_path / f"{name}.ipynb" for name in made]
    before = paths[0].read_bytes()
    monkeypatch.setattr(sys, "argv", ["execute.py", *map(str, paths)])
    with pytest.raises(SystemExit, match=r"fails\.ipynb"):
        execute.main()
    assert paths[0].read_bytes() == before and "one is more than two" in capsys.readouterr().out
    assert outputs(paths[1])[0].text == "42\n"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
class TestCommitted:
    def test_it_is_half_prose(self, path):
        prose, code = (len(sources(path, kind).split()) for kind in ("markdown", "code"))
        assert PROSE[0] <= prose / (prose + code) <= PROSE[1]

    def test_its_code_is_neither_long_nor_missing(self, path):
        lines = [line for line in sources(path, "code").splitlines() if line.strip()]
        assert CODE_LINES[0] <= len(lines) <= CODE_LINES[1]

    def test_it_ends_with_a_check(self, path):
        assert "assert " in cells(path, "code")[-1].source
        assert "## Check" in sources(path, "markdown")

    def test_every_cell_that_computes_asserts_what_the_page_says_of_it(self, path):
        claims = [cell.source.count("assert ") for cell in cells(path, "code")]
        assert sum(claims) >= 8 and sum(count > 0 for count in claims) >= len(claims) / 2

    def test_it_shows_figures_and_no_errors(self, path):
        shown = outputs(path)
        assert any("image/png" in output.get("data", {}) for output in shown)
        assert not any(output.output_type == "error" for output in shown)
        counts = [cell.execution_count for cell in cells(path, "code")]
        assert counts == list(range(1, len(counts) + 1))

    def test_it_names_no_machine(self, path):
        texts = [output for output in outputs(path) if "image/png" not in output.get("data", {})]
        assert not ABSOLUTE_PATH.search(json.dumps(texts))
        notebook = nbformat.read(path, 4)
        assert notebook.metadata == execute.METADATA
        assert not any(cell.metadata for cell in notebook.cells)


# ------------------------------------------------------------------ scripts

MAIN = re.compile(r'^if __name__ == "__main__":', re.MULTILINE)
# have tests of their own, make data or pages, or are called by LIGGGHTS
APART = ("calibrate/", "jdem/", "docs/", "build/", "tests/data/", "studies/liggghts/referee")
MODULES = ("studies", "verification")  # folders whose files run as `python -m`
BY_MODULE = (*MODULES, "tests")  # packages that are not installed


def is_script(path: Path) -> bool:
    inside = path.relative_to(ROOT).with_suffix("").as_posix()
    if inside.startswith((".", *APART)):
        return False
    return bool(MAIN.search(path.read_text(encoding="utf-8")))


def called(path: Path) -> str:
    """What `python` is given to run a script: its path, or the name of a module."""
    place = path.relative_to(ROOT)
    if place.parts[0] not in BY_MODULE:
        return place.as_posix()
    return "-m " + ".".join(place.with_suffix("").parts).removesuffix(".__main__")


SCRIPTS = {called(path): path for path in sorted(ROOT.rglob("*.py")) if is_script(path)}
PAGES = [
    *ROOT.glob("*.md"),
    *(ROOT / "docs").rglob("*.md"),
    *ROOT.glob("bench*/**/*.md"),
    *(page for name in MODULES for page in (ROOT / name).rglob("*.md")),
]
CALLED = rf"[\w/]+/\w+\.py|-m (?:{'|'.join(BY_MODULE)})\.[a-z][\w.]*\w"
ON_PAGES = re.compile(rf"python ((?:{CALLED})[^`\n#|*]*)")
WORDS, MORE = r"(?: \S+)*", r"(?:\n {8,}[-\[]\S+(?: \S+)*)*"  # of a line, of those that go on
IN_HEADS = re.compile(rf"^    python ((?:{CALLED}){WORDS}{MORE})", re.MULTILINE)


def command_lines() -> list[str]:
    """Every command of a script that a page or a script's own head gives."""
    found = {line for page in PAGES for line in ON_PAGES.findall(page.read_text(encoding="utf-8"))}
    for path in SCRIPTS.values():
        found |= set(IN_HEADS.findall(path.read_text(encoding="utf-8")))
    return sorted({" ".join(re.sub(r"[][]", "", line).split()) for line in found})


@pytest.fixture
def script(monkeypatch, tmp_path):
    """Runs a script of the repository in tmp_path as `python` does, in this process."""
    before = set(sys.modules)

    def call(line: str) -> dict:
        words = shlex.split(line)
        count = 2 if words[0] == "-m" else 1
        name, arguments = " ".join(words[:count]), words[count:]
        path = SCRIPTS[name]
        monkeypatch.chdir(tmp_path)
        if count == 1:
            monkeypatch.syspath_prepend(path.parent)
        monkeypatch.setattr(sys, "argv", [str(path), *arguments])
        monkeypatch.setattr(cli, "_configure", lambda: None)
        return runpy.run_path(str(path), run_name="__main__")

    yield call
    for name in set(sys.modules) - before:  # a sibling of one script is no module of another
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(ROOT / "bench")):
            del sys.modules[name]


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_starts_and_says_what_it_is(script, name, capsys, tmp_path):
    with pytest.raises(SystemExit) as end:
        script(f"{name} --help")
        raise SystemExit(0)  # a program of typer's returns
    assert end.value.code == 0
    assert len(capsys.readouterr().out.split()) > 10
    assert not list(tmp_path.iterdir())


class UnderstoodError(Exception):
    """A command line was taken; nothing is to be begun."""


@pytest.mark.parametrize("line", command_lines())
def test_a_script_takes_the_command_lines_of_pages(script, line, monkeypatch):
    read = argparse.ArgumentParser.parse_args

    def only_read(*arguments, **named):
        read(*arguments, **named)
        raise UnderstoodError

    def only_parsed(program, name, arguments):
        typer.main.get_command(program).make_context(name, list(arguments))
        raise UnderstoodError

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", only_read)
    monkeypatch.setattr(cli, "run", only_parsed)
    with pytest.raises(UnderstoodError):
        script(line)


SMALL = (  # whole runs, where simulating is all that they would take long for
    "audit --spheres 48 --packings 4 --seeds 21 --folder runs",
    "calibration --folder runs",
    "convergence --packings 3 --folder runs",
    "designs --folder runs",
    "fuzz --refused 2 --processes 0",
    "prior --soils 4 --folder runs",
    "recovery --case two --start 'base soil' --folder runs",
    "resolution --most 500 --folder runs",
)


@pytest.mark.slow
@pytest.mark.parametrize("line", SMALL, ids=lambda line: line.partition(" ")[0])
def test_a_script_runs_to_its_end(script, line, monkeypatch, tmp_path):
    """On formulas; its page lands in tmp_path."""
    in_place_of_spheres(monkeypatch)
    monkeypatch.setattr(reporting, "configure", lambda *given: None)
    for place in ("RESULTS", "OF_NOTEBOOKS", "IMAGES"):
        monkeypatch.setattr(reporting, place, tmp_path)
    with contextlib.suppress(SystemExit):
        script(f"-m verification.{line}")
    [page] = tmp_path.glob("*.md")
    name = line.partition(" ")[0]
    sections = {"fuzz": "reliability", "prior": "convergence", "calibration": "designs"}
    assert page.stem == sections.get(name, name)
    assert "| --- |" in page.read_text(encoding="utf-8")
