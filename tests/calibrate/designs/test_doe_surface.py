"""Response surfaces: terms, intervals, selection, slopes in the fit, residual diagnostics."""

import numpy as np
import pytest
from scipy import optimize, stats

from calibrate.core.errors import BadValue
from calibrate.designs import designs, terms
from calibrate.designs.anova import anova
from calibrate.designs.diagnostics import box_cox, diagnose, transformed, without_profile
from calibrate.designs.factors import Factor
from calibrate.designs.gradients import fit_with_gradients
from calibrate.designs.selection import aicc, select_backward, without
from calibrate.designs.surface import Surface, fit_surface
from calibrate.designs.terms import Term


def noisy_surface(seed: int = 0, sd: float = 0.3) -> Surface:
    design = designs.central_composite((Factor("A", 0, 1), Factor("B", 0, 1)))
    a, b = design.coded.T
    rng = np.random.default_rng(seed)
    y = 10 + 2 * a - b + 0.8 * a * b + 1.5 * a**2 + sd * rng.normal(size=len(a))
    return fit_surface(design.coded, y, terms.quadratic(2), design.names)


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


def test_intervals_are_those_of_statsmodels():
    surface = noisy_surface()
    x = np.array([[0.3, -0.2], [0, 0]])
    ours = surface.predict(x, level=0.9)
    theirs = surface.fit.get_prediction(terms.matrix(surface.terms, x)).summary_frame(alpha=0.1)
    assert ours.mean == pytest.approx(theirs["mean"].to_numpy())
    assert ours.mean_se == pytest.approx(theirs["mean_se"].to_numpy())
    both = theirs[["mean_ci_lower", "mean_ci_upper"]].to_numpy()
    assert ours.mean_interval == pytest.approx(both)
    assert ours.run_interval == pytest.approx(theirs[["obs_ci_lower", "obs_ci_upper"]].to_numpy())
    assert ours.df == 7


def test_prediction_of_several_runs_lies_between_a_run_and_the_mean():
    surface, x = noisy_surface(), np.zeros((1, 2))
    one, four, many = (surface.predict(x, runs=runs) for runs in (1, 4, 10**9))
    assert four.run_se**2 == pytest.approx(four.mean_se**2 + one.run_se**2 / 4 - one.mean_se**2 / 4)
    assert many.run_interval == pytest.approx(one.mean_interval)


def test_slopes_at_the_centre_are_the_linear_coefficients():
    surface = noisy_surface()
    slopes = surface.slopes(np.zeros(2))
    assert slopes.values == pytest.approx(surface.coefficients[1:3])
    assert slopes.se == pytest.approx(np.asarray(surface.fit.bse)[1:3])
    assert slopes.interval() == pytest.approx(np.asarray(surface.fit.conf_int())[1:3])
    elsewhere = surface.slopes(np.array([0.2, -0.4]))
    assert elsewhere.values == pytest.approx(surface.gradient(np.array([[0.2, -0.4]]))[0])


def test_weights_count_like_repeats():
    surface = noisy_surface()
    weights = np.where(np.arange(len(surface.y)) % 3 == 0, 3.0, 1.0)
    weighted = fit_surface(surface.X, surface.y, surface.terms, weights=weights)
    repeats = np.repeat(np.arange(len(surface.y)), weights.astype(int))
    repeated = fit_surface(surface.X[repeats], surface.y[repeats], surface.terms)
    assert weighted.coefficients == pytest.approx(repeated.coefficients)
    with pytest.raises(BadValue, match="weights"):
        anova(weighted)


def test_natural_units_that_double_precision_cannot_carry_are_refused():
    surface = noisy_surface()
    moduli = surface.X * [2e6, 0.2] + [7e6, 0.5]
    assert fit_surface(moduli, surface.y, terms.linear(2)).df == 10
    with pytest.raises(BadValue, match="coded units"):
        fit_surface(moduli * [1e3, 1.0], surface.y, surface.terms)


def test_points_that_cannot_fix_the_terms_are_refused():
    X = designs.full_factorial((Factor("A", 0, 1), Factor("B", 0, 1))).coded
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


@pytest.mark.parametrize("by", ["p", "aicc"])
def test_selection_finds_the_terms_that_are_there_and_their_parents(by):
    full = clean_surface("A + B*C")
    reduced, steps = select_backward(full, by=by)
    assert set(reduced.labels) == {"A", "B", "C", "B*C"}
    assert {step.dropped for step in steps} == set(full.labels) - set(reduced.labels)
    assert [step.residual_df for step in steps] == list(range(full.df + 1, reduced.df + 1))


def test_selection_keeps_what_it_is_told_to():
    full = clean_surface("A + B*C")
    kept = Term((2, 0, 0))
    assert kept in select_backward(full, keep=(kept,))[0].terms
    assert kept not in select_backward(full)[0].terms


def test_selection_needs_residual_degrees_of_freedom():
    X = designs.full_factorial((Factor("A", 0, 1), Factor("B", 0, 1))).coded
    both = terms.parse("A + B + A*B", ("A", "B"))
    with pytest.raises(BadValue, match="no residual"):
        select_backward(fit_surface(X, np.array([1.0, 2.0, 4.0, 9.0]), both))


def test_aicc_is_that_of_the_likelihood():
    surface = without(noisy_surface(), Term((0, 2)))
    n, k = len(surface.y), len(surface.terms) + 2
    likelihood = -2 * surface.fit.llf - n * np.log(2 * np.pi) - n
    assert aicc(surface) == pytest.approx(likelihood + 2 * k * n / (n - k - 1))


