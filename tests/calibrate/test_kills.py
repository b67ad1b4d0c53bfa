"""The kill script's own eyes: does it see what a kill has lost, repeated or changed?

Folders are laid out as commands leave them, then harmed by hand; nothing is simulated.
"""

import ast
import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

from calibrate.core import files
from calibrate.core.files import whole, write_json, write_text
from calibrate.designs.designs import sweep
from calibrate.designs.factors import Factor
from calibrate.figures import style
from calibrate.simulation.store import Store
from calibrate.view import vtk
from jdem.bodies.spheres import Spheres
from jdem.core.vector import Vector
from jdem.packing.specimen import Packing
from studies.sealed.run import write_once
from tests import ROOT
from tests.support import pieces
from tests.support.formulas import BASE, specimen

RESULT = {"observables": {"depression_depth_mm": 2.5}, "simulations": 2, "command": "calibrate"}


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two simulations, a case and a verdict, and the result of a fit."""
    for seed in range(2):
        Store(tmp_path).keep_run(f"run{seed}", specimen(BASE, seed))
    for name, text in (("sealed/0a1b2.attempt", "0"), ("verdicts/0a1b2.json", "{}")):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    write_result(tmp_path, RESULT)
    return tmp_path


def write_result(folder: Path, result: dict) -> None:
    (folder / "result.json").write_text(json.dumps(result))


def seen(folder: Path, harm) -> pieces.Tally:
    """What is counted if `harm` happens between a kill and the next start."""
    tally = pieces.Tally()
    before = pieces.inspected(folder, {}, tally)
    assert len(before) == 4 and (tally.lost, tally.repeated) == (0, 0)
    harm(folder)
    pieces.inspected(folder, before, tally)
    return tally


def rewrite(path: Path) -> None:
    """The same bytes as a new file."""
    part = path.with_suffix(".part")
    part.write_bytes(path.read_bytes())
    part.replace(path)


def test_nothing_is_counted_where_nothing_happened(folder):
    tally = seen(folder, lambda _: None)
    assert (tally.lost, tally.repeated) == (0, 0)


@pytest.mark.parametrize("piece", ["runs/run1.nc", "sealed/0a1b2.attempt", "verdicts/0a1b2.json"])
def test_each_kind_of_piece_is_missed_found_damaged_or_found_rewritten(folder, piece):
    path = folder / piece
    whole = path.read_bytes()
    assert seen(folder, lambda _: rewrite(path)).repeated == 1
    assert seen(folder, lambda _: path.unlink()).lost == 1
    path.write_bytes(whole)
    assert seen(folder, lambda _: path.write_bytes(whole[: len(whole) // 2])).lost == 1


def test_an_end_that_differs_is_told_from_one_that_does_not(folder):
    result = pieces.result_of(folder / "result.json")
    whole = pieces.Whole(1.0, result, frozenset(pieces.written(folder)))
    assert whole.equals("fit", folder)
    write_result(folder, {**RESULT, "simulations": 1, "command": "other"})
    assert whole.equals("fit", folder)
    write_result(folder, {**RESULT, "observables": {"depression_depth_mm": 2.5 + 1e-15}})
    assert not whole.equals("fit", folder)
    write_result(folder, RESULT)
    Store(folder).keep_run("one_too_many", specimen(BASE, 3))
    assert not whole.equals("fit", folder)


def test_libraries_are_compared_by_their_numbers(tmp_path):
    from calibrate.discrepancy.library import store

    library = store.load(store.bundled_library())
    store.save(library, tmp_path / "library.nc")
    found = pieces.result_of(tmp_path / "library.nc")
    store.save(library, tmp_path / "library.nc")
    assert found == pieces.result_of(tmp_path / "library.nc")
    values = library.rows.values
    values[0, 0] = np.nextafter(np.float32(values[0, 0]), np.float32(np.inf))
    store.save(library, tmp_path / "library.nc")
    assert found != pieces.result_of(tmp_path / "library.nc")


# ------------------------------------------------------------------ two processes in one folder

AGAIN = ("simulate", "fit", "withheld")  # of the verbs that keep runs; others end as these do
ALONE = "import sys; from tests.support.pieces import begin; begin(sys.argv[1:])"


def alone(arguments: list[str], cwd: Path) -> subprocess.Popen:
    """A command line in a process of its own, on formulas."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    return subprocess.Popen(
        [sys.executable, "-c", ALONE, *arguments], cwd=cwd, env=environment,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def side_by_side(arguments: list[str], cwd: Path) -> None:
    """Two processes with one command line: both end with 0, and nothing is left over."""
    both = [alone(arguments, cwd) for _ in range(2)]
    said = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert not pieces.left_over(cwd)


@pytest.mark.slow
@pytest.mark.parametrize(
    "verb", [*pieces.PAIRED, "fit", "doe", pytest.param("withheld", marks=pytest.mark.rare)]
)
def test_two_processes_in_one_folder_both_end_well(verb, tmp_path):
    """Where all runs are kept then twice more (`AGAIN`), so that the ends fall together."""
    chosen = {**pieces.VERBS, **pieces.PAIRED}[verb]
    folder = tmp_path / "both"
    folder.mkdir()
    if chosen.before:
        alone([*chosen.before, "--out", str(tmp_path / "made")], tmp_path).communicate()
    arguments = chosen.arguments(folder)
    side_by_side(arguments, folder)
    first = pieces.result_of(folder / chosen.result)
    if verb in AGAIN:
        assert pieces.written(folder)
        side_by_side(arguments, folder)
        assert pieces.result_of(folder / chosen.result) == first


