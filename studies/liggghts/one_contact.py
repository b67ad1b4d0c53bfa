"""One contact and one sphere on a wall, by this simulator and by LIGGGHTS: levels 1 and 2 of codes.

The soil is exported and run by LIGGGHTS; ours has sharp kinks.  Spheres are those of a bed, the
overlap that of a contact under load.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibrate.exporters import liggghts
from calibrate.exporters.source import Found
from calibrate.io.soil import with_values
from jdem.apparatus.pair import SpherePair, drive_overlap
from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import FAR
from jdem.boundaries.composite import CELL_SURFACES, PLATEN
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.engine.bed import Bed, Numerics, build_bed
from jdem.engine.loop import start
from jdem.engine.neighbors import Grid, rebuild
from jdem.engine.step import Command
from jdem.engine.step import step as advanced
from jdem.materials.conventions import CONVENTIONS
from jdem.materials.soil import SoilParameters, particle_law
from studies.liggghts import two_spheres

PATH = (0.08, 0.03, 0.05, 0.02, 0.1, -0.01)  # turning points of the overlap, radii
HELD = 0.05  # overlap at which slip and roll are measured, radii
TURN = 0.2  # rad; enough to reach the limits of sliding and rolling
SLOW = 1e-7  # m/s, rad/s
ROLLING = 0.1  # m/s, of the sphere on the wall at the start
ROLLED = 0.3  # s
GRAVITY = 9.81  # m/s2
SHARP = Smoothing.sharp()
CELL, WIDE = 6e-3, 2.0  # m; of the grid, and a skin that the sphere does not leave


@dataclass(frozen=True)
class Compared:
    """One quantity, ours and theirs, and how far apart they are at most over their largest."""

    level: str
    quantity: str
    ours: float
    theirs: float
    apart: float

    @staticmethod
    def of(level: str, quantity: str, ours: np.ndarray, theirs: np.ndarray) -> "Compared":
        size = np.abs(theirs).max()
        apart = float(np.abs(np.asarray(ours) - theirs).max() / size)
        return Compared(level, quantity, float(ours[-1]), float(theirs[-1]), apart)


def compared(found: Found, folder: Path) -> list[Compared]:
    """The normal loop, slip, roll, and a sphere that rolls on the base."""
    radius, held = found.diameter / 2, HELD * found.diameter / 2
    path = [share * radius for share in PATH]
    overlap, force = two_spheres.liggghts_loop(liggghts.text(found), radius, path, folder)
    loop = eqx.filter_jit(drive_overlap)(_law(found), _pair(found), jnp.asarray(overlap))
    slips, drag, turns, torque = slip_and_roll(found, folder)
    one = "one contact"
    return [
        Compared.of(one, "normal force along a loop (N)", np.asarray(loop), force),
        Compared.of(one, "traction in sliding (N)", _traction(found, held, slips), drag),
        Compared.of(one, "torque in rolling (N m)", _torque(found, held, turns), torque),
        Compared.of("sphere on wall", "way of a rolling sphere (m)", *_ways(found, folder)),
    ]


def slip_and_roll(found: Found, folder: Path) -> tuple[np.ndarray, ...]:
    """LIGGGHTS' slips (m) and tractions (N), rotations (rad) and torques (N m) of a contact that
    is held; while it rolls, nothing holds it sideways."""
    radius, held = found.diameter / 2, HELD * found.diameter / 2
    slips, drag = two_spheres.liggghts_slip(liggghts.text(found), radius, held, TURN, folder)
    smooth = replace(found, values={**found.values, "static_friction": 0.0})
    torque = two_spheres.liggghts_roll(liggghts.text(smooth), radius, held, TURN, folder)
    return slips, drag, TURN * np.arange(1, len(torque) + 1) / len(torque), torque


def soil_of(found: Found) -> SoilParameters:
    """The exported soil as ours."""
    names = SoilParameters.__dataclass_fields__
    plain = SoilParameters(conventions=CONVENTIONS[found.conventions])
    return with_values(plain, {n: found[n] for n in names if n in found.values})


def _law(found: Found):
    return particle_law(soil_of(found), jnp.asarray(found.diameter), SHARP)


def _pair(found: Found) -> SpherePair:
    return SpherePair(jnp.asarray(found.diameter / 2), two_spheres.DENSITY)


def _held(found: Found, held: float, moments: np.ndarray, moving, of):
    """`of` the forces of a contact held at an overlap while it moves slowly to each moment."""
    law, pair = _law(found), _pair(found)

    def advance(carry, moment):
        history, before = carry
        contact = moving(pair.contact(jnp.asarray(held), jnp.asarray(0.0)))
        time = (moment - before) / SLOW
        contact = eqx.tree_at(lambda c: c.time_step, contact, time)
        force, history = law.force(contact, history)
        return (history, moment), of(force)

    start = (law.memory((), jnp.float64), jnp.asarray(0.0))
    return np.asarray(jax.lax.scan(advance, start, jnp.asarray(moments))[1])


def _traction(found: Found, held: float, slips: np.ndarray) -> np.ndarray:
    """Traction (N) at slips (m)."""
    zero, slow = jnp.asarray(0.0), jnp.asarray(SLOW)
    friction = jnp.asarray(found["static_friction"])
    moving = lambda c: eqx.tree_at(  # noqa: E731, one expression
        lambda x: (x.slip, x.friction), c, (Vector(zero, slow, zero), friction)
    )
    return _held(found, held, slips, moving, lambda force: -force.traction().y)


def _torque(found: Found, held: float, turns: np.ndarray) -> np.ndarray:
    """Torque (N m) on one sphere at relative rotations (rad)."""
    zero, slow = jnp.asarray(0.0), jnp.asarray(SLOW)
    lever = found.diameter / 2 - held / 2
    moving = lambda c: eqx.tree_at(lambda x: x.spin, c, Vector(zero, zero, slow))  # noqa: E731

    def of(force):
        return force.rolling_limit * lever if force.moment is None else -force.moment.z

    return _held(found, held, turns, moving, of)


def _ways(found: Found, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Ways (m) of a sphere on the base over time, ours and theirs."""
    radius = np.array([found.diameter / 2])
    mass = two_spheres.DENSITY * 4 / 3 * np.pi * radius**3
    bed = _bed(Spheres(jnp.asarray(radius), jnp.asarray(mass)), soil_of(found))
    step = float(bed.time_step)
    steps = int(ROLLED / step)
    ours = np.asarray(_rolled(bed, jnp.asarray(radius[0]), steps))
    sphere = two_spheres.Rolling(float(radius[0]), ROLLING, step, steps, 10)
    rows = two_spheres.liggghts_on_wall(liggghts.text(found), liggghts.model(found), sphere, folder)
    times = np.arange(len(rows)) * 10
    return np.interp(times, np.arange(1, steps + 1), ours), rows[:, 0]


