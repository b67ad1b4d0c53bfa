"""Every rounding in `jdem.core.smooth`: exact outside its width, smooth and finite inside it.

Each docstring's statement about the kink (value and slope) is checked as it stands.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jdem.core import smooth
from jdem.core.elementary import cube_root, logarithm
from jdem.core.vector import Vector

pytestmark = pytest.mark.thorough

WIDTHS = [1e-9, 0.02, 0.5, 3.0]
ALL_WIDTHS = [0.0, *WIDTHS]
GRID = np.sort(np.concatenate([np.linspace(-4.0, 4.0, 161), [-1e-12, 1e-12, -1e-30, 1e-30]]))
ROUND_OFF = 16 * np.finfo(np.float64).eps  # a handful of additions of numbers up to 4


def maximum(x, width):
    return smooth.maximum(x, 0.7, width)


def minimum(x, width):
    return smooth.minimum(x, 0.7, width)


# name: (rounded function of x and width, sharp function of x, kinks)
ROUNDED = {
    "ramp": (jax.jit(smooth.ramp), lambda x: np.maximum(x, 0.0), [0.0]),
    "maximum": (jax.jit(maximum), lambda x: np.maximum(x, 0.7), [0.7]),
    "minimum": (jax.jit(minimum), lambda x: np.minimum(x, 0.7), [0.7]),
    "absolute": (jax.jit(smooth.absolute), np.abs, [0.0]),
    "saturate": (jax.jit(smooth.saturate), lambda x: np.minimum(x, 1.0), [1.0]),
    "step": (jax.jit(smooth.step), lambda x: np.where(x > 0, 1.0, 0.0), [0.0]),
    "saturate_slope": (jax.jit(smooth.saturate_slope), lambda x: np.where(x < 1, 1.0, 0.0), [1.0]),
}
# name: (kink, value at the kink, slope there) as functions of the width, from the docstrings
AT_KINK = {
    "ramp": (0.0, lambda w: w / 4, 0.5),
    "maximum": (0.7, lambda w: 0.7 + w / 4, 0.5),
    "minimum": (0.7, lambda w: 0.7 - w / 4, 0.5),
    "absolute": (0.0, lambda w: w / 2, 0.0),
    "saturate": (1.0, lambda w: 1 - w / 4, 0.5),
}

numbers = st.floats(-4.0, 4.0)
widths = st.one_of(st.just(0.0), st.floats(1e-9, 3.0))


@partial(jax.jit, static_argnums=(0, 3))
def slopes(function, x, width, argument=0):
    return jax.vmap(jax.grad(function, argument), (0, None))(jnp.asarray(x), width)


@pytest.mark.parametrize("name", AT_KINK)
@pytest.mark.parametrize("width", WIDTHS)
def test_value_and_slope_at_the_kink_are_as_stated(name, width):
    function = ROUNDED[name][0]
    kink, value, slope = AT_KINK[name]
    assert abs(function(kink, width) - value(width)) < ROUND_OFF
    assert abs(jax.jit(jax.grad(function))(kink, width) - slope) < ROUND_OFF / width


@pytest.mark.parametrize("function", [smooth.maximum, smooth.minimum])
@pytest.mark.parametrize("width", ALL_WIDTHS)
def test_at_the_kink_both_arguments_share_the_slope(function, width):
    assert jax.grad(function, (0, 1))(0.3, 0.3, width) == (0.5, 0.5)


@pytest.mark.parametrize("name", ROUNDED)
@pytest.mark.parametrize("width", WIDTHS)
def test_equals_the_sharp_function_outside_the_width(name, width):
    function, sharp, (kink,) = ROUNDED[name]
    outside = np.abs(GRID - kink) >= width * (1 + ROUND_OFF)
    assert np.abs(function(GRID, width) - sharp(GRID))[outside].max() < ROUND_OFF


@pytest.mark.parametrize("name", ROUNDED)
def test_width_zero_is_the_sharp_function(name):
    function, sharp, _ = ROUNDED[name]
    assert np.abs(function(GRID, 0.0) - sharp(GRID)).max() < ROUND_OFF


@pytest.mark.parametrize("name", AT_KINK)
@pytest.mark.parametrize("width", WIDTHS)
def test_stays_within_half_a_width_of_the_sharp_function(name, width):
    """So the function tends to the sharp one, everywhere at once, as the width does to 0."""
    function, sharp, _ = ROUNDED[name]
    assert np.abs(function(GRID, width) - sharp(GRID)).max() <= width / 2 + ROUND_OFF


@pytest.mark.parametrize("name", ROUNDED)
@pytest.mark.parametrize("width", ALL_WIDTHS)
def test_values_and_gradients_are_finite_everywhere(name, width):
    function, _, kinks = ROUNDED[name]
    x = jnp.asarray(np.concatenate([GRID, kinks, [width, -width, 1 + width, 1 - width]]))
    for argument in (0, 1):
        assert np.isfinite(slopes(function, x, width, argument)).all()
    assert np.isfinite(function(x, width)).all()


@pytest.mark.parametrize("name", [*AT_KINK, "step"])
@pytest.mark.parametrize("width", [0.02, 0.5, 3.0])
def test_slope_is_continuous(name, width):
    """The curvature is at most 1/width (6/width^2 in `step`): neighbours' slopes show it."""
    function, _, (kink,) = ROUNDED[name]
    x = kink + np.linspace(-1.5 * width, 1.5 * width, 3001)
    curvature = np.abs(np.diff(slopes(function, x, width))) / np.diff(x)
    assert curvature.max() < (6 / width**2 if name == "step" else 1 / width) * (1 + 1e-9)


