"""Derivatives in the strengths of effects that JAX takes, against differences of runs.

    python -m studies.strengths               some 10 minutes on two cores

Confined tests of the bundled soil, all effects off, packings of 500 spheres.  An effect's slope is
that per typical strength.  Differences are central ones of half a typical strength to either side,
and for effects that cannot be negative the second-order formula of 0, a half and a whole one; a lag
of the load cell is left out (`traced_strengths`).
Writes studies/results/strengths.md.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibrate.core.progress import for_terminal
from calibrate.inference.curve_points import CurvePoints, CurveReading
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.labtests.composite import names_observed
from calibrate.simulation import Campaign, side_by_side
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.core.kernel import program
from jdem.effects.base import AbstractEffect
from jdem.effects.composite import EFFECTS, with_strengths
from jdem.laboratory.virtual_lab import Outcome, TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing
from jdem.sensitivity.base import AbstractTraced, Traced
from jdem.sensitivity.overdamped import Overdamped
from studies import reporting

LEFT_OUT = ("acquisition_lag", "second_test_factor")  # the latter acts in the second test alone
STEP = 0.5  # typical strengths
SMALLEST = 1e-3  # mm; what a displacement is recorded to
HEADER = ("effect", "depth (mm): differences", "JAX", "error",
          "confined curve: mean square error over that of the slope")  # fmt: skip


def laboratory(spheres: int, folder: Path) -> tuple[Campaign, VirtualLab]:
    """Where packings come from, and the confined test with all effects at strength 0."""
    lab, preset = load_lab(bundled_lab()), replace(PRESETS["standard"], spheres=spheres)
    cylinder = specimen(lab, preset)
    numerics = numerics_for(cylinder)
    tests = virtual_lab(lab, preset, numerics).tests
    kinds: list[Callable] = [kind for name, kind in EFFECTS.items() if name not in LEFT_OUT]
    effects: list[AbstractEffect] = [kind(0.0) for kind in kinds]
    virtual = VirtualLab.of(cylinder, TestSequence(tests.apparatus[:1]), numerics, effects)
    return Campaign(virtual, cylinder, folder, for_terminal()), virtual


def typical(effect: AbstractEffect) -> float:
    return max(map(abs, effect.about.typical))


def differences(value: Callable, effects: tuple[AbstractEffect, ...]) -> np.ndarray:
    """Slopes (m, k) per typical strength of what `value` reads (m,) at strengths (k,)."""
    found = []
    for number, effect in enumerate(effects):
        unit = typical(effect) * np.eye(len(effects))[number]
        if effect.about.one_sided:
            zero, half, whole = (value(share * unit) for share in (0.0, STEP, 2 * STEP))
            found.append((4 * half - 3 * zero - whole) / (2 * STEP))
        else:
            found.append((value(STEP * unit) - value(-STEP * unit)) / (2 * STEP))
    return np.array(found).T


def traced_strengths(
    strategy: AbstractTraced, lab: VirtualLab, soil: SoilParameters, points: CurvePoints
) -> Callable[[Packing, Array], Traced]:
    """A compiled function of one packing and its time step (s), at the strengths of the effects of
    a campaign's `lab`; slopes are per typical strength.

    Slopes lack what the load cell's lag and drift do to where the machine turns.
    """
    typical = jnp.asarray([max(map(abs, effect.about.typical)) for effect in lab.effects])
    point = jnp.stack([jnp.asarray(effect.strength, float) for effect in lab.effects]) / typical

    @program
    def slopes(packing: Packing, time_step: Array) -> Traced:
        def simulated(lab: VirtualLab, asked: Array) -> Outcome:
            changed = with_strengths(lab.effects, list(asked * typical))
            altered = strategy.laboratory(replace(lab, effects=changed))
            return altered.run(packing, soil, time_step)

        return strategy.traced(lab, simulated, points.traced, point)

    return slopes


def on_packing(lab: VirtualLab, soil, points: CurvePoints) -> Callable[[Packing], np.ndarray]:
    """Slopes (2, m, k) on a packing: by differences, and those that JAX takes."""
    strategy = Overdamped()
    derivative = traced_strengths(strategy, lab, soil, points)

    @program
    def value(packing: Packing, time_step, strengths):
        changed = replace(lab, effects=with_strengths(lab.effects, strengths))
        return points.traced(changed.run(packing, soil, time_step))

    def both(packing: Packing) -> np.ndarray:
        step = lab.time_step(packing, soil)  # bonds grow after this test alone

        def at(strengths: np.ndarray) -> np.ndarray:
            return np.asarray(value(packing, step, jnp.asarray(strengths)))

        found = derivative(packing, step)
        refused = any(any(row) for row in strategy.refusals(lab, found))
        slopes = np.where(refused, np.nan, np.asarray(found.slopes))
        return np.array([differences(at, lab.effects), slopes])

    return both


def row(name: str, slopes: np.ndarray) -> dict:
    """One effect's depth and curve from slopes (packings, 2, m): means and standard errors."""
    mean = slopes.mean(axis=0)
    error = slopes.std(axis=0, ddof=1) / np.sqrt(len(slopes))
    misfit = float(np.mean((mean[1, 1:] - mean[0, 1:]) ** 2) / np.mean(mean[0, 1:] ** 2))
    return {
        "effect": name,
        "depth_mm": {"differences": mean[0, 0], "differences_se": error[0, 0],
                     "jax": mean[1, 0], "jax_se": error[1, 0]},
        "packings": slopes[:, :, 0].tolist(),
        "curve_error": misfit,
    }  # fmt: skip


