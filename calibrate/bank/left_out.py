"""What an emulator misses, seen on packings left out in turn: how much too sure it is.

    e = y - f(x, s)        of a left-out row, in a standardised component
    e ~ N(0, w v(x, s) + q n)        n = packing + twin + rest

w widens the variance v that the process states of itself, q the scatter n of specimens; both
by maximum likelihood over rows with at most one effect, w with a weak pull to 1, as a few
errors of values hide in much scatter.  What is left of the squares of features beyond
both is a tolerance of each feature alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from calibrate.bank.emulator import FeatureEmulator, Kernel, fit_emulator, principal

FOLDS, BLOCK = 4, 4  # packings are left out in turn, by blocks
FURTHEST = np.log(10.0)  # of ln w and ln q
PULL_SD = 0.5  # of ln w about 0


@dataclass(frozen=True, eq=False)
class Points:
    """Scaled points (n, p), (n, k) of a bank, their packings (n,), features (n, m), kernels."""

    x: np.ndarray
    s: np.ndarray
    packing: np.ndarray
    values: np.ndarray
    scale: np.ndarray
    kernels: Sequence[Kernel]


@dataclass(frozen=True, eq=False)
class Missed:
    """Factors on the variances that components' processes state of their values, widening (c,),
    and of specimens, scatter (c,); tolerance (m,) of warped features."""

    widening: np.ndarray
    scatter: np.ndarray
    tolerance: np.ndarray


def missed(points: Points) -> Missed:
    """What the emulator of all points with these kernels misses."""
    errors, stated, squares, carried = [], [], [], []
    for learned, x, s, value in _left_out(points):
        variances = learned.variances(x, s)
        warped = np.arcsinh(value / points.scale)
        errors.append(learned.basis.components(warped) - learned.of_components(x, s))
        stated.append(variances)
        squares.append((learned.warped(x, s) - warped) ** 2 - learned.residuals.var(axis=0))
        carried.append(learned.basis.carried**2)
    noise = np.array([k.scatter for k in points.kernels])
    by_component = zip(np.array(errors).T, np.array(stated).T, noise, strict=True)
    widening, scatter = np.array([_factors(*parts) for parts in by_component]).T
    known = [
        part @ (widening * v + (scatter - 1) * noise)
        for part, v in zip(carried, stated, strict=True)
    ]
    left = np.mean(np.array(squares) - np.array(known), axis=0)
    return Missed(widening, scatter, np.sqrt(np.maximum(left, 0.0)))


def _left_out(
    points: Points,
) -> Iterator[tuple[FeatureEmulator, np.ndarray, np.ndarray, np.ndarray]]:
    """Each row with at most one effect, with an emulator that has not seen its packing; folds
    are blocks of packings, which hold all numbers of spheres."""
    few = (points.s != 0).sum(axis=1) <= 1
    basis = principal(np.arcsinh(points.values / points.scale))
    for fold in range(FOLDS):
        out = points.packing // BLOCK % FOLDS == fold
        learned = fit_emulator(
            points.x[~out], points.s[~out], points.packing[~out], points.values[~out],
            points.scale, points.kernels, basis,
        )  # fmt: skip
        for row in np.flatnonzero(out & few):
            yield learned, points.x[row], points.s[row], points.values[row]


def _factors(errors: np.ndarray, stated: np.ndarray, noise: float) -> tuple[float, float]:
    """w and q that make the errors (n,) likeliest, given stated variances (n,) and noise."""

    def loss(ln_factors: np.ndarray) -> float:
        w, q = np.exp(ln_factors)
        variance = w * stated + q * noise
        pull = (ln_factors[0] / PULL_SD) ** 2
        return float((np.log(variance) + errors**2 / variance).sum() + pull)

    bounds = [(0.0, FURTHEST), (-FURTHEST, FURTHEST)]
    w, q = np.exp(minimize(loss, np.zeros(2), bounds=bounds).x)
    return float(w), float(q)
