"""What a laboratory's tests show of a soil, as one function that JAX differentiates.

    response(delta, strengths) -> features          delta = ln p - ln p0,  strengths in typical ones

    soil's processes -> model discrepancy -> machine -> lab's size -> recording -> more

All parts are there at once and do nothing where nothing is known of them, so that one compiled
program serves all labs of the same features.  `linearised` gives values and all slopes.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy.interpolate import PchipInterpolator

from calibrate.core.kept import kept
from calibrate.response.machine import Machine
from calibrate.response.process import SoilResponse

LAGS = (0.0, 0.2, 0.5, 1.0, 2.5)  # typical ones, for which curves are recorded
FURTHER = 2  # features that depend on strengths alone


class Discrepancy(eqx.Module):
    """Reality minus simulation in warped features: mean (m,) and directions (m, q), whose shares
    are further base coordinates; scale (m,) by which features are warped."""

    mean: Array
    directions: Array
    scale: Array

    def __call__(self, values: Array, share: Array) -> Array:
        warped = jnp.arcsinh(values / self.scale) + self.mean + self.directions @ share
        return self.scale * jnp.sinh(warped)


class BetweenLags(eqx.Module):
    """Rows (j, m) at LAGS as a function of the lag, smoothly between them (monotone cubics; Fritsch
    and Carlson 1980, SIAM J. Numer. Anal. 17, 238); constant where there is one row, and beyond the
    last."""

    cubics: Array  #: (4, intervals, m), from the highest power down

    @staticmethod
    def of(rows: np.ndarray) -> "BetweenLags":
        if len(rows) == 1:
            rows = np.repeat(rows, len(LAGS), axis=0)
        return BetweenLags(jax.device_put(PchipInterpolator(LAGS, rows).c))

    def slope(self, lag: float) -> np.ndarray:
        """Of the rows (m,) with the lag."""
        return np.asarray(_slope(self, np.float64(lag)))

    def __call__(self, lag: Array) -> Array:
        lags = jnp.array(LAGS)
        within = jnp.where(lag < lags[0], lags[0], jnp.where(lag < lags[-1], lag, lags[-1]))
        at = jnp.clip((lags <= within).sum() - 1, 0, len(LAGS) - 2)
        return jnp.polyval(self.cubics[:, at], within - lags[at])


@kept
def _slope(between: BetweenLags, lag: Array) -> Array:
    return jax.jacfwd(between)(lag)


class Response(eqx.Module):
    """Features (m + further,) at a shift (p,) of the base coordinates and strengths (k,) in typical
    ones.

    offset (p,) of the lab's soil in base coordinates and their spread (p,); strength (k,): what
    takes strengths to shares of their limits, of which some (`squared`) are squared, their sign
    kept; typical (e, k): strengths, SI, of a machine's errors; units (m,): from the library's size
    to the lab's; shape: numbers of the coordinates that are the specimen's shape, the largest
    stress last.  What recording adds, between lags, and lag (k,): what of strengths is the lag, in
    typical ones; further (FURTHER, k): features that depend on strengths alone.  Under another
    condition: factors (k,) on strengths, and what these add to delta, faster (p, k).
    """

    soil: SoilResponse
    offset: Array
    spread: Array
    strength: Array
    squared: Array
    units: Array
    shape: tuple[int, int] = eqx.field(static=True)
    machine: Machine | None
    typical: Array
    discrepancy: Discrepancy | None
    recorded: BetweenLags
    lag: Array
    further: Array
    factors: Array
    faster: Array

    @staticmethod
    def plain(
        soil: SoilResponse, offset, spread, strength, squared, units, shape: tuple[int, int],
        machine: Machine | None, typical, discrepancy: Discrepancy | None = None,
    ) -> "Response":  # fmt: skip
        """Of a soil and a machine alone: nothing is recorded or tared."""
        m, k = len(units), len(strength)
        p = len(offset) + (0 if discrepancy is None else discrepancy.directions.shape[1])
        unknown = np.zeros(k), np.zeros((FURTHER, k)), np.ones(k), np.zeros((p, k))
        lag, further, factors, faster = jax.device_put(unknown)
        parts = jax.device_put((offset, spread, strength, squared, units))
        return Response(
            soil, *parts, shape=shape, machine=machine, typical=jax.device_put(typical),
            discrepancy=discrepancy, recorded=BetweenLags.of(np.zeros((1, m))), lag=lag,
            further=further, factors=factors, faster=faster,
        )  # fmt: skip

    def __call__(self, delta: Array, strengths: Array) -> Array:
        delta, strengths = self.moved(delta, strengths)
        return jnp.append(self._shown(delta, strengths), self.further @ strengths)

    def moved(self, delta: Array, strengths: Array) -> tuple[Array, Array]:
        """The point (p,), (k,) at which a test under another condition is asked."""
        return delta + self.faster @ strengths, strengths * self.factors

    def scaled(self, delta: Array, strengths: Array) -> tuple[Array, Array]:
        """Where the soil is asked, scaled: at the stress that the machine reaches."""
        base = self.offset + delta[: len(self.offset)]
        if self.machine is not None:
            over = self.machine.overload(self.typical @ strengths, base[np.array(self.shape)])
            base = base.at[self.shape[-1]].add(over)
        own = strengths * self.strength
        return base / self.spread, jnp.where(self.squared, own * jnp.abs(own), own)

    def _shown(self, delta: Array, strengths: Array) -> Array:
        share, (x, s) = delta[len(self.offset) :], self.scaled(delta, strengths)
        stress = self.shape[-1]
        along = jnp.zeros_like(x).at[stress].set(1 / self.spread[stress])
        values, by_stress = self.soil.along(x, s, along)
        if self.discrepancy is not None:
            known, still = self.discrepancy, jax.lax.stop_gradient((values, share))
            by_stress = jax.jvp(lambda values: known(values, still[1]), still[:1], (by_stress,))[1]
            values = known(values, share)
        if self.machine is not None:
            shape = (self.offset + delta[: len(self.offset)])[np.array(self.shape)]
            values += self.machine.shift(values, self.typical @ strengths, shape, by_stress)
        return self.units * values + self.recorded(self.lag @ strengths)


@kept
def _linearised(response: Callable[[Array, Array], Array], delta: Array, strengths: Array):
    def twice(*at: Array):
        return (found := response(*at)), found

    slopes, values = jax.jacfwd(twice, (0, 1), has_aux=True)(delta, strengths)
    return values, *slopes


def linearised(
    response: Callable[[Array, Array], Array], delta: np.ndarray, strengths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values (m,) of a response and its slopes (m, p), (m, k), all from JAX."""
    values, base, effects = map(np.asarray, _linearised(response, delta, strengths))
    return values, base, effects


@kept
def asked(response: Response, recorded: BetweenLags, delta: Array, strengths: Array):
    """Where the soil is asked, scaled (p,), (k,); what a warped feature's error does to the
    features (m,); half of what machines differ by (m,)."""
    delta, strengths = response.moved(delta, strengths)
    x, s = response.scaled(delta, strengths)
    steepness = response.units * response.soil.steepness(x, s)
    return x, s, steepness, recorded(response.lag @ strengths)
