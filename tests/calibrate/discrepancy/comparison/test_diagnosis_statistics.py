"""Noise, projection, scores, gate, evidence and classes, where the answer is known.

Closed forms against the formulas in the files; rates by simulation in a made-up world
(`diagnosis_world`), with bounds from the binomial distribution.
"""

import numpy as np
import pytest
from scipy import integrate, stats

from calibrate.discrepancy.comparison.classes import (
    classes,
    separation,
)
from calibrate.discrepancy.comparison.compare import likeliest_verdict
from calibrate.discrepancy.comparison.evidence import (
    SCALES,
    Evidence,
    bivariate_normal,
    pairs,
    singles,
)
from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.lack_of_fit import null_distribution, statistics
from calibrate.discrepancy.comparison.noise import (
    PRIOR_SD_LN_AMPLITUDE,
    Shape,
    amplitude_of,
    best_shape,
    estimate,
    packing_covariance,
)
from calibrate.discrepancy.comparison.probability_calibration import (
    NAMED_BELOW,
    NONE,
    EvidenceSummary,
    ProbabilityCalibration,
    log_probabilities,
)
from calibrate.discrepancy.comparison.projection import Projected, fitted_shift, project, scores
from calibrate.discrepancy.comparison.refit import best_strengths
from calibrate.discrepancy.comparison.repeats import FREEDOM, Scatter, from_vectors, robust, weights
from calibrate.discrepancy.comparison.unspecified_gap import (
    AMPLITUDES,
    kernel_factors,
    log_bayes_factor,
    projected,
    rough,
    spectrum,
)
from calibrate.labtests.diagnosis.curves import declare_before_contact
from tests.support import diagnosis_world as generator

M = len(generator.FEATURES)
KNOWN = generator.description()
MEAN_COVARIANCE = generator.scatter() / 4 * (generator.PLAN.astype(float).T @ generator.PLAN > 0)


def plain(residual=None) -> Projected:
    r = np.zeros(M) if residual is None else residual
    return project(r, KNOWN.base_slopes, KNOWN.prior_sd, KNOWN.effect_slopes, MEAN_COVARIANCE)


# ------------------------------------------------------------------ noise


def test_the_shape_that_predicts_best_beats_the_raw_covariance():
    """Distance to the true covariance, whitened by it, from thirty specimens of 51 features."""
    samples = generator.draws(generator.scatter(), 30, 5)
    samples = samples - samples.mean(axis=0)
    root = np.linalg.inv(np.linalg.cholesky(generator.scatter()))

    def loss(covariance):
        white = root @ covariance @ root.T
        return np.trace(white) - np.linalg.slogdet(white)[1] - M

    ours = loss(best_shape(samples).of(samples))
    diagonal = loss(Shape(weight=1.0).of(samples))
    assert ours < 0.5 * diagonal


def test_a_shape_keeps_every_variance():
    samples = generator.draws(generator.scatter(), 60, 6)
    samples = samples - samples.mean(axis=0)
    for shape in (Shape(factors=3), Shape(weight=0.2)):
        np.testing.assert_allclose(
            np.diag(shape.of(samples)), samples.var(axis=0, ddof=1), rtol=0.02
        )


@pytest.mark.parametrize("true", [0.6, 1.0, 1.7])
def test_the_amplitude_comes_back_from_repeats(true):
    """Twelve specimens outweigh the prior about 1."""
    covariance = generator.scatter()
    tiny = 1e-6 * np.diag(np.diag(covariance))
    found = []
    for seed in range(30):
        rows = true * generator.draws(covariance, 12, seed)
        rows = rows - rows.mean(axis=0)
        found.append(amplitude_of(covariance, tiny, Scatter(rows.T @ rows, 11)))
    ln, sd = np.log([a for a, _ in found]), np.mean([s for _, s in found])
    assert abs(ln.mean() - np.log(true)) < 0.12
    assert 0.6 < ln.std() / sd < 1.6  # the stated deviation is that of repetitions


def test_without_repeats_the_amplitude_is_the_prior():
    value, sd = amplitude_of(generator.scatter(), np.zeros((M, M)), None)
    assert value == pytest.approx(1.0, abs=1e-6)
    assert sd == pytest.approx(PRIOR_SD_LN_AMPLITUDE, abs=0.02)


def test_the_mean_of_four_and_the_simulated_mean_add_up():
    packing = packing_covariance(KNOWN)
    noise = estimate(KNOWN, generator.case(1), packing, np.zeros(5))
    expected = noise.specimen[0, 0] / 4 + packing[0, 0] / KNOWN.mean_specimens
    assert noise.mean[0, 0] == pytest.approx(expected, rel=1e-9)