def _bed(spheres: Spheres, soil: SoilParameters) -> Bed:
    """One sphere under gravity on the base of a cell."""
    grid = Grid(
        shape=(3, 3, 3), per_cell=1, pairs=1, wall_contacts=3, cell=CELL + WIDE, skin=WIDE
    )  # fmt: skip
    numerics = Numerics(smoothing=SHARP)
    bed = build_bed(spheres, soil, grid, numerics, surfaces=CELL_SURFACES, follows=PLATEN)
    return eqx.tree_at(lambda b: b.gravity, bed, jnp.asarray(GRAVITY, spheres.radius.dtype))


@eqx.filter_jit
def _rolled(bed: Bed, radius: jax.Array, steps: int) -> jax.Array:
    """Places x (m) of the sphere after each of `steps` steps; it begins on the base, rolling."""
    dtype = radius.dtype
    zero = jnp.zeros(1, dtype)
    state = start(bed, Vector(zero, zero, zero + radius), FAR, FAR)
    moving = Vector(zero + ROLLING, zero, zero)
    state = eqx.tree_at(lambda s: s.motion.velocity, state, moving)
    pairs, contacts, _ = rebuild(
        bed.grid, bed.spheres, state.boundaries, state.motion.position,
        state.pairs, state.wall_contacts,
    )  # fmt: skip
    state = eqx.tree_at(lambda s: (s.pairs, s.wall_contacts), state, (pairs, contacts))
    none = jnp.zeros((), dtype)
    command = Command(jnp.zeros((3, len(state.boundaries)), dtype), none, none)

    def advance(state, _):
        state = advanced(bed, state, command)
        return state, state.motion.position.x[0]

    return jax.lax.scan(advance, state, None, length=steps)[1]
