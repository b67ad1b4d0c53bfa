"""Many specimens at once on this machine's accelerator: seconds a specimen, both tests.

One compiled program simulates a batch (`jax.vmap` over packings and soils) of 1100 spheres in
single precision, as the library of runs has them: its rates, its effects at strength 0 but for the
costly ones.  Packings and soils differ.  Compiling is not counted; a batch lasts as long as its
longest specimen.  Without an accelerator this says what a batch costs on the processor, where a
campaign's threads are quicker.

    python benchmarks/accelerator.py --batches 1 32 256 1024      5 minutes on an H100

Writes a section of benchmarks/results/README.md.
"""

import argparse
import time
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting

from calibrate.core.progress import for_terminal
from calibrate.discrepancy.library.design import CENTRE
from calibrate.discrepancy.library.simulate import COSTLY, PRESET, switched_off
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import numerics_for, specimen, virtual_lab
from jdem.effects.composite import EFFECTS
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing
from studies.sealed.plan import USUAL

SPHERES, PACKINGS = 1100, 32
STIFFER = np.exp(np.linspace(-0.5, 0.5, 512))  # shear moduli of soils over the usual one
HEADER = ("specimens", "wall time (s)", "of one (s)", "M particle-steps/s", "failed",
          "F of the first (N)")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Batch:
    """What a batch lasted, with what it simulated."""

    specimens: int
    compiled_s: float
    seconds: float
    steps: float
    failed: int
    first_force_n: float

    def cells(self) -> tuple[str, ...]:
        rate = 1e-6 * SPHERES * self.steps / self.seconds
        return (
            f"{self.specimens}", f"{self.seconds:.1f}", f"{self.seconds / self.specimens:.2f}",
            f"{rate:.1f}", f"{self.failed}", f"{self.first_force_n:.0f}",
        )  # fmt: skip


def campaign(lab: Lab) -> Campaign:
    """Specimens as a library of runs has them."""
    preset = replace(PRESET, spheres=SPHERES)
    cylinder = specimen(lab, preset)
    numerics = numerics_for(cylinder, dtype="float32")
    cheap = tuple(e for e in switched_off(EFFECTS) if not isinstance(e, COSTLY))
    tests = virtual_lab(lab, preset, numerics).tests
    virtual = VirtualLab.of(cylinder, tests, numerics, cheap)
    return Campaign(virtual, cylinder, reporting.CACHE / "accelerator", for_terminal())


def soil(lab: Lab, number: int) -> SoilParameters:
    """The soil of a specimen of this number."""
    modulus = CENTRE["shear_modulus"] * STIFFER[7 * number % len(STIFFER)]
    return with_values(base_soil(lab), {**CENTRE, "shear_modulus": modulus})


def stacked(items: list):
    """Trees of the same structure as one with a leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(one) for one in leaves]), *items)


def simulated(virtual: VirtualLab, packings: list[Packing], soils: list[SoilParameters]) -> Batch:
    """A batch of specimens, simulated."""
    inputs = stacked(packings), stacked(soils)
    batch = eqx.filter_jit(eqx.filter_vmap(lambda bed, soil: virtual.run(bed, soil)))
    begun = time.perf_counter()
    compiled = batch.lower(*inputs).compile()
    ready = time.perf_counter()
    outcome = jax.block_until_ready(compiled(*inputs))
    seconds = time.perf_counter() - ready
    samples = np.sum(np.asarray(outcome.record.samples.segment) >= 0, axis=1)
    size = np.asarray(eqx.filter_jit(eqx.filter_vmap(virtual.time_step))(*inputs))
    steps = samples * np.round(virtual.numerics.sample_time / size)
    force = np.asarray(outcome.observables["unconfined"]["crushing_force"])
    failed = int(np.sum(np.asarray(outcome.failed)))
    return Batch(len(soils), ready - begun, seconds, float(steps.sum()), failed, float(force[0]))


def markdown(found: list[Batch], origin: dict) -> str:
    device = jax.devices()[0].device_kind
    compiled = " to ".join(f"{f(b.compiled_s for b in found):.0f}" for f in (min, max))
    return (
        f"## Batches on an accelerator\n\nBoth tests, {SPHERES} spheres, single precision, on one "
        f"{device}; compiling ({compiled} s a size) not counted.\n\n"
        + reporting.table(HEADER, [b.cells() for b in found])
        + reporting.footer(origin)
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 32, 256])
    chosen = parser.parse_args()
    reporting.configure()
    lab = USUAL.lab()
    work = campaign(lab)
    beds = work.packings(range(min(PACKINGS, max(chosen.batches))))
    found = []
    for count in chosen.batches:
        numbers = range(count)
        given = [beds[k % len(beds)] for k in numbers], [soil(lab, k) for k in numbers]
        found.append(simulated(work.lab, *given))
        reporting.write_page(markdown(found, reporting.provenance()))


if __name__ == "__main__":
    main()
