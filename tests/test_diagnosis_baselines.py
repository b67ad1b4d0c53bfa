"""What the diagnosis is measured against: usual answers, given in its words."""

from dataclasses import replace

import diagnosis_world as generator
import numpy as np
import pytest

from calibrate.discrepancy.comparison import baselines
from calibrate.discrepancy.comparison.repeats import from_vectors

KNOWN = generator.description()
SAMPLE = generator.case(61, 4.0 * KNOWN.effect_slopes[:, 3])


def test_baselines_answer_in_the_same_words():
    names = {"none", *KNOWN.effect_names}
    assert baselines.template(KNOWN, SAMPLE, 0.0) in names
    assert baselines.template(KNOWN, SAMPLE, np.inf) == "none"
    assert baselines.bic(KNOWN, SAMPLE) in names
    assert baselines.majority(["a", "b", "b"]) == "b"


def test_the_criterion_of_refits_does_not_depend_on_units():
    by = np.where(np.arange(len(KNOWN.mean)) % 7 == 0, 1e3, 1.0)
    other = replace(
        KNOWN, mean=KNOWN.mean * by, base_slopes=KNOWN.base_slopes * by[:, None],
        effect_slopes=KNOWN.effect_slopes * by[:, None],
        packing_residuals=KNOWN.packing_residuals * by,
    )  # fmt: skip
    same = from_vectors(KNOWN.features, SAMPLE.specimens * by)
    ours, theirs = (
        [baselines._criterion(d, s, key) for key in ((), (0,), (3,))]
        for d, s in ((KNOWN, SAMPLE), (other, same))
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
