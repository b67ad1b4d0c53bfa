"""Numbers that are read off measured and simulated curves alike, and that a fit compares.

A feature is declared once, with the zero from which its displacement counts, and reads any curve
with the functions of `calibrate.labtests.reading`.  A fit counts from a force that every measured
record holds: the seating force, or the preload at which the latest of them begins.  A protocol with
several loads and unloads is walked along: a waypoint is the next place on the curve where its force
is reached.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jax import Array

from calibrate.labtests.measured import Curve
from calibrate.labtests.reading import (
    Zero,
    displacement_on_rise,
    force_near,
    loading,
    passing,
    peak_displacement,
    unloading,
)
from jdem.observables import AbstractGauge
from jdem.observables import Curve as RunCurve

SEATING = 2.0  # N; force at which displacement starts to count, where every record holds it
SEATED = Zero(SEATING)
REVERSAL = 0.05  # share of the largest force; smaller ups and downs are noise
A_BRANCH = (0.25, 0.5, 0.75, 1.0)  # where a continuous record is read, shares of a branch's forces
NARROWEST = 0.05  # mm to either side, over which a force is averaged
SHORT_OF = 0.02  # share of a force or a way by which a machine may stop before it


@dataclass(frozen=True)
class AbstractFeature(abc.ABC):
    """One number of a specimen: its name, its unit, the test that it belongs to."""

    is_target: ClassVar[bool] = False

    name: str
    unit: str
    test: str

    def of(self, observables: Mapping[str, float], curves: Mapping[str, np.ndarray]) -> float:
        """This feature of a specimen; curves by test have shape (points, 2), in mm and N."""
        return float(self.read(observables, curves))

    def begun_later(self, by: float) -> "AbstractFeature":
        """The same, counting displacement `by` (mm) later, where it has a zero at a force."""
        zero = getattr(self, "zero", None)
        if zero is None or zero.force is None:
            return self
        return replace(self, zero=replace(zero, beyond=zero.beyond + by))  # pyright: ignore[reportCallIssue]

    @abc.abstractmethod
    def read(self, observables: Mapping[str, Any], curves: Mapping[str, Any]) -> Any:
        """The same of numpy or JAX, which can differentiate it."""


@dataclass(frozen=True)
class ScalarTarget(AbstractFeature):
    """An observable that is known without a curve."""

    is_target = True

    def read(self, observables: Mapping[str, Any], curves: Mapping[str, Any]) -> Any:
        return observables[self.name]


@dataclass(frozen=True)
class AbstractCurveFeature(AbstractFeature):
    """A number read off the curve of one test."""

    def read(self, observables: Mapping[str, Any], curves: Mapping[str, Any]) -> Any:
        return self.of_curve(*curves[self.test].T)

    @abc.abstractmethod
    def of_curve(self, displacement_mm, force_n) -> Any:
        """This feature of one curve, of numpy or JAX, whose arrays have shape (points,)."""


@dataclass(frozen=True)
class DisplacementOnLoading(AbstractCurveFeature):
    """Displacement (mm) beyond `zero` at which the rising force reaches `force` (N, or an array of
    several); JAX takes its derivative over `window` as in `jdem.observables.Curve`."""

    force: float | np.ndarray
    zero: Zero = SEATED
    window: float = 0.0

    def of_curve(self, displacement_mm, force_n):
        rise = loading(displacement_mm, force_n)
        return displacement_on_rise(*rise, self.force, self.window) - self.zero.of(*rise)


@dataclass(frozen=True)
class DisplacementOnUnloading(AbstractCurveFeature):
    """Displacement (mm) beyond `zero` on loading, at `force` (N) after the largest."""

    force: float
    zero: Zero = SEATED

    def of_curve(self, displacement_mm, force_n):
        zero = self.zero.of(*loading(displacement_mm, force_n))
        return displacement_on_rise(*unloading(displacement_mm, force_n), self.force) - zero


@dataclass(frozen=True)
class ForceAtDisplacement(AbstractCurveFeature):
    """Force (N) at `displacement` (mm, or an array of several where the half-width is 0) beyond
    `zero`, a mean over `half_width` (mm) to either side; None: over a twentieth of the
    displacement, at least `NARROWEST`."""

    displacement: float | np.ndarray
    zero: Zero = SEATED
    half_width: float | None = None

    def of_curve(self, displacement_mm, force_n):
        seated = displacement_mm - self.zero.of(*loading(displacement_mm, force_n))
        near = self.half_width
        if near is None:
            near = max(0.05 * float(self.displacement), NARROWEST)
        return force_near(seated, force_n, self.displacement, near)


@dataclass(frozen=True)
class ForceAtEnd(AbstractCurveFeature):
    """Force (N) at the end of the curve."""

    def of_curve(self, displacement_mm, force_n):
        return force_n[-1]


@dataclass(frozen=True)
class StrainAtPeak(AbstractCurveFeature):
    """Strain (%) at the largest force: the displacement beyond `zero` over the specimen's `height`
    (mm); the force is averaged over `half_width` (mm) to either side."""

    height: float
    half_width: float
    zero: Zero = SEATED

    def of_curve(self, displacement_mm, force_n):
        zero = self.zero.of(*loading(displacement_mm, force_n))
        peak = peak_displacement(displacement_mm, force_n, self.half_width)
        return 100 * (peak - zero) / self.height


@dataclass(frozen=True)
class SecantModulus(AbstractCurveFeature):
    """Secant modulus (kPa): stress at a `share` of the largest force on a specimen of this `area`
    (mm2), over the strain there, which counts from `zero` on this `height` (mm)."""

    share: float
    area: float
    height: float
    zero: Zero = SEATED

    def of_curve(self, displacement_mm, force_n):
        rise = loading(displacement_mm, force_n)
        force = self.share * force_n.max()
        way = displacement_on_rise(*rise, force) - self.zero.of(*rise)
        return 1e3 * (force / self.area) / (way / self.height)


@dataclass(frozen=True)
class WorkToPeak(AbstractCurveFeature):
    """Work (J) of the force up to its largest value."""

    def of_curve(self, displacement_mm, force_n):
        way, force = loading(displacement_mm, force_n)
        return 1e-3 * ((force[1:] + force[:-1]) * (way[1:] - way[:-1])).sum() / 2


class FeatureGauge(AbstractGauge):
    """A feature as a number of a run, SI: `scale` takes it from there to the feature's unit."""

    feature: AbstractCurveFeature = eqx.field(static=True)
    scale: float = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def of(self, curve: RunCurve, movement: Array) -> Array:
        whole = curve.filled()
        return self.feature.of_curve(1e3 * whole.displacement, whole.force) / self.scale


