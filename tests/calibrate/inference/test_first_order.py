"""Slopes of features from derivatives that JAX took: on a small bed, against differences of runs.

Forty spheres are pressed with 50 N in the mould and do nothing else.  Their response is rough, so a
slope over +-20 % differs from a derivative by some per cent even where both are right.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibrate.inference.parameters import space
from calibrate.inference.problem import pose
from calibrate.inference.traced import FirstOrder
from calibrate.io.lab import Lab, bundled_lab, load_lab
from calibrate.io.soil import base_soil
from calibrate.simulation import Campaign
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab

pytestmark = pytest.mark.thorough

FREE = ("shear_modulus",)
QUICK = replace(PRESETS["quick"], spheres=40)
TARGETS = '[tests.targets]\ndepression_depth = { mean = "3 mm", scatter = "0.1 mm", repeats = 4 }\n'


def laboratory(folder: Path) -> Lab:
    """The bundled soil, in a lab that presses it in the mould and does nothing else."""
    bundled = load_lab(bundled_lab())
    soil = base_soil(bundled)
    values = "".join(
        f"{name} = {float(getattr(soil, name))!r}\n"
        for name, choice in bundled.parameters.items()
        if choice.value is not None
    )
    density = ", ".join(f'"{value} kg/m^3"' for value in bundled.density_kg_m3)
    path = folder / "lab.toml"
    path.write_text(
        f'[soil]\nname = "pressed"\ndensity = [{density}]\n'
        '[specimen]\ndiameter = "50 mm"\nheight = "50 mm"\n'
        '[[tests]]\ntype = "confined"\nrate = "8 mm/s"\nforce_low = "25 N"\n'
        f'force_high = "50 N"\n{TARGETS}'
        '[particles]\npoisson_ratio = 0.3\nreference_diameter = "80 um"\n'
        f"[parameters]\n{values}"
    )
    return load_lab(path)


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """The lab and its simulations."""
    folder = tmp_path_factory.mktemp("pressed")
    lab = laboratory(folder)
    return lab, Campaign(virtual_lab(lab, QUICK), specimen(lab, QUICK), folder)


@pytest.mark.slow
def test_slopes_of_a_bed_are_those_of_its_response_and_are_kept(pressed):
    lab, work = pressed
    free, problem, seeds = space(lab, FREE), pose(lab), (0,)
    first = FirstOrder(work, free)
    found = first.slopes(problem, free.start(), seeds, "slopes")
    soils = [[free.soil(free.start() * factor)] for factor in np.exp([0.2, -0.2])]
    up, down = (problem.simulated(row) for row in work.each(soils, seeds, "differences"))
    difference = ((up - down) / 0.4)[0]
    assert difference[0] < -0.3
    np.testing.assert_allclose(np.asarray(found.slopes)[:, 0], difference, rtol=0.15)

    def refused(*_):
        raise AssertionError("a derivative that is kept was taken again")

    first._program = refused
    again = first.slopes(problem, free.start(), seeds, "slopes")
    np.testing.assert_array_equal(np.asarray(again.slopes), np.asarray(found.slopes))
