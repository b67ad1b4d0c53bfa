"""Presets: how finely a virtual laboratory is resolved, and what that costs.

| preset | spheres | one run of both tests, one core | use |
|---|---|---|---|
| quick | 150 | see benchmarks/results | trying, tests, first calibration |
| standard | 1000 | see benchmarks/results | results |
| fine | 5000 | see benchmarks/results | checks of resolution |
"""

from dataclasses import dataclass

import numpy as np

from calibrate.io.lab import Lab
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.engine.bed import Numerics
from jdem.engine.step import GRAVITY
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.packing.settling import Specimen


@dataclass(frozen=True)
class Preset:
    """Number of spheres, simulated platen speeds (m/s), packings averaged over."""

    name: str
    spheres: int
    confined_rate: float
    unconfined_rate: float
    packings: int


# Confined rates keep the inertial number at 200 N below 1e-3 (50 mm by 100 mm specimen).
PRESETS = {
    preset.name: preset
    for preset in (
        Preset("quick", 150, 0.045, 0.05, 3),
        Preset("standard", 1000, 0.08, 0.05, 4),
        Preset("fine", 5000, 0.10, 0.05, 2),
    )
}


def specimen(lab: Lab, preset: Preset) -> Specimen:
    """The lab's cylinder of soil filled with the preset's number of spheres."""
    density = {"density": float(np.mean(lab.density_kg_m3))} if lab.density_kg_m3 else {}
    return Specimen(
        diameter=lab.specimen.diameter,
        height=lab.specimen.height,
        count=preset.spheres,
        **density,
    )


def virtual_lab(lab: Lab, preset: Preset, numerics: Numerics | None = None) -> VirtualLab:
    """Both tests of the lab at the preset's simulated rates."""
    cylinder = specimen(lab, preset)
    numerics = numerics_for(cylinder) if numerics is None else numerics
    rows = PEAK_WINDOW / (preset.unconfined_rate * numerics.sample_time)
    confined = ConfinedCompression(
        simulated_rate=preset.confined_rate,
        nominal_rate=lab.confined.rate,
        force_low=lab.confined.force_low,
        force_high=lab.confined.force_high,
        stroke=STROKE * lab.specimen.height,
    )
    unconfined = UnconfinedCompression(
        simulated_rate=preset.unconfined_rate,
        nominal_rate=lab.unconfined.rate,
        nominal_rest=lab.unconfined.rest,
        stroke=CRUSHING_STRAIN * lab.specimen.height,
        peak_rows=2 * int(rows / 2) + 1,
    )
    return VirtualLab.of(cylinder, TestSequence((confined, unconfined)), numerics)


def numerics_for(cylinder: Specimen, **choices) -> Numerics:
    """Numerics sampled so often that spheres falling off the top stay within their skin."""
    skin = Numerics().skin * 2 * cylinder.mean_radius()
    fall = 1.5 * float(np.sqrt(2 * GRAVITY * cylinder.height))
    return Numerics(sample_time=0.5 * skin / fall, **choices)


PEAK_WINDOW = 2.5e-4  # m; travel over which the crushing force is averaged
STROKE = 0.35  # largest confined compression, as a fraction of the height
CRUSHING_STRAIN = 0.15  # of the unconfined test
