"""Tests that bring tools along: surfaces of revolution against closed forms, a plate on one sphere,
tools of several tests in one sequence, and what is recorded of them."""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.base import TORQUE, Channel, Gauged, Readings, machine_segment, numbered
from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.direct_shear import DirectShear, round_box
from jdem.apparatus.penetration import (
    MeanPressure,
    Penetration,
    PressureAt,
    cone,
    cone_length,
    plate,
)
from jdem.apparatus.repose import SOLID, Heap
from jdem.apparatus.vane import VaneShear, vane_constant
from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import DOWN, FAR, UP, along, point
from jdem.boundaries.composite import CELL_SURFACES, cell
from jdem.boundaries.revolved import Revolved
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed, plan_grid
from jdem.engine.loads import boundary_overlaps
from jdem.engine.loop import begun, run
from jdem.engine.segment import CELL, PLATEN, REMOVE, stack
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.contact_laws import BED_LAWS
from jdem.materials.soil import SoilParameters
from jdem.observables import Curve
from jdem.packing.specimen import Packing, Specimen

RADIUS = 2.5e-3
ORIGIN = point(0.0, 0.0, 0.0, float)
CONE = [(0.0, 0.0), (0.01, 0.02)]  # half angle atan(1/2), opening along its axis
PLAIN = SoilParameters(
    restitution=0.5, surface_energy=0.0, rolling_friction=0.0, shear_modulus=12e6,
    platen_friction=0.0, wall_friction=0.0, conventions=BED_LAWS["hertz_mindlin"],
)  # fmt: skip


def at(*places):
    return Vector.from_rows(jnp.asarray(places, float))


def test_the_nearest_point_is_on_the_flank_at_the_apex_or_on_the_edge():
    body = Revolved.of(CONE, ORIGIN, UP)
    flank = np.array([0.005, 0.01]) + 0.003 * np.array([2.0, -1.0]) / np.sqrt(5)
    position = at([flank[0], 0.0, flank[1]], [0.0, 0.0, -0.004], [0.0, 0.013, 0.024])
    surface = body.surface(position)
    np.testing.assert_allclose(surface.distance, [0.003, 0.004, 0.005], rtol=1e-12)
    expected = [[2 / np.sqrt(5), 0.0, -1 / np.sqrt(5)], [0.0, 0.0, -1.0], [0.0, 0.6, 0.8]]
    np.testing.assert_allclose(surface.normal.stack(), expected, atol=1e-12)


def test_a_tool_is_lowered_onto_the_first_sphere_under_it():
    """Of many spheres none is touched before, whichever part of the line meets it."""
    random = np.random.default_rng(3)
    for line in (CONE, [(0.0, 0.0), (0.01, 0.0), (0.01, -0.004)], [(0.008, 0.0), (0.008, -0.01)]):
        body = Revolved.of([(r, -z) for r, z in line] if line is CONE else line, ORIGIN, DOWN)
        places = random.uniform([-0.02, -0.02, -0.08], [0.02, 0.02, -0.05], (40, 3))
        radius = jnp.asarray(random.uniform(0.001, 0.004, 40))
        gap = body.removed().touching(at(*places), radius).distance(at(*places)) - radius
        assert float(gap.min()) == pytest.approx(0.0, abs=1e-13)
        lifted = replace(body.touching(at(*places), radius), made_at=ORIGIN)
        higher = lifted.distance(at(*(places - [0.0, 0.0, 1e-4]))) - radius
        assert float(higher.min()) > 0.0


def test_a_line_needs_two_points_on_its_side_of_the_axis():
    with pytest.raises(ValueError, match="two or more"):
        Revolved.of([(0.0, 0.0)], ORIGIN, UP)
    with pytest.raises(ValueError, match="0 or more"):
        Revolved.of([(0.0, 0.0), (-0.1, 0.0)], ORIGIN, UP)


# ---------------------------------------------------------------- one sphere under a tool


