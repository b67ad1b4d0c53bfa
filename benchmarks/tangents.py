"""Growth of pathwise derivatives along both tests, before and after each change of numerics.

One tangent, d/d ln (shear modulus), is carried through every step of both tests on a few
packings of 300 spheres.  A derivative of the platen force that grows beyond the force
itself belongs to the path that this computer took, not to the soil.  Variants:

    as first built      dashpot beside the friction limit, rattling spheres hardly damped
    dashpot limited     spring and dashpot share the friction limit
    rattlers damped     the same, and spheres that carry no load are damped
    sharp friction      the same with stick-slip rounded ten times less (the default)

    python benchmarks/tangents.py               about 5 minutes on two cores

Writes notebooks/data/tangents.json, benchmarks/results/tangents.md and docs/images/tangents.png.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import reporting
from jax import Array

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.pair import KINDS
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.core import smooth
from jdem.core.smooth import Smoothing
from jdem.engine.bed import build_bed, steps_per_sample
from jdem.engine.loop import run, start
from jdem.engine.step import Bed
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.laws.coulomb import CoulombSpring
from jdem.mechanics.dashpot import dashpot_constant
from jdem.packing.specimen import Packing

PARAMETER = "shear_modulus"
SPHERES = 300
AWAY = -5.0  # log10 N; smaller derivatives mean that the platen touches nothing


class UnlimitedDashpot(CoulombSpring):
    """As first built: the dashpot acts beside the limited spring while that one sticks."""

    def force(self, contact, normal, stiffness, history):
        limit = contact.friction * normal.frictional_load
        loaded = jnp.where(limit > 0, 1.0, 0.0)
        stretch = history.without(contact.normal) + contact.slip * contact.time_step
        stretch = self._shortened(stretch, stiffness, limit) * loaded
        load = smooth.divide(stiffness * smooth.norm(stretch), limit)
        saturated = smooth.saturate(load, self.smoothing.slip)
        secant = jnp.where(load > 0, smooth.divide(saturated, load), 1.0)
        beta = dashpot_constant(self.restitution, contact.mass, jnp.maximum(stiffness, 1e-30))
        sticking = smooth.saturate_slope(load, self.smoothing.slip) * loaded
        return stretch * (-stiffness * secant), contact.slip * (-beta * sticking), stretch


VARIANTS = {
    "as first built": {"unlimited": True, "unloaded": 0.0, "slip": 0.5},
    "dashpot limited": {"unlimited": False, "unloaded": 0.0, "slip": 0.5},
    "rattlers damped": {"unlimited": False, "unloaded": 4000.0, "slip": 0.5},
    "sharp friction (default)": {"unlimited": False, "unloaded": 4000.0, "slip": 0.05},
}
STAGES = ("loading", "unloading", "resting", "crushing")
LINES = {0: ("#9fb7c9", ":"), 1: ("#7a7a7a", "--"), 2: ("#20344f", "-"), 3: ("#c4622d", "-.")}


def laboratory(lab, slip: float, unloaded: float) -> VirtualLab:
    """The bundled soil's tests at quick's rates with 300 spheres."""
    preset = replace(PRESETS["quick"], spheres=SPHERES)
    smoothing = replace(Smoothing(), slip=jnp.asarray(slip))
    numerics = numerics_for(specimen(lab, preset), smoothing=smoothing)
    virtual = virtual_lab(lab, preset, numerics)
    return eqx.tree_at(
        lambda v: [v.tests[kind].damping.unloaded for kind in KINDS],
        virtual,
        [jnp.asarray(unloaded)] * len(KINDS),
    )


def with_dashpot(bed: Bed) -> Bed:
    """The bed with the tangential law as first built."""
    for where in (lambda b: b.particle_law.tangential, lambda b: b.wall_law.tangential):
        law = where(bed)
        bed = eqx.tree_at(where, bed, UnlimitedDashpot(law.restitution, law.smoothing))
    return bed


@eqx.filter_jit
def derivative(
    virtual: VirtualLab, packing: Packing, soil, time_step: Array, unlimited: bool
) -> tuple[Array, Array, Array]:
    """Platen force (N), its derivative (N) and the segment of every sample."""

    def force(x: Array):
        changed = with_values(soil, {PARAMETER: jnp.exp(x) * getattr(soil, PARAMETER)})
        bed = build_bed(packing.spheres, changed, virtual.grid, virtual.numerics, time_step)
        bed = with_dashpot(bed) if unlimited else bed
        state = start(bed, packing.position, packing.height, packing.mould_radius)
        steps = steps_per_sample(bed, virtual.numerics)
        record = run(bed, state, virtual.tests.programme(), steps, virtual.capacity)
        return record.samples.platen_force, record.samples.segment

    value, slope, segment = jax.jvp(force, (jnp.zeros(()),), (jnp.ones(()),), has_aux=True)
    return value, slope, segment


def measured(variant: dict, packings: int, folder: Path) -> dict:
    """Sizes of the derivative along the tests: median over packings of each stage's rms."""
    lab = load_lab(bundled_lab())
    soil, virtual = base_soil(lab), laboratory(lab, variant["slip"], variant["unloaded"])
    preset = replace(PRESETS["quick"], spheres=SPHERES)
    beds = Campaign(virtual, specimen(lab, preset), folder).packings(range(packings))

    def one(packing: Packing):
        time_step = virtual.time_step(packing, soil)
        found = derivative(virtual, packing, soil, time_step, variant["unlimited"])
        return [np.asarray(part) for part in found]

    one(beds[0])
    with ThreadPoolExecutor(2) as pool:
        curves = list(pool.map(one, beds))
    names = virtual.tests.names
    sizes = [
        {stage: _rms(slope[segment == names.index(stage)]) for stage in STAGES}
        for _, slope, segment in curves
    ]
    typical = {stage: float(np.median([size[stage] for size in sizes])) for stage in STAGES}
    worst = {stage: float(max(size[stage] for size in sizes)) for stage in STAGES}
    return {"typical": typical, "worst": worst, "trace": _trace(curves)}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _trace(curves: list, points: int = 200) -> list[list[float]]:
    """Median over packings of |derivative|, along the samples, on a common axis of 0 to 1."""
    axis = np.linspace(0, 1, points)
    rows = []
    for _, slope, segment in curves:
        size = np.abs(slope[segment >= 0])
        smoothed = np.sqrt(np.convolve(size**2, np.ones(15) / 15, mode="same"))
        rows.append(np.interp(axis, np.linspace(0, 1, len(size)), np.log10(smoothed + 1e-16)))
    return [axis.tolist(), np.median(rows, axis=0).tolist()]