@given(a=numbers, b=numbers, width=widths)
def test_maximum_and_minimum_mirror_each_other(a, b, width):
    assert abs(smooth.maximum(a, b, width) + smooth.minimum(-a, -b, width)) < ROUND_OFF
    assert abs(smooth.maximum(a, b, width) - smooth.maximum(b, a, width)) < ROUND_OFF
    assert smooth.maximum(a, b, width) >= max(a, b) - ROUND_OFF


@pytest.mark.parametrize("width", WIDTHS)
def test_step_runs_from_0_to_1_with_slope_0_at_both_ends(width):
    assert smooth.step(0.0, width) == 0.0
    assert smooth.step(width, width) == 1.0
    assert abs(smooth.step(0.5 * width, width) - 0.5) < ROUND_OFF
    assert np.array_equal(slopes(smooth.step, np.array([0.0, width]), width), [0.0, 0.0])


@pytest.mark.parametrize("width", WIDTHS)
def test_saturate_reaches_1_with_slope_0(width):
    assert abs(smooth.saturate(1 + width, width) - 1) < ROUND_OFF
    assert abs(jax.grad(smooth.saturate)(1 + width, width)) < ROUND_OFF / width


@pytest.mark.parametrize("width", ALL_WIDTHS)
def test_saturate_slope_is_the_derivative_of_saturate(width):
    s = GRID[(GRID >= 0) & (GRID != 1.0)]
    error = np.abs(smooth.saturate_slope(s, width) - slopes(smooth.saturate, s, width))
    assert error.max() < ROUND_OFF / min(width or 1.0, 1.0)  # of s, in units of the width


def test_divide_is_zero_with_zero_gradient_where_the_denominator_is_zero():
    assert smooth.divide(3.0, 0.0) == 0.0
    assert jax.grad(smooth.divide, (0, 1))(3.0, 0.0) == (0.0, 0.0)
    assert smooth.divide(3.0, -2.0) == -1.5
    assert jax.grad(smooth.divide, (0, 1))(3.0, -2.0) == (-0.5, -0.75)


def test_norm_has_zero_gradient_at_zero_and_a_unit_one_elsewhere():
    zero = Vector(0.0, 0.0, 0.0)
    gradient = jax.grad(smooth.norm)
    assert smooth.norm(zero) == 0.0
    assert np.array_equal(gradient(zero).stack(), [0.0, 0.0, 0.0])
    assert abs(smooth.norm(Vector(2.0, -3.0, 6.0)) - 7) < ROUND_OFF
    expected = np.array([2, -3, 6]) / 7
    assert np.abs(gradient(Vector(2.0, -3.0, 6.0)).stack() - expected).max() < ROUND_OFF


FLOOR = 1e-3
EXPONENTS = [0.5, 1.0, 2.0, 5.0]


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_power_is_the_power_above_its_floor_and_the_chord_below(exponent):
    above = np.geomspace(FLOOR, 3.0, 50)
    below = np.linspace(0.0, FLOOR, 50)
    chord = below * FLOOR ** (exponent - 1)
    assert np.allclose(smooth.power(above, exponent, FLOOR), above**exponent, rtol=1e-13)
    assert np.allclose(smooth.power(below, exponent, FLOOR), chord, rtol=1e-13)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_power_has_the_chords_finite_slope_at_zero(exponent):
    slope = jax.grad(smooth.power)(0.0, exponent, FLOOR)
    assert slope == pytest.approx(FLOOR ** (exponent - 1), rel=1e-12)


@given(base=st.floats(0.0, 5.0), exponent=st.floats(0.5, 5.0))
def test_power_has_finite_gradients(base, exponent):
    assert np.isfinite(jax.grad(smooth.power, (0, 1))(base, exponent, FLOOR)).all()


def test_the_logarithm_is_the_logarithm():
    x = 10.0 ** np.random.default_rng(0).uniform(-300, 300, 100_000)
    near = 1 + np.linspace(-0.5, 0.5, 10_001)
    for values in (x, near, np.array([0.5, 1.0, 2.0, np.sqrt(0.5), np.sqrt(2.0)])):
        exact = np.log(values)
        error = np.abs(np.asarray(jax.jit(logarithm)(jnp.asarray(values))) - exact)
        assert np.all(error <= 4e-16 * np.maximum(np.abs(exact), 1.0))
    slope = jax.jvp(logarithm, (jnp.asarray(near),), (jnp.ones(near.size),))[1]
    np.testing.assert_allclose(slope, 1 / near, rtol=1e-15)
    assert np.isnan(np.asarray(logarithm(jnp.asarray([np.nan, np.inf])))).all()
    single = logarithm(jnp.asarray([0.1, 3.0], jnp.float32))
    np.testing.assert_array_equal(single, jnp.log(jnp.asarray([0.1, 3.0], jnp.float32)))


def test_the_cube_root_is_right_to_the_last_digits():
    values = 10 ** np.random.default_rng(2).uniform(-30, 30, 1000)
    found = cube_root(jnp.asarray(values))
    np.testing.assert_allclose(found, np.cbrt(values), rtol=1e-15)
    slope = jax.vmap(jax.grad(cube_root))(jnp.asarray(values))
    np.testing.assert_allclose(slope, np.cbrt(values) / (3 * values), rtol=1e-14)
