"""How probabilities are learned, and the usual answers against which the diagnosis is measured.

Where the answer is known: evidence that is wrong by a stated factor, a world of formulas
(`diagnosis_world`), and the archived evidences behind the probabilities that ship.
"""

from dataclasses import replace

import numpy as np
import pytest

from calibrate.discrepancy.comparison.classes import JOINED, TOGETHER
from calibrate.discrepancy.comparison.compare import prepare
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.probability_calibration import (
    NONE,
    EvidenceSummary,
    ProbabilityCalibration,
    bundled_calibration,
    explanations,
    hypotheses,
)
from calibrate.discrepancy.comparison.repeats import from_vectors
from studies.sealed import baselines, training
from studies.sealed.training import fit_calibration, threshold
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
