"""Exported soils in the programs that they are exported for: one contact, ours and theirs.

    python -m studies.liggghts.export_contact [--folder FOLDER]

Needs the Debian packages `liggghts` and `yade`; takes a minute or two.  Writes
studies/results/export_contact.md, docs/images/export.png, and into
tests/data/export_contact the exported texts with the loops that the programs made of them,
to which tests compare where the programs are absent.
"""

import argparse
import gzip
import re
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from calibrate.core.files import write_bytes, write_text
from calibrate.exporters import liggghts, yade
from calibrate.exporters.notes import PRESSURE, overlap_under
from calibrate.exporters.source import Found, find
from calibrate.io.lab import bundled_lab
from calibrate.io.soil import with_values
from jdem.apparatus.pair import SpherePair, collide, drive_overlap
from jdem.core.smooth import Smoothing
from jdem.core.vector import Vector
from jdem.materials.soil import SoilParameters, particle_law
from studies import reporting
from studies.liggghts import two_spheres

DATA = reporting.ROOT / "tests" / "data" / "export_contact"
IMAGE = reporting.IMAGES / "export.png"
PATH = (0.02, 0.004, 0.03, -0.01)  # turning points of the overlap, radii
TWICE = (0.5, -0.01, 1.0, -0.01)  # turning points in YADE, matched overlaps
ONCE = (1.0, -0.01)
HELD = 0.02  # overlap at which slip and roll are measured, radii
TURN = 0.2  # rad; enough to reach the limits of sliding and rolling
SPEED = 0.05  # m/s of each sphere in a collision
REBOUNDS: dict[str, dict[str, float]] = {  # nearly elastic, so that spheres come apart
    "rebound, slope exponent 1": {"surface_energy": 1e-3, "plasticity_ratio": 0.05},
    "rebound, slope exponent 1.5": {
        "surface_energy": 1e-3,
        "plasticity_ratio": 0.05,
        "slope_exponent": 1.5,
    },
    "rebound, slope exponent 1, surface energy 0": {
        "surface_energy": 0.0,
        "plasticity_ratio": 0.05,
    },
}
CASES: dict[str, dict[str, float]] = {
    "linear": {},
    "hertz": {"slope_exponent": 1.5},
    "exponent_1": {"tensile_exponent": 1.0, "surface_energy": 2.0, "static_friction": 0.3},
    "capped": {"plasticity_ratio": 0.358, "surface_energy": 170.0, "pull_off_force": -0.5},
}


def main() -> None:
    reporting.configure()
    folder = _arguments().folder or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    loops = {name: _loop(name, changes, folder) for name, changes in CASES.items()}
    found = soil({})
    radius = found.diameter / 2
    equal = _yade_loop(found, (radius, radius), folder / "yade")
    unequal = _yade_loop(found, (0.7 * radius, 1.3 * radius), folder / "yade")
    alike = _yade_loop(soil(CASES["exponent_1"]), (radius, radius), folder / "yade", ONCE)
    _keep_yade(found, equal)
    measured = {
        "loops": {name: deviations(*loop) for name, loop in loops.items()},
        "liggghts": _liggghts_rows(folder),
        "yade_exponent_1": deviations(*alike),
        "yade": [
            *_yade_rows("equal spheres", *equal),
            *_yade_rows("radii 0.7 and 1.3 of the mean", *unequal),
        ],
    }
    _figure(loops["linear"], equal)
    origin = reporting.provenance()
    reporting.write_page("export_contact", _markdown(measured, origin))


def soil(changes: dict[str, float]) -> Found:
    """The bundled soil's starting values for its spheres at the quick preset."""
    return find(bundled_lab(), changes, None)


def law_of(found: Found):
    """Our sharp law between spheres of the exported diameter."""
    names = SoilParameters.__dataclass_fields__
    values = {name: found[name] for name in names if name in found.values}
    parameters = with_values(SoilParameters(), values)
    return particle_law(parameters, jnp.asarray(found.diameter), Smoothing.sharp())


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="where the programs work")
    return parser.parse_args()


def ours(found: Found, overlap: np.ndarray) -> np.ndarray:
    """Our forces (N) along overlaps (m)."""
    forces = eqx.filter_jit(drive_overlap)(law_of(found), _pair(found), jnp.asarray(overlap))
    return np.asarray(forces)


def _pair(found: Found) -> SpherePair:
    return SpherePair(jnp.asarray(found.diameter / 2), two_spheres.DENSITY)


