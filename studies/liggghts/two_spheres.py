"""Two spheres in LIGGGHTS and in YADE, driven through a path with an exported soil.

Quasi-static: spheres are moved, not accelerated, so slowly that dashpots do not matter.  The
programs are found on the search path (Debian packages `liggghts` and `yade`) and are run in a
folder of the caller's; nothing of them is part of this project.
"""

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

POINTS = 160  # of each leg
SPEED = 1e-7  # m/s
DENSITY = 2650.0  # kg/m3
APART = 1e-9  # m; gap at the start
SLOW = 1e4  # s; how long a turn by one step's angle takes

_LIGGGHTS = """\
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region box block -{box} {box} -{box} {box} -{box} {box} units box
create_box 3 box
neighbor {skin} bin
neigh_modify delay 0
include soil.liggghts
create_atoms 1 single -{place:.12g} 0 0 units box
create_atoms 1 single {place:.12g} 0 0 units box
set group all density {density} diameter {diameter}
group left id 1
group right id 2
fix none all gravity 0 vector 0 0 -1
compute torque all property/atom tqz
variable gap equal x[2]-x[1]
variable side equal y[2]
variable push equal fx[2]
variable drag equal fy[2]
variable turn equal c_torque[2]
thermo_style custom step atoms
thermo 1000000
"""
_PRINT = 'fix out all print 1 "${gap} ${side} ${push} ${drag} ${turn}" file rows.txt screen no\n'
_LEG = """\
fix hold left freeze
timestep {step:.12g}
fix go right move {how}
run {count}
unfix go
unfix hold
"""


def has(program: str) -> bool:
    """Whether the program is installed."""
    return shutil.which(program) is not None


def liggghts_loop(section: str, radius: float, turning_points: list[float], folder: Path):
    """Overlaps (m) and normal forces (N, repulsion positive) along the path of overlaps."""
    legs = "".join(_legs(turning_points))
    rows = _liggghts(section, radius, legs, folder)
    return 2 * radius - rows[:, 0], rows[:, 2]


def liggghts_slip(section: str, radius: float, overlap: float, angle: float, folder: Path):
    """Slips (m) and tractions (N) while one sphere is carried around the other like a rigid
    body, by an angle (rad) at a fixed distance."""
    legs = "".join(_legs([overlap])) + _turn(-(radius + APART / 2), angle)
    rows = _liggghts(section, radius, legs, folder)[POINTS:]
    turned = angle * np.arange(1, POINTS + 1) / POINTS
    traction = rows[:, 2] * np.sin(turned) - rows[:, 3] * np.cos(turned)
    return turned * (radius - overlap / 2), traction


def liggghts_roll(section: str, radius: float, overlap: float, angle: float, folder: Path):
    """Torques (N m) on one sphere while it is turned about an axis across the contact."""
    legs = "".join(_legs([overlap])) + _turn(radius - overlap - APART / 2, angle)
    rows = _liggghts(section, radius, legs, folder)[POINTS:]
    return np.abs(rows[:, 4])


def liggghts_rebound(section: str, radius: float, speed: float, step: float, folder: Path) -> float:
    """Rebound over approach speed of two free spheres that meet head on, each at `speed`."""
    free = (
        f"timestep {step}\nvelocity left set {speed} 0 0 units box\n"
        f"velocity right set -{speed} 0 0 units box\nvariable rate equal vx[2]\n"
        'fix out2 all print 1 "${rate} 0 0 0 0" file rates.txt screen no\n'
        "fix move all nve/sphere\nrun 20000\n"
    )
    _liggghts(section, radius, free, folder)
    rates = np.loadtxt(folder / "rates.txt", comments="#")[:, 0]
    return float(rates[-1] / speed)


def yade_loop(material: str, radii: tuple[float, float], turning_points: list[float], folder: Path):
    """Overlaps (m) and normal forces (N) of YADE's law between spheres of two radii (m), each of
    its own `soil_of`, along the path of overlaps."""
    (folder / "soil_yade.py").write_text(material, encoding="utf-8")
    drive = _YADE.format(
        radii=radii, points=POINTS, speed=SPEED, path=list(turning_points), apart=APART
    )
    (folder / "pair.py").write_text(drive, encoding="utf-8")
    run_program(["yade", "-x", "-n", "pair.py"], folder)
    rows = np.loadtxt(folder / "rows.txt")
    return rows[:, 0], rows[:, 1]


