"""What instruments add to a description: recording, and the force before contact.

A recording misses what is sharp; where the force reading lags, the turn of a curve is round already
and nothing is lost there.  So the shift by recording is found for several lags, with monotone
cubics between them (Fritsch and Carlson 1980, SIAM J. Numer. Anal. 17, 238; `BetweenLags`).
How a machine is steered where it turns tells nothing of a soil (`steering`).

Where the force before contact was recorded, it is taken off (`recorded_feature_values`), so that
an untared load cell moves those features alone in which the machine turned by its reading.  Where
records begin at contact or at a preload, nobody knows it, nor how the seat closed (`left_free`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.recording import REPEATS, Recordings, recordings
from calibrate.discrepancy.comparison.reduction import along_branch
from calibrate.discrepancy.comparison.repeats import Measured, from_vectors
from calibrate.discrepancy.library.description import LocalEmulator
from calibrate.discrepancy.library.measurements import STRETCHED, Measurements
from calibrate.labtests.diagnosis.base import APART, Curves, Feature, UsualSizes
from calibrate.labtests.diagnosis.contact import readings_before_contact
from calibrate.labtests.diagnosis.curves import (
    TEST_FEATURES,
    declare_before_contact,
    feature_values,
    tared_rows,
)
from calibrate.response.machine import LAG
from calibrate.response.reading import filtered
from calibrate.response.response import LAGS, BetweenLags

FEWEST_BEFORE_SD = 0.05  # N; of the mean before contact, at least
STEERING = {"largest force": 0.0025, "travel at the top": 0.02}  # of the largest force; mm
OFFSET, GAP = "load_cell_offset", "seating_gap"
UNTARED_SD = 5.0  # N, by which the zero of force is off in records that begin at a preload; assumed
BEGUN_SD = 0.3  # mm, the same of the zero of travel where this counts from a seating force
SEAT_SD = 1.0  # typical strengths of a loose seating, whose closing such records do not hold
ON_A_LAG = 30  # recordings


def with_instruments(
    d: Linearised, found: Measurements, curves: Curves, usual: UsualSizes, seed: int
) -> Linearised:
    """The description with what recording adds to the features of curves; `curves`: of a specimen
    like the lab's, by whose usual sizes features are declared."""
    if not found.channels:
        return d
    reference, air = typical(curves, usual, found), ways_through_air(found)
    lag = d.effect_names.index(LAG) if LAG in d.effect_names else None
    unit = 0.0 if lag is None else d.effects[lag].typical

    def read(curves: Curves, repeats: int) -> Recordings:
        rng = np.random.default_rng(seed)
        return recordings(d.features, curves, found.channels, rng, repeats, air)

    prompt = read(reference, REPEATS)
    late = [read(lagged(reference, found, lags * unit), ON_A_LAG)
            for lags in (LAGS if lag is not None else ())]  # fmt: skip
    shift, either = np.nan_to_num(prompt.shift), np.nan_to_num(prompt.either)
    shifts, halves = _from_none(shift, either, [(one.shift, one.either) for one in late])
    turn, slopes = steering(d.features), np.zeros_like(d.effect_slopes)
    if lag is not None:
        slopes[:, lag] = BetweenLags.of(shifts).slope(0.0)
    d = replace(
        d, mean=d.mean + shift, sensor=d.sensor + prompt.covariance(),
        effect_slopes=d.effect_slopes + slopes,
        wrong=np.column_stack([d.wrong, either, turn]),
        emulator=emulator_of(d).recording(
            BetweenLags.of(among_all(d, shifts.T).T), BetweenLags.of(among_all(d, halves.T).T), lag,
            among_all(d, turn),
        ),
    )  # fmt: skip
    return _tared(d, found.tared)


def emulator_of(d: Linearised) -> LocalEmulator:
    """The emulator behind a description of a library."""
    return cast(LocalEmulator, d.emulator)


