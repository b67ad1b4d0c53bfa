"""Values and slopes of features between the simulations of a library: Gaussian processes.

    asinh(feature/scale) = mean + sum_c loading_c y_c             c: components, by `leading`
    y_c(x, s) = f_c(x, s) + packing + soil block + rest

x are base coordinates over their spread, s strengths over their limits.  The inverse hyperbolic
sine makes factors of force and stiffness add up and scatter alike for weak and strong soils
(Johnson 1949, SU).  Residuals are given for x = 0.  `kernel` has the covariances and their
hyperparameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import cho_solve, solve_triangular

from calibrate.core.errors import CalibrationError
from calibrate.core.progress import Silent
from calibrate.discrepancy.library.kernel import (
    Blocks,
    Kernel,
    covariance,
    fit_kernel,
    scatter_of_pairs,
)
from calibrate.simulation import side_by_side

COMPONENTS = 14
LEAST_SCATTER = 1e-6  # of a feature's variance
ROUND_OFF = 1e-12
MOST_ROWS = 1100  # from which hyperparameters are estimated
POINTS_KEPT = 256  # at which variances are kept


@dataclass(frozen=True, eq=False)
class Basis:
    """Components of warped features: their mean (m,), a root (m, m) of the covariance that they
    scatter with, orthonormal axes (c, m) in units of this scatter, deviation (c,) along these."""

    mean: np.ndarray
    root: np.ndarray
    axes: np.ndarray
    deviation: np.ndarray

    @property
    def carried(self) -> np.ndarray:
        """What components of one deviation change in warped features, shape (m, c)."""
        return (self.root @ self.axes.T) * self.deviation

    def components(self, warped: np.ndarray) -> np.ndarray:
        """Standardised components (c,) or (n, c) of warped features (m,) or (n, m)."""
        return self.standard(warped) @ self.axes.T / self.deviation

    def standard(self, warped: np.ndarray) -> np.ndarray:
        """Warped features (m,) or (n, m) in units of scatter, of which axes are directions."""
        return np.linalg.solve(self.root, (warped - self.mean).T).T

    def longer(self, axes: np.ndarray, deviation: np.ndarray) -> "Basis":
        """With further axes (e, m), orthogonal to its own, and deviations (e,) along these."""
        every = np.vstack([self.axes, axes]), np.append(self.deviation, deviation)
        return Basis(self.mean, self.root, *every)


def leading(warped: np.ndarray, x: np.ndarray, s: np.ndarray, count: int = COMPONENTS) -> Basis:
    """The components of warped features (n, m) at scaled points that vary most in units of scatter:
    what a quadratic regression on the points leaves, its covariance shrunk towards its diagonal by
    m/(m + degrees of freedom).

    Components that vary most by themselves are mostly scatter, and leave out what a soil does to
    features that hardly scatter (as the unloading's beginning): a maximum noise fraction transform
    (Green, Berman, Switzer and Craig 1988, IEEE Trans. Geosci. Remote Sens. 26, 65)."""
    mean, spread = warped.mean(axis=0), np.maximum(warped.std(axis=0), 1e-12)
    standard = (warped - mean) / spread
    terms = np.hstack([np.ones((len(x), 1)), x, s, x**2])
    left = standard - terms @ np.linalg.lstsq(terms, standard, rcond=None)[0]
    freedom = max(len(left) - terms.shape[1], 1)
    scatter = left.T @ left / freedom + LEAST_SCATTER * np.eye(len(mean))
    shrunk = len(mean) / (len(mean) + freedom)
    scatter = (1 - shrunk) * scatter + shrunk * np.diag(np.diag(scatter))
    root = np.linalg.cholesky(scatter)
    whitened = np.linalg.solve(root, standard.T).T
    axes = np.linalg.svd(whitened, full_matrices=False)[2][:count]
    deviation = np.maximum((whitened @ axes.T).std(axis=0), 1e-9)
    return Basis(mean, spread[:, None] * root, axes, deviation)


@dataclass(frozen=True, eq=False)
class Component:
    """One component's process: kernel, weights (n,), lower Cholesky factor (n, n), and
    what it leaves of the rows (n,)."""

    kernel: Kernel
    weights: np.ndarray
    lower: np.ndarray
    left: np.ndarray


class Processes:
    """All components' processes about the same points x (n, p), s (n, k), evaluated together; what
    does not depend on the location is worked out once."""

    def __init__(self, components: Sequence[Component], x: np.ndarray, s: np.ndarray):
        every = Kernel(*map(np.array, zip(*(c.kernel for c in components), strict=True)))
        self.weights = np.array([c.weights for c in components])
        self.points, self.wide = np.hstack([x, s]), x.shape[1]
        self.near = np.exp(-2 * np.hstack([every.length, every.reach]))
        self.height = 2 * every.curved[:, None] - 0.5 * self.near @ (self.points**2).T
        linear, self.effect, mixed, bent = (
            np.exp(2 * part) for part in (every.linear, every.effect, every.interaction, every.bent)
        )
        self.linear, self.sum = linear * (self.weights @ x), self.weights.sum(axis=1)
        self.along = self.effect * (self.weights @ s)
        self.bent = bent * (self.weights @ s**2)
        shared = np.einsum("cn,np,nk->cpk", self.weights, x, s, optimize=True) / x.shape[1]
        self.mixed = mixed[:, None, :] * shared
        self.local_near = np.exp(-2 * every.local_length)
        self.local_height = -0.5 * self.local_near @ (x**2).T
        self.local = np.exp(2 * every.local)

    def __call__(self, at: np.ndarray, strength: np.ndarray):
        """Values (c,), slopes (c, p) and effects' slopes (c, k) at a point (p,), (k,)."""
        location, p = np.concatenate([at, strength]), self.wide
        curved = self._weights_near(location, self.points, self.near, self.height)
        level = curved.sum(axis=1)
        slopes = self.near * (curved @ self.points - level[:, None] * location)
        along = self.along + at @ self.mixed
        base = self.linear + slopes[:, :p] + self.mixed @ strength
        effects = along + 2 * self.bent * strength + slopes[:, p:]
        value = self.sum + self.linear @ at + level + along @ strength + self.bent @ strength**2
        more, steeper, apart = self._by_soil(at, strength)
        return value + more, base + steeper, effects + apart

    def _weights_near(self, at, points, near, height) -> np.ndarray:
        """Weights (c, n) of the points (n, d), less the farther they lie from one (d,)."""
        pulled = near * at
        exponent = height - 0.5 * (pulled @ at)[:, None] + pulled @ points.T
        return np.exp(exponent) * self.weights

    def _by_soil(self, at: np.ndarray, strength: np.ndarray):
        """The same three of the part e."""
        x, s = np.split(self.points, [self.wide], axis=1)
        near = self._weights_near(at, x, self.local_near, self.local_height)
        apart = self.local * (near @ s)
        along = near * ((self.local * strength) @ s.T)
        level = along.sum(axis=1)
        return level, self.local_near * (along @ x - level[:, None] * at), apart


@dataclass(frozen=True, eq=False)
class FeatureEmulator:
    """Features (m,) and slopes at any point of a library.

    x (n, p) and s (n, k) are the simulated points, scaled; scale (m,) in the features' units;
    residuals (n, m) are what is left of the warped simulated features, as large as at x = 0.
    `always` are strengths of the last columns of s, which nobody asks for: s of a point is without
    them.
    """

    x: np.ndarray
    s: np.ndarray
    scale: np.ndarray
    basis: Basis
    components: tuple[Component, ...]
    residuals: np.ndarray
    always: tuple[float, ...] = ()

    def __call__(self, x: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means over packings (m,), slopes (m, p) and effects' (m, k) per scaled coordinate."""
        values, base, effects = self._processes(x, self._every(s))
        carried, effects = self.basis.carried, effects[:, : len(s)]
        lift, steep = self._back(self.basis.mean + carried @ values)
        return lift, steep[:, None] * (carried @ base), steep[:, None] * (carried @ effects)

    def _back(self, warped: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean features (m,) whose warped median is given, and their derivative."""
        scale = self.scale * self._mean_over_median
        return scale * np.sinh(warped), scale * np.cosh(warped)

    def steepness(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """d feature / d warped feature (m,) at a point: what turns residuals into scatter."""
        return self._back(self.warped(x, s))[1]

    def warped(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Warped features (m,) at a point."""
        return self.basis.mean + self.basis.carried @ self.of_components(x, s)

    @property
    def plain(self) -> np.ndarray:
        """Rows (l,) without effects; all where there are fewer than two."""
        found = np.flatnonzero((self.s == 0).all(axis=1))
        return found if len(found) > 1 else np.arange(len(self.s))

    @property
    def without_effects(self) -> np.ndarray:
        """Residuals (l, m) of the rows without effects."""
        return self.residuals[self.plain]

    @cached_property
    def dropped_directions(self) -> np.ndarray:
        """Directions (m, r) of what no component holds of a row without effects, one standard
        deviation each."""
        left = self.without_effects - self.held(self.without_effects)
        _, size, axes = np.linalg.svd(left, full_matrices=False)
        return axes.T * (size / np.sqrt(len(left)))

    def held(self, residuals: np.ndarray) -> np.ndarray:
        """What components hold of warped residuals (n, m)."""
        return self.basis.components(self.basis.mean + residuals) @ self.basis.carried.T

    def larger(self, x: np.ndarray) -> np.ndarray:
        """Deviations (c,) of components at a point (p,) over those at x = 0."""
        return np.array([float(c.kernel.larger(x)) for c in self.components])

    @cached_property
    def _mean_over_median(self) -> np.ndarray:
        """Of the hyperbolic sine of a normal that scatters as features do, shape (m,)."""
        return np.exp(0.5 * self.residuals.var(axis=0))

    @cached_property
    def _processes(self) -> Processes:
        return Processes(self.components, self.x, self.s)

    def variances(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Variances (c,) of the standardised components' errors at a point."""
        return self._variances(x.tobytes(), s.tobytes())

    @cached_property
    def _variances(self) -> Callable[[bytes, bytes], np.ndarray]:
        """The same, kept for the last points: a diagnosis asks for each some six times."""

        @lru_cache(POINTS_KEPT)
        def at(x: bytes, s: bytes) -> np.ndarray:
            point = np.frombuffer(x), self._every(np.frombuffer(s))
            found = np.array([_variance(c, self.x, self.s, *point) for c in self.components])
            found.flags.writeable = False
            return found

        return at

    def __getstate__(self) -> dict:
        """Without the kept points, so that it goes to other processes."""
        return {name: value for name, value in self.__dict__.items() if name != "_variances"}

    def of_components(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Standardised components (c,) at a point."""
        return self._processes(x, self._every(s))[0]

    def _every(self, s: np.ndarray) -> np.ndarray:
        return np.append(s, self.always)


def fit_emulator(
    x: np.ndarray, s: np.ndarray, packing: np.ndarray, features: np.ndarray, scale: np.ndarray,
    kernels: Sequence[Kernel] | None = None, basis: Basis | None = None,
    noise: np.ndarray | None = None, most_rows: int = MOST_ROWS, always: tuple[float, ...] = (),
) -> FeatureEmulator:  # fmt: skip
    """The emulator of features (n, m), warped by `scale` (m,), at scaled points; kernels and
    components already known are kept, others estimated from about `most_rows`.  noise (n, c):
    factors on the variance that rows scatter with in each component; `always` as its own."""
    warped = np.arcsinh(features / scale)
    basis = basis or leading(warped, x, s)
    scores = basis.components(warped)
    few, blocks = spread(packing, most_rows), Blocks.of(x, packing)
    kernels = kernels or side_by_side(
        lambda c: fit_kernel(x[few], s[few], packing[few], scores[few, c]),
        scores.shape[1], Silent(), "", compiles=True,
    )  # fmt: skip

    def component(c: int) -> Component:
        factor = np.ones(len(x)) if noise is None else noise[:, c]
        return _component(kernels[c], x, s, blocks, scores[:, c], factor)

    parts = side_by_side(component, len(kernels), Silent(), "")
    left = np.array([_as_large_as_stated(c.kernel, c.left, x) for c in parts])
    dropped = _at_centre(warped - basis.mean - scores @ basis.carried.T, x)
    residuals = dropped + left.T @ basis.carried.T
    return FeatureEmulator(x, s, scale, basis, tuple(parts), residuals, always)


def _as_large_as_stated(kernel: Kernel, residuals: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Residuals (n,) of a component at points (n, p) with the variance that its process gives to
    packings, soils in them and rest at x = 0: those of a fit are smaller, as some of the scatter is
    fitted."""
    alike = residuals / kernel.larger(x)
    return alike * np.sqrt(kernel.scatter / max(float(alike.var()), 1e-300))


def _at_centre(dropped: np.ndarray, x: np.ndarray) -> np.ndarray:
    """What no component holds (n, m), as large as at x = 0."""
    if np.abs(dropped).max() < ROUND_OFF:
        return dropped
    level = 0.5 * np.log(np.maximum((dropped**2).mean(axis=1), 1e-300))
    terms = np.hstack([np.ones((len(x), 1)), x])
    slopes = np.linalg.lstsq(terms, level, rcond=None)[0][1:]
    return dropped / np.exp(x @ slopes)[:, None]


def spread(packing: np.ndarray, most_rows: int) -> np.ndarray:
    """Mask of at most about `most_rows` rows: whole packings, evenly from first to last;
    `CalibrationError` where there are none."""
    if not len(packing):
        raise CalibrationError("too few simulations for a library; give more --packings")
    every = np.unique(packing)
    share = min(most_rows / len(packing), 1.0)
    kept = every[np.unique((np.arange(len(every)) * share).astype(int), return_index=True)[1]]
    return np.isin(packing, kept)


def _component(kernel: Kernel, x, s, blocks: Blocks, y, factor) -> Component:
    row, other = np.nonzero(blocks.packing)  # other pairs have no scatter in common
    pairs = row, other
    shared = scatter_of_pairs(kernel, x, blocks, pairs) * np.sqrt(factor[row] * factor[other])
    total = covariance(kernel, x, s, x, s)
    total[pairs] += shared
    lower = np.linalg.cholesky(total)
    weights = cho_solve((lower, True), y)
    left = np.bincount(row, shared * weights[other], minlength=len(x))
    return Component(kernel, weights, lower, left)


def _variance(c: Component, x, s, at, strength) -> float:
    point = (at[None], strength[None])
    cross = covariance(c.kernel, *point, x, s)[0]
    own = float(covariance(c.kernel, *point, *point)[0, 0])
    white = solve_triangular(c.lower, cross, lower=True, check_finite=False)
    return max(own - white @ white, 0.0)
