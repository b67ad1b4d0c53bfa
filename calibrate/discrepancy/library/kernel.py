"""The covariance of the emulator's processes, and its hyperparameters.

    cov f = 1 + sum_i a_i^2 x_i x_i' + sum_k s_k s_k' (b_k^2 + c_k^2 x.x'/p) + d_k^2 s_k^2 s_k'^2
          + q^2 exp(-|x - x'|^2_l / 2 - |s - s'|^2_m / 2)
          + sum_k e_k^2 s_k s_k' exp(-|x - x'|^2_n / 2)

x are base coordinates over their spread, s strengths over their limits.  In the last term soils
bend what effects do.  What a packing does to all its rows has a variance of its own, so that
slopes rest on differences within packings (blocks); so has what it does to all rows of one soil
(soil blocks within it, whose rows differ in effects and pace alone): the less is left, the better
an effect is estimated.  Some soils scatter more than others, and coarse beds more than fine ones:
all three deviations go with exp(g.x).

Rows that follow other conventions of the contact law (`other_law`) have one column of strengths
more, 1 for them and 0 for all others: what conventions change is a function of the soil, as what an
effect changes is.  Its hyperparameters are found with all others held (`Column`).

Hyperparameters maximise the marginal likelihood (Rasmussen and Williams 2006, chapters 2 and 5);
derivatives are those of the kernel, in closed form.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from scipy.optimize import minimize

from calibrate.discrepancy.library.design import SETTINGS

ITERATIONS = 60
PULL_SD = 2.0  # of the logarithms of hyperparameters about their start
SLOPE_SD = 0.2  # of the slopes of ln deviation, about theirs
JITTER = 1e-6
NOTHING = -6.0  # logarithm of a deviation that counts for nothing
PACE = SETTINGS.index("pace") - len(SETTINGS)  # in it rows of one soil may differ
COARSE = 0.36  # where that with the size of spheres starts: N^-0.4 (verification/resolution.py)


class Kernel(NamedTuple):
    """Logarithms of the hyperparameters; shapes (p,), (p,), (k,), (), (k,) four times, (p,), then
    scalars, then (p,): scattering, the slopes g of the logarithm of deviations with base
    coordinates."""

    linear: Any
    length: Any
    reach: Any
    curved: Any
    effect: Any
    interaction: Any
    bent: Any
    local: Any
    local_length: Any
    packing: Any
    soil_block: Any
    rest: Any
    scattering: Any

    @property
    def scatter(self) -> float:
        """Variance of one specimen about the process, at x = 0."""
        return float(np.exp(2 * self.packing) + np.exp(2 * self.soil_block) + np.exp(2 * self.rest))

    @staticmethod
    def start(p: int, k: int) -> "Kernel":
        low = np.log(0.1)
        return Kernel(
            np.full(p, np.log(0.3)), np.full(p, np.log(3.0)), np.full(k, np.log(1.5)), np.log(0.5),
            np.full(k, np.log(0.3)), np.full(k, low), np.full(k, low), np.full(k, np.log(0.2)),
            np.full(p, np.log(3.0)), np.log(0.3), np.log(0.2), np.log(0.2),
            np.append(np.zeros(p - 1), COARSE),
        )  # fmt: skip

    def larger(self, x, xp=np):
        """Deviations (n,) at scaled points (n, p) over those at 0."""
        return xp.exp(x @ self.scattering)


class Column(NamedTuple):
    """Logarithms of the hyperparameters of one more column of strengths, each 0 or 1."""

    reach: Any
    effect: Any
    interaction: Any
    local: Any

    def joined(self, kernel: Kernel, xp=np) -> Kernel:
        """The kernel with this column behind its own.  Squares of strengths are these strengths."""
        behind = {**self._asdict(), "bent": NOTHING}
        return kernel._replace(**{n: xp.append(getattr(kernel, n), v) for n, v in behind.items()})


COLUMN = Column(np.log(1.5), np.log(0.5), np.log(0.3), np.log(0.3))  # where its fit starts


class Blocks(NamedTuple):
    """Which rows share a packing, and which also a soil, as ones in matrices (n, n)."""

    packing: np.ndarray
    soil_block: np.ndarray

    @staticmethod
    def of(x: np.ndarray, packing: np.ndarray) -> "Blocks":
        soil = np.unique(np.delete(x, PACE, axis=1), axis=0, return_inverse=True)[1].ravel()
        same = packing[:, None] == packing
        one_soil = same & (soil[:, None] == soil)
        return Blocks(same.astype(float), one_soil.astype(float))


def covariance(kernel: Kernel, x, s, x2, s2, xp=np):
    """cov f between points (n, p), (n, k) and (l, p), (l, k); shape (n, l); xp: numpy or its
    traceable twin."""
    mixed, local = (xp.exp(2 * part) for part in (kernel.interaction, kernel.local))

    def straight(x, s):
        terms = (x * xp.exp(kernel.linear), s * xp.exp(kernel.effect), s**2 * xp.exp(kernel.bent))
        return xp.hstack([xp.ones((len(x), 1)), *terms])

    def everywhere(x, s):
        return xp.hstack([x / xp.exp(kernel.length), s / xp.exp(kernel.reach)])

    found = straight(x, s) @ straight(x2, s2).T
    found = found + _nearness(everywhere(x, s), everywhere(x2, s2), xp, 2 * kernel.curved)
    found = found + ((s * mixed / x.shape[1]) @ s2.T) * (x @ x2.T)
    near = _nearness(x / xp.exp(kernel.local_length), x2 / xp.exp(kernel.local_length), xp)
    return found + ((s * local) @ s2.T) * near


def _nearness(a, b, xp, height=0.0):
    """exp(height - |a - b|^2/2) between points (n, d) and (l, d); shape (n, l)."""

    def lifted(a, *more):
        return xp.hstack([a, *(part * xp.ones((len(a), 1)) for part in more)])

    off, off2 = (0.5 * (part**2).sum(1)[:, None] for part in (a, b))
    return xp.exp(lifted(a, height - off, 1.0) @ lifted(b, 1.0, -off2).T)


def _total(kernel: Kernel, x, s, blocks: Blocks, xp=np):
    return covariance(kernel, x, s, x, s, xp) + scatter_of_rows(kernel, x, blocks, xp)


def scatter_of_rows(kernel: Kernel, x, blocks: Blocks, xp=np):
    """Covariance (n, n) of what packings, soils in them and rest add."""
    larger = kernel.larger(x, xp)
    alike = xp.eye(len(blocks.packing))
    return larger[:, None] * larger * _scatter(kernel, *blocks, alike, xp)


def scatter_of_pairs(kernel: Kernel, x, blocks: Blocks, pairs: tuple[np.ndarray, np.ndarray]):
    """The same (q,) for pairs of rows (q,), (q,)."""
    (row, other), larger = pairs, kernel.larger(x)
    packing, soil_block = (block[pairs] for block in blocks)
    return larger[row] * larger[other] * _scatter(kernel, packing, soil_block, row == other, np)


def _scatter(kernel: Kernel, packing, soil_block, alike, xp):
    rest = xp.exp(2 * kernel.rest) + JITTER
    blocks = xp.exp(2 * kernel.packing) * packing + xp.exp(2 * kernel.soil_block) * soil_block
    return blocks + rest * alike


@jax.jit
def _loss(kernel: Kernel, start: Kernel, x, s, blocks: Blocks, y):
    """Minus the log marginal likelihood, with a weak pull to the start."""
    lower = jnp.linalg.cholesky(_total(kernel, x, s, blocks, jnp))
    white = jax.scipy.linalg.solve_triangular(lower, y, lower=True)
    sd = Kernel(*[PULL_SD] * len(kernel))._replace(scattering=SLOPE_SD)
    pull = sum(jnp.sum(((a - b) / d) ** 2) for a, b, d in zip(kernel, start, sd, strict=True))
    return 0.5 * white @ white + jnp.log(jnp.diag(lower)).sum() + 0.5 * pull


_loss_and_slope = jax.jit(jax.value_and_grad(_loss))


def fit_kernel(x, s, packing, y) -> Kernel:
    """The kernel with the largest marginal likelihood of standardised values y (n,)."""
    start = Kernel.start(x.shape[1], s.shape[1])
    flat, unflatten = ravel_pytree(start)
    blocks = Blocks.of(x, packing)

    def objective(values):
        value, slope = _loss_and_slope(unflatten(jnp.asarray(values)), start, x, s, blocks, y)
        found = float(value)
        gradient = np.asarray(ravel_pytree(slope)[0], float)
        return (found, gradient) if np.isfinite(found) else (1e10, np.zeros(len(values)))

    bounds = [(-6.0, 3.0)] * len(flat)
    options = {"maxiter": ITERATIONS}
    done = minimize(objective, np.asarray(flat), jac=True, bounds=bounds, options=options)
    return Kernel(*[np.asarray(part) for part in unflatten(jnp.asarray(done.x))])


@jax.jit
def _loss_of_column(values, kernel: Kernel, x, s, blocks: Blocks, y):
    column, start = Column(*values), Column(*COLUMN)
    at, about = (one.joined(kernel, jnp) for one in (column, start))
    return _loss(at, about, x, s, blocks, y)


_column_and_slope = jax.jit(jax.value_and_grad(_loss_of_column))


def fit_column(kernel: Kernel, x, s, packing, y) -> Column:
    """The column with the largest marginal likelihood of standardised values y (n,), the kernel of
    all others held; s (n, k + 1) with the column behind the others."""
    blocks = Blocks.of(x, packing)

    def objective(values):
        value, slope = _column_and_slope(jnp.asarray(values), kernel, x, s, blocks, y)
        good = np.isfinite(float(value))
        return (float(value), np.asarray(slope, float)) if good else (1e10, 0.0 * values)

    bounds = [(NOTHING, 3.0)] * len(COLUMN)
    done = minimize(objective, np.array(COLUMN), jac=True, bounds=bounds, method="L-BFGS-B")
    return Column(*done.x.tolist())
