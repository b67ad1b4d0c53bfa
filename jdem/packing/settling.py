"""A bed of spheres in its mould: drawn by seed, settled, levelled.

Spheres of random radii (mean +- spread) start on a loose lattice above each other, fall
under gravity with little friction and no adhesion, and are levelled by a platen at a
small seating force.  Their density is then set so that the bed has the target bulk
density.  A packing is prepared once and reused for every parameter set (common random
numbers); `settled` takes another soil if the bed is to be made with the parameters
under test.
"""

from collections.abc import Callable
from functools import cache, partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jdem.bodies.spheres import Spheres
from jdem.core.kernel import program
from jdem.core.vector import Vector
from jdem.engine.bed import (
    Numerics,
    build_bed,
    reach_of,
    sample_capacity,
    steps_per_sample,
)
from jdem.engine.loop import Record, run, start
from jdem.engine.segment import LOWER, REMOVE, Segment, cell_segment, stack
from jdem.materials.soil import SoilParameters
from jdem.packing.specimen import Packing, Specimen, solid_fraction, with_density

LOOSE = 4.0  # height of the drawn column over the settled bed's, at most
SOFT = 0.15  # modulus while the spheres fall, relative to the soil's
FASTEST = 1.5  # m/s; fall under gravity with the settling programme's damping


def neutral_soil() -> SoilParameters:
    """Slippery, cohesionless, strongly damped: what beds are settled with by default.

    Nearly elastic, because plasticity would stiffen unloading and shorten the time step.
    """
    return SoilParameters(
        plasticity_ratio=0.05,
        restitution=0.1,
        static_friction=0.15,
        rolling_friction=0.0,
        surface_energy=0.0,
        wall_friction=0.0,
        platen_friction=0.0,
    )


def settled(
    specimen: Specimen, seed: int, soil: SoilParameters | None = None, seating_force: float = 2.0
) -> Packing:
    """A packing drawn and settled; the same arguments give the same bed bit for bit.

    The porosity is what the spheres' friction leaves it at.

    Raises ValueError if the bed had not come to rest.
    """
    radius, position = _draw(specimen, seed)
    mass = specimen.density / 0.6 * 4 / 3 * np.pi * radius**3
    spheres = Spheres(jnp.asarray(radius), jnp.asarray(mass))
    soil = neutral_soil() if soil is None else soil
    loose = Packing(position, spheres, float(position.z.max()) * 1.1, specimen.diameter / 2)
    record = _fallen(specimen, loose, soil, seating_force)
    motion = record.state.motion
    height = float(record.samples.platen_height[np.flatnonzero(record.samples.segment >= 0)[-1]])
    packing = Packing(motion.position, spheres, height, specimen.diameter / 2)
    if not bool(record.finished) or not _is_dense(packing, specimen):
        raise ValueError(
            f"{specimen.count} spheres of {2e3 * specimen.mean_radius():.1f} mm did not settle in "
            f"a mould of {1e3 * specimen.diameter:.0f} mm (solid fraction "
            f"{float(packing.solid_fraction()):.2f}); use more spheres or a lower specimen"
        )
    return with_density(packing, specimen.density)


def _is_dense(packing: Packing, specimen: Specimen) -> bool:
    """Whether the bed has at least three quarters of the solid fraction of its like."""
    usual = solid_fraction(2 * specimen.mean_radius() / specimen.diameter)
    return float(packing.solid_fraction()) > 0.75 * usual


def _draw(specimen: Specimen, seed: int):
    """Radii, and centres on a loose hexagonal lattice with a random jitter."""
    rng = np.random.default_rng(seed)
    mean = specimen.mean_radius()
    radius = mean * rng.uniform(1 - specimen.spread, 1 + specimen.spread, specimen.count)
    pitch = 2.05 * radius.max()
    layer = _layer(specimen.diameter / 2 - radius.max(), pitch)
    layers = -(-specimen.count // len(layer))
    height = (np.arange(layers) + 0.6) * pitch
    centres = np.array([(x, y, z) for z in height for x, y in layer])[: specimen.count]
    centres += rng.uniform(-0.012, 0.012, centres.shape) * pitch
    turn = rng.uniform(0, 2 * np.pi, layers).repeat(len(layer))[: specimen.count]
    x = centres[:, 0] * np.cos(turn) - centres[:, 1] * np.sin(turn)
    y = centres[:, 0] * np.sin(turn) + centres[:, 1] * np.cos(turn)
    return radius, Vector(jnp.asarray(x), jnp.asarray(y), jnp.asarray(centres[:, 2]))


def _layer(radius: float, pitch: float) -> list[tuple[float, float]]:
    """Points of a square lattice within a circle, on a node or between nodes: the fuller."""
    whole = np.arange(-np.ceil(radius / pitch) - 1, np.ceil(radius / pitch) + 2)
    lattices = [(whole + shift) * pitch for shift in (0.0, 0.5)]
    layers = [
        [(x, y) for x in side for y in side if x * x + y * y < (0.97 * radius) ** 2]
        for side in lattices
    ]
    return max(layers, key=len) or [(0.0, 0.0)]


def _fallen(
    specimen: Specimen, loose: Packing, soil: SoilParameters, seating_force: float
) -> Record:
    """The drawn bed after falling (soft spheres, large steps), resting and levelling."""
    height = float(loose.height)
    fall = cell_segment(damping=10.0, duration=np.sqrt(2 * height / 9.81) + 0.05, platen=REMOVE)
    calm = cell_segment(damping=200.0, duration=0.04, platen=REMOVE)
    level = cell_segment(
        platen_speed=0.1,
        force_target=seating_force,
        servo_width=0.5 * seating_force,
        tolerance=0.02 * seating_force,
        damping=200.0,
        duration=0.3,
        platen=LOWER,
    )
    numerics = settling_numerics(2 * specimen.mean_radius())
    programmes = stack([fall, calm]), stack([calm, level])
    longest = max(sample_capacity(programme, numerics) for programme in programmes)
    advance = partial(_advanced, specimen, numerics, _ROWS * -(-longest // _ROWS))
    soft = eqx.tree_at(lambda p: p.shear_modulus, soil, soil.shear_modulus * SOFT)
    fallen = advance(loose, soft, programmes[0])
    rested = eqx.tree_at(_position, loose, fallen.state.motion.position)
    return advance(rested, soil, programmes[1])


def _position(packing: Packing):
    return packing.position


def _advanced(
    specimen: Specimen,
    numerics: Numerics,
    capacity: int,
    packing: Packing,
    soil: SoilParameters,
    programme: Segment,
) -> Record:
    """The bed after a programme; raises ValueError where a contact list was too small."""
    reach = reach_of(soil, packing.mean_diameter(), specimen.max_radius())
    bed = build_bed(packing.spheres, soil, specimen.grid(numerics, LOOSE, reach), numerics)
    state = start(bed, packing.position, packing.height, packing.mould_radius)
    record = _program()(bed, state, programme, steps_per_sample(bed, numerics), capacity)
    if bool(record.overflow_of(bed.grid)):
        raise ValueError(f"while settling the bed, {record.explain_overflow(bed.grid)}")
    return record


@cache
def _program() -> Callable:
    return program(run)


_ROWS = 256  # capacities are multiples of it: one program falls and levels beds of all seeds


def settling_numerics(diameter: float) -> Numerics:
    """Lists are rebuilt before a falling sphere has crossed a third of their skin."""
    skin = 0.2
    return Numerics(
        skin=skin,
        sample_time=skin * diameter / (3 * FASTEST),
        pairs_per_sphere=6.0,
        wall_layer=8.0,
        per_cell=12,
    )
