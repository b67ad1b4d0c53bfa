"""Campaigns: damage is noticed, processes share the work, failures are labelled rows.

Most tests run on formulas (`toy_place`), so that they test the cache and not the DEM; the last
ones run real simulations of 48 spheres.
"""

import errno
import io
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from dataclasses import replace
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
import xarray as xr

from calibrate.core.errors import CalibrationError, InputError
from calibrate.core.progress import PlainLines, Silent, duration
from calibrate.io.soil import with_values
from calibrate.simulation import NETCDF, compiled, side_by_side, store
from calibrate.simulation.batches import InBatches, _Queue
from calibrate.simulation.run import QUALITY
from calibrate.simulation.session import Session, place_of
from calibrate.simulation.specimens import curves_json, reservations, simulation_json
from calibrate.simulation.store import LENGTH, sealed, unsealed
from tests import ROOT
from tests.support.formulas import BASE, tiny_campaign
from tests.support.toy_place import formula, soils, toy_campaign

pytestmark = pytest.mark.thorough

SEEDS = (0, 1)


def numbers(rows):
    """Everything of rows of runs, comparable with ==."""
    return [
        [
            (run.observables, run.curves["confined"].tolist(), run.curves["unconfined"].tolist())
            for run in row
        ]
        for row in rows
    ]


def entries(folder, pattern):
    return sorted((folder / "cache").glob(pattern))


@pytest.fixture
def filled(tmp_path):
    """A cache of one soil on two packings, and what it holds."""
    work = toy_campaign(tmp_path)
    rows = work.runs(soils(1), SEEDS, "filling")
    return tmp_path, numbers(rows)


def test_programs_do_not_pile_up(monkeypatch):
    """Beside those that are kept, JAX's own caches are emptied as often as these are filled."""
    kinds, emptied = iter(range(3 * compiled.KEPT)), []
    made = SimpleNamespace(lower=lambda *_: SimpleNamespace(compile=object))
    monkeypatch.setattr(compiled, "program", lambda _: made)
    monkeypatch.setattr(compiled, "kind_of", lambda *_: next(kinds))
    monkeypatch.setattr(compiled.jax, "clear_caches", lambda: emptied.append(1))
    programs = compiled.Programs()
    nothing: Any = None
    for _ in range(3 * compiled.KEPT):
        programs.get(nothing, nothing, nothing)
    assert len(programs._compiled) == compiled.KEPT and len(emptied) == 3


# ------------------------------------------------------------------ damage


def flipped(data: bytes) -> list[bytes]:
    """One bit changed, all along the content."""
    places = range(0, len(data) - LENGTH, 31)
    return [data[:k] + bytes([data[k] ^ 0x10]) + data[k + 1 :] for k in places]