@dataclass(frozen=True)
class Waypoint:
    """A force (N) that a protocol passes, on the way up or down."""

    force: float
    rising: bool


@dataclass(frozen=True)
class DisplacementOnPath(AbstractCurveFeature):
    """Displacement (mm) at the last waypoint of a path, beyond that at its first, which is the
    zero; NaN where a curve does not come that way."""

    path: tuple[Waypoint, ...]

    def of_curve(self, displacement_mm, force_n):
        places, row = [], 0
        for point in self.path:
            short = SHORT_OF * abs(point.force) + SEATING
            row, place = passing(displacement_mm, force_n, row, point.force, point.rising, short)
            places.append(place)
        return places[-1] - places[0]


def zero_of(curves: Sequence[Curve]) -> float:
    """Force (N) that all records hold on loading: what lies below the first row of one of them is
    not known there, so that neither it nor a simulation may be counted from it."""
    return max(SEATING, *(float(curve.force_n[0]) for curve in curves))


def path_features(test: str, curves: Sequence[Curve]) -> list[AbstractFeature]:
    """Displacements along the path of the first curve: at each load step, or on each branch of a
    continuous record; all count from the first of them."""
    first = curves[0]
    path = _steps(first.force_n) if first.points else _branches(first.force_n)
    found: list[AbstractFeature] = []
    for end in range(2, len(path) + 1):
        last = path[end - 1]
        number = sum(a.rising != b.rising for a, b in pairwise(path[:end]))  # of turns
        course = ("loading", "unloading")[number % 2] if path[0].rising else "course"
        name = f"displacement at {last.force:.4g} N, {course} {number // 2 + 1}, {test}"
        found.append(DisplacementOnPath(name, "mm", test, tuple(path[:end])))
    return found


def turning_rows(force: np.ndarray) -> list[int]:
    """Rows (first and last among them) between which the force rises or falls as a whole."""
    least = REVERSAL * float(np.ptp(force))
    turns, extreme, rising = [0], 0, None
    for row, value in enumerate(force):
        if rising is None:
            if abs(value - force[0]) > least:
                rising, extreme = value > force[0], row
        elif (value > force[extreme]) == rising:
            extreme = row
        elif abs(value - force[extreme]) > least:
            turns.append(extreme)
            rising, extreme = not rising, row
    return [*turns, extreme] if extreme != turns[-1] else turns


def cyclic_course(displacement: np.ndarray, force: np.ndarray) -> tuple[float, ...]:
    """Forces (N) between which a record goes up and down again, beginning with the end of its
    first loading; empty where it is loaded only once.  Where the force falls while the platen goes
    on, a specimen breaks and nothing is unloaded; where a loading does not end above zero,
    nothing is pressed."""
    rows = turning_rows(force)
    kept = [rows[1]] if len(rows) > 1 and force[rows[1]] > force[rows[0]] else []
    for begin, end in pairwise(rows[1:] if kept else ()):
        falls = force[end] < force[begin]
        if falls and displacement[end] >= displacement[begin]:
            return ()
        kept.append(end)
    pressed = all(force[row] > 0 for row in kept[::2])
    return tuple(float(force[row]) for row in kept) if len(kept) > 2 and pressed else ()


def _steps(force: np.ndarray) -> list[Waypoint]:
    """Every load step; a repeated load counts once."""
    kept = [row for row in range(len(force)) if row == 0 or force[row] != force[row - 1]]
    rising = [force[b] > force[a] for a, b in pairwise(kept)]
    return [
        Waypoint(float(force[row]), bool(up))
        for row, up in zip(kept, [True, *rising], strict=False)
    ]


def _branches(force: np.ndarray) -> list[Waypoint]:
    """Shares of each branch of a continuous record."""
    path: list[Waypoint] = []
    rows = turning_rows(force)
    for begin, end in pairwise(rows):
        low, high = force[begin], force[end]
        path += [
            Waypoint(float(low + share * (high - low)), bool(high > low)) for share in A_BRANCH
        ]
    return path
