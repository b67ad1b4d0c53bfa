"""The answers, in a made-up linear world: which, where, how far, next test, and the report.

One library is prepared for all tests; cases come from the true covariance, which the
diagnosis only knows from sixty simulated specimens (`diagnosis_world`).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad
from scipy.optimize import brentq

from calibrate.discrepancy.comparison import fits, next_test
from calibrate.discrepancy.comparison.compare import (
    Comparison,
    Prepared,
    compare,
    design_classes,
    label,
    prepare,
)
from calibrate.discrepancy.comparison.fits import HOPELESS, covariance_at, fitted_base
from calibrate.discrepancy.comparison.further import (
    ALL,
    STAYS,
    FurtherTest,
    LinearResponse,
    Prediction,
    predicted,
    stacked,
)
from calibrate.discrepancy.comparison.generated import plan_of
from calibrate.discrepancy.comparison.linear import EffectCandidate
from calibrate.discrepancy.comparison.localise import localise
from calibrate.discrepancy.comparison.next_test import Explanation, Outcome, next_tests, updated
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.comparison.probability_calibration import ProbabilityCalibration
from calibrate.discrepancy.comparison.reduction import (
    distortions,
    estimate_reduction,
    feature_weights,
    shrinkage,
)
from calibrate.discrepancy.comparison.refit import local_minima, refit, start_at, weighed
from calibrate.discrepancy.comparison.repeats import from_targets, from_vectors
from calibrate.discrepancy.comparison.verdict import as_json, effect_estimates, status
from calibrate.labtests.diagnosis.confined import NAME as CONFINED
from calibrate.labtests.diagnosis.curves import declare_targets
from calibrate.labtests.diagnosis.unconfined import NAME as UNCONFINED
from studies.sealed.baselines import strength_of
from tests.support import diagnosis_world as generator
from tests.support.diagnosis_world import simple

KNOWN = generator.description()
NULLS, STRONG = 60, 24


@cache
def with_nulls() -> Prepared:
    return prepare(KNOWN, generator.PLAN, seed=1, draws=120)


def gap_of(effect: int, snr: float) -> np.ndarray:
    """What one effect does at a signal-to-noise."""
    return strength_of(with_nulls().generator, effect, snr) * KNOWN.effect_slopes[:, effect]


def base_of(prepared: Prepared, sample):
    """The noise of a sample and the fit without effects."""
    return fitted_base(
        prepared.description, sample, prepared.generator.packing, prepared.null.inflation
    )


@cache
def answered(effect: int, snr: float, seed: int) -> Comparison:
    return compare(with_nulls(), generator.case(seed, gap_of(effect, snr)))


# ------------------------------------------------------------------ which


def test_false_alarms_stay_near_five_per_cent():
    """At most what 5 % would give in 999 of 1000 such tests."""
    alarms = sum(compare(with_nulls(), generator.case(s)).verdict != "none" for s in range(NULLS))
    assert alarms <= stats.binom.ppf(0.999, NULLS, 0.05)


def test_strong_effects_are_named():
    right = 0
    for seed in range(STRONG):
        effect = seed % generator.EFFECTS
        found = answered(effect, 12.0, 500 + seed)
        right += found.verdict == label(with_nulls().classes, (f"e{effect}",))
    assert right >= stats.binom.ppf(0.01, STRONG, 0.85)


def test_a_gap_that_no_effect_makes_is_not_called_an_effect():
    """A narrow dent in both curves, at a signal-to-noise of 20."""
    dent = generator.UNIT * np.exp(-0.5 * ((generator.PLACE % 1.5 - 0.45) / 0.03) ** 2)
    dent *= 20 / with_nulls().generator.snr(dent[:, None])[0]
    verdicts = [compare(with_nulls(), generator.case(900 + s, dent)).verdict for s in range(6)]
    assert verdicts.count("unknown") >= 4


def test_probabilities_are_whole_and_the_set_holds_the_verdict():
    found = answered(2, 12.0, 1)
    assert sum(found.probability.values()) == pytest.approx(1.0)
    assert sum(found.by_class.values()) == pytest.approx(1.0)
    assert found.verdict in found.likely_set
    assert {"none", "unknown", "e0 + e1"} <= set(found.probability)


def test_an_effect_that_is_no_candidate_is_not_named():
    plan = replace(with_nulls().generator, description=KNOWN.without_effects(["e2"]))
    fewer = replace(with_nulls(), generator=plan, classes=design_classes(plan))
    assert "e2" not in fewer.description.effect_names
    found = compare(fewer, generator.case(3, gap_of(2, 20.0)))
    assert "e2" not in found.probability
    assert found.verdict != "none"


def test_the_gap_is_said_to_shrink_by_the_effect_that_is_named():
    """Not by that with the largest evidence, where the calibration prefers another one."""
    plain = answered(2, 12.0, 1)
    names, classes = KNOWN.effect_names, with_nulls().classes
    others = [k for (k, *more) in plain.refits if not more and names[k] not in classes.of("e2")]
    assert plain.best == (2,) and others
    prepared = replace(
        with_nulls(),
        calibration=ProbabilityCalibration(pair=-200.0, class_bias={names[others[0]]: 90.0}),
    )
    found = compare(prepared, generator.case(1, gap_of(2, 12.0)))
    assert found.verdict == label(classes, (names[others[0]],))
    assert found.best == (others[0],)


def test_scalar_targets_alone_get_an_honest_answer():
    """Two numbers and seven parameters: nothing can be told."""
    features = declare_targets(["depression_depth_mm", "crushing_force_n"])
    rng = np.random.default_rng(4)
    base = {f"b{i}": (rng.standard_normal(2) * [1.0, 60.0], 0.5) for i in range(7)}
    effects = [
        (EffectCandidate(f"e{k}", True, 1.0), rng.standard_normal(2) * [0.3, 20]) for k in range(3)
    ]
    residuals = rng.standard_normal((30, 2)) * [0.3, 20]
    known = simple(features, np.array([3.4, 200.0]), base, effects, residuals)
    values = {"depression_depth_mm": (3.36, 0.3, 4), "crushing_force_n": (206.0, 20.0, 4)}
    sample = from_targets(features, values)
    prepared = prepare(known, plan_of(sample), seed=2, draws=60)
    found = compare(prepared, sample)
    assert found.verdict == "none"
    assert {r.status for r in effect_estimates(prepared, found)} <= {"inconclusive", "absent"}


@dataclass(frozen=True, eq=False)
class Formula:
    """An emulator by formula, wrong by the same everywhere but for what `errors` adds."""

    at: Callable
    errors: Callable = lambda delta, strengths: np.zeros((len(KNOWN.mean), 0))

    def __call__(self, delta, strengths):
        return self.at(delta, strengths)

    def wrong(self, delta, strengths):
        return np.column_stack([KNOWN.wrong, self.errors(delta, strengths)])


def test_an_emulator_that_is_linear_changes_nothing():
    def at(delta, strengths):
        values = KNOWN.mean + KNOWN.base_slopes @ delta + KNOWN.effect_slopes @ strengths
        return values, KNOWN.base_slopes, KNOWN.effect_slopes

    bent = replace(KNOWN, emulator=Formula(at))
    bent_one = replace(with_nulls(), generator=replace(with_nulls().generator, description=bent))
    sample = generator.case(7, gap_of(5, 8.0))
    one, other = compare(with_nulls(), sample), compare(bent_one, sample)
    assert one.verdict == other.verdict
    np.testing.assert_allclose(
        one.summary.evidence.singles, other.summary.evidence.singles, atol=0.02
    )


def test_a_fit_finds_a_bent_truth():
    def at(delta, strengths):
        bend = 1 + 0.3 * strengths[2]
        values = KNOWN.base_slopes @ delta + KNOWN.effect_slopes[:, 2] * strengths[2] * bend
        slopes = np.zeros_like(KNOWN.effect_slopes)
        slopes[:, 2] = KNOWN.effect_slopes[:, 2] * (1 + 0.6 * strengths[2])
        return values, KNOWN.base_slopes, slopes

    bent = replace(KNOWN, emulator=Formula(at))
    strengths = np.zeros(generator.EFFECTS)
    strengths[2] = 1.5
    truth = at(np.zeros(5), strengths)[0]
    found = refit(bent, truth, 1e-4 * generator.scatter(), [2])
    assert found.strengths[2] == pytest.approx(1.5, abs=0.01)


def test_a_fit_follows_a_bent_valley_to_its_end():
    """Rosenbrock's valley, from its wrong end: each full step would leave it."""
    along, across = 30 * KNOWN.base_slopes[:, 0], 300 * KNOWN.effect_slopes[:, 2]

    def at(delta, strengths):
        values = along * delta[0] + across * (strengths[2] - delta[0] ** 2)
        base, effects = np.zeros_like(KNOWN.base_slopes), np.zeros_like(KNOWN.effect_slopes)
        base[:, 0] = along - 2 * delta[0] * across
        effects[:, 2] = across
        return values, base, effects

    bent = replace(KNOWN, emulator=Formula(at))
    truth = at(np.eye(5)[0], np.eye(generator.EFFECTS)[2])[0]
    start = start_at(bent, -3 * np.eye(5)[0], 2, 9.0)
    found = refit(bent, truth, 1e-4 * generator.scatter(), [2], start)
    assert found.delta[0] == pytest.approx(1.0, abs=0.01)
    assert found.strengths[2] == pytest.approx(1.0, abs=0.01)


