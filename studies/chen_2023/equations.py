"""A printed regression equation: its values at design points, and the factor it is off by."""

from collections.abc import Mapping

import numpy as np

from calibrate.designs.terms import Term, Terms, parse
from studies.chen_2023.tables import Range, equation, printed


def printed_terms(response: str, names: tuple[str, ...]) -> Terms:
    """Terms of the "depth" or "force" equation in its factors' letters, without the intercept."""
    return parse(" + ".join(term for term in equation(response) if term != "1"), names)


def printed_coefficients(response: str) -> dict[str, Range]:
    return {term: printed(text) for term, text in equation(response).items()}


def distinct_points(points: np.ndarray, runs: tuple[str, ...]) -> dict[str, list[int]]:
    """Rows (from 0) of each distinct point of a design (n, p), by the numbers of its runs."""
    rows: dict[tuple[float, ...], list[int]] = {}
    for row, point in enumerate(points.tolist()):
        rows.setdefault(tuple(point), []).append(row)
    return {
        ("run " if len(same) == 1 else "centre, runs ") + ", ".join(runs[r] for r in same): same
        for same in rows.values()
    }


def value(response: str, names: tuple[str, ...], point: np.ndarray, reach: np.ndarray) -> Range:
    """The printed equation at a point (p,) known to ± reach (p,), in whatever unit it has.

    The coefficients' rounding and that of the point add up in the worst case.
    """
    terms = (Term((0,) * len(names)), *printed_terms(response, names))
    ranges = list(printed_coefficients(response).values())
    coefficients = np.array([number.value for number in ranges])

    def polynomial(x: np.ndarray) -> np.ndarray:
        return np.array([term.values(x[None])[0] for term in terms])

    rounding = sum(
        abs(coefficients @ (polynomial(point + shift) - polynomial(point - shift))) / 2
        for shift in np.diag(reach)
    )
    monomials = polynomial(point)
    rounding += float(np.abs(monomials) @ np.array([number.reach for number in ranges]))
    return Range(float(coefficients @ monomials), float(rounding))


def common_factor(
    equation_values: Mapping[str, Range], responses: Mapping[str, Range]
) -> tuple[Range, list[str]]:
    """The factors that, times the equation, give the responses at as many points as possible.

    Each point allows an interval of factors; returned is the intersection of the largest set
    of intervals that have one, and the names of that set.  All numbers are positive.
    """
    intervals = {
        name: (
            (responses[name].value - responses[name].reach) / (v.value + v.reach),
            (responses[name].value + responses[name].reach) / (v.value - v.reach),
        )
        for name, v in equation_values.items()
    }
    starts = [low for low, _ in intervals.values()]
    best = max(starts, key=lambda s: sum(low <= s <= high for low, high in intervals.values()))
    members = [name for name, (low, high) in intervals.items() if low <= best <= high]
    low = max(intervals[name][0] for name in members)
    high = min(intervals[name][1] for name in members)
    return Range((low + high) / 2, (high - low) / 2), members
