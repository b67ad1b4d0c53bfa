"""Numbers that are read off measured and simulated curves alike, and that a fit compares.

Displacements (mm) are read at forces, forces (N) at displacements.  Both count from a force that
every measured record holds: the seating force, or the preload at which the latest of them begins.
A protocol with several loads and unloads is walked along: a waypoint is the next place on the
curve where its force is reached.
"""

import abc
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from calibrate.labtests.measured import Curve

SEATING = 2.0  # N; force at which displacement starts to count, where every record holds it
REVERSAL = 0.05  # share of the largest force; smaller ups and downs are noise
A_BRANCH = (0.25, 0.5, 0.75, 1.0)  # where a continuous record is read, shares of a branch's forces
SHORT_OF = 0.02  # share of a force or a way by which a machine may stop before it


@dataclass(frozen=True)
class AbstractFeature(abc.ABC):
    """One number of a specimen: its name, its unit, the test that it belongs to."""

    is_target: ClassVar[bool] = False

    name: str
    unit: str
    test: str

    @abc.abstractmethod
    def of(self, observables: Mapping[str, float], curves: Mapping[str, np.ndarray]) -> float:
        """This feature of a specimen; curves by test have shape (points, 2), in mm and N."""


@dataclass(frozen=True)
class ScalarTarget(AbstractFeature):
    """An observable that is known without a curve."""

    is_target = True

    def of(self, observables: Mapping[str, float], curves: Mapping[str, np.ndarray]) -> float:
        return observables[self.name]


@dataclass(frozen=True)
class AbstractCurveFeature(AbstractFeature):
    """A number read off the curve of one test."""

    def of(self, observables: Mapping[str, float], curves: Mapping[str, np.ndarray]) -> float:
        return self.of_curve(*curves[self.test].T)

    @abc.abstractmethod
    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        """This feature of one curve."""


@dataclass(frozen=True)
class DisplacementOnLoading(AbstractCurveFeature):
    """Displacement (mm) beyond that at `zero` (N) at which the rising force reaches `force` (N)."""

    force: float
    zero: float = SEATING

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        turn = int(np.argmax(force_n)) + 1
        return displacement_up(displacement_mm[:turn], force_n[:turn], self.force, self.zero)


@dataclass(frozen=True)
class DisplacementOnUnloading(AbstractCurveFeature):
    """Displacement (mm) beyond that at `zero` (N) on loading, at `force` (N) after the largest."""

    force: float
    zero: float = SEATING

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        turn = int(np.argmax(force_n))
        highest = np.maximum.accumulate(force_n[: turn + 1])
        zero = np.interp(self.zero, highest, displacement_mm[: turn + 1])
        lowest = np.minimum.accumulate(force_n[turn:])
        return float(np.interp(self.force, lowest[::-1], displacement_mm[turn:][::-1]) - zero)


@dataclass(frozen=True)
class ForceAtDisplacement(AbstractCurveFeature):
    """Force (N) at `displacement` (mm) beyond that at `zero` (N), averaged over a tenth of it."""

    displacement: float
    zero: float = SEATING

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        seated = displacement_mm - seat(displacement_mm, force_n, self.zero)
        near = np.abs(seated - self.displacement) <= max(0.05 * self.displacement, 0.05)
        interpolated = np.interp(self.displacement, seated, force_n)
        return float(force_n[near].mean()) if near.sum() > 2 else float(interpolated)


@dataclass(frozen=True)
class ForceAtEnd(AbstractCurveFeature):
    """Force (N) at the end of the curve."""

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        return float(force_n[-1])


@dataclass(frozen=True)
class Waypoint:
    """A force (N) that a protocol passes, on the way up or down."""

    force: float
    rising: bool


@dataclass(frozen=True)
class DisplacementOnPath(AbstractCurveFeature):
    """Displacement (mm) at the last waypoint of a path, beyond that at its first; NaN where a
    curve does not come that way."""

    path: tuple[Waypoint, ...]

    def of_curve(self, displacement_mm: np.ndarray, force_n: np.ndarray) -> float:
        places, row = [], 0
        for waypoint in self.path:
            row, place = _next(displacement_mm, force_n, row, waypoint)
            places.append(place)
        return places[-1] - places[0]


def zero_of(curves: Sequence[Curve]) -> float:
    """Force (N) that all records hold on loading: what lies below the first row of one of them is
    not known there, so that neither it nor a simulation may be counted from it."""
    return max(SEATING, *(float(curve.force_n[0]) for curve in curves))


def seat(displacement: np.ndarray, force: np.ndarray, zero: float) -> float:
    """Displacement (mm) at the first row that carries `zero` (N), at the largest force if none."""
    reached = force >= zero
    return float(displacement[int(np.argmax(reached if reached.any() else force))])


def displacement_up(
    displacement: np.ndarray, force: np.ndarray, wanted: float, zero: float = SEATING
) -> float:
    """Displacement (mm) beyond that at `zero` (N) at which the rising force is `wanted` (N)."""
    highest = np.maximum.accumulate(force)
    return float(np.interp(wanted, highest, displacement) - np.interp(zero, highest, displacement))


def path_features(test: str, curves: Sequence[Curve]) -> list[AbstractFeature]:
    """Displacements along the path of the first curve: at each load step, or on each branch of a
    continuous record; all count from the first of them."""
    first = curves[0]
    path = _steps(first.force_n) if first.points else _branches(first.force_n)
    found: list[AbstractFeature] = []
    for end in range(2, len(path) + 1):
        last = path[end - 1]
        number = _turns(path[:end])
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
    on, a specimen breaks and nothing is unloaded."""
    rows = turning_rows(force)
    kept = [rows[1]] if len(rows) > 1 and force[rows[1]] > force[rows[0]] else []
    for begin, end in pairwise(rows[1:] if kept else ()):
        falls = force[end] < force[begin]
        if falls and displacement[end] >= displacement[begin]:
            return ()
        kept.append(end)
    return tuple(float(force[row]) for row in kept) if len(kept) > 2 else ()


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


def _turns(path: Sequence[Waypoint]) -> int:
    """How often the path turns."""
    return sum(a.rising != b.rising for a, b in pairwise(path))


def _next(
    displacement: np.ndarray, force: np.ndarray, row: int, waypoint: Waypoint
) -> tuple[int, float]:
    """Row and displacement at which the curve passes a waypoint, from `row` on."""
    sign = 1.0 if waypoint.rising else -1.0
    rest, wanted = sign * force[row:], sign * waypoint.force
    reached = rest >= wanted
    if not reached.any():
        nearest = int(np.argmax(rest))
        close = abs(rest[nearest] - wanted) <= SHORT_OF * abs(wanted) + SEATING
        return row + nearest, float(displacement[row + nearest]) if close else np.nan
    at = row + int(np.argmax(reached))
    before = max(at - 1, row)
    change = force[at] - force[before]
    share = (waypoint.force - force[before]) / change if change else 1.0
    way = displacement[at] - displacement[before]
    return at, float(displacement[before] + np.clip(share, 0.0, 1.0) * way)
