"""Tools in beds whose positions are given, beside an independent code on the same beds.

LIGGGHTS-PUBLIC 3.8.0 pushed a cone and a plate into six beds of 1000 spheres, turned a vane in
them, lifted the tube from around them, and sheared six beds of 700 in a square box (law 1:
Hertz-Mindlin without adhesion; law 2: EEPA, three beds, of boxes two).  This script does the same
from the same positions.  Codes that are both right part on ONE bed, by as much as a smaller time
step changes there; what they have to share is the mean over beds.

    python -m verification.reference_beds                    some fifteen minutes on two cores
    python -m verification.reference_beds --tests plate --laws 1    the other rows stay

Runs are kept in results/benchmarks; a second call resumes.  Writes a section of
verification/results/reference_beds.md.  Positions, radii and what LIGGGHTS found are in
tests/data/reference_beds.npz (made for this purpose, MIT).
"""

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from calibrate.core.files import write_json
from jdem.apparatus.base import AbstractApparatus, Tool
from jdem.apparatus.direct_shear import SIDEWAYS, DirectShear
from jdem.apparatus.penetration import Penetration, cone, plate
from jdem.apparatus.repose import LiftedCylinder, tube
from jdem.apparatus.vane import VaneShear, vane, vane_constant
from jdem.bodies.spheres import Spheres
from jdem.boundaries.base import UP
from jdem.boundaries.mesh import Mesh
from jdem.core.vector import Vector
from jdem.engine.bed import Numerics
from jdem.engine.segment import CELL
from jdem.laboratory.virtual_lab import Outcome, TestSequence, VirtualLab
from jdem.materials.contact_laws import BED_LAWS
from jdem.materials.soil import SoilParameters
from jdem.observables import running_mean
from jdem.packing.specimen import Packing, Specimen
from verification import reporting

DATA = Path(__file__).parents[1] / "tests" / "data" / "reference_beds.npz"
DENSITY = 1830.0  # kg/m3
MOULD = 0.030  # m, radius
RATE = 0.05  # m/s
DAMPING = 41.0  # 1/s, while beds come to rest: 5e-3 N s/m on a sphere of 0.12 g
SPECIMEN = Specimen(diameter=2 * MOULD, height=0.06, count=1000, spread=0.15, porosity=0.42)
TRIES = 3  # with larger lists each, looked after three times as often
TITLE = "# Tools on the beds of another code"
SMALLER = 0.8  # of the time step, for what a bed itself leaves open
SIDE, PEAK_ROWS = 0.05, 45  # of the shear box: m; samples of 8 um of travel
CONE, PLATE = np.pi / 4 * 0.01283**2, np.pi / 4 * 0.025**2  # m2

_SHARED = SoilParameters(
    restitution=0.3, static_friction=0.5, rolling_friction=0.2, shear_modulus=31.2e6 / 2.6,
    poisson_ratio=0.3, wall_friction=0.3, platen_friction=0.3, surface_energy=0.0,
    tensile_exponent=1.0, plasticity_ratio=2 / 3, tangential_multiplier=1.0,
)  # fmt: skip
ADHESIVE = 2
LAWS = {
    1: replace(_SHARED, conventions=BED_LAWS["hertz_mindlin"]),
    ADHESIVE: replace(
        _SHARED,
        surface_energy=jnp.asarray(1500.0),
        reference_diameter=jnp.asarray(5.02e-3),
        conventions=BED_LAWS["liggghts"],
    ),
}

Read = Callable[[Outcome, Packing], float]


@dataclass(frozen=True)
class Compared:
    """A test: its apparatus; by name in the data what is compared, its unit, its reading; rough (-)
    is the friction on the base where it is not the platen's; adhesion (J/m2) that of law 2 where it
    is not the usual one; `beds` by kind; `longer` the time step under law 1 over the usual one,
    which reckons with deeper contacts than these tests have."""

    apparatus: AbstractApparatus
    numbers: dict[str, tuple[str, str, Read]]
    rough: float | None = None
    adhesion: float | None = None
    beds: str = "cylinder"
    longer: float = 2.0


def _mean_pressure(low: float, high: float, area: float) -> Read:
    """Mean (kPa) over depths (m) under the highest sphere, on an area (m2)."""

    def read(found: Outcome, made: Packing) -> float:
        curve = found.curves["pushed"]
        rows = np.asarray(curve.valid) > 0
        depth = float(made.height) - np.asarray(found.record.samples.reference)[rows, CELL, 2]
        force = np.asarray(curve.force)[rows]
        return float(1e-3 * force[(depth > low) & (depth < high)].mean() / area)

    return read