def first_the_other_way():
    """A description whose one-sided effect 2 acts as e^2 - e: at strength 0 its slope points
    away."""
    column = 30 * KNOWN.effect_slopes[:, 2]

    def at(delta, strengths):
        slopes = np.zeros_like(KNOWN.effect_slopes)
        slopes[:, 2] = column * (2 * strengths[2] - 1)
        value = strengths[2] ** 2 - strengths[2]
        return KNOWN.base_slopes @ delta + column * value, KNOWN.base_slopes, slopes

    positive = tuple(replace(effect, one_sided=True) for effect in KNOWN.effects)
    return replace(KNOWN, emulator=Formula(at), effects=positive)


def test_the_best_of_several_starts_finds_a_strength_that_first_pulls_the_other_way():
    bent = first_the_other_way()
    truth = bent.at(np.zeros(5), np.eye(generator.EFFECTS)[2] * 2.0)[0]
    near, far = start_at(bent), start_at(bent, effect=2, strength=3.0)
    stuck = refit(bent, truth, generator.scatter(), [2], near)
    found, other = local_minima(bent, truth, generator.scatter(), [2], [near, far, far])
    assert stuck.strengths[2] == other.strengths[2] == 0.0
    assert found.strengths[2] == pytest.approx(2.0, abs=0.1)
    assert found.objective < 0.5 * stuck.objective


