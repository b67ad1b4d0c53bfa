"""Further tests that a laboratory can make, with what each explanation predicts for them.

Checks of the machine follow from the effects' own equations; repeats of the two tests under
other conditions from the slopes that a bank has.  Costs are hours of a laboratory technician,
a guess that `calibrate diagnose` prints beside each test.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np

from calibrate.discrepancy.comparison.features import CONFINED, UNCONFINED, tests_of
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.next_test import FurtherTest
from calibrate.discrepancy.comparison.noise import Noise
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
    tests = set(tests_of(d.features))
    both = [_block(d), _weight_and_empty_run(d), _hold(d)]
    confined = [
        _again(d, noise, CONFINED, "confined test in a freshly greased mould", 3.0, _greased),
        _again(d, noise, CONFINED, "confined test at a tenth of the speed", 2.0, _slowly),
    ]
    unconfined = [
        _again(d, noise, UNCONFINED, "crushing between lubricated platens", 3.0, _lubricated),
        _again(d, noise, UNCONFINED, "crushing ten times as fast", 2.0, _faster),
        _again(d, noise, UNCONFINED, "crushing a sealed specimen at once", 3.0, _fresh),
    ]
    return (
        both + (confined if CONFINED in tests else []) + (unconfined if UNCONFINED in tests else [])
    )


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


def _again(
    d: Linearised, noise: Noise, test: str, name: str, cost: float,
    change: Callable[[Linearised, np.ndarray], np.ndarray],
) -> FurtherTest:  # fmt: skip
    """One of the two tests repeated on fresh specimens; `change` gives the effects' slopes."""
    mine = np.flatnonzero(tests_of(d.features) == test)
    slopes = change(d, d.effect_slopes.copy())[mine]
    labels = tuple(d.features[i].name for i in mine)
    covariance = noise.specimen[np.ix_(mine, mine)]
    return FurtherTest(
        name, cost, labels, d.mean[mine], d.base_slopes[mine], slopes, covariance, REPEATS
    )


def _without(name: str) -> Callable[[Linearised, np.ndarray], np.ndarray]:
    def change(d: Linearised, slopes: np.ndarray) -> np.ndarray:
        if name in d.effect_names:
            slopes[:, d.effect_names.index(name)] = 0.0
        return slopes

    return change


_greased = _without("wall_friction")
_lubricated = _without("platen_friction")
_fresh = _without("second_test_factor")


def _slowly(d: Linearised, slopes: np.ndarray) -> np.ndarray:
    """A tenth of the speed: a tenth of the lag's travel, one decade of rate."""
    if "acquisition_lag" in d.effect_names:
        slopes[:, d.effect_names.index("acquisition_lag")] *= 0.1
    return _decades(d, slopes, -1.0)


def _faster(d: Linearised, slopes: np.ndarray) -> np.ndarray:
    """Ten times as fast: a tenth of the drift, one decade of rate back."""
    if "load_cell_drift" in d.effect_names:
        slopes[:, d.effect_names.index("load_cell_drift")] *= 0.1
    return _decades(d, slopes, 1.0)


def _decades(d: Linearised, slopes: np.ndarray, count: float) -> np.ndarray:
    """Adds what rate dependence does over decades of rate: contact forces times exp(rho count)."""
    if "rate_dependence" in d.effect_names:
        k = d.effect_names.index("rate_dependence")
        forces = [d.base_names.index(n) for n in ("shear_modulus", "surface_energy")]
        slopes[:, k] += count * d.effects[k].typical * d.base_slopes[:, forces].sum(axis=1)
    return slopes
