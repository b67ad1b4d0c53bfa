"""From spheres and soil to a bed that can be advanced: laws, time step, list capacities.

dt = safety * min over contacts of the longest step at which two bodies are stable
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jdem.bodies.spheres import Spheres
from jdem.boundaries.composite import CELL_SURFACES, PLATEN
from jdem.core.fusion import fenced, once
from jdem.core.kernel import in_blocks
from jdem.core.quantity import Real, cast
from jdem.core.smooth import Smoothing
from jdem.engine.neighbors import Grid
from jdem.engine.segment import Segment
from jdem.engine.step import Bed
from jdem.materials.soil import SoilParameters, particle_law, wall_law

ON_TOOLS = 2.0  # contacts with a tool on an area of d^2 that are listed at most
PAIRS_GROW = 4  # power of the listing distance with which the number of listed pairs grows


class Numerics(eqx.Module):
    """Choices of the method, not of the soil.

    safety (-) is the time step over the longest at which one contact is stable; a sphere has
    several, and beds are unstable from 0.55 on (docs/decisions/2026-11-21-contact-law.md).
    sample_time (s) is the interval of output and of list rebuilds; skin (-) is the listing
    distance over the mean diameter; pairs_per_sphere (None: `usual_pairs`), wall_layer (wall
    contacts = wall_layer x spheres x diameter / width, in a specimen twice as high as wide) and
    per_cell set list capacities; dtype is "float64" or "float32".
    """

    safety: float = eqx.field(static=True, default=0.45)
    sample_time: float = eqx.field(static=True, default=2.5e-4)
    skin: float = eqx.field(static=True, default=0.08)
    pairs_per_sphere: float | None = eqx.field(static=True, default=None)
    wall_layer: float = eqx.field(static=True, default=4.5)
    per_cell: int = eqx.field(static=True, default=9)
    dtype: str = eqx.field(static=True, default="float64")
    smoothing: Smoothing = eqx.field(default_factory=Smoothing)


def build_bed(
    spheres: Spheres,
    soil: SoilParameters,
    grid: Grid,
    numerics: Numerics,
    time_step: Array | None = None,
    surfaces: tuple[str, ...] = CELL_SURFACES,
    follows: int | None = PLATEN,
) -> Bed:
    """A bed in the wanted precision.

    `time_step` (s) overrides the one from the stiffness.  Surface energy is scaled to
    the spheres' mean diameter.  surfaces and follows as in `Bed`.
    """
    mean_diameter = 2 * jnp.mean(spheres.radius)
    between = particle_law(soil, mean_diameter, numerics.smoothing)
    walls = wall_law(soil, mean_diameter, numerics.smoothing)
    if time_step is None:
        time_step = stable_time_step(spheres, between, walls, numerics.safety)
    bed = Bed(
        spheres=spheres,
        particle_law=between,
        wall_law=walls,
        friction=soil.static_friction,
        wall_friction=friction_of_walls(soil, surfaces),
        time_step=time_step,
        roll_width=numerics.smoothing.roll,
        grid=grid,
        surfaces=surfaces,
        follows=follows,
    )
    return cast(bed, jnp.dtype(numerics.dtype))


def reach_of(soil: SoilParameters, mean_diameter: Real, largest: Real) -> float:
    """The gap (m) across which contacts between a soil's spheres of this mean diameter act at
    most, the largest radius being `largest` (m): lists must reach as far.

    Walls are listed within the skin alone: JKR on walls (`wall_adhesion`) ends there at the latest.
    """
    law = particle_law(soil, jnp.asarray(mean_diameter), Smoothing())
    return float(law.reach(jnp.asarray(0.5 * largest)))


def friction_of_walls(soil: SoilParameters, surfaces: tuple[str, ...]) -> Array:
    """Friction coefficients (-) of boundaries whose surfaces are like "platen" or "mould"."""
    known = {"platen": soil.platen_friction, "mould": soil.wall_friction}
    return jnp.stack([known[surface] for surface in surfaces])


def stable_time_step(spheres: Spheres, between, walls, safety: float) -> Array:
    """Time step (s) from the stiffest contact; no derivative passes through it, and none changes
    how it is rounded."""
    with fenced():
        spheres, between, walls = once(jax.lax.stop_gradient((spheres, between, walls)))
    radius, mass = spheres.radius, spheres.mass
    pair = jnp.min(between.longest_step(0.5 * mass, 0.5 * radius))
    wall = jnp.min(walls.longest_step(mass, radius))
    return safety * jnp.minimum(pair, wall)


def steps_per_sample(bed: Bed, numerics: Numerics) -> Array:
    """Whole number of time steps in one sampling interval, an array (never compiled in)."""
    return jnp.maximum(jnp.round(numerics.sample_time / bed.time_step), 1.0).astype(jnp.int32)


def sample_capacity(programme: Segment, numerics: Numerics) -> int:
    """Samples that the longest possible programme takes, with room for whole time steps:
    an interval of a whole number of steps may be a third shorter than asked for."""
    durations = np.asarray(programme.duration)
    return int(np.sum(np.ceil(1.5 * durations / numerics.sample_time))) + 2 * durations.size


def usual_pairs(size_ratio: float) -> float:
    """Room for listed pairs a sphere, at sphere over mould diameter, with the default skin.

    Spheres at walls have fewer neighbours.  A fit to what beds of 500 and 2000 spheres list at
    most during both compression tests, 3.32 and 3.60, and 30 % more for the softest soils.
    """
    return 5.3 * (1 - 1.28 * size_ratio)


def plan_grid(
    count: int,
    mean_radius: float,
    max_radius: float,
    extent: tuple[float, float],
    numerics: Numerics,
    reach: float = 0.0,
    touched: float = 0.0,
    spreads: float = 1.0,
) -> Grid:
    """The neighbour search for spheres of these sizes (m).

    `extent` is the width and height (m) that the search grid covers before it wraps; `reach`
    (m) is the gap across which forces act; `touched` (m2) is what tools add to the cell's walls;
    cells cover `spreads` times the width.
    """
    skin = numerics.skin * 2 * mean_radius
    cell = 2 * max_radius + skin + reach
    room = numerics.pairs_per_sphere
    room = usual_pairs(2 * mean_radius / extent[0]) if room is None else room
    pairs_per_sphere = room * (1 + reach / (2 * mean_radius)) ** PAIRS_GROW
    layer = numerics.wall_layer * 2 * mean_radius / extent[0]
    on_tools = ON_TOOLS * touched / (2 * mean_radius) ** 2
    covered = (spreads * extent[0], extent[1])
    across, up = (max(3, int(np.ceil(length / cell)) + 1) for length in covered)
    return Grid(
        shape=(across, across, up),
        per_cell=numerics.per_cell,
        pairs=in_blocks(int(np.ceil(pairs_per_sphere * count))),
        wall_contacts=in_blocks(int(np.ceil(layer * count + on_tools)) + 16),
        cell=cell,
        skin=skin,
        reach=reach,
    )