def test_a_fit_that_begins_less_likely_and_ends_likelier_is_found(monkeypatch: pytest.MonkeyPatch):
    """By the noise at its centre a fit stops short of the minimum by the noise where it ends, and
    is the less likely one there."""
    bent, noise = first_the_other_way(), generator.scatter()
    truth = bent.at(np.zeros(5), np.eye(generator.EFFECTS)[2] * 2.0)[0]
    stuck = refit(bent, truth, noise, [2], start_at(bent))

    def short(by: float):
        point = start_at(bent, by * bent.prior_sd, 2, 2.0)
        first = replace(stuck, delta=point[0], strengths=point[1], values=bent.at(*point)[0])
        return weighed(bent, truth, noise, first)

    by = brentq(lambda by: short(by).objective - stuck.objective - HOPELESS / 2, 0.0, 1e3)
    monkeypatch.setattr(fits, "local_minima", lambda *_: [stuck, short(by)])
    alone = Noise(noise, noise, {}, {})
    found = fits._Fitter(bent, truth, alone, 1.0).likeliest((2,), [])
    assert short(by).objective > stuck.objective > 2 * found.objective
    assert found.strengths[2] == pytest.approx(2.0, abs=0.1)


def test_a_fit_far_away_is_weighed_by_what_the_emulator_is_wrong_by_there():
    """Known values at strength 0, next to nothing known of effect 2 at strength 1."""

    def at(delta, strengths):
        values = KNOWN.mean + KNOWN.base_slopes @ delta + KNOWN.effect_slopes @ strengths
        return values, KNOWN.base_slopes, KNOWN.effect_slopes

    def errors(delta, strengths):
        return 10 * strengths[2] * KNOWN.effect_slopes[:, [2]]

    bent = replace(KNOWN, emulator=Formula(at, errors))
    bent_one = replace(with_nulls(), generator=replace(with_nulls().generator, description=bent))
    sample = generator.case(7, gap_of(2, 12.0))
    known, vague = compare(with_nulls(), sample), compare(bent_one, sample)
    fit = vague.refits[(2,)]
    excess = fit.covariance - vague.noise.mean
    shape = np.outer(KNOWN.effect_slopes[:, 2], KNOWN.effect_slopes[:, 2])
    np.testing.assert_allclose(excess / np.trace(excess), shape / np.trace(shape), atol=1e-6)
    assert np.trace(excess) > np.trace(shape)
    where_it_ends = covariance_at(bent, vague.noise, fit)
    np.testing.assert_allclose(fit.covariance, where_it_ends, rtol=1e-9)
    assert vague.summary.evidence.singles[2] < known.summary.evidence.singles[2]


