"""How probabilities are learned, and the usual answers against which the diagnosis is measured.

Where the answer is known: evidence that is wrong by a stated factor, a world of formulas
(`diagnosis_world`), and the archived evidences behind the probabilities that ship.  The last part
shows that a diagnosis cannot see what is sealed, by what it imports and by what it opens: a case of
formulas is diagnosed while an audit hook refuses every path that says "sealed".
"""

import ast
import json
import pickle
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibrate.core.errors import InputError
from calibrate.core.progress import Silent
from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.compare import prepare
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.naming import Grounds, named
from calibrate.discrepancy.comparison.probability_calibration import (
    NONE,
    EvidenceSummary,
    ProbabilityCalibration,
    bundled_calibration,
    explanations,
    hypotheses,
)
from calibrate.discrepancy.comparison.repeats import from_vectors
from calibrate.discrepancy.library.design import CENTRE
from studies.sealed import baselines, training, trial
from studies.sealed.laboratory import SpecimenRecords, write_case
from studies.sealed.seal import open_seal, write_seal
from studies.sealed.training import fit_calibration, threshold
from tests import ROOT
from tests.project.test_architecture import Module, read_modules
from tests.support import diagnosis_world as generator


def summary(singles_, unknown=0.0, p_before=0.5) -> EvidenceSummary:
    found = Evidence(np.array(singles_), np.zeros(1), np.array([[0, 1]]), unknown)
    return EvidenceSummary(("a", "b"), found, p_before, 0.5)


def test_overconfident_evidence_is_tempered():
    """Evidence three times too strong is found to be so."""
    rng = np.random.default_rng(6)
    cases, truths = [], []
    for _ in range(400):
        gain = rng.normal(0, 1.5, 2)
        odds = np.exp(np.array([-20.0, *gain]))
        truth = rng.choice(3, p=odds / odds.sum())
        cases.append(summary(3 * gain, unknown=-60.0))
        truths.append(np.arange(5) == truth)
    assert 1 / fit_calibration(cases, truths).sharpness == pytest.approx(3.0, rel=0.35)


def test_an_effect_for_which_evidence_speaks_too_readily_is_found_out():
    """Two units of ln evidence for "a", whatever is true."""
    rng = np.random.default_rng(16)
    cases, truths = [], []
    for _ in range(400):
        gain = rng.normal(0, 1.5, 2)
        odds = np.exp(np.array([0.0, *(gain - np.log(2))]))
        truth = rng.choice(3, p=odds / odds.sum())
        cases.append(summary(gain + np.array([2.0, 0.0]), unknown=-60.0))
        truths.append(np.arange(5) == truth)
    class_bias = fit_calibration(cases, truths).class_bias
    assert class_bias["b"] - class_bias["a"] == pytest.approx(2.0, abs=0.5)


def test_one_case_that_nobody_could_foresee_does_not_decide():
    def learned_from(absurd: int) -> ProbabilityCalibration:
        right = [
            (summary([4.0, 0.0]), np.arange(5) == 1),
            (summary([-1.0, -1.0]), np.arange(5) == 0),
        ]
        wrong = [(summary([900.0, 0.0]), np.arange(5) == 0)]
        cases, truths = zip(*(right * 40 + wrong * absurd), strict=True)
        return fit_calibration(cases, truths)

    assert learned_from(1).sharpness == pytest.approx(learned_from(0).sharpness, rel=0.1)


def test_sets_cover_as_stated():
    rng = np.random.default_rng(7)
    p = rng.dirichlet(np.ones(4) * 0.7, 4000)
    truth = np.array([rng.choice(4, p=row) for row in p])
    of_truth = p[np.arange(4000), truth]
    least = threshold(of_truth[:300], 0.9)
    covered = [
        str(t) in explanations({str(i): v for i, v in enumerate(row)}, least)
        for row, t in zip(p[300:], truth[300:], strict=True)
    ]
    assert 0.85 < np.mean(covered) < 0.95
    assert threshold(of_truth[:300], 0.9, confidence=0.95) <= least


# ---------------------------------------------------------------- probabilities that ship


