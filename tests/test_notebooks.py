"""Every notebook runs from top to bottom, and is committed as it should be.

Each is executed with small numbers in a copy of its folder, so that nothing it writes lands
in the repository.  The whole set takes longer than a test run should: by default those run that
are quick and touch much of the library, with JDEM_EVERY_NOTEBOOK=1 (or `make notebooks`) all.
"""

import importlib.util
import json
import os
import re
import shutil
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "notebooks"
BY_DEFAULT = ("01", "06")  # 05 simulates specimens of 1100 spheres: two minutes
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


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """A folder beside copies of what notebooks read, with one cache of compiled programs."""
    shutil.copytree(FOLDER / "data", tmp_path / "notebooks" / "data")
    monkeypatch.setenv("JDEM_NOTEBOOK_QUICK", "1")
    monkeypatch.setenv("XDG_CACHE_HOME", str(ROOT / ".jax_cache"))
    return tmp_path / "notebooks"


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 5


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [p for p in NOTEBOOKS if p.stem[:2] in BY_DEFAULT or "JDEM_EVERY_NOTEBOOK" in os.environ],
    ids=lambda path: path.stem,
)
def test_it_runs(path, copied):
    done = execute.executed(path, copied)
    assert all(cell.execution_count for cell in done.cells if cell.cell_type == "code")


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
