"""Mean and band of several curves, also of curves that turn back."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from calibrate.figures.panels import BANDED, FRESH, _band, _resampled
from calibrate.records.base import Curve


def there_and_back(top=8.0, force=400.0):
    """A straight line up to `top` (mm) and a steeper one back to half of it."""
    travel = np.concatenate([np.linspace(0, top, 50), np.linspace(top, top / 2, 30)[1:]])
    load = np.concatenate([np.linspace(0, force, 50), np.linspace(force, 0, 30)[1:]])
    return Curve(displacement_mm=travel.tolist(), force_n=load.tolist())


def drawn(curves):
    figure, axis = plt.subplots()
    _band(axis, curves, FRESH)
    (line,), (patch,) = axis.lines, axis.patches
    plt.close(figure)
    return line.get_xydata(), patch.get_xy()


def test_a_curve_is_read_at_equal_shares_of_its_way():
    found = _resampled(there_and_back(), points=13)
    assert np.abs(np.diff(found[:, 0])) == pytest.approx(np.full(12, 1.0))
    assert found[8] == pytest.approx([8.0, 400.0])


def test_equal_curves_have_themselves_as_mean_and_no_band():
    mean, band = drawn([there_and_back()] * BANDED)
    assert mean[:, 1].max() == pytest.approx(400.0, rel=0.01)
    assert band[: len(mean)] == pytest.approx(mean, abs=1e-9)


def test_the_band_is_as_wide_as_the_scatter():
    """Forces of 0.9 and 1.1 times the mean: halfway up, at 200 N, the deviation is 20 N times
    sqrt(6/5); measured across a slope of 45 degrees, in units of the axes, it is 0.71 of that."""
    curves = [there_and_back(force=400 * f) for f in (0.9, 1.1) * (BANDED // 2)]
    mean, band = drawn(curves)
    half = int(np.argmin(np.abs(mean[:80, 1] - 200)))
    offset = (band[half] - mean[half]) / np.ptp(mean, axis=0)
    assert np.linalg.norm(offset) == pytest.approx(20 * 1.095 / 400 * 0.71, rel=0.1)
