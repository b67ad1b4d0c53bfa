"""Response surfaces: terms, intervals, selection, slopes in the fit, residual diagnostics."""

import itertools

import numpy as np
import pytest
from scipy import stats

from calibrate.core.errors import BadValue
from calibrate.designs import designs, terms
from calibrate.designs.anova import anova
from calibrate.designs.diagnostics import box_cox, diagnose, transformed, without_profile
from calibrate.designs.factors import Factor
from calibrate.designs.surface import (
    Surface,
    fit_surface,
    fit_with_gradients,
    select_backward,
    without,
)
from calibrate.designs.terms import Term


def noisy_surface(seed: int = 0, sd: float = 0.3) -> Surface:
    design = designs.central_composite((Factor("A", 0, 1), Factor("B", 0, 1)))
    a, b = design.coded.T
    rng = np.random.default_rng(seed)
    y = 10 + 2 * a - b + 0.8 * a * b + 1.5 * a**2 + sd * rng.normal(size=len(a))
    return fit_surface(design.coded, y, terms.quadratic(2), design.names)


def grid(levels) -> np.ndarray:
    """Every combination of two factors' levels."""
    return np.array(list(itertools.product(levels, repeat=2)))


# ---------------------------------------------------------------- surfaces


def test_terms_of_the_usual_models():
    names = ("A", "B", "C")
    labels = [term.label(names) for term in terms.quadratic(3)]
    assert labels == ["A", "B", "C", "A*B", "A*C", "B*C", "A^2", "B^2", "C^2"]
    assert len(terms.cubic(3)) == 19
    assert terms.parse("A + B*A + C**2*A", names) == (
        Term((1, 0, 0)), Term((1, 1, 0)), Term((1, 0, 2)),
    )  # fmt: skip


@pytest.mark.parametrize("text", ["A + Z", "A^0", "A^x", "A + A", "A +", ""])
def test_unknown_terms_are_refused(text: str):
    with pytest.raises(BadValue):
        terms.parse(text, ("A", "B"))


def test_a_cubic_and_its_gradient_are_recovered():
    rng = np.random.default_rng(1)
    X = rng.uniform(-1, 1, (40, 3))
    truth = rng.normal(size=20)
    surface = fit_surface(X, terms.matrix(terms.cubic(3), X) @ truth, terms.cubic(3))
    assert surface.coefficients == pytest.approx(truth, abs=1e-10)
    step = 1e-6 * np.eye(3)
    probe = X[:5]
    numeric = [(surface(probe + d) - surface(probe - d)) / 2e-6 for d in step]
    assert surface.gradient(probe) == pytest.approx(np.array(numeric).T, abs=1e-6)


def test_slopes_at_the_centre_are_the_linear_coefficients():
    surface = noisy_surface()
    slopes = surface.slopes(np.zeros(2))
    assert slopes.values == pytest.approx(surface.coefficients[1:3])
    assert slopes.se == pytest.approx(np.asarray(surface.fit.bse)[1:3])
    elsewhere = surface.slopes(np.array([0.2, -0.4]))
    assert elsewhere.values == pytest.approx(surface.gradient(np.array([[0.2, -0.4]]))[0])


def test_natural_units_that_double_precision_cannot_carry_are_refused():
    surface = noisy_surface()
    moduli = surface.X * [2e6, 0.2] + [7e6, 0.5]
    assert fit_surface(moduli, surface.y, terms.linear(2)).df == 10
    with pytest.raises(BadValue, match="coded units"):
        fit_surface(moduli * [1e3, 1.0], surface.y, surface.terms)


def test_points_that_cannot_fix_the_terms_are_refused():
    X = grid([-1.0, 1.0])
    with pytest.raises(BadValue, match="4 points fix only 4 of 6 coefficients"):
        fit_surface(X, np.arange(4.0), terms.quadratic(2))
    with pytest.raises(BadValue, match="not a finite number"):
        fit_surface(X, np.array([1, 2, np.nan, 4]), terms.linear(2))
    with pytest.raises(BadValue, match="one response for each point"):
        fit_surface(X, np.arange(3.0), terms.linear(2))