def _error(differences: float, differences_se: float, jax: float, jax_se: float) -> str:
    """Relative where the slope can be told from nothing; else in mm, where JAX says otherwise."""
    if abs(differences) > max(3 * differences_se, SMALLEST):
        return f"{jax / differences - 1:+.0%}"
    off = jax - differences
    seen = abs(off) > max(3 * float(np.hypot(differences_se, jax_se)), SMALLEST)
    return f"{off:+.2g} mm" if seen else "too small to judge"


def markdown(rows: list[dict], packings: int, spheres: int, origin: dict) -> str:
    lines = []
    for each in rows:
        d = each["depth_mm"]
        error = _error(**d)
        lines.append(
            [each["effect"], f"{d['differences']:.3g} ± {d['differences_se']:.2g}",
             f"{d['jax']:.3g} ± {d['jax_se']:.2g}", error, f"{each['curve_error']:.3f}"]
        )  # fmt: skip
    return (
        f"# Derivatives in the strengths of effects\n\nPer typical strength, all effects off; "
        f"{packings} packings of {spheres} spheres whose derivatives are accepted. Cementation "
        "begins after this test.\n\n" + reporting.table(HEADER, lines) + reporting.footer(origin)
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=500)
    parser.add_argument("--packings", type=int, default=4)
    parser.add_argument("--seed", type=int, default=61)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE)
    chosen = parser.parse_args()
    reporting.configure()
    work, lab = laboratory(chosen.spheres, chosen.folder)
    test = lab.tests.apparatus[0]
    points = CurvePoints(names_observed([test]), (CurveReading.of(test),))
    both = on_packing(lab, base_soil(load_lab(bundled_lab())), points)
    packings = work.packings(range(100 * chosen.seed, 100 * chosen.seed + chosen.packings))
    found = side_by_side(
        lambda k: both(packings[k]), len(packings), work.progress, "packings", compiles=True
    )
    slopes = np.array([each for each in found if np.isfinite(each).all()])
    kept = [name for name in EFFECTS if name not in LEFT_OUT]
    rows = [row(name, slopes[..., k]) for k, name in enumerate(kept)]
    origin = reporting.provenance()
    reporting.write_page("strengths", markdown(rows, len(slopes), chosen.spheres, origin))


if __name__ == "__main__":
    main()
