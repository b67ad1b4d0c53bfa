"""Presets: how finely a virtual laboratory is resolved, and what that costs.

| preset | spheres | across a specimen of height 2 D | use |
|---|---|---|---|
| quick | 150 | 4.7 | trying, tests |
| standard | 2000 | 10.6 | results |
| fine | 10000 | 17.9 | checks of resolution |

What a run costs stands in benchmarks/results/README.md.
"""

from dataclasses import dataclass

import numpy as np

from calibrate.core.errors import InputError
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.labtests.base import Pace
from calibrate.labtests.measured import Cylinder
from jdem.engine.bed import Numerics, reach_of
from jdem.engine.step import GRAVITY
from jdem.laboratory.bare_machine import BareMachine
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.catalogue import parameters_of
from jdem.packing.specimen import Specimen


@dataclass(frozen=True)
class Preset:
    """Number of spheres, simulated platen speeds (m/s) on a specimen in its mould and on a free
    one, packings averaged over; whether beds grow to a porosity or settle as they fall; fresh
    packings that a fit is checked on, spheres of the beds that it explores with (None: the same);
    numbers are kept in double precision (float64) or in single (float32)."""

    name: str
    spheres: int
    rate_in_mould: float
    rate_free: float
    packings: int
    grown: bool = False
    fresh: int = 3
    explored: int | None = None
    dtype: str = "float64"


NARROWEST = 3.0  # spheres across a specimen
SPARE = 1.05  # of the gap across which contacts act
# The end of a parameter at which that gap is widest.
FARTHEST = {
    "gamma": max,
    "shear_modulus": min,
    "tensile_strength": max,
    "normal_stiffness": min,
}

# Rates in the mould keep the inertial number at 200 N below 1e-3 (50 mm by 100 mm specimen).
PRESETS = {
    preset.name: preset
    for preset in (
        Preset("quick", 150, 0.045, 0.05, 3),
        Preset("standard", 2000, 0.08, 0.05, 4, grown=True, fresh=12, explored=500),
        Preset("fine", 10_000, 0.10, 0.05, 2, grown=True, fresh=3, explored=1000),
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
    numerics = numerics_for(filled, dtype=preset.dtype) if numerics is None else numerics
    sphere = 2 * filled.mean_radius()
    pace = Pace(preset.rate_in_mould, preset.rate_free, numerics.sample_time, sphere)
    apparatus = tuple(test.machine(tested.cylinder, pace) for test in tested.tests)
    return VirtualLab.of(filled, TestSequence(apparatus), numerics, reach=_reach(lab, filled))


def _reach(lab: Lab, filled: Specimen) -> float:
    """The gap (m) across which contacts of the lab's law act: the stickiest or strongest, and the
    softest ones that its values, bounds and named sets allow, and a little more, as sizes are
    drawn."""
    soil, size = base_soil(lab), (2 * filled.mean_radius(), filled.max_radius())
    if reach_of(soil, *size) == 0.0:
        return 0.0
    known = parameters_of(lab.particles.conventions)
    ends = {name: end(_allowed(lab, name)) for name, end in FARTHEST.items() if name in known}
    return SPARE * reach_of(with_values(soil, ends), *size)


def _allowed(lab: Lab, name: str) -> list[float]:
    """The values of a parameter that the lab file states, and the bounds of a fit."""
    search = parameters_of(lab.particles.conventions)[name].search
    named = lab.differing().get(name, [name])
    every = [lab.parameters[each] for each in named if each in lab.parameters]
    stated = [end for each in every for end in (each.low, each.value, each.high)]
    found = [value for value in stated if value is not None]
    choice = every[0] if every else None
    found += [values[name] for values in lab.named_sets.values() if name in values]
    if search is not None and not (choice and choice.free is False):
        found += [search.low] if choice is None or choice.low is None else []
        found += [search.high] if choice is None or choice.high is None else []
    return [*found, float(base_soil(lab).values()[name])]


def bare_machine(lab: Lab) -> BareMachine | None:
    """The machine with the lab's tests without soil; None where it has none."""
    tests = tuple(test.apparatus(lab.specimen, STILL) for test in lab.without_soil())
    return BareMachine(TestSequence(tests)) if tests else None


def _filled(lab: Lab, cylinder: Cylinder, preset: Preset) -> Specimen:
    """A cylinder filled to the lab's density and porosity."""
    density = {"density": float(np.mean(lab.density_kg_m3))} if lab.density_kg_m3 else {}
    filled = Specimen(
        diameter=cylinder.diameter,
        height=cylinder.height,
        count=preset.spheres,
        porosity=lab.particles.porosity,
        **density,
    )
    across = cylinder.diameter / (2 * filled.mean_radius())
    if across < NARROWEST:
        problem = f"{preset.spheres} spheres are {across:.1f} across this specimen"
        repair = f"give a finer --preset: below {NARROWEST:.0f} there is no bed"
        raise InputError(lab.file, "specimen", problem, repair)
    usual = preset.grown and filled.porosity is None
    return filled.at_usual_porosity() if usual else filled


def numerics_for(cylinder: Specimen, **choices) -> Numerics:
    """Numerics sampled so often that spheres falling off the top stay within their skin."""
    skin = Numerics().skin * 2 * cylinder.mean_radius()
    fall = 1.5 * float(np.sqrt(2 * GRAVITY * cylinder.height))
    return Numerics(sample_time=0.5 * skin / fall, **choices)
