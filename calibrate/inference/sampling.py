"""Draws from a posterior: chains of NUTS in chunks that are kept, how they mixed, and runs where
the posterior is and the response unsure.

Several chains run side by side, each with a step size and a mass matrix of its own (Hoffman and
Gelman 2014, J. Machine Learning Research 15, 1593; numpyro).  A chunk is written with the state of
all chains when it is done.  The state holds the random keys, so a sampler that was killed goes on
from its last chunk to the same draws.  Chains go on until they have mixed, by rank-normalised R-hat
and effective sample sizes (Vehtari et al. 2021, Bayesian Analysis 16, 667), or up to MOST.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import BadZipFile

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from arviz_stats.base.array import array_stats
from jax import Array
from numpyro.infer.hmc import hmc

from calibrate.core.files import whole
from calibrate.core.progress import AbstractProgress
from calibrate.inference.on_response import DIGITS
from calibrate.inference.parameters import to_digits
from calibrate.inference.posterior import Density, OwnError, Question, Shown
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.keys import content_hash

RHAT, ESS = 1.01, 400.0  # chains have mixed: at most, and at least in total
TAILS = (0.05, 0.95)  # quantiles of which the effective size counts too
WIDER = 1.5  # times as far as the posterior's deviations do points lie apart that are searched
SEARCHED, CLIMBED = 512, 24  # points among which starts are sought, and from which it goes uphill
UPHILL = 60  # steps, at most
DEEP = 10.0  # nats below the best: a top so far down holds next to nothing
APART = 0.5  # of the posterior's deviations, by which starts on one top differ


@dataclass(frozen=True)
class Plan:
    """How long chains are: warm-up and draws of each, at least and at most, in chunks."""

    chains: int = 4
    warm_up: int = 300
    draws: int = 700
    most: int = 2100
    chunk: int = 100


class Draws(NamedTuple):
    """Of all chains: y (c, d, p); for each its log density (c, d), whether it diverged, steps of
    its trajectory, probability of acceptance and step size."""

    y: Any
    log_density: Any
    diverging: Any
    steps: Any
    accepted: Any
    step_size: Any


def sample(
    density: Density, start: tuple[np.ndarray, np.ndarray], content: Mapping, seed: int,
    folder: Path, progress: AbstractProgress, plan: Plan = Plan(),
) -> Draws:  # fmt: skip
    """Draws of a density, of which chunks are kept in `folder` by all that they depend on.

    Args:
        density: of y (p,).
        start: y (p,) where it is about largest, and the covariance (p, p) of y about it.
        content: what else they are called by, as plain data.
        seed: of random numbers.
        folder: for chunks.
        progress: is told of them.
        plan: how many chains, and how long.
    """
    made_of = {"density": _digest((density, start)), "seed": seed, "plan": repr(plan)}
    key = content_hash({**content, **made_of})
    begin, covariance = (jnp.asarray(part) for part in start)
    keys = jax.random.split(jax.random.PRNGKey(seed), plan.chains)
    places = starts(density, (begin, covariance), plan.chains, seed)
    state = _begun(density, places, covariance, keys, plan.warm_up)
    structure, found = jax.tree.structure(state), []
    first = plan.warm_up // plan.chunk
    least, most = (first + count // plan.chunk for count in (plan.draws, plan.most))
    progress.start("sampling", least)
    for number in range(most):
        path = folder / "draws" / f"{key}_{number:03d}.npz"
        chunk = _kept(path, structure)
        if chunk is None:
            chunk = jax.tree.map(
                np.asarray, _advanced(density, state, covariance, plan.warm_up, plan.chunk)
            )
            _keep(path, *chunk)
        state, made = chunk
        found += [made] if number >= first else []
        if number < least:
            progress.advance()
        if number + 1 >= least and mixed(*mixing(joined(found).y)):
            break
    progress.finish()
    return joined(found)


def _digest(tree: Any) -> str:
    """Of all arrays in a tree: other data, priors, libraries or runs draw anew."""
    digest = hashlib.sha256()
    for leaf in map(np.asarray, jax.tree.leaves(eqx.filter(tree, eqx.is_array))):
        digest.update(f"{leaf.shape}{leaf.dtype}".encode() + leaf.tobytes())
    return digest.hexdigest()


def starts(density: Density, about: tuple[Array, Array], chains: int, seed: int) -> Array:
    """Where chains begin, y (chains, p).

    A density may have tops of which one holds all of the mass, and chains that begin on another
    stay there for long.  So points are searched about the best fit (`about`: y and its covariance)
    and everywhere within the bounds, the likeliest go uphill, and chains begin on tops that are not
    far below the highest.
    """
    random = np.random.default_rng([seed, 1])
    begin, root = np.asarray(about[0]), np.linalg.cholesky(np.asarray(about[1]))
    near = begin + WIDER * random.normal(size=(SEARCHED // 2, len(begin))) @ root.T
    points = jnp.asarray(np.vstack([near, random.logistic(size=near.shape)]))
    found = np.asarray(_densities(density, points))
    likeliest = np.argsort(-np.where(np.isfinite(found), found, -np.inf))[:CLIMBED]
    tops = _uphill(density, points[likeliest])
    heights = np.asarray(_densities(density, tops))
    heights = np.where(np.isfinite(heights), heights, -np.inf)
    kept = np.asarray(tops)[heights > heights.max() - DEEP]
    chosen = kept[random.integers(len(kept), size=chains)]
    return jnp.asarray(chosen + APART * random.normal(size=chosen.shape) @ root.T)


@eqx.filter_jit
def _densities(density: Density, y: Array) -> Array:
    return jax.lax.map(density, y, batch_size=64)


@eqx.filter_jit
def _uphill(density: Density, y: Array) -> Array:
    """Points (n, p) moved towards the nearest top."""
    solver = optx.BFGS(rtol=1e-3, atol=1e-3)

    def moved(y: Array) -> Array:
        def below(y: Array, args: None) -> Array:
            return -density(y)

        return optx.minimise(below, solver, y, max_steps=UPHILL, throw=False).value

    return jax.vmap(moved)(y)


def joined(chunks: Sequence[Draws]) -> Draws:
    """Chunks (d, c, ...) one after the other, by chain."""
    return Draws(*(np.swapaxes(np.concatenate(part), 0, 1) for part in zip(*chunks, strict=True)))


def mixing(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R-hat (p,) and the lesser of bulk and tail effective sizes (p,) of draws (c, d, p)."""
    columns = np.moveaxis(y, -1, 0)
    axes: dict[str, Any] = {"chain_axis": -2, "draw_axis": -1}
    rhat = array_stats.rhat(columns, **axes)
    bulk = array_stats.ess(columns, method="bulk", **axes)
    tail = array_stats.ess(columns, method="tail", prob=TAILS, **axes)
    return np.asarray(rhat), np.minimum(bulk, tail)


