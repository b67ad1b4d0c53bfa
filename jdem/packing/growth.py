"""A bed of given height and porosity: spheres that grow where they are, without weight or friction.

    volume of the spheres = (1 - porosity) pi/4 D^2 h        fixes all radii
    container of height h' -> grow, hold, level -> height h(h'),   h' chosen so that h(h') = h

Small spheres are thrown into the mould between base and platen and grow to their size while
nothing weighs (radius expansion).  Then gravity sets in, with a friction that holds the bed
nearly as it is, and a platen levels it.  What it sinks, or springs back, is made up for by the
next container.  A given porosity matters because strength goes with it, and so part of what
seems an effect of the number of spheres (Ding et al. 2014, doi 10.1007/s00603-013-0533-1).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from jdem.bodies.spheres import Spheres
from jdem.core.kernel import program
from jdem.core.quantity import Real, quantity
from jdem.core.vector import Vector
from jdem.engine.bed import build_bed, reach_of, sample_capacity, steps_per_sample
from jdem.engine.loop import Record, run, start
from jdem.engine.schedule import AbstractSurroundings
from jdem.engine.segment import LOWER, Segment, cell_segment, stack
from jdem.engine.state import Bed, BedState
from jdem.materials.soil import SoilParameters
from jdem.packing.settling import SOFT, neutral_soil, settling_numerics
from jdem.packing.specimen import Packing, Specimen, with_density

SPARSE = 0.2  # solid fraction of the spheres that are thrown in
GROWTH = 0.1  # s; each sphere moves by a fifth of its diameter meanwhile
CALM = 0.03  # s afterwards, in which overlaps go that growing left
SINK = 0.08  # s under gravity before the platen comes
LEVEL = 0.1  # s that the platen has
HOLDING = 0.6  # friction that keeps the bed from sinking once it weighs
DAMPING = 100.0  # 1/s; half of it while the bed sinks
STILL = 0.01  # m/s; a bed that sinks faster than that does not stand
CLOSE = 0.006  # of the height; it is below 1 % of any porosity above 0.375
TRIES = 5
SHARE = 0.7  # of a container's change that the bed's height follows, before it is known


def grown(specimen: Specimen, seed: int, soil: SoilParameters | None = None) -> Packing:
    """A bed of the specimen's porosity and height, both within 1 %; the same arguments give the
    same bed bit for bit.  `soil` holds it once it weighs: rough and cohesionless by default.

    Raises ValueError where the porosity cannot be reached.
    """
    container, tried = specimen.height, []
    while len(tried) < TRIES:
        packing, sunk, speed = _grown_in(replace(specimen, height=container), specimen, seed, soil)
        height = float(packing.height)
        tried.append((container, height))
        if abs(height / specimen.height - 1) < CLOSE and min(sunk, speed) <= STILL:
            return with_density(packing, specimen.density)
        if speed > STILL:
            break
        container = _next_container(tried, specimen.height)
    raise ValueError(_out_of_reach(specimen, tried))


def holding_soil() -> SoilParameters:
    """The slippery soil of settled beds made rough: it keeps the porosity that it is given."""
    return replace(neutral_soil(), static_friction=HOLDING, rolling_friction=0.1)


def _next_container(tried: list[tuple[float, float]], height: float) -> float:
    """The container's height (m) for a bed of this height, by the last two tries (secant)."""
    (container, found) = tried[-1]
    slope = SHARE
    if len(tried) > 1:
        (before, was) = tried[-2]
        slope = float(np.clip((found - was) / (container - before), 0.3, 1.5))
    return container + (height - found) / slope


def _out_of_reach(specimen: Specimen, tried: list[tuple[float, float]]) -> str:
    """One sentence: which porosity was asked for, and what to do."""
    loose = tried[0][1] < specimen.height  # the first container had the porosity asked for
    why, repair = ("so loosely", "lower") if loose else ("so densely", "higher")
    return (
        f"{specimen.count} spheres in a mould of {1e3 * specimen.diameter:.0f} mm do not stand "
        f"{why} as at a porosity of {specimen.porosity:.3f}: ask for a {repair} one"
    )


# ---- one container


def _grown_in(
    container: Specimen, wanted: Specimen, seed: int, soil: SoilParameters | None
) -> tuple[Packing, float, float]:
    """The bed that the wanted specimen's spheres make when they grow in this container, and how
    fast they still are (m/s, root mean square) before the platen comes and when it has come."""
    rng = np.random.default_rng(seed)
    radius = _radii(wanted, rng)
    solid = 4 / 3 * np.pi * float(np.sum(radius**3)) / _volume(container)
    small = (SPARSE / solid) ** (1 / 3)
    thrown = _thrown(small * radius, container.diameter / 2, container.height, rng)
    mass = wanted.density / 0.6 * 4 / 3 * np.pi * radius**3
    spheres = Spheres(jnp.asarray(radius), jnp.asarray(mass))
    place = Vector(*[jnp.asarray(column) for column in thrown.T])
    begun = Packing(place, spheres, container.height, container.diameter / 2)
    firm = holding_soil() if soil is None else soil
    soft = eqx.tree_at(lambda p: p.shear_modulus, firm, firm.shear_modulus * SOFT)
    full = _advanced(wanted, begun, soft, _growth(), Growing(small, GROWTH, 0.0))
    begun = eqx.tree_at(lambda p: p.position, begun, full.state.motion.position)
    record = _advanced(wanted, begun, firm, _levelling(), Growing(1.0, GROWTH, 1.0))
    sunk, last = (int(np.flatnonzero(at)[-1]) for at in _ends(record))
    height = float(record.samples.platen_height[last])
    packing = Packing(record.state.motion.position, spheres, height, container.diameter / 2)
    energy = np.asarray(record.samples.kinetic_energy)[[sunk, last]]
    before, after = np.sqrt(2 * energy / mass.sum())
    return packing, float(before), float(after)


