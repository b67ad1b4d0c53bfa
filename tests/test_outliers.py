"""Odd specimens: the weights of a multivariate t, and what they spare a mean."""

import diagnosis_world as generator
import numpy as np
import pytest

from calibrate.discrepancy.comparison.noise import amplitude_of
from calibrate.discrepancy.comparison.outliers import FREEDOM, robust, weights
from calibrate.discrepancy.comparison.repeats import from_vectors
from calibrate.labtests.diagnosis.curves import declare_before_contact

SCATTER = np.diag([1.0, 4.0, 0.25])
RNG = np.random.default_rng(0)


def rows(count: int = 4) -> np.ndarray:
    return RNG.multivariate_normal([3.0, -2.0, 10.0], SCATTER, size=count)


def test_specimens_that_scatter_as_simulated_nearly_all_count_in_full():
    found = np.array([weights(rows(), SCATTER) for _ in range(400)])
    assert found.mean() > 0.9 and found.max() == 1.0


def test_one_far_off_hardly_moves_the_mean():
    plain, robust_means, odd = [], [], []
    for _ in range(200):
        sample = rows()
        sample[2] += [9.0, 0.0, 0.0]
        weight = weights(sample, SCATTER)
        odd.append(weight[2])
        plain.append(sample[:, 0].mean())
        robust_means.append(weight @ sample[:, 0] / weight.sum())
    assert np.mean(odd) < 0.2
    assert np.mean(plain) == pytest.approx(5.25, abs=0.15)
    assert np.mean(robust_means) == pytest.approx(3.4, abs=0.25)


def test_repeats_that_all_scatter_widely_are_not_odd_and_say_so():
    """Twice the scatter of simulated specimens: the amplitude is found as without weights."""
    rng, wide = np.random.default_rng(4), generator.scatter()
    features = generator.FEATURES
    fixed, found, plain = 1e-6 * np.eye(len(features)), [], []
    confined = np.flatnonzero([f.test == "confined" for f in features])
    block = np.ix_(confined, confined)
    for _ in range(30):
        rows = 2 * generator.draws(wide, 4, int(rng.integers(2**31)))
        sample = from_vectors(features, rows)
        for estimated, amplitudes in ((robust(sample, wide), found), (sample, plain)):
            scatter = estimated.scatter["confined"]
            amplitudes.append(amplitude_of(wide[block], fixed[block], scatter)[0])
    assert np.mean(found) > 0.85 * np.mean(plain) and np.mean(plain) > 1.25


def test_one_test_speaks_for_itself_and_forces_before_contact_do_not():
    rng, features = np.random.default_rng(5), (*generator.FEATURES, *declare_before_contact())
    m = len(generator.FEATURES)
    wide = np.eye(m + 2)
    wide[:m, :m] = generator.scatter()
    rows = np.hstack([generator.draws(generator.scatter(), 7, 3), 50 * rng.standard_normal((7, 2))])
    rows[:4, [i for i, f in enumerate(features) if f.test == "unconfined"]] = np.nan
    rows[4:, [i for i, f in enumerate(features) if f.test == "confined"]] = np.nan
    assert robust(from_vectors(features, rows), wide).weight.mean() > 0.85
    rows[1, 0] += 40 * np.sqrt(wide[0, 0])
    weight = robust(from_vectors(features, rows), wide).weight
    assert weight[1] < 0.3 and weight[[0, 2, 3]].mean() > 0.7


def test_a_weight_is_that_of_students_t():
    """Three alike and one at a distance: the weight solves its own equation."""
    sample = np.zeros((4, 3))
    sample[0, 0] = 8.0
    w = weights(sample, SCATTER)[0]
    away = (8.0 - 8.0 * w / (3 + w)) ** 2 * 4 / 3
    assert w == pytest.approx((FREEDOM + 3) / (FREEDOM + away), rel=1e-3)


def test_what_is_not_measured_does_not_speak_and_two_specimens_are_left_alone():
    sample = rows()
    sample[1, 0] = np.nan
    assert np.isfinite(weights(sample, SCATTER)).all()
    measured = from_vectors(generator.FEATURES, np.ones((2, len(generator.FEATURES))))
    assert robust(measured, np.eye(len(generator.FEATURES))) is measured


def test_a_weighted_mean_is_less_sure():
    """Weights 1, 1, 1/2: mean and its variance over that of one by hand."""
    values = np.tile([[1.0], [2.0], [6.0]], (1, len(generator.FEATURES)))
    found = from_vectors(generator.FEATURES, values, np.array([1.0, 1.0, 0.5]))
    assert found.mean[0] == pytest.approx(6 / 2.5)
    assert found.weights()[0, 1] == pytest.approx(2.25 / 2.5**2)
    assert found.counts[0] == pytest.approx(2.5**2 / 2.25)
    left = found.without(1)
    assert left.mean[0] == pytest.approx(4 / 1.5)