def _observable(test: str, name: str, factor: float) -> Read:
    return lambda found, made: float(factor * found.observables[test][name])


def _late_torque(found: Outcome, made: Packing) -> float:
    """Mean (mN m) from 60 degrees on."""
    curve = found.curves["turned"]
    late = (np.asarray(curve.valid) > 0) & (np.asarray(curve.displacement) > 1.05)
    return float(1e3 * np.asarray(curve.force)[late].mean())


def _peak_stress(found: Outcome, made: Packing) -> float:
    """Largest mean (kPa) over 0.36 mm, as LIGGGHTS' curves were read: the test's own peak is
    rounded over 2 % of the lid's force, and lies below."""
    curve = running_mean(found.curves["sheared"], PEAK_ROWS)
    return float(1e-3 * np.asarray(curve.force)[np.asarray(curve.valid) > 0].max() / SIDE**2)


def _mean_stress(found: Outcome, made: Packing) -> float:
    """Mean (kPa) while the box travels from 1 to 5 mm."""
    curve = found.curves["sheared"]
    way = np.asarray(curve.displacement)
    between = (np.asarray(curve.valid) > 0) & (way > 1e-3) & (way < 5e-3)
    return float(1e-3 * np.asarray(curve.force)[between].mean() / SIDE**2)


def _at_sinkage(depth: float) -> Read:
    """Mean pressure (kPa) within 0.5 mm of a sinkage (m), from where it first reaches 1 kPa."""

    def read(found: Outcome, made: Packing) -> float:
        curve = found.curves["pushed"]
        rows = np.asarray(curve.valid) > 0
        pressure = 1e-3 * np.asarray(curve.force)[rows] / PLATE
        way = np.asarray(curve.displacement)[rows]
        sinkage = way - way[np.argmax(pressure > 1.0)]
        return float(pressure[np.abs(sinkage - depth) < 5e-4].mean())

    return read


def _pushed(parts: tuple[Tool, ...], stroke: float) -> Penetration:
    return Penetration(
        parts=parts, simulated_rate=RATE, nominal_rate=RATE, stroke=stroke, rest=0.05,
        resting_damping=DAMPING, name="pushed",
    )  # fmt: skip


def _sheared(stress: float) -> Compared:
    """Under a lid of so many kPa."""
    lower, upper = square_box(SIDE, 0.016, 0.001, 0.09)
    apparatus = DirectShear(
        lower=lower, upper=upper, area=SIDE**2, normal_force=1e3 * stress * SIDE**2, stroke=0.008,
        nominal_rate=0.02, resting_damping=DAMPING, peak_rows=PEAK_ROWS, name="sheared",
    )  # fmt: skip
    reads = {
        f"shear{stress:g}": ("peak shear stress", _peak_stress),
        f"plane{stress:g}": (
            "normal stress on the plane at the peak", _observable("sheared", "plane_stress", 1e-3)
        ),
        f"early{stress:g}": ("mean shear stress from 1 to 5 mm", _mean_stress),
    }  # fmt: skip
    numbers = {
        key: (f"{what}, lid {stress:g} kPa", "kPa", read) for key, (what, read) in reads.items()
    }
    return Compared(apparatus, numbers, beds="box", longer=2.0 if stress < 100 else 1.0)


def square_box(
    side: float, plane: float, gap: float, top: float
) -> tuple[tuple[Tool, ...], tuple[Tool, ...]]:
    """Both halves of a square box with lips, as shells of triangles, m."""
    half, rim = side / 2, 0.8 * side + side / 10
    below, above = plane, plane + gap
    lower = [
        *_quad(_square(half, 0.0)[::-1]),
        *_around(_square(half, 0.0), _square(half, below)),
        *_around(_square(half, below), _square(rim, below)),
    ]
    upper = [
        *_around(_square(rim, above), _square(half, above)),
        *_around(_square(half, above), _square(half, top)),
    ]
    area = 4 * side * plane
    made = [
        Mesh.from_triangles(np.array(faces), axis=axis, two_sided=True, name=name)
        for faces, axis, name in ((lower, SIDEWAYS, "lower half"), (upper, UP, "upper half"))
    ]
    return (Tool("lower", made[0], area, "mould"),), (Tool("upper", made[1], 2 * area, "mould"),)