def _ends(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Which samples come before the platen, and which at all: a platen that has just come pushes a
    flat bed, which stands all the same."""
    segment = np.asarray(record.samples.segment)
    return segment == 0, segment >= 0


def _volume(specimen: Specimen) -> float:
    return np.pi / 4 * specimen.diameter**2 * specimen.height


def _radii(specimen: Specimen, rng: np.random.Generator) -> np.ndarray:
    """Radii (m) spread evenly over their range, in random order: every seed has the same ones,
    and they fill the specimen to its porosity exactly."""
    even = (np.arange(specimen.count) + 0.5) / specimen.count
    radius = 1 + specimen.spread * (2 * even - 1)
    solid = (1 - (specimen.porosity or 0.0)) * _volume(specimen)
    scale = (solid / (4 / 3 * np.pi * np.sum(radius**3))) ** (1 / 3)
    return scale * rng.permutation(radius)


def _thrown(radius: np.ndarray, mould: float, height: float, rng) -> np.ndarray:
    """Centres (N, 3) in m of spheres thrown in at random, none of which overlaps another.

    Random sequential addition in rounds: all that are not placed yet are thrown at once.
    """
    centres = _random_points(radius, mould, height, rng)
    loose = _clashing(centres, radius)
    while len(loose):
        centres[loose] = _random_points(radius[loose], mould, height, rng)
        loose = _clashing(centres, radius)
    return centres


def _random_points(radius: np.ndarray, mould: float, height: float, rng) -> np.ndarray:
    """Points where spheres of these radii lie within the cylinder, evenly in its volume."""
    far = (mould - radius) * np.sqrt(rng.random(len(radius)))
    angle = 2 * np.pi * rng.random(len(radius))
    up = radius + (height - 2 * radius) * rng.random(len(radius))
    return np.stack([far * np.cos(angle), far * np.sin(angle), up], axis=1)


def _clashing(centres: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The second sphere of each pair that overlaps."""
    pairs = KDTree(centres).query_pairs(2 * radius.max(), output_type="ndarray")
    first, second = pairs[:, 0], pairs[:, 1]
    distance = np.linalg.norm(centres[first] - centres[second], axis=1)
    return np.unique(second[distance < radius[first] + radius[second]])


# ---- the machine


class Growing(AbstractSurroundings):
    """Spheres grow from the share `begun` of their radius for `duration` (s); weight and friction
    are `present` (1) or not (0)."""

    begun: Real = quantity()
    duration: Real = quantity()
    present: Real = quantity()

    def begin(self, dtype) -> Array:
        """Time, s."""
        return jnp.zeros((), dtype)

    def bed(self, bed: Bed, segment: Array, memory: Array) -> Bed:
        size = self.begun + (1 - self.begun) * jnp.minimum(1.0, memory / self.duration)
        return eqx.tree_at(
            lambda b: (b.spheres.radius, b.friction, b.wall_friction, b.gravity),
            bed,
            (
                bed.spheres.radius * size,
                bed.friction * self.present,
                bed.wall_friction * self.present,
                bed.gravity * self.present,
            ),
        )

    def shown(self, reading: Array, memory: Array) -> Array:
        return reading

    def later(self, memory: Array, segment: Array, before: BedState, after: BedState) -> Array:
        return after.time


def _growth() -> Segment:
    """Growth between base and platen, and calm."""
    return stack([cell_segment(damping=DAMPING, duration=each) for each in (GROWTH, CALM)])


def _levelling(seating_force: float = 2.0) -> Segment:
    """The bed sinks, and a platen comes down until it carries the seating force (N)."""
    level = cell_segment(
        platen_speed=0.05,
        force_target=seating_force,
        servo_width=seating_force,
        tolerance=0.1 * seating_force,
        damping=2 * DAMPING,
        duration=LEVEL,
        platen=LOWER,
    )
    return stack([cell_segment(damping=0.5 * DAMPING, duration=SINK), level])


def _advanced(
    wanted: Specimen, packing: Packing, soil: SoilParameters, programme: Segment, growing: Growing
) -> Record:
    """The record of a programme; raises ValueError where a contact list was too small."""
    numerics = settling_numerics(2 * wanted.mean_radius())
    reach = reach_of(soil, packing.mean_diameter(), wanted.max_radius())
    bed = build_bed(packing.spheres, soil, wanted.grid(numerics, reach=reach), numerics)
    state = start(bed, packing.position, packing.height, packing.mould_radius)
    capacity = max(sample_capacity(each, numerics) for each in (_growth(), _levelling()))
    steps = steps_per_sample(bed, numerics)
    record = _program()(bed, state, programme, steps, capacity, growing)
    if bool(record.overflow_of(bed.grid)):
        raise ValueError(f"while growing the bed, {record.explain_overflow(bed.grid)}")
    return record


@cache
def _program() -> Callable:
    return program(run)
