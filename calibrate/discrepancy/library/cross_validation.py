"""Errors of the emulator: packings left out in turn, and soils repeated on several packings.

    e = y - f(x, s)                                      in a standardised component
    held-out row                e ~ t(w v(x, s) + (u + q) n(x))
    mean of k repeats           e ~ t(w v(x, s) + (u + q/k) n(x))
    repeats about their mean    sum of squares ~ q n(x) chi2(k - 1)

v is the variance that the process states of itself, n = packing + soil block + rest the scatter
that it states of specimens.  Part of n is what a smooth function misses, the same for all specimens
of a soil: its misfit u.  Rows have a packing each and cannot tell u from q, the scatter proper
(lack of fit and pure error; Draper and Smith 1998, section 2.1); repeats can, and without them
u = 0.  All three by maximum likelihood over rows with at most one effect and repeats, w with a weak
pull to 1.  Errors have heavy tails, as a few soils are far off (Student's t with HEAVY degrees of
freedom, Lange, Little and Taylor 1989).

What no component holds is split as a whole, by mean squares over repeats.  Its scatter goes with
size and soil as that of components does on average; its misfit is taken for the same everywhere.
Rows with effects miss more there, along directions of their own, and do not count.

Where an effect is on, features err together, along a few directions that few components hold (the
turn of a curve recorded with a lag).  These are the leading principal directions of the errors of
rows with that effect, in units of the errors of rows without any, that are longer than as many
rows without an effect have by chance.  Rows longer than the median count as this long (near the
sign covariance of Visuri, Koivunen and Oja 2000, J. Stat. Plan. Inference 91, 557), and how long a
direction is follows from the same likelihood with heavy tails, z ~ t(1 + (size s)^2).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import fminbound, minimize

from calibrate.discrepancy.comparison.generated import HEAVY
from calibrate.discrepancy.library.design import SIZES
from calibrate.discrepancy.library.emulator import FeatureEmulator, fit_emulator, leading

FOLDS, BLOCK = 4, len(SIZES)  # packings are left out in turn, by blocks
FEWEST_WITHOUT = 2  # rows without an effect over features, for their covariance
FEWEST = 20  # rows with an effect, for its directions
MOST = 8  # directions of an effect
CHANCES = 50  # draws of rows without an effect
SMALLEST = 1e-9  # variance of errors along a direction, of the largest
FURTHEST = np.log(10.0)  # of ln w, ln q and ln u
PULL_SD = 0.5  # of ln w about 0
LEAST = 1e-3  # of u and q
SIZES_OF_ERRORS = (np.log(0.05), np.log(400.0))  # of directions at full strength, logarithms


class Split(NamedTuple):
    """Variances of specimens, at x = 0, and of misfit, over that of the rows' residuals."""

    scatter: float = 1.0
    misfit: float = 0.0


