"""How much the observables depend on choices of the method, beside the scatter of packings.

On the bundled soil at the preset standard's rates, on grown beds of 500 spheres (2000 with
`--spheres 2000`): depression depth H and crushing force F with the time step halved and
lengthened, with both simulated rates halved and doubled, with every rounding sharp, with half
the background damping, and with the shear modulus changed by one part in 10^9 (what chaos
alone does).  H is also read up to two servo widths below the largest force, where the platen
has not slowed down yet: the difference tells creep under the nearly constant force from the
response to loading.  Differences are paired by packing.

    python -m verification.convergence               all parts, about 10 minutes on two cores
    python -m verification.convergence --part rate   one part, about 2 minutes

Runs are kept in results/benchmarks; a second call resumes.  Writes
verification/results/convergence.md; single parts are added to what is there.
"""

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path

import equinox as eqx
import numpy as np

from calibrate.core.progress import for_terminal
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.pair import KINDS
from calibrate.simulation import Campaign, Run
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.apparatus.base import Damping
from jdem.apparatus.confined import ConfinedCompression
from jdem.core.smooth import Smoothing
from jdem.engine.bed import Numerics
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.observables import displacement_on_rise
from jdem.packing.specimen import Specimen
from verification import reporting

EARLY = "depth_before_servo_mm"
OBSERVABLES = ("depression_depth_mm", EARLY, "crushing_force_n")


@dataclass(frozen=True)
class Variant:
    """One change of the method; factors are relative to the preset."""

    part: str
    what: str
    rate: float = 1.0
    damping: float = 1.0
    modulus: float = 1.0
    numerics: dict = field(default_factory=dict)


def _step(factor: float) -> dict:
    return {"safety": factor * Numerics().safety}


BASE = Variant("base", "as the preset")
VARIANTS = (
    Variant("chaos", "shear modulus + 1e-9 of itself", modulus=1 + 1e-9),
    Variant("step", "time step halved", numerics=_step(0.5)),
    Variant("step", "time step 1.1 times as long", numerics=_step(1.1)),
    Variant("rate", "both rates halved", rate=0.5),
    Variant("rate", "both rates doubled", rate=2.0),
    Variant("sharp", "all roundings sharp", numerics={"smoothing": Smoothing.sharp()}),
    Variant("damping", "background damping halved", damping=0.5),
)


def laboratory(lab: Lab, variant: Variant, spheres: int) -> tuple[VirtualLab, Specimen]:
    """The virtual tests and the specimen of a variant."""
    usual = PRESETS["standard"]
    preset = replace(
        usual,
        spheres=spheres,
        rate_in_mould=variant.rate * usual.rate_in_mould,
        rate_free=variant.rate * usual.rate_free,
    )
    cylinder = specimen(lab, preset)
    virtual = virtual_lab(lab, preset, numerics_for(cylinder, **variant.numerics))
    return _damped(virtual, variant.damping), cylinder


def _damped(virtual: VirtualLab, factor: float) -> VirtualLab:
    usual = Damping()
    scaled = (factor * rate for rate in (usual.loading, usual.resting, usual.unloaded))
    damping = Damping(*scaled)
    return eqx.tree_at(
        lambda v: [v.tests[kind].damping for kind in KINDS],
        virtual,
        [damping] * len(KINDS),
    )


def measured(lab: Lab, variant: Variant, chosen: argparse.Namespace) -> list[Run]:
    """The variant's runs, one a packing."""
    work = Campaign(*laboratory(lab, variant, chosen.spheres), chosen.folder, for_terminal())
    soil = base_soil(lab)
    soil = with_values(soil, {"shear_modulus": variant.modulus * float(soil.shear_modulus)})
    seeds = range(chosen.seed, chosen.seed + chosen.packings)
    return work.runs([soil], seeds, variant.what)[0]


def row(variant: Variant, runs: list[Run], base: list[Run]) -> dict:
    """Numbers of one variant and its differences from the base."""
    return {
        "part": variant.part,
        **{name: compared(_values(runs, name), _values(base, name)) for name in OBSERVABLES},
        **quality(runs),
        "failures": [run.failure for run in runs if run.failure],
    }


def compared(values: np.ndarray, base: np.ndarray) -> dict:
    """Mean and scatter over packings; difference from the base and its standard error."""
    differences = values - base
    error = differences.std(ddof=1) / np.sqrt(len(differences))
    return {
        "values": values.tolist(),
        "mean": float(values.mean()),
        "scatter": float(values.std(ddof=1)),
        "difference": float(values.mean() - base.mean()),
        "standard_error": float(error),
    }


