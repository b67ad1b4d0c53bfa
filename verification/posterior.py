"""Posteriors: do draws agree with brute force, are they calibrated, do intervals hold the truth?

Brute force weighs DRAWN soils of the prior, with the density that is sampled:

- the bundled soil's targets by the library alone: quantiles of NUTS beside brute force, and
  effective draws a second of processor time beside a random walk that is given the posterior's own
  covariance to step by (Metropolis; Roberts, Gelman and Gilks 1997), and beside GrainLearning where
  it is installed (version 2.0.5 was);
- simulation-based calibration (Talts et al. 2018, arXiv 1804.06788): HIDDEN soils of the prior,
  numbers as the response with all its errors would give them, ranks of the truth in the posterior,
  tested by Kolmogorov and Smirnov.

    python -m verification.posterior        5 minutes of a core

Writes a section of verification/results/posterior.md.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import binomtest, kstest

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.posterior import Density, Question
from calibrate.inference.sampling import mixing, sample, values_of
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation.resolution import PRESETS, Preset
from calibrate.simulation.specimens import Seeds, campaign
from verification import reporting

DRAWN, HIDDEN = 100_000, 200
QUANTILES = (0.05, 0.5, 0.95)
STEPS = 20_000  # of each random walk
FILTERED = 4_000  # samples of an iteration of GrainLearning
UNIT = 0.1  # of what it observes: one deviation


def question_of(lab: Lab, preset: Preset) -> Question:
    """What is asked of the bundled library."""
    work = campaign(lab, preset, reporting.CACHE, for_terminal())
    response, why = served(lab, preset, None, base_soil(lab), work)
    if response is None:
        raise SystemExit(why)
    seeds = Seeds.of(0, preset.packings, preset.fresh)
    return Question.of(lab, base_soil(lab), response, work, seeds)


# ---------------------------------------------------------------- brute force


@dataclass(frozen=True, eq=False)
class Brute:
    """Soils of a prior: ln p (n, q), what they show (n, m), and its covariance (n, m, m)."""

    logs: np.ndarray
    shown: np.ndarray
    covariance: np.ndarray

    @staticmethod
    def of(question: Question, density: Density, count: int, seed: int) -> "Brute":
        drawn = np.random.default_rng(seed)
        logs = question.prior.rvs((count, len(question.space.names)), drawn)
        shown, own = _shown(density, jnp.asarray(np.exp(logs)))
        return Brute(logs, np.asarray(shown), np.asarray(own + density.covariance))

    def weights(self, measured: np.ndarray) -> np.ndarray:
        """Of each soil, given measured numbers (m,); their sum is 1."""
        off = measured - self.shown
        away = (off * np.linalg.solve(self.covariance, off[:, :, None])[:, :, 0]).sum(axis=1)
        logs = -0.5 * (away + np.linalg.slogdet(self.covariance)[1])
        weights = np.exp(logs - logs.max())
        return weights / weights.sum()

    def below(self, weights: np.ndarray, truth: np.ndarray) -> np.ndarray:
        """Shares (q,) of the posterior below a soil's ln p (q,)."""
        return weights @ (self.logs < truth)

    def quantiles(self, weights: np.ndarray, shares) -> np.ndarray:
        """Of ln p, (shares, q)."""
        found = []
        for column in self.logs.T:
            order = np.argsort(column)
            found.append(np.interp(shares, np.cumsum(weights[order]), column[order]))
        return np.array(found).T


@eqx.filter_jit
def _shown(density: Density, values: Array) -> tuple[Array, Array]:
    return jax.lax.map(density.shown, values, batch_size=128)


# ---------------------------------------------------------------- the sampler


def random_walk(density: Density, begin: np.ndarray, spread: np.ndarray, steps: int) -> np.ndarray:
    """Metropolis' chains of y (c, d, p) from `begin` (c, p), for a posterior whose covariance is
    about `spread` (p, p)."""
    root = np.linalg.cholesky(spread) * 2.38 / np.sqrt(len(spread))
    return np.asarray(_walk(density, jnp.asarray(begin), jnp.asarray(root), steps))


