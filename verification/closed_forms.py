"""Beds of spheres beside two closed forms of soil mechanics.

    Rankine        P = K_p rho g H^2 W/2 on a smooth wall that is moved into dry soil,
                   K_p = tan^2(45 + phi/2)
    vane           T = tau pi D^2 H/2 (1 + D/(3 H)), tau the same on mantle and both ends

None of the angles and strengths is assumed.  phi of Rankine is that of the SAME bed: without
gravity, between smooth planes, the wall is pushed in under a lid that keeps the bed's mean vertical
stress, and K_p is the ratio of both stresses (a biaxial test in plane strain).

    python -m verification.closed_forms                  some fifteen minutes of a core
    python -m verification.closed_forms --parts rankine vane

Runs are kept in results/benchmarks; a second call resumes.  Seeds: 0, 1, 2.  Writes sections
of verification/results/closed_forms.md.
"""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from calibrate.core.files import write_json
from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import DOWN, UP, Axis, point
from jdem.boundaries.plane import Plane
from jdem.core.quantity import cast
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics, build_bed, plan_grid
from jdem.engine.loop import Record, begun, run
from jdem.engine.segment import KEEP, LOWER, Segment, stack
from jdem.materials.contact_laws import BED_LAWS
from jdem.materials.soil import SoilParameters
from tests.jdem.apparatus.test_tools import ring
from verification import reporting

GRAVITY, DENSITY, SPREAD = 9.81, 1830.0, 0.15  # m/s2; kg/m3 of spheres; of their radius

# ---------------------------------------------------------------- Rankine

DENSE = 0.6  # solid fraction with which the height was chosen
POURED, FRICTION = 0.05, 0.3  # friction between spheres as they fall, and afterwards
WALL, FAR_WALL, LID = 1, 2, 5  # numbers of boundaries; 0 is the base
STROKE, STRAIN = 4e-3, 0.06  # m, of the wall under gravity; of the length, without
PUSHED, LID_SPEED = 0.5, 0.05  # s, of all strokes; m/s
SMOOTHED, END = 0.05, 0.1  # of the stroke: the peak is of means over it; the end
DRY = SoilParameters(
    restitution=0.3, surface_energy=0.0, rolling_friction=0.0, shear_modulus=1e6,
    poisson_ratio=0.3, conventions=BED_LAWS["hertz_mindlin"],
)  # fmt: skip
NUMERICS = Numerics(wall_layer=27.0, sample_time=1e-3)
CAPACITY = 1800  # samples
STEP = 2.0  # over the usual one, which reckons with contacts far deeper than these


@dataclass(frozen=True)
class Room:
    """A box of planes, m: length, along which a wall moves, width, how high it is filled."""

    length: float = 0.2
    width: float = 0.026
    filled: float = 0.062

    def planes(self) -> tuple[Plane, ...]:
        """Base, the wall that moves along x, the wall opposite, both sides, the lid, far away."""
        low, high = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
        long, wide = (self.length, 0.0, 0.0), (0.0, self.width, 0.0)
        planes: tuple[tuple[Axis, Axis], ...] = (
            (low, UP), (low, (1.0, 0.0, 0.0)), (long, (-1.0, 0.0, 0.0)),
            (low, (0.0, 1.0, 0.0)), (wide, (0.0, -1.0, 0.0)), (high, DOWN),
        )  # fmt: skip
        return tuple(Plane.at(point(*place, float), axis) for place, axis in planes)


@dataclass(frozen=True)
class Variant:
    """How a bed is made and pushed: radius of its spheres (m), speed and time step over the usual
    ones, its seed, its room."""

    radius: float = 2.5e-3
    seed: int = 0
    speed: float = 1.0
    step: float = 1.0
    room: Room = Room()

    @property
    def name(self) -> str:
        return f"{self.radius:g}-{self.seed}-{self.speed:g}-{self.step:g}"

    def inertial(self, height: float) -> float:
        """v/H d sqrt(rho/p), p the mean vertical stress."""
        pressure = 0.5 * DENSE * DENSITY * GRAVITY * height
        rate = self.speed * STROKE / PUSHED / height
        return rate * 2 * self.radius * math.sqrt(DENSITY / pressure)


