"""Strategies on responses whose slopes are known, and the audit's judgement.

A response has curvature, interactions, a level and a slope of its own on each packing, and
where a test says so noise: what a bed of spheres has, without a bed of spheres.
"""

import inspect
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array
from pydantic import TypeAdapter

import calibrate
from calibrate.figures.audit import MARKS
from calibrate.inference.audit import STRATEGIES, Audit, verdict
from calibrate.inference.curve_points import POINTS, CurvePoints, CurveReading
from calibrate.inference.evaluation import Evaluation
from calibrate.inference.parameters import ALONE, FACTORS, fitting_groups, probing_groups, space
from calibrate.inference.slopes import secant
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.composite import names
from calibrate.records.audit import StrategyName
from calibrate.verbs import audit as audit_verb
from jdem.observables import Curve
from jdem.sensitivity.base import Sensitivity
from jdem.sensitivity.composite import Blend, blended
from jdem.sensitivity.ensemble import Ensemble
from jdem.sensitivity.pathwise import Pathwise
from jdem.sensitivity.regression import Regression
from tests.support.formulas import two_tests

pytestmark = pytest.mark.thorough

PACKINGS, PARAMETERS = 5, 7
RNG = np.random.default_rng(7)
LEVEL = jnp.asarray(RNG.normal(size=(PACKINGS, 2)))
SLOPE = RNG.normal(size=(2, PARAMETERS))
BEND = RNG.normal(size=(2, PARAMETERS, PARAMETERS))
POINT = jnp.asarray(RNG.normal(size=PARAMETERS))


GROUPED = Ensemble(0.2, ((0, 3, 6), (1, 4), (2, 5)))


@jax.jit
def quadratic(points: Array) -> Array:
    """Values (k, n, 2) of a full quadratic around POINT, at another level on each packing."""
    x = points - POINT
    bent = jnp.einsum("knp,mpq,knq->knm", x, BEND, x)
    return LEVEL[None] + jnp.einsum("mp,knp->knm", SLOPE, x) + bent


def noisy(amplitude, seed=0):
    """The quadratic with noise that is fresh at every point."""
    rng = np.random.default_rng(seed)

    def response(points: Array) -> Array:
        values = quadratic(points)
        return values + amplitude * rng.normal(size=values.shape)

    return response


@pytest.mark.parametrize(
    "strategy",
    [Pathwise(), Regression((0.1, 0.2)), Ensemble(), GROUPED, Ensemble(0.3, pairs=4), Blend()],
)
def test_slopes_of_a_quadratic_are_exact(strategy):
    """Curvature and interactions of two parameters leave no trace in antithetic steps."""
    found = strategy(quadratic, POINT, PACKINGS)
    assert np.abs(np.asarray(found.slopes) - SLOPE).max() < 1e-12
    assert np.abs(np.asarray(found.values) - LEVEL).max() < 1e-12


@pytest.mark.parametrize("strategy", [Regression((0.2,)), Ensemble(), GROUPED])
def test_a_strategy_costs_the_runs_that_it_says(strategy):
    asked = []

    def counted(points):
        asked.append(points.shape)
        return quadratic(points)

    strategy(counted, POINT, PACKINGS)
    assert sum(shape[0] for shape in asked) == strategy.runs(PARAMETERS, PACKINGS)
    assert all(shape[1:] == (PACKINGS, PARAMETERS) for shape in asked)


def test_seven_slopes_cost_six_forward_runs():
    """The bound that the project set itself: all factors, the value at the point apart."""
    for free in (FACTORS, (*FACTORS, "shear_modulus")):
        strategy = Ensemble(0.2, probing_groups(free))
        for packings in (3, 4, 8):
            assert strategy.runs(len(free), packings) - 1 <= 6


@pytest.mark.parametrize("grouped", [probing_groups, fitting_groups])
def test_groups_keep_what_matters_apart(grouped):
    """Each of the four parameters that matter most to force has a partner that does not."""
    names = (*FACTORS, "shear_modulus")
    groups = [{names[i] for i in group} for group in grouped(names)]
    assert sum(len(group) for group in groups) == len(names) == len(set().union(*groups))
    for one, other in (
        ("shear_modulus", "plasticity_ratio"),
        ("shear_modulus", "rolling_friction"),
        ("shear_modulus", "tangential_multiplier"),
        ("plasticity_ratio", "surface_energy"),
        ("plasticity_ratio", "rolling_friction"),
    ):
        assert not any({one, other} <= group for group in groups)


def test_a_fit_moves_unconfirmed_parameters_alone_and_nothing_else():
    names = (*FACTORS, "shear_modulus")
    groups = [{names[i] for i in group} for group in fitting_groups(names)]
    alone = {name for group in groups if len(group) == 1 for name in group}
    assert {name for name in names if name in ALONE} <= alone
    assert fitting_groups(ALONE) == tuple((i,) for i in range(len(ALONE)))
    sure = tuple(name for name in names if name not in ALONE)
    assert fitting_groups(sure) == probing_groups(sure)


