"""How far does the gap shrink when an effect is added?

The gap E of a model is the root mean square, over features, of its distance from a fresh
specimen, each feature in units of the scatter of specimens; both tests count alike:

    E^2 = 1 + d^2       d^2 = mean over features of (true mean - model)^2 / scatter^2

1 is the floor: no model of the mean can predict a specimen better.  d^2 is estimated twice:
from the sample with what fitting has swallowed given back (Mallows' Cp: |residual|^2 - tr S +
2 tr H S, where S is the scatter of the sample's mean alone: what the description itself is wrong
by shows on fresh specimens too), and by leaving specimens out.  Shrinkage = (E0 - E1)/(E0 - 1).
Where its interval is wide the data cannot show it, and no value is claimed.
Ceilings are the same number for any change of the contact law (base parameters, contact effects and
a smooth gap), and of the measuring chain (its effects, and smooth distortions of displacement and
of force along force, the same in both tests).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.discrepancy.comparison.refit import Refit, refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.unspecified_gap import kernel_factors
from calibrate.labtests.diagnosis.base import Feature
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, tests_of

WIDEST = 0.3  # of an interval (90 %), for a shrinkage to be claimed
SMALLEST_GAP = 0.02  # of E0 - 1; below it a shrinkage says nothing
BOOTSTRAP = 300
CENTRES = (0.05, 0.3, 0.6, 0.9)  # of distortions, shares of the largest force
SPAN_SD = 3.0  # typical strengths, of every direction of a ceiling
FREE_SD = 1e3  # of ln p, where base parameters are free
CONTACT_LAW = ("soil", "wall")  # kinds of effects that a change of the contact law spans
SMOOTH_AMPLITUDE = 2.0  # scatters of a specimen, of the smooth gap in the contact ceiling


@dataclass(frozen=True)
class Reduction:
    """E before and after, the floor, the shrinkage with an interval (90 %), the shrinkage on
    specimens left out (None with fewer than two), the ceilings of the shrinkage, and the E that
    the description's own error at the base fit makes alone."""

    before: float
    after: float
    floor: float
    shrinkage: float
    low: float
    high: float
    cross_validated: float | None
    ceilings: dict[str, float]
    own_error: float = 1.0

    @property
    def visible(self) -> bool:
        """Whether the gap is larger than the description's own error, place by place."""
        return self.before > self.own_error

    @property
    def shrinks(self) -> bool:
        """Whether the gap becomes smaller: on these specimens and, where the interval of this
        reaches zero, on specimens left out of the fit as well."""
        return self.shrinkage > 0 and (self.low > 0 or (self.cross_validated or 0.0) > 0)

    @property
    def holds(self) -> bool:
        """Whether the interval holds its value: not where more than the effect is left out."""
        return self.low <= self.shrinkage <= self.high


def estimate_reduction(
    description: Linearised,
    measured: Measured,
    noise: Noise,
    base: Refit,
    best: Refit,
    seed: int,
) -> Reduction:
    """The shrinkage by one refit, given the base fit."""
    rng = np.random.default_rng(seed)
    weight = feature_weights(description, noise)
    hats = [hat_of(*_columns(description, fit), fit.covariance) for fit in (base, best)]
    offsets = [_swallowed(hat, _of_the_mean(measured, noise), weight) for hat in hats]
    before, after = (
        float(weight @ (measured.mean - fit.values) ** 2 + offset)
        for fit, offset in zip((base, best), offsets, strict=True)
    )
    drawn = _drawn(noise, best.values - base.values, hats, offsets, weight, rng)
    low, high = np.quantile(drawn, [0.05, 0.95])
    value, own = shrinkage(before, after), description.wrong_at(base.delta, base.strengths)
    ceilings = {
        name: max(shrinkage(before, _span_gap(base, measured, noise, columns, weight)), value)
        for name, columns in _spans(description, measured, noise, base).items()
    }
    cross_validated = _cross_validated(description, measured, noise, (base, best), weight)
    return Reduction(
        before=_error(before),
        after=_error(after),
        floor=1.0,
        shrinkage=value,
        low=float(low),
        high=float(high),
        cross_validated=cross_validated,
        ceilings=ceilings,
        own_error=_error(float(weight @ (own**2).sum(axis=1))),
    )


def is_reportable(low: float, high: float) -> bool:
    """Whether an interval is narrow enough for a shrinkage to be claimed."""
    return high - low <= WIDEST


def feature_weights(description: Linearised, noise: Noise) -> np.ndarray:
    """1/scatter^2 (m,), so that they sum to one gap per test: both tests count alike."""
    tests = tests_of(description.features)
    names = list(dict.fromkeys(tests))
    count = np.array([(tests == test).sum() for test in tests])
    return 1 / (np.diag(noise.specimen) * count * len(names))


def shrinkage(before: float, after: float) -> float:
    """(E0 - E1)/(E0 - 1) from d0^2 and d1^2, kept within -1 and 1."""
    possible = _error(before) - 1
    if possible < SMALLEST_GAP:
        return 0.0
    return float(np.clip((_error(before) - _error(after)) / possible, -1.0, 1.0))


def _error(gap: float) -> float:
    return float(np.sqrt(1 + max(gap, 0.0)))


def _columns(description: Linearised, fit: Refit) -> tuple[np.ndarray, np.ndarray]:
    """Directions (m, q) that a fit may move in, with prior deviations (q,); an effect held at
    its bound does not move."""
    moving = [k for k in fit.chosen if fit.strengths[k] != 0]
    columns = np.hstack([fit.base_slopes, fit.effect_slopes[:, moving]])
    return columns, np.concatenate([description.prior_sd, np.full(len(moving), SPAN_SD)])


