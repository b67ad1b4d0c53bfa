"""What a recording shows before the platen touches: its length, its force, and the noise.

The noise of force is told from second differences by their median, so that kinks of the curve do
not count: sd = 1.4826 MAD/sqrt(6).
"""

from collections.abc import Sequence

import numpy as np

from calibrate.labtests.diagnosis.base import Curves

RISES = 2.0  # standard errors by which force rises with travel, above which it was not at rest
ALL_RISE = 3.0  # the same of all curves of a test together
EARLY = 2 / 3  # of readings at rest, among which a rise counts: the last ones may touch already
LEAST_NOISE = 1e-6  # N
CONTACT = 0.012  # share of the range of forces at which the platen surely touches
TOUCH = 0.002  # the same at which it may touch already, where noise allows to see it
SURE = 4.0  # deviations of a reading that are no noise
FEWEST_BEFORE = 3  # readings before contact that make a mean
STANDS = 0.1  # of the usual travel between readings; a platen that moves less holds a load


def force_noise(forces: Sequence[np.ndarray]) -> float:
    """Standard deviation (N) of one reading's noise in recordings of force."""
    seconds = np.concatenate([np.diff(force, 2) for force in forces])
    return float(1.4826 * np.median(np.abs(seconds - np.median(seconds))) / np.sqrt(6))


def force_before_contact(force: np.ndarray) -> float:
    """Mean of the readings (N) before force leaves them at all, NaN if they are fewer than
    `FEWEST_BEFORE`."""
    readings = _readings_at_rest(force)
    return float(force[:readings].mean()) if readings >= FEWEST_BEFORE else np.nan


def begins_before_contact(curves: Sequence[tuple[np.ndarray, np.ndarray]]) -> bool:
    """Whether records of one test, displacement (mm) and force (N) each, hold readings before
    contact.

    A record that begins at contact or at a preload rises from its first reading on, and what looks
    like rest are the few readings before the rise leaves their noise.  So at least half of the
    records must show enough readings at rest, and these may not rise: with travel x, the slope of
    force over its standard error, s/sqrt(sum (x - <x>)^2) with the noise s, stays below `RISES` in
    each and, summed over n records and divided by sqrt(n), below `ALL_RISE`.  First readings of a
    platen that stands still do not count: a machine holds a preload, too."""
    rises = [rise for x, force in curves if (rise := _rise_at_rest(x, force)) is not None]
    at_rest = sum(rise < RISES for rise in rises)
    if not at_rest or 2 * at_rest < len(curves):
        return False
    return bool(sum(rises) / np.sqrt(len(rises)) < ALL_RISE)


def _rise_at_rest(displacement: np.ndarray, force: np.ndarray) -> float | None:
    """Slope of force over its standard error among the readings that look like rest while the
    platen moves; None where they are too few."""
    moves = _moves_from(displacement, _readings_at_rest(force))
    displacement, force = displacement[moves:], force[moves:]
    readings = _readings_at_rest(force)
    if readings < FEWEST_BEFORE:
        return None
    readings = max(int(np.ceil(EARLY * readings)), FEWEST_BEFORE)
    x, noise = displacement[:readings], max(force_noise([force]), LEAST_NOISE)
    centred = x - x.mean()
    length = float(np.sqrt(centred @ centred))
    return float(centred @ force[:readings]) / (length * noise) if length > 0 else 0.0


def _moves_from(displacement: np.ndarray, readings: int) -> int:
    """The first of some readings from which on the platen moves, compared with its way after
    them."""
    if len(displacement) < readings + 2 or len(displacement) <= FEWEST_BEFORE:
        return 0
    usual = np.median(np.abs(np.diff(displacement[readings:])))
    moved = np.abs(displacement[FEWEST_BEFORE:] - displacement[:-FEWEST_BEFORE]) / FEWEST_BEFORE
    return int(np.argmax(moved[: readings + 1] > STANDS * usual))


def _readings_at_rest(force: np.ndarray) -> int:
    """How many readings (N) come before force leaves them at all."""
    away = force - np.median(force[:FEWEST_BEFORE])
    leaves = np.argmax(away > max(TOUCH * away.max(), SURE * force_noise([force])))
    return min(int(leaves) - 1, readings_before_contact(force))


def readings_before_contact(force: np.ndarray) -> int:
    """How many readings (N) come surely before contact.

    Contact is where force leaves its first readings' median by more than CONTACT of its
    range, two readings earlier to be safe.
    """
    away = force - np.median(force[:FEWEST_BEFORE])
    return max(int(np.argmax(away > CONTACT * away.max())) - 2, 0)


def from_contact_on(curves: Curves) -> Curves:
    """The curves without the platen's way through the air, as a simulation records them."""
    found = {}
    for test, (displacement, force) in curves.items():
        first = max(readings_before_contact(force) - 1, 0)
        found[test] = (displacement[first:], force[first:])
    return found
