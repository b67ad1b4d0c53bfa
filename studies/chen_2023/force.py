"""Table 10, the force equation and the force optimum against the seventeen runs of Table 4.

The analysis of variance is that of the full quadratic model.  The equation is a cubic that the
thirteen distinct points of a Box-Behnken design just fix, in a unit of its own.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from calibrate.designs.anova import Anova, anova
from calibrate.designs.factors import Factor
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import quadratic
from studies.chen_2023 import equations
from studies.chen_2023.levels import coded_points, run_interval
from studies.chen_2023.tables import Range, in_text, printed, table
from studies.chen_2023.verdict import (
    Attempt,
    Figure,
    Numbers,
    Ranges,
    judge,
    judge_rows,
    judge_value,
    judge_words,
    rounded,
    row_entries,
)

NAMES = ("surface_energy", "plasticity_ratio", "tangential_multiplier")
LETTERS = ("C", "D", "E")
FACTORS = (Factor("C", 4, 20), Factor("D", 0.3, 0.7), Factor("E", 0.3, 1.0))
SOURCES = {"model": "Model", **dict(zip(NAMES, LETTERS, strict=True)), "total": "Total"}
LABEL = "the row is the pure error, the residual has 7 degrees of freedom"
# The least change of Table 4 that makes all of Table 10 follow: one centre run and one other run
# by 0.2 N each.  Other pairs of runs do as well, so this shows the size of the difference between
# the printed and the analysed responses, not where it lies.
ANALYSED = {"3": 174.00, "8": 245.00}
ANALYSED_WORDS = "run 3 of Table 4 read as 174.00 N and run 8 as 245.00 N"
# Digits of run 12 that, exchanged, make the equation hold there too: 331.61 and 313.61.
OF_EQUATION = {"12": 313.61}
OF_EQUATION_WORDS = "run 12 of Table 4 read as 313.61 N instead of 331.61 N"


def points() -> np.ndarray:
    """Design points of Table 4 (17, 3) in natural units."""
    return table(4).points(NAMES)


def forces(changes: dict[str, float] | None = None) -> np.ndarray:
    """Printed crushing forces (17,), N; `changes` replaces those of single runs."""
    column = table(4).values("crushing_force_n")
    for run, value in (changes or {}).items():
        column[list(table(4).rows).index(run)] = value
    return column


def half_units() -> np.ndarray:
    return table(4).half_units("crushing_force_n")


def surface(y: np.ndarray) -> Surface:
    """The full quadratic in coded units, fitted to forces y (17,)."""
    return fit_surface(coded_points(FACTORS, points()), y, quadratic(3), LETTERS)


def analysis(y: np.ndarray) -> Anova:
    return anova(surface(y))


def figures() -> Iterator[Figure]:
    """Table 10, the equation's coefficients and values, the optimum, what the text concludes."""
    yield from judge_rows(
        table(10), anova_ranges(), {"sum_of_squares": "N²", "mean_square": "N²"}, _misprint()
    )
    yield from conclusions()
    yield from coefficients()
    yield from values_at_points()
    yield from optimum()


def conclusions() -> Iterator[Figure]:
    """Which factors are significant, and which is the strongest."""
    found, level = analysis(forces()), printed(in_text("significance.level")).value
    significant = ", ".join(n for n in NAMES if found[SOURCES[n]].p < level)
    title = f"significant at {level:g}"
    others = [f"{table(10).text(n, 'p_value')}" for n in NAMES if n not in significant]
    remark = f"Table 10 itself prints p = {' and '.join(others)} for the others"
    text = in_text("significant.crushing_force")
    yield judge_words("Table 10", title, text, significant, remark)
    stronger = max(NAMES, key=lambda name: found[SOURCES[name]].f)
    text = in_text("stronger.crushing_force")
    yield judge_words("Table 10", "most significant factor", text, stronger)


def coefficients() -> Iterator[Figure]:
    """The equation's coefficients against a fit of the same terms in natural units."""
    factor, _ = unit_of_equation()
    unit = f"in units of {factor.value:.4g} N"
    computations = {
        "": _coefficient_ranges(forces(), Range(1.0)),
        unit: _coefficient_ranges(forces(), factor),
        f"{unit}; {OF_EQUATION_WORDS}": _coefficient_ranges(forces(OF_EQUATION), factor),
    }
    for term, number in equations.equation("force").items():
        attempts = [Attempt(found[term], words) for words, found in computations.items()]
        title = "intercept" if term == "1" else f"coefficient of {term}"
        remark = "not within rounding even so"
        yield judge("Force equation", title, number, attempts, remark)


