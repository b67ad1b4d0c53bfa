"""Load steps, from their numbers alone: rows that are states of rest and no points of a curve.

25  50  100  200 ... 1200  800 ... 25 kPa      one row a step, or the readings of each step
"""

import numpy as np

from calibrate.instrument_import.sizes import Column
from calibrate.instrument_import.vocabulary import LOAD_STEPS, Quantity

MOST_STEPS = 40  # rows; more are a curve unless the load stands still in most of them
_EQUAL = 5e-3  # of the largest load; what a load keeps to while it stands still
_REVISITED = 2  # loads of the way up that come back on the way down


def are_steps(load: Column, travel: Column, test: str | None, given: bool | None) -> bool:
    """Whether the rows are load steps: as the user says, or few rows of an oedometer test."""
    if given is not None:
        return given
    if travel.kind == Quantity.CONSOLIDATION:
        return True
    if len(load.values) > MOST_STEPS and not _stands_still(load.values):
        return False
    if test is not None:
        return test == LOAD_STEPS
    return travel.kind == Quantity.VOID_RATIO or (
        load.kind == Quantity.STRESS and _comes_back(load.values)
    )


def ends_of_steps(load: np.ndarray) -> np.ndarray:
    """Rows, the last before each change of load."""
    changes = np.abs(np.diff(load)) > _EQUAL * np.abs(load).max()
    return np.flatnonzero(np.append(changes, True))


def turning_rows(load: np.ndarray) -> list[int]:
    """Rows where loading turns into unloading or back, the last row among them."""
    rows, direction = [], 1.0
    for row in range(1, len(load)):
        step = load[row] - load[row - 1]
        if step * direction < 0:
            rows.append(row - 1)
            direction = -direction
    return [*rows, len(load) - 1]


def _stands_still(load: np.ndarray) -> bool:
    steps = len(ends_of_steps(load)) if len(load) else 0
    return 0 < steps <= min(MOST_STEPS, len(load) // 4)


def _comes_back(load: np.ndarray) -> bool:
    """Whether unloading visits the very loads of the way up."""
    load = np.abs(load)
    top = int(np.argmax(load)) if len(load) else 0
    up = set(load[:top].tolist())
    return len(up.intersection(load[top + 1 :].tolist())) >= _REVISITED
