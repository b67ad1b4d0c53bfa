"""Errors of the emulator by cross-validation: packings are left out in turn, in blocks.

    e = y - f(x, s)        of a held-out row, in a standardised component
    e ~ N(0, w v(x, s) + q n(x))     n = packing + soil block + rest, at their soil and size

w widens the variance v that the process states of itself, q the scatter n of specimens; both
by maximum likelihood over rows with at most one effect, w with a weak pull to 1, as a few
errors of values hide in much scatter.

Where an effect is on, features err together, along a few directions that few components hold (the
turn of a curve recorded with a lag).  These are the leading principal directions of the errors of
rows with that effect, in units of the errors of rows without any, that are longer than as many
rows without an effect have by chance; they grow with its strength.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from calibrate.discrepancy.library.design import SIZES
from calibrate.discrepancy.library.emulator import FeatureEmulator, Kernel, fit_emulator, leading

FOLDS, BLOCK = 4, len(SIZES)  # packings are left out in turn, by blocks
FEWEST_WITHOUT = 2  # rows without an effect over features, for their covariance
FEWEST = 20  # rows with an effect, for its directions
MOST = 5  # directions of an effect
CHANCES = 50  # draws of rows without an effect
SMALLEST = 1e-9  # variance of errors along a direction, of the largest
FURTHEST = np.log(10.0)  # of ln w and ln q
PULL_SD = 0.5  # of ln w about 0


@dataclass(frozen=True, eq=False)
class TrainingPoints:
    """Scaled points (n, p), (n, k) of a library, their packings (n,), features (n, m), kernels."""

    x: np.ndarray
    s: np.ndarray
    packing: np.ndarray
    values: np.ndarray
    scale: np.ndarray
    kernels: Sequence[Kernel]


@dataclass(frozen=True, eq=False)
class EmulatorErrors:
    """Factors on the variances that components' processes state of their values, widening (c,),
    and of specimens, scatter (c,); directions (m, q) of warped features' errors at the full
    strength of an effect, whose number is in effect (q,)."""

    widening: np.ndarray
    scatter: np.ndarray
    directions: np.ndarray
    effect: np.ndarray

    @staticmethod
    def nothing(components: int, features: int) -> "EmulatorErrors":
        """For an emulator whose stated variances hold."""
        ones = np.ones(components)
        return EmulatorErrors(ones, ones, np.zeros((features, 0)), np.zeros(0, int))

    def along(self, s: np.ndarray) -> np.ndarray:
        """Directions (m, q) of errors at scaled strengths (k,), one standard deviation each."""
        return self.directions * s[self.effect]


def cross_validate(points: TrainingPoints) -> EmulatorErrors:
    """Errors of the emulator of all points with these kernels."""
    errors, stated, whole, strengths, at = [], [], [], [], []
    for emulator, x, s, value in _held_out_rows(points):
        warped = np.arcsinh(value / points.scale)
        errors.append(emulator.basis.components(warped) - emulator.of_components(x, s))
        stated.append(emulator.variances(x, s))
        whole.append(warped - emulator.warped(x, s))
        strengths.append(s)
        at.append(x)
    noise = [k.scatter * k.larger(np.array(at)) ** 2 for k in points.kernels]
    by_component = zip(np.array(errors).T, np.array(stated).T, noise, strict=True)
    widening, scatter = np.array([_factors(*parts) for parts in by_component]).T
    directions = by_effects(np.array(whole), np.array(strengths))
    return EmulatorErrors(widening, scatter, *directions)


def by_effects(errors: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (m, q) of errors (n, m) at strengths (n, k) of at most one effect each, and the
    effects (q,) that they belong to."""
    m = errors.shape[1]
    without = errors[(s == 0).all(axis=1)]
    if len(without) < FEWEST_WITHOUT * m:
        return np.zeros((m, 0)), np.zeros(0, int)
    values, axes = np.linalg.eigh(np.cov(without.T))
    root = axes * np.sqrt(np.maximum(values, SMALLEST * values[-1]))
    standard = np.linalg.solve(root, errors.T).T
    none = standard[(s == 0).all(axis=1)]
    found = [_of_effect(standard[on], s[on, k], none) for k, on in enumerate((s != 0).T)]
    effect = np.repeat(np.arange(s.shape[1]), [part.shape[1] for part in found])
    return root @ np.hstack(found), effect


def _of_effect(standard: np.ndarray, s: np.ndarray, none: np.ndarray) -> np.ndarray:
    """Leading directions (m, r) at strength 1 of standardised errors (n, m) at strengths (n,);
    none (l, m): errors without an effect."""
    n, m = standard.shape
    if n < FEWEST:
        return np.zeros((m, 0))
    values, axes = np.linalg.eigh(standard.T @ standard / n)
    kept = np.flatnonzero(values > _by_chance(none, n))[::-1][:MOST]
    return axes[:, kept] * np.sqrt((values[kept] - 1) / np.mean(s**2))


def _by_chance(none: np.ndarray, count: int) -> float:
    """The longest direction, as a variance, of `count` errors without an effect: its 95 % quantile
    over draws."""
    rng = np.random.default_rng(0)
    drawn = (none[rng.integers(len(none), size=count)] for _ in range(CHANCES))
    return float(np.quantile([np.linalg.norm(rows, 2) ** 2 / count for rows in drawn], 0.95))


def _held_out_rows(
    points: TrainingPoints,
) -> Iterator[tuple[FeatureEmulator, np.ndarray, np.ndarray, np.ndarray]]:
    """Each row with at most one effect, with an emulator fitted without its packing; folds
    are blocks of packings; each block holds all numbers of spheres."""
    few = (points.s != 0).sum(axis=1) <= 1
    basis = leading(np.arcsinh(points.values / points.scale), points.x, points.s)
    for fold in range(FOLDS):
        out = fold_of(points.packing) == fold
        emulator = fit_emulator(
            points.x[~out], points.s[~out], points.packing[~out], points.values[~out],
            points.scale, points.kernels, basis,
        )  # fmt: skip
        for row in np.flatnonzero(out & few):
            yield emulator, points.x[row], points.s[row], points.values[row]


def fold_of(packing: np.ndarray) -> np.ndarray:
    """The fold of each row (n,).  Blocks take turns, and the turn moves on by one each time round:
    slow packings recur as often, and would else lie in the same folds (`design.TURN`)."""
    block = packing // BLOCK
    return (block + block // FOLDS) % FOLDS


def _factors(errors: np.ndarray, stated: np.ndarray, noise: np.ndarray) -> tuple[float, float]:
    """w and q that make the errors (n,) likeliest, given stated variances and noise (n,)."""

    def loss(ln_factors: np.ndarray) -> float:
        w, q = np.exp(ln_factors)
        variance = w * stated + q * noise
        pull = (ln_factors[0] / PULL_SD) ** 2
        return float((np.log(variance) + errors**2 / variance).sum() + pull)

    bounds = [(0.0, FURTHEST), (-FURTHEST, FURTHEST)]
    w, q = np.exp(minimize(loss, np.zeros(2), bounds=bounds).x)
    return float(w), float(q)
