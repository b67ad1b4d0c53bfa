"""Does a shear box show the strength that a biaxial test and a column show?

    box        tau = c + sigma tan(phi), a line through peaks
    biaxial    sigma_1 = q_u + K sigma_3, with sin(phi) = (K - 1)/(K + 1), a line through peaks
    column     q_u = 2 c cos(phi)/(1 - sin(phi)), of c and phi of the others

All are pressed alike, and spheres have one size and one law.  Boxes differ in how many spheres
they are wide, and in how far their halves stand apart: at a narrow gap both edges catch spheres.
Beds of the biaxial test are crushed as columns too, along the direction of pressing or across it,
with two faces free or four.

    python -m verification.shear_boxes                  some seventy minutes of a core
    python -m verification.shear_boxes --parts columns

Runs are kept in results/benchmarks; a second call resumes.  Seeds: 0, 1, 2.  Writes sections of
verification/results/closed_forms.md.
"""

import argparse
import math
from dataclasses import replace
from functools import cache, partial

import jax.numpy as jnp
import numpy as np

from jdem.apparatus.confined import ConfinedCompression
from jdem.apparatus.direct_shear import DirectShear, round_box
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.engine.bed import Numerics
from jdem.engine.segment import LOWER, REMOVE, Segment
from jdem.laboratory.virtual_lab import Outcome, TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.settling import settled
from jdem.packing.specimen import Specimen
from verification import reporting
from verification.closed_forms import (
    DENSITY,
    FAR_WALL,
    LID,
    LID_SPEED,
    WALL,
    PouredBed,
    Room,
    Variant,
    biaxial,
    compiled,
    kept,
    mean,
    moved,
    smoothed,
)

NARROW, WIDE = 0.05, 0.1  # m, diameters; eight and sixteen spheres
TALL, BOX_HEIGHT, COUNT = 0.1, 0.05, 500  # m, of a column and a box; spheres in a narrow box
STRESSES = (12.5e3, 25e3, 50e3)  # Pa, of the lid
THIN, HALF = 1e-3, 3e-3  # m, between the halves; a sixth and half of a sphere
BOXES = ((NARROW, THIN, (0,)), (NARROW, HALF, (0, 1, 2)), (WIDE, THIN, (0,)), (WIDE, HALF, (0,)))
COLUMNS = ((NARROW, TALL, (0, 1, 2)), (WIDE, BOX_HEIGHT, (0,)))
STIFF = SoilParameters(
    wall_friction=0.0, static_friction=0.4, rolling_friction=0.1, shear_modulus=3e7
)  # so stiff that a box has its peak within the travel
ADHESION, NONE = 17.158, 0.0  # J/m2, surface energy; the usual one
DRY = "dry"
RADIUS, ROOM = 3e-3, Room(0.08, 0.05, 0.08)  # m; 13 spheres long and high, eight wide
BEDS = (0, 1, 2)
PRESSED = 204e3  # Pa, before both tests
TRAVEL = 6e-3  # m


def filled(diameter: float, height: float) -> Specimen:
    """With spheres of one size, whatever its own."""
    share = (diameter / NARROW) ** 2 * height / BOX_HEIGHT
    return Specimen(diameter=diameter, height=height, count=round(COUNT * share))


def pressing(area: float) -> ConfinedCompression:
    """To PRESSED, and back to 0."""
    force, wide = PRESSED * area, area / (math.pi / 4 * NARROW**2)
    return ConfinedCompression(
        force_low=force / 2, force_high=force, servo_width=1.5 * wide, tolerance=0.75 * wide,
        seating_force=2.0 * wide,
    )  # fmt: skip


def sheared(
    diameter: float,
    gap: float,
    seed: int,
    stress: float,
    adhesion: float = ADHESION,
    speed: float = 0.02,
) -> dict[str, float]:
    """A bed that was pressed, sheared under a lid of `stress` (Pa): peak and normal stress on the
    plane (kPa), porosity; its adhesion is a surface energy (J/m2)."""
    area = math.pi / 4 * diameter**2
    lower, upper = round_box(diameter, BOX_HEIGHT, 0.45 * BOX_HEIGHT, gap, 1.5 * TRAVEL)
    test = DirectShear(
        lower=lower, upper=upper, area=area, normal_force=stress * area, stroke=TRAVEL,
        servo_width=0.15 * stress * area, simulated_rate=speed, name="shear",
        peak_rows=2 * int(1e-4 / (speed * 2.5e-4) / 2) + 1,
    )  # fmt: skip
    box = filled(diameter, BOX_HEIGHT)
    found, _, porosity = _tested(box, (pressing(area), test), seed, 0.7, adhesion)
    seen = found.observables["shear"]
    peak, plane = (1e-3 * float(seen[f"{name}_stress"]) for name in ("peak_shear", "plane"))
    return {"peak_shear": peak, "plane": plane, "porosity": porosity}