def test_a_pair_never_ends_below_its_parts(monkeypatch: pytest.MonkeyPatch):
    """Fits of pairs that descend to a poor place: the best fit of one of the two stands."""

    def poor(d, measured, covariance, chosen, starts):
        if len(chosen) < 2:
            return local_minima(d, measured, covariance, chosen, starts)
        far = start_at(d, 50 * d.prior_sd)
        return [replace(refit(d, measured, covariance, (), far), chosen=chosen, delta=far[0])]

    monkeypatch.setattr(fits, "local_minima", poor)
    found = compare(with_nulls(), generator.case(7, gap_of(2, 12.0)))
    pairs = [key for key in found.refits if len(key) == 2]
    parts = {key: [found.refits[(k,)] for k in key if (k,) in found.refits] for key in pairs}
    assert any(parts.values())
    for key, alone in parts.items():
        for part in (found.base, *alone):
            assert _unlikely(found.refits[key]) <= _unlikely(part) + 1e-6


def _unlikely(fit) -> float:
    """Minus twice the log posterior density, up to a constant."""
    return fit.objective + float(np.linalg.slogdet(fit.covariance)[1])


# ------------------------------------------------------------------ where


def test_the_segment_that_differs_is_flagged_and_holds_the_share():
    """A toe of the unconfined test that is off by six deviations of the mean."""
    toe = np.array([f.test == UNCONFINED and f.segment == "toe" for f in generator.FEATURES])
    sample = generator.case(21, 30.0 * toe)
    noise, base = base_of(with_nulls(), sample)
    found = localise(KNOWN, sample, noise, base, seed=0)
    rows = {(s.test, s.segment): s for s in found.segments}
    assert rows[UNCONFINED, "toe"].outside_band
    assert rows[UNCONFINED, "toe"].share > 3 * rows[UNCONFINED, "toe"].share_by_chance
    assert sum(s.share for s in found.segments) == pytest.approx(1.0)
    assert all(low <= high for low, high in (s.share_interval for s in found.segments))


def test_bands_hold_everything_at_once():
    outside = 0
    for seed in range(NULLS):
        sample = generator.case(seed)
        noise, base = base_of(with_nulls(), sample)
        found = localise(KNOWN, sample, noise, base, seed=seed)
        outside += bool((np.abs(found.residual) > found.band).any())
    assert outside <= stats.binom.ppf(0.999, NULLS, 0.05)


