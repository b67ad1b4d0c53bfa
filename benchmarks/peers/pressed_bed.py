"""A settled bed pressed in its mould by LIGGGHTS, with an exported soil.

Positions and sizes of the spheres are the caller's; contacts start without history, the platen
comes down at a constant rate from the top of the bed until it has done its stroke.  LIGGGHTS is
found on the search path and run in a folder of the caller's.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from support.two_spheres import run_program

PLATE = Path(__file__).parent / "plate.stl"
ROWS = 1200  # readings on the way down

_SCRIPT = """\
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
read_data bed.data
neighbor {skin:.6g} bin
neigh_modify delay 0
include soil.liggghts
timestep {step:.10g}
fix gr all gravity 9.81 vector 0 0 -1
fix base all wall/gran model {model} primitive type 3 zplane 0.0
fix mould all wall/gran model {model} primitive type 2 zcylinder {mould:.10g} 0. 0.
fix plate all mesh/surface/stress file plate.stl type 3 move 0. 0. {top:.10g}
fix platen all wall/gran model {model} mesh n_meshes 1 meshes plate
fix down all move/mesh mesh plate linear 0. 0. -{rate:.10g}
fix motion all nve/sphere
variable travel equal step*dt*{rate:.10g}
variable force equal f_plate[3]
fix out all print {every} "${{travel}} ${{force}}" file rows.txt screen no
thermo 100000
run {steps}
"""


@dataclass(frozen=True, eq=False)
class Spheres:
    """Centres (N, 3) and radii (N,) in m, and their density, kg/m3."""

    centres: np.ndarray
    radius: np.ndarray
    density: float

    @property
    def top(self) -> float:
        """Height (m) of the highest point."""
        return float((self.centres[:, 2] + self.radius).max())


@dataclass(frozen=True)
class Press:
    """Radius of the mould (m), rate (m/s) and stroke (m) of the platen, time step (s)."""

    mould: float
    rate: float
    stroke: float
    step: float


def pressed(section: str, model: str, spheres: Spheres, press: Press, folder: Path):
    """Travel of the platen from the top of the bed (m) and force on it (N); `section` is an
    exported soil and `model` its contact models."""
    folder.mkdir(parents=True, exist_ok=True)
    steps = int(press.stroke / press.rate / press.step)
    script = _SCRIPT.format(
        skin=0.2 * spheres.radius.mean(),
        step=press.step,
        model=model,
        mould=press.mould,
        top=spheres.top,
        rate=press.rate,
        every=max(1, steps // ROWS),
        steps=steps,
    )
    (folder / "soil.liggghts").write_text(section, encoding="utf-8")
    (folder / "bed.data").write_text(_data(spheres, press.mould), encoding="utf-8")
    (folder / "in.bed").write_text(script, encoding="utf-8")
    shutil.copy(PLATE, folder)
    run_program(["liggghts", "-in", "in.bed", "-log", "log.bed"], folder)
    rows = np.loadtxt(folder / "rows.txt", comments="#")
    return rows[:, 0], rows[:, 1]


def _data(spheres: Spheres, mould: float) -> str:
    """The bed as LIGGGHTS reads it; three types, all spheres of the first."""
    side, height = 1.3 * mould, 1.3 * spheres.top
    lines = [
        "bed",
        "",
        f"{len(spheres.radius)} atoms",
        "3 atom types",
        f"{-side} {side} xlo xhi",
        f"{-side} {side} ylo yhi",
        f"{-0.1 * height} {height} zlo zhi",
        "",
        "Atoms",
        "",
    ]
    rows = zip(spheres.radius, spheres.centres, strict=True)
    lines += [
        f"{number} 1 {2 * radius:.12g} {spheres.density:.12g} {x:.12g} {y:.12g} {z:.12g}"
        for number, (radius, (x, y, z)) in enumerate(rows, start=1)
    ]
    return "\n".join(lines) + "\n"