# ---------------------------------------------------------------- slopes in the fit


def test_gradients_fix_a_quadratic_with_fewer_points_than_coefficients():
    rng = np.random.default_rng(4)
    X = rng.uniform(-1, 1, (4, 3))
    truth = fit_surface(rng.uniform(-1, 1, (10, 3)), rng.normal(size=10), terms.quadratic(3))
    found = fit_with_gradients(X, truth(X), truth.gradient(X), truth.terms, sd=(1, [1, 1, 1]))
    assert found.surface.coefficients == pytest.approx(truth.coefficients, abs=1e-9)
    assert found.surface.df == 4 * 4 - 10


def test_gradients_that_are_missing_change_nothing():
    surface = noisy_surface()
    none = np.full(surface.X.shape, np.nan)
    found = fit_with_gradients(surface.X, surface.y, none, surface.terms, sd=(1, [1, 1]))
    assert found.surface.coefficients == pytest.approx(surface.coefficients)
    assert found.surface.covariance == pytest.approx(surface.covariance)
    assert found.surface.slope_rows == 0


def test_noise_of_values_and_slopes_is_estimated_and_halves_the_error():
    rng = np.random.default_rng(5)
    X = rng.uniform(-1, 1, (400, 2))
    truth = noisy_surface(sd=0.0)
    y = truth(X) + 0.5 * rng.normal(size=400)
    slopes = truth.gradient(X) + rng.normal(size=(400, 2)) * [0.2, 1.0]
    slopes[:100, 1] = np.nan
    found = fit_with_gradients(X, y, slopes, truth.terms)
    estimates = [found.value_sd, *found.slope_sd]
    assert estimates == pytest.approx([0.5, 0.2, 1.0], rel=0.12)  # 3 s.e. of an sd from 300
    plain = fit_surface(X, y, truth.terms)
    error = np.abs(found.surface.coefficients - truth.coefficients)
    assert np.all(error < 4 * np.sqrt(np.diag(found.surface.covariance)))
    assert np.diag(found.surface.covariance)[1] < np.diag(plain.covariance)[1] / 4
    assert found.surface.df == 400 + 400 + 300 - 6


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
    assert found.surface.coefficients == pytest.approx(coefficients)
    assert found.surface.covariance == pytest.approx(variance * np.linalg.inv(normal))
    assert found.value_sd == pytest.approx(np.sqrt(variance))
    assert found.slope_sd == pytest.approx(np.sqrt(variance) * np.array([0.5, 2.0]))


def test_estimated_noise_is_that_of_restricted_likelihood():
    surface = noisy_surface()
    slopes = noisy_slopes(surface)
    found = fit_with_gradients(surface.X, surface.y, slopes, surface.terms)
    rows, targets = stacked(surface, slopes)

    def minus_log_likelihood(log_sd: np.ndarray) -> float:
        weight = np.repeat(np.exp(-2 * log_sd), len(surface.y))
        normal = rows.T @ (weight[:, None] * rows)
        residual = targets - rows @ np.linalg.solve(normal, rows.T @ (weight * targets))
        squares = weight @ residual**2
        return float(squares - np.log(weight).sum() + np.linalg.slogdet(normal)[1]) / 2

    best = optimize.minimize(minus_log_likelihood, np.zeros(3), tol=1e-10).x
    assert [found.value_sd, *found.slope_sd] == pytest.approx(np.exp(best), rel=1e-4)


def test_gradient_fits_refuse_what_they_cannot_do():
    surface = noisy_surface()
    slopes = surface.gradient(surface.X)
    with pytest.raises(BadValue, match="one slope for each factor"):
        fit_with_gradients(surface.X, surface.y, slopes[:, :1], surface.terms)
    found = fit_with_gradients(surface.X, surface.y, slopes, surface.terms, sd=(1, [1, 1]))
    for refuse in (anova, diagnose, lambda s: without(s, s.terms[0])):
        with pytest.raises(BadValue, match="slopes"):
            refuse(found.surface)


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
        deleted = missed / other.predict(surface.X[run : run + 1]).run_se[0]
        assert found.studentised[run] == pytest.approx(deleted)
        moved = other(surface.X) - surface(surface.X)
        cook = moved @ moved / (rows.shape[1] * surface.variance)
        assert found.cooks_distance[run] == pytest.approx(cook)
    assert analysis.press.value == pytest.approx(press)
    total = np.sum((surface.y - surface.y.mean()) ** 2)
    assert analysis.predicted_r2.value == pytest.approx(1 - press / total)
    assert found.leverage.sum() == pytest.approx(6)


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
    X = designs.full_factorial((Factor("A", 0, 1), Factor("B", 0, 1)), 4).coded
    noise = 0.02 * np.random.default_rng(7).normal(size=len(X))
    y = inverse(3 + X @ [0.8, 0.5] + noise)
    found = box_cox(fit_surface(X, y, terms.linear(2)))
    assert found.interval[0] < power < found.interval[1]
    assert found.suggestion == power
    with pytest.raises(BadValue, match="not positive"):
        box_cox(fit_surface(X, y - 100, terms.linear(2)))


@pytest.mark.parametrize("slope", [0.0, 2.0])
def test_a_response_without_scatter_has_no_box_cox_profile(slope):
    """One that no factor changes, and one that the terms give exactly."""
    X = designs.full_factorial((Factor("A", 0, 1),), 7).coded
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