def one_sphere(test, height=0.02, soil=PLAIN):
    """A sphere on the base of a wide mould, and what a test finds."""
    mass = 1830 * 4 / 3 * np.pi * RADIUS**3
    spheres = Spheres(jnp.asarray([RADIUS]), jnp.asarray([mass]))
    packing = Packing(at([0.0, 0.0, RADIUS]), spheres, height, 0.03)
    specimen = Specimen(diameter=0.06, height=height, count=64, porosity=0.4)
    numerics = Numerics(sample_time=2e-4, smoothing=Smoothing.sharp())
    lab = VirtualLab.of(specimen, TestSequence(test), numerics)
    return eqx.filter_jit(VirtualLab.run)(lab, packing, soil)


def squeezed(stroke):
    """A plate pressed on the sphere, slowly."""
    area = np.pi / 4 * 0.02**2
    gauges = (
        MeanPressure(area=area, low=0.0, high=stroke),
        PressureAt(area=area, depth=0.5 * stroke, window=0.02 * stroke),
    )
    return Penetration(plate(0.02, 2e-3), gauges, 5e-4, 0.01, stroke, rest=0.02, name="plate")


@pytest.fixture(scope="module")
def pressed():
    return one_sphere((squeezed(4e-5),))


def test_the_inertial_number_of_a_tool_is_that_of_the_soil_it_shears():
    """A plate at 0.5 mm/s, 20 mm wide: 0.025 1/s; the first gauge's pressure."""
    plain = squeezed(1e-3)
    assert plain.sheared({"cone_index": 5e3}, 1e-3) is None
    known = replace(plain, width=0.02)
    assert known.sheared({"cone_index": 5e3}, 1e-3) == (pytest.approx(0.025), 5e3)
    gauged = Gauged.of(known.at_rate(2.0), ())
    assert gauged.width == 0.02
    assert gauged.sheared({"cone_index": 5e3}, 1e-3)[0] == pytest.approx(0.05)


HERTZ = 4 / 3 * 12e6 / 0.7 * np.sqrt(RADIUS)  # N/m^1.5 of a sphere on a plane
WEIGHT = 9.81 * 1830 * 4 / 3 * np.pi * RADIUS**3


def test_a_plate_on_one_sphere_follows_hertz(pressed):
    """Way of the plate: overlaps d(F) above and d(F + W) below, of which d(W) was there before,
    with F = 4/3 E* sqrt(R) d^1.5."""
    curve = pressed.curves["plate"]
    rows = np.asarray(curve.valid) > 0
    way, force = np.asarray(curve.displacement)[rows], np.asarray(curve.force)[rows]
    begun = 0.5 * 5e-4 * 2e-4  # the first sample is a mean over some way
    below, before = ((force + WEIGHT) / HERTZ) ** (2 / 3), (WEIGHT / HERTZ) ** (2 / 3)
    expected = (force / HERTZ) ** (2 / 3) + below - before
    late = way > 1e-5
    np.testing.assert_allclose((way - way[0] + begun)[late], expected[late], rtol=0.01)
    area = np.pi / 4 * 0.02**2
    found = pressed.observables["plate"]
    mean = np.trapezoid(force, way) / 4e-5 / area
    assert float(found["cone_index"]) == pytest.approx(mean, rel=0.03)
    half = np.interp(2e-5, way, force) / area
    assert float(found["sinkage_pressure"]) == pytest.approx(half, rel=0.02)
    assert not bool(pressed.failed)


@pytest.mark.slow
@pytest.mark.parametrize(("rolling", "slides"), [(5.0, True), (0.1, False)])
def test_a_box_reads_the_friction_of_a_block_and_the_resistance_of_a_roller(rolling, slides):
    """One sphere between floor and lid, N on it.  If it cannot roll, it slides as a block: mu N.
    Else both moments mu_r N R turn about arms R - d, d the overlap after Hertz:
    T = mu_r N R/(R - d)."""
    friction, force, travel = 0.3, 2.0, 1e-3
    area = np.pi / 4 * 0.06**2
    halves = round_box(0.06, 2 * RADIUS, RADIUS, 1e-3, 2 * travel)
    box = DirectShear(
        *halves, area=area, normal_force=force, stroke=travel, servo_width=0.15 * force, name="box"
    )
    of_walls = dict.fromkeys(("platen_friction", "wall_friction"), friction)
    soil = replace(PLAIN, static_friction=friction, rolling_friction=rolling, **of_walls)
    outcome = one_sphere((box,), 2 * RADIUS, soil)
    overlap = (force / HERTZ) ** (2 / 3)
    rolled = rolling * force * RADIUS / (RADIUS - overlap)
    found = {name: float(x) * area for name, x in outcome.observables["box"].items()}
    expected = friction * force if slides else rolled
    assert found["residual_shear_stress"] == pytest.approx(expected, rel=2e-3)
    assert found["plane_stress"] == pytest.approx(force + WEIGHT, rel=1e-3)


