"""Do whole curves agree, not only two numbers?  A fit at standard to curves made at fine.

Hidden parameters are tested on beds of 10 000 spheres, three packings; the curves of both tests
make a lab file.  `calibrate fit --preset standard` fits it.  The mean curve of its fresh packings
is compared with the mean measured one, on loading:

    error = sum |F - F_measured| / sum F_measured
    R2 = 1 - sum (F - F_measured)^2 / sum (F_measured - mean)^2

with the standard error of sum F over sum F_measured, by the scatter of both sets of specimens.

Chen et al. 2023 state 2.8 % and 93.5 % for the confined, 3.7 % and 94.2 % for the unconfined test.

    python -m verification.whole_curves          some 25 minutes on two cores

Runs are kept in results/benchmarks; a second call resumes.  Writes a section of
verification/results/fresh_packings.md and a picture in results/benchmarks.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation import Campaign, Run
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from verification import reporting
from verification.made_lab import LABORATORY, of_curves, scaled

HIDDEN = {"shear_modulus": 0.8, "surface_energy": 1.2, "plasticity_ratio": 0.9}
REPEATS = 3
PUBLISHED = {"confined": (0.02782, 0.93509), "unconfined": (0.03674, 0.942)}
LAST = {"confined": np.inf, "unconfined": 14.0}  # mm
POINTS = 200
HEADER = ("test", "error", "R2", "error (published)", "R2 (published)",
          "error of one fresh packing", "of one measured")  # fmt: skip
PICTURE = reporting.CACHE / "whole_curves.png"
Curves = list[np.ndarray]  # (points, 2): mm, N


def measured(folder: Path) -> tuple[Lab, list[Run]]:
    """The laboratory of the hidden parameters, and its runs."""
    lab, fine = load_lab(bundled_lab()), PRESETS["fine"]
    work = Campaign(virtual_lab(lab, fine), specimen(lab, fine), folder, for_terminal())
    seeds = range(LABORATORY, LABORATORY + REPEATS)
    runs = work.runs([scaled(base_soil(lab), HIDDEN)], seeds, "laboratory at fine")[0]
    return of_curves(folder / "whole_curves" / "lab.toml", runs), runs


def fitted(lab: Lab, seed: int, folder: Path) -> dict:
    """What the command finds."""
    out = folder / "whole_curves" / f"fit-{seed}"
    command = [sys.executable, "-m", "calibrate", "fit", str(lab.file), "--preset", "standard"]
    subprocess.run([*command, "--seed", str(seed), "--out", str(out)], check=True)
    return json.loads((out / "result.json").read_text(encoding="utf-8"))


def loading(curve: np.ndarray, last: float) -> np.ndarray:
    """A curve up to its largest displacement, or `last` (mm)."""
    rising = curve[: int(np.argmax(curve[:, 0])) + 1]
    return rising[(rising[:, 0] >= 0) & (rising[:, 0] <= last)]


def forces(curves: Curves, at: np.ndarray, last: float) -> np.ndarray:
    """Forces (curves, points) at the displacements `at` (mm)."""
    return np.stack([np.interp(at, *loading(curve, last).T) for curve in curves])


def compared(real: Curves, fresh: Curves, last: float) -> dict:
    """Errors and R2 of the mean of fresh curves against the mean of real ones."""
    ends = [loading(curve, last)[-1, 0] for curve in (*real, *fresh)]
    at = np.linspace(0.0, min(ends), POINTS)
    wanted, found = forces(real, at, last), forces(fresh, at, last)
    truth = wanted.mean(axis=0)

    def error(force: np.ndarray) -> float:
        return float(np.abs(force - truth).sum() / truth.sum())

    mean = found.mean(axis=0)
    shares = (each.sum(axis=1) / truth.sum() for each in (found, wanted))
    return {
        "error": error(mean),
        "standard_error": float(np.hypot(*(s.std(ddof=1) / len(s) ** 0.5 for s in shares))),
        "r2": float(1 - ((mean - truth) ** 2).sum() / ((truth - truth.mean()) ** 2).sum()),
        "error_of_one": float(np.mean([error(force) for force in found])),
        "error_of_one_measured": float(np.mean([error(force) for force in wanted])),
        "displacement_mm": at.tolist(),
        "measured_n": wanted.tolist(),
        "fresh_n": found.tolist(),
    }


def markdown(result: dict, found: dict, origin: dict) -> str:
    rows = [
        [
            test,
            f"{100 * row['error']:.1f} ± {100 * row['standard_error']:.1f} %",
            f"{100 * row['r2']:.1f} %",
            f"{100 * PUBLISHED[test][0]:.1f} %",
            f"{100 * PUBLISHED[test][1]:.1f} %",
            f"{100 * row['error_of_one']:.1f} %",
            f"{100 * row['error_of_one_measured']:.1f} %",
        ]
        for test, row in found.items()
    ]
    soil = base_soil(load_lab(bundled_lab()))
    truth = {name: factor * float(getattr(soil, name)) for name, factor in HIDDEN.items()}
    values = ", ".join(
        f"{name} {result['parameters'][name]:.4g} (hidden {value:.4g})"
        for name, value in truth.items()
    )
    return (
        "# Whole curves\n\nMean loading curve of fresh packings at standard against that of "
        f"{REPEATS} specimens at fine. Freed: {', '.join(result['free'])}. {values}.\n\n"
        + reporting.table(HEADER, rows)
        + reporting.footer(origin)
    )


def picture(found: dict) -> None:
    """Both tests: measured curves and their mean, fresh packings' mean and band."""
    figure, axes = plt.subplots(1, len(found), figsize=(9, 3.6), layout="constrained")
    for axis, (test, row) in zip(axes, found.items(), strict=True):
        at, real, fresh = (np.array(row[n]) for n in ("displacement_mm", "measured_n", "fresh_n"))
        low, high = fresh.min(axis=0), fresh.max(axis=0)
        axis.fill_between(at, low, high, color="0.82", label="fresh packings at standard: range")
        axis.plot(at, fresh.mean(axis=0), color="k", lw=1.6, label="their mean")
        axis.plot(at, real.T, color="#c05000", lw=0.6)
        axis.plot(at, real.mean(axis=0), "--", color="#c05000", lw=1.8,
                  label="specimens at fine and their mean")  # fmt: skip
        axis.set(xlabel="displacement (mm)", ylabel="force (N)", title=test)
    axes[0].legend(fontsize=8)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)  # runs may be kept elsewhere
    figure.savefig(PICTURE, dpi=120)
    plt.close(figure)


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--seed", type=int, default=0, help="choice of packings of the fit")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    chosen = parser.parse_args()
    reporting.configure()
    lab, runs = measured(chosen.folder.resolve())
    result = fitted(lab, chosen.seed, chosen.folder.resolve())
    found = {}
    for test in PUBLISHED:
        fresh = [
            np.column_stack(
                [packing["curves"][test][axis] for axis in ("displacement_mm", "force_n")]
            )
            for packing in result["packings"]["fresh"]
        ]
        found[test] = compared([run.curves[test] for run in runs], fresh, LAST[test])
    reporting.write_section("fresh_packings", markdown(result, found, reporting.provenance()))
    picture(found)


if __name__ == "__main__":
    main()