def among_all(d: Linearised, values: np.ndarray) -> np.ndarray:
    """Values (m, ...) of a description's features among all of the library, nothing for others."""
    found = np.zeros((len(emulator_of(d).response.units), *values.shape[1:]), values.dtype)
    found[d.rows] = values
    return found


def steering(features: Sequence[Feature]) -> np.ndarray:
    """Directions (m, q) in which features (m,) may be wrong as machines turn in other ways, one
    standard deviation each: assumptions, as no laboratory states them."""
    rows = [i for i, f in enumerate(features) if f.kind in STEERING]
    found = np.zeros((len(features), len(rows)))
    for column, row in enumerate(rows):
        feature = features[row]
        found[row, column] = STEERING[feature.kind] * (feature.scale if feature.unit == "N" else 1)
    return found


def _from_none(shift, either, rows) -> tuple[np.ndarray, np.ndarray]:
    """Shifts and half differences (j, m) at LAGS, those without a lag as they were found best;
    one row where there are no lags."""
    if not rows:
        return shift[None], either[None]
    shifts, halves = (np.nan_to_num(_filled(np.array(part))) for part in zip(*rows, strict=True))
    return shifts - shifts[0] + shift, halves - halves[0] + either


def ways_through_air(found: Measurements) -> dict[str, float]:
    """The way (mm) by test that a laboratory's platen usually makes before it surely touches."""
    readings = {
        test: [readings_before_contact(c[test][1]) for c in found.specimens if test in c]
        for test in found.channels
        if test not in found.begun
    }
    return {
        test: found.channels[test].spacing * float(np.median(counts))
        for test, counts in readings.items()
        if counts
    }


def _tared(d: Linearised, tests: Sequence[str]) -> Linearised:
    """The description of curves; of some tests the force before contact was taken off."""
    if OFFSET not in d.effect_names or not tests:
        return d
    offset = d.effect_names.index(OFFSET)
    rows = tared_rows(d.features) & np.isin([f.test for f in d.features], tests)
    slopes = d.effect_slopes.copy()
    slopes[rows, offset] = 0.0
    return replace(
        d, effect_slopes=slopes,
        emulator=emulator_of(d).taring(offset, among_all(d, rows)),
    )  # fmt: skip


def _filled(rows: np.ndarray) -> np.ndarray:
    """Rows (j, m) with that of the next smaller lag where a lagged curve lacks a feature."""
    for number in range(1, len(rows)):
        rows[number] = np.where(np.isfinite(rows[number]), rows[number], rows[number - 1])
    return rows


def lagged(curves: Curves, found: Measurements, lag: float) -> Curves:
    """Curves recorded with a lag (s); forces pushed up so that readings reach the same
    largest value, as the machine turns by what it reads."""
    if not lag:
        return curves
    read = {}
    for test, (displacement, force) in curves.items():
        path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))])
        reading = filtered(path, force, found.speeds[test] * lag)
        read[test] = (displacement, reading * force.max() / reading.max())
    return read


def typical(curves: Curves, usual: UsualSizes, found: Measurements) -> Curves:
    """Curves stretched to those that the lab measured: travel above half the largest force; force
    and displacement of the peak."""
    stretched = {}
    for test in found.channels:
        displacement, force = curves[test]
        along, up = TEST_FEATURES[test].stretched_by(usual)
        stretched[test] = (
            displacement * _ratio(curves, found, along), force * _ratio(curves, found, up)
        )  # fmt: skip
    return stretched


def _ratio(curves: Curves, found: Measurements, name: str) -> float:
    """A measured feature over that of curves, 1 where it is not known."""
    names = [f.name for f in found.measured.features]
    if name not in names:
        return 1.0
    feature = found.measured.features[names.index(name)]
    ratio = found.measured.mean[names.index(name)] / feature_values([feature], curves)[0]
    least, most = STRETCHED
    return float(np.clip(ratio, least, most)) if np.isfinite(ratio) else 1.0


