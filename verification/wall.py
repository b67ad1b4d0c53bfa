"""The pressure on a smooth wall that is moved into a bed, and away from it, beside Rankine.

    P = K rho g H^2 W/2     passive K_p = tan^2(45 + phi/2),  active K_a = tan^2(45 - phi/2)

A smooth wall of width W and height H stands before a bed of dry spheres on a rough base between
smooth sides, and moves horizontally.  Two things do not depend on a friction angle phi that would
have to be measured elsewhere:

- frictionless spheres have phi = 5.8 degrees (Peyneau and Roux 2008, Physical Review E 78,
  011307: 5.76 +- 0.22), so K_p = 1.22 and K_a = 0.82;
- with friction K_p K_a = 1: wall in and wall out give the same phi.

H is twice the height of the centre of mass, and rho g H L W the weight: no surface has to be found.

    python -m verification.wall          some ten minutes of a core

Runs are kept in results/benchmarks; a second call resumes.  Writes a section of
verification/results/reference_beds.md.
"""

import argparse
import json
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibrate.core.files import write_json
from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import UP, Axis, point
from jdem.boundaries.plane import Plane
from jdem.core.quantity import cast
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed, plan_grid
from jdem.engine.loop import Record, begun, run
from jdem.engine.segment import KEEP, Segment, stack
from jdem.materials.contact_laws import BED_LAWS
from jdem.materials.soil import SoilParameters
from verification import reporting

RADIUS, SPREAD, DENSITY = 2.5e-3, 0.15, 1830.0  # m, of the radius, kg/m3
LENGTH, WIDTH = 0.16, 0.04  # m; 32 and 8 diameters
LAYERS = 11  # of the lattice from which the spheres fall
PITCH = 1.16  # of the lattice, in diameters of the largest sphere
WALL, GRAVITY = 1, 9.81  # number of the wall that moves; m/s2
SPEED, STROKE = 5e-3, {"passive": 8e-3, "active": 2e-3}  # m/s, m
SETTLING, REST = 0.5, 0.1  # s, with much and with little damping
LATE = 0.5  # of the stroke, over which the pressure is a mean
BEDS = 3
FRICTIONS = (0.0, 0.5)
SOIL = SoilParameters(
    restitution=0.3, surface_energy=0.0, rolling_friction=0.0, shear_modulus=12e6,
    poisson_ratio=0.3, wall_friction=0.0, conventions=BED_LAWS["hertz_mindlin"],
)  # fmt: skip
NUMERICS = Numerics(wall_layer=27.0, sample_time=5e-4)
FRICTIONLESS = np.radians(5.76)