def _square(half: float, height: float) -> list[tuple[float, float, float]]:
    return [(x * half, y * half, height) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]


def _quad(corners) -> list:
    a, b, c, d = corners
    return [(a, b, c), (a, c, d)]


def _around(first, second) -> list:
    """Four quadrilaterals between two squares."""
    sides = [(first[k], first[(k + 1) % 4], second[(k + 1) % 4], second[k]) for k in range(4)]
    return [face for side in sides for face in _quad(side)]


TESTS = {
    "cone": Compared(
        _pushed(cone(0.01283, 30.0, 0.00953), 0.036),
        {"cone": ("mean on the tip from 24 to 34 mm", "kPa", _mean_pressure(0.024, 0.034, CONE))},
    ),
    "plate": Compared(
        _pushed(plate(0.025, 0.004), 0.0105),
        {
            "plate": ("mean from 5 to 10 mm", "kPa", _mean_pressure(0.005, 0.010, PLATE)),
            **{
                f"plate{mm}": (f"at a sinkage of {mm} mm", "kPa", _at_sinkage(1e-3 * mm))
                for mm in (2, 4, 6)
            },
        },
    ),
    "vane": Compared(
        VaneShear(  # no servo lets it rest at no axial force, as there
            vane=vane(0.02, 0.02, 0.0015), constant=vane_constant(0.02, 0.02), nominal_rate=5.0,
            depth=0.03, resting_damping=DAMPING, servo_width=1e9, name="turned",
        ),
        {
            "vane": ("peak torque", "mN m", _observable("turned", "peak_torque", 1e3)),
            "late": ("mean torque from 60 to 90 degrees", "mN m", _late_torque),
        },
    ),
    "repose": Compared(
        LiftedCylinder(
            tube=tube(2 * MOULD, 0.05), nominal_rate=RATE, resting_damping=DAMPING, name="lifted"
        ),
        {
            "repose": (
                "angle of the mass profile", "deg",
                _observable("lifted", "repose_angle", 180 / np.pi),
            )
        },
        rough=0.5,
        adhesion=5.0,
    ),
    **{f"shear{stress:g}": _sheared(stress) for stress in (25.0, 50.0, 100.0)},
}  # fmt: skip


@cache
def data() -> dict[str, np.ndarray]:
    """Beds (`cylinder_1`: (4, spheres), x, y, z and radius in um) and what LIGGGHTS found, by
    number and law (`cone_1`: (beds,))."""
    with np.load(DATA) as found:
        return {name: found[name] for name in found.files}


def packing(kind: str, bed: int) -> Packing:
    """The spheres of one bed, from their positions alone."""
    *centres, radius = 1e-6 * data()[f"{kind}_{bed}"]
    spheres = Spheres(radius, DENSITY * 4 / 3 * np.pi * radius**3)
    height, mould = float((centres[2] + radius).max()), MOULD if kind == "cylinder" else 2 * MOULD
    return Packing(Vector(*map(jnp.asarray, centres)), spheres, height, mould)


def known() -> list[tuple[str, int]]:
    """Tests and laws of which LIGGGHTS' numbers are there."""
    firsts = {test: next(iter(asked.numbers)) for test, asked in TESTS.items()}
    return [(test, law) for test in TESTS for law in LAWS if f"{firsts[test]}_{law}" in data()]


def beds_of(test: str, law: int) -> range:
    """Numbers of the beds of a test."""
    return range(1, len(data()[f"{next(iter(TESTS[test].numbers))}_{law}"]) + 1)


def simulated(test: str, law: int, bed: int, step: float, folder: Path) -> dict[str, float]:
    """The numbers of one run, kept; `step` is its time step over the usual one."""
    path = reporting.kept("reference_beds", folder) / f"{test}_{law}_{bed}_{step:g}.json"
    kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if not kept.keys() >= TESTS[test].numbers.keys():
        kept = _run(test, law, bed, step)
        write_json(path, kept)
    return kept


