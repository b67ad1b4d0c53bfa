"""The laboratory behind the seal makes further tests: what `calibrate next` asks for, as a lab file
with curves beside it.

    test again      both tests on fresh packings; effects kept away or scaled as the test's table
                    says; at 10^n of the rate contact forces times exp(rho n), rho: rate dependence
    machine alone   `jdem.laboratory.bare_machine` with the case's effects; a known weight reads
                    what the load cell makes of it
    hold            F (1 - rho decades) + drift; spheres at rest lose next to nothing more

Every answer is kept; a test is made once, whoever asks for it.  Fresh specimens are those that a
case holds back, in turn.

`Asking` is the whole loop on one case: diagnose, ask for a further test, take its answer in, three
times.  It compares ways to ask on the same answers: what `calibrate next` proposes, a test at
random, and all cheap tests at once.
"""

import abc
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import jax.numpy as jnp
import numpy as np

from calibrate.core.files import write_text
from calibrate.discrepancy.comparison.compare import Comparison, Prepared, compare
from calibrate.discrepancy.comparison.further import FurtherTest
from calibrate.discrepancy.comparison.next_test import Proposal, next_tests, updated, why_stop
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.diagnosis import described
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy
from calibrate.discrepancy.library.further_tests import (
    ANSWER,
    CURVES,
    DECADES_OF_A_HOLD,
    DRIFT,
    HOLD,
    OF_NAME,
    OFFSET,
    RATE,
    REPEATS,
    answer_file,
    menu,
    outcomes,
)
from calibrate.discrepancy.library.run_library import Cylinder
from calibrate.io.lab import Lab, load_lab
from calibrate.labtests.diagnosis.base import Condition, Variation
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, TESTS
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.relaxation import RelaxationTest
from calibrate.simulation.resolution import STILL
from calibrate.simulation.run import points_of
from jdem.effects.base import AbstractEffect
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence
from studies.sealed.laboratory import DISPLACEMENT_SD, FORCE_SD, Laboratory
from studies.sealed.plan import SPECIMENS, Hidden, WithheldCase
from studies.sealed.trial import InferenceSetup

VARIATIONS: tuple[tuple[str, Variation], ...] = tuple(
    (test, variation) for test in TESTS for variation in TEST_FEATURES[test].variations
)
IN_AIR = 20  # readings before contact, mm apart
STEP_IN_AIR = 0.01
HOLDING = np.linspace(0.0, 1.0, 61)  # share of a hold at which it is read
LOADING_MM = 2.0  # of travel before a hold, which says nothing
ROUNDS = 3
CHEAP = 1.0  # h of a technician, at most
Answer = Callable[[Proposal], Lab | None]


class Named(Protocol):
    """A case, of which a name is known."""

    @property
    def name(self) -> str: ...


CaseT = TypeVar("CaseT", bound=Named)


class AbstractFurtherLaboratory(abc.ABC, Generic[CaseT]):
    """Makes further tests of cases of its kind; answers lie in `folder`."""

    folder: Path

    @abc.abstractmethod
    def curves(self, case: CaseT, lab: Lab, asked: Proposal) -> list[np.ndarray] | None:
        """Curves (readings, 2) of the repeats, mm and N; None if a specimen does not stand."""

    @abc.abstractmethod
    def reads(self, case: CaseT, asked: Proposal, weight: float) -> float:
        """What the load cell reads (N) of a known weight (N)."""

    def answer(self, case: CaseT, lab: Lab, asked: Proposal) -> Lab | None:
        """The lab file of a test, as `calibrate next` wrote it, with its curves; None if a specimen
        does not stand."""
        place = self.folder / case.name / re.sub(r"\W+", "_", asked.name)
        if not (place / ANSWER).exists():
            curves = self.curves(case, lab, asked)
            if curves is None:
                return None
            write_curves(place, curves)
            write_text(place / ANSWER, answer_file(lab, self._weighed(case, asked)))
        return load_lab(place / ANSWER)

    def _weighed(self, case: CaseT, asked: Proposal) -> Proposal:
        """The test with what the load cell reads of a known weight, if one is asked for."""
        if "weight" not in asked.entries:
            return asked
        true = MachineTest.model_validate({**asked.entries, "reads": "1 N"}).weight or 0.0
        reads = self.reads(case, asked, true)
        return replace(asked, entries={**asked.entries, "reads": f"{reads:.1f} N"})


def write_curves(place: Path, curves: Iterable[np.ndarray]) -> None:
    """The file of each repeat's curve (readings, 2), mm and N."""
    for number, curve in enumerate(curves, 1):
        rows = "\n".join(f"{x:.3f},{f:.1f}" for x, f in curve)
        write_text(place / CURVES.format(number=number), f"displacement,force\n{rows}\n")


def variation_of(asked: Proposal) -> tuple[int, str, Variation]:
    """A test again: its number among all variations, the test, and the variation."""
    number = [variation.name for _, variation in VARIATIONS].index(asked.name)
    return number, *VARIATIONS[number]


