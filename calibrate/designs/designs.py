"""Builders of designs; their matrices come from pyDOE and equal the textbooks' tables.

Screening: Plackett-Burman (Biometrika 33, 1946), full and fractional factorials.  Response
surfaces: central composite (Box and Wilson 1951), Box-Behnken (Technometrics 2, 1960).
Surrogates: Latin hypercube, Sobol'.  References: Myers, Montgomery and Anderson-Cook, Response
Surface Methodology, and the NIST/SEMATECH e-Handbook, chapter 5.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import pydoe

from calibrate.core.errors import BadValue, shown
from calibrate.designs.design import Design
from calibrate.designs.factors import Factor
from calibrate.designs.runsheet import RunSheet, read_csv

__all__ = [
    "Design",
    "RunSheet",
    "box_behnken",
    "central_composite",
    "fractional_factorial",
    "full_factorial",
    "latin_hypercube",
    "plackett_burman",
    "read_csv",
    "sobol",
    "sweep",
]

PLACKETT_BURMAN_FACTORS = 11
STARS: dict[str, Literal["ccc", "ccf", "cci"]] = {
    "rotatable": "ccc",
    "faced": "ccf",
    "inscribed": "cci",
}
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


def central_composite(
    factors: Sequence[Factor],
    centre: int = 5,
    face: Literal["rotatable", "faced", "inscribed"] = "rotatable",
) -> Design:
    """Two-level factorial, two star points a factor and `centre` centre points.

    `rotatable` puts the stars at alpha = (2^p)^(1/4), outside the levels; `inscribed` shrinks
    that design until its stars are the levels; `faced` puts the stars on the faces.
    """
    _need(factors, 2)
    if face not in STARS:
        raise BadValue(f"unknown face {shown(face)}", "give one of " + ", ".join(STARS), "face")
    blocks: Any = (0, centre)  # centre points with the corners, and with the stars
    matrix = pydoe.ccdesign(len(factors), center=blocks, alpha="rotatable", face=STARS[face])
    return Design(tuple(factors), matrix, f"central composite, {face}")


def box_behnken(factors: Sequence[Factor], centre: int = 5) -> Design:
    """Three to five factors at three levels: two vary, the others rest at their centres."""
    if len(factors) not in BOX_BEHNKEN_FACTORS:
        repair = "give 3 to 5, or take a central composite design"
        raise BadValue(f"a Box-Behnken design of {len(factors)} factors", repair, "factors")
    edges = pydoe.bbdesign(len(factors), center=1)[:-1]
    return Design(tuple(factors), _with_centre(edges, centre), "Box-Behnken")


def full_factorial(factors: Sequence[Factor], levels: int | Sequence[int] = 2) -> Design:
    """Every combination of equidistant levels; `levels` for all factors or for each."""
    counts = [levels] * len(factors) if isinstance(levels, int) else list(levels)
    if len(counts) != len(factors) or min(counts, default=0) < 2:
        raise BadValue(f"levels {counts}", "give 2 or more for each factor", "levels")
    indices = pydoe.fullfact(np.array(counts))
    return Design(tuple(factors), 2 * indices / (np.array(counts) - 1) - 1, "full factorial")


def fractional_factorial(factors: Sequence[Factor], generators: str, centre: int = 0) -> Design:
    """Two levels; one generator a factor, as in "a b c ab ac" for five factors in 8 runs.

    A letter alone is a basic factor, a product (with a leading "-" for the other fraction)
    the interaction on which the factor is laid.  `aliases` says what that costs.
    """
    words = generators.split()
    if len(words) != len(factors):
        problem = f"{len(words)} generators for {len(factors)} factors"
        raise BadValue(problem, 'give one word a factor, such as "a b c ab"', "generators")
    try:
        matrix = pydoe.fracfact(generators)
    except ValueError as error:
        raise BadValue(str(error), 'give words such as "a b c ab"', "generators") from None
    return Design(tuple(factors), _with_centre(matrix, centre), "fractional factorial")


def sweep(factor: Factor, levels: int = 8) -> Design:
    """One factor at equidistant levels from low to high."""
    if levels < 2:
        raise BadValue(f"{levels} levels", "give 2 or more", "levels")
    return Design((factor,), np.linspace(-1, 1, levels)[:, None], "sweep")


def latin_hypercube(factors: Sequence[Factor], runs: int, seed: int) -> Design:
    """Each factor's range cut into `runs` strata, one run in each; the most spread of 100."""
    unit = pydoe.lhs(len(factors), samples=runs, criterion="maximin", iterations=100, seed=seed)
    return Design(tuple(factors), 2 * unit - 1, "Latin hypercube")


def sobol(factors: Sequence[Factor], runs: int, seed: int) -> Design:
    """The first `runs` points of a scrambled Sobol' sequence; a power of 2 is best balanced."""
    unit = pydoe.sobol_sequence(runs, len(factors), scramble=True, seed=seed, use_pow_of_2=False)
    return Design(tuple(factors), 2 * unit - 1, "Sobol'")


def _with_centre(matrix: np.ndarray, centre: int) -> np.ndarray:
    return np.vstack([matrix, np.zeros((centre, matrix.shape[1]))])


def _need(factors: Sequence[Factor], fewest: int) -> None:
    if len(factors) < fewest:
        raise BadValue(f"{len(factors)} factors", f"give {fewest} or more", "factors")