def with_forces_before_contact(d: Linearised, found: Measurements) -> tuple[Linearised, Measured]:
    """The description and the sample with the forces before contact: only an untared load cell
    moves those."""
    keep = [i for i in (0, 1) if np.isfinite(found.before[:, i]).any()]
    if not keep:
        return d, found.measured
    before = declare_before_contact()
    vectors = np.hstack([found.measured.specimens, found.before[:, keep]])
    features = (*d.features, *(before[i] for i in keep))
    noise = max(c.force_sd for c in found.channels.values())
    return _extended(d, features, len(keep), noise), from_vectors(features, vectors)


def _extended(d: Linearised, features: tuple[Feature, ...], more: int, noise: float) -> Linearised:
    column = np.array([e.typical if e.name == "load_cell_offset" else 0.0 for e in d.effects])
    rows = np.tile(column, (more, 1))
    variance = max(noise / np.sqrt(3), FEWEST_BEFORE_SD) ** 2

    def taller(matrix: np.ndarray, below: np.ndarray | None = None) -> np.ndarray:
        below = np.zeros((more, *matrix.shape[1:])) if below is None else below
        return np.concatenate([matrix, below])

    def wider(matrix: np.ndarray, value: float = 0.0) -> np.ndarray:
        m = len(matrix)
        grown = np.zeros((m + more, m + more))
        grown[:m, :m] = matrix
        grown[range(m, m + more), range(m, m + more)] = value
        return grown

    empty = np.zeros((len(d.packing_residuals), more))
    return replace(
        d, features=features, mean=taller(d.mean), base_slopes=taller(d.base_slopes),
        effect_slopes=taller(d.effect_slopes, rows), base_errors=taller(d.base_errors),
        packing_residuals=np.hstack([d.packing_residuals, empty]),
        extra=wider(d.extra), sensor=wider(d.sensor, variance), wrong=taller(d.wrong),
        emulator=emulator_of(d).longer(rows),
        rows=np.append(np.asarray(d.rows), len(emulator_of(d).response.units) + np.arange(more)),
    )  # fmt: skip


def left_free(d: Linearised, found: Measurements) -> Linearised:
    """The description where records of some tests begin at contact or at a preload: the zeros of
    force and of travel and a loose seat of each are directions in which it may be wrong.  An
    untared load cell and a loose seat are no candidates where no test shows what comes before."""
    if not found.begun:
        return d
    columns = np.column_stack([_free(d, test) for test in found.begun])
    d = replace(
        d, wrong=np.hstack([d.wrong, columns]),
        emulator=emulator_of(d).freed(among_all(d, columns)),
    )  # fmt: skip
    if any(f.test not in found.begun and f.kind not in APART for f in d.features):
        return d
    return d.without_effects([OFFSET, GAP])


def _free(d: Linearised, test: str) -> np.ndarray:
    """What is free in one test (m, q), one standard deviation each."""
    mine = np.array([f.test == test and f.kind not in APART for f in d.features])
    known = {e.name: (d.effect_slopes[:, k], e.typical) for k, e in enumerate(d.effects)}
    columns = [known[OFFSET][0] * UNTARED_SD / known[OFFSET][1]] if OFFSET in known else []
    columns += [SEAT_SD * known[GAP][0]] if GAP in known else []
    columns += [BEGUN_SD * column for column in along_travel(d.features, d.mean)]
    return np.where(mine[:, None], np.array(columns).reshape(-1, len(mine)).T, 0.0)


def along_travel(features: Sequence[Feature], mean: np.ndarray) -> list[np.ndarray]:
    """What a zero of travel that is off by 1 mm does to features (m,) that are forces at
    displacements; one column for each kind of these."""
    found = []
    for test in TEST_FEATURES.values():
        for kind in () if test.read_at_forces else test.branches:
            if sum(f.kind == kind for f in features) > 1:
                column = along_branch(features, mean, kind)
                column[[f.test == test.name and f.unit == "mm" for f in features]] = -1.0
                found.append(column)
    return found
