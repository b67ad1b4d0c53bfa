"""Derivatives that JAX takes, against the slope of the response: tables from `calibrate audit`.

    python benchmarks/overdamped.py --spheres 500 --packings 8 --seed 11
    python benchmarks/overdamped.py --spheres 1000 --packings 4 --seed 12

The first takes some 30 minutes on two cores, the second 40.  Audits are kept in
results/benchmarks/overdamped; one that is there is only tabulated.  Writes
benchmarks/results/overdamped.json and .md, all audits that are there.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import reporting

STRATEGY = "overdamped"
HEADER = ("spheres", "seed", "parameter", "of", "reference", "overdamped", "error")
CURVES = (
    "spheres",
    "seed",
    "parameter",
    "confined curve: mean square error over that of the slope",
)
BELIEVED = ("spheres", "seed", "test", "accepted packings and parameters", "largest growth")


def audited(spheres: int, packings: int, seed: int, folder: Path) -> None:
    """One audit, if it is not there yet."""
    out = folder / f"{spheres}-{seed}"
    if (out / "audit.json").exists():
        return
    numbers = {"--spheres": spheres, "--packings": packings, "--seed": seed}
    options = [part for name, value in numbers.items() for part in (name, str(value))]
    command = [sys.executable, "-m", "calibrate", "audit", "--strategy", STRATEGY]
    subprocess.run([*command, *options, "--out", str(out)], check=True)


def slopes(audit: dict) -> list[dict]:
    """Slopes of observables that can be judged."""
    rows = audit["strategies"][STRATEGY]["rows"]
    return [row for row in rows if row["judged"]]


def curve_errors(audit: dict) -> dict[str, float]:
    """For each parameter that matters to the confined curve (three standard errors in the mean
    square), the mean square error of its slope over the mean square of the reference's."""
    found = {}
    for parameter, by_name in audit["curves"]["confined"]["slopes"].items():
        reference, error = (np.array(by_name["reference"][key]) for key in ("slope", "se"))
        size = np.mean(reference**2)
        if size > 9 * np.mean(error**2):
            estimate = np.array(by_name[STRATEGY]["slope"], float)
            found[parameter] = float(np.mean((estimate - reference) ** 2) / size)
    return found


def certified(audit: dict) -> list[list[str]]:
    """For each test how many certificates were accepted, and how far derivatives grew."""
    rows = audit["strategies"][STRATEGY]["certificate"]
    return [
        [
            test,
            f"{sum(row['accepted'] for row in chosen)} of {len(chosen)}",
            f"{max(row['growth'] for row in chosen):.2g}",
        ]
        for test in dict.fromkeys(row["test"] for row in rows)
        for chosen in [[row for row in rows if row["test"] == test]]
    ]


def markdown(audits: list[dict], origin: dict) -> str:
    """Three tables: slopes, curves, certificates."""

    def named(audit: dict) -> list[str]:
        return [str(audit["spheres"]), str(min(audit["seeds"]) // 100)]

    judged = [[*named(audit), *_cells(row)] for audit in audits for row in slopes(audit)]
    curves = [
        [*named(audit), parameter, f"{error:.3f}"]
        for audit in audits
        for parameter, error in curve_errors(audit).items()
    ]
    believed = [[*named(audit), *row] for audit in audits for row in certified(audit)]
    return (
        "# Derivatives that JAX takes\n\nPer unit of ln p, mm or N; slopes above three standard "
        "errors of the reference.\n\n"
        + "\n\n".join(
            reporting.table(*both)
            for both in ((HEADER, judged), (CURVES, curves), (BELIEVED, believed))
        )
        + reporting.footer(origin)
    )


def _cells(row: dict) -> list[str]:
    known = np.isfinite(row["estimate"] if row["estimate"] is not None else np.nan)
    estimate = f"{row['estimate']:.3g} ± {row['estimate_se']:.2g}" if known else "none"
    error = f"{row['relative_error']:+.0%}" if known else ""
    reference = f"{row['reference']:.3g} ± {row['reference_se']:.2g}"
    return [row["parameter"], row["observable"], reference, estimate, error]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=500)
    parser.add_argument("--packings", type=int, default=8)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE / "overdamped")
    chosen = parser.parse_args()
    audited(chosen.spheres, chosen.packings, chosen.seed, chosen.folder)
    paths = sorted(
        chosen.folder.glob("*/audit.json"), key=lambda p: int(p.parent.name.split("-")[0])
    )
    audits = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    origin = reporting.provenance()
    reporting.write("overdamped", {**origin, "audits": audits}, markdown(audits, origin))


if __name__ == "__main__":
    main()
