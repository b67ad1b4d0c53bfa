"""Table 9, the depth equation and the depth optimum against the thirteen runs of Table 3.

The paper's analysis of variance is that of the cubic model (A^3 and B^3 are aliased in this
design), its equation has A^2*B^2 besides; both belong to three times the printed depth.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from calibrate.designs.anova import Anova, anova
from calibrate.designs.factors import Factor
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import parse
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

NAMES = ("restitution", "static_friction")
LETTERS = ("A", "B")
FACTORS = (Factor("A", 0.3, 0.7), Factor("B", 0.2, 1.0))
MODELS = {
    "quadratic": "A + B + A*B + A^2 + B^2",
    "cubic": "A + B + A*B + A^2 + B^2 + A^2*B + A*B^2",
    "cubic with A^2*B^2": "A + B + A*B + A^2 + B^2 + A^2*B + A*B^2 + A^2*B^2",
}
SOURCES = {"model": "Model", "restitution": "A", "static_friction": "B", "total": "Total"}
TRIPLED = "three times the depth of Table 3"
PURE = f"{TRIPLED}; the row is the pure error, the residual has 5 degrees of freedom"


def points() -> np.ndarray:
    """Design points of Table 3 (13, 2) in natural units."""
    return table(3).points(NAMES)


def depths() -> np.ndarray:
    """Printed depression depths (13,), mm."""
    return table(3).values("depression_depth_mm")


def half_units() -> np.ndarray:
    return table(3).half_units("depression_depth_mm")


def surface(y: np.ndarray, model: str = "cubic") -> Surface:
    """One of `MODELS` in coded units, fitted to depths y (13,)."""
    return fit_surface(coded_points(FACTORS, points()), y, parse(MODELS[model], LETTERS), LETTERS)


def analysis(y: np.ndarray, model: str = "cubic") -> Anova:
    return anova(surface(y, model))


def figures() -> Iterator[Figure]:
    """Table 9, the equation's coefficients and values, the optimum, what the text concludes."""
    yield from judge_rows(table(9), anova_ranges(), {"sum_of_squares": "mm²", "mean_square": "mm²"})
    yield from conclusions()
    yield from coefficients()
    yield from values_at_points()
    yield optimum()


def conclusions() -> Iterator[Figure]:
    """Which factors are significant, and which is the stronger."""
    found, level = analysis(depths()), printed(in_text("significance.level")).value
    significant = ", ".join(n for n in NAMES if found[SOURCES[n]].p < level)
    title = f"significant at {level:g}"
    yield judge_words("Table 9", title, in_text("significant.depression_depth"), significant)
    stronger = max(NAMES, key=lambda name: found[SOURCES[name]].f)
    remark = "by F, in Table 9 itself and from Table 3"
    text = in_text("stronger.depression_depth")
    yield judge_words("Table 9", "more significant factor", text, stronger, remark)


def coefficients() -> Iterator[Figure]:
    """The equation's coefficients against a fit of the same terms in natural units."""
    once = rounded(_natural_coefficients, depths(), half_units())
    tripled = rounded(lambda y: _natural_coefficients(3 * y), depths(), half_units())
    for term, number in equations.equation("depth").items():
        attempts = [Attempt(once[term]), Attempt(tripled[term], TRIPLED)]
        title = "intercept" if term == "1" else f"coefficient of {term}"
        yield judge("Depth equation", title, number, attempts)


def values_at_points() -> Iterator[Figure]:
    """The printed equation at the design points against the depths printed for them."""
    published, measured = equation_values(), depth_at_points()
    for name, depth in measured.items():
        tripled = Range(3 * depth.value, 3 * depth.reach)
        attempts = [Attempt(depth), Attempt(tripled, TRIPLED)]
        value = published[name]
        shown = f"{value.value:.3f}"
        yield judge_value("Depth equation", f"value at {name}", value, shown, attempts, unit="mm")


def optimum() -> Figure:
    """The depth at the published optimum, which was to be the measured one."""
    predicted = predictions_at_optimum()
    quadratic, saturated = predicted["quadratic"], predicted["cubic with A^2*B^2"]
    of_equation = predicted["printed equation / 3"]
    remark = (
        f"from the cubic of Table 9; with A^2*B^2 {saturated.value:.3f}, quadratic "
        f"{quadratic.value:.3f}, a third of the printed equation {of_equation.value:.3f} mm"
    )
    text = in_text("optimum.depression_depth.target")
    title = "depression depth at the optimum"
    return judge("Optimum", title, text, [Attempt(predicted["cubic"])], remark, "mm")


def predictions_at_optimum() -> Ranges:
    """Depth (mm) at the published optimum by each of `MODELS` and by the printed equation."""
    place = [printed(in_text(f"optimum.{name}")) for name in NAMES]
    x, reach = (np.array([getattr(p, part) for p in place]) for part in ("value", "reach"))

    def predict(inputs: np.ndarray) -> Numbers:
        at = coded_points(FACTORS, inputs[None, :2])
        return {model: float(surface(inputs[2:], model)(at)[0]) for model in MODELS}

    inputs = np.concatenate([x, depths()])
    found = rounded(predict, inputs, np.concatenate([reach, half_units()]))
    whole = equations.value("depth", LETTERS, x, reach)
    return found | {"printed equation / 3": Range(whole.value / 3, whole.reach / 3)}


def interval_at_optimum() -> tuple[float, float]:
    """The cubic's 95 % prediction interval at the published optimum, mm."""
    at = np.array([[printed(in_text(f"optimum.{name}")).value for name in NAMES]])
    return run_interval(surface(depths()), coded_points(FACTORS, at))


@cache
def equation_values() -> dict[str, Range]:
    """The printed equation at the nine distinct design points; their levels are exact."""
    return {
        name: equations.value("depth", LETTERS, points()[rows[0]], np.zeros(2))
        for name, rows in _distinct().items()
    }


def depth_at_points() -> dict[str, Range]:
    """Mean printed depth at the nine distinct design points, mm."""
    return {
        name: Range(float(depths()[rows].mean()), float(half_units()[rows].mean()))
        for name, rows in _distinct().items()
    }


def _distinct() -> dict[str, list[int]]:
    return equations.distinct_points(points(), tuple(table(3).rows))


def anova_ranges() -> dict[str, Ranges]:
    """Ranges of Table 9's entries by the correction that they take."""

    def entries(y: np.ndarray, residual: str) -> Numbers:
        return row_entries(analysis(y), SOURCES | {"residual": residual})

    once = rounded(lambda y: entries(y, "Residual"), depths(), half_units())
    tripled = rounded(lambda y: entries(3 * y, "Residual"), depths(), half_units())
    pure = rounded(lambda y: entries(3 * y, "Pure error"), depths(), half_units())
    only_residual = {name: r for name, r in pure.items() if name.startswith("residual")}
    return {"": once, PURE: only_residual, TRIPLED: tripled}


def _natural_coefficients(y: np.ndarray) -> Numbers:
    terms = equations.printed_terms("depth", LETTERS)
    fitted = fit_surface(points(), y, terms, LETTERS)
    return dict(zip(equations.equation("depth"), fitted.coefficients.tolist(), strict=True))
