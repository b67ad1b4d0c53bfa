"""Analyses against independent results that others computed.

Sources: the NIST Statistical Reference Datasets (certified values of Filip and Longley), the
vignette of R's rsm (chemical reaction), Table 10 of Chen et al. 2023, and statsmodels' formulas.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
import statsmodels.formula.api as smf
from statsmodels.stats.anova import anova_lm

from calibrate.designs import terms
from calibrate.designs.anova import Anova, anova, pure_error
from calibrate.designs.factors import Factor
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import Term
from tests import DATA

PUBLISHED = DATA / "doe"
SIX_DIGITS = 5e-7


def table(name: str) -> np.ndarray:
    return np.loadtxt(PUBLISHED / name, delimiter=",", skiprows=1)


def paper_surface() -> Surface:
    """The quadratic in the coded factors of the paper's Table 4."""
    rows = table("paper_table_4.csv")
    factors = (Factor("C", 4, 20), Factor("D", 0.3, 0.7), Factor("E", 0.3, 1.0))
    X = np.column_stack([f.coded(rows[:, j]) for j, f in enumerate(factors, 1)])
    return fit_surface(X, rows[:, 4], terms.quadratic(3), ("C", "D", "E"))


def natural_coefficients(
    terms: Sequence[Term], coefficients: np.ndarray, factors: Sequence[Factor]
) -> dict[Term, float]:
    """The same polynomial in natural units: the coefficient of each power, intercept included.

    `coefficients` (1 + terms) are those of coded units.  A logarithmic factor stands as the
    logarithm of its natural value.
    """
    found: dict[Term, float] = {}
    intercept = Term((0,) * len(factors))
    for term, coefficient in zip((intercept, *terms), coefficients, strict=True):
        for powers in itertools.product(*(range(power + 1) for power in term.powers)):
            share = float(coefficient)
            for factor, power, kept in zip(factors, term.powers, powers, strict=True):
                share *= _binomial_share(factor, power, kept)
            found[Term(powers)] = found.get(Term(powers), 0.0) + share
    return found


def _binomial_share(factor: Factor, power: int, kept: int) -> float:
    """Coefficient of x^kept in ((x - centre)/half_range)^power."""
    rest = (-factor.scaled_centre) ** (power - kept)
    return math.comb(power, kept) * rest / factor.half_range**power


# ---------------------------------------------------------------- certified values


def test_filip_agrees_with_nist():
    """A polynomial of degree 10 that raw powers cannot fit in double precision."""
    certified = [
        -1467.48961422980, -2772.17959193342, -2316.37108160893, -1127.97394098372,
        -354.478233703349, -75.1242017393757, -10.8753180355343, -1.06221498588947,
        -0.670191154593408e-01, -0.246781078275479e-02, -0.402962525080404e-04,
    ]  # fmt: skip
    y, x = table("filip.csv").T
    factor = Factor("x", x.min(), x.max())
    powers = tuple(Term((k,)) for k in range(1, 11))
    surface = fit_surface(factor.coded(x)[:, None], y, powers, ("x",))
    natural = natural_coefficients(powers, surface.coefficients, (factor,))
    found = [natural[Term((k,))] for k in range(11)]
    assert found == pytest.approx(certified, rel=SIX_DIGITS)
    analysis = anova(surface)
    assert analysis.r2.value == pytest.approx(0.996727416185620, rel=SIX_DIGITS)
    assert analysis.std_dev.value == pytest.approx(0.334801051324544e-02, rel=SIX_DIGITS)
    check_line(analysis, "Model", 0.242391619837339, 10, 2162.43954511489)
    check_line(analysis, "Residual", 0.795851382172941e-03, 71)


def test_longley_agrees_with_nist():
    certified = [
        -3482258.63459582, 15.0618722713733, -0.358191792925910e-01, -2.02022980381683,
        -1.03322686717359, -0.511041056535807e-01, 1829.15146461355,
    ]  # fmt: skip
    certified_sd = [
        890420.383607373, 84.9149257747669, 0.334910077722432e-01, 0.488399681651699,
        0.214274163161675, 0.226073200069370, 455.478499142212,
    ]  # fmt: skip
    data = sm.datasets.longley.load_pandas().data.to_numpy()
    surface = fit_surface(data[:, 1:], data[:, 0], terms.linear(6))
    assert surface.coefficients == pytest.approx(certified, rel=SIX_DIGITS)
    assert np.sqrt(np.diag(surface.covariance)) == pytest.approx(certified_sd, rel=SIX_DIGITS)
    analysis = anova(surface)
    assert analysis.std_dev.value == pytest.approx(304.854073561965, rel=SIX_DIGITS)
    assert analysis.r2.value == pytest.approx(0.995479004577296, rel=SIX_DIGITS)
    check_line(analysis, "Model", 184172401.944494, 6, 330.285339234588)
    check_line(analysis, "Residual", 836424.055505915, 9)


def check_line(analysis: Anova, source: str, squares: float, df: int, f: float | None = None):
    line = analysis[source]
    assert line.sum_of_squares == pytest.approx(squares, rel=SIX_DIGITS)
    assert line.df == df
    if f is not None:
        assert line.f == pytest.approx(f, rel=SIX_DIGITS)