def test_bundled_probabilities_follow_from_the_archived_evidences():
    found, again = bundled_calibration(), training.learn(training.cases())
    names = tuple(again.class_bias)
    assert found.numbers(names) == pytest.approx(again.numbers(names), abs=1e-3)
    assert 0 < found.smallest < 0.5


def test_probabilities_state_better_than_evidences_as_they_are():
    """By the logarithmic score of the cases that each fifth left out."""
    cases = training.cases()
    others = training.quality(cases, training.by_other_folds(cases))
    plain = training.quality(cases, [ProbabilityCalibration()] * len(cases))
    assert others["log_score"] > plain["log_score"]


def named_right(case: training.Known) -> set[tuple[str, ...]]:
    every = hypotheses(case.summary)
    return {h for h, right in zip(every, case.right, strict=True) if right}


def test_right_explanations_are_those_of_the_right_class():
    cases = training.cases()
    nothing = next(c for c in cases if c.truth == NONE)
    assert named_right(nothing) == {(NONE,)}
    joined = next(c for c in cases if JOINED in c.truth and TOGETHER not in c.truth)
    members = set(joined.truth.split(JOINED))
    assert {(name,) for name in members} <= named_right(joined)
    assert all(set(h) <= members for h in named_right(joined))
    pair = next(c for c in cases if TOGETHER in c.truth and JOINED not in c.truth)
    assert [set(h) for h in named_right(pair)] == [set(pair.truth.split(TOGETHER))]
    for case in (nothing, joined, pair):
        assert sum(case.said(bundled_calibration()).values()) == pytest.approx(1.0)


# ---------------------------------------------------------------- usual answers

COMPARED = generator.description()


COMPARED_SAMPLE = generator.case(61, 4.0 * COMPARED.effect_slopes[:, 3])


def test_baselines_answer_in_the_same_words():
    names = {"none", *COMPARED.effect_names}
    assert baselines.template(COMPARED, COMPARED_SAMPLE, 0.0) in names
    assert baselines.template(COMPARED, COMPARED_SAMPLE, np.inf) == "none"
    assert baselines.bic(COMPARED, COMPARED_SAMPLE) in names
    assert baselines.majority(["a", "b", "b"]) == "b"


def test_the_criterion_of_refits_does_not_depend_on_units():
    by = np.where(np.arange(len(COMPARED.mean)) % 7 == 0, 1e3, 1.0)
    other = replace(
        COMPARED, mean=COMPARED.mean * by, base_slopes=COMPARED.base_slopes * by[:, None],
        effect_slopes=COMPARED.effect_slopes * by[:, None],
        packing_residuals=COMPARED.packing_residuals * by,
    )  # fmt: skip
    same = from_vectors(COMPARED.features, COMPARED_SAMPLE.specimens * by)
    ours, theirs = (
        [baselines._criterion(d, s, key) for key in ((), (0,), (3,))]
        for d, s in ((COMPARED, COMPARED_SAMPLE), (other, same))
    )
    assert np.diff(theirs) == pytest.approx(np.diff(ours), abs=1e-3)


def test_the_classifier_learns_what_is_separable():
    rng = np.random.default_rng(9)
    inputs = np.concatenate([rng.normal(c, 1.0, (60, 3)) for c in (-3.0, 0.0, 3.0)])
    labels = [name for name in "abc" for _ in range(60)]
    trained = baselines.train(inputs, labels)
    right = [trained.best(row) == name for row, name in zip(inputs, labels, strict=True)]
    assert np.mean(right) > 0.9
    assert trained.probability(inputs[0]).sum() == pytest.approx(1.0)


def test_generated_cases_hold_what_they_say():
    known = prepare(COMPARED, generator.PLAN, seed=1, draws=120)
    pair = baselines.generated_case(known, np.random.default_rng(1), "pair")
    assert len(pair.truth) == 2 and not pair.excluded_effects
    other = [baselines.generated_case(known, np.random.default_rng(s), "unknown") for s in range(8)]
    assert {case.truth for case in other} == {("unknown",)}
    assert any(case.excluded_effects for case in other)


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
        trial.InferenceSetup(prepared.calibration, {generator.PLAN.shape: prepared.null}),
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