def _loop(name: str, changes: dict[str, float], folder: Path):
    """Overlaps (m), LIGGGHTS' forces and ours (N); keeps text and loop as test data."""
    found = soil(changes)
    section = liggghts.text(found)
    radius = found.diameter / 2
    path = [share * radius for share in PATH]
    overlap, force = two_spheres.liggghts_loop(section, radius, path, folder / name)
    _keep_section(name, section)
    _keep(f"liggghts_{name}", overlap, force)
    return overlap, force, ours(found, overlap)


def _yade_loop(found: Found, radii: tuple[float, float], folder: Path, turns=TWICE):
    """Overlaps (m), YADE's forces and ours (N) through turning points, in units of the overlap
    at which laws are matched.

    Ours know the effective radius only, which two equal spheres of the harmonic mean have.
    """
    alike = 2 * radii[0] * radii[1] / sum(radii)
    matched = overlap_under(PRESSURE, replace(found, diameter=2 * alike))
    path = [share * matched for share in turns]
    folder.mkdir(parents=True, exist_ok=True)
    overlap, force = two_spheres.yade_loop(yade.text(found), radii, path, folder)
    pair = SpherePair(jnp.asarray(alike), two_spheres.DENSITY)
    ours = eqx.filter_jit(drive_overlap)(law_of(found), pair, jnp.asarray(overlap))
    return overlap, force, np.asarray(ours)


def _keep_yade(found: Found, loop) -> None:
    write_text(DATA / "linear_yade.txt", yade.text(found))
    _keep("yade_linear", *loop[:2])