@eqx.filter_jit
def _walk(density: Density, y: Array, root: Array, steps: int) -> Array:
    def step(state, key):
        y, height = state
        first, second = jax.random.split(key)
        other = y + jax.random.normal(first, y.shape) @ root.T
        found = jax.vmap(density)(other)
        taken = jnp.log(jax.random.uniform(second, height.shape)) < found - height
        y, height = jnp.where(taken[:, None], other, y), jnp.where(taken, found, height)
        return (y, height), y

    keys = jax.random.split(jax.random.PRNGKey(1), steps)
    return jnp.swapaxes(jax.lax.scan(step, (y, jax.vmap(density)(y)), keys)[1], 0, 1)


def agreement(question: Question, density: Density, brute: Brute, steps: int) -> dict:
    """NUTS beside brute force and a random walk, of what was measured."""
    start = question.best()
    clock = time.process_time()
    folder = reporting.CACHE / f"posterior_{time.time_ns()}"
    draws = sample(density, start, {}, 0, folder, for_terminal())
    spent = time.process_time() - clock
    logs = np.log(values_of(density, draws.y))
    flat = logs.reshape(-1, logs.shape[-1])
    weights = brute.weights(question.problem.measured)
    exact, width = brute.quantiles(weights, QUANTILES), flat.std(axis=0)
    _, ess = mixing(draws.y)
    begin, spread = draws.y[:, 0], np.cov(draws.y.reshape(-1, draws.y.shape[-1]).T)
    random_walk(density, begin, spread, steps)  # compiles
    clock = time.process_time()
    walked = random_walk(density, begin, spread, steps)
    walking = time.process_time() - clock
    return {
        "brute_force_effective": float(1 / (weights**2).sum()),
        "quantiles_apart": (np.abs(np.quantile(flat, QUANTILES, axis=0) - exact) / width).tolist(),
        "nuts": {"seconds": spent, "least_ess": float(ess.min()),
                 "diverging": int(draws.diverging.sum())},
        "walk": {"seconds": walking, "least_ess": float(mixing(walked)[1].min())},
        "grain_learning": filtered(question, density, brute),
    }  # fmt: skip


def filtered(question: Question, density: Density, brute: Brute) -> dict:
    """GrainLearning's iterative Bayesian filter (Cheng et al. 2019, Comput. Methods Appl. Mech.
    Eng. 350, 268) on the same density; empty where it is not installed.

    Its samples are uniform in a box and its errors equal shares of what was observed, so it gets
    quantiles of the prior in place of parameters, and whitened residuals in place of features.
    """
    try:
        from grainlearning import (  # pyright: ignore[reportMissingImports]
            BayesianCalibration,
            DynamicSystem,
        )
    except ImportError:
        return {}
    names, prior = question.space.names, question.prior
    mean, own = density.shown(jnp.asarray(question.space.start()))
    whitening = np.linalg.inv(np.linalg.cholesky(np.asarray(density.covariance + own)))

    observed = 1.0 + np.arange(len(mean))

    def simulate(calibration) -> None:
        share = np.clip(calibration.system.param_data, 1e-9, 1 - 1e-9)
        shown = np.asarray(_shown(density, jnp.asarray(np.exp(prior.ppf(share))))[0])
        off = (shown - question.problem.measured) @ whitening.T
        calibration.system.set_sim_data((observed * (1 + UNIT * off))[:, :, None])

    calibration = BayesianCalibration.from_dict({
        "num_iter": 10, "callback": simulate, "save_fig": -1,
        "system": {
            "system_type": DynamicSystem, "model_name": "response", "param_names": [*names],
            "param_min": [0.0] * len(names), "param_max": [1.0] * len(names),
            "num_samples": FILTERED, "obs_data": observed[:, None], "ctrl_data": [0.0],
            "sigma_tol": UNIT**2,
        },
        "inference": {"Bayes_filter": {"ess_target": 0.3},
                      "sampling": {"max_num_components": 2, "random_state": 0}},
    })  # fmt: skip
    clock = time.process_time()
    calibration.run()
    spent = time.process_time() - clock
    weights = np.asarray(calibration.inference.posterior)
    share = calibration.system.param_data[: len(weights)]
    found = replace(brute, logs=prior.ppf(np.clip(share, 1e-9, 1 - 1e-9)))
    exact = brute.weights(question.problem.measured)
    width = np.sqrt(exact @ (brute.logs - exact @ brute.logs) ** 2)
    apart = found.quantiles(weights, QUANTILES) - brute.quantiles(exact, QUANTILES)
    return {"seconds": spent, "least_ess": float(1 / (weights**2).sum()),
            "iterations": calibration.num_iter, "samples": FILTERED,
            "quantiles_apart": (np.abs(apart) / width).tolist()}  # fmt: skip


