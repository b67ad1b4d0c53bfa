"""Screening and the optimum by desirability against published ones and brute force; the figures.

The filtration rate is the unreplicated 2^4 of Montgomery, Design and Analysis of Experiments.  The
published optima are those of Kuhn's manual of R's desirability package (2016) for the
response equations of Myers and Montgomery's chemical process.
"""

import itertools

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from scipy import stats

from calibrate.core.errors import BadValue
from calibrate.designs import designs, terms
from calibrate.designs.factors import Factor
from calibrate.designs.optimum import Region, maximise, minimise, optimise, target
from calibrate.designs.screening import screen
from calibrate.designs.surface import Surface, fit_surface
from calibrate.figures import doe

FACTORS = (Factor("time", 80, 90, "min"), Factor("temperature", 80, 90), Factor("catalyst", 2, 3))
CONVERSION = [81.09, 1.0284, 4.043, 6.2037, 2.2150, 11.375, -3.875, -1.8366, 2.9382, -5.1915]
ACTIVITY = [59.85, 3.583, 0.2546, 2.2298, -0.3875, -0.375, 0.3125, 0.83479, 0.07484, 0.05716]
GOALS = (maximise(80, 97), target(55, 57.5, 60))


def exact_surface(coefficients: list[float]) -> Surface:
    """The quadratic in three factors with these coefficients, "fitted" without noise."""
    X = designs.central_composite(FACTORS).coded
    y = terms.matrix(terms.quadratic(3), X) @ coefficients
    return fit_surface(X, y, terms.quadratic(3), [factor.name for factor in FACTORS])


def noisy_pair() -> tuple[Surface, Surface]:
    X = designs.central_composite(FACTORS[:2]).coded
    a, b = X.T
    noise = np.random.default_rng(0).normal(size=(2, len(a)))
    first = fit_surface(X, 20 + 3 * a + b - a**2 + 0.3 * noise[0], terms.quadratic(2))
    second = fit_surface(X, 5 + a - 2 * b + b**2 + 0.1 * noise[1], terms.quadratic(2))
    return first, second


@pytest.mark.parametrize(
    ("region", "desirability", "x"),
    [
        (Region(-1.682, 1.682), 0.9425094, [-0.5117132, 1.6820000, -0.5863863]),
        (Region(-1.682, 1.682, radius=1.682), 0.8581525, [-0.5094851, 1.5034146, -0.5561415]),
    ],
)
def test_optimum_is_the_published_one(region: Region, desirability: float, x: list[float]):
    found = optimise([exact_surface(CONVERSION), exact_surface(ACTIVITY)], GOALS, region, starts=8)
    assert found.desirability == pytest.approx(desirability, abs=1e-7)
    assert found.x == pytest.approx(x, abs=1e-4)  # theirs is a simplex search's


@pytest.mark.parametrize(
    "goals",
    [
        (maximise(15, 25), minimise(3, 8)),
        (target(18, 21, 23, weight=0.5), minimise(3, 8, weight=3, importance=5)),
        (minimise(17, 24, importance=2), target(4, 7.5, 9, weight=2)),
    ],
)
def test_no_point_of_a_grid_is_better(goals):
    surfaces = noisy_pair()
    found = optimise(surfaces, goals, starts=16)
    line = np.linspace(-1, 1, 61)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    powers = np.array([goal.importance for goal in goals])
    single = np.array([[g(v) for v in s(grid)] for g, s in zip(goals, surfaces, strict=True)])
    overall = np.prod(single ** (powers / powers.sum())[:, None], axis=0)
    assert 0 < overall.max() < 0.9999
    assert overall.max() <= found.desirability + 1e-9
    assert found.desirability == pytest.approx(overall.max(), abs=0.02)
    assert np.abs(found.x).max() <= 1


def test_desirability_of_each_goal():
    aim = target(10, 20, 40, weight=2)
    assert [aim(y) for y in (5, 10, 15, 20, 30, 40, 50)] == [0, 0, 0.25, 1, 0.25, 0, 0]
    large, small = maximise(10, 20), minimise(10, 20, weight=0.5)
    assert [large(y) for y in (10, 12.5, 20, 99)] == [0, 0.25, 1, 1]
    assert [small(y) for y in (-99, 10, 17.5, 20)] == [1, 1, 0.5, 0]


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: target(3, 2, 4),
        lambda: maximise(2, 2),
        lambda: minimise(3, 1),
        lambda: maximise(1, 2, weight=0),
        lambda: minimise(1, 2, importance=-1),
        lambda: optimise(noisy_pair(), [maximise(1, 2)]),
    ],
)
def test_senseless_goals_are_refused(wrong):
    with pytest.raises(BadValue):
        wrong()


def test_among_equal_points_the_best_predicted_is_chosen():
    """One target in two factors is met along a line; the point of least variance is on it."""
    surface = noisy_pair()[0]
    found = optimise([surface], [target(17, 21, 25)], starts=32)
    assert found.desirability == pytest.approx(1, abs=1e-6)
    assert surface(found.x[None])[0] == pytest.approx(21, abs=1e-5)
    assert len(found.alternatives) > 3
    others = [surface.leverage(x) for x in found.alternatives]
    assert surface.leverage(found.x) < min(others)


def test_what_cannot_be_reached_has_no_desirability():
    found = optimise([noisy_pair()[0]], [maximise(100, 200)], starts=4)
    assert found.desirability == 0


# ---------------------------------------------------------------- figures


def test_pareto_draws_every_effect_and_hatches_dummies():
    design = designs.plackett_burman(FACTORS)
    found = screen(design, design.coded @ [4.0, -2.0, 0.5] + design.dummies[:, 0])
    _, axis = plt.subplots()
    doe.pareto(axis, found, "force (N)")
    bars = [bar for bar in axis.patches if bar.get_height() < 0.75]
    assert [bar.get_width() for bar in bars] == sorted(abs(e.effect) for e in found.effects)
    assert sum(bool(bar.get_hatch()) for bar in bars) == 8
    assert axis.get_yticklabels()[-1].get_text() == "time"
    assert axis.get_xlabel() == "|effect| on force (N)"
    plt.close()


def test_contours_are_drawn_in_natural_units():
    log = (Factor("energy", 4, 25, "J/m^2", log=True), FACTORS[1])
    surface = noisy_pair()[0]
    _, axis = plt.subplots()
    doe.contour(axis, doe.View(surface, log, "force (N)"))  # as far as the design's stars
    assert axis.get_xlabel() == "energy (J/m²)"
    labels = [label.get_text() for label in axis.get_xticklabels()]
    assert labels[2] == "10"  # the geometric centre
    star = 5 * 2**0.5
    assert axis.get_ylim() == pytest.approx((85 - star, 85 + star))
    assert axis.get_title() == "force (N)"
    plt.close()


# ------------------------------------------------------------------ screening


def filtration() -> tuple[np.ndarray, list[str], np.ndarray]:
    """Montgomery's filtration rate, all 15 contrasts of its 2^4 design (standard order)."""
    y = np.array([45, 71, 48, 65, 68, 60, 80, 65, 43, 100, 45, 104, 75, 86, 70, 96], float)
    base = np.array(list(itertools.product([-1.0, 1.0], repeat=4)))[:, ::-1]
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