@dataclass(frozen=True, eq=False)
class FurtherLaboratory(AbstractFurtherLaboratory[WithheldCase]):
    """The laboratory of this project's own simulator."""

    laboratory: Laboratory
    folder: Path

    def curves(self, case: WithheldCase, lab: Lab, asked: Proposal) -> list[np.ndarray] | None:
        kind, random = asked.entries["type"], noise_of(case, asked)
        if kind == MachineTest.type_name:
            return [self._bare(case, lab, random) for _ in range(REPEATS)]
        if kind == RelaxationTest.type_name:
            return [held(case, lab, random) for _ in range(REPEATS)]
        number, test, variation = variation_of(asked)
        condition = TEST_FEATURES[test].varied(variation.faster, variation.entries)
        held_back = len(case.packings) - SPECIMENS
        first = SPECIMENS + REPEATS * number % held_back
        other = under(case, condition)
        made = self.laboratory.specimens(other, range(first, first + REPEATS))
        return None if made is None else [specimen.records[test] for specimen in made]

    def reads(self, case: WithheldCase, asked: Proposal, weight: float) -> float:
        random = noise_of(case, asked, 1)
        at = jnp.asarray(weight), jnp.asarray(0.0)
        of_cell = sum(float(effect.force_error(*at)) for effect in of_machine(case))
        return weight + of_cell + FORCE_SD * random.standard_normal()

    def _bare(self, case: WithheldCase, lab: Lab, random: np.random.Generator) -> np.ndarray:
        """A curve of the machine without soil, to the largest force of the lab's first test."""
        force = lab.pair().compression.force_high
        test = MachineTest.model_validate({"name": "bare", "force": f"{force!r} N"})
        press = test.apparatus(lab.specimen, STILL)
        (reading,) = BareMachine(TestSequence((press,)), of_machine(case)).run().values()
        way, reads = points_of(reading.curve).T
        return read_in_time(way, reads, strength_of(case, OFFSET), random, reads[-1])


def noise_of(case: WithheldCase, asked: Proposal, *more: int) -> np.random.Generator:
    """The noise of a test of a case."""
    return np.random.default_rng([case.seed, *asked.name.encode(), *more])


def of_machine(case: WithheldCase) -> tuple[AbstractEffect, ...]:
    """The hidden effects that the library knows."""
    return tuple(OF_NAME[h.name](h.strength) for h in case.hidden if h.name in OF_NAME)


def strength_of(case: WithheldCase, name: str) -> float:
    """Strength (SI) of a hidden effect, 0 if the case has none such."""
    return sum(h.strength for h in case.hidden if h.name == name)


def under(case: WithheldCase, condition: Condition) -> WithheldCase:
    """The case in a test under another condition."""
    factors = condition.factors
    hidden = tuple(Hidden(h.name, h.strength * factors.get(h.name, 1.0)) for h in case.hidden)
    stiffer = np.exp(condition.decades * strength_of(case, RATE))
    soil = {**case.soil}
    soil |= {name: soil[name] * stiffer for name in ("shear_modulus", "surface_energy")}
    return replace(case, hidden=hidden, soil=soil)


def held(case: WithheldCase, lab: Lab, random: np.random.Generator) -> np.ndarray:
    """A curve of loading in the mould to the largest force and a hold there."""
    force = lab.pair().compression.force_high
    after = np.log10(1 + HOLDING * (10**DECADES_OF_A_HOLD - 1))  # decades slower
    change = strength_of(case, DRIFT) * HOLD * HOLDING - force * strength_of(case, RATE) * after
    return at_rest_after(force, change, strength_of(case, OFFSET), random)


def at_rest_after(
    force: float, change: np.ndarray, at_rest: float, random: np.random.Generator
) -> np.ndarray:
    """A curve of loading to a force (N) and a hold in which the reading changes by this (n,)."""
    up = np.linspace(0.0, 1.0, 40)[:-1]
    way = np.concatenate([LOADING_MM * up**0.5, np.full(len(change), LOADING_MM)])
    return read_in_time(way, np.concatenate([force * up, force + change]), at_rest, random)


def read_in_time(
    way: np.ndarray, force: np.ndarray, at_rest: float, random: np.random.Generator,
    after: float | None = None,
) -> np.ndarray:  # fmt: skip
    """What a machine writes that reads by the clock: (readings, 2) of a way (mm) and a reading (N),
    with those in the air before it, and after it if the platen goes back."""
    away = STEP_IN_AIR * np.arange(1, IN_AIR + 1)
    x = np.concatenate([way[0] - away[::-1], way, [] if after is None else way[-1] - away])
    back = [] if after is None else np.full(IN_AIR, after)
    f = np.concatenate([np.full(IN_AIR, at_rest), force, back])
    x = x + DISPLACEMENT_SD * random.standard_normal(len(x))
    return np.column_stack([x, f + FORCE_SD * random.standard_normal(len(f))])


# ---------------------------------------------------------------- the loop


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
        prepared = setup.prepared(d, measured)
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
