"""From forces and displacements of the simulated platen to what a testing machine writes.

    F_read = (1 + gain) lag(F) + offset + drift t + noise,   d_read = d + seat(F) + zero + noise

The simulated tests run faster than the laboratory's; the machine's clock is that of the
laboratory: time is the platen's path over the nominal speed.  Every curve has the same number of
readings, evenly spaced in time, each an average over its interval.
"""

from dataclasses import dataclass

import numpy as np

CONFINED_SPEED = 8e-3  # m/s, nominal
UNCONFINED_SPEED = 1e-5  # m/s, nominal
READINGS = 110  # of each curve
SEAT_CLOSES = (15.0, 60.0)  # N, the force that closes a loose seat
SEAT_OPENS = 0.15  # of the largest force so far, below which it opens again
TARGET_FORCE = 400.0  # N, at which the confined platen turns


@dataclass(frozen=True)
class Instrument:
    """The measuring chain: gain (fraction), offset N, drift N/h, lag s, mean travel of a loose
    platen seat m, noise N and m (one sd), resolution N and m."""

    gain: float = 0.0
    offset: float = 0.0
    drift: float = 0.0
    lag: float = 0.0
    seat: float = 0.0
    noise_force: float = 0.5
    noise_displacement: float = 3e-6
    resolution_force: float = 0.1
    resolution_displacement: float = 1e-6


@dataclass(frozen=True)
class Record:
    """What a machine wrote: time s, displacement mm, force N, each (READINGS,)."""

    time: np.ndarray
    displacement: np.ndarray
    force: np.ndarray


def smoothing_per_round(instrument: Instrument, interval: float) -> float:
    """Share of a change that the lagging reading takes over within `interval` s."""
    return 1.0 if instrument.lag == 0 else float(-np.expm1(-interval / instrument.lag))


def lagged(time: np.ndarray, force: np.ndarray, lag: float) -> np.ndarray:
    """First-order lag: dy/dt = (force - y)/lag, exact for a force constant between samples."""
    if lag == 0:
        return force
    read = np.empty_like(force)
    value = force[0]
    shares = -np.expm1(-np.diff(time, prepend=time[0]) / lag)
    for number, (share, now) in enumerate(zip(shares, force, strict=True)):
        value += share * (now - value)
        read[number] = value
    return read


def seat_travel(force: np.ndarray, travel: float, random: np.random.Generator) -> np.ndarray:
    """Way of a loose seat between crosshead and platen, m: a linear spring that closes at its own
    force and, held by friction, opens again only when nearly unloaded.  Each seating differs."""
    size, closing = travel * np.exp(0.35 * random.standard_normal()), random.uniform(*SEAT_CLOSES)
    loaded = np.maximum.accumulate(force)
    held = np.minimum(loaded, np.maximum(force, 0) / SEAT_OPENS)
    return size * np.clip(held / closing, 0, 1)


def approach(
    displacement: np.ndarray, force: np.ndarray, gap: float
) -> tuple[np.ndarray, np.ndarray]:
    """The curve with the platen's way through the air, `gap` m, put before it."""
    step = 1e-5
    way = np.arange(0.0, gap, step)
    return np.concatenate([way, displacement + gap]), np.concatenate([0 * way, force])


def record(
    displacement: np.ndarray,
    force: np.ndarray,
    speed: float,
    instrument: Instrument,
    zero: float,
    random: np.random.Generator,
) -> Record:
    """The readings of one test.  displacement m and force N of the platen, both (points,)."""
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(displacement)))]) / speed
    displacement = displacement + seat_travel(force, instrument.seat, random)
    seen = (1 + instrument.gain) * lagged(time, force, instrument.lag)
    seen = seen + instrument.offset + instrument.drift * time / 3600
    ends = np.linspace(0, time[-1], READINGS + 1)
    moments = (ends[1:] + ends[:-1]) / 2
    way = np.interp(moments, time, displacement) + zero
    way = way + instrument.noise_displacement * random.standard_normal(READINGS)
    mean = _averages(time, seen, ends)
    mean = mean + instrument.noise_force * random.standard_normal(READINGS)
    return Record(
        moments,
        1e3 * _rounded(way, instrument.resolution_displacement),
        _rounded(mean, instrument.resolution_force),
    )


def _averages(time: np.ndarray, values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Mean of `values` over time between consecutive `ends`, by the trapezoidal integral."""
    pieces = np.diff(time) * (values[1:] + values[:-1]) / 2
    integral = np.concatenate([[0.0], np.cumsum(pieces)])
    return np.diff(np.interp(ends, time, integral)) / np.diff(ends)


def _rounded(values: np.ndarray, resolution: float) -> np.ndarray:
    return np.round(values / resolution) * resolution