def test_a_factor_on_one_test_shows_across_tests():
    """Base parameters nearly known, so that one test says what the other should be."""
    known = replace(KNOWN, mean=KNOWN.mean + 10 * generator.UNIT, prior_sd=np.full(5, 0.01))
    prepared = prepare(known, generator.PLAN, seed=1, draws=30)
    weaker = np.where(generator.CONFINED_ONES, 0.0, 2.0 * generator.UNIT)
    sample = generator.case(31, 10 * generator.UNIT + weaker, off_centre=0.0)
    noise, base = base_of(prepared, sample)
    across = {c.predicted: c for c in localise(known, sample, noise, base, seed=0).across}
    assert abs(across[UNCONFINED].factor - 1.2) < 4 * across[UNCONFINED].factor_se
    assert abs(across[CONFINED].factor - 1.0) < 4 * across[CONFINED].factor_se


def test_the_force_at_which_the_machine_turns_hides_no_factor_of_displacements():
    turn = [i for i, f in enumerate(KNOWN.features) if f.kind == "largest force"]
    quiet = np.where(np.isin(np.arange(len(KNOWN.mean)), turn), 1e-3, 1.0)
    d = replace(
        KNOWN, mean=KNOWN.mean + 10 * generator.UNIT, prior_sd=np.full(5, 0.01),
        base_slopes=KNOWN.base_slopes * quiet[:, None],
        packing_residuals=KNOWN.packing_residuals * quiet,
    )  # fmt: skip
    longer = np.where(generator.CONFINED_ONES & (quiet == 1), 2.0 * generator.UNIT, 0.0)
    sample = generator.case(31, 10 * generator.UNIT + longer, off_centre=0.0)
    sample = from_vectors(
        d.features, d.mean + longer + quiet * (sample.specimens - d.mean - longer)
    )
    noise, base = base_of(prepare(d, generator.PLAN, seed=1, draws=30), sample)
    across = {c.predicted: c for c in localise(d, sample, noise, base, seed=0).across}
    assert len(turn) == 1 and across[CONFINED].factor_se < 0.05
    assert abs(across[CONFINED].factor - 1.2) < 4 * across[CONFINED].factor_se


# ------------------------------------------------------------------ how far


def test_claimed_shrinkage_is_that_on_fresh_specimens():
    """Median error below ten points over strong effects, against 2000 fresh specimens' mean."""
    errors = []
    for seed in range(10):
        effect = seed % generator.EFFECTS
        gap = gap_of(effect, 12.0)
        sample = generator.case(700 + seed, gap)
        found = compare(with_nulls(), sample)
        fit = found.refits[(effect,)] if (effect,) in found.refits else found.refits[found.best]
        far = estimate_reduction(KNOWN, sample, found.noise, found.base, fit, seed=0)
        delta = KNOWN.prior_sd * np.random.default_rng(700 + seed).standard_normal(5)
        truth = KNOWN.base_slopes @ delta + gap
        weight = feature_weights(KNOWN, found.noise)
        real = shrinkage(*(weight @ (f.values - truth) ** 2 for f in (found.base, fit)))
        errors.append(abs(far.shrinkage - real))
        assert far.before >= far.floor and far.low <= far.high
        assert far.cross_validated is not None
        assert all(c >= far.shrinkage for c in far.ceilings.values())
    assert np.median(errors) < 0.10


def test_distortions_of_displacement_act_alike_in_both_tests():
    columns = distortions(KNOWN, generator.case(1))
    assert columns.shape[0] == len(generator.FEATURES)
    assert (np.abs(columns[generator.CONFINED_ONES]).max(axis=0) > 0).all()


# ------------------------------------------------------------------ next test


