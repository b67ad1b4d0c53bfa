"""`calibrate diagnose`: from a lab file and a bank to where, which, how far and the next test.

    curves -> features -> description about the best base fit -> null distributions
           -> where, which, how far, next test

How probabilities are stated was learned once (`diagnosis.opinion`); null distributions depend on
the plan of measurement and may be shared by labs with the same plan.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from calibrate.discrepancy.comparison.compare import (
    Prepared,
    Which,
    design_classes,
    diagnose,
    prepare,
)
from calibrate.discrepancy.comparison.generated import World, plan_of
from calibrate.discrepancy.comparison.lack_of_fit import NullTable
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.localise import Where, where
from calibrate.discrepancy.comparison.next_test import Proposal, next_tests
from calibrate.discrepancy.comparison.noise import packing_covariance
from calibrate.discrepancy.comparison.outliers import robust, scatter_of
from calibrate.discrepancy.comparison.probability_calibration import NONE, Opinion, learned
from calibrate.discrepancy.comparison.reduction import HowFar, how_far
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.verdict import as_json
from calibrate.discrepancy.library.description import (
    DENSITY_SD,
    Discrepancy,
    Ready,
    describe,
    point_for,
)
from calibrate.discrepancy.library.further_tests import menu
from calibrate.discrepancy.library.instruments import with_baseline, with_instruments
from calibrate.discrepancy.library.lab import LabCurves, read
from calibrate.io.lab import Lab

DRAWS = 400  # of null distributions
LEADING = 4  # explanations between which a further test is to decide
LEAST_LIKELY = 0.01  # probability of such an explanation, but for the likeliest
Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Manner:
    """How probabilities are stated; null distributions by plan of measurement (specimens,
    features), to be shared by labs that have the same."""

    opinion: Opinion = field(default_factory=learned)
    nulls: dict[tuple[int, ...], NullTable] = field(default_factory=dict)

    @staticmethod
    def neutral() -> "Manner":
        """Evidences as they are."""
        return Manner(Opinion())


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a report shows of one lab."""

    lab: Lab
    found: LabCurves
    measured: Measured
    prepared: Prepared
    where: Where
    which: Which
    far: HowFar | None
    proposals: list[Proposal]

    def as_json(self) -> dict:
        """The contract's keys."""
        return as_json(self.prepared, self.where, self.which, self.far, self.proposals)


def described(
    lab: Lab, ready: Ready, seed: int, discrepancy: Discrepancy | None = None, baseline: bool = True
) -> tuple[LabCurves, Linearised, Measured]:
    """What was measured, and the simulator about the best base fit to it; baseline: with the
    forces before contact."""
    found = read(lab, ready.bank)
    point = point_for(lab, ready.bank)
    density = lab.density_kg_m3
    scatter = float(np.std(density, ddof=1) / np.mean(density)) if len(density) > 1 else DENSITY_SD
    scatter = min(scatter, LARGEST_DENSITY_SD)
    d = describe(ready, point, found.measured.mean, found.chosen, scatter, discrepancy)
    d = with_instruments(d, found, ready.bank, seed)
    d, measured = with_baseline(d, found) if baseline else (d, found.measured)
    return found, d, robust(measured, scatter_of(d))


LARGEST_DENSITY_SD = 0.02  # of specimens in one mould; more is the field's scatter


def ready_to_diagnose(
    d: Linearised, measured: Measured, seed: int, manner: Manner | None = None, draws: int = DRAWS
) -> Prepared:
    """Null distributions of the linear description; the emulator is put back for refits."""
    manner = manner or Manner()
    linear, plan = replace(d, emulator=None), plan_of(measured)
    if plan.shape in manner.nulls:
        world = World(linear, plan, packing_covariance(linear))
        null = manner.nulls[plan.shape]
        prepared = Prepared(world, null, design_classes(world), manner.opinion)
    else:
        prepared = prepare(linear, plan, seed, draws, manner.opinion)
        manner.nulls[plan.shape] = prepared.null
    return replace(prepared, world=replace(prepared.world, description=d))


def diagnosed(
    lab: Lab,
    ready: Ready,
    seed: int = 0,
    manner: Manner | None = None,
    discrepancy: Discrepancy | None = None,
    say: Say = lambda text: None,
) -> Diagnosis:
    """The whole diagnosis of one lab."""
    say("reading curves, fitting the base model")
    found, d, measured = described(lab, ready, seed, discrepancy)
    say("simulating null distributions")
    prepared = ready_to_diagnose(d, measured, seed, manner)
    say("comparing explanations")
    which = diagnose(prepared, measured)
    place = where(d, measured, which.noise, which.base, seed)
    far = None
    if which.best and which.verdict != NONE:
        say("how far the gap shrinks")
        far = how_far(d, measured, which.noise, which.base, which.refits[which.best], seed)
    proposals = _proposals(d, which)
    return Diagnosis(lab, found, measured, prepared, place, which, far, proposals)


def _proposals(d: Linearised, which: Which) -> list[Proposal]:
    """Further tests between the leading single explanations."""
    single = {n: p for n, p in which.probability.items() if n in d.effect_names}
    order = sorted(single, key=lambda n: -single[n])[:LEADING]
    order = order[:1] + [n for n in order[1:] if single[n] >= LEAST_LIKELY]
    keys = [d.effect_names.index(n) for n in order]
    leading = {k: which.refits[(k,)] for k in keys if (k,) in which.refits}
    leading = {k: fit for k, fit in leading.items() if fit.strengths[k] != 0}
    if not leading:
        return []
    return next_tests(d, which.noise, which.base, leading, menu(d, which.noise))
