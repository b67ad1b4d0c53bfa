"""Posteriors: do draws agree with brute force, are they calibrated, do intervals hold the truth?

Brute force weighs DRAWN soils of the prior, with the density that is sampled:

- the bundled soil's targets by the library alone: quantiles of NUTS beside brute force, and
  effective draws a second of processor time beside a random walk that is given the posterior's own
  covariance to step by (Metropolis; Roberts, Gelman and Gilks 1997);
- simulation-based calibration (Talts et al. 2018, arXiv 1804.06788): HIDDEN soils of the prior,
  numbers as the response with all its errors would give them, ranks of the truth in the posterior,
  tested by Kolmogorov and Smirnov;
- the 48 sound soils of studies/sound_cases.py, which were simulated with packings, porosities and
  roundings of their own: how often intervals hold the truth.

    python -m verification.posterior        10 minutes of a core

Writes verification/results/posterior.md.
"""

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import binomtest, kstest

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library import stand_in
from calibrate.discrepancy.library.design import CENTRE, SETTINGS, SOIL_PRIOR_SD, SPEEDS
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.posterior import Density, Question
from calibrate.inference.sampling import Draws, mixing, sample, values_of
from calibrate.io.lab import Lab, ParameterChoice, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation.resolution import PRESETS, Preset, specimen
from calibrate.simulation.specimens import Seeds
from studies import open_cases, sound_cases
from studies.sealed.plan import PACE, SMOOTHING, WithheldCase
from studies.sealed.run import planned_case
from verification import reporting

DRAWN, HIDDEN = 100_000, 200
QUANTILES = (0.05, 0.5, 0.95)
STEPS = 20_000  # of each random walk
READINGS = 3  # of a record, over which noise is averaged
HOLDS = (0.5, 0.9)  # shares of draws whose intervals are asked


@dataclass(frozen=True)
class Nowhere:
    """A campaign that simulates nothing."""

    folder: Path
    progress: object
    apparatus: tuple = ()


def question_of(lab: Lab, preset: Preset) -> Question:
    """What is asked of the bundled library."""
    work = Nowhere(reporting.CACHE, for_terminal())
    response, why = served(lab, preset, None, base_soil(lab), work)  # pyright: ignore[reportArgumentType]
    if response is None:
        raise SystemExit(why)
    seeds = Seeds.of(0, preset.packings, preset.fresh)
    return Question.of(lab, base_soil(lab), response, work, seeds)  # pyright: ignore[reportArgumentType]


def as_in_sound_cases(lab: Lab, porosity: float) -> Question:
    """The same of beds as the sound soils were simulated with: nearly without roundings."""
    preset = replace(PRESETS["standard"], spheres=1100, rate_in_mould=PACE * SPEEDS[0])
    usual = specimen(lab, preset).porosity
    particles = replace(lab.particles, porosity=None if usual is None else usual + porosity)
    settings = stand_in._settings

    def smooth(*given) -> list[float]:
        known = dict(zip(SETTINGS, settings(*given), strict=True))
        return [*{**known, "smoothing": SMOOTHING}.values()]

    with mock.patch.object(stand_in, "_settings", smooth):
        return question_of(replace(lab, particles=particles), preset)


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


def random_walk(density: Density, draws: Draws, steps: int) -> np.ndarray:
    """Metropolis' chains (c, d, p) from draws of the posterior, with its own covariance."""
    flat = draws.y.reshape(-1, draws.y.shape[-1])
    root = np.linalg.cholesky(np.cov(flat.T)) * 2.38 / np.sqrt(flat.shape[1])
    return np.asarray(_walk(density, jnp.asarray(draws.y[:, 0]), jnp.asarray(root), steps))


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
    random_walk(density, draws, 10)
    clock = time.process_time()
    walked = random_walk(density, draws, steps)
    walking = time.process_time() - clock
    return {
        "brute_force_effective": float(1 / (weights**2).sum()),
        "quantiles_apart": (np.abs(np.quantile(flat, QUANTILES, axis=0) - exact) / width).tolist(),
        "nuts": {"seconds": spent, "least_ess": float(ess.min()),
                 "diverging": int(draws.diverging.sum())},
        "walk": {"seconds": walking, "least_ess": float(mixing(walked)[1].min())},
    }  # fmt: skip


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


# ---------------------------------------------------------------- soils that were simulated


def sound(folder: Path) -> list[tuple[WithheldCase, np.ndarray]]:
    """The sound soils, and H and F (specimens, 2), mm and N, as each one's records show them."""
    found = []
    for path in sorted((folder / "cases").glob("*/lab.toml")):
        lab, rows = load_lab(path), []
        pressed, crushed = (
            [curve for curve in lab.curves if curve.test == test.called] for test in lab.tests
        )
        low, high = lab.tests[0].guides()
        for press, crush in zip(pressed, crushed, strict=True):
            top = int(np.argmax(press.force_n)) + 1
            rising = np.maximum.accumulate(press.force_n[:top])
            start, end = np.interp([low, high], rising, press.displacement_mm[:top])
            smooth = np.convolve(crush.force_n, np.full(READINGS, 1 / READINGS), "valid")
            rows.append([end - start, smooth.max()])
        found.append((planned_case(folder, path.parent.name), np.array(rows)))
    return found