def test_the_test_that_differs_between_explanations_is_proposed():
    found, sample, blind, sharp = offered()
    proposals = next_tests(with_nulls(), found, sample.mean, [blind, sharp])
    assert [p.name for p in proposals] == ["sharp", "blind"]
    assert proposals[1].separation == pytest.approx(proposals[1].now, rel=1e-6)
    assert proposals[1].gain == pytest.approx(0.0, abs=0.02)
    assert proposals[0].gain > 0.2 and proposals[0].chance > proposals[0].chance_now + 0.1
    assert proposals[0].predicted["e2"][0] == pytest.approx(TELLING, rel=1e-6)


TELLING = 30.0


def offered():
    """A sample that two effects explain, a test that shows nothing, and one that shows one of them
    alone."""
    sample = generator.case(41, gap_of(2, 3.0))
    found = compare(with_nulls(), sample)
    none = LinearResponse(np.zeros(1), np.zeros((1, 5)), np.zeros((1, 8)))
    blind = FurtherTest("blind", 1.0, ("x",), none, np.eye(1), 4)
    telling = np.zeros((1, 8))
    telling[0, 2] = TELLING / found.refits[(2,)].strengths[2]
    response = replace(none, effect_slopes=telling)
    return found, sample, blind, replace(blind, name="sharp", cost=5.0, response=response)


def test_the_gain_of_a_test_is_what_it_tells_between_two_equal_explanations():
    """ln 2 where outcomes lie far apart, 0 where they are the same; between, by quadrature."""
    none = Prediction(np.zeros(1), np.eye(1))
    fits = answered(2, 12.0, 41).base
    likely = [Explanation(name, name, 0.5, fits) for name in ("none", "e1")]

    def gain_at(distance: float) -> tuple[float, float]:
        return next_test._worth(likely, [none, Prediction(np.array([distance]), np.eye(1))], 0)

    assert gain_at(0.0)[0] == pytest.approx(0.0, abs=1e-9)
    assert gain_at(1000.0) == pytest.approx((np.log(2), 1.0), abs=1e-3)
    far = Prediction(np.array([2.0]), np.eye(1))

    def term(y: float) -> float:
        p, q = (np.exp(float(each.log_density(np.array([y])))) for each in (none, far))
        return p * np.log(2 * p / (p + q))

    exact = quad(term, -60, 60, points=[0, 2])[0]
    assert gain_at(2.0)[0] == pytest.approx(exact, abs=0.05)


def test_an_outcome_moves_the_answer_to_what_foresaw_it():
    found, sample, blind, sharp = offered()
    moved, learned = updated(
        with_nulls(), found, sample.mean, [Outcome(sharp, np.array([TELLING]))]
    )
    assert learned.foreseen and moved.verdict == "e2"
    assert sum(p for name, p in moved.probability.items() if "e2" in name) > 0.99
    away, _ = updated(with_nulls(), found, sample.mean, [Outcome(sharp, np.zeros(1))])
    assert away.probability["e2"] < found.probability["e2"]
    same, _ = updated(with_nulls(), found, sample.mean, [Outcome(blind, np.zeros(1))])
    listed = {n: p for n, p in found.probability.items() if n in learned.before}
    total = sum(listed.values())
    for name, p in listed.items():
        assert same.probability[name] == pytest.approx(p / total, abs=1e-6)


def test_an_outcome_that_nothing_foresees_is_called_unknown():
    found, sample, blind, _ = offered()
    moved, learned = updated(with_nulls(), found, sample.mean, [Outcome(blind, np.array([500.0]))])
    assert not learned.foreseen
    assert moved.verdict == "unknown" and moved.probability["unknown"] > 0.9


def test_outcomes_of_one_soil_are_told_together():
    """Two tests that see a base parameter alone: their difference is surer than either."""
    found, sample, blind, _ = offered()
    seen = replace(blind.response, base_slopes=np.full((1, 5), 1e3))
    both = stacked([replace(blind, response=seen)] * 2)
    told = predicted(both, KNOWN, found.base, sample.mean)
    difference = np.array([1.0, -1.0])
    assert difference @ told.covariance @ difference == pytest.approx(2 * 1 / 4, rel=1e-6)
    assert told.covariance[0, 0] > 100