def crushed(diameter: float, height: float, seed: int) -> dict[str, float]:
    """A bed that was pressed, without its mould between smooth platens: strength (kPa) over the
    area that it has at its peak, strain there, porosity."""
    area, test = math.pi / 4 * diameter**2, UnconfinedCompression(simulated_rate=0.05)
    column = filled(diameter, height)
    found, tall, porosity = _tested(column, (pressing(area), test), seed, 0.0)
    curve = found.curves["unconfined"]
    rows = np.asarray(curve.valid) > 0
    force, way = np.asarray(curve.force)[rows], np.asarray(curve.displacement)[rows]
    strain = float(way[int(np.argmax(force))]) / tall
    peak = float(found.observables["unconfined"]["crushing_force"])
    strong = 1e-3 * peak / area * (1 - strain)
    return {"strength": strong, "strain": strain, "porosity": porosity}


def _tested(
    specimen: Specimen, tests, seed: int, rough: float, adhesion: float = ADHESION
) -> tuple[Outcome, float, float]:
    """Tests on a settled bed between platens of this friction; height (m) and porosity as the last
    movement begins."""
    made, own = settled(specimen, seed), {"platen_friction": rough, "surface_energy": adhesion}
    soil = replace(STIFF, **{name: jnp.asarray(value) for name, value in own.items()})
    lab = VirtualLab.of(specimen, TestSequence(tests), Numerics(pairs_per_sphere=6.0))
    found = compiled(VirtualLab.run)(lab, made, soil)
    if bool(found.failed):
        raise RuntimeError(f"bed {seed}: {found.record.explain_overflow(lab.grid)}")
    samples = found.record.samples
    first = int(np.argmax(np.asarray(samples.segment) == int(samples.segment.max())))
    height = float(samples.platen_height[first])
    solid = float(made.solid_fraction() * made.height) / height
    return found, height, 1 - solid


def mohr_coulomb(rows: list[dict[str, float]]) -> tuple[float, float, float]:
    """c (kPa), phi (rad) and the q_u (kPa) that they make, by a line through peaks of one bed."""
    slope, cohesion = np.polyfit([r["plane"] for r in rows], [r["peak_shear"] for r in rows], 1)
    phi = np.arctan(slope)
    return float(cohesion), float(phi), float(2 * cohesion * np.cos(phi) / (1 - np.sin(phi)))


def poured(seed: int) -> PouredBed:
    """A dry bed between planes."""
    variant = Variant(RADIUS, seed, step=0.5, room=ROOM)
    soil = replace(STIFF, surface_energy=jnp.asarray(NONE))
    bed = PouredBed(variant, soil, Numerics(wall_layer=27.0, sample_time=2.5e-4), 8000)
    bed.pour()
    return bed


def sticky(bed: PouredBed) -> PouredBed:
    """The bed with adhesion."""
    bed.soil = replace(bed.soil, surface_energy=jnp.asarray(ADHESION))
    return bed


def pushed(seed: int) -> dict[str, dict]:
    """A bed between planes that was pressed, then pushed by a wall under the lid's stress: what
    `biaxial` says of it dry, and with adhesion under each of STRESSES."""
    bed = poured(seed)
    found = {DRY: biaxial(bed, float(STIFF.static_friction), STRESSES[1], PRESSED)}
    bed = sticky(bed)
    for stress in STRESSES:
        found[f"{stress:g}"] = biaxial(bed, float(STIFF.static_friction), stress, PRESSED)
    return found


def of_planes(found: dict[str, dict]) -> tuple[list[tuple[float, float]], float, float, float]:
    """sigma_3 and sigma_1 (kPa) at the peaks of one bed with adhesion, and the q_u (kPa), c (kPa)
    and phi (rad) of the line through them."""
    rows = [found[f"{stress:g}"] for stress in STRESSES]
    points = [(1e-3 * r["vertical"], 1e-3 * r["vertical"] * r["peak"]) for r in rows]
    ratio, strength = np.polyfit([low for low, _ in points], [high for _, high in points], 1)
    phi = math.asin((ratio - 1) / (ratio + 1))
    return points, float(strength), float(strength / (2 * ratio**0.5)), phi


# ---------------------------------------------------------------- columns between planes

