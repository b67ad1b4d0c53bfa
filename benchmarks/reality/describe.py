"""What the cases are like as data, without opening their labels.

    python describe.py FOLDER        -> cases.json, cases.png beside its cases/

Depth H is the displacement between readings of 200 and 395 N, crushing force F the largest
reading; scatter is the coefficient of variation between the specimens of one case.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests"))
from support.reality.instrument import CONFINED_SPEED, UNCONFINED_SPEED
from support.reality.soil import MEAN_DIAMETER
from support.reality.specimen import CRUSHING, DENSITY, LOADING, MOULD_RADIUS

from calibrate.io.lab import Lab, load_lab
from calibrate.labtests.measured import Curve
from calibrate.labtests.pair import KINDS

PRESSED, CRUSHED = KINDS


def depth(curve: Curve) -> float:
    """H of one curve of pressing, mm."""
    rise = slice(0, int(np.argmax(curve.displacement_mm)) + 1)
    force = np.maximum.accumulate(curve.force_n[rise])
    low, high = np.interp([200.0, 395.0], force, curve.displacement_mm[rise])
    return float(high - low)


def of_case(lab: Lab) -> dict[str, float]:
    """H and F of one case, mean over specimens and coefficient of variation."""
    depths = [depth(c) for c in lab.curves if c.test == PRESSED]
    forces = [float(c.force_n.max()) for c in lab.curves if c.test == CRUSHED]
    row = {}
    for name, values in (("depth_mm", depths), ("crushing_n", forces)):
        row[name] = float(np.mean(values))
        row[f"{name}_cv"] = float(np.std(values, ddof=1) / np.mean(values))
    return row


def inertial_number(speed: float, height: float, force: float) -> float:
    """I = (speed/height) d sqrt(density/pressure) at `force` N on the platen."""
    pressure = force / (np.pi * MOULD_RADIUS**2)
    return float(speed / height * MEAN_DIAMETER * np.sqrt(DENSITY / pressure))


def plot(labs: list[Lab], path: Path) -> None:
    """All curves of all cases."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    for lab in labs:
        for curve in lab.curves:
            axis = axes[KINDS.index(curve.test)]
            axis.plot(curve.displacement_mm, curve.force_n, "k", lw=0.3, alpha=0.5)
    for axis, name in zip(axes, KINDS, strict=True):
        axis.set(title=name, xlabel="displacement (mm)", ylabel="force (N)")
    figure.savefig(path, dpi=80)


def main() -> None:
    folder = Path(sys.argv[1])
    labs = [load_lab(path) for path in sorted(folder.glob("cases/*/lab.toml"))]
    rows = [of_case(lab) for lab in labs]
    height = float(np.mean([lab.specimen.height for lab in labs]))
    middle = {
        name: dict(zip(("low", "median", "high"), map(float, np.quantile(
            [row[name] for row in rows], (0.05, 0.5, 0.95))), strict=True))
        for name in rows[0]
    }  # fmt: skip
    force = middle["crushing_n"]["median"]
    facts = {
        "cases": len(labs),
        "height_m": height,
        "faster_than_laboratory": {
            PRESSED: LOADING / CONFINED_SPEED, CRUSHED: CRUSHING / UNCONFINED_SPEED
        },
        "inertial_number": {
            f"{PRESSED} at 200 N": inertial_number(LOADING, height, 200.0),
            f"{PRESSED} at 400 N": inertial_number(LOADING, height, 400.0),
            f"{CRUSHED} at the median peak": inertial_number(CRUSHING, height, force),
        },
        "quantiles": middle,
    }  # fmt: skip
    (folder / "cases.json").write_text(json.dumps(facts, indent=1) + "\n")
    plot(labs, folder / "cases.png")
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