def test_an_emulator_errs_again_as_it_erred_at_first():
    """The first test made again: what fit and scatter leave of it is foreseen, but for scatter."""
    found, sample, blind, _ = offered()
    rows = np.arange(len(sample.mean))
    wrong = 50.0 * np.sqrt(np.diag(found.noise.specimen))[:, None]
    erring = replace(KNOWN, wrong=wrong)
    covariance = found.base.covariance + wrong @ wrong.T
    fit = refit(erring, sample.mean + 1.5 * wrong[:, 0], covariance)
    fit = replace(fit, covariance=covariance)
    response = replace(
        blind.response, mean=KNOWN.mean, base_slopes=KNOWN.base_slopes,
        effect_slopes=KNOWN.effect_slopes,
    )  # fmt: skip
    again = replace(
        blind, labels=tuple(map(str, rows)), response=Erring(response, wrong), rows=rows,
        specimen=found.noise.specimen,
    )  # fmt: skip
    first = sample.mean + 1.5 * wrong[:, 0]
    told = predicted(again, erring, fit, first)
    assert told.p_value(first) > 0.5
    assert np.abs(first - told.mean).max() < 0.1 * wrong.max()
    assert np.abs(first - fit.values).max() > 0.5 * wrong.max()
    assert told.covariance.trace() < 0.05 * (wrong**2).sum()


def test_what_a_fit_leaves_may_come_again_and_hardly_speaks_against_it():
    """However much is left: an outcome that shows it all again speaks for "unknown" by a factor
    below two, one that shows none of it against "unknown"."""
    found, _, blind, _ = offered()
    values = found.base.values
    response = replace(blind.response, mean=values[:1])
    again = replace(blind, response=response, rows=np.zeros(1, int))
    plain = replace(KNOWN, wrong=np.zeros((len(values), 0)))
    for left in (30.0, 3e3):
        data = values + left * np.eye(len(values))[0]
        every = [predicted(again, plain, found.base, data, stays) for stays in (STAYS, ALL)]
        named, unknown = ([float(p.log_density(y)) for y in (data[:1], values[:1])] for p in every)
        assert 0.3 < unknown[0] - named[0] < np.log(2)
        assert unknown[1] - named[1] < -1.0


@dataclass(frozen=True, eq=False)
class Erring:
    """A response that may be wrong along given directions (m, q)."""

    inner: LinearResponse
    directions: np.ndarray

    def __call__(self, delta, strengths):
        return self.inner(delta, strengths)

    def wrong(self, delta, strengths):
        return self.directions

    def scatter(self, strengths):
        return self.inner.scatter(strengths)


# ------------------------------------------------------------------ report and baselines


def test_the_report_has_the_contract_s_keys_and_is_json():
    sample = generator.case(51, gap_of(3, 12.0))
    found = compare(with_nulls(), sample)
    fit = found.refits[found.best]
    content = as_json(
        with_nulls(),
        localise(KNOWN, sample, found.noise, found.base, seed=0),
        found,
        estimate_reduction(KNOWN, sample, found.noise, found.base, fit, seed=0),
        [],
    )
    again = json.loads(json.dumps(content, allow_nan=False))
    assert {"where", "which", "how_far", "next_test"} <= set(again)
    assert {"test", "segment", "gap", "unit", "z", "share"} <= set(again["where"][0])
    assert {"verdict", "probability", "alike"} <= set(again["which"])
    assert {"before", "after", "interval", "floor", "ceiling"} <= set(again["how_far"])
    assert again["which"]["probability"]["none"] + again["which"]["probability"]["unknown"] <= 1


def test_the_reporting_rule():
    assert status(5.0, True, 1.0, 6.0) == "found"
    assert status(5.0, True, 0.1, 40.0) == "trivial"
    assert status(0.5, True, 0.1, 6.0) == "absent"
    assert status(0.5, True, 0.1, 1.0) == "inconclusive"
