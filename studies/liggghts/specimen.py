"""One specimen: poured, settled, compressed in the mould, unloaded, freed and crushed by LIGGGHTS.

`run` writes the input beside copies of inputs/in.settle and in.tests into a scratch folder,
runs both in one process each, and returns the raw curves.  A specimen that falls apart, or one
that never reaches the target force, comes back as a `Run` that does not stand.
"""

import math
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from studies.liggghts.instrument import (
    CONFINED_SPEED,
    TARGET_FORCE,
    Instrument,
    smoothing_per_round,
)
from studies.liggghts.physics import (
    LAYERS,
    Physics,
    between,
    filling_materials,
    laws,
    machine,
    materials,
    trapped_air_force,
)
from studies.liggghts.referee import bond_commands, bonded_start, crush_commands
from studies.liggghts.soil import MEAN_DIAMETER, SIZE, SPHERES, Soil

HERE = Path(__file__).parent
MOULD_RADIUS = 0.025  # m
SPREAD = 0.15  # of the radii, uniform on both sides
DENSITY = 1830.0  # kg/m3, of the spheres
TIME_STEP, FILLING_STEP = 8e-6 * SIZE, 2e-5 * SIZE  # s
# Stages that last a given time, in steps of 8e-6 s of the tests and of 2e-5 s of filling.
STAGES = {"begin": 2000, "end": 750, "opening": 80, "free": 4000, "stand": 2500, "round": 200}
FILLING_STAGES = {"fall": 16000, "sink": 8000, "lift": 2000, "calm": 3000}
DRAG = {"slow": 0.05, "slower": 0.2}  # N s/m, of spheres of 8 mm; goes with their mass
FILLING_DRAG = {"slow": 5e-3, "slower": 0.05}
BOND_GAP = 1e-4 * SIZE  # m; spheres nearer than this are bonded
BOND_STIFFNESS = 2e4 * SIZE  # N/m, about half that of a contact
LOADING, UNLOADING, CRUSHING = 0.1, 0.08, 0.08  # m/s, simulated platen speeds
STRAIN = 0.12  # end of the second test
CHUNK, EVERY = 60, 15  # time steps between looks at the machine, and between saved forces
DEEPEST = 0.02  # m; a specimen that has not reached the target force by then is given up
LEVELLING_FORCE = 10.0  # N, of the platen that levels the settled bed
FILLING_FRICTION = 0.3  # of the spheres while they settle, on average
DEPTH_FORCES = (0.5 * TARGET_FORCE, 0.99 * TARGET_FORCE)  # N, between which a depth is taken


@dataclass(frozen=True)
class Run:
    """Raw outcome of one specimen; arrays are (points,), m and N.

    height m of the soil in the mould before the test, mass kg; `stands` is False when the
    specimen fell apart, and the curves are then empty.
    """

    stands: bool
    height: float
    mass: float
    confined: np.ndarray  # (points, 2)
    unconfined: np.ndarray  # (points, 2)
    facts: dict[str, float]

    def depth_mm(self) -> float:
        """Displacement between half the target force and the target, first passages, mm."""
        way, force = self.confined[: self.confined[:, 0].argmax() + 1].T
        low, high = np.interp(DEPTH_FORCES, np.maximum.accumulate(force), way)
        return 1e3 * float(high - low)

    def crushing_n(self) -> float:
        """Largest force of the second test, smoothed over 81 savings, N."""
        return float(np.convolve(self.unconfined[:, 1], np.full(81, 1 / 81), "valid").max())