SIDES, FACES = (WALL, FAR_WALL), (1, 2, 3, 4)  # the walls across the length; all four
FREE, PLANE, BOTH, ACROSS = "free", "plane", "both", "across"
COLUMN = {
    FREE: "along the pressing, four faces free",
    PLANE: "along the pressing, two faces free",
    BOTH: "along the pressing, two faces free, which had been pressed too",
    ACROSS: "across the pressing, the pressed face free",
}
LITTLE, CALM = 5.0, 500.0  # N, a lid's load that is as good as none; 1/s, damping as it is pressed
OPENED, OPENING, REST = 1e-3, 0.02, 0.05  # m, m/s, s: how walls open, and the rest that follows
CRUSHED, ACROSS_SPEED = 6e-3, 9.6e-3  # m, of the lid or the wall; m/s of the wall
SLOWLY = 0.3  # times the lid's speed


def programme(way: str, slower: float = 1.0) -> tuple[list[Segment], int]:
    """How a column is pressed, freed and crushed, and what crushes it."""
    area, face = ROOM.length * ROOM.width, ROOM.width * ROOM.filled
    load, side = PRESSED * area, PRESSED * face
    calmer = 0.4 * CALM

    def servo(duration, boundary, target, full, placed=None):
        speeds = {boundary: LID_SPEED}
        return moved(duration, speeds, placed, damping=CALM, servo=boundary, load=target,
                     width=0.3 * full)  # fmt: skip

    pressing = [servo(0.2, LID, load, load, {LID: LOWER})]
    if way == BOTH:
        pressing += [servo(0.2, WALL, side, side), servo(0.1, WALL, LITTLE, side)]
    pressing += [servo(0.1, LID, LITTLE, load)]
    if way == ACROSS:
        push = moved(CRUSHED / ACROSS_SPEED, {WALL: ACROSS_SPEED})
        return [*pressing, moved(REST, {}, {LID: REMOVE}, damping=calmer), push], WALL
    walls, speed = FACES if way == FREE else SIDES, slower * LID_SPEED
    return [
        *pressing,
        moved(OPENED / OPENING, dict.fromkeys(walls, -OPENING), {LID: REMOVE}, damping=calmer),
        moved(REST, {}, dict.fromkeys(walls, REMOVE), damping=calmer),
        moved(CRUSHED / speed, {LID: speed}, {LID: LOWER}),
    ], LID


@cache
def column_bed(seed: int) -> PouredBed:
    """A bed with adhesion between planes, poured once."""
    return sticky(poured(seed))


