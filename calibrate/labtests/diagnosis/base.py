"""A feature of a curve, and what a type of test says of its features.

A feature is one number of a specimen: a displacement read at a force, a force read at a
displacement, or a property of the whole curve, so that equal features of two curves mean the same
location whatever the sampling was.  A type of test declares its features before the data are
looked at, for a soil and not for a specimen, and reads them off a curve.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from calibrate.labtests.reading import AS_RECORDED, Zero, rising

BEFORE = "before contact"  # kind and segment of the force that a machine shows at rest
TARGET = "target"  # kind and segment of a scalar that is known without a curve
TOE = "toe"  # segment of first touch, which a record that begins later does not hold
REFERENCE = 0.5  # share of the largest force whose displacement on loading is zero
APART = (TARGET, BEFORE)  # kinds that are not read off a curve's course

Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]  # test -> displacement (mm), force (N)
Values = dict[tuple[str, float], float]  # (kind, abscissa) -> value


@dataclass(frozen=True)
class Feature:
    """One number of a specimen: where it is read and in which unit it is.

    kind is one of its test's kinds, "before contact" or "target"; abscissa is the force (N) or
    displacement (mm) at which it is read.  `scale` is what all abscissae of its test are shares
    of; `zero` says where displacement begins to count; `position` runs from 0 to 1 along the test.
    """

    name: str
    test: str
    segment: str
    kind: str
    abscissa: float
    unit: str
    position: float
    scale: float = 1.0
    zero: Zero = AS_RECORDED


@dataclass(frozen=True)
class UsualSizes:
    """By what features are declared: the largest force (N) of compression, and the usual
    displacement (mm) and force (N) of a peak."""

    force_high: float
    peak_mm: float
    peak_n: float


class PlatenTest(Protocol):
    """What conditions need of a test's table."""

    rate: float


@dataclass(frozen=True)
class Variation:
    """The test again under another condition: its cost (h), by what factor it is faster, and the
    entries of its table in a lab file that are true then."""

    name: str
    cost: float
    faster: float = 1.0
    entries: tuple[str, ...] = ()


@dataclass(frozen=True)
class Condition:
    """How a test differs from the first of its type: factors on the strengths of effects, and the
    decades of rate by which it is faster."""

    factors: Mapping[str, float]
    decades: float


class AbstractTestFeatures(abc.ABC):
    """The features of one type of test.

    name: as in `Feature.test`; label: for readers; axis: of displacement, as features count it;
    segments: words for each segment; target: the scalar observable of the test; branches: kinds
    that follow the curve, by abscissa; tared: kinds that are read without the force before
    contact (None: all); read_at_forces: whether abscissae are forces; variations: of the test that
    would separate explanations; switches: entries of its table that keep an effect away.
    """

    name: ClassVar[str]
    label: ClassVar[str]
    axis: ClassVar[str]
    segments: ClassVar[Mapping[str, str]]
    target: ClassVar[str]
    branches: ClassVar[tuple[str, ...]]
    tared: ClassVar[tuple[str, ...] | None]
    read_at_forces: ClassVar[bool]
    variations: ClassVar[tuple[Variation, ...]]
    switches: ClassVar[Mapping[str, str]]

    @abc.abstractmethod
    def with_rate(self, faster: float) -> Mapping[str, float]:
        """Factors on the strengths of effects in a test that is faster by a factor."""

    def condition(self, first: PlatenTest, other: PlatenTest) -> Condition:
        """How `other` differs from the first test of this type."""
        on = [
            entry for entry in self.switches
            if getattr(other, entry) and not getattr(first, entry)
        ]  # fmt: skip
        return self.varied(other.rate / first.rate, on)

    def varied(self, faster: float, entries: Sequence[str]) -> Condition:
        """The condition of a test that is faster by a factor, with these entries true."""
        away = dict.fromkeys((self.switches[entry] for entry in entries), 0.0)
        return Condition({**self.with_rate(faster), **away}, float(np.log10(faster)))

    @abc.abstractmethod
    def declare(self, usual: UsualSizes) -> tuple[Feature, ...]:
        """All features of the test."""

    @abc.abstractmethod
    def read(
        self, features: Sequence[Feature], displacement: np.ndarray, force: np.ndarray
    ) -> Values:
        """Values of the test's `features` (none of `APART`, at least one) on a curve in the order
        of recording; NaN where the curve does not reach."""

    @abc.abstractmethod
    def beyond(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        """Mask (m,) of the features that a tared curve (N) does not reach."""

    @abc.abstractmethod
    def before_start(self, features: Sequence[Feature], force: np.ndarray) -> np.ndarray:
        """Mask (m,) of the test's features that a record (N) does not hold which begins at contact
        or at a preload."""

    def in_words(self, segment: str) -> str:
        """A segment of this test for readers."""
        return self.segments.get(segment, f"{segment} of the {self.label}")

    @abc.abstractmethod
    def last_of_rise(self, displacement: np.ndarray, force: np.ndarray) -> int:
        """The row at which a curve's rise ends."""

    def zero(self, feature: Feature, displacement: np.ndarray, force: np.ndarray) -> float:
        """Displacement (mm) on a curve from which its features count; `feature`: any of them."""
        end = self.last_of_rise(displacement, force) + 1
        return float(feature.zero.of(*rising(displacement[:end], force[:end], averaged=False)))

    @abc.abstractmethod
    def stretched_by(self, usual: UsualSizes) -> tuple[str, str]:
        """Names of the features whose ratios stretch a curve in displacement and in force to
        another soil's size; "" for none."""

    def mine(self, features: Sequence[Feature]) -> list[Feature]:
        """Those of the features that are read off this test's curve."""
        return [f for f in features if f.test == self.name and f.kind not in APART]
