"""The posterior of a soil's parameters on a response that runs have corrected: its log density.

    measured ~ N(f(p) e^(h(p)), S),       S = covariance of what was measured + that of f e^h
    ln density(y) = -|r|^2/2 - ln det L + sum ln d ln p/dy,       S = L L',   r as in `Whitened`

f are the response's features.  h is what they are wrong by, in logarithms: a Gaussian process for
each feature, whose deviation e(p) is the response's own error at the soil and whose correlation is
exp(-|ln p - ln p'|^2 / 2 REACHING^2), distances in units of `Reach.sd`.  Runs at some points are
known: they show h there, and scatter as their packings do (Rasmussen and Williams 2006, section
2.2).  Packings' scatter enters in this way alone; that of repeats is part of what was measured.

Strengths of effects, where some are asked for, stand behind ln p: in typical ones, with a normal
prior of deviation 1 as far as the runs reach.  Simulations have none, and correct soils without.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag
from scipy.stats import norm, truncnorm

from calibrate.core.errors import CalibrationError, InputError
from calibrate.inference.evaluation import Calibration, Whitened
from calibrate.inference.on_response import (
    FeaturesOfBeds,
    OnResponse,
    Reach,
    Solved,
    UnderEffects,
    solved,
)
from calibrate.inference.parameters import RANGES, Acting, Space, Strengths, space, within
from calibrate.inference.problem import Problem, pose
from calibrate.io.conventions import HELD
from calibrate.io.lab import Lab
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.specimens import Seeds
from jdem.core.parameter import Search as Range
from jdem.materials.soil import SoilParameters

REACHING = 2.3  # as errors of the bundled library's processes are correlated about its centre
ALIKE = 0.5  # of a packing's luck is the same for all soils
SOILS = 96  # at which the response's own error is worked out
POINTS = 16  # room is made for runs at so many points at a time, so that nothing compiles anew
UNLIMITED = 10**9  # packings: what scatter of theirs there is, runs bring with them
LEAST = 1e-9  # of a variance that runs leave, and of a measured number's square
EDGE = 0.05  # of a range in y's share, by which a sampler's start keeps off its ends


class OwnError(eqx.Module):
    """Relative deviations (n, m) of a response's features at ln p and strengths (q,), independent
    rows of one deviation each.

    Working them out takes 15 ms by the library of runs, so they are known at SOILS soils of the
    prior.  Between these each row keeps its direction (n, m), and the logarithm of its length is a
    quadratic function without products, of `terms` (n, 1 + 2 q), about `centre` in units of `sd`.
    For the bundled library this is right to some 5 % (verification/results/posterior.md).
    """

    direction: Array
    terms: Array
    centre: Array
    sd: Array

    @staticmethod
    def of(
        response: OnResponse, problem: Problem, known: Space, logs: np.ndarray,
        under: UnderEffects | None = None,
    ) -> "OwnError":  # fmt: skip
        """From soils at ln p and strengths of `logs` (k, q)."""
        centre, sd = logs.mean(axis=0), logs.std(axis=0) + 1e-12
        count = len(known.names)
        found = [
            response.error_rows(problem, known.soil(np.exp(at[:count])), under, at[count:])
            for at in logs
        ]
        rows = np.array([deviations / means for means, deviations in found])
        length = np.linalg.norm(rows, axis=2)
        nearest = np.argmin((((logs - centre) / sd) ** 2).sum(axis=1))
        kept = np.all(np.isfinite(length) & (length > 0), axis=0)
        unit = rows[nearest][kept] / length[nearest][kept][:, None]
        regressors = np.array(_quadratic(np, (logs - centre) / sd))
        terms = np.linalg.lstsq(regressors, np.log(length[:, kept]), rcond=None)[0].T
        return OwnError(*map(jnp.asarray, (unit, terms, centre, sd)))

    def __call__(self, logs: Array) -> Array:
        size = jnp.exp(self.terms @ _quadratic(jnp, (logs - self.centre) / self.sd))
        return size[:, None] * self.direction


def _quadratic(numbers, z):
    """1, z and z^2 of z (..., q), in one row."""
    return numbers.concatenate([numbers.ones_like(z[..., :1]), z, z**2], axis=-1)


@dataclass(frozen=True, eq=False)
class Shown:
    """What runs showed of one soil: parameters (p,), SI, packings (n,), features (n, m)."""

    values: np.ndarray
    packings: tuple[int, ...]
    features: np.ndarray

    @staticmethod
    def by(
        work: AbstractCampaign, problem: Problem, known: Space, values: np.ndarray,
        packings: Sequence[int], what: str,
    ) -> "Shown | None":  # fmt: skip
        """By a campaign, which simulates what it does not have; None where every run failed."""
        (runs,) = work.runs([known.soil(values)], packings, what)
        features = problem.simulated(runs)
        sound = np.all(np.isfinite(features), axis=1)
        kept = tuple(p for p, finished in zip(packings, sound, strict=True) if finished)
        return Shown(np.asarray(values), kept, features[sound]) if kept else None


class FromRuns(eqx.Module):
    """What runs at points (N, q) of ln p tell of h: at ln p, its mean (m,) over e, and the share
    (m,) of its variance that they leave."""

    points: Array
    distance: Array  #: (q,)
    weights: Array  #: (m, N)
    known: Array  #: (m, N, N)

    @staticmethod
    def of(
        shown: Sequence[Shown], features: FeaturesOfBeds, error: OwnError, scatter: np.ndarray,
        reach: Reach,
    ) -> "FromRuns":  # fmt: skip
        """scatter (m,): variance of one packing's features over their mean."""
        names = features.names
        distance = REACHING * np.array([reach.sd[reach.names.index(n)] for n in names])
        size = max(1, -(-len(shown) // POINTS)) * POINTS
        points = np.zeros((size, len(names)))
        weights, known = np.zeros((len(scatter), size)), np.zeros((len(scatter), size, size))
        if shown:
            points[: len(shown)] = np.log([each.values for each in shown])
            none = np.zeros(len(error.centre) - len(names))
            at = [jnp.asarray([*point, *none]) for point in points]
            own = np.array([np.asarray(_deviation(error, each)) for each in at])
            expected = [np.asarray(_features(features, jnp.asarray(s.values))) for s in shown]
            with np.errstate(invalid="ignore", divide="ignore"):
                apart = np.log([s.features.mean(axis=0) for s in shown] / np.array(expected))
            away = (points[:, None] - points) / distance
            alike, luck = np.exp(-0.5 * (away**2).sum(axis=2)), _luck(shown)
            for m, variance in enumerate(scatter):
                on = np.flatnonzero(np.isfinite(apart[:, m]))
                scale, square = own[on, m], np.ix_(on, on)
                total = np.outer(scale, scale) * alike[square] + variance * luck[square]
                inverse = np.linalg.inv(total + LEAST * np.diag(np.diag(total)))
                known[m][square] = np.outer(scale, scale) * inverse
                weights[m, on] = scale * (inverse @ apart[on, m])
        return FromRuns(*map(jnp.asarray, (points, distance, weights, known)))

    def __call__(self, logs: Array) -> tuple[Array, Array]:
        near = jnp.exp(-0.5 * (((self.points - logs) / self.distance) ** 2).sum(axis=1))
        return self.weights @ near, jnp.maximum(1 - (self.known @ near) @ near, LEAST)


def _luck(shown: Sequence[Shown]) -> np.ndarray:
    """Covariance (N, N) of means over packings, that of one packing being 1: points that share
    packings share part of their luck."""
    found = np.zeros((len(shown), len(shown)))
    for i, one in enumerate(shown):
        for j, other in enumerate(shown):
            common = len(set(one.packings) & set(other.packings))
            share = common / (len(one.packings) * len(other.packings))
            found[i, j] = share * (1.0 if i == j else ALIKE)
    return found


@eqx.filter_jit
def _features(features: FeaturesOfBeds, values: Array) -> Array:
    return features(values)


@eqx.filter_jit
def _deviation(error: OwnError, logs: Array) -> Array:
    """Of each feature (m,)."""
    return jnp.sqrt((error(logs) ** 2).sum(axis=0))


class Density(eqx.Module):
    """Log density of unbounded parameters, and strengths, y (q,), but for the evidence; nats.

    measured (m,) with its own covariance (m, m); centre and prior_sd (p,) of ln p; log_bounds:
    where the prior ends, those of the fit or of the response.
    """

    features: FeaturesOfBeds
    measured: Array
    covariance: Array
    centre: Array
    prior_sd: Array
    log_bounds: tuple[Array, Array]
    error: OwnError
    runs: FromRuns
    strengths: Strengths

    def values(self, y: Array) -> Array:
        """Parameters (..., p), SI, and strengths (..., e), in typical ones: (..., q)."""
        count = len(self.centre)
        parts = within(y[..., :count], self.log_bounds), self.strengths.values(y[..., count:])
        return jnp.concatenate(parts, axis=-1)

    def shown(self, values: Array) -> tuple[Array, Array]:
        """Mean features (m,) of a soil with these parameters and strengths (q,), and the covariance
        (m, m) of what the response and the runs that correct it leave unknown of them."""
        count = len(self.centre)
        logs = jnp.append(jnp.log(values[:count]), values[count:])
        return self.corrected(logs, self.features(values))

    def corrected(self, logs: Array, features: Array) -> tuple[Array, Array]:
        """The same of a soil at ln p and strengths of `logs` (q,), whose features (m,) the response
        gave."""
        error = self.error(logs)
        shift, left = self.runs(logs[: len(self.centre)])
        mean = features * jnp.exp(shift * jnp.sqrt((error**2).sum(axis=0)))
        rows = error * (jnp.sqrt(left) * mean)
        return mean, rows.T @ rows

    def __call__(self, y: Array) -> Array:
        values = self.values(y)
        mean, own = self.shown(values)
        lower = jnp.linalg.cholesky(self.covariance + own)
        unit = jnp.eye(len(self.measured))
        whitening = jax.scipy.linalg.solve_triangular(lower, unit, lower=True)
        known = Whitened(self.measured, whitening, self.centre, self.prior_sd)
        count = len(self.centre)
        residual = jnp.append(known(values[:count], mean), values[count:])
        low, high = self.log_bounds
        span = jnp.append(high - low, self.strengths.high - self.strengths.low)
        slope = jnp.log(span) + jax.nn.log_sigmoid(y) + jax.nn.log_sigmoid(-y)
        scale = jnp.log(jnp.diag(lower)).sum()
        return -0.5 * (residual @ residual) - scale + slope.sum()


# ---------------------------------------------------------------- of a laboratory


@dataclass(frozen=True, eq=False)
class Question:
    """What a posterior is asked of: a lab's problem, all parameters that the response varies and
    the lab does not hold, within the bounds of both, and what simulates.

    `share` (p,): of each parameter's prior within the bounds of a fit, what the response reaches;
    unknown (m,): features beyond its curves, which have no say; scatter (m, m): covariance of one
    packing's features over their mean, from `scattered`.
    """

    lab: Lab
    problem: Problem
    space: Space
    share: np.ndarray
    response: OnResponse
    unknown: np.ndarray
    scatter: np.ndarray
    scattered: int
    seeds: Seeds
    acting: tuple[Acting, ...] = ()

    @staticmethod
    def of(
        lab: Lab, base: SoilParameters, response: OnResponse, work: AbstractCampaign, seeds: Seeds,
        acting: tuple[Acting, ...] = (),
    ) -> "Question":  # fmt: skip
        """With the strengths of effects that are acting.  `CalibrationError` where bounds leave
        nothing that the response knows."""
        held = {name for name, choice in lab.parameters.items() if choice.free is False}
        held |= set(HELD.get(lab.particles.conventions, ()))
        names = tuple(n for n in response.reach.names if n in RANGES and n not in held)
        if not names:
            reason = "it holds every parameter that the library of runs varies"
            raise InputError(lab.file, "parameters", reason, "leave one free")
        known, share = within_reach(space(lab, names, base), response.reach)
        problem = pose(lab)
        unknown = response.unknown(problem, base)
        problem = problem.without(unknown)
        scatter, scattered = response.scatter(problem, base, seeds, work)
        return Question(
            lab, problem, known, share, response, unknown, scatter, scattered, seeds, acting
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of parameters, then of effects whose strengths are asked for."""
        return (*self.space.names, *self.strengths.names)

    @property
    def strengths(self) -> Strengths:
        return Strengths.of(self.acting)

    @property
    def under(self) -> UnderEffects | None:
        """What the response shows where these effects act."""
        return self.response.under(self.strengths.names)

    def drawn(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Soils of the prior: ln p and strengths (count, q)."""
        logs = self.prior.rvs((count, len(self.space.names)), random)
        return np.hstack([logs, self.strengths.drawn(count, random)])

    @property
    def prior(self):
        """Of ln p (p,): normal, cut where the response ends."""
        (low, high), sd = self.space.log_bounds(), self.space.prior_sd()
        centre = np.log(self.space.start())
        return truncnorm((low - centre) / sd, (high - centre) / sd, centre, sd)

    def own_error(self) -> OwnError:
        """The response's, about soils of the prior."""
        drawn = self.drawn(SOILS, np.random.default_rng(0))
        return OwnError.of(self.response, self.problem, self.space, drawn, self.under)

    def density(self, error: OwnError, shown: Sequence[Shown]) -> Density:
        """Given what runs showed."""
        features = self.features()
        covariance = self.problem.covariance(self.scatter, UNLIMITED)
        covariance += LEAST * np.diag(self.problem.measured**2)
        scatter, reach = np.diag(self.scatter), self.response.reach
        runs = FromRuns.of(shown, features, error, scatter, reach)
        low, high = self.space.log_bounds()
        return Density(
            features, jnp.asarray(self.problem.measured), jnp.asarray(covariance),
            jnp.asarray(np.log(self.space.start())), jnp.asarray(self.space.prior_sd()),
            (jnp.asarray(low), jnp.asarray(high)), error, runs, self.strengths,
        )  # fmt: skip

    def features(self) -> FeaturesOfBeds:
        """The response's, of parameters and strengths."""
        beds = self.response.campaign.beds
        return FeaturesOfBeds.of(beds, self.problem, self.space, self.under)

    def best(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the response fits best, y (q,), and the covariance (q, q) of y about it as slopes
        say; a sampler begins there.  Strengths are as beforehand."""
        calibration = Calibration(
            self.problem, self.space, self.response.campaign,  # pyright: ignore[reportArgumentType]
            self.seeds.fitted, self.scatter, self.scattered,
        )  # fmt: skip
        found: Solved = solved(self.response.campaign, calibration)
        low, high = self.space.log_bounds()
        share = np.clip(self.space.share(found.best.values), EDGE, 1 - EDGE)
        whitened = calibration.whitened(found.slopes)
        information = whitened.T @ whitened + np.diag(1 / self.prior.var())
        slope = (high - low) * share * (1 - share)
        covariance = np.linalg.inv(information) / np.outer(slope, slope)
        at, variance = self.strengths.start()
        return (
            np.append(np.log(share / (1 - share)), at),
            np.asarray(block_diag(covariance, *variance[:, None, None])),
        )


def within_reach(known: Space, reach: Reach) -> tuple[Space, np.ndarray]:
    """A space whose bounds end where a response does, and the share (p,) of each parameter's prior
    that they keep; `CalibrationError` where they keep nothing."""
    at = [reach.names.index(name) for name in known.names]
    low, high = known.log_bounds()
    least, most = np.maximum(low, reach.low[at]), np.minimum(high, reach.high[at])
    for name, a, b, entry in zip(known.names, least, most, known.ranges, strict=True):
        if not a < b:
            raise CalibrationError(
                f"no mass inside the bounds: {name} is sought from {entry.low:.4g} to "
                f"{entry.high:.4g}, where the library of runs has no soil; change its low and high"
            )
    centre, sd = np.log(known.start()), known.prior_sd()

    def mass(ends):
        a, b = ((end - centre) / sd for end in ends)
        return norm.cdf(b) - norm.cdf(a)

    ranges = tuple(
        Range(float(np.exp(a)), float(np.exp(b)), entry.prior_sd)
        for a, b, entry in zip(least, most, known.ranges, strict=True)
    )
    return replace(known, ranges=ranges), mass((least, most)) / mass((low, high))