def test_alone_is_the_reference_of_the_audit():
    """The same runs, so the same slope: what a fit relies on where the groups were not enough."""
    alone = Ensemble(0.2, tuple((i,) for i in range(PARAMETERS)))(quadratic, POINT, PACKINGS)
    reference = Regression((0.2,))(quadratic, POINT, PACKINGS)
    assert np.allclose(alone.slopes, reference.slopes, rtol=1e-12)


def test_a_slope_does_not_feel_other_groups():
    """Third orders and packings' own slopes leak within a group only."""

    def rough(points: Array) -> Array:
        x = points - POINT
        own = jnp.arange(PACKINGS)[None, :, None] * x[..., 3:4]  # a slope of each packing's own
        return quadratic(points) + own + x[..., :1] * x[..., 3:4] ** 2

    together = Ensemble()(rough, POINT, PACKINGS)
    apart = Ensemble(0.2, ((0, 1, 2), (3, 4), (5, 6)))(rough, POINT, PACKINGS)
    assert np.abs(np.asarray(together.slopes - SLOPE))[:, 0].max() > 0.03
    assert np.abs(np.asarray(apart.slopes - SLOPE))[:, :3].max() < 1e-12


@pytest.mark.parametrize("strategy", [Regression((0.2,)), GROUPED, Ensemble(0.2, pairs=3)])
def test_standard_errors_are_honest(strategy):
    """Over 200 repetitions the slopes scatter by what the standard errors say, within 15 %."""
    repeated = [strategy(noisy(0.3, seed), POINT, PACKINGS) for seed in range(200)]
    scatter = np.std([np.asarray(found.slopes) for found in repeated], axis=0)
    claimed = np.sqrt(np.mean([np.asarray(f.standard_error) ** 2 for f in repeated], axis=0))
    assert np.abs(np.mean(scatter) / np.mean(claimed) - 1) < 0.15


def test_steps_of_its_own_for_each_parameter():
    """Short in a parameter on which the response bends to third order, bias goes with s^2."""

    def bent(points: Array) -> Array:
        x = points - POINT
        third = x[..., :1] * x[..., 1:2] ** 2  # biases slope 0 by the square of step 1
        return quadratic(points) - 10 + third

    def bias(step):
        steps = (0.2, step, *[0.2] * (PARAMETERS - 2))
        found = Ensemble(steps, pairs=4)(bent, POINT, PACKINGS)
        return np.asarray(found.slopes - SLOPE)[:, 0]

    assert bias(0.2) == pytest.approx([0.04, 0.04])
    assert bias(0.05) == pytest.approx([0.0025, 0.0025])


def read_at(force_step, travel_step):
    """Points of the confined curve (N), and of the unconfined one (mm)."""
    pairs = (("confined", "depression_depth"), ("unconfined", "crushing_force"))
    steps = np.arange(1, POINTS + 1)
    loading = CurveReading("confined", "force_n", force_step * steps)
    crushing = CurveReading("unconfined", "displacement_mm", travel_step * steps)
    return CurvePoints(names(pairs), (loading, crushing))


def test_curves_are_read_where_the_audit_says():
    """Displacement at a force counts from the highest force so far; failed runs are NaN."""
    travel = np.linspace(0, 4, 81)
    confined = np.column_stack([travel, np.concatenate([100 * travel[:-1], [0.0]])])
    unconfined = np.column_stack([travel, 5 * travel])
    run = two_tests(2.0, 20.0, confined, unconfined, {})
    points = read_at(10.0, 0.1)
    loading, crushing = (reading.points for reading in points.readings)
    read = points.read(run)
    assert read[:2].tolist() == [2.0, 20.0]
    assert read[points.slices()["confined"]] == pytest.approx(loading / 100)
    assert read[points.slices()["unconfined"]] == pytest.approx(5 * crushing)
    failed = two_tests(2.0, 20.0, confined, unconfined, {}, "the soil is too soft")
    assert np.all(np.isnan(points.read(failed)))


def test_a_traced_run_is_read_like_a_stored_one():
    """Masked rows before and after a curve do not count."""
    travel, force = np.linspace(0, 4, 81), 100 * np.sin(np.linspace(0, 2, 81))
    table = np.column_stack([travel, force])
    kept = two_tests(2.0, 20.0, table, table, {})
    valid = np.concatenate([np.zeros(7), np.ones(81), np.zeros(5)])
    padded = [np.pad(part, (7, 5)) for part in (1e-3 * travel, force)]
    curve = Curve(*map(jnp.asarray, (*padded, valid)))
    observables = {
        "confined": {"depression_depth": jnp.asarray(2e-3)},
        "unconfined": {"crushing_force": jnp.asarray(20.0)},
    }
    curves = {"confined": curve, "unconfined": curve}
    traced: Any = SimpleNamespace(curves=curves, observables=observables)
    points = read_at(4.0, 0.2)
    np.testing.assert_allclose(points.traced(traced), points.read(kept), rtol=1e-12)


