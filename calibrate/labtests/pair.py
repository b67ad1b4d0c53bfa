"""The pair of tests that the diagnosis compares: confined, then unconfined compression.

Its library of runs holds both tests on one specimen, so a lab has to have just these.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from calibrate.core.errors import BadValue
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
    """Both tests of a lab; `BadValue` where it has others, or they follow their own protocols."""
    called = tuple(test.called for test in tests)
    if called != KINDS or any(test.protocol for test in tests) or tests[1].specimen is not None:
        problem = f"the diagnosis knows {KINDS[0]} and then {KINDS[1]} compression of one specimen"
        raise BadValue(problem, "give these two tests without protocols, in a file of their own")
    return Pair(cast(ConfinedTest, tests[0]), cast(UnconfinedTest, tests[1]))
