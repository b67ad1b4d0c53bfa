"""Is the noise of a diagnosis as wide as it should be?  Cases with nothing hidden tell.

Each case is fitted with base parameters alone.  Under every prior of the amplitudes of scatter the
same fits are weighed anew: how likely are the means, how often does the gate see a gap at 5 %, and
how often once an effect of the library, at a signal-to-noise of 4 as the bank predicts it, is added
to the measured mean.  Null distributions are simulated for each prior.

    python benchmarks/noise.py                  # makes 60 cases first: half an hour
    python benchmarks/noise.py --given FOLDER   # cases/*/lab.toml with nothing hidden

Writes benchmarks/results/noise.json and .md.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import reporting

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.comparison import noise as noise_model
from calibrate.discrepancy.comparison.evidence import log_base, singles
from calibrate.discrepancy.comparison.fits import fitted_base
from calibrate.discrepancy.comparison.generated import SampleGenerator, plan_of
from calibrate.discrepancy.comparison.lack_of_fit import NullDistributions, simulate, statistics
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import estimate, packing_covariance
from calibrate.discrepancy.comparison.probability_calibration import ALPHA
from calibrate.discrepancy.comparison.projection import project
from calibrate.discrepancy.comparison.refit import Refit
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.discrepancy.comparison.score import lengths
from calibrate.discrepancy.comparison.unspecified_gap import kernel_factors, projected
from calibrate.discrepancy.diagnosis import described
from calibrate.discrepancy.library.description import EmulatedLibrary
from calibrate.discrepancy.library.store import bundled_library, load
from calibrate.discrepancy.model_discrepancy import load as load_discrepancy
from calibrate.io.lab import load_lab
from calibrate.validation import run

CASES = 60
FIRST_SEED = 1_300_000  # of packings; not those of withheld cases
SNR = 4.0
REACH = 1.5  # of the bank's, beyond which no effect is put in
DRAWS = 250  # of null distributions
PRIORS = ((0.1, 4.0), (0.25, 2.0), (0.25, 4.0), (0.25, 8.0), (0.5, 4.0))  # sd of ln a, freedom
HEADER = ["sd of ln a", "freedom", "ln density", "gap seen, nothing hidden", "gap seen, an effect",
          "and that effect first"]  # fmt: skip


@dataclass(frozen=True, eq=False)
class Fitted:
    """A case with nothing hidden and its base fit; the description is linear, with its errors at
    that fit."""

    description: Linearised
    measured: Measured
    packing: np.ndarray
    base: Refit


def main() -> None:
    parser = argparse.ArgumentParser(description="The noise model on cases with nothing hidden.")
    parser.add_argument("--given", type=Path, help="a folder with such cases")
    parser.add_argument("--seed", type=int, default=2323, help="of cases that are made")
    parser.add_argument("--discrepancy", type=Path, help="what `calibrate discrepancy` wrote")
    given = parser.parse_args()
    reporting.configure()
    ready = EmulatedLibrary.of(load(bundled_library()))
    known = load_discrepancy(given.discrepancy, ready) if given.discrepancy else None
    folder = given.given or made(ready, given.seed)
    fits = [fitted(path, ready, known) for path in run.case_folders(folder)]
    rows = [under(fits, *prior) for prior in PRIORS]
    content = {"cases": len(fits), "signal_to_noise": SNR, "rows": rows}
    reporting.write("noise", {**content, **reporting.provenance()}, page(content))


def made(ready: EmulatedLibrary, seed: int) -> Path:
    """Cases with nothing hidden, made once."""
    folder = reporting.CACHE / "noise"
    run.generate(folder, ready, {"none": CASES}, seed, for_terminal(), FIRST_SEED)
    return folder


def fitted(case: Path, ready: EmulatedLibrary, known) -> Fitted:
    _, d, measured = described(load_lab(case / "lab.toml"), ready, 0, known)
    packing = packing_covariance(d)
    base = fitted_base(d, measured, packing, 1.0)[1]
    print(f"{case.name}: {base.objective:.0f} left", flush=True)
    wrong = d.wrong_at(base.delta, base.strengths)
    return Fitted(replace(d, emulator=None, wrong=wrong), measured, packing, base)


def under(fits: list[Fitted], sd: float, freedom: float) -> dict:
    """What the cases say under one prior."""
    noise_model.PRIOR_SD_LN_AMPLITUDE, noise_model.PRIOR_FREEDOM = sd, freedom
    first = fits[0]
    world = SampleGenerator(first.description, plan_of(first.measured), first.packing)
    null = simulate(world, 0, DRAWS)
    alone = [weighed(fit, null, np.zeros(len(fit.base.values))) for fit in fits]
    added = [(k, weighed(fit, null, change)) for fit in fits for k, change in effects(fit)]
    found = {
        "sd_of_ln_amplitude": sd,
        "freedom": freedom,
        "ln_density": sum(density for density, _, _ in alone),
        "gap_seen_in_nothing": float(np.mean([p <= ALPHA for _, p, _ in alone])),
        "gap_seen_in_an_effect": float(np.mean([p <= ALPHA for _, (_, p, _) in added])),
        "named": float(np.mean([p <= ALPHA and best == k for k, (_, p, best) in added])),
        "added": len(added),
    }
    print(found, flush=True)
    return found


def effects(fit: Fitted) -> Iterator[tuple[int, np.ndarray]]:
    """Effects and what they change (m,) at `SNR`, by the covariance of simulated specimens."""
    d = fit.description
    covariance = SampleGenerator(d, plan_of(fit.measured), fit.packing).mean_covariance
    design = project(fit.base.working, d.base_slopes, d.prior_sd, d.effect_slopes, covariance)
    for k, strength in enumerate(SNR / lengths(design.effects)):
        if strength < REACH * d.effects[k].reach and d.effects[k].name != "load_cell_offset":
            yield k, strength * fit.base.effect_slopes[:, k]


def weighed(fit: Fitted, null: NullDistributions, change: np.ndarray) -> tuple[float, float, int]:
    """ln density of a case, p of its gap, and the likeliest effect, once `change` is added."""
    d, base = fit.description, fit.base
    noise = estimate(d, fit.measured, fit.packing, d.prior_sd**2)
    design = project(
        base.working + change, base.base_slopes, d.prior_sd, base.effect_slopes, noise.mean
    )
    shapes = projected(kernel_factors(d.features, noise.specimen), design.operator)
    found = statistics(design.residual, design.effects, d.one_sided, shapes)
    best = int(np.argmax(singles(design, d.one_sided)))
    return log_base(design), null.before.p_value(found), best


def page(content: dict) -> str:
    """The table."""
    best = max(row["ln_density"] for row in content["rows"])
    rows = [
        [
            f"{row['sd_of_ln_amplitude']:g}",
            f"{row['freedom']:g}",
            f"{row['ln_density'] - best:+.0f}",
            *(f"{100 * row[key]:.0f} %" for key in ("gap_seen_in_nothing", "gap_seen_in_an_effect",
                                                    "named")),
        ]
        for row in content["rows"]
    ]  # fmt: skip
    return (
        "# The noise of a diagnosis\n\n"
        f"{content['cases']} cases of this simulator with nothing hidden, each with all effects in "
        f"turn at a predicted signal-to-noise of {content['signal_to_noise']:g} "
        f"({content['rows'][0]['added']} in all).\n\n"
        + reporting.table(HEADER, rows)
        + reporting.footer(reporting.provenance())
    )


if __name__ == "__main__":
    main()
