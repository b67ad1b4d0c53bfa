"""Runs of confined and unconfined compression, made by hand, and labs that do both."""

from dataclasses import replace

import numpy as np

from calibrate.io.lab import Lab
from calibrate.simulation.run import Run


def two_tests(
    depth: float,
    force: float,
    confined: np.ndarray,
    crushing: np.ndarray,
    quality: dict[str, float],
    failure: str = "",
) -> Run:
    """A run with these observables (mm, N), curves (points, 2) and checks."""
    observables = {"depression_depth_mm": depth, "crushing_force_n": force}
    return Run(observables, {"confined": confined, "unconfined": crushing}, quality, failure)


def pressed_lightly(lab: Lab, height: float = 0.05) -> Lab:
    """The lab with a specimen of this height (m), pressed with 50 N."""
    compression = lab.tests[0].model_copy(update={"force_low": 25.0, "force_high": 50.0})
    return replace(
        lab,
        specimen=replace(lab.specimen, height=height),
        tests=(compression, *lab.tests[1:]),
    )
