"""Curves as numbers: declared places on the curves of both tests, and how they are read.

A feature is read at a force in the confined test (a displacement, mm) and at a
displacement in the unconfined test (a force, N), so that equal features of two curves mean the
same place whatever the sampling was.  What a laboratory is free to choose drops out:
displacements of the confined test count from the one at half the largest force on loading,
those of the unconfined test from a seating force.  Noise is averaged, not followed: branches
go through the closest rising or falling curve (isotonic regression), forces through a
straight line over a short window.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import isotonic_regression

CONFINED, UNCONFINED = "confined", "unconfined"
TESTS = (CONFINED, UNCONFINED)

# Shares of the largest force at which displacement is read, by segment.
ON_LOADING = {
    "toe": (0.0125, 0.025, 0.05),
    "loading": (0.075, 0.1, 0.15, 0.2, 0.275, 0.35, 0.425),
    "200-400 N": (0.575, 0.65, 0.725, 0.8, 0.875, 0.95, 0.99),
}
ON_UNLOADING = {
    "reversal": (0.98, 0.95, 0.9),
    "unloading": (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05),
}
# Shares of the displacement at the peak at which force is read, by segment.
ON_CRUSHING = {
    "toe": (0.05, 0.1, 0.15, 0.2),
    "rise": (0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
    "peak": (0.9, 1.0, 1.1),
    "softening": (1.25, 1.4, 1.6, 1.8, 2.0),
}
REFERENCE = 0.5  # share of the largest force whose displacement on loading is zero
SEATING = 0.02  # share of the crushing force at which displacement starts to count
WINDOW = 0.04  # half-width of the averaging window, share of the displacement at the peak
NEAR_PEAK = 0.95  # share of the peak above which the peak's place is averaged
LATE = 0.08  # share of the largest force; a loading that begins above it is read from there on
CONTACT = 0.012  # share of the range of forces at which the platen surely touches
BEYOND = 0.01  # share of the largest force by which a tared loading may end too early
TOUCH = 0.002  # the same at which it may touch already, where noise allows to see it
SURE = 4.0  # deviations of a reading that are no noise
FEWEST_BEFORE = 3  # readings before contact that make a mean
BEFORE = "before contact"  # kind and segment of the force that a machine shows at rest
APART = ("target", BEFORE)  # kinds that are not read off a curve's course
TEST_OF_TARGET = {"depression_depth_mm": CONFINED, "crushing_force_n": UNCONFINED}

Curves = Mapping[str, tuple[np.ndarray, np.ndarray]]  # test -> displacement (mm), force (N)


@dataclass(frozen=True)
class Feature:
    """One number of a specimen: where it is read and in which unit it is.

    kind is "loading", "unloading" (abscissa in N), "crushing" (abscissa in mm), "largest
    force", "travel at the top", "peak force", "peak displacement", "before contact" or
    "target".  `scale` is the force (N; confined) or displacement (mm; unconfined) that all
    abscissae are shares of; `force` is the seating force (N; unconfined); `position` runs from
    0 to 1 along the test.
    """

    name: str
    test: str
    segment: str
    kind: str
    abscissa: float
    unit: str
    position: float
    scale: float = 1.0
    force: float = 0.0


def declare(force_high_n: float, peak_mm: float, peak_n: float) -> tuple[Feature, ...]:
    """All features of both tests, for a largest force and a usual place of the peak.

    They are declared before the data are looked at: for a soil, not for a specimen.
    """
    return (*declare_confined(force_high_n), *declare_unconfined(peak_mm, peak_n))


def declare_confined(force_high_n: float) -> tuple[Feature, ...]:
    """Features of confined compression to `force_high_n` (N) and back."""
    up = [
        _confined(segment, "loading", share, force_high_n, 0.6 * share)
        for segment, shares in ON_LOADING.items()
        for share in shares
    ]
    top = [
        _special(CONFINED, "reversal", "largest force", "N", force_high_n, 0.0, 0.61),
        _special(CONFINED, "reversal", "travel at the top", "mm", force_high_n, 0.0, 0.62),
    ]
    down = [
        _confined(segment, "unloading", share, force_high_n, 1.0 - 0.36 * share)
        for segment, shares in ON_UNLOADING.items()
        for share in shares
    ]
    return (*up, *top, *down)


def declare_unconfined(peak_mm: float, peak_n: float) -> tuple[Feature, ...]:
    """Features of crushing with the peak usually near `peak_mm` (mm) and `peak_n` (N)."""
    seat = SEATING * peak_n
    forces = [
        _crushing(segment, share, peak_mm, seat)
        for segment, shares in ON_CRUSHING.items()
        for share in shares
    ]
    peak = [
        _special(UNCONFINED, "peak", "peak force", "N", peak_mm, seat, 0.5),
        _special(UNCONFINED, "peak", "peak displacement", "mm", peak_mm, seat, 0.5),
    ]
    return (*forces, *peak)


def declare_targets(names: Sequence[str]) -> tuple[Feature, ...]:
    """Features of a soil of which only scalar targets are known (`TEST_OF_TARGET`)."""
    return tuple(
        Feature(name, TEST_OF_TARGET[name], "target", "target", 0.0, _unit_of(name), 0.5)
        for name in names
    )


def declare_before_contact() -> tuple[Feature, ...]:
    """The force (N) that a machine shows before its platen touches, in both tests."""
    return tuple(
        Feature(f"force before contact, {test}", test, BEFORE, BEFORE, 0.0, "N", 0.0)
        for test in TESTS
    )  # fmt: skip


def force_before_contact(force: np.ndarray) -> float:
    """Mean of the readings (N) before force leaves them at all, NaN if they are fewer than
    `FEWEST_BEFORE`."""
    away = force - np.median(force[:FEWEST_BEFORE])
    seconds = np.diff(force, 2)
    noise = 1.4826 * np.median(np.abs(seconds - np.median(seconds))) / np.sqrt(6)
    leaves = np.argmax(away > max(TOUCH * away.max(), SURE * noise))
    readings = min(int(leaves) - 1, readings_before_contact(force))
    return float(force[:readings].mean()) if readings >= FEWEST_BEFORE else np.nan


def readings_before_contact(force: np.ndarray) -> int:
    """How many readings (N) come surely before contact.

    Contact is where force leaves its first readings' median by more than CONTACT of its
    range, two readings earlier to be safe.
    """
    away = force - np.median(force[:FEWEST_BEFORE])
    return max(int(np.argmax(away > CONTACT * away.max())) - 2, 0)


def tared_rows(features: Sequence[Feature]) -> np.ndarray:
    """Mask (m,) of the features that are read after the force before contact is taken off: all of
    crushing, and confined loading, which do not know where the machine will turn."""
    return np.array([f.test == UNCONFINED or f.kind == "loading" for f in features])


def seen(
    features: Sequence[Feature], curves: Curves, rest: Mapping[str, float] | None = None
) -> np.ndarray:
    """Features (m,) of recorded curves: the force before contact itself, the others cut where the
    platen surely touches, those of `tared_rows` without that force, unless there are too few
    readings of it.

    rest: that force (N) by test, for curves that do not show it.
    """
    cut = from_contact_on(curves)
    known = rest or {}
    at_rest = {test: force_before_contact(force) for test, (_, force) in curves.items()}
    taken = {t: b if np.isfinite(b) else known.get(t, 0.0) for t, b in at_rest.items()}
    without = {test: (x, force - taken[test]) for test, (x, force) in cut.items()}
    as_read, tared = vector(features, cut), vector(features, without)
    if CONFINED in without:
        top = without[CONFINED][1].max()
        beyond = [f.kind == "loading" and f.abscissa > top + BEYOND * f.scale for f in features]
        tared = np.where(beyond, np.nan, tared)
    found = np.where(tared_rows(features), tared, as_read)
    before = [f.kind == BEFORE for f in features]
    return np.where(before, [at_rest.get(f.test, np.nan) for f in features], found)


def from_contact_on(curves: Curves) -> Curves:
    """The curves without the platen's way through the air, as a simulation records them."""
    found = {}
    for test, (displacement, force) in curves.items():
        first = max(readings_before_contact(force) - 1, 0)
        found[test] = (displacement[first:], force[first:])
    return found