# ---------------------------------------------------------------- selection


def clean_surface(truth: str) -> Surface:
    """A full quadratic of A, B, C whose noise is orthogonal to all its terms."""
    design = designs.central_composite(tuple(Factor(n, 0, 1) for n in "ABC"), centre=6)
    noise = np.random.default_rng(3).normal(size=len(design))
    noise = fit_surface(design.coded, noise, terms.quadratic(3)).fit.resid
    signal = terms.matrix(terms.parse(truth, design.names), design.coded).sum(axis=1)
    return fit_surface(design.coded, signal + 0.3 * noise, terms.quadratic(3), design.names)


def test_selection_finds_the_terms_that_are_there_and_their_parents():
    assert set(select_backward(clean_surface("A + B*C")).labels) == {"A", "B", "C", "B*C"}


def test_selection_needs_residual_degrees_of_freedom():
    X = grid([-1.0, 1.0])
    both = terms.parse("A + B + A*B", ("A", "B"))
    with pytest.raises(BadValue, match="no residual"):
        select_backward(fit_surface(X, np.array([1.0, 2.0, 4.0, 9.0]), both))


# ---------------------------------------------------------------- slopes in the fit


def test_gradients_fix_a_quadratic_with_fewer_points_than_coefficients():
    rng = np.random.default_rng(4)
    X = rng.uniform(-1, 1, (4, 3))
    truth = fit_surface(rng.uniform(-1, 1, (10, 3)), rng.normal(size=10), terms.quadratic(3))
    found = fit_with_gradients(X, truth(X), truth.gradient(X), truth.terms, sd=(1, [1, 1, 1]))
    assert found.coefficients == pytest.approx(truth.coefficients, abs=1e-9)
    assert found.df == 4 * 4 - 10


def test_gradients_that_are_missing_change_nothing():
    surface = noisy_surface()
    none = np.full(surface.X.shape, np.nan)
    found = fit_with_gradients(surface.X, surface.y, none, surface.terms, sd=(1, [1, 1]))
    assert found.coefficients == pytest.approx(surface.coefficients)
    assert found.covariance == pytest.approx(surface.covariance)
    assert found.slope_rows == 0


