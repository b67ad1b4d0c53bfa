"""Simulates rows of the bundled bank again after a change of the engine that concerns few of them.

    python benchmarks/bank_again.py            a quarter of an hour beside other jobs; resumes

Rate dependence made one bed in seven with it creep where the platen turns (docs/decisions.md), by
0.4 mm and more where all other rows have 0.27 mm at most from 400 N to the turn.  The engine is
mended; the rows with that effect and more than ABOVE of travel are simulated anew, besides some
CHECKED others with it (how far these change is printed), and the bank is fitted again.  Run on the
bank of commit 118682f; the one that it made holds no such row any more.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.core.runtime import configure
from calibrate.discrepancy.library import store
from calibrate.discrepancy.library.simulate import Points, Simulator, run_points
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.simulation import engine_hash

EFFECT, FEATURE, ABOVE = "rate_dependence", "travel at the top, confined", 0.3  # mm
CHECKED = 12


def chosen(bank: store.Bank) -> tuple[np.ndarray, np.ndarray]:
    """Rows to be simulated anew, and others by which to see how far the rest would change."""
    at_work = bank.strengths[:, bank.design.effect_names.index(EFFECT)] > 0
    travel = bank.values[:, [f.name for f in bank.features].index(FEATURE)]
    others = np.flatnonzero(at_work & (travel <= ABOVE))
    return np.flatnonzero(at_work & (travel > ABOVE)), others[:: len(others) // CHECKED]


def planned(bank: store.Bank) -> dict[tuple, int]:
    """The row of the design by what the bank's file keeps of it."""
    base, strengths = (part.astype(np.float32) for part in bank.design.rows())
    return {key(b, s): row for row, (b, s) in enumerate(zip(base, strengths, strict=True))}


def key(base: np.ndarray, strengths: np.ndarray) -> tuple:
    return (*base.astype(np.float32).tolist(), *strengths.astype(np.float32).tolist())


def simulated(bank: store.Bank, rows: np.ndarray, runs: Path) -> np.ndarray:
    """Features (n, m) of these rows on today's engine; NaN where one is missing."""
    design, of_design = bank.design, planned(bank)
    numbers = [of_design[key(bank.base[row], bank.strengths[row])] for row in rows]
    base, strengths = (part[numbers] for part in design.rows())
    packing = np.array(numbers) // design.rows_each
    spheres = [design.spheres_of(int(j)) for j in packing]
    points = Points(base, strengths, spheres, 1000 * design.seed + packing)
    found = run_points(design, points, Simulator(load_lab(bundled_lab()), runs), for_terminal())
    return store.features_of(bank.features, found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=Path, default=Path("bank_again_runs"))
    parser.add_argument("--out", type=Path, default=store.bundled_bank())
    given = parser.parse_args()
    configure()
    bank = store.load(store.bundled_bank())
    again, checked = chosen(bank)
    if not len(again):
        raise SystemExit(f"{store.bundled_bank().name}: no row crept, nothing is to be done")
    print(f"{len(again)} rows to simulate anew, {len(checked)} to compare", flush=True)
    values = simulated(bank, np.concatenate([again, checked]), given.runs)
    new, same = values[: len(again)], values[len(again) :]
    scatter = np.std(bank.values, axis=0)
    changed = np.nanmax(np.abs(same - bank.values[checked]) / scatter, axis=1)
    print(f"largest changes of compared rows, in deviations of all rows: {changed.round(3)}")
    whole = np.isfinite(new).all(axis=1)
    kept = np.setdiff1d(np.arange(len(bank.values)), again[~whole])
    updated = bank.values.copy()
    updated[again[whole]] = new[whole]
    print(f"{whole.sum()} of {len(again)} have all features", flush=True)
    parts = {n: getattr(bank, n)[kept] for n in ("base", "strengths", "packing")}
    bank = replace(bank, **parts, values=updated[kept], engine=engine_hash(), late=None)
    store.save(replace(bank, kernels=(), missed=None).fitted(), given.out)


if __name__ == "__main__":
    main()
