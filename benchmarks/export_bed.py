"""Exported soils in LIGGGHTS: a whole bed in confined compression, ours and theirs.

    python benchmarks/export_bed.py [--packings N] [--folder FOLDER]

The same settled beds of the quick preset are pressed at the same rate by both programs, from the
same positions.  In the first soil only normal contacts act, where the laws agree, but such a bed
flows; then friction and rolling come in, where they do not quite.  Needs the Debian package
`liggghts`; some minutes on an idle core.  Writes benchmarks/results/export_bed.json and .md, and
docs/images/export_bed.png.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import equinox as eqx
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import reporting

from calibrate.export import liggghts
from calibrate.export.source import Found, find
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.io.soil import with_values
from calibrate.labtests.confined import ConfinedTest
from calibrate.simulation.resolution import PRESETS, specimen, virtual_lab
from jdem.apparatus.unconfined import UnconfinedCompression
from jdem.laboratory.virtual_lab import TestSequence, VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare
from jdem.packing.specimen import Packing, Specimen

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parent / "peers"))
import pressed_bed

PRESSED = ConfinedTest.type_name
IMAGE = Path(__file__).parents[1] / "docs" / "images" / "export_bed.png"
LEVELS = (50.0, 200.0, 400.0)  # N; displacements are compared at these
WHAT = (*(f"{level:.0f} N" for level in LEVELS), "H")
SEATING = 2.0  # N; displacement counts from here
SMOOTH = {
    "static_friction": 0.0,
    "wall_friction": 0.0,
    "platen_friction": 0.0,
    "rolling_friction": 0.0,
}
CASES: dict[str, dict[str, float]] = {
    "no friction, no rolling": SMOOTH,
    "no rolling, tensile exponent 1": {"tensile_exponent": 1.0, "rolling_friction": 0.0},
    "tensile exponent 1": {"tensile_exponent": 1.0},
    "bundled start": {},
}


def main() -> None:
    reporting.configure()
    arguments = _arguments()
    folder = arguments.folder or Path(tempfile.mkdtemp())
    cylinder = specimen(load_lab(bundled_lab()), PRESETS["quick"])
    packings = [prepare(cylinder, seed) for seed in range(arguments.packings)]
    lab = _only_pressing(cylinder)
    run = eqx.filter_jit(VirtualLab.run)
    curves = {
        name: [_both(lab, run, packing, changes, folder / f"{number}") for packing in packings]
        for number, (name, changes) in enumerate(CASES.items())
    }
    rows = {name: [_levels(*pair) for pair in pairs] for name, pairs in curves.items()}
    measured = {"levels_n": LEVELS, "seating_n": SEATING, "packings": len(packings), "rows": rows}
    _figure(curves)
    origin = reporting.provenance()
    reporting.write("export_bed", {**origin, **measured}, _markdown(rows, origin))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packings", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where LIGGGHTS works")
    return parser.parse_args()


def _only_pressing(cylinder: Specimen) -> VirtualLab:
    """The pressing of the preset; crushing is cut to almost nothing."""
    lab = virtual_lab(load_lab(bundled_lab()), PRESETS["quick"])
    short = UnconfinedCompression(stroke=1e-4, rest=1e-3, opening=1e-4)
    return VirtualLab.of(cylinder, TestSequence((lab.tests[PRESSED], short)), lab.numerics)


def _both(lab: VirtualLab, run, packing: Packing, changes: dict[str, float], folder: Path):
    """Loading curves of both programs: displacement from SEATING on (m), force (N)."""
    found = find(bundled_lab(), changes, float(packing.mean_diameter()))
    soil = _soil(found)
    outcome = run(lab, packing, soil)
    curve = outcome.curves[PRESSED]
    valid = np.asarray(curve.valid) > 0
    ours = [np.asarray(part)[valid] for part in (curve.displacement, curve.force)]
    press = pressed_bed.Press(
        mould=float(packing.mould_radius),
        rate=float(lab.tests[PRESSED].simulated_rate),
        stroke=float(ours[0].max() - ours[0].min()) * 1.3 + 2e-3,
        step=0.5 * float(lab.time_step(packing, soil)),
    )
    section, model = liggghts.text(found), liggghts.model(found)
    theirs = pressed_bed.pressed(section, model, _spheres(packing), press, folder)
    return _from_seating(*ours), _from_seating(*theirs)


def _soil(found: Found) -> SoilParameters:
    names = SoilParameters.__dataclass_fields__
    return with_values(SoilParameters(), {n: found[n] for n in names if n in found.values})


def _spheres(packing: Packing) -> pressed_bed.Spheres:
    radius, mass = np.asarray(packing.spheres.radius), np.asarray(packing.spheres.mass)
    density = float(mass.sum() / (4 / 3 * np.pi * radius**3).sum())
    return pressed_bed.Spheres(np.asarray(packing.position.stack()), radius, density)


def _from_seating(travel: np.ndarray, force: np.ndarray):
    """The loading part, displacement counted from the seating force."""
    end = int(np.argmax(force >= LEVELS[-1])) if force.max() >= LEVELS[-1] else len(force) - 1
    travel, force = travel[: end + 1], force[: end + 1]
    return travel - _at(travel, force, SEATING), force


def _at(travel: np.ndarray, force: np.ndarray, level: float) -> float:
    """Displacement (m) at which the running maximum of the force reaches a level (N)."""
    highest = np.maximum.accumulate(force)
    after = int(np.argmax(highest >= level))
    before = max(after - 1, 0)
    rise = highest[after] - highest[before]
    share = (level - highest[before]) / rise if rise > 0 else 1.0
    return float(travel[before] + share * (travel[after] - travel[before]))


def _levels(ours, theirs) -> dict[str, list[float]]:
    """Displacement (mm) of both at each level."""
    return {
        "ours_mm": [1e3 * _at(*ours, level) for level in LEVELS],
        "theirs_mm": [1e3 * _at(*theirs, level) for level in LEVELS],
    }


def _figure(curves) -> None:
    figure, axes = plt.subplots(
        1, len(curves), figsize=(3.4 * len(curves), 3.6), layout="constrained", sharey=True
    )
    for axis, (name, pairs) in zip(axes, curves.items(), strict=True):
        for number, (ours, theirs) in enumerate(pairs):
            labels = ("ours", "LIGGGHTS") if number == 0 else (None, None)
            axis.plot(1e3 * ours[0], ours[1], color="0.7", lw=3, label=labels[0])
            axis.plot(1e3 * theirs[0], theirs[1], color="#20344f", lw=1.1, ls="--", label=labels[1])
        axis.set(xlabel="displacement (mm)", title=name)
        axis.title.set_size(9)
    axes[0].set(ylabel="force on the platen (N)")
    axes[0].legend(frameon=False, fontsize=8)
    figure.savefig(IMAGE, dpi=130)
    plt.close(figure)


def _markdown(rows: dict[str, list[dict]], origin: dict) -> str:
    text = "# A bed in confined compression with exported soils, ours and LIGGGHTS\n\n"
    text += "The same beds (quick preset), the same rate; displacement (mm) from "
    text += f"{SEATING:.0f} N to each force, and H between the last two.\n\n"
    head = ["soil", "packing"]
    head += [f"{what}, {who}" for what in WHAT for who in ("ours", "LIGGGHTS")]
    lines = [
        [name, str(number), *(f"{x:.3f}" for pair in _pairs(row) for x in pair)]
        for name, found in rows.items()
        for number, row in enumerate(found)
    ]
    return text + reporting.table(head, lines) + reporting.footer(origin)


def _pairs(row: dict[str, list[float]]):
    """Ours and theirs, at each level, then between the last two."""
    both = [[*row[who], row[who][-1] - row[who][-2]] for who in ("ours_mm", "theirs_mm")]
    return zip(*both, strict=True)


if __name__ == "__main__":
    main()