def stacked(surface: Surface, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Model rows and targets of values, then of slopes factor by factor, built term by term."""
    rows = [
        np.column_stack([np.ones(len(surface.X)), *(t.values(surface.X) for t in surface.terms)])
    ]
    for j in range(slopes.shape[1]):
        columns = [t.slopes(surface.X)[:, j] for t in surface.terms]
        rows.append(np.column_stack([np.zeros(len(surface.X)), *columns]))
    return np.vstack(rows), np.concatenate([surface.y, *slopes.T])


def noisy_slopes(surface: Surface) -> np.ndarray:
    noise = np.random.default_rng(10).normal(size=surface.X.shape)
    return surface.gradient(surface.X) + noise * [0.2, 1.0]


def test_gradient_fit_is_generalised_least_squares():
    surface = noisy_surface()
    slopes = noisy_slopes(surface)
    found = fit_with_gradients(surface.X, surface.y, slopes, surface.terms, sd=(2, [1.0, 4.0]))
    rows, targets = stacked(surface, slopes)
    weight = np.repeat([1.0, 4.0, 0.25], len(surface.y))
    normal = rows.T @ (weight[:, None] * rows)
    coefficients = np.linalg.solve(normal, rows.T @ (weight * targets))
    residual = targets - rows @ coefficients
    variance = weight @ residual**2 / (len(targets) - 6)
    assert found.coefficients == pytest.approx(coefficients)
    assert found.covariance == pytest.approx(variance * np.linalg.inv(normal))


def test_gradient_fits_refuse_what_they_cannot_do():
    surface = noisy_surface()
    slopes = surface.gradient(surface.X)
    with pytest.raises(BadValue, match="one slope for each factor"):
        fit_with_gradients(surface.X, surface.y, slopes[:, :1], surface.terms, sd=(1, [1]))
    found = fit_with_gradients(surface.X, surface.y, slopes, surface.terms, sd=(1, [1, 1]))
    for refuse in (anova, diagnose, lambda s: without(s, s.terms[0])):
        with pytest.raises(BadValue, match="slopes"):
            refuse(found)


# ---------------------------------------------------------------- diagnostics


def test_diagnostics_equal_refits_without_each_run():
    surface = noisy_surface()
    found, analysis = diagnose(surface), anova(surface)
    rows, press = terms.matrix(surface.terms, surface.X), 0.0
    for run in range(len(surface.y)):
        rest = np.arange(len(surface.y)) != run
        if np.linalg.matrix_rank(rows[rest]) < rows.shape[1]:
            continue
        other = fit_surface(surface.X[rest], surface.y[rest], surface.terms)
        missed = float(surface.y[run] - other(surface.X[run : run + 1])[0])
        press += missed**2
        run_sd = np.sqrt(other.variance * (1 + other.leverage(surface.X[run])))
        deleted = missed / run_sd
        assert found.studentised[run] == pytest.approx(deleted)
        moved = other(surface.X) - surface(surface.X)
        cook = moved @ moved / (rows.shape[1] * surface.variance)
        assert found.cooks_distance[run] == pytest.approx(cook)
    assert analysis.press.value == pytest.approx(press)
    total = np.sum((surface.y - surface.y.mean()) ** 2)
    assert analysis.predicted_r2.value == pytest.approx(1 - press / total)


def test_an_outlier_is_beyond_the_limit():
    surface = noisy_surface()
    assert np.abs(diagnose(surface).studentised).max() < diagnose(surface).outlier_limit
    spoilt = surface.y + 6 * (np.arange(len(surface.y)) == 9)
    found = diagnose(fit_surface(surface.X, spoilt, surface.terms))
    assert np.argmax(np.abs(found.studentised)) == 9
    assert np.abs(found.studentised[9]) > found.outlier_limit


def test_normal_quantiles_follow_the_ranks():
    found = diagnose(noisy_surface())
    order = np.argsort(found.studentised)
    assert np.all(np.diff(found.normal_quantile[order]) > 0)
    assert found.normal_quantile.sum() == pytest.approx(0, abs=1e-12)


def test_box_cox_equals_scipys_for_a_mean():
    y = np.exp(np.random.default_rng(6).normal(1.0, 0.8, size=60))
    _, best, interval = stats.boxcox(y, alpha=0.05)
    found = box_cox(fit_surface(np.zeros((60, 1)), y, ()))
    assert found.best == pytest.approx(best, abs=1e-4)
    assert found.interval == pytest.approx(interval, abs=1e-4)


@pytest.mark.parametrize(("power", "inverse"), [(0.0, np.exp), (-1.0, lambda z: 1 / z)])
def test_box_cox_finds_the_power_that_makes_a_surface_linear(power, inverse):
    X = grid(np.linspace(-1, 1, 4))
    noise = 0.02 * np.random.default_rng(7).normal(size=len(X))
    y = inverse(3 + X @ [0.8, 0.5] + noise)
    found = box_cox(fit_surface(X, y, terms.linear(2)))
    assert found.interval[0] < power < found.interval[1]
    with pytest.raises(BadValue, match="not positive"):
        box_cox(fit_surface(X, y - 100, terms.linear(2)))


@pytest.mark.parametrize("slope", [0.0, 2.0])
def test_a_response_without_scatter_has_no_box_cox_profile(slope):
    """One that no factor changes, and one that the terms give exactly."""
    X = np.linspace(-1, 1, 7)[:, None]
    surface = fit_surface(X, 213.037143 + slope * X[:, 0], terms.quadratic(1))
    assert "exactly" in without_profile(surface)
    with pytest.raises(BadValue, match="exactly"):
        box_cox(surface)


def test_box_cox_powers_join_smoothly_at_zero():
    y = np.array([0.5, 1.0, 3.0, 8.0])
    near, at = (np.ptp(transformed(y, power)) for power in (1e-6, 0.0))
    assert near == pytest.approx(at, rel=1e-5)
    mean = np.exp(np.mean(np.log(y)))
    assert transformed(y, 2.0) == pytest.approx((y**2 - 1) / (2 * mean))
