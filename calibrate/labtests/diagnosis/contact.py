"""What a recording shows before the platen touches: its length, its force, and the noise.

The noise of force is told from second differences by their median, so that kinks of the curve do
not count: sd = 1.4826 MAD/sqrt(6).
"""

from collections.abc import Sequence

import numpy as np

from calibrate.labtests.diagnosis.base import Curves

CONTACT = 0.012  # share of the range of forces at which the platen surely touches
TOUCH = 0.002  # the same at which it may touch already, where noise allows to see it
SURE = 4.0  # deviations of a reading that are no noise
FEWEST_BEFORE = 3  # readings before contact that make a mean


def force_noise(forces: Sequence[np.ndarray]) -> float:
    """Standard deviation (N) of one reading's noise in recordings of force."""
    seconds = np.concatenate([np.diff(force, 2) for force in forces])
    return float(1.4826 * np.median(np.abs(seconds - np.median(seconds))) / np.sqrt(6))


def force_before_contact(force: np.ndarray) -> float:
    """Mean of the readings (N) before force leaves them at all, NaN if they are fewer than
    `FEWEST_BEFORE`."""
    away = force - np.median(force[:FEWEST_BEFORE])
    leaves = np.argmax(away > max(TOUCH * away.max(), SURE * force_noise([force])))
    readings = min(int(leaves) - 1, readings_before_contact(force))
    return float(force[:readings].mean()) if readings >= FEWEST_BEFORE else np.nan


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
