"""Soils and paths on which every contact law is tried, and what a law returns along them; laws by
name; other codes' curves.

Soils are the corners of a Plackett-Burman design of the seven calibrated factors, one with
tensile exponent 5, and two with the large surface energies that coarse spheres carry, at
which the adhesion's cap acts.  A path of overlaps visits every kink of EEPA.  Laws are pure
functions of arrays, so all soils of one slope exponent run in one compiled program; paths have
few lengths for the same reason.
"""

import json
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jdem.apparatus.pair import (
    Encounter,
    Path,
    SpherePair,
    drive_overlap,
    drive_path,
    overlap_path,
)
from jdem.core.quantity import cast
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.materials.contact_laws import CONTACT_LAWS, Stated
from jdem.materials.soil import SoilParameters, particle_law
from tests import DATA

RADIUS = 2.5e-3
PAIR = SpherePair(RADIUS)
MOST = 3e-5  # m; largest overlap of a path
POINTS, LEGS = 400, 7  # points of a leg; legs of the longest path
SLIP, APPROACH, TIME_STEP, FRICTION = 2e-3, 1e-3, 1e-5, 0.5

RANGES = {
    "restitution": (0.3, 0.7),
    "static_friction": (0.2, 1.0),
    "rolling_friction": (0.1, 0.6),
    "surface_energy": (4.0, 20.0),
    "plasticity_ratio": (0.2, 0.7),
    "tensile_exponent": (0.5, 3.0),
    "tangential_multiplier": (0.3, 1.0),
}
SCALED_ENERGIES = (400.0, 1500.0)  # J/m2; near the cap, and far above it
EXPONENTS = [1.0, 1.5]
SMOOTHINGS = {"sharp": Smoothing.sharp(), "default": Smoothing()}

every_exponent = pytest.mark.parametrize("exponent", EXPONENTS)
every_smoothing = pytest.mark.parametrize("smoothing", SMOOTHINGS.values(), ids=SMOOTHINGS.keys())


def plackett_burman_signs():
    """Eight runs of seven two-level factors: a generating row, its shifts, all low."""
    generator = np.array([1, 1, 1, 0, 1, 0, 0])
    return np.array([*(np.roll(generator, k) for k in range(7)), np.zeros(7, int)])


PAPER_OPTIMUM = {"plasticity_ratio": 0.358, "rolling_friction": 0.5, "shear_modulus": 12e6}


def soil_of(exponent, **values):
    """The paper's optimum; the reference diameter is the spheres' own (energy not scaled)."""
    given = {**PAPER_OPTIMUM, **values}
    return SoilParameters(**given, reference_diameter=2 * RADIUS, slope_exponent=exponent)


@cache
def corner_soils(exponent):
    corners = [
        soil_of(exponent, **{k: RANGES[k][s] for k, s in zip(RANGES, signs, strict=True)})
        for signs in plackett_burman_signs()
    ]
    steep = soil_of(exponent, tensile_exponent=5.0)
    coarse = [soil_of(exponent, surface_energy=energy) for energy in SCALED_ENERGIES]
    return [*corners, steep, *coarse]


def stacked(soils):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *soils)


def law_of(soil, smoothing=SMOOTHINGS["default"]):
    return particle_law(soil, 2 * RADIUS, smoothing)


def contact_at(overlap, slip=SLIP, friction=FRICTION):
    contact = PAIR.contact(overlap, APPROACH * jnp.ones_like(overlap), TIME_STEP)
    slip = Vector(0.0 * overlap, slip + 0.0 * overlap, 0.0 * overlap)
    changed = (slip, friction + 0.0 * overlap)
    return cast(eqx.tree_at(lambda c: (c.slip, c.friction), contact, changed), overlap.dtype)


def row_of(force):
    """Everything a law returns for one contact, as one row."""
    normal, traction = force.normal, force.traction()
    parts = [normal.hysteretic, normal.viscous, normal.frictional_load]
    return jnp.stack([*parts, traction.x, traction.y, traction.z, force.rolling_limit])


def rows_along(soil, smoothing, overlaps):
    """Rows of force parts, and of memory, along a path of overlaps with steady slip."""
    law = law_of(soil, smoothing)

    def advance(history, overlap):
        force, history = law.force(contact_at(overlap, friction=soil.static_friction), history)
        memory = jnp.stack([*jax.tree.leaves(history.normal), history.tangential.y])
        return history, (row_of(force), memory)

    return jax.lax.scan(advance, law.memory((), overlaps.dtype), overlaps)[1]


def minimum_of(soil):
    """f_min (N) and d_min (m) after loading to MOST, from the law as it is printed."""
    n, k1 = soil.slope_exponent, stiffness_of(soil)
    plastic, k2 = plastic_overlap_of(soil), k1 / (1 - soil.plasticity_ratio)
    lens = np.sqrt(RADIUS * plastic - plastic**2 / 4)
    free, cap = 1.5 * np.pi * soil.surface_energy * lens, k2 * plastic**n / 2
    if free > cap:
        return float(cap), float(plastic / 2)
    return float(free), float((plastic**n - free / k2) ** (1 / n))