def reaction_surface() -> Surface:
    """The second-order surface of the chemical reaction, with its two blocks."""
    time, temperature, block, y = table("chem_react.csv").T
    names = ("block", "x1", "x2")
    X = np.column_stack([block - 1, (time - 85) / 5, (temperature - 175) / 5])
    model = terms.parse("block + x1 + x2 + x1*x2 + x1^2 + x2^2", names)
    return fit_surface(X, y, model, names)


def test_chemical_reaction_agrees_with_rsm():
    surface = reaction_surface()
    printed = [84.095427, -4.457530, 0.932541, 0.577712, 0.125000, -1.308555, -0.933442]
    printed_se = [0.079631, 0.087226, 0.057699, 0.057699, 0.081592, 0.060064, 0.060064]
    assert surface.coefficients == pytest.approx(printed, abs=5.1e-7)
    assert np.sqrt(np.diag(surface.covariance)) == pytest.approx(printed_se, abs=5.1e-7)
    analysis = anova(surface)
    p = [analysis[name].p for name in ("block", "x1", "x2", "x1*x2", "x1^2", "x2^2")]
    printed_p = [2.877e-10, 8.444e-07, 2.122e-05, 0.1694, 1.083e-07, 1.104e-06]
    assert p == pytest.approx(printed_p, rel=5e-4)
    assert analysis["Model"].f == pytest.approx(607.2, abs=0.05)
    assert analysis["Model"].p == pytest.approx(3.811e-09, rel=5e-4)
    assert (analysis["Lack of fit"].df, analysis["Pure error"].df) == (3, 4)
    assert analysis["Lack of fit"].f == pytest.approx(0.5307, abs=5e-5)
    assert analysis["Lack of fit"].p == pytest.approx(0.6851, abs=5e-5)
    assert (analysis.r2.value, analysis.adjusted_r2.value) == pytest.approx(
        (0.9981, 0.9964), abs=5e-5
    )


# ---------------------------------------------------------------- the paper's Table 4


def test_analysis_of_the_papers_table_4():
    """Values that Table 10 prints, and its pure error and true residual."""
    analysis = anova(paper_surface())
    model, residual, error = (analysis[s] for s in ("Model", "Residual", "Pure error"))
    assert (model.df, residual.df, error.df, analysis["Total"].df) == (9, 7, 4, 16)
    assert model.sum_of_squares == pytest.approx(1.062e5, abs=50)
    assert model.f == pytest.approx(4.58, abs=0.01)
    assert model.p == pytest.approx(0.0287, abs=2e-4)
    assert residual.sum_of_squares == pytest.approx(18012, abs=0.5)
    assert error.sum_of_squares == pytest.approx(16825, abs=0.5)
    assert analysis["Lack of fit"].df == 3
    assert analysis["Total"].sum_of_squares == pytest.approx(1.242e5, abs=50)


def test_analysis_equals_type_three_of_statsmodels_formulas():
    surface = paper_surface()
    frame = pd.DataFrame(surface.X, columns=list(surface.names)).assign(y=surface.y)
    formula = "y ~ C + D + E + C:D + C:E + D:E + I(C**2) + I(D**2) + I(E**2)"
    independent = anova_lm(smf.ols(formula, frame).fit(), typ=3).drop(index="Intercept")
    analysis = anova(surface)
    lines = [line for line in analysis.lines if line.source in surface.labels]
    assert len(lines) == 9
    ours = [(line.sum_of_squares, line.df, line.f, line.p) for line in lines]
    theirs = independent.loc[independent.index != "Residual", ["sum_sq", "df", "F", "PR(>F)"]]
    assert np.array(ours) == pytest.approx(theirs.to_numpy(), rel=1e-8)


def test_sums_of_squares_add_up():
    analysis = anova(paper_surface())
    line = {line.source: line for line in analysis.lines}
    for whole, parts in (("Total", ("Model", "Residual")),
                         ("Residual", ("Lack of fit", "Pure error"))):  # fmt: skip
        squares = sum(line[part].sum_of_squares for part in parts)
        assert squares == pytest.approx(line[whole].sum_of_squares)
        assert sum(line[part].df for part in parts) == line[whole].df


def test_statistics_carry_their_degrees_of_freedom():
    analysis = anova(paper_surface())
    assert {name: value.df for name, value in analysis.statistics().items()} == {
        "std_dev": (7,), "mean": (17,), "cv_percent": (7,), "r2": (9, 7),
        "adjusted_r2": (7, 16), "predicted_r2": (17, 16), "press": (17,),
        "adequate_precision": (10, 7),
    }  # fmt: skip
    text = analysis.as_text()
    assert "Lack of fit" in text
    assert "predicted r2" in text


def test_pure_error_finds_replicates_in_natural_units_too():
    X = np.array([[0.1 + 0.2, 1e6], [0.3, 1e6], [0.3, 2e6], [0.5, 2e6], [0.5, 2e6]])
    assert pure_error(X, np.array([1.0, 3.0, 9.0, 4.0, 5.0])) == (pytest.approx(2.5), 2)


def test_a_saturated_model_says_nothing_about_noise():
    X = np.array(list(itertools.product([-1.0, 1.0], repeat=2)))
    both = terms.parse("A + B + A*B", ("A", "B"))
    analysis = anova(fit_surface(X, np.array([1.0, 2.0, 4.0, 9.0]), both))
    assert analysis["Model"].df == 3
    assert analysis["Residual"].df == 0
    assert np.isnan([analysis["Model"].f, analysis["A"].p, analysis.press.value]).all()
    assert "Pure error" not in analysis
