"""Before and after: every effect on the same packings with and without it, raw curves plotted.

    python signatures.py --work DIR [--effect NAME ...]    -> images/NAME.png, signatures.json

The table gives the change of depression depth H (200 to 400 N), crushing force F, displacement
at 50 N, displacement recovered on unloading, displacement at the peak and the end force over F.
"""

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests"))
from support.reality.effects import BY_NAME, Effect, Setup
from support.reality.instrument import CONFINED_SPEED, UNCONFINED_SPEED, Record, record
from support.reality.soil import Soil
from support.reality.specimen import run

HERE = Path(__file__).parent
SEEDS = (1, 2)
STRENGTH_SHARE = 0.8  # of the logarithmic way from the weak to the strong end


def records(setup: Setup, seed: int, folder: Path) -> tuple[Record, Record]:
    """Both tests as the machine writes them, without scatter of the zero; cached by `folder`."""

    def made() -> tuple[Record, Record]:
        outcome = run(setup.soil, setup.physics, setup.instrument, seed, folder)
        if not outcome.stands:
            raise RuntimeError(f"{folder.name}: {outcome.facts}")
        random = np.random.default_rng(0)
        first, second = outcome.curves["confined"], outcome.curves["unconfined"]
        chain = setup.instrument
        return (
            record(first[:, 0], first[:, 1], CONFINED_SPEED, chain, 0.0, random),
            record(second[:, 0], second[:, 1], UNCONFINED_SPEED, chain, 0.0, random),
        )

    return cached(folder.with_suffix(".json"), made)


def cached(file: Path, made: Callable[[], tuple[Record, Record]]) -> tuple[Record, Record]:
    """Two records from `file`, which `made` fills the first time."""
    if not file.exists():
        lists = [{k: v.tolist() for k, v in asdict(test).items()} for test in made()]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(lists))
    first, second = [
        Record(**{k: np.array(v) for k, v in test.items()}) for test in json.loads(file.read_text())
    ]
    return first, second


def features(confined: Record, unconfined: Record) -> dict[str, float]:
    """Numbers that an engineer reads off the two curves; mm, N, fractions."""
    turn = int(np.argmax(confined.displacement))
    way = confined.displacement[: turn + 1]
    force = np.maximum.accumulate(confined.force[: turn + 1])
    back_way, back_force = confined.displacement[:turn:-1], confined.force[:turn:-1]
    at = {level: float(np.interp(level, force, way)) for level in (50, 200, 399)}
    peak = int(np.argmax(unconfined.force))
    rise = unconfined.displacement[: peak + 1], np.maximum.accumulate(unconfined.force[: peak + 1])
    return {
        "depth_mm": at[399] - at[200],
        "at_50n_mm": at[50],
        "recovered_mm": float(way[-1] - np.interp(5, back_force, back_way)),
        "largest_confined_n": float(force.max()),
        "crushing_force_n": float(unconfined.force[peak]),
        "at_half_peak_mm": float(np.interp(rise[1][-1] / 2, rise[1], rise[0])),
        "at_peak_mm": float(unconfined.displacement[peak]),
        "end_over_peak": float(unconfined.force[-5:].mean() / unconfined.force[peak]),
    }


def typical(effect: Effect) -> float:
    """A strength near the strong end."""
    return effect.weak * (effect.strong / effect.weak) ** STRENGTH_SHARE


def compare(effect: Effect, work: Path) -> dict:
    """Plot one effect and return its mean change of every feature over the packings."""
    base, rows = Setup(Soil()), []
    changed = effect.realise(base, typical(effect))
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for seed in SEEDS:
        before = records(base, seed, work / f"base-{seed}")
        after = records(changed, seed, work / f"{effect.name}-{seed}")
        for axis, old, new in zip(axes, before, after, strict=True):
            first = seed == SEEDS[0]
            axis.plot(old.displacement, old.force, "0.6", lw=1.8, label="without" if first else "")
            axis.plot(new.displacement, new.force, "k", lw=0.9, label="with" if first else "")
        rows.append([features(*before), features(*after)])
    for axis, name in zip(axes, ("confined", "unconfined"), strict=True):
        axis.set(title=name, xlabel="displacement (mm)", ylabel="force (N)")
    axes[0].legend()
    title = effect.name.replace("_", " ")
    figure.suptitle(f"{title}, {typical(effect):.3g} {effect.unit}, packings {SEEDS}")
    (HERE / "images").mkdir(exist_ok=True)
    figure.savefig(HERE / "images" / f"{effect.name}.png", dpi=70)
    plt.close(figure)
    names = rows[0][0]
    return {
        "effect": effect.name, "strength": typical(effect), "unit": effect.unit,
        "before": {n: float(np.mean([r[0][n] for r in rows])) for n in names},
        "after": {n: float(np.mean([r[1][n] for r in rows])) for n in names},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--effect", nargs="*", default=list(BY_NAME))
    options = parser.parse_args()
    table = HERE / "signatures.json"
    rows = {r["effect"]: r for r in json.loads(table.read_text())} if table.exists() else {}
    for name in options.effect:
        try:
            rows[name] = compare(BY_NAME[name], options.work)
            before, after = rows[name]["before"], rows[name]["after"]
            print(name, {k: round(after[k] - before[k], 2) for k in after}, flush=True)
        except RuntimeError as error:
            print("FELL", error, flush=True)
        table.write_text(json.dumps(list(rows.values()), indent=1) + "\n")


if __name__ == "__main__":
    main()