def stiffness_of(soil):
    modulus = soil.shear_modulus / (1 - soil.poisson_ratio)  # E* of equal bodies
    linear = 2 * modulus * RADIUS / 2
    return float(linear if soil.slope_exponent == 1.0 else 4 / 3 * modulus * np.sqrt(RADIUS / 2))


def plastic_overlap_of(soil):
    """d_p (m) after loading to MOST."""
    return float(soil.plasticity_ratio) ** (1 / soil.slope_exponent) * MOST


def path_through_every_kink(soil):
    """Zero, virgin loading, both unloading branches, d_min itself, adhesive reload, separation."""
    plastic, turn = plastic_overlap_of(soil), minimum_of(soil)[1]
    loading = [-1e-6, 0.0, 1e-16, 1e-9, 0.5 * MOST, MOST]
    unloading = [plastic, 1.01 * turn, turn, 0.99 * turn, 0.5 * turn]
    reloading = [0.5 * turn, 0.51 * turn, 0.53 * turn, turn, 0.4 * turn, 0.7 * turn]
    ending = [1.2 * MOST, plastic, 0.3 * turn, 1e-9, 1e-16, 0.0, 0.0, -1e-6, 0.2 * MOST]
    return jnp.asarray([*loading, *unloading, *reloading, *ending])


def kink_paths(exponent):
    return jnp.stack([path_through_every_kink(soil) for soil in corner_soils(exponent)])


@eqx.filter_jit
def all_rows(soils, smoothing, overlaps):
    return jax.vmap(rows_along, (0, None, 0))(soils, smoothing, overlaps)


@eqx.filter_jit
def all_jacobians(soils, smoothing, overlaps):
    """Of every row along the path: by the soil's numbers, and by every overlap before."""

    def one(soil, overlap):
        return jax.jacfwd(lambda s, d: rows_along(s, smoothing, d)[0], (0, 1))(soil, overlap)

    return jax.vmap(one)(soils, overlaps)


def sampled_cycle(soil):
    """Loading, adhesive unloading, reload and separation."""
    turn = minimum_of(soil)[1]
    return overlap_path(jnp.asarray([MOST, 0.4 * turn, 0.9 * MOST, -0.01 * MOST]), POINTS)


def last_row(soil, smoothing, turns):
    """Force parts and d_max at the end of a path, which first loads in as many legs, and is taken
    as many times, as make it like the sampled cycles of all soils (one compiled program)."""
    turns = [*np.linspace(0, turns[0], 10 - len(turns))[1:-1], *turns]
    overlaps = overlap_path(jnp.asarray(turns), POINTS // 2)
    alike = len(corner_soils(soil.slope_exponent))
    forces, memory = all_rows(stacked([soil] * alike), smoothing, jnp.stack([overlaps] * alike))
    return np.asarray(forces)[0, -1], float(memory[0, -1, 0])


_drive = eqx.filter_jit(drive_overlap)


def drive(law, overlaps):
    """Normal force (N) along a path; points without contact before it make all paths alike."""
    apart = np.full(LEGS * POINTS - len(overlaps), -MOST)
    return np.asarray(_drive(law, PAIR, np.concatenate([apart, overlaps])))[len(apart) :]


# ------------------------------------------------------------------ laws that have a name

YOUNG, POISSON = 1e7, 0.3
MODULUS = YOUNG / (2 * (1 - POISSON**2))  # E*
SHEAR = YOUNG / (4 * (2 - POISSON) * (1 + POISSON))  # G*


def named(name, young=YOUNG, friction=0.5, poisson=POISSON, **values):
    """A law of equal materials; texts are options.  Numbers are arrays: one program for all."""
    numbers = {k: jnp.asarray(v) for k, v in values.items() if not isinstance(v, str)}
    chosen = {k: v for k, v in values.items() if isinstance(v, str)}
    numbers["static_friction"] = jnp.asarray(friction)
    stated = Stated(jnp.asarray(young), jnp.asarray(poisson), numbers, chosen, Smoothing.sharp())
    return CONTACT_LAWS[name].law(stated)


driven = eqx.filter_jit(drive_path)


def led(
    law, corners, turns=(), held_turns=(), *, radius=RADIUS, held=None, wall=False, friction=0.5
):
    """What happens at the corners (x, z of the centre over first touch, m) of a path."""
    places = np.zeros((12, 3))
    places[:, [0, 2]] = twelve(corners, 2)
    places[:, 2] += radius if wall else radius + (held or radius)
    path = Path(*(jnp.asarray(each) for each in (places, twelve(turns, 3), twelve(held_turns, 3))))
    bodies = Encounter(radius, held or radius, friction, wall=wall)
    return driven(law, bodies, path, 400)


def twelve(rows, width):
    """Twelve rows, the last one repeated, so that one program serves all paths."""
    rows = [*(rows if len(rows) else [[0.0] * width])]
    return np.array([*rows, *[rows[-1]] * (12 - len(rows))])


# ------------------------------------------------------------------ other codes' curves

FOLLOWED = np.load(DATA / "contact_curves.npz")  # rows by case, see data/README.md
STATED = json.loads(str(FOLLOWED["cases"]))
ROWS, STEPS = 300, 20  # all paths are as long: one program for a law
follow = eqx.filter_jit(drive_path)


def padded(column):
    """A path's column with its last entry repeated."""
    return np.concatenate([column, np.full(ROWS - len(column), column[-1])])
