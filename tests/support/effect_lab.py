"""A small bed in which effects are tried: forces are half the paper's, crushing is short."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jax import Array

from calibrate.simulation.resolution import numerics_for
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.laboratory.virtual_lab import Outcome, TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Specimen

SMALL = Specimen(count=60, height=0.06)
NUMERICS = numerics_for(SMALL)
SOIL = SoilParameters()
HOLD = 0.005  # s, simulated
ROWS = 7000  # of a record; test_lab and test_view have as many, so that programs are the same


def both_tests(hold=0.0):
    confined = ConfinedCompression(
        simulated_rate=0.05,
        force_low=100.0,
        force_high=200.0,
        stroke=0.2 * SMALL.height,
        hold=hold,
    )
    return TestSequence((confined, UnconfinedCompression(stroke=1e-3, rest=2e-3, opening=1e-4)))


def small_lab(tests, effects=()):
    """A laboratory for the small bed with room for ROWS samples."""
    lab = VirtualLab.of(SMALL, tests, NUMERICS, effects)
    assert lab.capacity <= ROWS
    return replace(lab, capacity=ROWS)


def lab_with(*effects, hold=0.0):
    lab = small_lab(both_tests(HOLD), effects)
    return eqx.tree_at(lambda lab: lab.tests, lab, both_tests(hold))


def arrays(tree):
    return [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]


def assert_same(ours, theirs):
    for a, b in zip(arrays(ours), arrays(theirs), strict=True):
        np.testing.assert_array_equal(a, b)


def depth_of(outcome: Outcome) -> Array:
    """Depression depth, m."""
    return outcome.observables["confined"]["depression_depth"]


def force_of(outcome: Outcome) -> Array:
    """Crushing force, N."""
    return outcome.observables["unconfined"]["crushing_force"]