def test_two_writers_of_one_file_do_not_meet(tmp_path):
    path = tmp_path / "a.txt"
    with whole(path) as one, whole(path) as two:
        assert one != two and one.parent == two.parent == tmp_path
        one.write_text("one")
        two.write_text("two")
        assert not path.exists()
    assert path.read_text() == "one"  # the block that ends last
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_what_fails_leaves_nothing_and_spoils_nothing(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "before")
    with pytest.raises(RuntimeError), whole(path) as part:
        part.write_text("half")
        raise RuntimeError
    assert path.read_text() == "before"
    assert [each.name for each in tmp_path.iterdir()] == ["a.txt"]


def test_a_pipe_is_written_to_and_stays_a_pipe(tmp_path):
    """As /dev/null and /dev/stdout are: a file that took their place would break the machine."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(path.read_text)
        files.check_writable(path)
        write_json(path, {"a": 1})
        assert json.loads(read.result(timeout=30)) == {"a": 1}
    assert path.is_fifo() and [each.name for each in tmp_path.iterdir()] == ["pipe"]


def test_the_first_of_several_is_the_one_that_stays(tmp_path):
    write_once(tmp_path / "plan", "first")
    write_once(tmp_path / "plan", "second")
    assert (tmp_path / "plan").read_text() == "first"
    assert len(list(tmp_path.iterdir())) == 1


def writes_figure(path: Path) -> None:
    style.save(Figure(), path.with_suffix(".png"))


def writes_packing(path: Path) -> None:
    ones = jnp.ones(3)
    bed = Packing(Vector(ones, ones, ones), Spheres(ones, ones), 1.0, 1.0)
    Store(path.parent).keep_packing(path.stem, bed)


def writes_collection(path: Path) -> None:
    vtk._write_collection(path.with_suffix(".pvd"), ["vtk/a.vtu"], [0.0])


WRITERS = {
    "text": lambda path: write_text(path, "x"),
    "json": lambda path: write_json(path, {"x": 1.0}),
    "figure": writes_figure,
    "packing": writes_packing,
    "run": lambda path: Store(path.parent).keep_run(path.stem, specimen(BASE, 0)),
    "collection": writes_collection,
    "run sheet": lambda path: sweep(Factor("a", 1.0, 2.0)).write_csv(path),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_writers_meet_at_the_moment_of_renaming(kind, tmp_path, monkeypatch):
    """Two threads, each held back just before it renames until the other is there too: as in case
    09, where one process renamed the file of both."""
    meet, rename = threading.Barrier(2, timeout=60), os.replace

    def together(source, target):
        if Path(target).parent.is_relative_to(tmp_path) and ".part" not in Path(target).name:
            meet.wait()
        rename(source, target)

    monkeypatch.setattr(files.os, "replace", together)
    with ThreadPoolExecutor(2) as pool:
        begun = [pool.submit(WRITERS[kind], tmp_path / "a.csv") for _ in range(2)]
        assert [each.exception(timeout=120) for each in begun] == [None, None]
    assert not pieces.left_over(tmp_path)
    assert sum(path.is_file() for path in tmp_path.rglob("*")) == 1


OPENERS = ("write_text", "write_bytes", "savefig", "savez", "to_netcdf", "writestr", "mkstemp")
OURS = ("part", "text", "file")  # a name of its own, or memory


def direct_writers(source: str) -> list[int]:
    """Lines that write to a path which is not `part`, the name that `whole` gives."""
    found = []
    for call in ast.walk(ast.parse(source)):
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute)):
            continue
        name, owner = call.func.attr, call.func.value
        modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
        opens = name == "open" and any(str(mode)[:1] in "wax" for mode in modes)
        if name not in OPENERS and not opens:
            continue
        first = call.args[0] if call.args else None
        names = [each.id for each in (owner, first) if isinstance(each, ast.Name)]
        in_memory = name == "to_netcdf" and not call.args
        if not in_memory and not any(each in OURS for each in names):
            found.append(call.lineno)
    return found


def test_no_writer_has_a_name_that_another_has():
    found = {
        str(path.relative_to(ROOT)): lines
        for package in ("calibrate", "jdem", "studies/sealed")
        for path in sorted((ROOT / package).rglob("*.py"))
        if (lines := direct_writers(path.read_text(encoding="utf-8")))
    }
    assert found == {}


@pytest.mark.parametrize(
    "source",
    [
        'path.write_text("x")',
        "path.write_bytes(data)",
        "figure.savefig(path, dpi=130)",
        'path.open("w")',
        'path.with_suffix(".part").open("wb")',
        "np.savez(path, a=1)",
        "dataset.to_netcdf(path)",
    ],
)
def test_the_rule_catches(source):
    assert direct_writers(source) == [1]


def test_commands_are_loaded_without_a_backend_of_jax():
    """A process that has one cannot fork: `kills.py` loads all once, and every start is a fork."""
    asked = (
        "import jax._src.xla_bridge as bridge, tests.support.pieces\n"
        "from calibrate.discrepancy import diagnosis\n"
        "from calibrate.reports import study\n"
        "from studies.sealed import report\n"
        "raise SystemExit(bridge.backends_are_initialized())"
    )
    done = subprocess.run(
        [sys.executable, "-c", asked], env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 0