_YADE = """\
import os
exec(open("soil_yade.py").read())
radii = {radii}
for radius, label in zip(radii, ("left", "right")):
    O.materials.append(soil_of(radius, label))
left = O.bodies.append(sphere((0, 0, 0), radii[0], material="left", fixed=True))
place = (sum(radii) + {apart}, 0, 0)
right = O.bodies.append(sphere(place, radii[1], material="right", fixed=True))
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb()], verletDist=radii[0] / 10),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom()],
        [Ip2_LudingMat_LudingMat_LudingPhys()],
        [Law2_ScGeom_LudingPhys_Basic()],
    ),
    NewtonIntegrator(damping=0),
]
rows, overlap = [], 0.0
for target in {path}:
    leg = target - overlap
    O.bodies[right].state.vel = (-{speed} if leg > 0 else {speed}, 0, 0)
    O.dt = abs(leg) / {speed} / {points}
    for _ in range({points}):
        here = sum(radii) - O.bodies[right].state.pos[0]  # forces come first in a step
        O.step()
        rows.append((here, O.forces.f(right)[0]))
    overlap = target
with open("rows.txt", "w") as file:
    file.writelines("%.12g %.12g\\n" % row for row in rows)
os._exit(0)
"""


def _liggghts(section: str, radius: float, legs: str, folder: Path) -> np.ndarray:
    """Rows of distance, sideways position, push, drag and torque, one a step."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "soil.liggghts").write_text(section, encoding="utf-8")
    head = _LIGGGHTS.format(
        box=8 * radius,
        skin=radius / 2,
        place=radius + APART / 2,
        density=DENSITY,
        diameter=2 * radius,
    )
    (folder / "in.pair").write_text(head + "run 0\n" + _PRINT + legs, encoding="utf-8")
    run_program(["liggghts", "-in", "in.pair", "-log", "log.pair"], folder)
    return np.loadtxt(folder / "rows.txt", comments="#")


def _legs(turning_points: list[float]) -> list[str]:
    """One approach or retreat for each turning point of the overlap, from the gap on."""
    corners = [-APART, *turning_points]
    changes = np.diff(corners)
    return [_leg(change, "linear {speed:.12g} 0 0 units box", -1) for change in changes]


def _leg(change: float, how: str, sign: int = 1) -> str:
    speed = sign * np.sign(change) * SPEED
    step = abs(change) / SPEED / POINTS
    return _LEG.format(step=step, how=how.format(speed=speed), count=POINTS)


def _turn(place: float, angle: float) -> str:
    """A slow turn of the right sphere about the z axis through x = `place`."""
    period = 2 * np.pi * POINTS * SLOW
    how = f"rotate {place:.12g} 0 0 0 0 1 {period:.12g} units box"
    return _LEG.format(step=SLOW * angle, how=how, count=POINTS)


def run_program(command: list[str], folder: Path) -> None:
    """Runs a program in the folder; RuntimeError with its last words if it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=3600)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]} failed: {(done.stdout + done.stderr)[-600:]}")


_ON_WALL = """\
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region box block -{box} {box} -{box} {box} -{box} {box} units box
create_box 3 box
neighbor {skin:.6g} bin
neigh_modify delay 0
include soil.liggghts
create_atoms 1 single 0 0 {height:.12g} units box
set group all density {density} diameter {diameter:.12g}
fix gr all gravity 9.81 vector 0 0 -1
fix base all wall/gran model {model} primitive type 3 zplane 0.0
fix motion all nve/sphere
velocity all set {speed:.6g} 0 0 units box
variable place equal x[1]
variable rate equal vx[1]
timestep {step:.12g}
thermo 1000000
fix out all print {every} "${{place}} ${{rate}}" file wall.txt screen no
run {steps}
"""


def liggghts_on_wall(section: str, model: str, sphere: "Rolling", folder: Path) -> np.ndarray:
    """Place (m) and speed (m/s) of a sphere that slides and rolls on the base, (rows, 2)."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "soil.liggghts").write_text(section, encoding="utf-8")
    script = _ON_WALL.format(
        box=max(40 * sphere.radius, 2 * sphere.speed * sphere.step * sphere.steps),
        skin=sphere.radius / 2,
        height=sphere.radius,
        density=DENSITY,
        diameter=2 * sphere.radius,
        model=model,
        speed=sphere.speed,
        step=sphere.step,
        steps=sphere.steps,
        every=sphere.every,
    )
    (folder / "in.wall").write_text(script, encoding="utf-8")
    run_program(["liggghts", "-in", "in.wall", "-log", "log.wall"], folder)
    return np.loadtxt(folder / "wall.txt", comments="#", ndmin=2)


@dataclass(frozen=True)
class Rolling:
    """A sphere sent along the base: radius (m), speed at the start (m/s), time step (s), steps,
    and steps between readings."""

    radius: float
    speed: float
    step: float
    steps: int
    every: int