def coverage(folder: Path, count: int) -> dict:
    """How often intervals hold the parameters of soils that were simulated."""
    cases, lab = sound(folder), load_lab(bundled_lab())
    scatter = np.mean([np.var(np.log(rows), axis=0, ddof=1) for _, rows in cases], axis=0) ** 0.5
    choices = {n: ParameterChoice(CENTRE[n], None, None, sd, None)
               for n, sd in SOIL_PRIOR_SD.items()}  # fmt: skip
    lab = replace(lab, parameters={**lab.parameters, **choices})
    below, surprise = [], []
    for porosity in sorted({case.porosity for case, _ in cases}):
        question = as_in_sound_cases(lab, porosity)
        density = question.density(question.own_error(), [])
        brute = Brute.of(question, replace(density, covariance=jnp.zeros((2, 2))), count, 5)
        for case, rows in cases:
            if case.porosity != porosity:
                continue
            measured = rows.mean(axis=0)
            own = np.diag((scatter * measured) ** 2 / len(rows))
            known = replace(brute, covariance=brute.covariance + own)
            weights = known.weights(measured)
            truth = np.log([case.soil[name] for name in question.space.names])
            below.append(known.below(weights, truth))
            surprise.append(1 / (weights**2).sum())
    found = np.array(below)
    held = {
        str(share): [
            _share(np.abs(column - 0.5) < share / 2) for column in found.T
        ]
        for share in HOLDS
    }  # fmt: skip
    return {
        "soils": len(found), "scatter": scatter.tolist(), "held": held,
        "p": [kstest(column, "uniform").pvalue for column in found.T],
        "least_effective": float(np.min(surprise)), "names": list(SOIL_PRIOR_SD),
    }  # fmt: skip


def share_of(inside: np.ndarray) -> str:
    """The share that holds, with its 95 % interval, in words."""
    return _in_words(_share(inside))


def _share(inside: np.ndarray) -> dict:
    """A share with its 95 % interval."""
    found = binomtest(int(inside.sum()), len(inside)).proportion_ci(method="wilson")
    return {"share": float(inside.mean()), "low": found.low, "high": found.high}


# ---------------------------------------------------------------- the page


def markdown(found: dict, origin: dict) -> str:
    agreed, ranked, held = found["agreement"], found["ranks"], found["coverage"]
    names, apart = held["names"], np.array(agreed["quantiles_apart"])
    samplers = [
        [name, f"{row['seconds']:.0f}", f"{row['least_ess']:.0f}",
         f"{row['least_ess'] / row['seconds']:.1f}"]
        for name, row in (("NUTS", agreed["nuts"]), ("random walk", agreed["walk"]))
    ]  # fmt: skip
    parameters = [
        [name, *(f"{100 * column:.0f}" for column in apart[:, i]), f"{ranked['p'][i]:.2f}",
         *(_in_words(held["held"][str(share)][i]) for share in HOLDS), f"{held['p'][i]:.2f}"]
        for i, name in enumerate(names)
    ]  # fmt: skip
    return (
        "# Posteriors\n\n"
        "Draws are compared with brute force, which weighs soils of the prior "
        f"({agreed['brute_force_effective']:.0f} effective ones for the bundled soil's targets, "
        f"at least {ranked['least_effective']:.0f} for {ranked['soils']} hidden soils of the "
        "prior, whose numbers are the response's with all its errors).\n\n"
        + reporting.table(("sampler", "seconds of processor time", "least effective draws",
                           "a second"), samplers)
        + "\nSeconds of NUTS are those with compiling and warm-up; the random walk begins with "
        "the posterior's own covariance.\n\n"
        + reporting.table(
            ("parameter", "5 % quantile of draws off, in hundredths of a deviation", "50 %",
             "95 %", "ranks of hidden soils: p", "50 % intervals hold of simulated soils",
             "90 % intervals", "their ranks: p"), parameters)
        + f"\n{held['soils']} soils were simulated on four packings each with porosities and "
        "roundings of their own; the library alone judged them, by depression depth and crushing "
        f"force, which scatter by {100 * held['scatter'][0]:.1f} % and "
        f"{100 * held['scatter'][1]:.1f} % from specimen to specimen.\n"
        + reporting.footer(origin)
    )  # fmt: skip


def _in_words(row: dict) -> str:
    return f"{100 * row['share']:.0f} % ({100 * row['low']:.0f} to {100 * row['high']:.0f})"


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of brute force")
    parser.add_argument("--part", choices=("agreement", "ranks", "coverage"), help="only this one")
    chosen = parser.parse_args()
    reporting.configure()
    found = {part: reporting.earlier("posterior", part) for part in ("agreement", "ranks",
                                                                     "coverage")}  # fmt: skip
    if chosen.part in (None, "agreement", "ranks"):
        question = question_of(load_lab(bundled_lab()), PRESETS["standard"])
        density = question.density(question.own_error(), [])
        brute = Brute.of(question, density, chosen.drawn, 4)
        if chosen.part != "ranks":
            found["agreement"] = agreement(question, density, brute, STEPS)
        if chosen.part != "agreement":
            found["ranks"] = ranks(brute, density, question, HIDDEN)
    if chosen.part in (None, "coverage"):
        open_cases.unpack(("sound_cases.tar.xz",))
        found["coverage"] = coverage(sound_cases.WORK, chosen.drawn)
    origin = reporting.provenance()
    print(found)
    if all(found.values()):
        reporting.write_content("posterior", {**origin, **found})
        reporting.write_section("posterior", markdown(found, origin))
    else:
        reporting.write_content("posterior", {**origin, **found})


if __name__ == "__main__":
    main()
