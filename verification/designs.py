"""Designed experiments beside gradients, on the simulator: `calibrate doe` with a committed table.

    python -m verification.designs                about 20 minutes on two cores

The bundled soil at quick: the paper's sequence (screening, central composite, Box-Behnken, one
factor), slopes of its surfaces against gradients, where both ways of calibrating end, and what
that gives on fresh packings.  Runs are kept in results/benchmarks; a second call resumes.
Writes verification/results/designs.md.
"""

import argparse
from pathlib import Path

import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.designs.comparison import Designed, Enhanced, MethodResult, SlopePair, design
from calibrate.designs.study import ranked
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.reports.study import sentence, short
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from verification import reporting


def markdown(found: Designed, origin: dict) -> str:
    done, compared = found.study, found.comparison
    largest = "; ".join(
        f"{short(name)}: "
        + ", ".join(f"{n} ({screen[n].contribution:.0f} %)" for n in ranked(screen)[:4])
        for name, screen in done.screens.items()
    )
    return (
        f"# Designed experiments and gradients\n\n{sentence(compared)} One gradient of eight "
        f"parameters costs {compared.gradient_runs:.0f} forward runs a packing here.\n\n"
        f"Largest contributions in the screening. {largest}.\n\n"
        "Where each method ended, mean ± one packing:\n\n"
        + _endings(compared.endings)
        + "\nSlopes per unit of ln p of factors that matter by the design's own t test:\n\n"
        + _slopes(compared.slopes)
        + "\nCrushing-force surfaces from fewer points, error (N) at the points left out:\n\n"
        + _enhanced(compared.enhanced)
        + reporting.footer(origin)
    )


def _endings(endings: tuple[MethodResult, ...]) -> str:
    rows = [
        [
            ending.method,
            str(ending.simulations),
            *(_mean(v, m) for m in (0, 1) for v in (ending.fitted, ending.fresh)),
            ", ".join(f"{name} {value:.4g}" for name, value in ending.values.items()),
        ]
        for ending in endings
    ]
    header = ("method", "simulations", "H (mm)", "H fresh", "F (N)", "F fresh", "parameters (SI)")
    return reporting.table(header, rows)


def _mean(values: np.ndarray, m: int) -> str:
    return f"{np.nanmean(values[:, m]):.3f} ± {np.nanstd(values[:, m], ddof=1):.2g}"


def _slopes(pairs: tuple[SlopePair, ...]) -> str:
    rows = [
        [
            pair.design,
            pair.factor,
            short(pair.observable),
            f"{pair.surface:.3g} ± {pair.surface_se:.2g}",
            f"{pair.gradient:.3g} ± {pair.gradient_se:.2g}",
            "yes" if pair.agree else f"no: {pair.why()}",
        ]
        for pair in pairs
        if pair.matters
    ]
    return reporting.table(("design", "factor", "of", "surface", "gradient", "agree"), rows)


def _enhanced(rows: tuple[Enhanced, ...]) -> str:
    cells = [
        [str(row.points), *(_error(e) for e in (row.values_only, row.with_gradient))]
        for row in rows
        if np.isfinite(row.with_gradient)
    ]
    return reporting.table(("points", "values alone", "with the gradient at the centre"), cells)


def _error(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "not fixed"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0, help="choice of packings")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    chosen = parser.parse_args()
    reporting.configure()
    lab, quick = load_lab(bundled_lab()), PRESETS["quick"]
    work = Campaign(virtual_lab(lab, quick), specimen(lab, quick), chosen.folder, for_terminal())
    found = design(lab, quick, base_soil(lab), chosen.seed, work)
    reporting.write_section("designs", markdown(found, reporting.provenance()))


if __name__ == "__main__":
    main()
