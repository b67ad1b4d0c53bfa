"""The pair of tests that the diagnosis compares: confined, then unconfined compression.

Its library of runs holds both tests on one specimen, so a lab has to begin with these.  What comes
after them are further tests (`calibrate.discrepancy.library.further_tests`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from calibrate.core.errors import BadValue, shown
from calibrate.labtests.base import AbstractLabTest
from calibrate.labtests.confined import ConfinedTest
from calibrate.labtests.unconfined import UnconfinedTest

KINDS = (ConfinedTest.type_name, UnconfinedTest.type_name)


@dataclass(frozen=True)
class Pair:
    """Compression in the mould to a largest force, and crushing of the free specimen."""

    compression: ConfinedTest
    crushing: UnconfinedTest

    @property
    def rates(self) -> dict[str, float]:
        """The platen's speeds (m/s) by test."""
        return {KINDS[0]: self.compression.rate, KINDS[1]: self.crushing.rate}


def pair_of(tests: Sequence[AbstractLabTest]) -> Pair:
    """The first two tests of a lab; `BadValue` says why a library of runs does not hold them."""
    for place, test in enumerate(tests[: len(KINDS)]):
        misfit = _misfit(test, place)
        if misfit:
            problem = f"a library of runs holds {HELD}, but {misfit}"
            steps = test.shape == "steps" and place == 0
            raise BadValue(problem, OF_STEPS if steps else REPAIR, f"tests[{place}]")
    if len(tests) < len(KINDS):
        problem = f"a library of runs holds {HELD}, but no test here is {KINDS[len(tests)]}"
        raise BadValue(problem, REPAIR, "tests")
    return Pair(cast(ConfinedTest, tests[0]), cast(UnconfinedTest, tests[1]))


HELD = f"{KINDS[0]} and then {KINDS[1]} compression of one specimen"
REPAIR = "give a lab file that begins with these two; others may come after them"

OF_STEPS = (
    'give its curves to a test of type = "confined" whose force_high is a load of 50 to 500 kPa '
    "times the area, and then an unconfined test; the soil trumao_curves does so"
)


def _misfit(test: AbstractLabTest, place: int) -> str:
    """Why a library does not hold the test at this place of a lab; "" if it does."""
    if test.type_name != KINDS[place]:
        return f"test {shown(test.called)}, number {place + 1}, is of type {test.type_name}"
    if test.protocol:
        return f"test {shown(test.called)} follows a protocol of its own"
    if place and test.specimen is not None:
        return f"test {shown(test.called)} is made on a specimen of its own"
    if test.called != test.type_name:
        return f"the test of type {test.type_name} is called {shown(test.called)}: leave out name"
    return ""
