"""A gap of no particular cause, the hypothesis "unknown": Gaussian processes along the tests.

    smooth   d ~ N(0, c^2 D K D)    K = exp(-(x - x')^2 / 2 l^2) within a test, 0 between tests
    rough    d ~ N(0, c^2 I)        in the projected space: shaped as the noise, and as what
                                    the base parameters leave open

x is the location along the test, D the scatter of one specimen, c an amplitude in that unit; for
the rough one, in that of the smallest scale of the noise that `evidence` integrates over.  It keeps
an effect from being named for a gap so large that no part of it fits.  Discrepancies enter in the
projected space only, so that they cannot compete with the base parameters (Plumlee 2017, Bayesian
calibration of inexact computer models).  Kernels over both tests and over either alone, with two
lengths l, and the rough one share the weight equally.  A kernel is kept as a factor (m, r) with
K = F F', which drops what is below a thousandth of its variance.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from calibrate.discrepancy.comparison.projection import leading_modes
from calibrate.labtests.diagnosis.base import Feature
from calibrate.labtests.diagnosis.curves import tests_of

LENGTHS = (0.08, 0.3)
AMPLITUDES = (0.3, 0.6, 1.2, 2.4, 4.8)
KEPT = 0.999  # of a kernel's variance

Factors = list[np.ndarray]


def kernel_factors(features: Sequence[Feature], specimen: np.ndarray) -> Factors:
    """Factors (..., m, r) of discrepancies of amplitude 1; specimen: covariance (..., m, m)."""
    tests = tests_of(features)
    unit = np.sqrt(np.diagonal(specimen, axis1=-2, axis2=-1))[..., None]
    present = list(dict.fromkeys(tests))
    masks = [np.ones(len(tests), bool)]
    if len(present) > 1:
        masks += [tests == test for test in present]
    return [
        unit * _factor(tuple(features), length) * mask[:, None]
        for length in LENGTHS
        for mask in masks
    ]


def projected(factors: Factors, operator: np.ndarray) -> Factors:
    """Factors in the projected space."""
    return [operator @ factor for factor in factors]


def kernel_scores(factors: Factors, residual: np.ndarray) -> np.ndarray:
    """Standardised score (..., j) of each amplitude at zero, of residuals (..., m): locally most
    powerful for it."""
    found = []
    for factor in factors:
        upright = np.swapaxes(factor, -1, -2)
        gram, along = upright @ factor, np.matvec(upright, residual)
        excess = (along**2).sum(axis=-1) - np.trace(gram, axis1=-2, axis2=-1)
        found.append(excess / np.sqrt(2 * np.maximum((gram**2).sum(axis=(-2, -1)), 1e-300)))
    return np.stack(found, axis=-1)


def spectrum(factors: Factors, residual: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """By kernel: eigenvalues (r,) and squared residual (r,) along their directions."""
    found = []
    for factor in factors:
        values, vectors = np.linalg.eigh(factor.T @ factor)
        values = np.maximum(values, 1e-12)
        found.append((values, (vectors.T @ (factor.T @ residual)) ** 2 / values))
    return found


def rough(residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The spectrum of a discrepancy shaped as the noise; residual (m,), projected."""
    return np.ones(len(residual)), residual**2


def log_bayes_factor(
    spectra: list[tuple[np.ndarray, np.ndarray]], noise_scale: float = 1.0
) -> float:
    """ln of the evidence for a discrepancy over that for none, of spectra that share its weight
    equally, with the noise scaled (which leaves the projection nearly as it is)."""
    terms = [
        0.5 * (along * gain / (1 + gain) - np.log1p(gain)).sum()
        for values, squared in spectra
        for gain, along in (
            ((a / noise_scale) ** 2 * values, squared / noise_scale**2) for a in AMPLITUDES
        )
    ]
    return float(np.logaddexp.reduce(terms) - np.log(len(terms)))


@lru_cache(maxsize=64)
def _factor(features: tuple[Feature, ...], length: float) -> np.ndarray:
    """Factor (m, r) of K over both tests."""
    tests = tests_of(features)
    location = np.array([feature.position for feature in features])
    apart = (location[:, None] - location[None, :]) ** 2
    kernel = (tests[:, None] == tests[None, :]) * np.exp(-apart / (2 * length**2))
    values, axes = leading_modes(kernel, KEPT)
    return axes * np.sqrt(np.maximum(values, 0))