def _keep_section(name: str, section: str) -> None:
    """Puts an exported text into the file of all, in place of an earlier one of its name."""
    path, mark = DATA / "sections.liggghts", r"^==> (\w+) <==\n"
    parts = re.split(mark, path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    known = dict(zip(parts[1::2], parts[2::2], strict=True)) | {name: section}
    write_text(path, "".join(f"==> {each} <==\n{text}" for each, text in sorted(known.items())))


def _keep(name: str, overlap: np.ndarray, force: np.ndarray) -> None:
    """Puts a loop into the file of all loops, in place of an earlier one of its name."""
    path = DATA / "loops.csv.gz"
    heading, *others = gzip.decompress(path.read_bytes()).decode().rstrip().split("\n")
    rows = [f"{name},{d:.9e},{f:.9e}" for d, f in zip(overlap, force, strict=True)]
    kept = [row for row in others if not row.startswith(f"{name},")]
    text = "\n".join([heading, *sorted([*kept, *rows], key=lambda r: r.split(",")[0])]) + "\n"
    write_bytes(path, gzip.compress(text.encode(), mtime=0))


def deviations(overlap, force, ours) -> list[float]:
    """Largest deviation on each leg over the largest force."""
    legs = np.abs(force - ours).reshape(-1, two_spheres.POINTS).max(axis=1)
    return (legs / np.abs(force).max()).tolist()


def _liggghts_rows(folder: Path) -> list[dict]:
    """What is not the normal loop: slip, roll, rebound."""
    rows = []
    for name in ("linear", "exponent_1"):
        found = soil(CASES[name])
        radius, held = found.diameter / 2, HELD * found.diameter / 2
        section = liggghts.text(found)
        slips, drag = two_spheres.liggghts_slip(section, radius, held, TURN, folder / "slip")
        smooth_section = liggghts.text(soil({**CASES[name], "static_friction": 0.0}))
        torque = two_spheres.liggghts_roll(smooth_section, radius, held, TURN, folder / "roll")
        ours, models = _our_slip(found, held, slips), liggghts.model(found)
        matched = overlap_under(PRESSURE, found) / radius
        rows += [
            _row(f"{name}: tangential stiffness (N/m)", ours[0] / slips[0], drag[0] / slips[0]),
            _row(f"{name}: limit of friction (N)", ours[-1], drag[-1]),
            _row(f"{name}: limit of rolling (N m)", _our_roll(found, held), torque[-1]),
        ]
        print(f"{name}: {models}, laws matched at an overlap of {matched:.3f} R", file=sys.stderr)
    for name, changes in REBOUNDS.items():
        rows.append(_row(name, *_rebounds(soil(changes), folder / "rebound")))
    return rows


def _row(name: str, ours: float, theirs: float) -> dict:
    return {"quantity": name, "ours": float(ours), "theirs": float(theirs)}


def _rebounds(found: Found, folder: Path) -> tuple[float, float]:
    step = 1e-6
    law, pair = law_of(found), _pair(found)
    ours = jax.jit(lambda: collide(law, pair, 2 * SPEED, step, 20_000))()
    section = liggghts.text(found)
    return float(ours), two_spheres.liggghts_rebound(
        section, found.diameter / 2, SPEED, step, folder
    )


def _our_slip(found: Found, held: float, slips: np.ndarray) -> np.ndarray:
    """Our traction (N) at the slips, at a fixed overlap after virgin loading."""
    law, pair = law_of(found), _pair(found)
    speed = 1e-7

    def advance(carry, slip):
        history, before = carry
        contact = pair.contact(jnp.asarray(held), jnp.asarray(0.0))
        sideways = Vector(jnp.asarray(0.0), jnp.asarray(speed), jnp.asarray(0.0))
        contact = eqx.tree_at(
            lambda c: (c.slip, c.time_step, c.friction),
            contact,
            (sideways, (slip - before) / speed, jnp.asarray(found["static_friction"])),
        )
        force, history = law.force(contact, history)
        return (history, slip), -force.traction().y

    start = (law.memory((), jnp.float64), jnp.asarray(0.0))
    return np.asarray(jax.lax.scan(advance, start, jnp.asarray(slips))[1])


def _our_roll(found: Found, held: float) -> float:
    """Our largest rolling torque on one sphere (N m)."""
    law, pair = law_of(found), _pair(found)
    contact = pair.contact(jnp.asarray(held), jnp.asarray(0.0))
    force, _ = law.force(contact, law.memory((), jnp.float64))
    return float(force.rolling_limit * (found.diameter / 2 - held / 2))


def _yade_rows(pair: str, overlap, force, ours) -> list[dict]:
    """Corners of the two loops: to half of the matched overlap, then to all of it."""
    legs = [part.reshape(4, -1) for part in (overlap, force, ours)]
    rows = []
    for leg, name in ((1, "half of the matched overlap"), (3, "the matched overlap")):
        travel = legs[0][leg]
        tops = [part[leg - 1].max() for part in legs[1:]]
        ends = [float(np.interp(0.0, part[leg][::-1], travel[::-1])) for part in legs[1:]]
        pulls = [-part[leg].min() for part in legs[1:]]
        rows += [
            _row(f"{pair}: largest force (N), loaded to {name}", tops[1], tops[0]),
            _row(f"{pair}: overlap left at zero force (um), loaded to {name}", *_um(ends)),
            _row(f"{pair}: largest tension (N), loaded to {name}", pulls[1], pulls[0]),
        ]
    return rows


def _um(ends: list[float]) -> tuple[float, float]:
    return 1e6 * ends[1], 1e6 * ends[0]


def _figure(linear, in_yade) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    titles = ("LIGGGHTS, model edinburgh", "YADE, Luding's law")
    for axis, title, (overlap, theirs, ours) in zip(axes, titles, (linear, in_yade), strict=True):
        axis.plot(1e6 * overlap, ours, color="0.75", lw=4, label="ours")
        axis.plot(1e6 * overlap, theirs, color="#20344f", lw=1.2, ls="--", label=title)
        axis.axhline(0, color="0.6", lw=0.8)
        axis.set(xlabel="overlap (µm)", ylabel="normal force (N)", title=title)
        axis.legend(frameon=False, fontsize=8)
    figure.savefig(IMAGE, dpi=130)
    plt.close(figure)


def _markdown(measured: dict, origin: dict) -> str:
    loops = [
        [name, *(f"{error:.1e}" for error in errors)] for name, errors in measured["loops"].items()
    ]
    text = "# One contact with exported soils, ours and theirs\n\n"
    text += "The bundled soil's starting values, spheres of the quick preset.\n\n"
    text += "LIGGGHTS, normal force along a loop: largest deviation of a leg over the largest "
    text += "force.\n\n"
    text += reporting.table(("soil", "load", "unload", "reload", "separate"), loops)
    text += "\nYADE, tensile exponent 1, loaded once to the matched overlap and separated: "
    errors = [f"{error:.1e}" for error in measured["yade_exponent_1"]]
    text += f"largest deviation over the largest force {' and '.join(errors)}.\n"
    for program in ("liggghts", "yade"):
        name = {"liggghts": "LIGGGHTS", "yade": "YADE"}[program]
        rows = [
            [row["quantity"], f"{row['ours']:.4g}", f"{row['theirs']:.4g}"]
            for row in measured[program]
        ]
        text += "\n" + reporting.table((name, "ours", "theirs"), rows)
    return text + reporting.footer(origin)


if __name__ == "__main__":
    main()