def _run(test: str, law: int, bed: int, step: float) -> dict[str, float]:
    asked = TESTS[test]
    made, soil, lab = packing(asked.beds, bed), LAWS[law], _lab(test)
    if asked.rough is not None:
        soil = replace(soil, platen_friction=jnp.asarray(asked.rough))
    if asked.adhesion is not None and law == ADHESIVE:
        soil = replace(soil, surface_energy=jnp.asarray(asked.adhesion))
    step *= asked.longer if law == 1 else 1.0
    time_step, said = step * lab.time_step(made, soil), ""
    for _ in range(TRIES):
        found: Outcome = _program()(lab, made, soil, time_step)
        if not bool(found.failed):
            return {name: read(found, made) for name, (*_, read) in asked.numbers.items()}
        said, lab = found.record.explain_overflow(lab.grid), lab.roomier(SPECIMEN)
    raise RuntimeError(f"{test}, bed {bed}: {said}")


@cache
def _lab(test: str) -> VirtualLab:
    tests = TestSequence((TESTS[test].apparatus,))
    return VirtualLab.of(SPECIMEN, tests, Numerics(sample_time=4e-4, pairs_per_sphere=5.0))


@cache
def _program() -> Callable:
    return eqx.filter_jit(VirtualLab.run)


@dataclass(frozen=True)
class Row:
    """One number of a test and law: its name, what it is with its unit, by bed of LIGGGHTS and of
    this code, and of bed 1 with a smaller time step."""

    name: str
    what: str
    law: int
    theirs: np.ndarray
    ours: np.ndarray
    smaller: float

    def cells(self) -> list[str]:
        """What the page says of it."""
        ratio = self.ours.mean() / self.theirs.mean()
        apart = self.ours - self.theirs
        error = apart.std(ddof=1) / len(apart) ** 0.5 / self.theirs.mean()
        each = ", ".join(f"{a:.3g}/{b:.3g}" for a, b in zip(self.ours, self.theirs, strict=True))
        return [
            self.name, str(self.law), self.what, _mean(self.theirs), _mean(self.ours),
            f"{ratio:.3f} ± {error:.3f}", each,
            f"{100 * abs(self.smaller / self.ours[0] - 1):.0f} %",
        ]  # fmt: skip


def rows_of(test: str, law: int) -> list[Row]:
    """Those of one test under one law; its beds are simulated."""
    runs = [simulated(test, law, bed, 1.0, reporting.CACHE) for bed in beds_of(test, law)]
    smaller = simulated(test, law, 1, SMALLER, reporting.CACHE)
    return [
        Row(
            name, f"{what} ({unit})", law, data()[f"{name}_{law}"],
            np.array([run[name] for run in runs]), smaller[name],
        )
        for name, (what, unit, _) in TESTS[test].numbers.items()
    ]  # fmt: skip


def _mean(values: np.ndarray) -> str:
    return f"{values.mean():.4g} ± {values.std(ddof=1) / len(values) ** 0.5:.2g}"


def cells_before() -> dict[tuple[str, str], list[str]]:
    """Rows of the page as it is, by name and law."""
    path = reporting.RESULTS / "reference_beds.md"
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    table = text.partition(TITLE)[2].partition("\n# ")[0]
    rows = [line[2:-2].split(" | ") for line in table.splitlines() if line.startswith("| ")]
    return {(row[0], row[1]): row for row in rows[2:]}


def markdown(cells: list[list[str]], origin: dict) -> str:
    header = ("name", "law", "number", "LIGGGHTS, mean over beds", "this code", "ratio",
              "bed by bed, this code/LIGGGHTS", "a step 20 % smaller changes bed 1 by")  # fmt: skip
    return (
        f"{TITLE}\n\n"
        "Law 1: Hertz-Mindlin without adhesion, six beds; law 2: EEPA in the conventions of "
        "LIGGGHTS, three beds, of shear boxes two. Means stand with their standard errors over "
        "beds; the ratio's is of the differences bed by bed. Peak shear stresses are means over "
        "0.36 mm of travel, in both codes.\n\n"
        + reporting.table(header, cells)
        + reporting.footer(origin)
    )


def main() -> None:
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
    parser.add_argument("--tests", nargs="+", choices=tuple(TESTS), default=list(TESTS))
    parser.add_argument("--laws", nargs="+", type=int, choices=tuple(LAWS), default=list(LAWS))
    chosen = parser.parse_args()
    reporting.configure()
    order = [(name, str(law)) for test, law in known() for name in TESTS[test].numbers]
    cells = cells_before()
    for test, law in known():
        if test in chosen.tests and law in chosen.laws:
            cells.update({(row.name, str(law)): row.cells() for row in rows_of(test, law)})
            there = [cells[key] for key in order if key in cells]
            reporting.write_section("reference_beds", markdown(there, reporting.provenance()))


if __name__ == "__main__":
    main()