def test_a_mean_that_one_slipping_specimen_pulled_is_no_gap():
    """Eight deviations of one of four specimens: four of the mean, less once repeats have spoken;
    directions along which nobody slips keep about their variance."""
    packing = packing_covariance(KNOWN)
    mine = np.flatnonzero(generator.CONFINED_ONES)
    sd = np.sqrt(np.diag(packing))[mine]
    values, axes = np.linalg.eigh(packing[np.ix_(mine, mine)] / np.outer(sd, sd))
    local, broad = (np.zeros(M), np.zeros(M))
    local[mine], broad[mine] = (sd * axes[:, i] * np.sqrt(values[i]) for i in (2, -1))

    def deviations(slip: float) -> np.ndarray:
        rows = KNOWN.mean + generator.draws(packing, 4, 3)
        rows[0] += slip * local
        noise = estimate(KNOWN, from_vectors(generator.FEATURES, rows), packing, np.zeros(5))
        inverse = np.linalg.inv(noise.specimen / 4)
        return np.array([1 / np.sqrt(d @ inverse @ d) for d in (local, broad)])

    calm, slipping = deviations(0.0), deviations(8.0)
    pulled = 2.0  # deviations of a specimen, by which the mean moves
    assert pulled / calm[0] > 3.0
    assert pulled / slipping[0] < 2.0
    assert slipping[1] == pytest.approx(calm[1], rel=0.4)


# ------------------------------------------------------------------ projection and scores


def test_the_projected_residual_is_standard_normal_and_blind_to_base_parameters():
    operator = plain().operator
    prior = np.diag(KNOWN.prior_sd**2)
    marginal = MEAN_COVARIANCE + KNOWN.base_slopes @ prior @ KNOWN.base_slopes.T
    np.testing.assert_allclose(operator @ marginal @ operator.T, np.eye(M), atol=1e-6)


def test_the_determinant_is_that_of_the_marginal_covariance():
    prior = np.diag(KNOWN.prior_sd**2)
    marginal = MEAN_COVARIANCE + KNOWN.base_slopes @ prior @ KNOWN.base_slopes.T
    assert plain().log_determinant == pytest.approx(np.linalg.slogdet(marginal)[1], rel=1e-9)


def test_an_effect_that_base_parameters_mimic_is_invisible():
    mimic = KNOWN.base_slopes @ np.ones(5)
    wide = 1e4 * np.ones(5)
    design = project(np.zeros(M), KNOWN.base_slopes, wide, mimic[:, None], MEAN_COVARIANCE)
    assert scores(design, mimic[:, None], MEAN_COVARIANCE).visibility[0] < 1e-3


def test_one_step_strength_is_the_refitted_strength():
    """In a linear world the score's one step is the joint least-squares solution."""
    gap = 1.3 * KNOWN.effect_slopes[:, 3]
    residual = generator.draws(MEAN_COVARIANCE, 1, 8)[0] + gap
    found = scores(plain(residual), KNOWN.effect_slopes, MEAN_COVARIANCE)
    slopes = np.hstack([KNOWN.base_slopes, KNOWN.effect_slopes[:, [3]]])
    joint, _ = fitted_shift(residual, slopes, np.append(KNOWN.prior_sd, 1e6), MEAN_COVARIANCE)
    assert found.strength[3] == pytest.approx(joint[-1], rel=1e-6)


def test_scores_of_points_taken_as_independent_do_not_hold_their_rate():
    """Why the covariance of specimens matters: the same test with points as the sample."""
    draws = generator.draws(MEAN_COVARIANCE, 400, 9)
    independent = np.diag(np.diag(MEAN_COVARIANCE))
    rates = []
    for covariance in (MEAN_COVARIANCE, independent):
        design = project(
            np.zeros(M), KNOWN.base_slopes, KNOWN.prior_sd, KNOWN.effect_slopes, covariance
        )
        z = draws @ design.operator.T @ design.effects / np.linalg.norm(design.effects, axis=0)
        rates.append((np.abs(z) > 1.96).mean())
    assert 0.03 < rates[0] < 0.07
    assert not 0.02 < rates[1] < 0.10


# ------------------------------------------------------------------ gate


def test_the_smallest_p_value_of_three_is_itself_a_p_value():
    rng = np.random.default_rng(2)
    known = null_distribution(rng.standard_normal((500, 3)))
    p = [known.p_value(rng.standard_normal(3)) for _ in range(400)]
    low, high = stats.binom.ppf([0.001, 0.999], 400, 0.1) / 400
    assert low - 0.02 <= np.mean(np.array(p) <= 0.1) <= high + 0.02


