"""The answer in plain numbers, under the names that others build on.

Every effect is also reported by itself, after the rule of Saris, Satorra and van der Veld
(2009) for expected changes: `found` (significant, as large as is typical for it), `trivial`
(significant, small), `absent` (not significant, though its typical strength would have been
seen with 80 % power), `inconclusive` (not significant, and it could not have been seen).
"""

from dataclasses import asdict, dataclass

import numpy as np

from calibrate.discrepancy.comparison.classes import SEPARABLE
from calibrate.discrepancy.comparison.compare import Comparison, Prepared
from calibrate.discrepancy.comparison.localise import Localisation
from calibrate.discrepancy.comparison.next_test import Proposal, UpdatedBelief, why_stop
from calibrate.discrepancy.comparison.probability_calibration import NONE, UNKNOWN
from calibrate.discrepancy.comparison.projection import admissible, lengths
from calibrate.discrepancy.comparison.reduction import Reduction, is_reportable

BIG = 0.3  # typical strengths; smaller is trivial
SIGNIFICANT = 1.96  # of |z|; 1.64 for one-sided effects
REPORTED = 0.005  # smallest probability of a pair that is listed


@dataclass(frozen=True)
class EffectEstimate:
    """One effect by itself; strengths in its own unit."""

    name: str
    status: str
    z: float
    strength: float
    standard_error: float
    unit: str
    visibility: float


def effect_estimates(prepared: Prepared, comparison: Comparison) -> list[EffectEstimate]:
    """Every candidate effect, by falling score; strengths are those of its own best fit, as those
    of explanations are, where it has one."""
    found, d = comparison.scores, prepared.description
    score = admissible(found.z, d.one_sided)

    def estimate(k: int) -> EffectEstimate:
        effect, (strength, error) = d.effects[k], _fitted(prepared, comparison, k)
        said = status(float(score[k]), effect.one_sided, strength, float(found.typical_snr[k]))
        return EffectEstimate(
            effect.name, said, float(found.z[k]), strength * effect.typical, error * effect.typical,
            effect.unit, float(found.visibility[k]),
        )  # fmt: skip

    return [estimate(int(k)) for k in np.argsort(-score)]


def _fitted(prepared: Prepared, comparison: Comparison, k: int) -> tuple[float, float]:
    """Strength of an effect and its standard error, in typical strengths: at its own best fit, else
    one step from the fit without it."""
    fit, found = comparison.refits.get((k,)), comparison.scores
    if fit is None or not fit.strengths[k]:
        at_none = 0.0 if fit is not None else float(found.strength[k])
        return at_none, float(found.strength_se[k])
    design = fit.projected(prepared.null.inflation * fit.covariance, [k])
    return float(fit.strengths[k]), float(1 / lengths(design.effects)[0])


def status(score: float, one_sided: bool, strength: float, typical_snr: float) -> str:
    """The rule above for one effect; strength in typical strengths."""
    if score >= (1.64 if one_sided else SIGNIFICANT):
        return "found" if abs(strength) >= BIG else "trivial"
    return "absent" if typical_snr >= SEPARABLE else "inconclusive"


def as_json(
    prepared: Prepared,
    localisation: Localisation,
    comparison: Comparison,
    reduction: Reduction | None,
    proposals: list[Proposal],
    belief: UpdatedBelief | None = None,
) -> dict:
    """The keys where, which, how_far, next_test and further_tests."""
    return {
        "where": [
            {**asdict(s), "share_interval": list(s.share_interval) if s.holds else None}
            for s in localisation.segments
        ],
        "across_tests": [asdict(c) for c in localisation.across],
        "which": _which(prepared, comparison),
        "how_far": how_far(reduction),
        "next_test": _next(comparison, proposals),
        "further_tests": None
        if belief is None
        else {**asdict(belief), "foreseen": belief.foreseen},
    }


def _which(prepared: Prepared, comparison: Comparison) -> dict:
    single = {n: comparison.probability[n] for n in comparison.summary.names}
    ends = {n: comparison.probability[n] for n in (NONE, UNKNOWN)}
    pairs = {
        n: p
        for n, p in comparison.probability.items()
        if n not in single and n not in ends and p >= REPORTED
    }
    return {
        "verdict": comparison.verdict,
        "reason": comparison.reason,
        "probability": {**single, **pairs, **ends},
        "probability_by_class": comparison.by_class,
        "likely_set": comparison.likely_set,
        "alike": prepared.classes.alike(),
        "absorbed_by_calibration": list(prepared.classes.absorbed),
        "p_gap": comparison.summary.p_before,
        "p_left_after_best": comparison.summary.p_after,
        "effects": [asdict(report) for report in effect_estimates(prepared, comparison)],
    }


def how_far(reduction: Reduction | None) -> dict | None:
    """By how much the gap shrinks; no interval where it does not hold its value."""
    if reduction is None:
        return None
    return {
        "before": reduction.before,
        "after": reduction.after,
        "floor": reduction.floor,
        "shrinkage": reduction.shrinkage,
        "interval": [reduction.low, reduction.high] if reduction.holds else None,
        "shown": is_reportable(reduction.low, reduction.high) and reduction.holds,
        "shrinkage_left_out": reduction.cross_validated,
        "ceiling": reduction.ceilings,
    }


def _next(comparison: Comparison, proposals: list[Proposal]) -> dict | None:
    if not proposals or comparison.verdict == NONE:
        return None
    best = proposed(proposals[0], why_stop(comparison, proposals))
    return {**best, "all": [offered(one) for one in proposals]}


def offered(proposal: Proposal) -> dict:
    """One line of a list of further tests."""
    return {
        "name": proposal.name, "cost": proposal.cost, "specimens": proposal.specimens,
        "gain_nats": proposal.gain, "chance": proposal.chance, "separation": proposal.separation,
    }  # fmt: skip


def proposed(proposal: Proposal, stop: str) -> dict:
    """A further test with all that is said of it."""
    return {
        **offered(proposal),
        "chance_now": proposal.chance_now,
        "stop": stop,
        "separation_now": proposal.now,
        "settles": proposal.settles,
        "hardest_pair": list(proposal.hardest),
        "predicted": {name: curve.tolist() for name, curve in proposal.predicted.items()},
        "labels": list(proposal.labels),
        "deviation": proposal.deviation.tolist(),
        "entries": dict(proposal.entries),
    }