def column(way: str, seed: int, slower: float = 1.0) -> dict[str, float]:
    """Strength (kPa, over the area at the peak) and strain there of a bed between planes that was
    pressed, then freed and crushed in one of the ways of COLUMN; stresses (kPa) of lid and wall as
    it was pressed, and porosity before it was freed."""
    bed, (rows, crusher) = column_bed(seed), programme(way, slower)
    record = bed.advanced(rows, float(STIFF.static_friction), 0.0, 0.0)
    samples, movement = record.samples, np.asarray(record.samples.segment)
    place, loads = np.asarray(samples.reference), np.abs(np.asarray(samples.loads))
    before = np.flatnonzero(movement == len(rows) - (3 if crusher == WALL else 4))[-1]
    length = place[before, FAR_WALL, 0] - place[before, WALL, 0]
    height = place[before, LID, 2]
    flat, upright = length * ROOM.width, ROOM.width * height
    axis, area, long = (2, flat, height) if crusher == LID else (0, upright, length)
    last = movement == len(rows) - 1
    way_gone = np.abs(place[last, crusher, axis] - place[last, crusher, axis][0]) / long
    stress = smoothed(1e-3 * loads[last, crusher, axis] / area * (1 - way_gone))
    peak = int(np.argmax(stress))
    pressed = loads[movement < len(rows) - 2].max(axis=0)
    return {
        "strength": float(stress[peak]),
        "strain": float(way_gone[peak + (last.sum() - len(stress)) // 2]),
        "lid": 1e-3 * float(pressed[LID, 2] / flat),
        "wall": 1e-3 * float(pressed[WALL, 0] / upright),
        "porosity": float(1 - bed.mass / DENSITY / (flat * height)),
    }


# ---------------------------------------------------------------- the page


def markdown() -> str:
    return (
        f"# Direct shear, biaxial test and unconfined strength\n\n"
        f"## Boxes\n\n{_boxes()}\n## Biaxial tests\n\n{_planes()}\n"
        f"## Columns\n\n{_columns()}\n## Without adhesion\n\n{_dry()}"
    )


def _boxes() -> str:
    rows = []
    for wide, gap, beds in BOXES:
        for bed in beds:
            name = f"box-{1e3 * wide:g}-{1e3 * gap:g}-{bed}"
            found = [kept(f"{name}-{p:g}", partial(sheared, wide, gap, bed, p)) for p in STRESSES]
            c, phi, made = mohr_coulomb(found)
            each = "; ".join(f"{r['plane']:.1f}: {r['peak_shear']:.1f}" for r in found)
            rows.append([
                f"{1e3 * wide:g}", f"{1e3 * gap:g}", f"{bed}", each, f"{c:.1f}",
                f"{np.degrees(phi):.1f}", f"{made:.0f}", f"{found[0]['porosity']:.3f}",
            ])  # fmt: skip
    slowly = partial(sheared, NARROW, HALF, 0, STRESSES[1], speed=0.01)
    slow = kept("box-slow", slowly)["peak_shear"]
    head = ("width (mm)", "gap (mm)", "bed", "sigma on the plane: tau (kPa)", "c (kPa)",
            "phi (deg)", "q_u of both (kPa)", "porosity")  # fmt: skip
    return (
        f"{reporting.table(head, rows)}\n"
        f"At half the speed, width {1e3 * NARROW:g} mm, gap {1e3 * HALF:g} mm, bed 0: "
        f"{slow:.1f} kPa under {1e-3 * STRESSES[1]:g} kPa.\n"
    )


def _dry() -> str:
    """tau/sigma of dry spheres by the width of the box, and their angle in a biaxial test."""
    rows = []
    for wide in (NARROW, WIDE):
        make = partial(sheared, wide, HALF, 0, STRESSES[1], adhesion=NONE)
        r = kept(f"dry-{1e3 * wide:g}-0", make)
        angle = math.degrees(math.atan2(r["peak_shear"], r["plane"]))
        rows.append([f"{1e3 * wide:g}", f"{r['plane']:.1f}", f"{r['peak_shear']:.1f}",
                     f"{angle:.1f}", f"{r['porosity']:.3f}"])  # fmt: skip
    ratios = [kept(f"planes-{bed}", partial(pushed, bed))[DRY]["peak"] for bed in BEDS]
    angles = [math.degrees(math.asin((k - 1) / (k + 1))) for k in ratios]
    head = ("width (mm)", "sigma on the plane (kPa)", "tau (kPa)", "phi (deg)", "porosity")
    said = f"In a biaxial test: {mean(angles)} degrees, {len(BEDS)} beds."
    return f"{reporting.table(head, rows)}\n{said}\n"


def _planes() -> str:
    """sigma_1 at the peak of biaxial tests with adhesion, and what lines through them say."""
    rows = []
    for bed in BEDS:
        found = kept(f"planes-{bed}", partial(pushed, bed))
        points, strength, c, phi = of_planes(found)
        each = "; ".join(f"{low:.1f}: {high:.0f}" for low, high in points)
        rows.append([f"{bed}", each, f"{c:.1f}", f"{np.degrees(phi):.1f}", f"{strength:.0f}",
                     f"{found[DRY]['porosity']:.3f}"])  # fmt: skip
    head = ("bed", "sigma_3: sigma_1 (kPa)", "c (kPa)", "phi (deg)", "q_u of both (kPa)",
            "porosity")  # fmt: skip
    return reporting.table(head, rows)


def _columns() -> str:
    rows = [
        [f"{1e3 * wide:g} x {1e3 * tall:g}", f"{bed}", f"{r['strength']:.1f}",
         f"{100 * r['strain']:.1f}", f"{r['porosity']:.3f}"]
        for wide, tall, beds in COLUMNS for bed in beds
        for r in [kept(f"column-{1e3 * wide:g}-{bed}", partial(crushed, wide, tall, bed))]
    ]  # fmt: skip
    head = ("column (mm)", "bed", "q_u measured (kPa)", "strain (%)", "porosity")
    return reporting.table(head, rows)


def between_planes() -> str:
    """The section on columns between planes."""
    rows, found = [], {}
    for way, said in COLUMN.items():
        found[way] = [kept(f"column-{way}-{bed}", partial(column, way, bed)) for bed in BEDS]
        names = ("lid", "wall", "porosity", "strain", "strength")
        rows.append([said, *(mean([r[name] for r in found[way]]) for name in names)])
    slow = kept("column-slow", partial(column, PLANE, 0, slower=SLOWLY))["strength"]
    head = ("crushed", "pressed by the lid to (kPa)", "by the wall (kPa)", "porosity",
            "strain at the peak", "strength (kPa)")  # fmt: skip
    return (
        "# Columns between planes\n\n"
        f"Beds of the biaxial tests above; planes are smooth; {len(BEDS)} beds.\n\n"
        f"{reporting.table(head, rows)}\n"
        f"At {SLOWLY:g} of the speed, {COLUMN[PLANE]}, bed 0: {slow:.1f} kPa in place of "
        f"{found[PLANE][0]['strength']:.1f}.\n"
    )


PARTS = {"tests": markdown, "columns": between_planes}


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
