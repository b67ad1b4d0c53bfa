"""Do batches by `vmap` inside a worker pay?  Processor seconds a run, alone and in batches.

One packing of 48 and of 150 spheres, soils that differ by up to 10 % in surface energy; a batch
of B soils is one compiled program (`jax.vmap` over the soil).  Compiling is not counted.

    python benchmarks/batches.py                some 5 minutes on one core

Writes benchmarks/results/batches.json and .md.
"""

import argparse
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting
from kills import low_lab

from calibrate.io.lab import load_lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.pair import KINDS
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import Preset, specimen, virtual_lab
from jdem.laboratory.virtual_lab import VirtualLab

BATCHES = (1, 4)


def measured(spheres: int, repeats: int) -> dict[str, float]:
    """Processor seconds a run for each size of batch."""
    folder = reporting.CACHE / "batches"
    folder.mkdir(parents=True, exist_ok=True)
    lab = load_lab(low_lab(folder / "low.toml"))
    preset = Preset("tiny", spheres, 0.1, 0.2, 1)
    work = Campaign(virtual_lab(lab, preset), specimen(lab, preset), folder)
    packing, base = work.packings([0])[0], base_soil(lab)
    energies = float(base.surface_energy) * np.linspace(1.0, 1.1, max(BATCHES))
    soils = [with_values(base, {"surface_energy": float(value)}) for value in energies]
    alone = eqx.filter_jit(lambda soil: _ends(work.lab, packing, soil))
    together = eqx.filter_jit(eqx.filter_vmap(lambda soil: _ends(work.lab, packing, soil)))
    seconds, rows = {}, {}
    for size in BATCHES:
        if size == 1:
            seconds["1"], rows["1"] = _timed(alone, soils[0], repeats)
            continue
        batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *soils[:size])
        took, rows[str(size)] = _timed(together, batch, repeats)
        seconds[str(size)] = took / size
    first = [float(np.ravel(value)[0]) for value in rows.values()]
    return {**seconds, "depth_of_the_first_mm": first}


def _ends(lab: VirtualLab, packing, soil):
    observed = lab.run(packing, soil).observables
    pressed, crushed = (observed[kind] for kind in KINDS)
    return 1e3 * pressed["depression_depth"], crushed["crushing_force"]


def _timed(program, soil, repeats: int):
    """Processor seconds of a call, the least of some, and the depths."""
    depths = jax.block_until_ready(program(soil))[0]
    times = []
    for _ in range(repeats):
        begun = time.process_time()
        jax.block_until_ready(program(soil))
        times.append(time.process_time() - begun)
    return min(times), depths


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("--spheres", type=int, nargs="+", default=[48, 150])
    options.add_argument("--repeats", type=int, default=2)
    chosen = options.parse_args()
    reporting.configure()
    rows = {str(count): measured(count, chosen.repeats) for count in chosen.spheres}
    origin = reporting.provenance()
    header = ["spheres", *(f"{size} together (s a run)" for size in BATCHES)]
    lines = [[count, *(f"{row[str(size)]:.2f}" for size in BATCHES)] for count, row in rows.items()]
    text = "# Batches by vmap on processor cores\n\n" + reporting.table(header, lines)
    reporting.write("batches", {**origin, "seconds": rows}, text + reporting.footer(origin))


if __name__ == "__main__":
    main()
