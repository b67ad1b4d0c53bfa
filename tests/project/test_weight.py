"""A checkout stays light, no file edits sys.path, and tests need nothing of benchmarks."""

import ast
import re
import subprocess
from pathlib import Path

import pytest

from tests import ROOT

FOLDER = "benchmarks"
FILES, BYTES = 700, 15_000_000
BLOCK = 4096  # bytes; what the smallest file takes
READS = re.compile(rf"(^|.*/){FOLDER}(/\S*)?")  # as a whole: a path, not words that name one


def tracked() -> list[Path]:
    """The files of the checkout that git knows; skips where this is none."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z"]
    if not (ROOT / ".git").exists():
        pytest.skip("no git checkout")
    try:
        listed = subprocess.run(command, capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("git is missing or refuses")
    paths = (ROOT / name for name in listed.stdout.decode().split("\0") if name)
    return [path for path in paths if path.is_file()]


def test_a_checkout_is_light():
    files = tracked()
    on_disk = sum(-(-path.stat().st_size // BLOCK) * BLOCK for path in files)
    assert len(files) <= FILES
    assert on_disk <= BYTES


def in_benchmarks() -> set[str]:
    """Names under which what is in the folder could be imported."""
    files = {path.stem for path in (ROOT / FOLDER).rglob("*.py")}
    return {FOLDER, *files} - {path.stem for path in (ROOT / "tests").rglob("*.py")}


def needs(source: str, theirs: set[str]) -> list[str]:
    """What a file imports from benchmarks, and strings that are paths into them."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in theirs]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found += [node.module] if str(node.module).split(".")[0] in theirs else []
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found += [node.value] if READS.fullmatch(node.value) else []
    return found


def test_no_test_needs_benchmarks():
    files = sorted((ROOT / "tests").rglob("*.py"))
    theirs = in_benchmarks()
    assert len(files) > 60
    found = {path.name: needs(path.read_text(encoding="utf-8"), theirs) for path in files}
    for rules in (Path(__file__).name, "test_architecture.py"):  # these name the folder
        found.pop(rules)
    assert {name: words for name, words in found.items() if words} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import reporting",
        "from benchmarks.kills import low_lab",
        "import benchmarks.kills as kills",
        'sys.path.append(str(ROOT / "benchmarks"))',
        'Path("../benchmarks/results").exists()',
    ],
)
def test_the_rule_catches(source):
    assert len(needs(source, {"benchmarks", "reporting"})) == 1


def test_the_rule_lets_words_pass():
    assert not needs('import numpy\nmessage = "run `python benchmarks/beds.py`"', {"benchmarks"})


def edits_path(source: str) -> bool:
    """Whether a file uses `sys.path`: what it imports would depend on what ran before."""
    return any(
        isinstance(node, ast.Attribute) and ast.unparse(node) == "sys.path"
        for node in ast.walk(ast.parse(source))
    )


def test_no_file_edits_the_path_of_imports():
    files = [path for path in tracked() if path.suffix == ".py"]
    assert len(files) > 400
    assert not [path for path in files if edits_path(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("source", ['sys.path.insert(0, "tests")', "sys.path += [folder]"])
def test_an_edit_of_the_path_is_caught(source):
    assert edits_path(source) and not edits_path("import sys\nplace = f'{sys.argv[0]}'")
