"""The kill script's own eyes: does it see what a kill has lost, repeated or changed?

Folders are laid out as commands leave them, then harmed by hand; nothing is simulated.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from formulas import BASE, specimen
from support import pieces

from calibrate.simulation.store import Store

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


def test_banks_are_compared_by_their_numbers(tmp_path):
    from calibrate.discrepancy.library import store

    bank = store.load(store.bundled_bank())
    store.save(bank, tmp_path / "bank.nc")
    found = pieces.result_of(tmp_path / "bank.nc")
    store.save(bank, tmp_path / "bank.nc")
    assert found == pieces.result_of(tmp_path / "bank.nc")
    bank.values[0, 0] = np.nextafter(np.float32(bank.values[0, 0]), np.float32(np.inf))
    store.save(bank, tmp_path / "bank.nc")
    assert found != pieces.result_of(tmp_path / "bank.nc")
