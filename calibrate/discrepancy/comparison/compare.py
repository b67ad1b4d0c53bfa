"""Compares explanations of a gap: from a sample and a description to probabilities and a verdict.

    noise -> base fit -> is there a gap? -> scores -> evidences of all explanations ->
    refit of the leading effects and their pairs -> is anything left? -> probabilities

The verdict is the likeliest explanation: a class of effects, two of them, or "unknown"; it is
"none" where that is likeliest, or not unlikely enough to name something (`NAMED_BELOW`).
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibrate.discrepancy.comparison.classes import TOGETHER, Classes, classes
from calibrate.discrepancy.comparison.evidence import Evidence, at_a_fit, evidence
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
from calibrate.discrepancy.comparison.projection import Scores, confusability, scores, visibility
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.unspecified_gap import Factors, kernel_factors, projected

Key = tuple[int, ...]  #: of an explanation: the effects at work in it


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


@dataclass(frozen=True, eq=False)
class Comparison:
    """The answer and what it rests on: probability by explanation (effects and pairs by name, none,
    unknown) and by class; fits without (`base`) and with effects; `best` is the key of the one that
    is named, or of the effect with the largest evidence; reason: why the likeliest explanation is
    not named although it is likely enough (`naming`)."""

    verdict: str
    probability: dict[str, float]
    by_class: dict[str, float]
    likely_set: list[str]
    summary: EvidenceSummary
    scores: Scores
    noise: Noise
    base: Refit
    refits: dict[Key, Refit]
    best: Key
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
    null: NullDistributions | None = None,
) -> Prepared:
    """Forms classes for a plan (s, m) of measurement, and simulates its null distributions if they
    are not known."""
    generator = SampleGenerator(description, plan, packing_covariance(description))
    null, found = null or simulate(generator, seed, draws), design_classes(generator)
    return Prepared(generator, null, found, calibration or ProbabilityCalibration())


def design_classes(generator: SampleGenerator) -> Classes:
    """Classes of effects that this plan cannot tell apart."""
    d = generator.description
    effects = generator.projected(d.effect_slopes)
    visible = visibility(effects, d.effect_slopes, generator.mean_covariance)
    return classes(d.effect_names, confusability(effects), d.one_sided, visible)


def compare(prepared: Prepared, measured: Measured) -> Comparison:
    """Names the explanation of a sample's gap."""
    d = prepared.description
    inflation = prepared.null.inflation
    noise, base = fitted_base(d, measured, prepared.generator.packing, inflation)
    kernel = kernel_factors(d.features, noise.specimen)
    plain = base.projected(base.covariance)
    shapes = projected(kernel, plain.operator)
    p_before = prepared.null.before.p_value(
        statistics(plain.residual, plain.effects, d.one_sided, shapes)
    )
    first = evidence(base, d.one_sided, noise, inflation, kernel)
    refits = all_fits(d, measured.mean, noise, inflation, base, first)
    found = first if d.emulator is None else _refined(prepared, noise, base, refits, first)
    best, p_after = _left(prepared, kernel, found, refits)
    summary = EvidenceSummary(d.effect_names, found, p_before, p_after)
    covariance = inflation * base.covariance
    probability, _ = probabilities(summary, prepared.classes, prepared.calibration)
    likely = found.by_key()
    return Comparison(
        **_decided(prepared, probability, refits, lambda key: likely[key], best),
        summary=summary,
        scores=scores(base.projected(covariance), base.effect_slopes, covariance),
        noise=noise,
        base=base,
        refits=refits,
    )


def label(classes_: Classes, hypothesis: tuple[str, ...]) -> str:
    """The name of an explanation by classes: that of a class, or of two classes with "+"."""
    return TOGETHER.join(sorted({classes_.label(name) for name in hypothesis}))


def _refined(prepared, noise: Noise, base: Refit, refits, first: Evidence) -> Evidence:
    """Evidences of the refitted explanations replaced by those at their own best fit."""

    def at(fit: Refit) -> float:
        return at_a_fit(fit, prepared.description.one_sided, noise, prepared.null.inflation)

    nothing = [replace(f, chosen=()) for f in refits.values() if not f.strengths.any()]
    none = max(at(fit) for fit in (base, *nothing))
    singles, pairs = first.singles.copy(), first.pairs.copy()
    for key, fit in refits.items():
        value = at(fit) - none
        if len(key) == 1:
            singles[key[0]] = value
        else:
            pairs[(first.pair_index == key).all(axis=1)] = value
    return replace(first, singles=singles, pairs=pairs)


def _left(prepared, kernel: Factors, found: Evidence, refits):
    """The best refitted effect, and the p-value of what is left: the better of those after
    this effect and after the best refitted pair."""
    if not refits:
        return (), 1.0
    value = found.by_key()
    best = max((key for key in refits if len(key) == 1), key=lambda key: value[key])
    pairs = [key for key in refits if len(key) == 2]
    keys = [best, *([max(pairs, key=lambda key: value[key])] if pairs else [])]
    p_values = []
    for key in keys:
        design = refits[key].projected(refits[key].covariance)
        shapes = projected(kernel, design.operator)
        left = statistics_after(design, np.array(key), prepared.description.one_sided, shapes)
        p_values.append(prepared.null.after.p_value(left))
    return best, max(p_values)


def answered_with(
    prepared: Prepared, comparison: Comparison, probability: dict[str, float]
) -> Comparison:
    """The same comparison with other probabilities of explanations, by name."""
    names, every = prepared.description.effect_names, dict.fromkeys(comparison.probability, 0.0)
    every |= probability

    def likely(key: Key) -> float:
        return every.get(TOGETHER.join(names[k] for k in sorted(key)), 0.0)

    decided = _decided(prepared, probability, comparison.refits, likely, comparison.best)
    return replace(comparison, **decided | {"probability": every})


def _decided(
    prepared: Prepared, probability: dict[str, float], refits: Iterable[Key],
    likely: Callable[[Key], float], best: Key,
) -> dict[str, Any]:  # fmt: skip
    """Fields of a comparison that follow from probabilities of explanations: `best` is the
    likeliest of the fits that the verdict names, or as given where it names none."""
    by_class = _by_class(prepared.classes, probability)
    verdict = likeliest_verdict(by_class)
    return {
        "verdict": verdict,
        "probability": probability,
        "by_class": by_class,
        "likely_set": explanations(by_class, prepared.calibration.smallest),
        "best": max(_fits_of(prepared, refits, verdict), key=likely, default=best),
    }


def _fits_of(prepared: Prepared, refits: Iterable[Key], verdict: str) -> list[Key]:
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