def figure(found: dict, path: Path) -> None:
    """Size of the derivative along both tests, one line a variant."""
    drawn, axis = plt.subplots(figsize=(8.5, 4.6), layout="constrained")
    for number, (name, entry) in enumerate(found.items()):
        colour, line = LINES[number]
        share, size = (np.array(column) for column in entry["trace"])
        size = np.where(size > AWAY, size, np.nan)
        axis.plot(share, size, line, color=colour, lw=1.6, label=name)
    axis.axhspan(1, 3, color="0.92", zorder=0)
    axis.text(0.41, 2, "size of the forces", fontsize=8, ha="center", va="center")
    axis.text(0.41, 30, "platen away:\nmould removed, rest", fontsize=8, ha="center")
    axis.set(
        xlabel="share of both tests that has passed (-)",
        ylabel=f"log10 |d force / d ln {PARAMETER.replace('_', ' ')}|  (N)",
    )
    axis.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn.savefig(path, dpi=130)


def markdown(found: dict, packings: int, origin: dict) -> str:
    rows = [
        [name, *(f"{e['typical'][s]:.0e} ({e['worst'][s]:.0e})" for s in STAGES)]
        for name, e in found.items()
    ]
    return (
        f"# Growth of tangents\n\nRoot mean square of d(platen force)/d ln({PARAMETER}) in N over "
        f"each stage, {SPHERES} spheres, float64: median of {packings} packings (worst).\n\n"
        + reporting.table(("numerics", *STAGES), rows)
        + reporting.footer(origin)
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--packings", type=int, default=4)
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="stored packings")
    chosen = parser.parse_args()
    reporting.configure()
    found = {}
    for name, variant in VARIANTS.items():
        found[name] = measured(variant, chosen.packings, chosen.folder)
        print(name, found[name]["typical"], flush=True)
    origin = reporting.provenance()
    content = {**origin, "seed": 0, "packings": chosen.packings, "variants": found}
    figure(found, Path("docs/images/tangents.png"))
    reporting.write("tangents", content, markdown(found, chosen.packings, origin))


if __name__ == "__main__":
    main()