def test_overlaps_with_boundaries_are_those_of_their_forces(pressed):
    state = pressed.record.state
    found = boundary_overlaps(Spheres(jnp.full(1, RADIUS), jnp.full(1, 1.0)), state)
    push = np.maximum(np.asarray(state.wall_force), 0.0)
    assert push[0] > push[CELL] > 0.0
    np.testing.assert_allclose(RADIUS * found, (push / HERTZ) ** (2 / 3), rtol=0.01)


def test_what_pushes_is_what_the_base_feels(pressed):
    loads = np.asarray(pressed.record.samples.loads)
    last = np.flatnonzero(np.asarray(pressed.record.samples.segment) >= 0)[-1]
    assert loads[last, CELL, 2] == pytest.approx(-loads[last, 0, 2] - WEIGHT, rel=1e-3)
    ledger = pressed.record.state.energy
    assert float(ledger.boundaries[CELL]) > 0
    assert float(ledger.supplied()) == pytest.approx(float(ledger.absorbed()), rel=0.02)


# ---------------------------------------------------------------- tools of several tests


def test_each_test_numbers_its_own_tools():
    own = machine_segment(2, speed={CELL: 0.1, CELL + 1: 0.2}, placed={PLATEN: REMOVE}, servo=CELL)
    wide = numbered(own, 1, 2)
    np.testing.assert_allclose(wide.speed, [0, 0, 0, 0, 0.1, 0.2, 0, 0])
    np.testing.assert_array_equal(wide.placed, [0, REMOVE, 0, REMOVE, 0, 0, REMOVE, REMOVE])
    assert int(wide.servo) == CELL + 1
    assert int(numbered(machine_segment(0, servo=PLATEN), 3, 0).servo) == PLATEN


@pytest.mark.slow
def test_tools_are_away_while_another_test_runs():
    """The platen presses the sphere first; cone and shaft, then a plate come to the same force."""
    pressing = ConfinedCompression(
        simulated_rate=0.004, force_low=0.02, force_high=0.04, servo_width=0.004, tolerance=0.002,
        stroke=0.02, seating_force=0.005,
    )  # fmt: skip
    tip = Penetration(cone(0.02, 60.0, 0.01), (), 0.002, 0.03, 2e-5, rest=0.01, name="cone")
    found = one_sphere((pressing, tip, squeezed(2e-5)), height=2.1 * RADIUS)
    samples = found.record.samples
    segment, place = np.asarray(samples.segment), np.asarray(samples.reference)[..., 2]
    tools = slice(CELL, CELL + 3)
    assert np.abs(place[(segment >= 0) & (segment < 3)][:, tools]).min() > 0.9 * FAR
    last = np.flatnonzero(segment >= 0)[-1]
    assert place[last, CELL] > 0.9 * FAR and place[last, CELL + 2] < 0.01
    pushed = segment == 4
    length = 0.01 / np.tan(np.radians(30.0))
    assert cone_length(0.02, 60.0) == pytest.approx(length)
    tips, shafts = place[pushed][:, CELL], place[pushed][:, CELL + 1]
    np.testing.assert_allclose(tips, shafts, atol=1e-12)  # both count from the apex
    ends = [np.asarray(found.curves[n].force).max() for n in ("cone", "plate")]
    assert ends[0] == pytest.approx(ends[1], rel=0.1)
    assert float(np.abs(found.channels["cone"]["shaft"]).max()) == 0.0


