"""A vane in soil of known strength: T = tau pi D^2 H/2 (1 + D/(3 H)), term by term.

The soil that a vane cuts out turns with it.  Here it is one body, a cylinder, and spheres that
cannot move hold it on mantle and ends, each with mu (f + f_min (d/d_min)^x) of EEPA.  So T is the
sum of strength x arm, and the more spheres there are the nearer it comes to tau K.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.base import Readings
from jdem.apparatus.penetration import plate
from jdem.apparatus.vane import VaneShear, vane_constant
from jdem.bodies.spheres import Spheres
from jdem.boundaries.composite import CELL_SURFACES, cell
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed, plan_grid
from jdem.engine.loop import begun, run
from jdem.engine.segment import stack
from jdem.materials.soil import SoilParameters

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
