"""Which further test would settle what these data leave open, and what a further test has settled.

Explanations h with probabilities p_h predict outcomes y (`further`).  A test is worth

    gain    I(h; y) = sum_h p_h E[ln q(y|h) - ln sum_j p_j q(y|j)]                        in nats
    chance  that the explanation which is likeliest afterwards is the right one

by simulation: the mutual information between model and datum (Lindley 1956, of which the criterion
of Box and Hill 1967, Technometrics 9, 57, is an upper bound; Cavagnaro et al. 2010, Neural
Computation 22, 887, use it between models).  Beside it stands the separation of explanations k and
l, the signal-to-noise with which the data at hand and a test together would tell k from l,

    s_k sqrt(1 - c_kl^2)     s, c of the projected effects of both data sets, stacked

(the linearised T-optimality of Harman and Mueller); that of a test is the smallest over all pairs,
no gap being an explanation too, with s alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import logsumexp

from calibrate.discrepancy.comparison.classes import SEPARABLE, TOGETHER, separation
from calibrate.discrepancy.comparison.compare import Comparison, Prepared, answered_with, label
from calibrate.discrepancy.comparison.further import (
    ALL,
    STAYS,
    FurtherTest,
    Prediction,
    predicted,
    stacked,
)
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.naming import BEYOND, FEW, MUTE
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.projection import confusability, lengths, project
from calibrate.discrepancy.comparison.refit import Refit

DRAWS = 400  # outcomes of each explanation
LEAST_LIKELY = 0.003  # explanations below are left out of gains
LEADING = 4  # explanations whose predictions are shown
SHOWN = 0.01  # probability of such an explanation, but for the likeliest
SURE = 0.95  # probability of a class from which on nothing more need be asked
WORTH = 0.03  # nats; a test that tells less is not worth making
BEFORE_TESTS = (MUTE, FEW, BEYOND)  # reasons that no further test removes
UNFORESEEN = 0.01  # chance of an outcome below which an explanation did not foresee it


@dataclass(frozen=True, eq=False)
class Explanation:
    """One explanation of the data at hand: its name, its class, probability, and fit."""

    name: str
    of_class: str
    probability: float
    fit: Refit


@dataclass(frozen=True, eq=False)
class Proposal:
    """A test with its cost (h), fresh specimens and gain (nats); chance to name the right class and
    separation of the leading explanations, now and with it; the pair it separates least;
    the outcome (m,) under each leading explanation, or under the only one and none, with deviations
    (m,); the entries of its table in a lab file."""

    name: str
    cost: float
    specimens: int
    gain: float
    chance_now: float
    chance: float
    now: float
    separation: float
    hardest: tuple[str, str]
    labels: tuple[str, ...]
    predicted: dict[str, np.ndarray]
    deviation: np.ndarray
    entries: Mapping[str, str | bool]

    @property
    def settles(self) -> bool:
        """Whether all leading explanations are told apart with 80 % power."""
        return self.separation >= SEPARABLE


@dataclass(frozen=True, eq=False)
class Outcome:
    """A further test that was made: what it showed (m,), the mean of its repeats."""

    test: FurtherTest
    found: np.ndarray


@dataclass(frozen=True)
class UpdatedBelief:
    """What further tests changed: their names, the probabilities before by explanation, and the
    chance of such an outcome under each."""

    tests: tuple[str, ...]
    before: dict[str, float]
    chance: dict[str, float]

    @property
    def foreseen(self) -> bool:
        """Whether any explanation foresaw the outcome."""
        return max(self.chance.values()) >= UNFORESEEN


def explanations(prepared: Prepared, comparison: Comparison) -> list[Explanation]:
    """None, the refitted effects and pairs, and unknown, with probabilities that add up to 1."""
    names, given = prepared.description.effect_names, comparison.probability
    rows = [(NONE, comparison.base), (UNKNOWN, comparison.base)]
    rows += [
        (TOGETHER.join(names[k] for k in sorted(key)), fit)
        for key, fit in comparison.refits.items()
    ]
    total = sum(given.get(name, 0.0) for name, _ in rows)
    return [
        Explanation(
            name, label(prepared.classes, tuple(name.split(TOGETHER))), given[name] / total, fit
        )
        for name, fit in rows
        if name in given
    ]


def predictions(
    test: FurtherTest, d: Linearised, every: Sequence[Explanation], measured: np.ndarray
) -> list[Prediction]:
    """What each explanation predicts for a test; measured (m,): means of the data at hand."""
    stays = (ALL if one.name == UNKNOWN else STAYS for one in every)
    each = zip(every, stays, strict=True)
    return [predicted(test, d, one.fit, measured, share) for one, share in each]


def next_tests(
    prepared: Prepared, comparison: Comparison, measured: np.ndarray,
    tests: Sequence[FurtherTest], seed: int = 0,
) -> list[Proposal]:  # fmt: skip
    """Proposals, the one that tells most first; none where no effect is refitted."""
    every = explanations(prepared, comparison)
    likely = [one for one in every if one.probability >= LEAST_LIKELY]
    leading = _leading(every, prepared.description)
    if not leading or len(likely) < 2:
        return []
    shown = leading if len(leading) > 1 else [*leading, every[0]]  # beside that nothing is left out
    proposals = [
        _proposal(prepared, comparison, measured, test, likely, leading, shown, seed)
        for test in tests
    ]
    return sorted(proposals, key=lambda p: (-p.gain, p.cost))


def why_stop(comparison: Comparison, proposals: Sequence[Proposal]) -> str:
    """Why no further test is proposed; "" where one is."""
    if comparison.reason in BEFORE_TESTS:
        return comparison.reason
    if max(comparison.by_class.values()) >= SURE and not comparison.reason:
        return UNKNOWN if comparison.verdict == UNKNOWN else "sure"
    if not proposals or proposals[0].gain < WORTH:
        return "nothing helps"
    return ""


def updated(
    prepared: Prepared, comparison: Comparison, measured: np.ndarray, outcomes: Sequence[Outcome]
) -> tuple[Comparison, UpdatedBelief]:
    """The comparison after further tests, and what they changed; where no explanation foresaw them,
    "unknown", as surely as the outcome is odd."""
    every = explanations(prepared, comparison)
    test = stacked([outcome.test for outcome in outcomes])
    found = np.concatenate([outcome.found for outcome in outcomes])
    told = predictions(test, prepared.description, every, measured)
    chance = {one.name: p.p_value(found) for one, p in zip(every, told, strict=True)}
    prior = np.array([max(one.probability, 1e-12) for one in every])
    score = np.log(prior) + np.array([float(p.log_density(found)) for p in told])
    after = np.exp(score - logsumexp(score))
    belief = UpdatedBelief(
        tuple(outcome.test.name for outcome in outcomes),
        {one.name: one.probability for one in every}, chance,
    )  # fmt: skip
    if not belief.foreseen:
        foreseen = max(chance.values()) / UNFORESEEN
        after = foreseen * after + (1 - foreseen) * np.array([one.name == UNKNOWN for one in every])
    probability = {one.name: float(p) for one, p in zip(every, after, strict=True)}
    return answered_with(prepared, comparison, probability), belief


def _leading(every: Sequence[Explanation], d: Linearised) -> list[Explanation]:
    """The likeliest single effects that are at work in their own fits."""
    single = [
        one for one in every
        if len(one.fit.chosen) == 1 and one.fit.strengths[one.fit.chosen[0]] != 0
        and one.name in d.effect_names
    ]  # fmt: skip
    order = sorted(single, key=lambda one: -one.probability)[:LEADING]
    return order[:1] + [one for one in order[1:] if one.probability >= SHOWN]


def _proposal(
    prepared: Prepared, comparison: Comparison, measured: np.ndarray, test: FurtherTest,
    likely: Sequence[Explanation], leading: Sequence[Explanation],
    shown: Sequence[Explanation], seed: int,
) -> Proposal:  # fmt: skip
    d = prepared.description
    gain, chance = _worth(likely, predictions(test, d, likely, measured), seed)
    now, apart = _separations_with(d, comparison, test, leading)
    names = [one.name for one in leading]
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    by_class = _by_class(
        [one.of_class for one in likely], np.array([[o.probability for o in likely]])
    )
    return Proposal(
        name=test.name, cost=test.cost, specimens=test.specimens,
        gain=gain, chance_now=float(by_class.max()), chance=chance,
        now=float(now.min()), separation=float(apart.min()),
        hardest=(names[i], names[j] if i != j else NONE),
        labels=test.labels,
        predicted={one.name: predicted(test, d, one.fit, measured).mean for one in shown},
        deviation=np.sqrt(np.diag(test.noise)),
        entries=test.entries,
    )  # fmt: skip


def _worth(
    likely: Sequence[Explanation], told: Sequence[Prediction], seed: int
) -> tuple[float, float]:
    """Gain and chance of naming the right class, by simulated outcomes."""
    share = np.array([one.probability for one in likely])
    share = share / share.sum()
    classes = [one.of_class for one in likely]
    rng = np.random.default_rng(seed)
    gain = chance = 0.0
    for own, p, one in zip(range(len(likely)), share, likely, strict=True):
        outcomes = told[own].drawn(rng, DRAWS)
        density = np.array([each.log_density(outcomes) for each in told])
        joint = density + np.log(share)[:, None]
        together = logsumexp(joint, axis=0)
        gain += p * float(np.mean(density[own] - together))
        after = _by_class(classes, np.exp(joint - together).T)
        best = np.array(list(dict.fromkeys(classes)))[after.argmax(axis=1)]
        chance += p * float(np.mean(best == one.of_class))
    return max(gain, 0.0), chance


def _by_class(classes: Sequence[str], probability: np.ndarray) -> np.ndarray:
    """Probabilities (n, c) of classes, in order of first mention, from those of explanations."""
    of = np.array([[one == name for name in dict.fromkeys(classes)] for one in classes], float)
    return probability @ of


def _separations_with(d, comparison: Comparison, test: FurtherTest, leading):
    """Separations (n, n) of the leading explanations by the data at hand, and with the test."""
    base = comparison.base
    keys = [one.fit.chosen[0] for one in leading]
    strengths = np.array([one.fit.strengths[k] for one, k in zip(leading, keys, strict=True)])
    _, further_base, further_effects = test.response(base.delta, base.strengths)
    slopes = np.vstack([base.base_slopes, further_base])
    effects = np.vstack([base.effect_slopes, further_effects])[:, keys]
    covariance = block_diag(comparison.noise.mean, test.noise)
    m = len(comparison.noise.mean)
    now = _separations(d, comparison.noise.mean, slopes[:m], effects[:m], keys, strengths)
    return now, _separations(d, covariance, slopes, effects, keys, strengths)


def _separations(d: Linearised, covariance, base_slopes, effect_slopes, keys, strengths):
    """Signal-to-noise (n, n) of explanation i against j; against none on the diagonal."""
    nothing = np.zeros(len(covariance))
    design = project(nothing, base_slopes, d.prior_sd, effect_slopes, covariance)
    snr = lengths(design.effects) * np.abs(strengths)
    apart = separation(confusability(design.effects), d.one_sided[keys])
    np.fill_diagonal(apart, 1.0)
    return snr[:, None] * apart