def test_a_channel_says_what_it_may_be():
    with pytest.raises(ValueError, match="force, torque, place"):
        Channel("angle", "angle")
    assert Channel("torque", TORQUE).unit == "N m"


def test_pressures_are_read_between_and_at_depths():
    depth = jnp.linspace(-0.01, 0.03, 81)
    curve = Curve(depth, 100.0 * jnp.maximum(depth, 0.0), jnp.ones(81))
    mean = MeanPressure(area=2e-4, low=0.01, high=0.02).of(curve, jnp.zeros(81))
    assert float(mean) == pytest.approx(100 * 0.015 / 2e-4)
    there = PressureAt(area=2e-4, depth=0.02, window=1e-3).of(curve, jnp.zeros(81))
    assert float(there) == pytest.approx(100 * 0.02 / 2e-4)
    beyond = MeanPressure(area=2e-4, low=0.02, high=0.04).of(curve, jnp.zeros(81))
    assert np.isnan(float(beyond))  # and not the mean of what there is
    assert float(along(DOWN, at([0.0, 0.0, -2.0]))[0]) == 2.0


# ------------------------------------------------------------------ heaps


def heap_of(height, spacing=0.001):
    """Spheres on a shaken cubic lattice, as dense as a heap is reckoned with, below `height` (m) by
    distance from the axis (m)."""
    ticks = np.arange(-0.06, 0.06, spacing) + spacing / 2
    places = np.stack(np.meshgrid(ticks, ticks, ticks[ticks > 0], indexing="ij"))
    places += spacing * (np.random.default_rng(1).random(places.shape) - 0.5)
    off = np.hypot(*places[:2])
    off, x, y, z = (part[places[2] < height(off)] for part in (off, *places))
    radius = np.full(len(z), spacing * (SOLID * 3 / (4 * np.pi)) ** (1 / 3))
    return Heap(*map(jnp.asarray, (off, np.arctan2(y, x), z, radius, np.ones(len(z)))))


@pytest.mark.parametrize("degrees", [20.0, 35.0])
def test_the_slope_of_a_cone_is_its_angle(degrees):
    """The highest spheres' is flatter, since some rings lack theirs, height over base steeper."""
    slope = np.tan(np.radians(degrees))
    found = heap_of(lambda off: slope * (0.035 - off)).measured()
    assert np.degrees(found["repose_angle"]) == pytest.approx(degrees, abs=0.5)
    assert degrees - 3 < np.degrees(found["repose_angle_by_top"]) < degrees
    assert degrees < np.degrees(found["repose_angle_by_height"]) < degrees + 3
    assert found["heap_height"] == pytest.approx(0.035 * slope, abs=0.001)


def test_a_heap_without_a_flank_has_no_slope():
    """A cylinder as high as wide: one ring of spheres at its edge is half full."""
    found = heap_of(lambda off: np.where(off < 0.02, 0.03, 0.0)).measured()
    assert np.isnan(found["repose_angle"])
    assert found["heap_height"] == pytest.approx(0.03, abs=0.002)


# ---------------------------------------------------------------- a ring around a vane
# The soil that a vane cuts out turns with it.  Here it is one body, a cylinder, and spheres that
# cannot move hold it on mantle and ends, each with mu (f + f_min (d/d_min)^x) of EEPA.  So T is the
# sum of strength x arm, and the more spheres, the nearer to tau pi D^2 H/2 (1 + D/(3 H)).

DIAMETER, TALL = 0.04, 0.08  # m, of the plug of soil that a vane turns
HELD, PRESSED = 1e-3, 1e-5  # m; radius of the spheres around it, and how deep they are pressed
GOLDEN = math.pi * (3 - math.sqrt(5))  # rad, between one sphere and the next
FIXED = 1e9  # kg; nothing moves such a sphere
STICKY = SoilParameters(
    restitution=1.0, wall_adhesion=1.0, surface_energy=2.0, reference_diameter=2 * HELD,
    platen_friction=0.5,
)  # fmt: skip


