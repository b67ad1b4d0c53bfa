"""Runs of confined and unconfined compression, made by hand."""

import numpy as np

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
