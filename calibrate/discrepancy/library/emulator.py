"""The emulator of a library's runs: its components, its processes, what these leave of the runs.

Residuals are given for x = 0.  `calibrate.response.process` has the equations; slopes are JAX's.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_triangular

from calibrate.core.errors import CalibrationError
from calibrate.core.kept import arrays, kept
from calibrate.core.progress import Silent
from calibrate.discrepancy.library.kernel import Factors, Pairs, RowCovariance, fit_kernel
from calibrate.response.process import Component, Kernel, Means, SoilResponse
from calibrate.response.response import linearised
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
    m/(m + degrees of freedom).  This maximum noise fraction transform (Green, Berman, Switzer and
    Craig 1988, IEEE Trans. Geosci. Remote Sens. 26, 65) keeps what a soil does to features that
    hardly scatter."""
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
class FeatureEmulator:
    """Features (m,) and slopes at any point of a library: simulated points x (n, p), s (n, k),
    scaled; scale (m,) in the features' units; residuals (n, m) of the warped features, as large as
    at x = 0; factors of the rows' covariances.  `always` are strengths of the last columns of s,
    without which a point is asked for."""

    x: np.ndarray
    s: np.ndarray
    scale: np.ndarray
    basis: Basis
    components: tuple[Component, ...]
    residuals: np.ndarray
    factors: Factors
    always: tuple[float, ...] = ()

    def __call__(self, x: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means over packings (m,), slopes (m, p) and effects' (m, k) per scaled coordinate."""
        return linearised(self.response, x, s)

    def along(self, x: np.ndarray, s: np.ndarray, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Features (n, m) at points (n, p), (n, k), and their slopes with one base coordinate."""
        direction = np.eye(x.shape[1])[column]
        values, slopes = _along(self.response, jnp.asarray(x), jnp.asarray(s), direction)
        return np.asarray(values), np.asarray(slopes)

    @cached_property
    def response(self) -> SoilResponse:
        """The same as a function that JAX differentiates."""
        parts = (
            self.basis.mean, self.basis.carried, self.scale * self._mean_over_median,
            np.array(self.always, float),
        )  # fmt: skip
        return SoilResponse(self._means, *jax.device_put(parts))

    @cached_property
    def _means(self) -> Means:
        return Means.of(self.components, self.x, self.s)

    def steepness(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """d feature / d warped feature (m,) at a point: what turns residuals into scatter."""
        return np.asarray(_steepness(self.response, x, s))

    def warped(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Warped features (m,) at a point."""
        return np.asarray(_warped(self.response, x, s))

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
        deviation each; largest entries are positive, so that draws do not hang on rounding."""
        left = self.without_effects - self.held(self.without_effects)
        _, size, axes = np.linalg.svd(left, full_matrices=False)
        largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
        return (np.sign(largest) * axes).T * (size / np.sqrt(len(left)))

    def held(self, residuals: np.ndarray) -> np.ndarray:
        """What components hold of warped residuals (n, m)."""
        return self.basis.components(self.basis.mean + residuals) @ self.basis.carried.T

    def larger(self, x: np.ndarray) -> np.ndarray:
        """Deviations (c,) of components at a point (p,) over those at x = 0."""
        return np.exp(self._scattering @ x)

    @cached_property
    def _scattering(self) -> np.ndarray:
        """Slopes (c, p) of the logarithms of deviations."""
        return np.array([c.kernel.scattering for c in self.components])

    @cached_property
    def _mean_over_median(self) -> np.ndarray:
        """Of the hyperbolic sine of a normal that scatters as features do, shape (m,)."""
        return np.exp(0.5 * self.residuals.var(axis=0))

    def variances(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Variances (c,) of the standardised components' errors at a point."""
        return self._variances(x.tobytes(), s.tobytes())

    @cached_property
    def _variances(self) -> Callable[[bytes, bytes], np.ndarray]:
        """The same, kept for the last points: a diagnosis asks for each some six times."""

        @lru_cache(POINTS_KEPT)
        def at(x: bytes, s: bytes) -> np.ndarray:
            point = np.frombuffer(x), np.append(np.frombuffer(s), self.always)
            known, own = map(np.asarray, _covariances_with(self._means, *point))
            found = np.maximum(own - (self._whitened(known) ** 2).sum(axis=1), 0.0)
            found.flags.writeable = False
            return found

        return at

    def slope_variances(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Variances (c, p) of the standardised components' slopes with x, at a point."""
        point = x, np.append(s, self.always)
        known, own = map(np.asarray, _covariances_of_slopes(self._means, *point))
        told = (self._whitened(known) ** 2).sum(axis=1)
        return np.maximum(np.einsum("cpp->cp", own) - told, 0.0)

    def _whitened(self, known: np.ndarray) -> np.ndarray:
        """Covariances (c, n, ...) with the runs in units of what these scatter by."""
        each = [solve_triangular(self.factors[c], one, lower=True, check_finite=False)
                for c, one in enumerate(known)]  # fmt: skip
        return np.array(each)

    def __getstate__(self) -> dict:
        """Without the kept points, so that it goes to other processes."""
        return {name: value for name, value in self.__dict__.items() if name != "_variances"}

    def of_components(self, x: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Standardised components (c,) at a point."""
        return np.asarray(_of_components(self.response, x, s))


@jax.jit
def _along(soil: SoilResponse, x, s, direction):
    def one(at):
        return jax.jvp(lambda x: soil(x, at[1]), (at[0],), (direction,))

    return jax.lax.map(one, (x, s))


_of_components = kept(SoilResponse.components)
_warped = kept(SoilResponse.warped)
_steepness = kept(SoilResponse.steepness)
_covariances_with = kept(Means.covariances)
_covariances_of_slopes = kept(Means.covariances_of_slopes)


def fit_emulator(
    x: np.ndarray, s: np.ndarray, packing: np.ndarray, features: np.ndarray, scale: np.ndarray,
    kernels: Sequence[Kernel] | None = None, basis: Basis | None = None,
    noise: np.ndarray | None = None, most_rows: int = MOST_ROWS, always: tuple[float, ...] = (),
    again: bool = False,
) -> FeatureEmulator:  # fmt: skip
    """The emulator of features (n, m), warped by `scale` (m,), at scaled points; kernels and
    components that are not known are estimated from about `most_rows`.  noise (n, c): factors on
    the variance that rows scatter with; again: weights and factors are kept for other starts."""
    warped = np.arcsinh(features / scale)
    basis = basis or leading(warped, x, s)
    scores = basis.components(warped)
    few = spread(packing, most_rows)
    kernels = kernels or side_by_side(
        lambda c: fit_kernel(x[few], s[few], packing[few], scores[few, c]),
        scores.shape[1], Silent(), "", compiles=True,
    )  # fmt: skip
    noise = np.ones_like(scores) if noise is None else noise
    pairs = Pairs.of(x, packing)
    rows = [RowCovariance(k, x, s, pairs, noise[:, c], again) for c, k in enumerate(kernels)]
    factors = Factors(rows)
    weights = arrays(
        "weights", (x, s, packing, scores, noise, *(part for k in kernels for part in k)),
        lambda: factors.solved(scores), again,
    )  # fmt: skip
    parts = [Component(k, w, row.left(w)) for k, w, row in zip(kernels, weights, rows, strict=True)]
    left = np.array([_as_large_as_stated(c.kernel, c.left, x) for c in parts])
    dropped = _at_centre(warped - basis.mean - scores @ basis.carried.T, x)
    residuals = dropped + left.T @ basis.carried.T
    return FeatureEmulator(x, s, scale, basis, tuple(parts), residuals, factors, always)


def _as_large_as_stated(kernel: Kernel, residuals: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Residuals (n,) of a component at points (n, p) with the variance that its process gives to
    scatter at x = 0: those of a fit are smaller, as some of the scatter is fitted."""
    alike = residuals / np.asarray(kernel.larger(x))
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