def spheres_of(seed: int) -> tuple[Spheres, np.ndarray]:
    """Spheres, and centres (N, 3) from which they fall, m."""
    random, step = np.random.default_rng(seed), PITCH * 2 * RADIUS * (1 + SPREAD)
    across = [int((side - step) // step) + 1 for side in (LENGTH, WIDTH)]
    grid = np.stack(np.meshgrid(*map(np.arange, (*across, LAYERS)), indexing="ij"), -1)
    free = 0.5 * (PITCH - 1) * 2 * RADIUS * (1 + SPREAD)
    rows = grid.reshape(-1, 3)
    centres = (rows + 0.5) * step + random.uniform(-free, free, rows.shape)
    radius = RADIUS * random.uniform(1 - SPREAD, 1 + SPREAD, len(rows))
    return Spheres(jnp.asarray(radius), jnp.asarray(DENSITY * 4 / 3 * np.pi * radius**3)), centres


def box() -> tuple[Plane, ...]:
    """Base, the wall that moves along x, the wall opposite, both sides."""

    def plane(x: float, y: float, axis: Axis) -> Plane:
        return Plane.at(point(x, y, 0.0, float), axis)

    return (
        plane(0.0, 0.0, UP),
        plane(0.0, 0.0, (1.0, 0.0, 0.0)),
        plane(LENGTH, 0.0, (-1.0, 0.0, 0.0)),
        plane(0.0, 0.0, (0.0, 1.0, 0.0)),
        plane(0.0, WIDTH, (0.0, -1.0, 0.0)),
    )


def movement(duration: float, speed: float = 0.0, damping: float = 0.0) -> Segment:
    """The wall at a speed (m/s) along its axis, into the soil."""
    rates = jnp.zeros(len(box()))
    return Segment(
        speed=rates.at[WALL].set(speed), spin=rates, growth=rates,
        placed=jnp.full(len(box()), KEEP), damping=damping, duration=duration,
    )  # fmt: skip


def moved(friction: float, way: str, seed: int) -> Record:
    """A bed that came to rest, and then the wall."""
    spheres, centres = spheres_of(seed)
    soil = replace(
        SOIL, static_friction=jnp.asarray(friction), platen_friction=jnp.asarray(friction)
    )
    largest = RADIUS * (1 + SPREAD)
    extent = (LENGTH, float(centres[:, 2].max()) + 2 * largest)
    grid = plan_grid(spheres.count, RADIUS, largest, extent, NUMERICS)
    surfaces = ("platen", *4 * ("mould",))
    bed = build_bed(spheres, soil, grid, NUMERICS, surfaces=surfaces, follows=None)
    sign, stroke = 1.0 if way == "passive" else -1.0, STROKE[way]
    programme = [
        movement(SETTLING, damping=20.0), movement(REST), movement(stroke / SPEED, sign * SPEED)
    ]  # fmt: skip
    steps = jnp.maximum(jnp.round(NUMERICS.sample_time / bed.time_step), 1.0).astype(jnp.int32)
    whole = SETTLING + REST + stroke / SPEED
    capacity = int(1.02 * whole / float(steps * bed.time_step)) + 4
    state = begun(bed, Vector.from_rows(jnp.asarray(centres)), box())
    advance = eqx.filter_jit(run)
    record = advance(bed, state, cast(stack(programme), jnp.dtype("float64")), steps, capacity)
    record = jax.block_until_ready(record)
    if bool(record.overflow_of(grid)):
        raise RuntimeError(record.explain_overflow(grid))
    return record


def coefficients(record: Record, seed: int) -> dict:
    """K over the late stroke, its course, and on the opposite wall: 2 P/(weight H/L)."""
    spheres, _ = spheres_of(seed)
    mass = np.asarray(spheres.mass)
    segment = np.asarray(record.samples.segment)
    height = 2 * float(np.sum(mass * np.asarray(record.state.motion.position.z)) / mass.sum())
    unit = 0.5 * mass.sum() * GRAVITY * height / LENGTH
    loads = np.asarray(record.samples.loads)[segment == 2]
    wall, opposite = -loads[:, WALL, 0] / unit, loads[:, WALL + 1, 0] / unit
    late = slice(int((1 - LATE) * len(wall)), None)
    return {
        "spheres": int(spheres.count),
        "height": height,
        "k": float(wall[late].mean()),
        "opposite": float(opposite[late].mean()),
        "base": float(-loads[late, 0, 2].mean() / (mass.sum() * GRAVITY)),
        "course": [float(f"{x:.4g}") for x in wall[:: max(1, len(wall) // 40)]],
    }


def kept(friction: float, way: str, seed: int) -> dict:
    """One bed and one way, of this call or an earlier one."""
    path = reporting.kept("wall") / f"{friction:g}-{way}-{seed}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    found = coefficients(moved(friction, way, seed), seed)
    write_json(path, found)
    print(friction, way, seed, found, flush=True)
    return found


def expected(friction: float, way: str) -> str:
    """Rankine's coefficient of frictionless spheres."""
    angle = (1 if way == "passive" else -1) * FRICTIONLESS / 2
    return f"{np.tan(np.pi / 4 + angle) ** 2:.2f}" if friction == 0 else ""


def markdown(found: dict[tuple[float, str], list[dict]], origin: dict) -> str:
    """A row for each soil and way; then the angles of both ways."""
    rows = []
    for (friction, way), beds in found.items():
        values = np.array([bed["k"] for bed in beds])
        rows.append([
            f"{friction:g}", way, f"{values.mean():.3f} ± {_error(values):.3f}",
            expected(friction, way), f"{np.degrees(_angle(values.mean(), way)):.1f}",
        ])  # fmt: skip
    header = ("friction of spheres", "wall", "K", "Rankine", "friction angle (deg)")
    size = next(iter(found.values()))[0]
    said = ""
    for friction in dict.fromkeys(key for key, _ in found):
        both = [np.array([b["k"] for b in found[friction, way]]) for way in STROKE]
        product = both[0] * both[1]
        said += (
            f"- Friction {friction:g}: K_p K_a = {product.mean():.3f} ± {_error(product):.3f}; "
            "Rankine: 1.\n"
        )
    return (
        f"# A smooth wall, beside Rankine\n\n{size['spheres']} spheres of {2e3 * RADIUS:g} mm, "
        f"bed {1e3 * size['height']:.0f} mm high, wall at {1e3 * SPEED:g} mm/s by "
        f"{1e3 * STROKE['passive']:g} mm in or {1e3 * STROKE['active']:g} mm out; mean over the "
        f"late half of the stroke and {BEDS} beds, with its standard error.\n\n"
        + reporting.table(header, rows) + "\n" + said + reporting.footer(origin)
    )  # fmt: skip


def _error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / len(values) ** 0.5) if len(values) > 1 else np.nan


def _angle(coefficient: float, way: str) -> float:
    """phi (rad) of Rankine's coefficient."""
    half = np.arctan(np.sqrt(coefficient)) - np.pi / 4
    return 2 * (half if way == "passive" else -half)


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--frictions", nargs="+", type=float, default=list(FRICTIONS))
    parser.add_argument("--beds", type=int, default=BEDS)
    chosen = parser.parse_args()
    reporting.configure()
    found = {
        (friction, way): [kept(friction, way, seed) for seed in range(chosen.beds)]
        for friction in chosen.frictions
        for way in STROKE
    }
    reporting.write_section("reference_beds", markdown(found, reporting.provenance()))


if __name__ == "__main__":
    main()
