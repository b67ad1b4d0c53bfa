"""The whole loop on one case: diagnose, ask for a further test, take its answer in, three times.

Several ways to ask are compared on the same case and the same answers: what `calibrate next`
proposes, a test at random, and all cheap tests at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibrate.discrepancy.comparison.compare import Comparison, Prepared, compare
from calibrate.discrepancy.comparison.further import FurtherTest
from calibrate.discrepancy.comparison.next_test import Proposal, next_tests, updated, why_stop
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.diagnosis import InferenceSetup, described, prepared_diagnosis
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.further_tests import menu, outcomes
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import Lab

ROUNDS = 3
CHEAP = 1.0  # h of a technician, at most
Answer = Callable[[Proposal], Lab | None]


@dataclass(frozen=True, eq=False)
class Asking:
    """One case as it stands before any further test, and the laboratory's answers."""

    lab: Lab
    measured: Measured
    prepared: Prepared
    first: Comparison
    offers: Sequence[FurtherTest]
    answer: Answer

    @staticmethod
    def of(
        lab: Lab, emulated: EmulatedLibrary, setup: InferenceSetup, answer: Answer,
        discrepancy: ModelDiscrepancy | None = None,
    ) -> "Asking":  # fmt: skip
        _, d, measured = described(lab, emulated, 0, discrepancy)
        prepared = prepared_diagnosis(d, measured, 0, setup)
        first = compare(prepared, measured)
        offers = menu(d, first.noise, lab.pair().rates, Cylinder.of(lab).force_high)
        return Asking(lab, measured, prepared, first, offers, answer)

    def proposals(self, now: Comparison, left: Sequence[FurtherTest]) -> list[Proposal]:
        return next_tests(self.prepared, now, self.measured.mean, left)

    def after(self, answers: Sequence[Lab]) -> Comparison:
        """The comparison with these answers taken in."""
        if not answers:
            return self.first
        d, cylinder = self.prepared.description, Cylinder.of(self.lab)
        made, _ = outcomes(self.lab, answers, cylinder, d, self.first.noise)
        return updated(self.prepared, self.first, self.measured.mean, made)[0]

    def by_proposals(self) -> list[dict]:
        """After 0, 1, ... tests that `calibrate next` asks for, until it stops; a test that the
        laboratory cannot make is left out."""
        left, answers, now = list(self.offers), [], self.first
        said = [verdict(now, "")]
        while len(answers) < ROUNDS and left:
            offered = self.proposals(now, left)
            if not offered or why_stop(now, offered):
                break
            left = [test for test in left if test.name != offered[0].name]
            given = self.answer(offered[0])
            if given is not None:
                answers.append(given)
                now = self.after(answers)
                said.append(verdict(now, offered[0].name))
        return said

    def at_random(self, seed: Sequence[int]) -> list[dict]:
        """After 0, 1, ... tests drawn from the list."""
        order = np.random.default_rng(seed).permutation(len(self.offers))
        answers, said = [], [verdict(self.first, "")]
        for proposal in [p for i in order for p in self.proposals(self.first, [self.offers[i]])]:
            given = self.answer(proposal) if len(answers) < ROUNDS else None
            if given is not None:
                answers.append(given)
                said.append(verdict(self.after(answers), proposal.name))
        return said

    def all_cheap(self) -> dict:
        """After all tests that take no longer than `CHEAP`."""
        cheap = [test for test in self.offers if test.cost <= CHEAP]
        answers = [self.answer(proposal) for proposal in self.proposals(self.first, cheap)]
        return verdict(self.after([one for one in answers if one is not None]), "cheap")


def verdict(comparison: Comparison, test: str) -> dict:
    """What is said after a test."""
    return {
        "test": test, "verdict": comparison.verdict, "stated": comparison.stated,
        "by_class": comparison.by_class,
    }  # fmt: skip
