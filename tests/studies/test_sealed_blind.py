"""A diagnosis cannot see what is sealed: what it imports, and what it opens while it runs.

The second half diagnoses a case of formulas while an audit hook refuses every file or folder
whose path says "sealed", whoever asks for it and by whatever call.
"""

import ast
import json
import pickle
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.discrepancy.comparison.compare import prepare
from calibrate.discrepancy.comparison.naming import Grounds, named
from calibrate.discrepancy.diagnosis import InferenceSetup
from calibrate.discrepancy.library.design import CENTRE
from studies.sealed import baselines, trial
from studies.sealed.laboratory import SpecimenRecords, write_case
from studies.sealed.seal import open_seal, write_seal
from tests import ROOT
from tests.project.test_architecture import Module, read_modules
from tests.support import diagnosis_world as generator

ROOTS = ("studies.sealed.trial", "calibrate.discrepancy.diagnosis")
KNOWING = (
    "seal",
    "plan",
    "outside",
    "laboratory",
    "run",
    "scores",
    "canary",
)  # of studies.sealed


@pytest.fixture(scope="module")
def modules() -> dict[str, Module]:
    return read_modules(ROOT)


# ---------------------------------------------------------------- imports


def reached(roots: tuple[str, ...], modules: dict[str, Module]) -> set[str]:
    """All modules that the roots import, at whatever level, with the packages they lie in."""
    found: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name in modules and name not in found:
            found.add(name)
            waiting += [item.target for item in modules[name].imports]
            waiting += [name.rpartition(".")[0]]
    return found


def paths_in(module: Module) -> list[str]:
    """String constants that could lead to the labels."""
    words = (n.value for n in ast.walk(module.tree) if isinstance(n, ast.Constant))
    given = [word for word in words if isinstance(word, str)]
    return [w for w in given if w == "sealed" or "sealed/" in w or "labels." in w]


def test_a_diagnosis_imports_nothing_that_knows_the_labels(modules):
    found = reached(ROOTS, modules)
    assert (
        "calibrate.discrepancy.comparison.compare" in found
        and "calibrate.discrepancy.library.emulator" in found
    )
    assert not found & {f"studies.sealed.{name}" for name in KNOWING}


def test_a_diagnosis_names_no_path_to_the_labels(modules):
    """Entries of the run cache are sealed too, with a checksum: another thing."""
    named = {n: p for n in reached(ROOTS, modules) if (p := paths_in(modules[n]))}
    assert not {n for n in named if not n.startswith("calibrate.simulation.")}
    assert paths_in(modules["studies.sealed.seal"])  # the rule sees what it is to see


def test_whoever_opens_the_seal_is_seen_by_the_rule(modules):
    assert "studies.sealed.seal" in reached(("studies.sealed.run",), modules)


# ---------------------------------------------------------------- running

_watching: list[str] = []  # paths that were asked for while the hook is armed
_armed = False


def _refuse(event: str, arguments: tuple) -> None:
    if _armed and event in ("open", "os.listdir", "os.scandir") and "sealed" in str(arguments[0]):
        _watching.append(str(arguments[0]))
        raise PermissionError(f"{arguments[0]} is sealed")


sys.addaudithook(_refuse)


@contextmanager
def sealed_folders_refused() -> Iterator[None]:
    global _armed
    _watching.clear()
    _armed = True
    try:
        yield
    finally:
        _armed = False


@pytest.fixture(scope="module")
def judge() -> trial.TrainedBaselines:
    """Everything that is made before a case is seen, in the world of formulas."""
    known = generator.description()
    prepared = prepare(known, generator.PLAN, seed=1, draws=16)
    inputs = np.random.default_rng(0).standard_normal((8, 3))
    return trial.TrainedBaselines(
        InferenceSetup(prepared.calibration, {generator.PLAN.shape: prepared.null}),
        ("none of ours",), 3.0, "e1",
        baselines.train(inputs, ["none", "e1"] * 4),
    )  # fmt: skip


@pytest.fixture
def sealed_case(tmp_path, monkeypatch) -> Path:
    """A case with its seal; what its files say is read, what it hides is the formulas' e1."""
    way = np.linspace(0, 12, 160)
    records = {t: np.column_stack([way, 50 * way]) for t in ("confined", "unconfined")}
    write_case(
        "0abcd", [SpecimenRecords(records, 1830.0)] * 4, CENTRE, tmp_path / "cases" / "0abcd"
    )
    write_seal([{"case": "0abcd", "kind": "single", "nonce": "1"}], tmp_path)
    known = generator.description()
    measured = generator.case(3, 8 * known.effect_slopes[:, 1])

    def described(lab, emulated, seed, discrepancy=None):
        assert len(lab.curves) == 8
        return None, known, measured

    def answered(lab, emulated, found, d, measured, comparison, seed):
        return named(d, measured, comparison, Grounds(), seed)

    monkeypatch.setattr(trial, "described", described)
    monkeypatch.setattr(trial, "answered", answered)
    return tmp_path


def verdict_in(folder: Path, out: str, judge: trial.TrainedBaselines) -> dict:
    """The verdict file on the one case."""
    cases = [folder / "cases" / "0abcd"]
    trial.diagnose_all(cases, folder / out, None, judge, 0, Silent())  # pyright: ignore
    return json.loads((folder / out / "0abcd.json").read_text())


@pytest.mark.parametrize("count", [0, 1, pytest.param(3, marks=pytest.mark.slow)])
def test_all_cases_are_judged_in_whatever_process(tmp_path, count):
    cases = [tmp_path / str(number) for number in range(count)]
    assert list(trial._in_processes(Path.touch, cases)) == [None] * count
    assert all(case.exists() for case in cases)
    beyond = [tmp_path / "absent" / str(number) for number in range(max(count, 1))]
    with pytest.raises(FileNotFoundError):
        list(trial._in_processes(Path.touch, beyond))


def test_what_cannot_go_to_another_process_is_an_error_and_no_endless_wait(tmp_path):
    cases = [tmp_path / str(number) for number in range(3)]
    with pytest.raises((AttributeError, pickle.PicklingError)):
        list(trial._in_processes(lambda case: case.touch(), cases))


def test_a_diagnosis_runs_while_the_seal_cannot_be_opened(sealed_case, judge):
    with sealed_folders_refused():
        with pytest.raises(InputError, match="PermissionError"):
            open_seal(sealed_case)  # the hook refuses what it is to refuse
        _watching.clear()
        said = verdict_in(sealed_case, "refused", judge)
    assert _watching == []
    assert "failed" not in said and said["stated"] > 0
    shutil.rmtree(sealed_case / "sealed")
    (sealed_case / "labels.sha256").unlink()
    assert verdict_in(sealed_case, "absent", judge) == said


def test_a_case_that_is_refused_is_a_wrong_verdict_and_not_the_end(sealed_case, judge):
    lab = sealed_case / "cases" / "0abcd" / "lab.toml"
    lab.write_text(lab.read_text().replace('diameter = "50 mm"', 'diameter = "50 N"'))
    said = verdict_in(sealed_case, "refused", judge)
    assert said["verdict"] == "failed" and said["stated"] == 0.0
    assert "diameter" in said["failed"]


def test_rivals_are_trained_about_a_case_that_shows_what_most_show(monkeypatch):
    shown = {"less": (0,), "whole": (0, 1), "other": (0, 1), "broken": ()}
    cases = [Path(name) for name in shown]
    monkeypatch.setattr(trial, "_features_shown", lambda case, emulated: shown[case.name])
    assert trial.typical(cases, None) == Path("whole")
    assert trial.typical(cases[-1:], None) == Path("broken")
