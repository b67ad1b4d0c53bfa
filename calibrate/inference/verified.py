"""Tests that took no part in a fit, predicted from what the fit leaves of all parameters.

    ln p ~ N( ln fitted, (J' J + P^-1)^-1 )        of ALL candidates, free or not

J are the whitened slopes of the fit's features at its end, in every parameter that a fit may free,
P the priors' variances.  What the fit's tests say nothing of keeps its prior: another test may hang
on it, and an interval of the free parameters alone would promise too much.  Soils are drawn from
this normal distribution and simulated (`calibrate.inference.prediction`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calibrate.core.errors import COMMAND_LINE, InputError, shown, suggestion
from calibrate.inference.calibration import Calibrated
from calibrate.inference.identifiability import assess
from calibrate.inference.prediction import Prediction, by_runs
from calibrate.io.lab import Lab
from calibrate.labtests.composite import names_of
from calibrate.simulation.joint import AbstractCampaign
from jdem.materials.soil import SoilParameters

SOILS, PACKINGS = 8, 2  # that are drawn, and packings of its own on which each is simulated


def drawn_soils(done: Calibrated, count: int, seed: int) -> list[SoilParameters]:
    """Soils that the data of a fit leave possible, within their bounds."""
    screened = done.setup.screened()
    space, best = screened.space, done.result.best
    fitted = done.calibration.space.soil(best.values)
    middle = np.log([float(fitted.values()[name]) for name in space.names])
    slopes = screened.at(best.features.mean(axis=0))
    whitened = done.setup.calibration(space.names).whitened(slopes)
    left = assess(space.names, np.exp(middle), whitened, space.prior_sd(), 1)
    random = np.random.default_rng([seed, 5])
    rows = random.multivariate_normal(middle, left.covariance_log, count, method="eigh")
    return [space.soil(np.exp(row)) for row in space.inside(rows)]


def predicted(done: Calibrated, work: AbstractCampaign, first: int, seed: int) -> Prediction:
    """What the tests of `work` would show, on packings from number `first` on."""
    packings = range(first, first + PACKINGS * SOILS)
    return by_runs(work, drawn_soils(done, SOILS, seed), packings)


def parts(lab: Lab, tests: Sequence[str], verify: Sequence[str]) -> tuple[Lab, Lab | None]:
    """The lab of a fit and the one that it is verified on, None without any; tests by name, all
    that are not verified where none are named."""
    known = [test.called for test in lab.tests]
    for option, names in (("--tests", tests), ("--verify", verify)):
        for name in names:
            if name not in known:
                problem = f"no test is called {shown(name)}"
                raise InputError(COMMAND_LINE, option, problem, suggestion(name, known))
    if both := [name for name in tests if name in verify]:
        problem = f"{both[0]} is in both"
        raise InputError(COMMAND_LINE, "--verify", problem, "take it out of one of them")
    used = tests or [name for name in known if name not in verify]
    fitted = _of_tests(lab, used, "--tests")
    held_back = _of_tests(lab, verify, "--verify") if verify else None
    if held_back is not None:
        _check_moistures(fitted, held_back)
    return fitted, held_back


def _check_moistures(fitted: Lab, held_back: Lab) -> None:
    """Refuse tests at a moisture of which the fitted ones say nothing."""
    known = [name for values in fitted.differing().values() for name in values]
    for name in (name for values in held_back.differing().values() for name in values):
        if name not in known:
            problem = f"no fitted test says anything of {name}"
            raise InputError(COMMAND_LINE, "--verify", problem, "fit a test at this moisture too")


def _of_tests(lab: Lab, names: Sequence[str], option: str) -> Lab:
    """The tests of these names, with what was measured in them; tests before them on the same
    specimen stay too, with nothing measured.  `InputError` where nothing is measured."""
    kept = [test for test in lab.without_soil() if test.called in names]
    for each in lab.specimens():
        last = max((k for k, test in enumerate(each.tests) if test.called in names), default=-1)
        kept += each.tests[: last + 1]
    kept.sort(key=lab.tests.index)
    before, now = names_of(lab.tests), names_of(kept)
    called = {before[key][0]: now[key][0] for key in now if key[0] in names}
    targets = {called[name]: target for name, target in lab.targets.items() if name in called}
    curves = tuple(curve for curve in lab.curves if curve.test in names)
    if not (targets or curves):
        problem = f"nothing is measured in {' and '.join(names)}"
        raise InputError(lab.file, option, problem, "name a test with a target or a curve")
    return replace(lab, tests=tuple(kept), targets=targets, curves=curves)