def around_plug(ends: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (N, 3) of spheres that touch a plug, `ends` of them each end and as many to an area
    the mantle, and the arms of their contacts about its axis (N,), m."""
    reach, away = DIAMETER / 2, HELD - PRESSED
    mantle = round(4 * TALL / DIAMETER * ends)
    number, along = np.arange(ends), np.arange(mantle)
    out = reach * np.sqrt((number + 0.5) / ends)
    disc = np.stack([out * np.cos(GOLDEN * number), out * np.sin(GOLDEN * number)], axis=1)
    wide, up = reach + away, TALL * (along + 0.5) / mantle
    side = np.stack([wide * np.cos(GOLDEN * along), wide * np.sin(GOLDEN * along), up], axis=1)
    faces = [np.column_stack([disc, np.full(ends, z)]) for z in (-away, TALL + away)]
    return np.concatenate([*faces, side]), np.concatenate([out, out, np.full(mantle, reach)])


def strength() -> float:
    """What one sphere holds against sliding, N: mu (k1 d + f_min (d/d_min)^x), by hand."""
    soil, overlap = STICKY, PRESSED
    shear, poisson = float(soil.shear_modulus), float(soil.poisson_ratio)
    modulus = shear / (1 - poisson)  # E* of two equal bodies
    stiff = float(soil.stiffness_factor) * modulus * HELD  # k1
    share, exponent = float(soil.plasticity_ratio), float(soil.tensile_exponent)
    unloading, plastic = stiff / (1 - share), share * overlap
    lens = math.sqrt(2 * HELD * plastic - plastic**2 / 4)
    free = 1.5 * math.pi * float(soil.surface_energy) * lens
    tension = min(free, unloading * plastic / 2)
    least = plastic - tension / unloading
    held = stiff * overlap + tension * (overlap / least) ** exponent
    return float(soil.platen_friction) * held


def ring(ends: int) -> dict[str, float]:
    """Torques (N m) of a plug that all spheres around hold alike: read off by a vane test, the sum
    of strength x arm, and tau K; and tau (Pa), as the test finds it and as it is."""
    centres, arms = around_plug(ends)
    count, plug = len(centres), plate(DIAMETER, TALL)[0]
    test = VaneShear(vane=plug, constant=vane_constant(DIAMETER, TALL), stroke=0.05)
    numerics = Numerics(smoothing=Smoothing.sharp(), sample_time=1e-4)
    extent = (2 * DIAMETER, 2 * TALL)
    grid = plan_grid(count, HELD, HELD, extent, numerics, touched=plug.area)
    spheres = Spheres(jnp.full(count, HELD), jnp.full(count, FIXED))
    surfaces = (*CELL_SURFACES, "platen")
    step = jnp.asarray(1e-5)
    bed = build_bed(spheres, STICKY, grid, numerics, step, surfaces, follows=None)
    bed = replace(bed, gravity=jnp.zeros(()))
    away = [b.removed() for b in cell(1.0, 1.0, centres.dtype)]
    state = begun(bed, Vector.from_rows(jnp.asarray(centres)), (*away, plug.boundary))
    turning = cast(stack([test.movements()[-1].segment]), centres.dtype)
    samples = eqx.filter_jit(run)(bed, state, turning, jnp.asarray(10), 200).samples
    torque, time = test.force.read(samples, 0), samples.time
    rows = jnp.where(samples.segment == 0, len(test.movements()) - 1, -1)
    found = test.read(Readings(time, torque, time=time), rows).observables
    held = strength()
    area = math.pi * DIAMETER * (TALL + DIAMETER / 2)
    tau = held * count / area
    return {
        "spheres": count, "torque": float(found["residual_torque"]),
        "sum": held * float(arms.sum()), "form": tau * vane_constant(DIAMETER, TALL),
        "tau": tau, "found": float(found["vane_strength"]),
    }  # fmt: skip


@pytest.mark.slow
def test_a_vane_in_a_ring_of_known_strength_reads_it():
    """The sum to round-off; tau K as nearly as 500 spheres stand for a surface."""
    found = ring(50)
    assert found["torque"] == pytest.approx(found["sum"], rel=1e-7)
    assert found["torque"] == pytest.approx(found["form"], rel=1e-4)
    assert found["found"] == pytest.approx(found["tau"], rel=5e-4)
