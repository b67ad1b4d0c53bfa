"""Builders of designs; their matrices come from pyDOE and equal the textbooks' tables.

Screening: Plackett-Burman (Biometrika 33, 1946).  Response surfaces: central composite (Box and
Wilson 1951), Box-Behnken (Technometrics 2, 1960).  References: Myers, Montgomery and
Anderson-Cook, Response Surface Methodology, and the NIST/SEMATECH e-Handbook, chapter 5.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pydoe

from calibrate.core.errors import BadValue
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.runsheet import read_csv as read_csv

PLACKETT_BURMAN_FACTORS = 11
BOX_BEHNKEN_FACTORS = (3, 4, 5)  # from 6 on the published designs vary three factors at a time


def plackett_burman(factors: Sequence[Factor], centre: int = 0) -> Design:
    """Up to 11 factors at two levels in 12 runs, and `centre` centre points.

    The first row is the published generator + + - + + + - - - + -, the next ten its cyclic
    shifts, the twelfth all low; columns that no factor needs become the dummies.
    """
    if len(factors) > PLACKETT_BURMAN_FACTORS:
        repair = f"give at most {PLACKETT_BURMAN_FACTORS}"
        raise BadValue(f"{len(factors)} factors for 12 runs", repair, "factors")
    matrix = -pydoe.pbdesign(PLACKETT_BURMAN_FACTORS)[:, ::-1]  # pyDOE lists its mirror image
    matrix = _with_centre(matrix, centre)
    used = len(factors)
    return Design(tuple(factors), matrix[:, :used], "Plackett-Burman", matrix[:, used:])


def central_composite(factors: Sequence[Factor], centre: int = 5) -> Design:
    """Two-level factorial, two star points a factor and `centre` centre points.

    The stars lie outside the levels, at alpha = (2^p)^(1/4): the design is rotatable.
    """
    if len(factors) < 2:
        raise BadValue(f"{len(factors)} factors", "give 2 or more", "factors")
    blocks: Any = (0, centre)  # centre points with the corners, and with the stars
    matrix = pydoe.ccdesign(len(factors), center=blocks, alpha="rotatable", face="ccc")
    return Design(tuple(factors), matrix, "central composite, rotatable")


def box_behnken(factors: Sequence[Factor], centre: int = 5) -> Design:
    """Three to five factors at three levels: two vary, the others rest at their centres."""
    if len(factors) not in BOX_BEHNKEN_FACTORS:
        repair = "give 3 to 5, or take a central composite design"
        raise BadValue(f"a Box-Behnken design of {len(factors)} factors", repair, "factors")
    edges = pydoe.bbdesign(len(factors), center=1)[:-1]
    return Design(tuple(factors), _with_centre(edges, centre), "Box-Behnken")


def sweep(factor: Factor, levels: int = 8) -> Design:
    """One factor at equidistant levels from low to high."""
    if levels < 2:
        raise BadValue(f"{levels} levels", "give 2 or more", "levels")
    return Design((factor,), np.linspace(-1, 1, levels)[:, None], "sweep")


def _with_centre(matrix: np.ndarray, centre: int) -> np.ndarray:
    return np.vstack([matrix, np.zeros((centre, matrix.shape[1]))])
