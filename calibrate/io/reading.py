"""Reading one number off a measured curve: displacement counts from a seating force.

displacement(F) = x(first reach F) - x(first reach 2 N)
"""

import numpy as np

SEATING = 2.0  # N; force at which displacement starts to count


def displacement_up(displacement: np.ndarray, force: np.ndarray, wanted: float) -> float:
    """Displacement (mm) beyond the seating force at which the rising force reaches `wanted` (N).

    Both arrays have shape (points,) and end at the largest force.
    """
    highest = np.maximum.accumulate(force)
    return float(
        np.interp(wanted, highest, displacement) - np.interp(SEATING, highest, displacement)
    )