def values_at_points() -> Iterator[Figure]:
    """The printed equation at the design points against the forces printed for them."""
    factor, _ = unit_of_equation()
    published, measured = equation_values(), force_at_points(forces())
    changed = force_at_points(forces(OF_EQUATION))
    correction = f"in units of {factor.value:.4g} N"
    for name, value in published.items():
        attempts = [
            Attempt(measured[name]),
            Attempt(_over(measured[name], factor), correction),
            Attempt(_over(changed[name], factor), f"{correction}; {OF_EQUATION_WORDS}"),
        ]
        shown = f"{value.value:.3f}"
        yield judge_value("Force equation", f"value at {name}", value, shown, attempts)


def optimum() -> Iterator[Figure]:
    """The force at the published optimum, for the body's target and for the abstract's."""
    predicted = force_at_optimum()
    for text, source in (
        (in_text("optimum.crushing_force.target"), "section 3.3.3"),
        (in_text("abstract.crushing_force"), "abstract"),
    ):
        remark = "the quadratic of Table 10 gives the abstract's target here"
        title = f"crushing force at the optimum ({source})"
        yield judge("Optimum", title, text, [Attempt(predicted)], remark, "N")


def force_at_optimum() -> Range:
    """What the quadratic predicts at the published optimum, N."""
    place = [printed(in_text(f"optimum.{name}")) for name in NAMES]
    x, reach = (np.array([getattr(p, part) for p in place]) for part in ("value", "reach"))

    def predict(inputs: np.ndarray) -> Numbers:
        at = coded_points(FACTORS, inputs[None, :3])
        return {"force": float(surface(inputs[3:])(at)[0])}

    inputs = np.concatenate([x, forces()])
    return rounded(predict, inputs, np.concatenate([reach, half_units()]))["force"]


def interval_at(multiplier: str) -> tuple[float, float, float]:
    """The quadratic's prediction at the optimum, with the multiplier printed under that name, and
    the ends of its 95 % interval, N."""
    place = [printed(in_text(f"optimum.{name}")).value for name in NAMES[:2]]
    at = np.array([[*place, printed(in_text(multiplier)).value]])
    fitted, coded = surface(forces()), coded_points(FACTORS, at)
    return float(fitted(coded)[0]), *run_interval(fitted, coded)


@cache
def unit_of_equation() -> tuple[Range, list[str]]:
    """What the printed equation must be multiplied by to be in N, and the points that agree."""
    return equations.common_factor(equation_values(), force_at_points(forces()))


@cache
def equation_values() -> dict[str, Range]:
    """The printed equation at the thirteen distinct design points; their levels are exact."""
    return {
        name: equations.value("force", LETTERS, points()[rows[0]], np.zeros(3))
        for name, rows in _distinct().items()
    }


def force_at_points(y: np.ndarray) -> dict[str, Range]:
    """Mean of forces y (17,) at the thirteen distinct design points, N."""
    return {
        name: Range(float(y[rows].mean()), float(half_units()[rows].mean()))
        for name, rows in _distinct().items()
    }


def _distinct() -> dict[str, list[int]]:
    return equations.distinct_points(points(), tuple(table(4).rows))


def _over(number: Range, factor: Range) -> Range:
    value = number.value / factor.value
    reach = (number.reach + abs(value) * factor.reach) / factor.value
    return Range(value, reach)


def anova_ranges() -> dict[str, Ranges]:
    """Ranges of Table 10's entries by the correction that they take."""
    found: dict[str, Ranges] = {}
    for words, changes in (("", {}), (ANALYSED_WORDS, ANALYSED)):
        y = forces(changes)
        whole = rounded(lambda y: _entries(y, "Residual"), y, half_units())
        pure = rounded(lambda y: _entries(y, "Pure error"), y, half_units())
        found[words] = whole
        label = "; ".join(word for word in (LABEL, words) if word)
        found[label] = {name: r for name, r in pure.items() if name.startswith("residual")}
    return found


def _entries(y: np.ndarray, residual: str) -> Numbers:
    return row_entries(analysis(y), SOURCES | {"residual": residual})


def _misprint() -> dict[str, Attempt]:
    """The sum of squares of D, whose own row contradicts it."""
    text = table(10).text("plasticity_ratio", "mean_square")
    squares = rounded(lambda y: _entries(y, "Residual"), forces(ANALYSED), half_units())
    entry = "plasticity_ratio.sum_of_squares"
    words = f"read as {text}, the mean square (one degree of freedom); {ANALYSED_WORDS}"
    return {entry: Attempt(squares[entry], words, printed(text))}


def _coefficient_ranges(y: np.ndarray, unit: Range) -> Ranges:
    def fitted(responses: np.ndarray) -> Numbers:
        terms = equations.printed_terms("force", LETTERS)
        found = fit_surface(points(), responses, terms, LETTERS).coefficients
        return dict(zip(equations.equation("force"), found.tolist(), strict=True))

    return {name: _over(r, unit) for name, r in rounded(fitted, y, half_units()).items()}
