"""What can be wrong with a recorded curve, found from its numbers alone.

Each function looks at arrays of shape (points,) and knows nothing of files: start of contact,
unloading, a force clipped at a limit, gaps in sampling, a clock that runs backwards.
"""

from dataclasses import dataclass

import numpy as np

LEAD = 0.1  # of the peak force; contact is looked for below it
NOISE_WIDTHS = 5.0  # above the baseline: contact
AVERAGED = 9  # readings, against noise
FLAT_POINTS = 5  # equal readings at the top that make a limit
SHARP = 25.0  # resolutions; a natural summit rises 8 before as many points as it is flat
GAP = 5.0  # median sampling intervals
PRESSURE = (1e3, 20e6)  # Pa; below the first a specimen does not carry its own weight
STRAIN = (1e-3, 1.0)  # largest strain of a test


@dataclass(frozen=True)
class Start:
    """Contact: first row of the curve, force (N) read before it or 0 where that is within the
    noise, noise (N), whether the record shows an approach at all."""

    row: int
    zero: float
    noise: float
    approach: bool


def start_of_contact(force: np.ndarray, travel: np.ndarray) -> Start:
    """Where the force, averaged over a few readings, leaves its baseline on the way to its peak.

    The baseline is an approach only where the platen moves along it: one that stands still under
    a constant force holds a preload, and says nothing of the zero of the force.
    """
    peak_row = int(np.argmax(force))
    if np.ptp(force[:5]) > LEAD * np.ptp(force):  # a few readings, the first of them at contact
        return Start(0, 0.0, 0.0, False)
    first = float(np.median(force[:5]))
    rise = float(force[peak_row]) - first
    above = np.flatnonzero(force >= first + LEAD * rise)
    lead = force[: max(int(above[0]), 1)] if len(above) else force[:1]
    steps = np.abs(np.diff(lead))
    noise = 1.4826 * float(np.median(steps)) / np.sqrt(2) if len(steps) else 0.0
    width = min(AVERAGED, len(lead))
    averaged = np.convolve(np.pad(lead, width // 2, "edge"), np.ones(width) / width, "valid")
    threshold = max(NOISE_WIDTHS * noise / np.sqrt(width), 1e-3 * rise)
    quiet = np.flatnonzero(averaged[: len(lead)] <= first + threshold)
    row = int(quiet[-1]) if len(quiet) else 0
    steps_on = np.abs(np.diff(travel[: len(force)]))
    usual = float(np.median(steps_on[steps_on > 0])) if np.any(steps_on > 0) else 0.0
    moved = abs(float(travel[row] - travel[0])) > 0.2 * usual * row > 0
    approach = row >= 10 and moved
    if not approach:  # a few readings tell where contact is, if they are of no load
        unloaded = abs(first) <= max(3 * noise, 2e-3 * float(force[peak_row]))
        return Start(row if moved and unloaded and row >= 4 else 0, 0.0, noise, False)
    zero = float(np.median(force[: row // 2 + 1]))
    shifted = abs(zero) > max(3 * noise, 1e-3 * float(force[peak_row]))
    return Start(row, zero if shifted else 0.0, noise, approach)


def turning_row(travel: np.ndarray) -> int | None:
    """The row of greatest travel if the platen clearly comes back after it."""
    row = int(np.argmax(travel))
    span = float(travel[row] - travel[0])
    back = float(travel[row] - travel[row:].min())
    return row if span > 0 and back > 0.02 * span and len(travel) - row > 3 else None


def reversals(travel: np.ndarray) -> list[int]:
    """Rows at which the platen turns: greatest travels before it comes back by a tenth of all that
    it travels, and least ones before it goes on again by as much."""
    back, found, row, up = 0.1 * float(np.ptp(travel)), [], 0, True
    for i, value in enumerate(travel):
        ahead = value > travel[row] if up else value < travel[row]
        if ahead:
            row = i
        elif abs(value - travel[row]) > back > 0:
            found.append(row)
            row, up = i, not up
    return found


def clipped_run(travel: np.ndarray, force: np.ndarray) -> tuple[int, int] | None:
    """First and last+1 row of a flat top at a limit of the load cell, None if there is none.

    Readings stay equal to the resolution while the platen moves on, right after a steep rise;
    a servo's hold moves no platen and a natural summit rounds off before it.
    """
    levels = np.unique(force)
    if len(levels) < 3:
        return None
    resolution = max(float(np.diff(levels).min()), 1e-9 * float(np.abs(levels).max()))
    at_top = force >= levels[-1] - 0.5 * resolution
    first, last = _longest(at_top)
    length = last - first
    if length < FLAT_POINTS or first < 2:
        return None
    before = max(first - length, 0)
    steep = force[first] - force[before] > max(SHARP * resolution, 0.01 * float(levels[-1]))
    step = float(np.median(np.abs(np.diff(travel[:first])))) if first > 1 else 0.0
    moves = abs(travel[last - 1] - travel[first]) > 0.3 * step * (length - 1) > 0
    return (first, last) if steep and moves else None


def gaps(time: np.ndarray | None, travel: np.ndarray, force: np.ndarray) -> list[int]:
    """Rows after which so much is missing that the curve is not known between them."""
    axis = travel if time is None else time
    steps = np.abs(np.diff(axis))
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if usual == 0.0:
        return []
    travelled = np.abs(np.diff(travel)) > 0.01 * np.ptp(travel)
    loaded = np.abs(np.diff(force)) > 0.02 * np.ptp(force)
    rows = np.flatnonzero((steps > GAP * usual) & (travelled | loaded))
    return [int(row) for row in rows]


def backward_rows(time: np.ndarray) -> np.ndarray:
    """Rows whose time lies before the latest time so far."""
    latest = np.maximum.accumulate(time)
    return np.flatnonzero(time < latest)


def has_softening(travel: np.ndarray, force: np.ndarray) -> bool:
    """Whether the force falls by a tenth of its peak while the platen still moves on."""
    peak = int(np.argmax(force))
    far = travel[0] + 0.995 * (travel.max() - travel[0])
    end = int(np.argmax(travel >= far))
    if end <= peak:
        return False
    tail = force[peak : end + 1]
    return bool(np.median(tail[-max(len(tail) // 10, 1) :]) < 0.9 * force[peak])


def is_stiffening(travel: np.ndarray, force: np.ndarray) -> bool:
    """Whether half of the travel to the peak carries clearly less than half of its force."""
    peak = int(np.argmax(force))
    up, load = travel[: peak + 1], force[: peak + 1]
    middle = 0.5 * (up[0] + up[-1])
    return bool(load[int(np.argmax(up >= middle))] < 0.42 * load[-1])


def speed(time: np.ndarray, travel: np.ndarray, force: np.ndarray) -> float | None:
    """Travel per time (mm/s) in the middle of loading; None where the clock stands still."""
    up = slice(0, int(np.argmax(force)) + 1)
    if np.ptp(time[up]) <= 0:
        return None
    middle = (travel[up] > 0.1 * travel[up][-1]) & (travel[up] < 0.9 * travel[up][-1])
    if middle.sum() < 3 or np.ptp(time[up][middle]) <= 0:
        return None
    return float(np.polyfit(time[up][middle], travel[up][middle], 1)[0])


def _longest(mask: np.ndarray) -> tuple[int, int]:
    """The longest run of True as (first, last+1)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    starts, ends = edges[::2], edges[1::2]
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])
