"""Further tests that a laboratory can make, with what each explanation predicts for them.

Checks of the machine follow from the effects' own equations; repeats of the two tests under
other conditions from the slopes that a library has.  Costs are hours of a laboratory technician,
a guess that `calibrate diagnose` prints beside each test.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np

from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.next_test import FurtherTest
from calibrate.discrepancy.comparison.noise import Noise
from calibrate.labtests.diagnosis.base import Variation
from calibrate.labtests.diagnosis.curves import TEST_FEATURES, TESTS, tests_of
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import EFFECTS

BLOCK_FORCES = (20.0, 50.0, 100.0, 200.0, 400.0)  # N
BLOCK_SD = 5e-3  # mm
FORCE_SD = 0.3  # N, of a mean of many readings
WEIGHT = 98.1  # N, of 10 kg
WAITING = 1200.0  # s, of an empty run
HOLD = 60.0  # s
HOLD_SD = 1.5  # N
DECADES_OF_A_HOLD = 2.7  # of the rate that the soil feels, from 8 mm/s to a minute of rest
REPEATS = 2
OF_NAME: Mapping[str, Callable[..., AbstractEffect]] = EFFECTS


def menu(d: Linearised, noise: Noise) -> list[FurtherTest]:
    """All further tests that apply to a description."""
    present = [test for test in TESTS if (tests_of(d.features) == test).any()]
    again = [_again(d, noise, t, v) for t in present for v in TEST_FEATURES[t].variations]
    return [_block(d), _weight_and_empty_run(d), _hold(d), *again]


def _machine(d: Linearised, name: str, cost: float, labels, columns, sd) -> FurtherTest:
    """A check of the machine: no soil, so nothing of the base parameters."""
    m = len(labels)
    slopes = np.zeros((m, len(d.effects)))
    for k, effect in enumerate(d.effects):
        if effect.name in columns:
            slopes[:, k] = columns[effect.name] * effect.typical
    return FurtherTest(
        name, cost, tuple(labels), np.zeros(m), np.zeros((m, len(d.base_names))), slopes,
        np.diag(np.broadcast_to(np.asarray(sd, float) ** 2, (m,))), REPEATS,
    )  # fmt: skip


def _block(d: Linearised) -> FurtherTest:
    force = jnp.asarray(BLOCK_FORCES)
    columns = {
        name: 1e3 * np.asarray(OF_NAME[name](1.0).travel_error(force))
        for name in ("load_frame_compliance", "seating_gap")
    }
    labels = [f"displacement at {f:g} N, mm" for f in BLOCK_FORCES]
    return _machine(d, "steel block in the machine", 1.0, labels, columns, BLOCK_SD)


def _weight_and_empty_run(d: Linearised) -> FurtherTest:
    columns = {
        "load_cell_gain": np.array([WEIGHT, 0.0, 0.0]),
        "load_cell_offset": np.array([0.0, 1.0, 1.0]),
        "load_cell_drift": np.array([0.0, 0.0, WAITING]),
    }
    labels = ["10 kg, N beyond 98.1", "nothing on the cell, N", "the same 20 min later, N"]
    return _machine(d, "10 kg on the load cell, and an empty run", 1.0, labels, columns, FORCE_SD)


def _hold(d: Linearised) -> FurtherTest:
    columns = {
        "rate_dependence": np.array([-400.0 * DECADES_OF_A_HOLD]),
        "load_cell_drift": np.array([HOLD]),
    }
    labels = ["change of force in a minute's hold at 400 N, N"]
    return _machine(d, "hold at 400 N for a minute", 1.0, labels, columns, HOLD_SD)


def _again(d: Linearised, noise: Noise, test: str, variation: Variation) -> FurtherTest:
    """A test repeated on fresh specimens under another condition."""
    mine = np.flatnonzero(tests_of(d.features) == test)
    labels = tuple(d.features[i].name for i in mine)
    covariance = noise.specimen[np.ix_(mine, mine)]
    return FurtherTest(
        variation.name, variation.cost, labels, d.mean[mine], d.base_slopes[mine],
        _varied(d, variation)[mine], covariance, REPEATS,
    )  # fmt: skip


def _varied(d: Linearised, variation: Variation) -> np.ndarray:
    """Slopes (m, k) of the effects under another condition; over decades of rate, rate dependence
    multiplies contact forces by exp(rho decades)."""
    slopes = d.effect_slopes.copy()
    for name, factor in variation.factors.items():
        if name in d.effect_names:
            k = d.effect_names.index(name)
            slopes[:, k] = factor * slopes[:, k] if factor else 0.0
    if variation.decades and "rate_dependence" in d.effect_names:
        k = d.effect_names.index("rate_dependence")
        forces = [d.base_names.index(n) for n in ("shear_modulus", "surface_energy")]
        per_decade = d.effects[k].typical * d.base_slopes[:, forces].sum(axis=1)
        slopes[:, k] += variation.decades * per_decade
    return slopes
