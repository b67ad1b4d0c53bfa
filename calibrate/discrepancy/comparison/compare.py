"""Compares explanations of a gap: from a sample and a description to probabilities and a verdict.

    noise -> base fit -> is there a gap? -> scores -> evidences of all explanations ->
    refit of the leading effects and their pairs -> is anything left? -> probabilities

The verdict is the likeliest explanation: a class of effects, two of them, or "unknown"; it is
"none" where that is likeliest, or not unlikely enough to name something (`NAMED_BELOW`).
`prepare` does what depends on the plan of measurement only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibrate.discrepancy.comparison import evidence as evidences
from calibrate.discrepancy.comparison.classes import TOGETHER, Classes, classes
from calibrate.discrepancy.comparison.evidence import Evidence, evidence
from calibrate.discrepancy.comparison.fits import all_fits, fitted_base
from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.lack_of_fit import (
    DRAWS,
    NullDistributions,
    simulate,
    statistics,
    statistics_after,
)
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import Noise, packing_covariance
from calibrate.discrepancy.comparison.probability_calibration import (
    NAMED_BELOW,
    NONE,
    EvidenceSummary,
    ProbabilityCalibration,
    explanations,
    hypotheses,
    log_probabilities,
)
from calibrate.discrepancy.comparison.projection import Scores, project, scores
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.unspecified_gap import Factors, kernel_factors, projected


@dataclass(frozen=True, eq=False)
class Prepared:
    """All that a diagnosis needs beside the data."""

    generator: SampleGenerator
    null: NullDistributions
    classes: Classes
    calibration: ProbabilityCalibration

    @property
    def description(self) -> Linearised:
        return self.generator.description

    def without(self, names: Sequence[str]) -> "Prepared":
        """The same with fewer candidate effects; the null distributions stay."""
        generator = replace(self.generator, description=self.description.without_effects(names))
        return replace(self, generator=generator, classes=design_classes(generator))


@dataclass(frozen=True, eq=False)
class Comparison:
    """The answer and what it rests on.

    probability by explanation (effects and pairs by name, none, unknown) and by_class; base
    and refits are fits without and with effects; best is the key of the refit that is named, or
    of the effect with the largest evidence; reason: why the likeliest explanation is not named
    although it is likely enough (`naming`).
    """

    verdict: str
    probability: dict[str, float]
    by_class: dict[str, float]
    likely_set: list[str]
    summary: EvidenceSummary
    scores: Scores
    noise: Noise
    base: Refit
    refits: dict[tuple[int, ...], Refit]
    best: tuple[int, ...]
    reason: str = ""

    @property
    def stated(self) -> float:
        """Probability stated for the verdict."""
        return self.by_class.get(self.verdict, 0.0)


def prepare(
    description: Linearised,
    plan: np.ndarray,
    seed: int,
    draws: int = DRAWS,
    calibration: ProbabilityCalibration | None = None,
) -> Prepared:
    """Simulates null distributions and forms classes for a plan (s, m) of measurement."""
    generator = SampleGenerator(description, plan, packing_covariance(description))
    null = simulate(generator, seed, draws)
    return Prepared(
        generator, null, design_classes(generator), calibration or ProbabilityCalibration()
    )


def design_classes(generator: SampleGenerator) -> Classes:
    """Classes of effects that this plan cannot tell apart."""
    d = generator.description
    covariance = generator.mean_covariance
    design = project(np.zeros(len(d.mean)), d.base_slopes, d.prior_sd, d.effect_slopes, covariance)
    found = scores(design, d.effect_slopes, covariance)
    return classes(d.effect_names, found.confusability, d.one_sided, found.visibility)


def compare(prepared: Prepared, measured: Measured) -> Comparison:
    """Names the explanation of a sample's gap."""
    d = prepared.description
    inflation = prepared.null.inflation
    noise, base = fitted_base(d, measured, prepared.generator.packing, inflation)
    here = replace(noise, mean=base.covariance)
    covariance = inflation * here.mean
    kernel = kernel_factors(d.features, noise.specimen)
    plain = project(base.working, base.base_slopes, d.prior_sd, base.effect_slopes, here.mean)
    shapes = projected(kernel, plain.operator)
    p_before = prepared.null.before.p_value(
        statistics(plain.residual, plain.effects, d.one_sided, shapes)
    )
    first = evidence(
        d,
        base.working,
        base.base_slopes,
        base.effect_slopes,
        here,
        inflation,
        kernel,
    )
    refits = all_fits(d, measured.mean, noise, inflation, base, first)
    found = first if d.emulator is None else _refined(prepared, noise, base, refits, first)
    best, p_after = _left(prepared, kernel, found, refits)
    summary = EvidenceSummary(d.effect_names, found, p_before, p_after)
    design = project(base.working, base.base_slopes, d.prior_sd, base.effect_slopes, covariance)
    return _answer(
        prepared,
        summary,
        scores=scores(design, base.effect_slopes, covariance),
        noise=noise,
        base=base,
        refits=refits,
        best=best,
    )