def mixed(rhat: np.ndarray, ess: np.ndarray) -> bool:
    """Whether chains have."""
    return bool(np.all(rhat <= RHAT) and np.all(ess >= ESS))


# ---------------------------------------------------------------- runs where it is unsure

PART = 0.25  # of a number's variance, above which the response's own calls for runs
FURTHER = 4  # points at which they are made, at most
GAIN = 0.1  # of all of it, which a point must take away
CANDIDATES, ASKED = 32, 64  # draws that are weighed as points, and at which their worth is asked


@dataclass(frozen=True, eq=False)
class Sampled:
    """Draws of a density, what runs had shown for it, and at how many points they were added."""

    density: Density
    draws: Draws
    shown: tuple[Shown, ...]
    added: int


def sampled(
    question: Question, shown: Sequence[Shown], work: AbstractCampaign | None, content: Mapping,
    seed: int, folder: Path, progress: AbstractProgress, plan: Plan = Plan(),
) -> Sampled:  # fmt: skip
    """The posterior given what runs showed, and what further ones show where it is and the
    response is unsure; `work` simulates them, None: none are made.  The rest as in `sample`."""
    error, start, known, added = question.own_error(), question.best(), tuple(shown), 0
    content = {**content, "features": [feature.name for feature in question.problem.features]}
    while True:
        density = question.density(error, known)
        draws = sample(density, start, content, seed, folder, progress, plan)
        if work is None or added == FURTHER:
            return Sampled(density, draws, known, added)
        values = values_of(density, draws.y).reshape(-1, draws.y.shape[-1])
        points = further_points(question, error, known, values, FURTHER - added)
        for each in points:
            what = f"runs where the posterior is unsure, soil {added + 1}"
            found = Shown.by(work, question.problem, question.space, *each, what)
            known, added = known + (() if found is None else (found,)), added + 1
        if not points:
            return Sampled(density, draws, known, added)