def cut(data: bytes) -> list[bytes]:
    """Truncated, or zeroed from somewhere to the end as after a power cut."""
    lengths = [0, 1, 100, len(data) // 2, len(data) - LENGTH - 40]
    return [data[:k] + fill * bytes(len(data) - k) for k in lengths for fill in (0, 1)]


def seal_broken(data: bytes) -> list[bytes]:
    """The content is whole and the seal is not."""
    places = range(len(data) - LENGTH, len(data), 5)
    changed = [data[:k] + b"?" + data[k + 1 :] for k in places]
    return [*changed, data[:-1], data[:-LENGTH]]


def content_of(folder, kind):
    """What the cache gives for its first file of a kind, comparable with ==; None if nothing."""
    keeper = store.Store(folder / "cache")
    path = entries(folder, kind)[0]
    if kind == "packings/*.npz":
        packing = keeper.packing(path.stem)
        return None if packing is None else packing.position.stack().tolist()
    run = keeper.run(path.stem)
    return None if run is None else numbers([[run]])


@pytest.mark.parametrize("kind", ["runs/*.nc", "packings/*.npz"])
def test_damage_of_the_content_is_always_noticed(filled, kind):
    path = entries(filled[0], kind)[0]
    whole = path.read_bytes()
    for data in [*flipped(whole), *cut(whole)]:
        path.write_bytes(data)
        assert content_of(filled[0], kind) is None


@pytest.mark.parametrize("kind", ["runs/*.nc", "packings/*.npz"])
def test_damage_of_the_seal_never_gives_other_numbers(filled, kind):
    path = entries(filled[0], kind)[0]
    whole, expected = path.read_bytes(), content_of(filled[0], kind)
    for data in seal_broken(whole):
        path.write_bytes(data)
        assert content_of(filled[0], kind) in (None, expected)


@pytest.mark.parametrize("kind", ["runs/*.nc", "packings/*.npz"])
@pytest.mark.parametrize("damage", [flipped, cut, seal_broken])
def test_what_is_damaged_is_made_again(filled, kind, damage):
    folder, expected = filled
    path = entries(folder, kind)[0]
    path.write_bytes(damage(path.read_bytes())[4])
    work = toy_campaign(folder)
    assert numbers(work.runs(soils(1), SEEDS, "again")) == expected
    assert content_of(folder, kind) is not None
    assert work.simulated == (kind.startswith("runs"))


def test_what_is_damaged_is_told(filled, capsys):
    folder, _ = filled
    path = entries(folder, "runs/*.nc")[0]
    path.write_bytes(path.read_bytes()[:-200])
    work = replace(toy_campaign(folder), progress=PlainLines(stream=sys.stdout))
    work.runs(soils(1), SEEDS, "again")
    assert "1 damaged entries of the cache are simulated again" in capsys.readouterr().out


def test_a_seal_is_put_on_and_taken_off():
    assert unsealed(sealed(b"abc")) == (b"abc", True)
    assert unsealed(b"abc") == (b"abc", False)
    with pytest.raises(ValueError, match="checksum"):
        unsealed(sealed(b"abc").replace(b"b", b"c", 1))


def test_entries_without_seal_from_earlier_versions_are_read(filled):
    """As they were written before: no seal, and no word of one inside."""
    folder, expected = filled
    for path in entries(folder, "runs/*.nc"):
        with xr.open_dataset(io.BytesIO(path.read_bytes()), engine=NETCDF) as data:
            old = data.load()
        del old.attrs["sealed"]
        old.to_netcdf(path, engine=NETCDF)
    for path in entries(folder, "packings/*.npz"):
        path.write_bytes(unsealed(path.read_bytes())[0])
    work = toy_campaign(folder)
    assert numbers(work.runs(soils(1), SEEDS, "old")) == expected
    assert work.simulated == 0


def test_sealed_entries_open_with_other_programs(filled):
    """NetCDF and .npz as they are, for whoever looks at a cache."""
    folder, expected = filled
    curves = [
        xr.open_dataset(path, engine=NETCDF)["confined"].values.tolist()
        for path in entries(folder, "runs/*.nc")
    ]
    assert sorted(curves) == sorted(confined for _, confined, _ in expected[0])
    assert all("radius" in np.load(path) for path in entries(folder, "packings/*.npz"))


# ------------------------------------------------------------------ two processes on one cache

PROCESS = """
import sys
from pathlib import Path
import tests.conftest  # double precision, without which keys differ
from tests.support.toy_place import soils, toy_campaign
work = toy_campaign(Path(sys.argv[1]), seconds=float(sys.argv[2]))
work.runs(soils(int(sys.argv[3])), (0, 1), "shared")
print(work.simulated)
"""


@pytest.fixture
def another_process(tmp_path):
    """Starts a process on the same cache; it does not outlive the test."""
    started = []

    def start(seconds, count):
        command = [sys.executable, "-c", PROCESS, *map(str, (tmp_path, seconds, count))]
        started.append(subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def wait_until(condition):
    deadline = time.monotonic() + 600  # of a busy machine
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def expected_numbers(work, count):
    packings = work.packings(SEEDS)
    return numbers([[formula(packing, soil) for packing in packings] for soil in soils(count)])


def nothing_is_left(folder):
    assert not entries(folder, "claims/*")
    assert not entries(folder, "*/*.part*")


@pytest.mark.slow
def test_two_processes_share_a_cache_and_simulate_nothing_twice(tmp_path, another_process):
    """40 runs of 50 ms: both begin together, each does some, none is done by both."""
    work = toy_campaign(tmp_path, seconds=0.05)
    other = another_process(0.05, 20)
    wait_until(lambda: work.place.noted())
    rows = work.runs(soils(20), SEEDS, "shared")
    assert other.wait() == 0
    theirs = int(other.stdout.read())
    assert numbers(rows) == expected_numbers(work, 20)
    noted = [line.split(" ", 1) for line in work.place.noted()]
    assert len(noted) == len({run for _, run in noted}) == 40
    assert work.simulated + theirs == 40
    assert work.simulated > 0 and theirs > 0
    nothing_is_left(tmp_path)


def test_what_a_killed_process_had_in_hand_is_taken_over(tmp_path, another_process):
    """The other process dies within two runs that it has claimed; we wait for it until then."""
    work = toy_campaign(tmp_path)
    other = another_process(600, 3)
    wait_until(lambda: len(work.place.noted()) == 2)
    lines = io.StringIO()
    work.progress = PlainLines(stream=lines)

    def kill_once_we_wait(line):
        if "waiting for 2" in line:
            other.send_signal(signal.SIGKILL)

    work.progress.say = lambda line: kill_once_we_wait(line)
    rows = work.runs(soils(3), SEEDS, "shared")
    assert other.wait() == -signal.SIGKILL
    assert numbers(rows) == expected_numbers(work, 3)
    assert work.simulated == 6
    nothing_is_left(tmp_path)


def test_a_file_system_without_locks_does_without(tmp_path, monkeypatch):
    def no_locks(*_, **__):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(store.FileLock, "acquire", no_locks)
    work = toy_campaign(tmp_path)
    assert numbers(work.runs(soils(2), SEEDS, "alone")) == expected_numbers(work, 2)


# ------------------------------------------------------------------ failures of the machine


def test_a_run_that_the_machine_failed_is_tried_again(tmp_path):
    work = replace(toy_campaign(tmp_path, fails=2), workers=1)
    rows = work.runs(soils(1), (0,), "retried")
    assert rows[0][0].failure == ""
    assert len(work.place.noted()) == 3


def test_a_run_that_no_machine_finishes_is_a_labelled_row_and_not_kept(tmp_path):
    work = replace(toy_campaign(tmp_path, fails=3), workers=1)
    (first,), (second,) = work.runs(soils(2), (0,), "retried")
    assert first.failure == "not simulated, tried 3 times: out of memory"
    assert np.isnan(list(first.observables.values())).all()
    assert second.failure == ""
    assert work.simulated == 1
    result = simulation_json([first, second])
    assert result["failures"] == [first.failure]
    assert set(result["quality"]) <= set(QUALITY)
    again = toy_campaign(tmp_path).runs(soils(2), (0,), "next day")
    assert [row[0].failure for row in again] == ["", ""]


def test_a_fault_of_the_program_is_not_taken_for_the_machines(tmp_path, monkeypatch):
    work = toy_campaign(tmp_path)
    monkeypatch.setattr(type(work.place), "simulate", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        work.runs(soils(1), SEEDS, "broken")


def test_a_specimen_that_cannot_be_packed_is_one_sentence(tmp_path, monkeypatch):
    def loose(*_):
        raise ValueError("48 spheres did not settle")

    work = toy_campaign(tmp_path)
    monkeypatch.setattr(type(work.place), "prepare", loose)
    with pytest.raises(CalibrationError, match="packing 0: 48 spheres did not settle"):
        work.runs(soils(1), SEEDS, "loose")


# ------------------------------------------------------------------ disks


def mounted(folder, options):
    """Mounts memory on `folder`; False where this user or system may not."""
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    try:
        return subprocess.run(command, capture_output=True).returncode == 0
    except FileNotFoundError:
        return False


@pytest.fixture
def disk(tmp_path):
    """A real disk of 64 kB, or a skipped test."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if not mounted(folder, "size=64k"):
        pytest.skip("only root may mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def test_a_full_disk_is_one_sentence_and_what_is_kept_is_whole(disk):
    with pytest.raises(CalibrationError, match="No space left on device; make room"):
        toy_campaign(disk).runs(soils(20), SEEDS, "filling the disk")
    kept = entries(disk, "runs/*.nc")
    assert kept
    subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
    work = toy_campaign(disk)
    assert numbers(work.runs(soils(20), SEEDS, "more room")) == expected_numbers(work, 20)
    assert work.simulated == 40 - len(kept)
    nothing_is_left(disk)


def test_a_read_only_cache_is_read_and_not_written(disk):
    work = toy_campaign(disk)
    work.runs(soils(1), SEEDS, "writing")
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    assert numbers(work.runs(soils(1), SEEDS, "reading")) == expected_numbers(work, 1)
    with pytest.raises(CalibrationError, match="Read-only file system"):
        work.runs(soils(2), SEEDS, "writing")


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EDQUOT, errno.EIO])
def test_whatever_the_disk_refuses_is_one_sentence(tmp_path, monkeypatch, code):
    """For those who may not mount: the system's error from the write itself."""

    def refuse(*_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(CalibrationError, match=os.strerror(code)):
        toy_campaign(tmp_path).runs(soils(1), SEEDS, "writing")
    nothing_is_left(tmp_path)


# ------------------------------------------------------------------ progress


def test_progress_tells_the_time_left(monkeypatch):
    clock = iter([0.0, 0.0, 30.0, 60.0, 61.0, 90.0])
    monkeypatch.setattr("calibrate.core.progress.time.monotonic", lambda: next(clock))
    lines = io.StringIO()
    progress = PlainLines(stream=lines)
    progress.start("simulating", 300)
    for _ in range(3):
        progress.advance()
    progress.finish()
    assert lines.getvalue().splitlines() == [
        "simulating: 300 to do",
        "simulating: 1/300, about 2 h 29 min left",
        "simulating: 2/300, about 2 h 29 min left",
        "simulating: 3/300 in 1 min 30 s",
    ]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.4, "0 s"),
        (59.6, "1 min 0 s"),
        (3599, "59 min 59 s"),
        (3600, "1 h 0 min"),
        (86399, "23 h 59 min"),
        (90000, "1 d 1 h"),
    ],
)
def test_lengths_of_time(seconds, words):
    assert duration(seconds) == words


def test_side_by_side_keeps_the_order_and_stops_at_an_error():
    def late_first(number):
        time.sleep(0.02 * (5 - number))
        return number**2

    assert side_by_side(late_first, 5, Silent(), "squares", 3) == [0, 1, 4, 9, 16]
    begun = []

    def fails(number):
        begun.append(number)
        if number == 1:
            raise ValueError("the second one")
        time.sleep(0.05)
        return number

    with pytest.raises(ValueError, match="the second one"):
        side_by_side(fails, 50, Silent(), "squares", 2)
    assert len(begun) < 50


def test_a_run_of_an_earlier_cache_states_its_resolution(tmp_path):
    """Entries written before resolution was kept are completed from their packing."""
    work = toy_campaign(tmp_path)
    (run,) = work.runs(soils(1), [0], "run")[0]
    key = work.key(soils(1)[0], 0)
    old = {k: v for k, v in run.quality.items() if k not in ("spheres_across", "porosity")}
    work.store.keep_run(key, replace(run, quality=old))
    (again,) = work.runs(soils(1), [0], "run")[0]
    (packing,) = work.packings([0])
    across, height = 2 * float(packing.mould_radius), float(packing.height)
    diameter = float(packing.mean_diameter())
    solid = packing.spheres.count * np.pi / 6 * diameter**3
    assert again.quality["spheres_across"] == pytest.approx(across / diameter)
    porosity = 1 - solid / (np.pi / 4 * across**2 * height)
    assert again.quality["porosity"] == pytest.approx(porosity)


def test_what_a_test_records_beside_its_curve_is_kept(tmp_path):
    work = toy_campaign(tmp_path)
    (run,) = work.runs(soils(1), [0], "run")[0]
    key, (test, *_) = work.key(soils(1)[0], 0), run.curves
    beside = {test: {"lid_force_n": np.arange(float(len(run.curves[test])))}}
    work.store.keep_run(key, replace(run, channels=beside))
    (again,) = work.runs(soils(1), [0], "run")[0]
    assert {*again.curves} == {*run.curves} and {*again.channels} == {test}
    np.testing.assert_array_equal(again.channels[test]["lid_force_n"], beside[test]["lid_force_n"])
    assert curves_json(again)[test]["lid_force_n"][1] == 1.0


def test_few_spheres_across_are_said():
    (said,) = reservations({"spheres_across": 4.6})
    assert "specimen is 4.6 spheres across, below 8" in said
    assert reservations({"spheres_across": 8.0, "tool_across": 5.0}) == reservations({}) == []
    specimen_said, tool_said = reservations({"spheres_across": 7.0, "tool_across": 2.5})
    assert "specimen is 7.0" in specimen_said
    assert "tool is 2.5 spheres across, below 5" in tool_said


def test_spheres_that_overlap_a_tool_too_far_are_said():
    (said,) = reservations({"tool_overlap": 0.71})
    assert "by 0.71 of their radius, above 0.5" in said
    assert reservations({"tool_overlap": 0.49}) == reservations({"tool_overlap": None}) == []


def test_a_session_in_single_precision_simulates_in_it(tmp_path):
    session = Session.open(None, "quick", tmp_path)
    both = (session, session.in_single_precision())
    campaigns = [each.campaign_of_one(tmp_path) for each in both]
    assert [work.lab.numerics.dtype for work in campaigns] == ["float64", "float32"]


@pytest.fixture
def in_threes():
    """A place that simulates three specimens at once; the default device is as before after it."""
    yield InBatches(3)
    jax.config.update("jax_default_device", None)


@pytest.mark.slow
def test_a_batch_simulates_what_single_runs_do(tmp_path, in_threes, monkeypatch):
    """Two soils on two packings: a batch and another one that is padded.  The machine gives up the
    first batch, so its specimens are handed in again.  In double precision they differ by rounding,
    which a bed of 48 spheres hardly lets grow before its peak."""
    sizes, run_batch = [], in_threes._run

    def run_but_first(queue, batch):
        sizes.append(len(batch))
        if len(sizes) == 1:
            raise MemoryError
        run_batch(queue, batch)

    monkeypatch.setattr(in_threes, "_run", run_but_first)
    tested = [with_values(BASE, {"surface_energy": energy}) for energy in (10.0, 14.0)]
    together = replace(tiny_campaign(tmp_path / "together"), place=in_threes)
    alone = tiny_campaign(tmp_path / "alone")
    found, single = (work.runs(tested, SEEDS, "run") for work in (together, alone))
    assert sum(sizes) == 4 + sizes[0] and max(sizes) == 3
    for run, one in zip(chain(*found), chain(*single), strict=True):
        assert run.failure == one.failure == ""
        assert run.quality["steps"] == one.quality["steps"]
        depth, same = (r.observables["depression_depth_mm"] for r in (run, one))
        assert depth == pytest.approx(same, rel=1e-3)


def test_specimens_of_a_batch_are_those_with_the_smallest_steps(in_threes):
    """Of the longest queue whose program is compiled."""
    compiled, waits = Future(), Future()
    compiled.set_result(None)
    steps = (3e-5, 1e-5, 4e-5, 2e-5)
    with in_threes._changed:
        for number, program in ((4, compiled), (3, compiled), (4, waits)):
            queue: Any = [SimpleNamespace(time_step=step) for step in steps[:number]]
            in_threes._queues[object()] = _Queue(compiled, {3: program}, queue)
        _, batch = in_threes._next()
        in_threes._queues.clear()
    assert [one.time_step for one in batch] == [1e-5, 2e-5, 3e-5]


def test_a_batch_is_not_for_a_cluster():
    with pytest.raises(InputError, match="one specimen at a time"):
        place_of("tcp://127.0.0.1:8786", 4)