@dataclass(frozen=True, eq=False)
class EmulatorErrors:
    """Factors on the variances that components' processes state: of their values, widening (c,);
    of specimens, scatter (c,), and misfit (c,); the same two of what no component holds; and
    directions (m, q) of warped features' errors at the full strength of an effect, whose number is
    in effect (q,)."""

    widening: np.ndarray
    scatter: np.ndarray
    misfit: np.ndarray
    dropped: Split
    directions: np.ndarray
    effect: np.ndarray

    @staticmethod
    def nothing(components: int, features: int) -> "EmulatorErrors":
        """For an emulator whose stated variances hold."""
        ones = np.ones(components)
        return EmulatorErrors(
            ones, ones, 0 * ones, Split(), np.zeros((features, 0)), np.zeros(0, int)
        )

    def longer(self, further: int) -> "EmulatorErrors":
        """With this many components more, which were among what none holds."""
        scatter, misfit = (np.append(part, np.full(further, of)) for part, of in (
            (self.scatter, self.dropped.scatter), (self.misfit, self.dropped.misfit),
        ))  # fmt: skip
        widening = np.append(self.widening, np.ones(further))
        return replace(self, widening=widening, scatter=scatter, misfit=misfit)

    def of_values(self, emulator: FeatureEmulator, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Directions (m, r) of errors of warped values at a scaled point, one deviation each."""
        scatter = np.array([c.kernel.scatter for c in emulator.components])
        stated = self.widening * emulator.variances(x, s)
        missed = self.misfit * scatter * emulator.larger(x) ** 2
        found = [
            emulator.basis.carried * np.sqrt(stated + missed),
            self.directions * s[self.effect],
        ]
        if self.dropped.misfit:
            found.append(np.sqrt(self.dropped.misfit) * emulator.dropped_directions)
        return np.hstack(found)

    def specimens(
        self, emulator: FeatureEmulator, residuals: np.ndarray, x: np.ndarray
    ) -> np.ndarray:
        """Warped residuals (n, m) at x = 0 as specimens scatter at a scaled point (p,)."""
        held = emulator.held(residuals)
        parts = emulator.basis.components(emulator.basis.mean + residuals)
        of_parts = np.sqrt(self.scatter) * emulator.larger(x)
        of_rest = np.sqrt(self.dropped.scatter) * _larger_on_average(emulator, x)
        return of_rest * (residuals - held) + (parts * of_parts) @ emulator.basis.carried.T


def _larger_on_average(emulator: FeatureEmulator, x: np.ndarray) -> float:
    """Deviation of components at a scaled point (p,) over that at x = 0, their geometric mean."""
    return float(np.exp(np.mean(np.log(emulator.larger(x)))))


@dataclass(frozen=True, eq=False)
class Repeats:
    """Scaled points (r, p) of repeated soils, and the features (k, m) of each one's specimens."""

    x: np.ndarray
    values: Sequence[np.ndarray]


class Errors(NamedTuple):
    """Errors (n, c) of components, stated variances (n, c) of values and of specimens; the count
    (n,) of specimens behind each error, and their sum of squares (n, c) about their mean."""

    error: np.ndarray
    stated: np.ndarray
    noise: np.ndarray
    count: np.ndarray
    squares: np.ndarray


def cross_validate(
    emulator: FeatureEmulator, packing: np.ndarray, values: np.ndarray,
    repeats: Repeats | None = None,
) -> EmulatorErrors:  # fmt: skip
    """Errors of an emulator, whose kernels stay, by packings (n,) and features (n, m) of rows."""
    known, whole, strengths = _of_rows(emulator, packing, values)
    if repeats is not None:
        both = zip(known, _of_repeats(emulator, repeats), strict=True)
        known = Errors(*map(np.concatenate, both))
    of_components = (
        _factors(known, c, repeats is not None) for c in range(len(emulator.components))
    )
    widening, scatter, misfit = np.array(list(of_components)).T
    dropped = Split() if repeats is None else dropped_split(emulator, repeats)
    directions, effect = by_effects(whole, strengths)
    return EmulatorErrors(widening, scatter, misfit, dropped, directions, effect)


def _of_rows(
    emulator: FeatureEmulator, packing: np.ndarray, values: np.ndarray
) -> tuple[Errors, np.ndarray, np.ndarray]:
    """Errors of held-out rows; those of warped features (n, m), and strengths (n, k)."""
    errors, stated, whole, strengths, at = [], [], [], [], []
    for blind, row in _held_out_rows(emulator, packing, values):
        x, s, warped = emulator.x[row], emulator.s[row], np.arcsinh(values[row] / emulator.scale)
        errors.append(blind.basis.components(warped) - blind.of_components(x, s))
        stated.append(blind.variances(x, s))
        whole.append(warped - blind.warped(x, s))
        strengths.append(s)
        at.append(x)
    kernels = (component.kernel for component in emulator.components)
    noise = np.array([k.scatter * k.larger(np.array(at)) ** 2 for k in kernels]).T
    error = np.array(errors)
    found = Errors(error, np.array(stated), noise, np.ones(len(error)), np.zeros_like(error))
    return found, np.array(whole), np.array(strengths)


def _of_repeats(emulator: FeatureEmulator, repeats: Repeats) -> Errors:
    """Errors of the means of repeats, which the emulator has not seen."""
    none = np.zeros(emulator.s.shape[1])
    found = []
    for x, values in zip(repeats.x, repeats.values, strict=True):
        parts = emulator.basis.components(np.arcsinh(values / emulator.scale))
        mean = parts.mean(axis=0)
        noise = [c.kernel.scatter for c in emulator.components] * emulator.larger(x) ** 2
        found.append((
            mean - emulator.of_components(x, none), emulator.variances(x, none), noise,
            len(parts), ((parts - mean) ** 2).sum(axis=0),
        ))  # fmt: skip
    return Errors(*(np.array(part) for part in zip(*found, strict=True)))


def dropped_split(emulator: FeatureEmulator, repeats: Repeats) -> Split:
    """Scatter and misfit of what no component holds, over the variance of rows without effects."""
    basis = emulator.basis

    def dropped(warped: np.ndarray) -> np.ndarray:
        """In units of scatter (n, m)."""
        return np.linalg.solve(basis.root, (warped - emulator.held(warped)).T).T

    within, freedom, between, share = 0.0, 0, [], []
    for x, values in zip(repeats.x, repeats.values, strict=True):
        left = dropped(np.arcsinh(values / emulator.scale) - basis.mean)
        mean, larger = left.mean(axis=0), _larger_on_average(emulator, x) ** 2
        within += ((left - mean) ** 2).sum() / larger
        freedom += len(left) - 1
        between.append((mean**2).sum())
        share.append(larger / len(left))
    stated = (dropped(emulator.without_effects) ** 2).sum(axis=1).mean()
    scatter = within / freedom / stated
    return Split(
        float(scatter), float(max(np.mean(between) / stated - np.mean(share) * scatter, 0.0))
    )


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
    usual = _shortened(standard)
    values, axes = np.linalg.eigh(usual.T @ usual / n)
    kept = np.flatnonzero(values > _by_chance(_shortened(none), n))[::-1][:MOST]
    return axes[:, kept] * [_size(along, s) for along in (standard @ axes[:, kept]).T]


def _shortened(standard: np.ndarray) -> np.ndarray:
    """Errors (n, m), none longer than the median, so that one soil does not turn all directions."""
    length = np.linalg.norm(standard, axis=1)
    return standard * np.minimum(1.0, np.median(length) / np.maximum(length, 1e-300))[:, None]


def _size(along: np.ndarray, s: np.ndarray) -> float:
    """Length of a direction at strength 1, given errors along it (n,) at strengths (n,), which are
    1 without an effect."""

    def loss(ln_size: float) -> float:
        return float(_unlikely(along, 1 + (np.exp(ln_size) * s) ** 2).sum())

    return float(np.exp(fminbound(loss, *SIZES_OF_ERRORS)))


def _by_chance(none: np.ndarray, count: int) -> float:
    """The longest direction, as a variance, of `count` errors without an effect: its 95 % quantile
    over draws."""
    rng = np.random.default_rng(0)
    drawn = (none[rng.integers(len(none), size=count)] for _ in range(CHANCES))
    return float(np.quantile([np.linalg.norm(rows, 2) ** 2 / count for rows in drawn], 0.95))


def _held_out_rows(
    emulator: FeatureEmulator, packing: np.ndarray, values: np.ndarray
) -> Iterator[tuple[FeatureEmulator, int]]:
    """Each row with at most one effect, with an emulator fitted without its block of packings."""
    x, s, scale = emulator.x, emulator.s, emulator.scale
    few, kernels = (s != 0).sum(axis=1) <= 1, [each.kernel for each in emulator.components]
    basis = leading(np.arcsinh(values / scale), x, s)
    for fold in range(FOLDS):
        out = fold_of(packing) == fold
        known = x[~out], s[~out], packing[~out], values[~out]
        blind = fit_emulator(*known, scale, kernels, basis)
        yield from ((blind, int(row)) for row in np.flatnonzero(out & few))


def fold_of(packing: np.ndarray) -> np.ndarray:
    """The fold of each row (n,).  Blocks take turns, and the turn moves on by one each time round:
    slow packings recur as often, and would else lie in the same folds (`design.TURN`)."""
    block = packing // BLOCK
    return (block + block // FOLDS) % FOLDS


def _factors(known: Errors, component: int, repeated: bool) -> tuple[float, float, float]:
    """w, q and u that make a component's errors likeliest; u is 0 where no soil is repeated."""
    errors, stated, noise, squares = (
        part[:, component] for part in (known.error, known.stated, known.noise, known.squares)
    )
    count = known.count

    def loss(ln_factors: np.ndarray) -> float:
        w, q, u = _factors_of(ln_factors, repeated)
        variance = w * stated + (u + q / count) * noise
        within = (count - 1) * np.log(q * noise) + squares / (q * noise)
        pull = (ln_factors[0] / PULL_SD) ** 2
        return float((_unlikely(errors, variance) + within).sum() + pull)

    low = np.log(LEAST)
    bounds = [(0.0, FURTHEST), (low, FURTHEST), (low, FURTHEST)][: 2 + repeated]
    start = np.log([1.0, 0.5, 0.5]) if repeated else np.zeros(2)
    return _factors_of(minimize(loss, start, bounds=bounds).x, repeated)


def likeliest_widening(errors: np.ndarray, stated: np.ndarray, scatter: np.ndarray) -> np.ndarray:
    """w (c,) alone from errors (n, c), stated variances of values and those of specimens."""

    def loss(ln_w: float, c: int) -> float:
        unlikely = _unlikely(errors[:, c], np.exp(ln_w) * stated[:, c] + scatter[:, c])
        return float(unlikely.sum() + (ln_w / PULL_SD) ** 2)

    found = [fminbound(loss, 0.0, FURTHEST, args=(c,)) for c in range(errors.shape[1])]
    return np.exp(np.array(found))


def _unlikely(errors: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Minus twice the log density of errors with heavy tails, up to a constant."""
    return np.log(variance) + (HEAVY + 1) * np.log1p(errors**2 / (HEAVY * variance))


def _factors_of(ln_factors: np.ndarray, repeated: bool) -> tuple[float, float, float]:
    w, q = map(float, np.exp(ln_factors[:2]))
    return w, q, float(np.exp(ln_factors[2])) if repeated else 0.0