# ---------------------------------------------------------------- calibration of ranks


def ranks(brute: Brute, density: Density, question: Question, count: int) -> dict:
    """Shares of the posterior below the truth, of soils whose numbers the response gave."""
    drawn = np.random.default_rng(11)
    truths = Brute.of(question, density, count, 12)
    found, effective = [], []
    for truth, shown, covariance in zip(truths.logs, truths.shown, truths.covariance, strict=True):
        weights = brute.weights(drawn.multivariate_normal(shown, covariance))
        found.append(brute.below(weights, truth))
        effective.append(1 / (weights**2).sum())
    tests = [kstest(column, "uniform").pvalue for column in np.array(found).T]
    return {"soils": count, "p": tests, "least_effective": float(np.min(effective))}


# ---------------------------------------------------------------- the page


def share_of(inside: np.ndarray) -> str:
    """The share that holds, with its 95 % interval, in words."""
    found = binomtest(int(inside.sum()), len(inside)).proportion_ci(method="wilson")
    return f"{100 * inside.mean():.0f} % ({100 * found.low:.0f} to {100 * found.high:.0f})"


def markdown(found: dict, names: Sequence[str], origin: dict) -> str:
    agreed, ranked = found["agreement"], found["ranks"]
    apart = np.array(agreed["quantiles_apart"])
    samplers = [
        [name, f"{row['seconds']:.0f}", f"{row['least_ess']:.0f}",
         f"{row['least_ess'] / row['seconds']:.1f}"]
        for name, row in (("NUTS", agreed["nuts"]), ("random walk", agreed["walk"]),
                          ("GrainLearning", agreed["grain_learning"]))
        if row
    ]  # fmt: skip
    parameters = [
        [name, *(f"{100 * column:.0f}" for column in apart[:, i]), f"{ranked['p'][i]:.2f}"]
        for i, name in enumerate(names)
    ]
    return (
        "# Posteriors\n\n"
        "Draws are compared with brute force, which weighs soils of the prior "
        f"({agreed['brute_force_effective']:.0f} effective ones for the bundled soil's targets, "
        f"at least {ranked['least_effective']:.0f} for {ranked['soils']} hidden soils of the "
        "prior, whose numbers are the response's with all its errors).\n\n"
        + reporting.table(("sampler", "seconds of processor time", "least effective draws",
                           "a second"), samplers)
        + "\nSeconds of NUTS are those with compiling and warm-up; the random walk begins with "
        "the posterior's own covariance." + _of_filter(agreed["grain_learning"]) + "\n\n"
        + reporting.table(
            ("parameter", "5 % quantile of draws off, in hundredths of a deviation", "50 %",
             "95 %", "ranks of hidden soils: p"), parameters)
        + reporting.footer(origin)
    )  # fmt: skip


def _of_filter(found: dict) -> str:
    if not found:
        return ""
    apart = 100 * np.max(found["quantiles_apart"])
    return (
        f" GrainLearning's filter weighs {found['samples']} samples in each of "
        f"{found['iterations']} iterations; its quantiles are up to {apart:.0f} hundredths of a "
        "deviation off those of brute force."
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of brute force")
    drawn = parser.parse_args().drawn
    reporting.configure()
    question = question_of(load_lab(bundled_lab()), PRESETS["standard"])
    density = question.density(question.own_error(), [])
    brute = Brute.of(question, density, drawn, 4)
    found = {
        "agreement": agreement(question, density, brute, STEPS),
        "ranks": ranks(brute, density, question, HIDDEN),
    }
    origin = reporting.provenance()
    reporting.write_content("posterior", {**origin, **found})
    reporting.write_section("posterior", markdown(found, question.space.names, origin))


if __name__ == "__main__":
    main()