def test_every_strategy_is_made_named_recorded_and_drawn():
    free = space(load_lab(bundled_lab()), FACTORS)
    assert all(each.constructor(free).describe() for each in STRATEGIES.values())
    assert set(STRATEGIES) == set(MARKS)
    recorded = TypeAdapter(StrategyName)
    assert [recorded.validate_python(name) for name in STRATEGIES] == list(STRATEGIES)
    with pytest.raises(ValueError, match="should be 'fit', 'response'"):
        recorded.validate_python("reference")
    stated = inspect.unwrap(audit_verb.audit).__annotations__["strategies"]
    (option,) = (each for each in stated.__metadata__ if hasattr(each, "help"))
    offered, _, _ = re.sub(r" \(.*?\)", "", option.help).partition(";")
    assert offered.split(", ") == list(STRATEGIES)
    page = (Path(calibrate.__file__).parents[1] / "docs/derivatives.md").read_text(encoding="utf-8")
    for name, each in STRATEGIES.items():
        assert f"| `{name}` | {each.doc} |" in page


def test_a_blend_stands_below_its_parts():
    names = list(STRATEGIES)
    for name, each in STRATEGIES.items():
        if each.blend_of:
            assert not STRATEGIES[each.blend_of].simulated
            assert max(map(names.index, (each.blend_of, "ensemble"))) < names.index(name)


def test_the_ensemble_is_more_precise_than_one_at_a_time_at_lower_cost():
    one, many = Regression((0.2,)), Ensemble(0.2, pairs=3)
    assert many.runs(7, PACKINGS) < one.runs(7, PACKINGS)
    errors = [
        np.mean([np.abs(np.asarray(s(noisy(0.3, k), POINT, PACKINGS).slopes) - SLOPE).mean()
                 for k in range(60)])
        for s in (one, many)
    ]  # fmt: skip
    assert errors[1] < errors[0]


def test_a_failed_run_leaves_its_pair_out():
    def failing(points):
        return jnp.asarray(quadratic(points)).at[1, 0].set(jnp.nan)

    found = Ensemble(0.2, pairs=3)(failing, POINT, PACKINGS)
    assert np.abs(np.asarray(found.slopes) - SLOPE).max() < 1e-12


def test_too_many_failures_are_not_hidden():
    found = GROUPED(lambda points: jnp.nan * quadratic(points), POINT, PACKINGS)
    assert np.all(np.isnan(np.asarray(found.slopes)))


def sensitivity(slopes, error):
    slopes = jnp.asarray(slopes, float)
    return Sensitivity(jnp.zeros((1, 1)), slopes, jnp.full(slopes.shape, float(error)))


def test_a_blend_follows_the_precise_estimate_where_it_agrees():
    found = blended(sensitivity([[1.02]], 0.01), sensitivity([[1.2]], 0.3))
    assert float(found.slopes[0, 0]) == pytest.approx(1.02, abs=0.01)


def test_a_blend_leaves_a_biased_estimate():
    found = blended(sensitivity([[-9.0]], 0.01), sensitivity([[1.2]], 0.3))
    assert float(found.slopes[0, 0]) == pytest.approx(1.2, abs=0.02)


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_a_blend_ignores_what_is_not_finite(broken):
    found = blended(sensitivity([[broken]], 1.0), sensitivity([[1.2]], 0.3))
    assert float(found.slopes[0, 0]) == 1.2
    assert float(found.standard_error[0, 0]) == pytest.approx(0.3)


def audited(estimate):
    """Depth has slope 1.0 +- 0.1 and force 100 +- 60 in one parameter."""
    reference = Sensitivity(
        jnp.zeros((2, 2)), jnp.asarray([[1.0], [100.0]]), jnp.asarray([[0.1], [60.0]])
    )
    found = sensitivity([[estimate], [-50.0]], 0.01)
    return Audit(("surface_energy",), reference, {"ensemble": found}, {}, {}, 2, read_at(1.0, 1.0))


@pytest.mark.parametrize(("estimate", "passed"), [(1.14, True), (1.16, False), (-1.0, False)])
def test_an_audit_judges_what_can_be_judged(estimate, passed):
    depth, force = audited(estimate).rows("ensemble")
    assert depth["judged"] and depth["passed"] is passed
    assert not force["judged"] and force["passed"] is None
    assert verdict([depth, force]) is passed


def test_a_secant_correction_gives_what_was_seen():
    """Along the step the corrected slopes give the measured change, across it the old one."""
    before = Evaluation(np.array([1.0, 2.0]), np.array([[3.0, 1.0]]), np.zeros(1), ())
    after = Evaluation(np.array([1.2, 1.5]), np.array([[3.7, 0.4]]), np.zeros(1), ())
    slopes = np.array([[1.0, 0.0], [0.5, 2.0]])
    corrected = secant(slopes, before, after)
    step = np.log(after.values / before.values)
    across = np.array([-step[1], step[0]])
    assert corrected @ step == pytest.approx([0.7, -0.6])
    assert corrected @ across == pytest.approx(slopes @ across)
