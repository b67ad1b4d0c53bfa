"""Do fits, posteriors and predictions hold for soils that nobody chose?

Soils of the bundled lab file's prior, as far as its library of runs reaches, are simulated at
`standard`: MEASURED specimens are the laboratory's, whose depth H and force F a lab file gets, and
one is held back.  Of each soil:

- the fit: whether it meets both numbers, on its own packings and on FRESH ones that it has not
  seen, and how many runs it takes before these;
- the posterior of all parameters, given these runs, by brute force (`verification.posterior`):
  which share of it lies below the hidden values;
- the prediction of the specimen that was held back: H, F and points of both curves.

    python -m verification.hidden_soils                   some four hours of a core
    python -m verification.hidden_soils --soils 0 1 2

Soils that verification/results/hidden_soils.json holds are not made again; runs are kept in
results/benchmarks.  Writes a section of verification/results/posterior.md after each soil.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.stats import kstest

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.stand_in import served
from calibrate.inference.calibration import Calibrated, calibrate
from calibrate.inference.curve_points import CurvePoints
from calibrate.inference.draws import laboratory_scatter
from calibrate.inference.on_response import OnResponse
from calibrate.inference.posterior import Density, Question
from calibrate.inference.prediction import Prediction, by_response
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Run, specimens
from calibrate.simulation.joint import AbstractCampaign
from calibrate.simulation.resolution import PRESETS
from calibrate.simulation.specimens import Seeds
from calibrate.verbs.posterior import shown_by_fit
from verification import reporting
from verification.made_lab import LABORATORY, of_targets
from verification.posterior import question_of, share_of

SOILS, MEASURED, FRESH = 20, 3, 4
SETS = 4  # of the laboratory's packings, and of those of fits, which soils take in turn
DRAWN = 100_000  # soils of the prior that are weighed
PREDICTED = 200  # of these, drawn by weight, of which tests are predicted
STANDARD = replace(PRESETS["standard"], fresh=FRESH)
HELD = 0.9  # share of specimens, or of a posterior, that intervals are to hold


@dataclass(frozen=True, eq=False)
class Prior:
    """Soils that a prior gave: ln p (n, p), and the features (n, m) that the response has of
    them."""

    logs: np.ndarray
    features: np.ndarray

    @staticmethod
    def of(question: Question, density: Density, count: int) -> "Prior":
        drawn = np.random.default_rng(20)
        logs = question.prior.rvs((count, len(question.space.names)), drawn)
        return Prior(logs, np.asarray(_features(density, jnp.asarray(np.exp(logs)))))

    def weights(self, density: Density) -> np.ndarray:
        """Of each soil (n,), given what was measured and what runs show; their sum is 1."""
        found = np.asarray(
            _likelihoods(density, jnp.asarray(self.logs), jnp.asarray(self.features))
        )
        weights = np.exp(found - found.max())
        return weights / weights.sum()


@eqx.filter_jit
def _features(density: Density, values: Array) -> Array:
    return jax.lax.map(density.features, values, batch_size=128)


@eqx.filter_jit
def _likelihoods(density: Density, logs: Array, features: Array) -> Array:
    def one(both: tuple[Array, Array]) -> Array:
        mean, own = density.corrected(*both)
        total = density.covariance + own
        off = density.measured - mean
        return -0.5 * (off @ jnp.linalg.solve(total, off) + jnp.linalg.slogdet(total)[1])

    return jax.lax.map(one, (logs, features), batch_size=128)


# ---------------------------------------------------------------- one soil


@dataclass(frozen=True, eq=False)
class Laboratory:
    """A hidden soil's lab file, the numbers that each specimen showed (`CurvePoints`), (n, m), and
    what simulates and stands for its tests."""

    lab: Lab
    numbers: np.ndarray
    points: CurvePoints
    work: AbstractCampaign
    response: OnResponse

    @staticmethod
    def made(number: int, values: dict[str, float], folder: Path) -> "Laboratory":
        """That of soil `number`, with parameters by name, SI."""
        bundled = load_lab(bundled_lab())
        work = specimens.campaign(bundled, STANDARD, folder, for_terminal())
        first = LABORATORY + 100 * (number % SETS)
        soil = with_values(base_soil(bundled), values)
        what = f"laboratory of soil {number}"
        (runs,) = work.runs([soil], range(first, first + MEASURED + 1), what)
        _all_finished(runs, number)
        points = CurvePoints.of(work)
        lab = of_targets(folder / "hidden_soils" / f"{number:02d}" / "lab.toml", runs[:MEASURED])
        own = specimens.campaign(lab, STANDARD, folder, for_terminal())
        response, why = served(lab, STANDARD, None, base_soil(lab), own)
        if response is None:
            raise SystemExit(why)
        read = np.array([points.read(run) for run in runs])
        return Laboratory(lab, read, points, own, response)

    def fitted(self, seed: int) -> Calibrated:
        """As `calibrate fit` does, with fewer fresh packings."""
        base = base_soil(self.lab)
        return calibrate(self.lab, STANDARD, None, base, seed, self.work, self.response)

    def question(self, seed: int) -> Question:
        """As `calibrate posterior` asks it."""
        seeds = Seeds.of(seed, STANDARD.packings, STANDARD.fresh)
        return Question.of(self.lab, base_soil(self.lab), self.response, self.work, seeds)

    def predicted(self, prior: Prior, weights: np.ndarray, question: Question) -> Prediction:
        """Of its own tests, as `calibrate predict` does."""
        drawn = np.random.default_rng(21).choice(len(weights), PREDICTED, p=weights)
        soils = [question.space.soil(np.exp(prior.logs[number])) for number in drawn]
        return by_response(self.response, None, soils, self.points, 0, laboratory_scatter(question))


def _all_finished(runs: list[Run], number: int) -> None:
    failures = [run.failure for run in runs if run.failure]
    if failures:
        raise RuntimeError(f"soil {number}: a laboratory specimen failed: {failures[0]}")


def entry(number: int, hidden: np.ndarray, prior: Prior, drawn: Question, folder: Path) -> dict:
    """What came of one soil at ln p of `hidden` (p,)."""
    names = drawn.space.names
    truth = dict(zip(names, np.exp(hidden).tolist(), strict=True))
    made, seed = Laboratory.made(number, truth, folder), number % SETS
    done = made.fitted(seed)
    question = made.question(seed)
    shown = tuple(shown_by_fit(question, done, made.work))
    weights = prior.weights(question.density(question.own_error(), shown))
    band = made.predicted(prior, weights, question).of_specimens
    held = (made.numbers[-1] > band[0]) & (made.numbers[-1] < band[1])
    inside = {n: bool(x) for n, x in zip(made.points.observables, held, strict=False)}
    curves = {test: float(held[rows][np.isfinite(band[0][rows])].mean())
              for test, rows in made.points.slices().items()}  # fmt: skip
    return {
        "hidden": truth,
        **_fit_row(made, done),
        "below": dict(zip(names, (weights @ (prior.logs < hidden)).tolist(), strict=True)),
        "effective": float(1 / (weights**2).sum()),
        "held_back": {"numbers": inside, "points": curves},
    }


def _fit_row(made: Laboratory, done: Calibrated) -> dict:
    best, setup = done.result.best, done.setup
    decided = [row for row in done.result.history if row["status"] != "explored"]
    names = [feature.name for feature in setup.problem.features]
    fresh = setup.problem.simulated(done.fresh_runs)
    return {
        "free": dict(zip(done.calibration.space.names, best.values.tolist(), strict=True)),
        "met": done.met,
        "evaluations": len(decided),
        "runs": len(setup.seeds.fitted) * len(decided),
        "measured": dict(zip(names, setup.problem.measured.tolist(), strict=True)),
        "fitted": dict(zip(names, best.features.mean(axis=0).tolist(), strict=True)),
        "fresh": dict(zip(names, np.nanmean(fresh, axis=0).tolist(), strict=True)),
        "scatter": dict(zip(names, np.nanstd(fresh, axis=0, ddof=1).tolist(), strict=True)),
        "at_bound": list(done.calibration.space.at_bound(best.values)),
    }


# ---------------------------------------------------------------- the page


def markdown(entries: dict[str, dict], origin: dict) -> str:
    """A row a soil, then how often intervals hold."""
    rows = [_row(number, entry) for number, entry in entries.items()]
    header = ("soil", "free", "met", "runs before fresh packings",
              "H: measured, fitted, fresh ± s.e. (mm)", "F: the same (N)",
              "held back: H, F inside", "points inside")  # fmt: skip
    return (
        "# Hidden soils\n\n"
        f"Soils of the prior at `standard`: {MEASURED} specimens were measured, one was held back; "
        f"fits and {FRESH} fresh packings saw none of them.\n\n"
        + reporting.table(header, rows)
        + "\n" + _summary(list(entries.values())) + "\n"
        + reporting.footer(origin)
    )  # fmt: skip


def _row(number: str, entry: dict) -> list[str]:
    numbers, points = entry["held_back"]["numbers"], entry["held_back"]["points"]
    cells = [
        f"{entry['measured'][n]:.4g}, {entry['fitted'][n]:.4g}, {entry['fresh'][n]:.4g} "
        f"± {entry['scatter'][n] / FRESH**0.5:.2g}"
        for n in entry["measured"]
    ]
    return [
        number, ", ".join(entry["free"]), "yes" if entry["met"] else "NO", str(entry["runs"]),
        *cells, ", ".join("yes" if inside else "NO" for inside in numbers.values()),
        ", ".join(f"{100 * share:.0f} %" for share in points.values()),
    ]  # fmt: skip


def _summary(entries: list[dict]) -> str:
    """Sentences with what all soils came to."""
    below = np.array([list(entry["below"].values()) for entry in entries])
    inside = np.abs(below - 0.5) < HELD / 2
    names = list(entries[0]["below"])
    held = {n: np.array([e["held_back"]["numbers"][n] for e in entries])
            for n in entries[0]["held_back"]["numbers"]}  # fmt: skip
    points = {t: np.array([e["held_back"]["points"][t] for e in entries])
              for t in entries[0]["held_back"]["points"]}  # fmt: skip
    sentences = [
        f"{sum(e['met'] for e in entries)} of {len(entries)} fits meet both numbers; "
        f"at most {max(e['runs'] for e in entries)} runs come before fresh packings, "
        f"{np.median([e['runs'] for e in entries]):.0f} in the middle.",
        *(f"Fresh packings are off by {_off(entries, n)} in {n} (middle, largest)."
          for n in entries[0]["measured"]),
        "90 % intervals of the posterior hold the hidden "
        + ", ".join(f"{n} of {share_of(column)} of soils" for n, column in
                    zip(names, inside.T, strict=True))
        + f", any parameter in {share_of(inside.ravel())}.",
        "Ranks of hidden values are uniform with p = "
        + ", ".join(f"{kstest(column, 'uniform').pvalue:.2f}" for column in below.T) + ".",
        *(f"90 % intervals of specimens hold {n} of {share_of(column)} of those held back."
          for n, column in held.items()),
        *(f"They hold {100 * column.mean():.0f} ± "
          f"{100 * column.std(ddof=1) / len(column) ** 0.5:.0f} % of the points of their {test} "
          "curve." for test, column in points.items() if len(column) > 1),
    ]  # fmt: skip
    return "\n".join(f"- {sentence}" for sentence in sentences) + "\n"


def _off(entries: list[dict], name: str) -> str:
    off = np.abs([e["fresh"][name] / e["measured"][name] - 1 for e in entries])
    return f"{100 * np.median(off):.1f} and {100 * off.max():.1f} %"


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--soils", nargs="+", type=int, default=list(range(SOILS)))
    parser.add_argument("--drawn", type=int, default=DRAWN, help="soils of the prior")
    chosen = parser.parse_args()
    reporting.configure()
    question = question_of(load_lab(bundled_lab()), STANDARD)
    density = question.density(question.own_error(), [])
    shape = (SOILS, len(question.space.names))
    hidden = question.prior.rvs(shape, np.random.default_rng(22))
    prior = Prior.of(question, density, chosen.drawn)
    for number in chosen.soils:
        entries = reporting.earlier("hidden_soils", "entries")
        if str(number) not in entries:
            found = entry(number, hidden[number], prior, question, reporting.CACHE)
            entries[str(number)] = found
            print(number, found, flush=True)
        entries = dict(sorted(entries.items(), key=lambda each: int(each[0])))
        origin = reporting.provenance()
        reporting.write_content("hidden_soils", {**origin, "entries": entries})
        reporting.write_section("posterior", markdown(entries, origin))


if __name__ == "__main__":
    main()
