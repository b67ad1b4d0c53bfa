"""Presets: how finely a virtual laboratory is resolved, and what that costs.

| preset | spheres | one run of the paper's two tests, one core | use |
|---|---|---|---|
| quick | 150 | see benchmarks/results | trying, tests, first calibration |
| standard | 1000 | see benchmarks/results | results |
| fine | 5000 | see benchmarks/results | checks of resolution |
"""

from dataclasses import dataclass

import numpy as np

from calibrate.io.lab import Lab
from calibrate.labtests.base import Pace
from calibrate.labtests.measured import Cylinder
from jdem.engine.bed import Numerics
from jdem.engine.step import GRAVITY
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.packing.settling import Specimen


@dataclass(frozen=True)
class Preset:
    """Number of spheres, simulated platen speeds (m/s) on a specimen in its mould and on a free
    one, packings averaged over."""

    name: str
    spheres: int
    rate_in_mould: float
    rate_free: float
    packings: int


# Rates in the mould keep the inertial number at 200 N below 1e-3 (50 mm by 100 mm specimen).
PRESETS = {
    preset.name: preset
    for preset in (
        Preset("quick", 150, 0.045, 0.05, 3),
        Preset("standard", 1000, 0.08, 0.05, 4),
        Preset("fine", 5000, 0.10, 0.05, 2),
    )
}


STILL = Pace(in_mould=0.0, free=0.0, sample_time=0.0)  # of a machine that presses nothing


def specimen(lab: Lab, preset: Preset, number: int = 0) -> Specimen:
    """A lab's cylinder of soil filled with the preset's number of spheres; `number` counts the
    lab's specimens."""
    return _filled(lab, lab.specimens()[number].cylinder, preset)


def virtual_lab(
    lab: Lab, preset: Preset, numerics: Numerics | None = None, number: int = 0
) -> VirtualLab:
    """The tests on one of the lab's specimens at the preset's simulated rates."""
    tested = lab.specimens()[number]
    filled = _filled(lab, tested.cylinder, preset)
    numerics = numerics_for(filled) if numerics is None else numerics
    pace = Pace(preset.rate_in_mould, preset.rate_free, numerics.sample_time)
    apparatus = tuple(test.apparatus(tested.cylinder, pace) for test in tested.tests)
    return VirtualLab.of(filled, TestSequence(apparatus), numerics)


def bare_machine(lab: Lab) -> BareMachine | None:
    """The machine with the lab's tests without soil; None where it has none."""
    tests = tuple(test.apparatus(lab.specimen, STILL) for test in lab.without_soil())
    return BareMachine(TestSequence(tests)) if tests else None


def _filled(lab: Lab, cylinder: Cylinder, preset: Preset) -> Specimen:
    """A cylinder filled to the lab's density."""
    density = {"density": float(np.mean(lab.density_kg_m3))} if lab.density_kg_m3 else {}
    return Specimen(
        diameter=cylinder.diameter, height=cylinder.height, count=preset.spheres, **density
    )


def numerics_for(cylinder: Specimen, **choices) -> Numerics:
    """Numerics sampled so often that spheres falling off the top stay within their skin."""
    skin = Numerics().skin * 2 * cylinder.mean_radius()
    fall = 1.5 * float(np.sqrt(2 * GRAVITY * cylinder.height))
    return Numerics(sample_time=0.5 * skin / fall, **choices)
