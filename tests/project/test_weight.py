"""A checkout stays light, tests need nothing of benchmarks, and wheel and sdist work alone."""

import ast
import re
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests import ROOT

FOLDER = "benchmarks"
FILES, BYTES = 720, 15_000_000
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


USE = """
import calibrate, jdem, sys

assert "checkout" not in calibrate.__file__ and sys.argv[1] not in calibrate.__file__
loop = calibrate.contact([20, 2, 32, -28], out="contact")
lab = calibrate.load_lab(calibrate.bundled_lab())
found = calibrate.diagnose(calibrate.bundled_lab("trumao_curves"), out="diagnosed")
page = calibrate.report(found)
print(loop.normal_force_n.max(), lab.name, found.verdict, page.path, len(jdem.__all__), sep="\\n")
"""


def run(*command: object, where: Path) -> str:
    done = subprocess.run(list(map(str, command)), cwd=where, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with wheel and sdist."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "hatchling", "build", "-d", folder, where=ROOT)
    return folder


@pytest.fixture(scope="module")
def python(built, tmp_path_factory) -> Path:
    """The interpreter of an environment that holds the wheel, and sees what it depends on."""
    place = tmp_path_factory.mktemp("environment")
    venv.create(place, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(place)}))
    own.joinpath("dependencies.pth").write_text(sysconfig.get_path("purelib"))
    wheel = next(built.glob("*.whl"))
    run(sys.executable, "-m", "pip", "install", "--no-deps", "--target", own, wheel, where=place)
    return place / "bin" / "python"


@pytest.mark.slow
def test_the_wheel_works_by_its_public_names(python, tmp_path):
    said = run(python, "-c", USE, ROOT, where=tmp_path).split("\n")
    assert float(said[0]) > 0.1 and said[1].startswith("wheat after rice")
    assert Path(said[3]).name == "report.html" and (tmp_path / said[3]).stat().st_size > 50_000
    version = run(python, "-m", "calibrate", "--version", where=tmp_path)
    assert version.startswith("calibrate 0.1.0")


@pytest.mark.slow
def test_both_archives_hold_what_is_used_and_nothing_of_the_workshop(built):
    wheel = zipfile.ZipFile(next(built.glob("*.whl"))).namelist()
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        sdist = archive.getnames()
    for needed in ("calibrate/__init__.pyi", "calibrate/soils/wheat_after_rice.toml"):
        assert needed in wheel and any(name.endswith(needed) for name in sdist)
    assert {name.split("/")[0] for name in wheel if ".dist-info" not in name} == {
        "jdem",
        "calibrate",
    }
    assert not any("/.ci/" in name for name in sdist)