def vector(
    features: Sequence[Feature], curves: Curves, targets: Mapping[str, float] | None = None
) -> np.ndarray:
    """Features (m,) of one specimen; NaN where its curves do not reach or are missing."""
    read = {test: _READERS[test](features, *curves[test]) for test in TESTS if test in curves}
    given = targets or {}
    return np.array([_value(feature, read, given) for feature in features])


def tests_of(features: Sequence[Feature]) -> np.ndarray:
    """The test of each feature, shape (m,)."""
    return np.array([feature.test for feature in features])


def segments_of(features: Sequence[Feature]) -> list[tuple[str, str, np.ndarray]]:
    """(test, segment, indices of its features) in the order of declaration."""
    keys = list(dict.fromkeys((feature.test, feature.segment) for feature in features))
    return [
        (*key, np.array([i for i, f in enumerate(features) if (f.test, f.segment) == key]))
        for key in keys
    ]


def _confined(segment, kind, share, force_high, position) -> Feature:
    name = f"displacement at {share * force_high:g} N, {kind}"
    return Feature(name, CONFINED, segment, kind, share * force_high, "mm", position, force_high)


def _crushing(segment, share, peak_mm, seat) -> Feature:
    at = share * peak_mm
    name = f"force at {at:.3g} mm, crushing"
    return Feature(name, UNCONFINED, segment, "crushing", at, "N", share / 2, peak_mm, seat)


