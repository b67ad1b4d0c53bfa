"""Beds of one to a few spheres, made by hand, and what advances them.

By `jdem.engine.step.step` or by `jdem.engine.loop.run`.  Spheres of one material; what a test
does not need is switched off.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jdem.bodies.spheres import Motion, Spheres
from jdem.boundaries.base import FAR
from jdem.boundaries.composite import CELL_SURFACES, PLATEN
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed
from jdem.engine.loop import run, start
from jdem.engine.neighbors import Grid, rebuild
from jdem.engine.segment import Segment, stack
from jdem.engine.step import Command, step
from jdem.materials.soil import SoilParameters

RADIUS, DENSITY, GRAVITY = 2.5e-3, 2650.0, 9.81
WIDE = 40.0  # mean diameters; a skin that a single sphere does not leave
SHARP = Smoothing.sharp()
STEPS = 3000  # of every single sphere, and CAPACITY of every record: shapes are compiled in
CAPACITY = 64

# Every bed that `ran` advances has four spheres, so one program must serve them all.
simulate = eqx.filter_jit(eqx.debug.assert_max_traces(run, max_traces=1))


def soil_of(**values):
    """Soft, elastic, without rolling resistance and adhesion, unless told otherwise."""
    plain = {
        "restitution": 0.9,
        "surface_energy": 0.0,
        "plasticity_ratio": 1e-6,
        "rolling_friction": 0.0,
        "shear_modulus": 1e6,
        "platen_friction": 0.3,
        "reference_diameter": 2 * RADIUS,
    }
    return SoilParameters(**{**plain, **values})


def spheres_of(count, spread=0.0):
    radius = RADIUS * np.linspace(1 - spread, 1 + spread, count)
    return Spheres(radius, DENSITY * 4 / 3 * np.pi * radius**3)


def bed_of(
    spheres,
    soil,
    *,
    gravity=GRAVITY,
    smoothing=SHARP,
    skin=1.0,
    surfaces=CELL_SURFACES,
    follows=PLATEN,
    **numerics,
):
    """`skin` is in mean diameters; every list has room for all there is."""
    count, gap = spheres.count, skin * 2 * RADIUS
    grid = Grid(
        shape=(3, 3, 3),
        per_cell=count,
        pairs=count * count,
        wall_contacts=3 * count,
        cell=2.4 * RADIUS + gap,
        skin=gap,
    )
    numerics = Numerics(smoothing=smoothing, **numerics)
    bed = build_bed(spheres, soil, grid, numerics, surfaces=surfaces, follows=follows)
    return eqx.tree_at(lambda b: b.gravity, bed, jnp.asarray(gravity, bed.time_step.dtype))


def state_of(bed, position, velocity=None, spin=None, mould_radius=FAR):
    """No platen, and a mould only if a radius is given."""
    dtype = bed.time_step.dtype
    zeros = np.zeros_like(position)
    rows = [zeros if given is None else given for given in (velocity, spin)]
    motion = Motion(*(Vector.from_rows(jnp.asarray(r, dtype)) for r in (position, *rows)))
    state = start(bed, motion.position, FAR, mould_radius)
    return eqx.tree_at(lambda s: s.motion, state, motion)


def listed(bed, state):
    """The state with lists for where its spheres are."""
    pairs, contacts, _ = rebuild(
        bed.grid,
        bed.spheres,
        state.boundaries,
        state.motion.position,
        state.pairs,
        state.wall_contacts,
    )
    return eqx.tree_at(lambda s: (s.pairs, s.wall_contacts), state, (pairs, contacts))


def idle(state, damping=0.0, unloaded=0.0):
    """The machine stands still."""
    dtype = state.time.dtype
    rates = jnp.zeros((3, len(state.boundaries)), dtype)
    return Command(rates, jnp.asarray(damping, dtype), jnp.asarray(unloaded, dtype))


@eqx.filter_jit
def advanced(bed, state, steps, damping=0.0):
    """The motion after each of `steps` steps of one list (the skin must outlast them)."""
    state = listed(bed, state)
    command = idle(state, damping)

    def advance(state, _):
        state = step(bed, state, command)
        return state, (state.motion, state.wall_force)

    return jax.lax.scan(advance, state, None, length=steps)


def ran(bed, state, samples, steps=100, damping=0.0):
    """The record of a bed left to itself for `samples` intervals of `steps` steps."""
    duration = (samples - 0.25) * steps * bed.time_step
    programme = stack([Segment(duration=duration, damping=damping)])
    record = simulate(bed, state, programme, jnp.asarray(steps), CAPACITY)
    assert not record.overflow_of(bed.grid), record.explain_overflow(bed.grid)
    return record


def last(samples):
    """The last interval that was recorded."""
    row = np.flatnonzero(np.asarray(samples.segment) >= 0)[-1]
    return jax.tree.map(lambda leaf: np.asarray(leaf)[row], samples)


def quickly(function, **options):
    """`function` jitted as a whole and compiled without optimisation: a derivative of a few spheres
    compiles in a third of the time, and is the same to round-off."""
    cheap = {"xla_backend_optimization_level": 0}
    return jax.jit(function, compiler_options=cheap, **options)