def run(soil: Soil, physics: Physics, instrument: Instrument, seed: int, folder: Path) -> Run:
    """Both tests on the specimen that `seed` makes; `folder` is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    random = np.random.default_rng(seed)
    soil, filling, spheres = specimen_of(soil, physics, random)
    radii = _column(folder / "column.data", spheres, random)
    for name in ("in.settle", "in.tests", "plate.stl"):
        shutil.copy(HERE / "inputs" / name, folder)
    values = {"level": LEVELLING_FORCE, "dt": FILLING_STEP}
    settings = _variables(values, FILLING_STAGES, FILLING_DRAG)
    (folder / "filling.in").write_text(settings + filling_materials(filling))
    _liggghts(folder, "in.settle")
    height = _heights(folder / "bed.data")[1]
    _write_input(folder, soil, physics, instrument, height, seed)
    _liggghts(folder, "in.tests")
    return _outcome(folder, physics, float(np.sum(4 / 3 * np.pi * radii**3) * DENSITY))


def specimen_of(
    soil: Soil, physics: Physics, random: np.random.Generator
) -> tuple[Soil, float, int]:
    """What differs between repeats: moisture (3 % in stiffness and adhesion), filling, mass."""
    wet = np.exp(0.03 * random.standard_normal(2))
    filling = FILLING_FRICTION * float(np.exp(physics.fill_scatter * random.standard_normal()))
    spheres = round(SPHERES * (1 + physics.mass_scatter * random.standard_normal()))
    moist = replace(
        soil,
        shear_modulus=soil.shear_modulus * float(wet[0]),
        surface_energy=soil.surface_energy * float(wet[1]),
    )
    return moist, min(max(filling, 0.02), 1.5), spheres


def _variables(values: dict, stages: dict[str, int], drag: dict[str, float]) -> str:
    """Numbers of an input script: as they are, stages of the same time, drag by mass."""
    every = {
        **{name: f"{value:.8g}" for name, value in values.items()},
        **{name: str(round(steps / SIZE)) for name, steps in stages.items()},
        **{name: f"{force * SIZE**3:.8g}" for name, force in drag.items()},
    }
    return "".join(f"variable {name} index {value}\n" for name, value in every.items())


def _column(path: Path, spheres: int, random: np.random.Generator) -> np.ndarray:
    """A loose column of spheres as a LIGGGHTS data file; returns all radii."""
    radii = MEAN_DIAMETER / 2 * (1 + SPREAD * random.uniform(-1, 1, spheres))
    spacing = MEAN_DIAMETER * (1 + SPREAD) * 1.03
    inside = MOULD_RADIUS - MEAN_DIAMETER / 2 * (1 + SPREAD) * 1.01
    rows, columns = np.mgrid[-8:9, -8:9]
    lattice = np.stack([columns + 0.5 * (rows % 2), rows * math.sqrt(0.75)], -1).reshape(-1, 2)
    places, z = [], spacing / 2
    while len(places) < len(radii):
        turn = random.uniform(0, 2 * np.pi)
        matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        layer = spacing * (lattice + random.uniform(-0.5, 0.5, 2)) @ matrix.T
        layer = layer[np.hypot(*layer.T) < inside]
        random.shuffle(layer)
        places += [(x, y, z) for x, y in layer]
        z += spacing
    top = places[len(radii) - 1][2] + 0.03
    lines = [f"{len(radii)} atoms", "8 atom types", "-0.06 0.06 xlo xhi", "-0.06 0.06 ylo yhi"]
    lines += [f"-0.01 {top:.4f} zlo zhi", "", "Atoms", ""]
    for number, (radius, place) in enumerate(zip(radii, places, strict=False), 1):
        numbers = " ".join(f"{value:.9g}" for value in (2 * radius, DENSITY, *place))
        lines.append(f"{number} 1 {numbers}")
    path.write_text("# loose column\n\n" + "\n".join(lines) + "\n")
    return radii


def _heights(bed: Path) -> tuple[float, float]:
    """Height of the settled bed, m: levelled (97 % lies below), of its highest point."""
    rows = np.loadtxt(bed.read_text().split("Atoms", 1)[1].split("Velocities")[0].splitlines())
    tops = rows[:, 6] + rows[:, 2] / 2
    return float(np.quantile(tops, 0.97)), float(np.max(tops))


def _write_input(
    folder: Path, soil: Soil, physics: Physics, instrument: Instrument, height: float, seed: int
) -> None:
    """The files that in.tests includes."""
    tilt = math.radians(physics.tilt)
    values = {
        "dt": TIME_STEP, "vload": LOADING, "vunl": UNLOADING, "vucs": CRUSHING,
        "strain": STRAIN, "chunk": CHUNK, "every": EVERY, "Ftarget": TARGET_FORCE,
        "deepest": DEEPEST, "tilt": physics.tilt, "lift": MOULD_RADIUS * math.tan(tilt),
    }  # fmt: skip
    style = "hybrid granular molecular" if physics.bond_strength else "granular"
    settings = _variables(values, STAGES, DRAG) + f"atom_style {style}\n"
    (folder / "settings.in").write_text(settings)
    round_time = CHUNK * TIME_STEP * LOADING / CONFINED_SPEED
    share = smoothing_per_round(instrument, round_time)
    reading = machine(physics, instrument.gain, instrument.offset, share, height)
    (folder / "machine.in").write_text(reading)
    (folder / "materials.in").write_text(
        materials(soil, physics) + laws(physics) + "include more.in\n"
    )
    (folder / "between.in").write_text(between(soil, physics))
    _write_referee(folder, physics, seed)


def _liggghts(folder: Path, script: str) -> None:
    """Run one input script; its own failures show as missing results."""
    command = ["liggghts", "-in", script, "-log", f"{script}.log"]
    with open(folder / f"{script}.out", "w") as output:
        subprocess.run(
            command, cwd=folder, stdout=output, stderr=subprocess.STDOUT, timeout=7200, check=False
        )


def _write_referee(folder: Path, physics: Physics, seed: int) -> None:
    """start.data, more.in (layers or bonds) and referee.in."""
    bed, more, calls = (folder / "bed.data").read_text(), "", ""
    if physics.bond_strength:
        bed, more = bonded_start(bed, BOND_GAP, BOND_STIFFNESS)
        rows = [line.split() for line in bed.split("Bonds\n", 1)[1].splitlines() if line]
        lengths = [line.split()[3] for line in more.splitlines()]
        table = "".join(
            f"{n} {i} {j} {rest}\n" for (n, _, i, j), rest in zip(rows, lengths, strict=True)
        )
        (folder / "bonds.txt").write_text(table)
        more = "bond_style harmonic\nspecial_bonds lj/coul 1 1 1\n" + more
        calls = bond_commands(SIZE**2 * physics.bond_strength / BOND_STIFFNESS)
    if physics.gradient:
        more = _layers(_heights(folder / "bed.data")[1])
    if physics.crushing_force:
        calls = crush_commands(SIZE**2 * physics.crushing_force, seed)
    (folder / "start.data").write_text(bed)
    (folder / "more.in").write_text(more + "\n")
    (folder / "referee.in").write_text(calls + "\n")


def _layers(height: float) -> str:
    """Commands that give each slice of the specimen its type."""
    lines, ends = [], np.linspace(0, height, len(LAYERS) + 1)
    for kind, low, high in zip(LAYERS, ends[:-1], ends[1:], strict=True):
        lines.append(f"region slice{kind} block -1 1 -1 1 {low:.6g} {high:.6g} units box")
        lines.append(f"set region slice{kind} type {kind}")
    return "\n".join(lines) + "\n"


def _outcome(folder: Path, physics: Physics, mass: float) -> Run:
    """What the two scripts left behind."""
    facts: dict[str, float] = {}
    for line in (folder / "in.tests.log").read_text(errors="replace").splitlines():
        words = line.split()
        if len(words) == 3 and words[0] == "RESULT":
            facts[words[1]] = float(words[2])
    empty = np.empty((0, 2))
    height = _heights(folder / "bed.data")[0]
    if facts.get("stands") != 1:
        return Run(False, height, mass, empty, empty, facts)
    confined = np.concatenate([_curve(folder / "load.txt"), _curve(folder / "unload.txt")])
    air = trapped_air_force(physics, confined[:, 0], facts["height0"])
    confined[:, 1] += air
    unconfined = _curve(folder / "ucs.txt")
    return Run(True, height, mass, confined, unconfined, facts)


def _curve(path: Path) -> np.ndarray:
    """The saved displacement m and force N, (points, 2)."""
    return np.loadtxt(path, skiprows=1, ndmin=2)[:, :2]
