"""The two codes at equal parameters: what their difference alone does to both curves.

    python compare_codes.py --work DIR [--packings 3]    -> codes.json, codes.md, images/codes.png

Centre of the prior, same number of spheres and mould, packings of each code's own making; ours a
second time with the rolling friction of the bundled soil.  Ours runs at the simulated rates of
the LIGGGHTS recipe.  Runs are kept in DIR, LIGGGHTS' shared with signatures.py.
"""

import argparse
import json
import sys
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests"))
from signatures import cached, features, records
from support.reality.effects import Setup
from support.reality.instrument import CONFINED_SPEED, UNCONFINED_SPEED, Instrument, Record, record
from support.reality.labfiles import BUNDLED_ROLLING
from support.reality.soil import TENSILE_EXPONENT, Soil
from support.reality.specimen import CRUSHING, LOADING, SPHERES

from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.pair import KINDS
from calibrate.simulation.resolution import Preset, specimen, virtual_lab
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.materials.soil import SoilParameters
from jdem.packing.composite import prepare

HERE = Path(__file__).parent


def ours(soil: Soil, packings: int, work: Path) -> list[tuple[Record, Record]]:
    """Both tests of this project's simulator on so many packings, cached in `work`."""
    jax.config.update("jax_enable_x64", True)
    lab = load_lab(bundled_lab())
    preset = Preset("as LIGGGHTS", SPHERES, LOADING, CRUSHING, packings)
    virtual, cylinder = virtual_lab(lab, preset), specimen(lab, preset)
    values = SoilParameters(**asdict(soil), tensile_exponent=TENSILE_EXPONENT)
    run = eqx.filter_jit(VirtualLab.run)

    def made(seed: int) -> tuple[Record, Record]:
        return _recorded(run(virtual, prepare(cylinder, seed), values))

    name = f"ours-{soil.rolling_friction:g}"
    return [cached(work / f"{name}-{seed}.json", partial(made, seed)) for seed in range(packings)]


def _recorded(outcome) -> tuple[Record, Record]:
    """The two curves as a machine without noise would write them."""
    if bool(outcome.failed):
        raise RuntimeError("a run failed")
    quiet = Instrument(noise_force=0, noise_displacement=0)
    tests = []
    for kind, speed in zip(KINDS, (CONFINED_SPEED, UNCONFINED_SPEED), strict=True):
        curve = outcome.curves[kind]
        rows = np.asarray(curve.valid) > 0
        way, force = np.asarray(curve.displacement)[rows], np.asarray(curve.force)[rows]
        tests.append(record(way, force, speed, quiet, 0.0, np.random.default_rng(0)))
    return tests[0], tests[1]


def theirs(packings: int, work: Path) -> list[tuple[Record, Record]]:
    """The same of LIGGGHTS."""
    seeds = range(1, packings + 1)
    return [records(Setup(Soil()), seed, work / f"base-{seed}") for seed in seeds]


def summary(tests: list[tuple[Record, Record]]) -> dict[str, dict[str, float]]:
    """Mean and scatter of one packing for every feature."""
    rows = [features(*pair) for pair in tests]
    return {
        name: {
            "mean": float(np.mean([row[name] for row in rows])),
            "scatter": float(np.std([row[name] for row in rows], ddof=1)),
        }
        for name in rows[0]
    }


def plot(sets: dict[str, list[tuple[Record, Record]]], path: Path) -> None:
    """All curves of all sets."""
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    styles = ({"color": "0.6", "lw": 2}, {"color": "k", "ls": "--"}, {"color": "k"})
    for (name, tests), style in zip(sets.items(), styles, strict=True):
        for number, pair in enumerate(tests):
            for axis, test in zip(axes, pair, strict=True):
                label = name if number == 0 else ""
                axis.plot(test.displacement, test.force, label=label, **style)
    for axis, name in zip(axes, KINDS, strict=True):
        axis.set(title=name, xlabel="displacement (mm)", ylabel="force (N)")
    axes[1].legend()
    figure.savefig(path, dpi=80)


def markdown(table: dict[str, dict[str, dict[str, float]]]) -> str:
    """Mean ± scatter of one packing; names carry their unit at the end."""
    lines = ["| | " + " | ".join(table) + " |", "| --- " * (len(table) + 1) + "|"]
    for name in next(iter(table.values())):
        cells = [f"{t[name]['mean']:.2f} ± {t[name]['scatter']:.2f}" for t in table.values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--packings", type=int, default=3)
    options = parser.parse_args()
    count, work = options.packings, options.work
    rolling = replace(Soil(), rolling_friction=BUNDLED_ROLLING)
    sets = {
        "LIGGGHTS": theirs(count, work),
        "ours, same numbers": ours(Soil(), count, work),
        f"ours, rolling friction {BUNDLED_ROLLING}": ours(rolling, count, work),
    }
    table = {name: summary(tests) for name, tests in sets.items()}
    facts = {"spheres": SPHERES, "packings": count}
    (HERE / "codes.json").write_text(json.dumps({**facts, **table}, indent=1) + "\n")
    (HERE / "codes.md").write_text(markdown(table))
    plot(sets, HERE / "images" / "codes.png")
    print(markdown(table))


if __name__ == "__main__":
    main()
