"""A test as a list of steps: its movements, and what it gives on a small bed."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from calibrate.simulation.run import not_simulated
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.protocol import LONGEST_HOLD, Protocol, Step
from jdem.boundaries.composite import PLATEN
from jdem.engine.bed import Numerics
from jdem.engine.segment import KEEP, LOWER, REMOVE
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.observables import ForceLeft, LargestDisplacement
from jdem.packing.composite import prepare
from jdem.packing.specimen import Specimen

pytestmark = pytest.mark.thorough

SPECIMEN = Specimen(diameter=0.05, height=0.05, count=48)  # that of TINY: one program settles both
CYCLE = (
    Step("force", "load", 100.0),
    Step("hold", "hold", 60.0),
    Step("force", "unload", 10.0),
    Step("force", "reload", 150.0),
)


def cycle() -> Protocol:
    gauges = (ForceLeft(held=1), LargestDisplacement())
    return Protocol(CYCLE, gauges=gauges, name="cycle", stroke=0.02)


def test_steps_become_movements_of_the_machine():
    steps = (*CYCLE, Step("open", "open"), Step("rest", "rest", 1.0), Step("travel", "crush", 2e-3))
    movements = Protocol(steps).movements()
    platen = [int(m.segment.placed[PLATEN]) for m in movements]
    assert platen == [LOWER, KEEP, KEEP, KEEP, REMOVE, KEEP, LOWER]
    assert [m.free for m in movements] == [False] * 4 + [True] * 3
    assert [m.testing for m in movements] == [True] * 4 + [False] * 2 + [True]
    assert [m.resting for m in movements] == [False] * 5 + [True, False]
    assert float(movements[6].segment.duration) == pytest.approx(2e-3 / 0.05)


def test_a_hold_lasts_as_long_in_the_laboratory_as_it_says():
    for time in (1e-3, 60.0):
        (held,) = Protocol((Step("hold", "hold", time, 1e-3),)).movements()
        assert float(held.segment.duration) <= LONGEST_HOLD
        assert float(held.segment.duration * held.time_scale) == pytest.approx(time)


def test_tests_of_one_sequence_have_names_of_their_own():
    with pytest.raises(ValueError, match="each its own name"):
        TestSequence((cycle(), cycle()))
    with pytest.raises(ValueError, match="at least one"):
        TestSequence(())


def test_a_step_keeps_the_force_of_the_step_before_it():
    steps = (Step("force", "load", 100.0), Step("keep", "creep", 60.0))
    _, kept = Protocol(steps).movements()
    assert float(kept.segment.force_target) == 100.0 and float(kept.segment.tolerance) == 0.0


def test_what_no_machine_can_do_is_refused():
    with pytest.raises(ValueError, match="no kind of step 'push'"):
        Step("push", "push")
    with pytest.raises(ValueError, match="no force to keep"):
        Protocol((Step("travel", "down", 1e-3), Step("keep", "creep", 60.0)))


def test_no_observable_hides_that_of_another_test():
    twice = TestSequence((cycle(), replace(cycle(), name="again")))
    lab = VirtualLab.of(SPECIMEN, twice, Numerics())
    named = not_simulated(lab, "the machine failed").observables
    assert set(named) == {
        f"{test}.{name}"
        for test in ("cycle", "again")
        for name in ("force_left_n", "settlement_mm")
    }


@pytest.fixture(scope="module")
def outcome():
    """A second cycle after confined compression of the same specimen."""
    tests = TestSequence((ConfinedCompression(0.05, force_low=40.0, force_high=80.0), cycle()))
    lab = VirtualLab.of(
        SPECIMEN, tests, Numerics(pairs_per_sphere=6.0, wall_layer=8.0, per_cell=12)
    )
    return lab, eqx.filter_jit(VirtualLab.run)(lab, prepare(SPECIMEN, 1), SoilParameters())


@pytest.mark.slow
def test_a_sequence_gives_curves_and_observables_by_test(outcome):
    _, found = outcome
    assert not bool(found.failed)
    assert set(found.curves) == {"confined", "cycle"}
    assert set(found.observables["cycle"]) == {"force_left", "settlement"}
    assert all(bool(jnp.isfinite(v)) for v in found.observables["cycle"].values())


@pytest.mark.slow
def test_the_machine_goes_where_the_steps_say(outcome):
    lab, found = outcome
    segment = np.asarray(found.record.samples.segment)
    force = np.asarray(found.record.samples.platen_force)
    first = lab.tests.first_movement(1)
    assert first == 3 and lab.tests.names[first:] == ("load", "hold", "unload", "reload")
    ends = [force[np.flatnonzero(segment == first + k)[-1]] for k in range(4)]
    assert ends[0] == pytest.approx(100.0, abs=1.0)
    assert ends[2] == pytest.approx(10.0, abs=1.0)
    assert ends[3] == pytest.approx(150.0, abs=1.0)
    assert ends[1] == pytest.approx(float(found.observables["cycle"]["force_left"]), rel=1e-6)
    assert 80.0 < ends[1] < 101.0  # it relaxes a little and gains nothing


@pytest.mark.slow
def test_reloading_is_stiffer_than_loading(outcome):
    """Plastic contacts: from 10 to 90 N the platen goes less far the second time."""
    lab, found = outcome
    samples = found.record.samples
    segment, first = np.asarray(samples.segment), lab.tests.first_movement(1)
    ways = []
    for number in (first, first + 3):
        rows = segment == number
        force = np.maximum.accumulate(np.asarray(samples.platen_force)[rows])
        travel = -np.asarray(samples.platen_height)[rows]
        ways.append(float(np.diff(np.interp([85.0, 98.0], force, travel))[0]))
    assert 0 < ways[1] < 0.7 * ways[0]