def thrown(variant: Variant) -> tuple[Spheres, np.ndarray]:
    """Spheres, and centres (N, 3) in m from which they fall."""
    random, radius, room = np.random.default_rng(variant.seed), variant.radius, variant.room
    solid = DENSE * room.length * room.width * room.filled
    count = round(solid / (4 / 3 * np.pi * radius**3 * (1 + SPREAD**2)))
    radii = radius * random.uniform(1 - SPREAD, 1 + SPREAD, count)
    pitch = 1.06 * 2 * radius * (1 + SPREAD)
    along, across = int(room.length // pitch), int(room.width // pitch)
    number = np.arange(count)
    rows = np.stack([number // across % along, number % across, number // (along * across)], 1)
    free = 0.5 * pitch - radius * (1 + SPREAD)
    shaken = random.uniform(-free, free, rows.shape)
    centres = (rows + 0.5) * np.array([room.length / along, room.width / across, pitch]) + shaken
    return Spheres(jnp.asarray(radii), jnp.asarray(DENSITY * 4 / 3 * np.pi * radii**3)), centres


def moved(
    duration: float,
    speeds: dict[int, float],
    placed: dict[int, int] | None = None,
    *,
    damping: float = 0.0,
    servo: int = LID,
    load: float = math.inf,
    width: float = 1.0,
) -> Segment:
    """Boundaries at speeds (m/s), of which `servo` brings its load (N) about, as a servo of this
    width (N) does."""
    still = jnp.zeros(LID + 1)
    speed, place = still, jnp.full(LID + 1, KEEP)
    for boundary, value in speeds.items():
        speed = speed.at[boundary].set(value)
    for boundary, value in (placed or {}).items():
        place = place.at[boundary].set(value)
    return Segment(
        speed=speed, spin=still, growth=still, placed=place, servo=servo, force_target=load,
        servo_width=width, response=1e-3, damping=damping, duration=duration,
    )  # fmt: skip


def movement(
    duration: float, speed: float = 0.0, damping: float = 0.0, load: float = 0.0, lid: int = KEEP
) -> Segment:
    """The wall at a speed (m/s) into the soil, under a lid of this load (N) if it has one."""
    speeds = {WALL: speed, LID: LID_SPEED if load else 0.0}
    return moved(
        duration, speeds, {LID: lid}, damping=damping, load=load or math.inf,
        width=0.3 * load or 1.0,
    )  # fmt: skip


class PouredBed:
    """Spheres of a variant in its room, and where they lie (m); records of at most `capacity`
    samples."""

    def __init__(
        self,
        variant: Variant,
        soil: SoilParameters = DRY,
        numerics: Numerics = NUMERICS,
        capacity: int = CAPACITY,
    ):
        self.variant, self.soil = variant, soil
        self.numerics, self.capacity = numerics, capacity
        self.spheres, centres = thrown(variant)
        self.place = Vector.from_rows(jnp.asarray(centres))
        self.mass = float(np.sum(self.spheres.mass))
        largest = variant.radius * (1 + SPREAD)
        extent = (variant.room.length, float(centres[:, 2].max()) + 2 * largest)
        self.grid = plan_grid(self.spheres.count, variant.radius, largest, extent, numerics)

    def pour(self) -> None:
        """Lets the spheres fall, with little friction and without adhesion."""
        falls = [movement(0.3, damping=20.0), movement(0.1, damping=100.0), movement(0.02)]
        soil, self.soil = self.soil, replace(self.soil, surface_energy=jnp.asarray(0.0))
        self.place = self.advanced(falls, POURED, POURED, GRAVITY).state.motion.position
        self.soil = soil

    def advanced(self, programme: list[Segment], friction: float, base: float, gravity: float):
        """The record of a programme from where the spheres lie, with frictions of spheres and base
        (-) and gravity (m/s2)."""
        soil = replace(self.soil, static_friction=jnp.asarray(friction))
        walls = ("mould",) * (LID + 1)
        bed = build_bed(self.spheres, soil, self.grid, self.numerics, surfaces=walls, follows=None)
        bed = replace(
            bed, time_step=STEP * self.variant.step * bed.time_step, gravity=jnp.asarray(gravity),
            wall_friction=jnp.zeros(LID + 1).at[0].set(base),
        )  # fmt: skip
        steps = jnp.maximum(jnp.round(self.numerics.sample_time / bed.time_step), 1.0).astype(
            jnp.int32
        )
        whole = stack([replace(s, duration=jnp.asarray(s.duration, float)) for s in programme])
        state = begun(bed, self.place, self.variant.room.planes())
        double = jnp.dtype("float64")
        record: Record = compiled(run)(bed, state, cast(whole, double), steps, self.capacity)
        record = jax.block_until_ready(record)
        if bool(record.overflow_of(self.grid)) or not bool(record.finished):
            raise RuntimeError(record.explain_overflow(self.grid) or "too few samples")
        return record


@cache
def compiled(function: Callable) -> Callable:
    return eqx.filter_jit(function)


def pushed(variant: Variant) -> dict:
    """One bed: K of the wall on a rough base and on a smooth one, and in the biaxial test."""
    bed = PouredBed(variant)
    bed.pour()
    height = 2 * float(np.sum(bed.spheres.mass * bed.place.z)) / bed.mass
    found = {"spheres": bed.spheres.count, "height": height}
    found["rough"] = under_gravity(bed, FRICTION, STROKE, height)
    found["smooth"] = under_gravity(bed, 0.0, STRAIN * variant.room.length, height)
    return found | {"biaxial": biaxial(bed)}


def under_gravity(bed: PouredBed, base: float, stroke: float, height: float) -> dict:
    """The wall's K at the end of its stroke (m), by the weight that lies before it there, over half
    the bed's height; its course and that of the wall opposite, by the first weight."""
    time = PUSHED / bed.variant.speed
    programme = [movement(0.05, damping=50.0), movement(0.02), movement(time, stroke / time)]
    record = bed.advanced(programme, FRICTION, base, GRAVITY)
    way, loads, _ = _last(record)
    place = record.state.motion.position
    near = np.asarray(place.x) < float(way[-1]) + 0.5 * height
    present = GRAVITY * float((bed.spheres.mass * place.z)[near].sum()) / (0.5 * height)  # N
    first = GRAVITY * bed.mass * height / 2 / bed.variant.room.length
    wall, far = -loads[:, WALL, 0], loads[:, FAR_WALL, 0]
    late = slice(-round(END * len(wall)), None)
    k = float(wall[late].mean()) / present
    return {"k": k, "risen": present / first, "wall": _course(wall / first),
            "opposite": _course(far / first)}  # fmt: skip


def biaxial(
    bed: PouredBed, friction: float = FRICTION, stress: float | None = None, pressed: float = 0.0
) -> dict:
    """Horizontal over vertical stress without gravity, on a smooth base; the height that carries
    stress is twice that of the centre of mass, as the lid touches few spheres.

    The lid has a stress (Pa), half of the bed's weight unless stated, after it `pressed` (Pa)."""
    time, room = PUSHED / bed.variant.speed, bed.variant.room
    area, weight = room.length * room.width, bed.mass * GRAVITY
    load = 0.5 * weight if stress is None else stress * area
    damping, first, rest = (500.0, pressed * area, 0.1) if pressed else (50.0, load, 0.03)
    programme = [
        movement(0.2, damping=damping, load=first, lid=LOWER),
        movement(rest, damping=500.0 * (pressed > 0), load=load),
        movement(time, STRAIN * room.length / time, load=load),
    ]  # fmt: skip
    record = bed.advanced(programme, friction, 0.0, 0.0)
    way, loads, lid = _last(record)
    height = 2 * float(np.sum(bed.spheres.mass * record.state.motion.position.z)) / bed.mass
    filled = height / float(lid[-1])
    vertical = loads[:, LID, 2] / (room.length - way)
    ratio = -loads[:, WALL, 0] / (filled * lid) / vertical
    smooth, half = smoothed(ratio), round(SMOOTHED * len(ratio)) // 2
    porosity = 1 - bed.mass / DENSITY / (area * filled * float(lid[0]))
    return {"peak": float(smooth.max()), "end": float(ratio[-round(END * len(ratio)) :].mean()),
            "vertical": float(vertical[half + int(np.argmax(smooth))]) / room.width,
            "porosity": porosity, "course": _course(ratio)}  # fmt: skip


def smoothed(values: np.ndarray) -> np.ndarray:
    """Means over a share of the stroke."""
    width = round(SMOOTHED * len(values))
    return np.convolve(values, np.ones(width) / width, mode="valid")


def _last(record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Way of the wall (m), loads and height of the lid (m) in the last movement."""
    samples, rows = record.samples, np.asarray(record.samples.segment) == 2
    place = np.asarray(samples.reference)[rows]
    return place[:, WALL, 0], np.asarray(samples.loads)[rows], place[:, LID, 2]


def _course(values: np.ndarray) -> list[float]:
    """Means over a twentieth of the stroke each."""
    return [float(f"{part.mean():.4g}") for part in np.array_split(values, 20)]


COARSE, FINE = 3.5e-3, 2.5e-3  # m, radii
BASES = ("rough", "smooth")
VARIANTS = tuple(Variant(radius, seed) for radius in (COARSE, FINE) for seed in range(3))
CHECKS = (Variant(COARSE, speed=0.5), Variant(COARSE, step=0.5))


def kept(name: str, made: Callable[[], dict]) -> dict:
    """What `made` gives, of this call or an earlier one."""
    path = reporting.kept("closed_forms") / f"{name}.json"
    if not path.exists():
        write_json(path, made())
    return json.loads(path.read_text(encoding="utf-8"))


def mean(values) -> str:
    """With its standard error."""
    error = np.std(values, ddof=1) / len(values) ** 0.5 if len(values) > 1 else np.nan
    return f"{np.mean(values):.3g} ± {error:.2g}"


def rankine_page(heading: str, variants: tuple[Variant, ...]) -> str:
    rows, ratios = [], {}
    for v in variants:
        r = kept(f"rankine-{v.name}", lambda v=v: pushed(v))
        k, peak, end = [r[test]["k"] for test in BASES], r["biaxial"]["peak"], r["biaxial"]["end"]
        ratios.setdefault(v.radius, []).append([each / peak for each in k])
        angle = np.degrees(2 * np.arctan(np.sqrt(peak)) - np.pi / 2)
        rows.append([
            f"{r['spheres']}", f"{r['height'] / v.radius / 2:.1f}", f"{v.seed}", f"{v.speed:g}",
            f"{v.step:g}", f"{v.inertial(r['height']):.1e}", f"{r['biaxial']['porosity']:.3f}",
            f"{angle:.1f}",
            *(f"{x:.2f}" for x in (peak, end, *k, *(each / peak for each in k))),
            f"{r['rough']['risen']:.2f}", f"{r['rough']['opposite'][-1]:.2f}",
        ])  # fmt: skip
    head = ("spheres", "height/d", "seed", "speed", "step", "inertial", "porosity", "phi (deg)",
            "K_p: biaxial peak", "end", "wall, rough base", "smooth base", "ratio, rough",
            "ratio, smooth", "weight before the wall over the first", "opposite wall")  # fmt: skip
    said = "".join(
        f"- {2e3 * radius:g} mm, {base} base: {mean([each[k] for each in found])} of K_p, "
        f"{len(found)} beds.\n"
        for radius, found in ratios.items() for k, base in enumerate(BASES)
        if len({v.seed for v in variants}) > 1  # else they are one bed, tested differently
    )  # fmt: skip
    text = "K of the walls at the end of the stroke, by the weight of soil that then lies before it"
    return f"# {heading}\n\n{text}.\n\n{reporting.table(head, rows)}\n{said}"


def vane_page() -> str:
    rows = []
    for ends in (5, 15, 50):
        r = kept(f"ring-{ends}", lambda ends=ends: ring(ends))
        shares = (r["torque"] / r["sum"], r["torque"] / r["form"], r["found"] / r["tau"])
        rows.append([f"{r['spheres']}", f"{r['torque']:.4g}", *(f"{x - 1:.1e}" for x in shares)])
    head = ("spheres", "torque (N m)", "over the sum of strength x arm, less 1",
            "over tau K, less 1", "strength at the peak over tau, less 1")  # fmt: skip
    return "# A ring around a vane\n\n" + reporting.table(head, rows)


PARTS: dict[str, Callable[[], str]] = {
    "rankine": lambda: rankine_page("Rankine", VARIANTS), "vane": vane_page,
    "checks": lambda: rankine_page("Rankine, slower and with a smaller step", CHECKS),
}  # fmt: skip


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--parts", nargs="+", choices=tuple(PARTS), default=list(PARTS))
    chosen = parser.parse_args()
    reporting.configure()
    for part in chosen.parts:
        page = PARTS[part]() + reporting.footer(reporting.provenance())
        reporting.write_section("closed_forms", page)


if __name__ == "__main__":
    main()