def test_statistics_see_an_effect():
    design = plain(5 * KNOWN.effect_slopes[:, 2])
    kernel = projected(kernel_factors(generator.FEATURES, generator.scatter()), design.operator)
    quiet = statistics(np.zeros(M), design.effects, KNOWN.one_sided, kernel)
    loud = statistics(design.residual, design.effects, KNOWN.one_sided, kernel)
    assert (loud > quiet).all()


# ------------------------------------------------------------------ evidence


def small_design(seed=0) -> Projected:
    rng = np.random.default_rng(seed)
    effects = rng.standard_normal((6, 2)) * 1.5
    return Projected(np.eye(6), effects @ [1.0, 0.4] + rng.standard_normal(6), effects, 0.0)


@pytest.mark.parametrize("one_sided", [True, False])
def test_evidence_of_one_effect_is_its_integral(one_sided):
    design = small_design()
    g, r = design.effects[:, 0], design.residual

    def integrand(e, s):
        half = 2.0 if one_sided else 1.0
        like = np.exp(-0.5 * ((r - g * e) ** 2).sum() + 0.5 * (r**2).sum())
        return like * half * stats.norm.pdf(e, scale=s)

    low = 0.0 if one_sided else -10.0
    exact = np.mean(
        [integrate.quad(integrand, low, 10, args=(s,), points=[0, 1])[0] for s in SCALES]
    )
    one = Projected(design.operator, r, g[:, None], 0.0)
    assert singles(one, np.array([one_sided]))[0] == pytest.approx(np.log(exact), abs=1e-5)


@pytest.mark.parametrize("one_sided", [(True, True), (True, False), (False, True), (False, False)])
def test_evidence_of_a_pair_is_its_integral(one_sided):
    design = small_design(3)
    g, r = design.effects, design.residual
    factor = 2.0 ** sum(one_sided)
    total = []
    for s in SCALES:
        grids = [np.linspace(0 if side else -8 * s, 8 * s, 1201) for side in one_sided]
        a, b = np.meshgrid(*grids, indexing="ij")
        prior = stats.norm.pdf(a, scale=s) * stats.norm.pdf(b, scale=s) * factor
        left = r[:, None, None] - g[:, 0, None, None] * a - g[:, 1, None, None] * b
        like = np.exp(-0.5 * (left**2).sum(axis=0) + 0.5 * (r**2).sum())
        total.append(integrate.simpson(integrate.simpson(prior * like, x=grids[1]), x=grids[0]))
    found = pairs(design, np.array(one_sided), np.array([[0, 1]]))[0]
    assert found == pytest.approx(np.log(np.mean(total)), abs=1e-3)


def test_bivariate_normal_is_that_of_scipy():
    rng = np.random.default_rng(4)
    for h, k, c in zip(*rng.uniform(-2, 2, (2, 12)), rng.uniform(-0.95, 0.95, 12), strict=True):
        exact = stats.multivariate_normal([0, 0], [[1, c], [c, 1]]).cdf([h, k])
        assert bivariate_normal(np.array([h]), np.array([k]), np.array([c]))[0] == pytest.approx(
            exact, abs=1e-5
        )


def test_evidence_of_a_smooth_gap_is_that_of_the_normal_distribution():
    factor = np.random.default_rng(5).standard_normal((6, 3))
    residual = small_design().residual
    null = stats.multivariate_normal(np.zeros(6), np.eye(6)).logpdf(residual)

    terms = [
        stats.multivariate_normal(np.zeros(6), np.eye(6) + a**2 * factor @ factor.T).logpdf(
            residual
        )
        - null
        for a in AMPLITUDES
    ]
    exact = np.logaddexp.reduce(terms) - np.log(len(terms))
    assert log_bayes_factor(spectrum([factor], residual)) == pytest.approx(exact, abs=1e-8)


def test_a_rough_discrepancy_is_noise_of_another_size():
    residual = np.random.default_rng(9).standard_normal(12) * 3
    terms = [stats.norm(0, np.sqrt(1 + a**2)).logpdf(residual).sum() for a in AMPLITUDES]
    null = stats.norm.logpdf(residual).sum()
    exact = np.logaddexp.reduce(terms) - np.log(len(terms)) - null
    assert log_bayes_factor([rough(residual)]) == pytest.approx(exact, abs=1e-8)


# -------------------------------------------- classes, refit, probabilities