def _special(test, segment, kind, unit, scale, force, position) -> Feature:
    return Feature(f"{kind}, {test}", test, segment, kind, 0.0, unit, position, scale, force)


def _unit_of(target: str) -> str:
    return "mm" if target.endswith("_mm") else "N"


def _value(feature: Feature, read: Mapping[str, dict], targets: Mapping[str, float]) -> float:
    if feature.kind == "target":
        return float(targets.get(feature.name, np.nan))
    return float(read.get(feature.test, {}).get((feature.kind, feature.abscissa), np.nan))


def _read_confined(features, displacement, force) -> dict[tuple[str, float], float]:
    """Values by (kind, abscissa) of a confined curve in the order of recording."""
    mine = [f for f in features if f.test == CONFINED and f.kind not in APART]
    if not mine:
        return {}
    turn = int(np.argmax(displacement))
    returns = turn < len(displacement) - 1
    rise = _rising(displacement[: turn + 1], force[: turn + 1])
    late = rise[1][0] > LATE * mine[0].scale  # a few points that begin under load
    zero = _displacement_at(rise, REFERENCE * mine[0].scale)
    near_top = _displacement_at(rise, 0.99 * mine[0].scale)
    values = {
        ("largest force", 0.0): float(rise[1][-1]) if returns else np.nan,
        ("travel at the top", 0.0): float(displacement[turn] - near_top) if returns else np.nan,
    }
    fall = _falling(displacement[turn:], force[turn:])
    for feature in mine:
        if feature.kind == "loading":
            value = _displacement_at(rise, feature.abscissa, strict=late) - zero
            values[feature.kind, feature.abscissa] = value
        elif feature.kind == "unloading":
            value = _displacement_at(fall, feature.abscissa, strict=True) - zero
            values[feature.kind, feature.abscissa] = value
    return values


def _read_unconfined(features, displacement, force) -> dict[tuple[str, float], float]:
    """Values by (kind, abscissa) of a crushing curve in the order of recording."""
    mine = [f for f in features if f.test == UNCONFINED and f.kind not in APART]
    if not mine:
        return {}
    peak_mm, seat = mine[0].scale, mine[0].force
    top = int(np.argmax(force))
    travel = displacement - _displacement_at(
        _rising(displacement[: top + 1], force[: top + 1]), seat
    )
    reach = travel.max() * (1 + 1e-9)
    dense = np.linspace(0.0, min(2.0 * peak_mm, reach), 101)
    smooth = _averaged(travel, force, dense, WINDOW * peak_mm)
    values = {
        ("peak force", 0.0): float(smooth.max()),
        ("peak displacement", 0.0): float(dense[smooth >= NEAR_PEAK * smooth.max()].mean()),
    }
    places = np.array([f.abscissa for f in mine if f.kind == "crushing"])
    forces = _averaged(travel, force, places, WINDOW * peak_mm)
    for place, value in zip(places, forces, strict=True):
        values["crushing", float(place)] = float(value) if place <= reach else np.nan
    return values


_READERS = {CONFINED: _read_confined, UNCONFINED: _read_unconfined}


def _rising(displacement: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and force of the blocks of the closest rising curve."""
    fit = isotonic_regression(force)
    edges, levels = fit.blocks, fit.x[fit.blocks[:-1]]
    sums = np.add.reduceat(displacement, edges[:-1])
    return sums / np.diff(edges), levels


def _falling(displacement: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same for a falling curve, in the order of rising force."""
    return _rising(displacement[::-1], force[::-1])


def _displacement_at(branch, force: float, strict: bool = False) -> float:
    """Displacement at a force; the end of the branch beyond its largest force.

    strict: NaN below the smallest force (an unloading that stopped early).
    """
    displacement, levels = branch
    if strict and force < levels[0]:
        return np.nan
    return float(np.interp(force, levels, displacement))


def _averaged(travel, force, places, half_width) -> np.ndarray:
    """Force at `places` from a straight line through the points within `half_width`.

    Where fewer than four points lie there: straight between the neighbours.
    """
    offset = travel[None, :] - places[:, None]
    weight = (np.abs(offset) <= half_width).astype(float)
    count = weight.sum(axis=1)
    enough = count >= 4
    safe = np.where(enough, count, 1.0)
    middle = (weight * offset).sum(axis=1) / safe
    level = weight @ force / safe
    spread = (weight * offset**2).sum(axis=1) / safe - middle**2
    joint = (weight * offset) @ force / safe - middle * level
    slope = joint / np.where(spread > 0, spread, 1.0)
    order = np.argsort(travel, kind="stable")
    between = np.interp(places, travel[order], force[order])
    return np.where(enough & (spread > 0), level - slope * middle, between)