def further_points(
    question: Question, error: OwnError, shown: Sequence[Shown], values: np.ndarray, most: int
) -> list[tuple[np.ndarray, tuple[int, ...]]]:
    """Soils of draws `values` (n, q) at which runs would narrow what is known most, one after the
    other until it is narrow enough or hardly narrows, with their packings, which take turns."""
    rows = np.linspace(0, len(values) - 1, ASKED).round().astype(int)
    asked, points, known = jnp.asarray(values[rows]), [], list(shown)
    soils = values[:, : len(question.space.names)]
    candidates = [to_digits(soils[n], DIGITS) for n in rows[:: ASKED // CANDIDATES]]
    every, none = [*question.seeds.fitted, *question.seeds.fresh], np.zeros(len(question.acting))
    count = len(question.seeds.fitted)
    density = question.density(error, known)
    part, variance = _unsure(question, density, asked)
    while part > PART and len(points) < most:
        first = count * len(known) % len(every)
        packings = tuple((every + every)[first : first + count])
        tried = []
        for number, at in enumerate(candidates):
            expected = np.tile(_expected(density, jnp.asarray([*at, *none])), (count, 1))
            other = question.density(error, [*known, Shown(at, packings, expected)])
            tried.append((_unsure(question, other, asked)[1], number, expected))
        least, number, expected = min(tried, key=lambda each: each[0])
        if least > (1 - GAIN) * variance:
            break
        known.append(Shown(candidates[number], packings, expected))
        density = question.density(error, known)
        part, variance = _unsure(question, density, asked)
        points.append((candidates[number], packings))
    return points


def _unsure(question: Question, density: Density, values: Array) -> tuple[float, float]:
    """The response's part of the variance of targets, or where there are none of all numbers, and
    this variance over the numbers' squares: means over draws (n, q), of targets the largest, else
    the mean over numbers."""
    share, variance = map(np.asarray, _variances(density, values))
    targets = [m for m, feature in enumerate(question.problem.features) if feature.is_target]
    if targets:
        return float(share[targets].max()), float(variance[targets].max())
    return float(share.mean()), float(variance.mean())


@eqx.filter_jit
def _expected(density: Density, values: Array) -> Array:
    return density.shown(values)[0]


@eqx.filter_jit
def _variances(density: Density, values: Array) -> tuple[Array, Array]:
    """Means over draws (n, q): the response's part of the variance (m,), and all of
    it over the squares of features (m,)."""

    def one(values: Array) -> tuple[Array, Array]:
        mean, own = density.shown(values)
        total = jnp.diag(own + density.covariance)
        return jnp.diag(own) / total, total / mean**2

    return jax.tree.map(lambda part: part.mean(axis=0), jax.vmap(one)(values))


# ---------------------------------------------------------------- NUTS


def _kernel(density: Density, y: Array, covariance: Array, key: Array, warm_up: int):
    """numpyro's sampler, begun at y: its state, and the function that takes a step.  The function
    knows what beginning has set, so both belong to one trace."""
    begin, step = hmc(potential_fn_gen=lambda density: lambda y: -density(y), algo="NUTS")
    state = begin(
        y, warm_up, inverse_mass_matrix=covariance, dense_mass=True, model_args=(density,),
        rng_key=key,
    )  # fmt: skip
    return state, step


@eqx.filter_jit
def _begun(density: Density, y: Array, covariance: Array, keys: Array, warm_up: int) -> Any:
    """The state of chains at y (c, p)."""
    return jax.vmap(lambda y, key: _kernel(density, y, covariance, key, warm_up)[0])(y, keys)


@eqx.filter_jit
def _advanced(
    density: Density, state: Any, covariance: Array, warm_up: int, count: int
) -> tuple[Any, Draws]:
    """The state after so many steps, and their draws (d, c, ...)."""
    _, step = _kernel(density, state.z[0], covariance, state.rng_key[0], warm_up)

    def advance(state: Any, _: None) -> tuple[Any, Draws]:
        state = jax.vmap(lambda state: step(state, (density,)))(state)
        size = state.adapt_state.step_size
        made = (state.z, -state.potential_energy, state.diverging, state.num_steps)
        return state, Draws(*made, state.accept_prob, size)

    return jax.lax.scan(advance, state, length=count)


def _keep(path: Path, state: Any, made: Draws) -> None:
    leaves = {f"state_{number:02d}": leaf for number, leaf in enumerate(jax.tree.leaves(state))}
    with whole(path, ".npz") as part:
        np.savez(part, **leaves, **made._asdict())


def _kept(path: Path, structure: Any) -> tuple[Any, Draws] | None:
    """A chunk with the state of all chains after it; None if there is none, or it is damaged."""
    try:
        with np.load(path) as found:
            leaves = [found[name] for name in sorted(found.files) if name.startswith("state_")]
            state = jax.tree.unflatten(structure, leaves)
            return state, Draws(*(found[name] for name in Draws._fields))
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None


def values_of(density: Density, y: np.ndarray) -> np.ndarray:
    """Parameters, SI, and strengths of effects (c, d, q) of draws y (c, d, q)."""
    return np.asarray(density.values(jnp.asarray(y)))
