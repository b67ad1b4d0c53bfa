"""Screening: effects, their significance, and what is refused.

The filtration rate is the unreplicated 2^4 of Montgomery, Design and Analysis of Experiments.
"""

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from scipy import stats

from calibrate.core.errors import BadValue
from calibrate.designs import designs
from calibrate.designs.factors import Factor
from calibrate.designs.screening import screen


def filtration() -> tuple[np.ndarray, list[str], np.ndarray]:
    """Montgomery's filtration rate, all 15 contrasts of its 2^4 design (standard order)."""
    y = np.array([45, 71, 48, 65, 68, 60, 80, 65, 43, 100, 45, 104, 75, 86, 70, 96], float)
    base = designs.full_factorial(tuple(Factor(n, 0, 1) for n in "ABCD")).coded
    names = [
        "".join(letter for bit, letter in enumerate("ABCD") if number >> bit & 1)
        for number in range(1, 16)
    ]
    columns = [np.prod(base[:, ["ABCD".index(c) for c in name]], axis=1) for name in names]
    return np.column_stack(columns), names, y


def test_effects_of_the_filtration_rate():
    """Effects as Montgomery prints them; Lenth's error worked out by hand from his effects."""
    columns, names, y = filtration()
    found = screen(columns, y, names)
    effects = {"A": 21.625, "C": 9.875, "D": 14.625, "AC": -18.125, "AD": 16.625}
    assert {name: found[name].effect for name in effects} == pytest.approx(effects)
    assert found["A"].sum_of_squares == pytest.approx(1870.5625)
    assert sum(effect.contribution for effect in found.effects) == pytest.approx(100)
    assert found.pseudo_se == pytest.approx(1.5 * 1.75)  # median of the ten below 9.84 is 1.75
    assert found.margin == pytest.approx(2.625 * stats.t.ppf(0.975, 5))
    active = {e.name for e in found.effects if abs(e.effect) > found.margin}
    assert active == set(effects)
    assert np.isnan([e.p for e in found.effects]).all()  # no degree of freedom is left


def test_screening_equals_least_squares_and_level_means():
    design = designs.plackett_burman(tuple(Factor(n, 0, 1) for n in "ABCDEFG"), centre=3)
    y = np.random.default_rng(8).normal(size=15)
    y[12:] += 4
    found = screen(design, y)
    corner = ~design.centre
    frame = pd.DataFrame(design.coded, columns=list(design.names)).assign(y=y, centre=~corner)
    fit = smf.ols("y ~ A + B + C + D + E + F + G + centre", frame).fit()
    for name, column in zip(design.names, design.coded.T, strict=True):
        mean = y[column == 1].mean() - y[column == -1].mean()
        assert found[name].effect == pytest.approx(mean)
        assert found[name].t == pytest.approx(fit.tvalues[name])
        assert found[name].p == pytest.approx(fit.pvalues[name])
        assert found[name].df == 6
    assert found.curvature == pytest.approx(y[12:].mean() - y[:12].mean())
    assert found.curvature_p == pytest.approx(fit.pvalues["centre[T.True]"])
    dummies = sum(e.sum_of_squares for e in found.effects if e.dummy)
    replicates = np.sum((y[12:] - y[12:].mean()) ** 2)
    assert found.residual_sum_of_squares == pytest.approx(dummies + replicates)


def test_screening_ranks_factors_and_not_dummies():
    design = designs.plackett_burman(tuple(Factor(n, 0, 1) for n in "ABCDE"))
    y = design.coded @ [1.0, -5.0, 0, 2.0, 0] + 9 * design.dummies[:, 0]
    assert [effect.name for effect in screen(design, y).ranked()][:3] == ["B", "D", "A"]
    quantiles = [
        e.half_normal for e in sorted(screen(design, y).effects, key=lambda e: e.effect**2)
    ]
    assert np.all(np.diff(quantiles) > 0)
    assert quantiles[0] > 0


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (np.array([[1, 1], [1, -1], [-1, 1], [1, 1]]), "balanced and orthogonal"),
        (np.array([[1, 0.5], [1, -1], [-1, 1], [-1, -1]]), "neither at low and high"),
        (np.zeros((4, 2)), "neither at low and high"),
    ],
)
def test_screening_refuses_other_designs(columns: np.ndarray, says: str):
    with pytest.raises(BadValue, match=says):
        screen(columns, np.arange(4.0))
    with pytest.raises(BadValue, match="missing"):
        screen(np.array([[1], [-1]]), np.array([1, np.nan]))
