"""Derivatives that JAX takes, against the slope of the response: tables from `calibrate audit`.

    python -m verification.overdamped --spheres 500 --packings 8 --seed 11
    python -m verification.overdamped --spheres 1000 --packings 8 --seed 12

Audits are kept in results/benchmarks/overdamped; one that is there is only tabulated.  Writes
verification/results/overdamped.md from all audits that are there with the present physics.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from jdem.physics import PHYSICS
from verification import reporting

STRATEGY = "overdamped"
HEADER = ("spheres", "seed", "parameter", "of", "reference", "overdamped", "error")
CURVES = (
    "spheres",
    "seed",
    "parameter",
    "confined curve: mean square error over that of the slope",
)
BELIEVED = ("spheres", "seed", "physics", "test", "accepted packings and parameters",
            "largest growth")  # fmt: skip
POOLED = ("spheres", "seeds", "packings", "parameter", "reference", "overdamped", "error",
          "packings wrong by more than 30 %")  # fmt: skip
WRONG = 0.3
LARGE = 0.1  # of the largest slope: smaller ones are not asked for
DEPTH = "depression_depth_mm"


def audited(spheres: int, packings: int, seed: int, folder: Path) -> None:
    """One audit, if it is not there yet with the present physics."""
    out = folder / f"{spheres}-{seed}"
    done = out / "audit.json"
    if done.exists() and reporting.physics_of(json.loads(done.read_text("utf-8"))) == str(PHYSICS):
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
    """For each test in the mould: certificates accepted, and how far derivatives grew."""
    rows = audit["strategies"][STRATEGY]["certificate"]
    rows = [row for row in rows if "stands free" not in row["refused"]]
    return [
        [
            test,
            f"{sum(row['accepted'] for row in chosen)} of {len(chosen)}",
            f"{max(row['growth'] for row in chosen):.2g}",
        ]
        for test in dict.fromkeys(row["test"] for row in rows)
        for chosen in [[row for row in rows if row["test"] == test]]
    ]


def pooled(audits: list[dict]) -> list[list[str]]:
    """Depth's slopes that are asked for, over all accepted packings of one size in audits that
    state them packing by packing; errors are those of the difference."""
    found, detailed = [], [audit for audit in audits if _by_packing(audit)]
    for spheres in sorted({audit["spheres"] for audit in detailed}):
        of_size = [audit for audit in detailed if audit["spheres"] == spheres]
        seeds = ", ".join(str(min(audit["seeds"]) // 100) for audit in of_size)
        pairs = {row["parameter"]: [] for row in of_size[0]["strategies"][STRATEGY]["rows"]}
        for row in (row for audit in of_size for row in audit["strategies"][STRATEGY]["rows"]):
            if row["observable"] == DEPTH:
                columns = row["reference_by_packing"], row["estimate_by_packing"]
                pairs[row["parameter"]] += np.array(columns, float).T.tolist()
        slopes = {name: np.array(rows) for name, rows in pairs.items() if rows}
        slopes = {name: rows[np.isfinite(rows).all(axis=1)] for name, rows in slopes.items()}
        largest = max((abs(rows[:, 0].mean()) for rows in slopes.values()), default=0.0)
        for name, rows in slopes.items():
            if abs(rows[:, 0].mean()) > max(LARGE * largest, 3 * _error(rows[:, 0])):
                found.append([str(spheres), seeds, str(len(rows)), name, *_compared(*rows.T)])
    return found


def _by_packing(audit: dict) -> bool:
    return "estimate_by_packing" in audit["strategies"][STRATEGY]["rows"][0]


def _compared(reference: np.ndarray, estimate: np.ndarray) -> list[str]:
    mean, wrong = reference.mean(), np.abs(estimate / reference - 1) > WRONG
    bias, error = (estimate - reference).mean() / mean, _error(estimate - reference) / abs(mean)
    return [
        f"{mean:.3g} ± {_error(reference):.2g}",
        f"{estimate.mean():.3g} ± {_error(estimate):.2g}",
        f"{bias:+.1%} ± {error:.1%}",
        f"{wrong.sum()} of {len(wrong)}",
    ]


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def markdown(audits: list[dict], origin: dict) -> str:
    """Tables: slopes by audit and over all packings, curves, certificates."""

    def named(audit: dict) -> list[str]:
        return [str(audit["spheres"]), str(min(audit["seeds"]) // 100)]

    judged = [[*named(audit), *_cells(row)] for audit in audits for row in slopes(audit)]
    curves = [
        [*named(audit), parameter, f"{error:.3f}"]
        for audit in audits
        for parameter, error in curve_errors(audit).items()
    ]
    believed = [
        [*named(audit), reporting.physics_of(audit), *row]
        for audit in audits
        for row in certified(audit)
    ]
    return (
        "# Derivatives that JAX takes\n\nPer unit of ln p, mm or N; slopes above three standard "
        "errors of the reference.\n\n"
        + "\n\n".join(
            reporting.table(*both)
            for both in (
                (POOLED, pooled(audits)),
                (HEADER, judged),
                (CURVES, curves),
                (BELIEVED, believed),
            )
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
    paths = sorted(chosen.folder.glob("*/audit.json"))
    audits = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    audits = [audit for audit in audits if reporting.physics_of(audit) == str(PHYSICS)]
    audits.sort(key=lambda audit: (audit["spheres"], min(audit["seeds"])))
    origin = reporting.provenance()
    reporting.write_page("overdamped", markdown(audits, origin))


if __name__ == "__main__":
    main()
