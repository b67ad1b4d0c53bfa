"""Both tests of a lab by LIGGGHTS on a bed of ours: pressed in the mould, freed, crushed.

Positions and sizes of the spheres are the caller's, the soil is an exported section.  The platen
presses at a constant rate to a force and returns to none; the mould opens by a millimetre in steps
of 20 micrometres and is taken away; the specimen rests under viscous damping and is crushed.  So
does `calibrate simulate`, but for its servo and its own damping.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from studies.liggghts.two_spheres import run_program

PLATE = (Path(__file__).parent / "inputs" / "plate.stl").read_text(encoding="utf-8")
HALF_SIDE = ("0.045", "0.028")  # m; of that plate and of the one here
ROWS = 1500  # readings of a test, at least
RESTING = 400.0  # 1/s; viscous damping of a sphere over its mass while the specimen is freed
FELL = 0.9  # of the height before, below which a specimen has fallen apart

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
fix motion all nve/sphere
compute radius all property/atom radius
variable topmost atom z+c_radius
compute top all reduce max v_topmost
variable top equal c_top
fix plate all mesh/surface/stress file plate.stl type 3 move 0. 0. {top:.10g}
fix platen all wall/gran model {model} mesh n_meshes 1 meshes plate
variable force equal f_plate[3]
thermo_style custom step ke v_force c_top
thermo_modify lost ignore
thermo 20000
variable began equal 0
variable travel equal {press:.10g}*(step-${{began}})*dt
fix down all move/mesh mesh plate linear 0. 0. -{press:.10g}
fix out all print {every} "${{travel}} ${{force}}" file loading.txt screen no
run 0
label pressing
run {chunk} post no
variable deep equal ${{travel}}
variable now equal ${{force}}
if "${{deep}} > {deepest:.6g}" then "print 'RESULT stands 0'" quit
if "${{now}} < {target:.8g}" then "jump SELF pressing"
unfix out
unfix down
variable here equal step
variable there equal ${{here}}
variable back equal ${{deep}}-{press:.10g}*(step-${{there}})*dt
fix down all move/mesh mesh plate linear 0. 0. {press:.10g}
fix out all print {every} "${{back}} ${{force}}" file unloading.txt screen no
label returning
run {chunk} post no
variable now equal ${{force}}
if "${{now}} > 0.05" then "jump SELF returning"
run {lift}
unfix out
unfix down
fix damped all viscous {viscous:.6g}
variable i loop 50
label opening
variable wide equal {mould:.10g}+$i*2e-5
unfix mould
fix mould all wall/gran model {model} primitive type 2 zcylinder ${{wide}} 0. 0.
run {opening} post no
next i
jump SELF opening
unfix mould
run {rest}
unfix damped
variable high equal ${{top}}
variable least equal {fell}*({top:.10g}-${{deep}})
variable lowest equal ${{least}}
if "${{high}} < ${{lowest}}" then "print 'RESULT stands 0'" quit
unfix platen
unfix plate
fix plate all mesh/surface/stress file plate.stl type 3 move 0. 0. ${{high}}
fix platen all wall/gran model {model} mesh n_meshes 1 meshes plate
variable s0 equal step
variable first equal ${{s0}}
variable way equal {crush:.10g}*(step-${{first}})*dt
fix down all move/mesh mesh plate linear 0. 0. -{crush:.10g}
fix out all print {sparse} "${{way}} ${{force}}" file crushing.txt screen no
run {steps}
print "RESULT stands 1"
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
class Tests:
    """Radius of the mould (m), platen's rates (m/s) in it and on the free specimen, force at which
    it turns (N), its way on the free specimen (m), time step (s)."""

    mould: float
    press: float
    crush: float
    target: float
    stroke: float
    step: float


@dataclass(frozen=True, eq=False)
class Curves:
    """Travel (m) and force (N) of loading and of crushing, (points, 2); the latter empty where the
    specimen fell apart."""

    loading: np.ndarray
    crushing: np.ndarray


def tested(section: str, model: str, spheres: Spheres, tests: Tests, folder: Path) -> Curves:
    """Both tests of one specimen; `section` is an exported soil and `model` its contact models."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    mass = spheres.density * 4 / 3 * np.pi * np.mean(spheres.radius**3)
    steps, usual = int(tests.stroke / tests.crush / tests.step), 3e-3 / tests.press / tests.step
    script = _SCRIPT.format(
        skin=0.2 * spheres.radius.mean(),
        model=model,
        top=spheres.top,
        deepest=0.3 * spheres.top,
        every=max(1, int(usual / ROWS)),
        sparse=max(1, steps // ROWS),
        chunk=max(1, int(2e-5 / tests.press / tests.step)),
        lift=int(2e-4 / tests.press / tests.step),
        viscous=RESTING * mass,
        opening=int(1e-3 / tests.step),
        rest=int(0.05 / tests.step),
        fell=FELL,
        steps=steps,
        **{name: getattr(tests, name) for name in ("mould", "press", "crush", "target", "step")},
    )
    (folder / "soil.liggghts").write_text(section, encoding="utf-8")
    (folder / "bed.data").write_text(_data(spheres, tests.mould), encoding="utf-8")
    (folder / "in.tests").write_text(script, encoding="utf-8")
    (folder / "plate.stl").write_text(PLATE.replace(*HALF_SIDE), encoding="utf-8")
    run_program(["liggghts", "-in", "in.tests", "-log", "log.tests"], folder)
    stands = "RESULT stands 1" in (folder / "log.tests").read_text()
    crushing = _rows(folder / "crushing.txt") if stands else np.empty((0, 2))
    return Curves(_rows(folder / "loading.txt"), crushing)


def _rows(path: Path) -> np.ndarray:
    return np.loadtxt(path, comments="#", ndmin=2)


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