def quality(runs: list[Run]) -> dict:
    """Largest over packings of what says whether to believe a run; mean cost."""
    energy = [r.quality["kinetic_energy_after_rest_j"] / r.quality["platen_work_j"] for r in runs]
    return {
        "inertial_number": _largest(runs, "inertial_number"),
        "energy_balance": _largest(runs, "energy_balance"),
        "kinetic_energy_after_rest_j": _largest(runs, "kinetic_energy_after_rest_j"),
        "kinetic_energy_after_rest_over_work": float(max(energy)),
        "time_step_s": _largest(runs, "time_step_s"),
        "steps": float(np.mean([run.quality["steps"] for run in runs])),
        "runtime_s": float(np.mean([run.quality["runtime_s"] for run in runs])),
    }


def _largest(runs: list[Run], name: str) -> float:
    return float(np.max([run.quality[name] for run in runs]))


def _values(runs: list[Run], name: str) -> np.ndarray:
    if name == EARLY:
        return np.array([depth_before_servo(run) for run in runs])
    return np.array([run.observables[name] for run in runs])


def depth_before_servo(run: Run) -> float:
    """Displacement (mm) from force_low to two servo widths below force_high, on loading."""
    test = ConfinedCompression()
    travel, force = run.curves[test.name].T
    ends = (float(test.force_low), float(test.force_high - 2 * test.servo_width))
    low, high = displacement_on_rise(travel, force, ends)
    return float(high - low)


def markdown(variants: dict, spheres: str) -> str:
    """The table of one size of bed, with scatter beside every difference."""
    header = (
        "variant",
        "packings",
        "H (mm) ± scatter",
        "ΔH ± s.e.",
        "Δ(H up to 392 N) ± s.e.",
        "F (N) ± scatter",
        "ΔF ± s.e.",
        "inertial number",
        "energy balance",
        "kinetic energy after rest (J)",
        "time steps",
        "run (s)",
    )
    rows = [_cells(what, entry) for what, entry in variants.items()]
    return f"## {spheres} spheres\n\n" + reporting.table(header, rows)


def _cells(what: str, entry: dict) -> list[str]:
    depth, early, force = (entry[name] for name in OBSERVABLES)
    return [
        what,
        str(len(depth["values"])),
        f"{depth['mean']:.3f} ± {depth['scatter']:.3f}",
        f"{depth['difference']:+.3f} ± {depth['standard_error']:.3f}",
        f"{early['difference']:+.3f} ± {early['standard_error']:.3f}",
        f"{force['mean']:.1f} ± {force['scatter']:.1f}",
        f"{force['difference']:+.1f} ± {force['standard_error']:.1f}",
        f"{entry['inertial_number']:.1e}",
        f"{entry['energy_balance']:.1e}",
        f"{entry['kinetic_energy_after_rest_j']:.1e}",
        f"{entry['steps']:.0f}",
        f"{entry['runtime_s']:.0f}",
    ]


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Plain)
    parts = sorted({variant.part for variant in VARIANTS})
    parser.add_argument("--part", choices=parts, action="append", help="default: all parts")
    parser.add_argument("--spheres", type=int, default=500)
    parser.add_argument("--packings", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0, help="first packing")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="cache of runs")
    return parser.parse_args()


class _Plain(argparse.RawDescriptionHelpFormatter):
    """Help that keeps the docstring's lines."""


def main() -> None:
    chosen = arguments()
    reporting.configure()
    lab = load_lab(bundled_lab())
    base = measured(lab, BASE, chosen)
    known = reporting.earlier("convergence", "sizes")
    found = {BASE.what: row(BASE, base, base)}
    before = known.get(str(chosen.spheres), {})
    for variant in VARIANTS:
        if chosen.part is None or variant.part in chosen.part:
            found[variant.what] = row(variant, measured(lab, variant, chosen), base)
        elif variant.what in before:
            found[variant.what] = before[variant.what]
        _save({**known, str(chosen.spheres): found})


def _save(sizes: dict) -> None:
    origin = reporting.provenance()
    tables = "\n".join(markdown(found, spheres) for spheres, found in sizes.items())
    head = (
        "# Convergence\n\nBundled soil. Scatter is the standard deviation over packings; "
        "differences are from the first row of their table, paired by packing. The inertial "
        "number is that of the confined test; energy balance is the integration error over "
        "the platen's work; quality columns give the worst packing.\n\n"
    )
    text = head + tables + reporting.footer(origin)
    reporting.write_content("convergence", {**origin, "sizes": sizes})
    reporting.write_section("convergence", text)


if __name__ == "__main__":
    main()
