"""Hyperparameters of the emulator's processes (`calibrate.response.process`), scatter of rows.

What a packing does to all its rows has a variance of its own, so that slopes rest on differences
within packings; so has what it does to all rows of one soil (soil blocks, whose rows differ in
effects and pace alone).  Some soils scatter more than others, and coarse beds more than fine ones:
all three deviations go with exp(g.x).

Factors of covariances are made by LAPACK, in threads; those of a library that serves again are kept
beside the compiled programs (`calibrate.core.kept`).

Rows that follow other conventions of the contact law (`other_law`) have one column of strengths
more, 1 for them and 0 for all others; its hyperparameters are found with all others held.

Hyperparameters maximise the marginal likelihood (Rasmussen and Williams 2006, chapters 2 and 5).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.linalg import cho_solve, cholesky, get_lapack_funcs
from scipy.optimize import minimize

from calibrate.core.kept import arrays, kept
from calibrate.discrepancy.library.design import SETTINGS
from calibrate.response.process import Kernel, covariance
from calibrate.simulation import cores

ITERATIONS = 60
PULL_SD = 2.0  # of the logarithms of hyperparameters about their start
SLOPE_SD = 0.2  # of the slopes of ln deviation, about theirs
JITTER = 1e-6
NOTHING = -6.0  # logarithm of a deviation that counts for nothing
PACE = SETTINGS.index("pace") - len(SETTINGS)  # in it rows of one soil may differ
BLOCK = 256  # rows of which covariances are worked out at once
PACK, UNPACK = get_lapack_funcs(("trttf", "tfttr"), dtype=np.float64)  # triangles
COARSE = 0.36  # where that with the size of spheres starts: N^-0.4 (verification/resolution.py)


def start(p: int, k: int) -> Kernel:
    """The kernel from which fitting starts, for p base coordinates and k strengths."""
    low = np.log(0.1)
    return Kernel(
        np.full(p, np.log(0.3)), np.full(p, np.log(3.0)), np.full(k, np.log(1.5)), np.log(0.5),
        np.full(k, np.log(0.3)), np.full(k, low), np.full(k, low), np.full(k, np.log(0.2)),
        np.full(p, np.log(3.0)), np.log(0.3), np.log(0.2), np.log(0.2),
        np.append(np.zeros(p - 1), COARSE),
    )  # fmt: skip


class Column(NamedTuple):
    """Logarithms of the hyperparameters of one more column of strengths, each 0 or 1."""

    reach: Any
    effect: Any
    interaction: Any
    local: Any

    def joined(self, kernel: Kernel) -> Kernel:
        """The kernel with this column behind its own.  Squares of strengths are these strengths."""
        behind = {**self._asdict(), "bent": NOTHING}
        return kernel._replace(**{n: jnp.append(getattr(kernel, n), v) for n, v in behind.items()})


COLUMN = Column(np.log(1.5), np.log(0.5), np.log(0.3), np.log(0.3))  # where its fit starts


class Blocks(NamedTuple):
    """Which rows share a packing, and which also a soil, as ones in matrices (n, n)."""

    packing: np.ndarray
    soil_block: np.ndarray

    @staticmethod
    def of(x: np.ndarray, packing: np.ndarray) -> "Blocks":
        soil, same = _soils(x), packing[:, None] == packing
        one_soil = same & (soil[:, None] == soil)
        return Blocks(same.astype(float), one_soil.astype(float))


def _soils(x: np.ndarray) -> np.ndarray:
    """Numbers (n,) of the soils of rows (n, p)."""
    return np.unique(np.delete(x, PACE, axis=1), axis=0, return_inverse=True)[1].ravel()


class Pairs(NamedTuple):
    """Pairs of rows (q,), (q,) that share a packing, and which of them (q,) also a soil; others
    have no scatter in common."""

    row: np.ndarray
    other: np.ndarray
    one_soil: np.ndarray

    @staticmethod
    def of(x: np.ndarray, packing: np.ndarray) -> "Pairs":
        soil = _soils(x)
        row, other = np.nonzero(packing[:, None] == packing)
        return Pairs(row, other, (soil[row] == soil[other]).astype(float))


@kept
def scatter_of_pairs(kernel: Kernel, x, pairs: Pairs):
    """Covariance (q,) of pairs of rows by what packings, soils in them and rest add."""
    row, other, one_soil = pairs
    larger = kernel.larger(x)
    return larger[row] * larger[other] * _scatter(kernel, 1.0, one_soil, row == other)


_of_block = kept(covariance)


@dataclass(frozen=True, eq=False)
class RowCovariance:
    """What rows at scaled points (n, p), (n, k) have in common in a component: the covariance
    (n, n) of its process and of their scatter, by whose variance noise (n,) are factors; again: it
    is made at other starts as well, so that its factor is kept."""

    kernel: Kernel
    x: np.ndarray
    s: np.ndarray
    pairs: Pairs
    noise: np.ndarray
    again: bool = False

    @cached_property
    def shared(self) -> np.ndarray:
        """The part of scatter (q,), for pairs of rows."""
        row, other, _ = self.pairs
        factor = np.sqrt(self.noise[row] * self.noise[other])
        return np.asarray(scatter_of_pairs(self.kernel, self.x, self.pairs)) * factor

    def left(self, weights: np.ndarray) -> np.ndarray:
        """What a process of these weights (n,) leaves of the rows (n,)."""
        return np.bincount(self.pairs.row, self.shared * weights[self.pairs.other])

    def lower(self) -> np.ndarray:
        """The Cholesky factor (n, n), its upper part as LAPACK leaves it.  What is kept is the
        lower part alone."""
        if not self.again:
            return self._lower()
        known = (self.x, self.s, *self.pairs, self.noise, *self.kernel)
        packed = arrays("factor", known, lambda: PACK(self._lower(), uplo="L")[0])
        return UNPACK(len(self.x), packed, uplo="L")[0]

    def _lower(self) -> np.ndarray:
        """Rows come in blocks: temporary arrays of all rows at once are so large that the system
        clears their memory anew for each component."""
        total = np.empty((len(self.x), len(self.x)), order="F")
        for rows in _blocks(len(self.x)):
            found = _of_block(self.kernel, self.x[rows], self.s[rows], self.x, self.s)
            total[:, rows] = np.asarray(found).T
        total[self.pairs.row, self.pairs.other] += self.shared
        return cholesky(total, lower=True, overwrite_a=True, check_finite=False)


def _blocks(count: int) -> list[slice]:
    """Rows in blocks of one size, the last of which may overlap."""
    size = min(BLOCK, count)
    starts = [min(start, count - size) for start in range(0, count, size)]
    return [slice(start, start + size) for start in starts]


@dataclass(frozen=True, eq=False)
class Factors:
    """Cholesky factors (n, n) of the covariances of rows, by component; made by LAPACK in threads,
    from `begin` on or when one is first asked for."""

    of: Sequence[RowCovariance]

    def begin(self) -> None:
        """Makes them while others work."""
        assert self._made is not None

    def __getitem__(self, component: int) -> np.ndarray:
        return self._made[component].result()

    def solved(self, values: np.ndarray) -> np.ndarray:
        """Weights (c, n) of processes with values (n, c) at the rows."""
        found = [cho_solve((self[c], True), y, check_finite=False) for c, y in enumerate(values.T)]
        return np.array(found)

    @cached_property
    def _made(self) -> list[Future]:
        pool = ThreadPoolExecutor(cores())
        made = [pool.submit(one.lower) for one in self.of]
        pool.shutdown(wait=False)
        return made

    def __getstate__(self) -> dict:
        """Without the factors, so that it goes to other processes."""
        return {"of": self.of}


def _scatter(kernel: Kernel, packing, soil_block, alike):
    rest = jnp.exp(2 * kernel.rest) + JITTER
    blocks = jnp.exp(2 * kernel.packing) * packing + jnp.exp(2 * kernel.soil_block) * soil_block
    return blocks + rest * alike


def _total(kernel: Kernel, x, s, blocks: Blocks):
    larger = kernel.larger(x)
    scatter = larger[:, None] * larger * _scatter(kernel, *blocks, jnp.eye(len(x)))
    return covariance(kernel, x, s, x, s) + scatter


@jax.jit
def _loss(kernel: Kernel, start: Kernel, x, s, blocks: Blocks, y):
    """Minus the log marginal likelihood, with a weak pull to the start."""
    lower = jnp.linalg.cholesky(_total(kernel, x, s, blocks))
    white = jax.scipy.linalg.solve_triangular(lower, y, lower=True)
    sd = Kernel(*[PULL_SD] * len(kernel))._replace(scattering=SLOPE_SD)
    pull = sum(jnp.sum(((a - b) / d) ** 2) for a, b, d in zip(kernel, start, sd, strict=True))
    return 0.5 * white @ white + jnp.log(jnp.diag(lower)).sum() + 0.5 * pull


_loss_and_slope = jax.jit(jax.value_and_grad(_loss))


def fit_kernel(x, s, packing, y) -> Kernel:
    """The kernel with the largest marginal likelihood of standardised values y (n,)."""
    first = start(x.shape[1], s.shape[1])
    known, options = (first, x, s, Blocks.of(x, packing), y), {"maxiter": ITERATIONS}
    return Kernel(*map(np.asarray, _likeliest(_loss_and_slope, first, known, options)))


@jax.jit
def _loss_of_column(values, kernel: Kernel, x, s, blocks: Blocks, y):
    at, about = (Column(*each).joined(kernel) for each in (values, COLUMN))
    return _loss(at, about, x, s, blocks, y)


_column_and_slope = jax.jit(jax.value_and_grad(_loss_of_column))


def fit_column(kernel: Kernel, x, s, packing, y) -> Column:
    """The column with the largest marginal likelihood of standardised values y (n,), the kernel of
    all others held; s (n, k + 1) with the column behind the others."""
    known = kernel, x, s, Blocks.of(x, packing), y
    return Column(*_likeliest(_column_and_slope, np.array(COLUMN), known, {}).tolist())


def _likeliest(loss_and_slope: Callable, first: Kernel | np.ndarray, known: tuple, options: dict):
    """Hyperparameters in the place of `first` at which a loss of these and of what is known is
    least."""
    flat, unflatten = ravel_pytree(first)

    def objective(values):
        value, slope = loss_and_slope(unflatten(jnp.asarray(values)), *known)
        gradient = np.asarray(ravel_pytree(slope)[0], float)
        return (float(value), gradient) if np.isfinite(float(value)) else (1e10, 0.0 * values)

    bounds = [(NOTHING, 3.0)] * len(flat)
    done = minimize(objective, np.asarray(flat), jac=True, bounds=bounds, options=options)
    return unflatten(jnp.asarray(done.x))