def test_classes_join_what_is_alike_and_respect_signs():
    c = np.array([[1, 0.99, -0.99], [0.99, 1, -0.98], [-0.99, -0.98, 1]])
    visible = np.ones(3)
    signed = classes(("a", "b", "c"), c, np.array([True, True, True]), visible)
    assert signed.alike() == [["a", "b"]]
    free = classes(("a", "b", "c"), c, np.array([True, True, False]), visible)
    assert free.alike() == [["a", "b", "c"]]
    assert separation(c, np.array([True, True, True]))[0, 2] == 1.0


def test_strengths_at_the_bound():
    gram, pull = np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([2.0, -1.0])
    np.testing.assert_allclose(best_strengths(gram, pull, np.array([True, True])), [1.0, 0.0])
    free = best_strengths(gram, pull, np.array([False, False]))
    np.testing.assert_allclose(free, np.linalg.solve(gram, pull))


def summary(singles_, unknown=0.0, p_before=0.5) -> EvidenceSummary:
    found = Evidence(np.array(singles_), np.zeros(1), np.array([[0, 1]]), unknown)
    return EvidenceSummary(("a", "b"), found, p_before, 0.5)


def test_probabilities_sum_to_one_and_follow_evidence():
    p = np.exp(log_probabilities(summary([0.4, 0.1]), ProbabilityCalibration()))
    assert p.sum() == pytest.approx(1.0)
    assert p[1] > p[2] and p[1] / p[2] == pytest.approx(np.exp(0.3), rel=0.01)


def test_an_explanation_that_could_not_be_fitted_is_none():
    p = np.exp(log_probabilities(summary([np.nan, 3.0], unknown=-np.inf), ProbabilityCalibration()))
    assert p.sum() == pytest.approx(1.0)
    assert p[1] < 1e-9 and p[2] > 0.9 * p[2:].sum()


def test_much_evidence_counts_less_than_in_proportion():
    def odds(first: float, second: float) -> float:
        p = log_probabilities(summary([first, second]), ProbabilityCalibration())
        return p[1] - p[2]

    assert odds(0.3, 0.0) == pytest.approx(0.3, rel=0.01)
    assert odds(1000.3, 1000.0) == pytest.approx(0.3, rel=0.01)
    assert odds(1000.0, 500.0) < odds(1000.0, 0.0) < 25


def test_the_generated_world_has_the_covariance_that_the_noise_states():
    generated = SampleGenerator(KNOWN, generator.PLAN, packing_covariance(KNOWN))
    rng = np.random.default_rng(8)
    every = np.array([generated.specimens(rng) for _ in range(400)])
    drawn = generated.sample(every).mean - KNOWN.mean
    prior = np.diag(KNOWN.prior_sd**2)
    expected = np.diag(generated.mean_covariance + KNOWN.base_slopes @ prior @ KNOWN.base_slopes.T)
    ratio = drawn.var(axis=0) / expected
    assert ratio.min() > 0.7 and ratio.max() < 1.35


def test_something_is_named_where_none_is_unlikely_enough():
    less, more = NAMED_BELOW - 0.01, NAMED_BELOW + 0.01
    assert likeliest_verdict({NONE: less, "wall_friction": 0.7}) == "wall_friction"
    assert likeliest_verdict({NONE: more, "wall_friction": 0.7}) == NONE
    assert likeliest_verdict({NONE: less, "a": 0.2, "b": 0.2, "c": 0.2}) == NONE


# ---- odd specimens: the weights of a multivariate t, and what they spare a mean

SMALL_SCATTER = np.diag([1.0, 4.0, 0.25])
SPECIMENS_RNG = np.random.default_rng(0)


def three_features(count: int = 4) -> np.ndarray:
    return SPECIMENS_RNG.multivariate_normal([3.0, -2.0, 10.0], SMALL_SCATTER, size=count)


def test_specimens_that_scatter_as_simulated_nearly_all_count_in_full():
    found = np.array([weights(three_features(), SMALL_SCATTER) for _ in range(400)])
    assert found.mean() > 0.9 and found.max() == 1.0


def test_one_far_off_hardly_moves_the_mean():
    plain, robust_means, odd = [], [], []
    for _ in range(200):
        sample = three_features()
        sample[2] += [9.0, 0.0, 0.0]
        weight = weights(sample, SMALL_SCATTER)
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
    w = weights(sample, SMALL_SCATTER)[0]
    away = (8.0 - 8.0 * w / (3 + w)) ** 2 * 4 / 3
    assert w == pytest.approx((FREEDOM + 3) / (FREEDOM + away), rel=1e-3)


def test_what_is_not_measured_does_not_speak_and_two_specimens_are_left_alone():
    sample = three_features()
    sample[1, 0] = np.nan
    assert np.isfinite(weights(sample, SMALL_SCATTER)).all()
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