def hat_of(columns: np.ndarray, prior: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Operator (m, m) of a fit that moves along columns (m, q) with prior deviations (q,)."""
    weighted = linalg.solve(covariance, columns, assume_a="pos")
    return columns @ np.linalg.inv(columns.T @ weighted + np.diag(prior**-2.0)) @ weighted.T


def _of_the_mean(measured: Measured, noise: Noise) -> np.ndarray:
    """Covariance (m, m) of a sample's mean about the mean of all such specimens."""
    return noise.specimen * measured.weights()


def _swallowed(hat: np.ndarray, scatter: np.ndarray, weight: np.ndarray) -> float:
    """Mallows' correction of a weighted squared residual: 2 tr H S - tr S."""
    return float(2 * weight @ np.diag(hat @ scatter) - weight @ np.diag(scatter))


def _drawn(noise: Noise, gap: np.ndarray, hats, offsets, weight, rng) -> np.ndarray:
    """Shrinkages (n,) of samples drawn about the better fit, analysed linearly; gap (m,): by what
    this differs from the other; hats (m, m) and offsets of both (`_swallowed`)."""
    root = np.linalg.cholesky(noise.mean)
    keep0, keep1 = (np.eye(len(hat)) - hat for hat in hats)
    drawn = []
    for _ in range(BOOTSTRAP):
        scatter = root @ rng.standard_normal(len(root))
        before = weight @ (gap + keep0 @ scatter) ** 2 + offsets[0]
        after = weight @ (keep1 @ scatter) ** 2 + offsets[1]
        drawn.append(shrinkage(float(before), float(after)))
    return np.array(drawn)


def _cross_validated(description, measured, noise, fits, weight) -> float | None:
    """Shrinkage on specimens left out of the fits, one after the other."""
    specimens = measured.specimens
    tests = tests_of(description.features)
    per_test = [np.isfinite(specimens[:, tests == t]).any(axis=1).sum() for t in set(tests)]
    if not len(specimens) or min(per_test) < 2:
        return None
    sums, total = np.zeros(2), measured.weight @ np.isfinite(specimens)
    for number, specimen in enumerate(specimens):
        rest = measured.without(number)
        fewer = noise.specimen * (rest.weights() - measured.weights())
        observed = np.isfinite(specimen)
        share = measured.weight[number] / total[observed].max()
        for i, whole in enumerate(fits):
            covariance, start = whole.covariance + fewer, (whole.delta, whole.strengths)
            fit = refit(description, rest.mean, covariance, whole.chosen, start)
            error = np.where(observed, specimen - fit.values, 0.0)
            sums[i] += share * weight @ error**2
    return shrinkage(float(sums[0] - 1), float(sums[1] - 1))


def _spans(description, measured, noise, base: Refit) -> dict[str, np.ndarray]:
    """Directions (m, q), one typical size each, of the two ceilings."""
    kind = np.array([effect.kind for effect in description.effects])
    smooth = kernel_factors(description.features, noise.specimen)
    any_shape = [SMOOTH_AMPLITUDE / SPAN_SD * factor for factor in smooth]
    contact = np.hstack([base.effect_slopes[:, np.isin(kind, CONTACT_LAW)], *any_shape])
    instruments = base.effect_slopes[:, kind == "instrument"]
    chain = np.hstack([instruments, distortions(description, measured)])
    return {"contact law": contact, "measuring chain": chain}


def distortions(description: Linearised, measured: Measured) -> np.ndarray:
    """What smooth distortions of displacement (0.1 mm) and of force (5 %) along force do to
    the features, shape (m, 2 q): the same distortion acts in both tests."""
    features, mean = description.features, measured.mean
    at_forces = np.array([TEST_FEATURES[f.test].read_at_forces for f in features])
    high = max((f.scale for f, on in zip(features, at_forces, strict=True) if on), default=1.0)
    force = np.where(at_forces, [f.abscissa for f in features], mean)
    kinds = (kind for test in TEST_FEATURES.values() for kind in test.branches)
    slope = np.sum([along_branch(features, mean, kind) for kind in kinds], axis=0)
    columns = []
    for centre in CENTRES:
        bump = np.exp(-0.5 * ((force / high - centre) / 0.2) ** 2)
        step = 1 / (1 + np.exp(-(force / high - centre) / 0.05))
        columns.append(np.where(at_forces, 0.1 * step, -0.1 * slope * step))
        columns.append(np.where(at_forces, -0.05 * force * bump * slope, 0.05 * force * bump))
    return np.array(columns).T


def along_branch(features: Sequence[Feature], mean: np.ndarray, kind: str) -> np.ndarray:
    """d value/d abscissa (m,) along the features of one kind; 0 elsewhere, and for one alone."""
    slope = np.zeros(len(mean))
    rows = np.array([i for i, feature in enumerate(features) if feature.kind == kind], int)
    if len(rows) > 1:
        at = np.array([features[i].abscissa for i in rows])
        order = np.argsort(at)
        slope[rows[order]] = np.gradient(mean[rows[order]], at[order])
    return slope


def _span_gap(base: Refit, measured, noise, columns, weight) -> float:
    """d^2 when the base parameters and all directions of a span are free (within priors)."""
    every = np.hstack([base.base_slopes, columns])
    prior = np.full(every.shape[1], SPAN_SD)
    prior[: base.base_slopes.shape[1]] = FREE_SD
    hat = hat_of(every, prior, noise.mean)
    left = base.working - hat @ base.working
    return float(weight @ left**2 + _swallowed(hat, _of_the_mean(measured, noise), weight))
