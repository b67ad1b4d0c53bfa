"""The laboratory behind the seal makes further tests: what `calibrate next` asks for, as a lab file
with curves beside it.

    test again      both tests on fresh packings; effects kept away or scaled as the test's table
                    says; at 10^n of the rate contact forces times exp(rho n), rho: rate dependence
    machine alone   `jdem.laboratory.bare_machine` with the case's effects; a known weight reads
                    what the load cell makes of it
    hold            F (1 - rho decades) + drift; spheres at rest lose next to nothing more

Every answer is kept; a test is made once, whoever asks for it.  Fresh specimens are those that a
case holds back, in turn.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from calibrate.core.files import write_text
from calibrate.discrepancy.comparison.next_test import Proposal
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
)
from calibrate.io.lab import Lab, load_lab
from calibrate.labtests.diagnosis.base import Condition, Variation
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, TESTS
from calibrate.labtests.machine import MachineTest
from calibrate.labtests.relaxation import RelaxationTest
from calibrate.simulation.resolution import STILL
from calibrate.simulation.run import points_of
from calibrate.validation.laboratory import DISPLACEMENT_SD, FORCE_SD, Laboratory
from calibrate.validation.plan import SPECIMENS, Hidden, WithheldCase
from jdem.effects.base import AbstractEffect
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence

VARIATIONS: tuple[tuple[str, Variation], ...] = tuple(
    (test, variation) for test in TESTS for variation in TEST_FEATURES[test].variations
)
IN_AIR = 20  # readings before contact, mm apart
STEP_IN_AIR = 0.01
HOLDING = np.linspace(0.0, 1.0, 61)  # share of a hold at which it is read
LOADING_MM = 2.0  # of travel before a hold, which says nothing


@dataclass(frozen=True, eq=False)
class FurtherLaboratory:
    """Makes further tests of cases; answers lie in `folder`."""

    laboratory: Laboratory
    folder: Path

    def answer(self, case: WithheldCase, lab: Lab, asked: Proposal) -> Lab | None:
        """The lab file of a test, as `calibrate next` wrote it, with its curves; None if a specimen
        does not stand."""
        place = self.folder / case.name / re.sub(r"\W+", "_", asked.name)
        if not (place / ANSWER).exists():
            curves = self._curves(case, lab, asked)
            if curves is None:
                return None
            for number, curve in enumerate(curves, 1):
                rows = "\n".join(f"{x:.3f},{f:.1f}" for x, f in curve)
                name = CURVES.format(number=number)
                write_text(place / name, f"displacement,force\n{rows}\n")
            write_text(place / ANSWER, answer_file(lab, self._weighed(case, asked)))
        return load_lab(place / ANSWER)

    def _curves(self, case: WithheldCase, lab: Lab, asked: Proposal) -> list[np.ndarray] | None:
        """Curves (readings, 2) of the repeats, mm and N."""
        kind = asked.entries["type"]
        random = np.random.default_rng([case.seed, *asked.name.encode()])
        if kind == MachineTest.type_name:
            return [self._bare(case, lab, random) for _ in range(REPEATS)]
        if kind == RelaxationTest.type_name:
            return [held(case, lab, random) for _ in range(REPEATS)]
        number = [variation.name for _, variation in VARIATIONS].index(asked.name)
        test, variation = VARIATIONS[number]
        condition = TEST_FEATURES[test].varied(variation.faster, variation.entries)
        held_back = len(case.packings) - SPECIMENS
        first = SPECIMENS + REPEATS * number % held_back
        other = under(case, condition)
        made = self.laboratory.specimens(other, range(first, first + REPEATS))
        return None if made is None else [specimen.records[test] for specimen in made]

    def _weighed(self, case: WithheldCase, asked: Proposal) -> Proposal:
        """The test with what the load cell reads of a known weight, if one is asked for."""
        if "weight" not in asked.entries:
            return asked
        random = np.random.default_rng([case.seed, *asked.name.encode(), 1])
        true = MachineTest.model_validate({**asked.entries, "reads": "1 N"}).weight or 0.0
        of_cell = (e.force_error(jnp.asarray(true), jnp.asarray(0.0)) for e in of_machine(case))
        reads = true + float(sum(of_cell)) + FORCE_SD * random.standard_normal()
        return replace(asked, entries={**asked.entries, "reads": f"{reads:.1f} N"})

    def _bare(self, case: WithheldCase, lab: Lab, random: np.random.Generator) -> np.ndarray:
        """A curve of the machine without soil, to the largest force of the lab's first test."""
        force = lab.pair().compression.force_high
        test = MachineTest.model_validate({"name": "bare", "force": f"{force!r} N"})
        press = test.apparatus(lab.specimen, STILL)
        (reading,) = BareMachine(TestSequence((press,)), of_machine(case)).run().values()
        way, reads = points_of(reading.curve).T
        return read_in_time(way, reads, strength_of(case, OFFSET), random, reads[-1])


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
    lost = force * strength_of(case, RATE) * after
    reads = force - lost + strength_of(case, DRIFT) * HOLD * HOLDING
    up = np.linspace(0.0, 1.0, 40)[:-1]
    way = np.concatenate([LOADING_MM * up**0.5, np.full(len(reads), LOADING_MM)])
    return read_in_time(way, np.concatenate([force * up, reads]), strength_of(case, OFFSET), random)


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