def label(classes_: Classes, hypothesis: tuple[str, ...]) -> str:
    """The name of an explanation by classes: that of a class, or of two classes with "+"."""
    return TOGETHER.join(sorted({classes_.label(name) for name in hypothesis}))


def _refined(prepared, noise: Noise, base: Refit, refits, first: Evidence) -> Evidence:
    """Evidences of the refitted explanations replaced by those at their own best fit."""
    nothing = [replace(f, chosen=()) for f in refits.values() if not f.strengths.any()]
    none = max(_at(prepared, noise, fit) for fit in (base, *nothing))
    singles, pairs = first.singles.copy(), first.pairs.copy()
    for key, fit in refits.items():
        value = _at(prepared, noise, fit) - none
        if len(key) == 1:
            singles[key[0]] = value
        else:
            pairs[(first.pair_index == key).all(axis=1)] = value
    return replace(first, singles=singles, pairs=pairs)


def _at(prepared, noise: Noise, fit: Refit) -> float:
    """Evidence of a fit, with the noise at its own location."""
    d, on = prepared.description, list(fit.chosen)
    return evidences.at_a_fit(
        fit.working,
        fit.base_slopes,
        d.prior_sd,
        fit.effect_slopes[:, on],
        d.one_sided[on],
        replace(noise, mean=fit.covariance),
        prepared.null.inflation,
    )


def _left(prepared, kernel: Factors, found: Evidence, refits):
    """The best refitted effect, and the p-value of what is left: the better of those after
    this effect and after the best refitted pair."""
    if not refits:
        return (), 1.0
    d = prepared.description
    value = found.by_key()
    best = max((key for key in refits if len(key) == 1), key=lambda key: value[key])
    pairs = [key for key in refits if len(key) == 2]
    keys = [best, *([max(pairs, key=lambda key: value[key])] if pairs else [])]
    p_values = []
    for key in keys:
        fit = refits[key]
        design = project(
            fit.working, fit.base_slopes, d.prior_sd, fit.effect_slopes, fit.covariance
        )
        shapes = projected(kernel, design.operator)
        left = statistics_after(design, np.array(key), d.one_sided, shapes)
        p_values.append(prepared.null.after.p_value(left))
    return best, max(p_values)


def _answer(
    prepared: Prepared, summary: EvidenceSummary, refits: dict, best: tuple[int, ...], **rest
) -> Comparison:
    probability, by_class = probabilities(summary, prepared.classes, prepared.calibration)
    verdict, value = likeliest_verdict(by_class), summary.evidence.by_key()
    of_verdict = _fits_of(prepared, refits, verdict)
    return Comparison(
        verdict=verdict,
        refits=refits,
        best=max(of_verdict, key=lambda key: value[key]) if of_verdict else best,
        probability=probability,
        by_class=by_class,
        likely_set=explanations(by_class, prepared.calibration.smallest),
        summary=summary,
        **rest,
    )


def answered_with(
    prepared: Prepared, comparison: Comparison, probability: dict[str, float]
) -> Comparison:
    """The same comparison with other probabilities of explanations, by name."""
    by_class = _by_class(prepared.classes, probability)
    every = {name: 0.0 for name in comparison.probability} | probability
    verdict, names = likeliest_verdict(by_class), prepared.description.effect_names
    of_verdict = _fits_of(prepared, comparison.refits, verdict)
    best = max(
        of_verdict,
        key=lambda key: every.get(TOGETHER.join(names[k] for k in sorted(key)), 0.0),
        default=comparison.best,
    )
    likely = explanations(by_class, prepared.calibration.smallest)
    return replace(
        comparison, verdict=verdict, best=best, probability=every, by_class=by_class,
        likely_set=likely,
    )  # fmt: skip


def _fits_of(prepared: Prepared, refits: dict, verdict: str) -> list[tuple[int, ...]]:
    """The refitted explanations that a verdict names."""
    names, size = prepared.description.effect_names, verdict.count(TOGETHER) + 1
    return [
        key for key in refits if len(key) == size
        and label(prepared.classes, tuple(names[k] for k in key)) == verdict
    ]  # fmt: skip


def probabilities(
    summary: EvidenceSummary, classes_: Classes, calibration: ProbabilityCalibration
) -> tuple[dict[str, float], dict[str, float]]:
    """Probabilities by explanation and by class."""
    values = np.exp(log_probabilities(summary, calibration)).tolist()
    every = dict(zip(map(TOGETHER.join, hypotheses(summary)), values, strict=True))
    return every, _by_class(classes_, every)


def _by_class(classes_: Classes, probability: Mapping[str, float]) -> dict[str, float]:
    """Probabilities by class from those of explanations."""
    found: dict[str, float] = {}
    for name, p in probability.items():
        of_class = label(classes_, tuple(name.split(TOGETHER)))
        found[of_class] = found.get(of_class, 0.0) + p
    return found


def likeliest_verdict(by_class: Mapping[str, float]) -> str:
    """The verdict: the likeliest explanation, if none is unlikely."""
    likeliest = max(by_class, key=lambda name: by_class[name])
    return likeliest if by_class[NONE] < NAMED_BELOW else NONE
