"""Virtual power against the committed audit's references, on the same packings.

    python benchmarks/virtual_power.py                 8 packings of 300 spheres
    python benchmarks/virtual_power.py --float32       in single precision: 150 s a packing

The references and the ensemble's slopes are those of notebooks/data/audit.json (all of its
packings of one seed); virtual power is computed on the first of the same packings, and once more
on some of them with nothing carried over from the tests before (`FrozenMotion.carried`).  The
blend weighs virtual power and ensemble (`jdem.sensitivity.composite`).  Cost is processor time of
all slopes on one packing over that of one run.  Finished packings are kept in results/benchmarks;
a second call resumes.  Writes benchmarks/results/virtual_power.json and .md after every packing.
"""

import argparse
import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import reporting
from jax import Array

from calibrate.inference.audit import judged
from calibrate.inference.curve_points import POINTS, CurvePoints
from calibrate.inference.parameters import FACTORS, Space, space
from calibrate.inference.traced import traced
from calibrate.io.lab import bundled_lab, load_lab
from calibrate.labtests.composite import PLAIN
from calibrate.labtests.unconfined import UnconfinedTest
from calibrate.simulation import Campaign, engine_hash
from calibrate.simulation.resolution import PRESETS, numerics_for, specimen, virtual_lab
from jdem.laboratory.virtual_lab import VirtualLab
from jdem.packing.specimen import Packing
from jdem.sensitivity.base import Sensitivity, averaged
from jdem.sensitivity.composite import blended
from jdem.sensitivity.virtual_power import VirtualPower

NAMES = (*FACTORS, "shear_modulus")
OBSERVABLES = [o.name for kind in PLAIN.values() for o in kind.observables]
VARIANTS = {"carried": VirtualPower(carried=True), "dropped": VirtualPower()}


@dataclass(frozen=True)
class Bench:
    """What is measured with: the audit's soil, specimen and tests, and where results are kept."""

    work: Campaign
    space: Space
    points: CurvePoints
    folder: Path

    @staticmethod
    def of(spheres: int, dtype: str, folder: Path) -> "Bench":
        lab = load_lab(bundled_lab())
        preset = replace(PRESETS["quick"], spheres=spheres)
        cylinder = specimen(lab, preset)
        virtual = virtual_lab(lab, preset, numerics_for(cylinder, dtype=dtype))
        work = Campaign(virtual, cylinder, folder)
        return Bench(work, space(lab, NAMES), CurvePoints.of(work), folder)

    @property
    def lab(self) -> VirtualLab:
        return self.work.lab

    def slopes(self, variant: str) -> Callable[[int], dict]:
        """Slopes (m, p) as `result`, and processor seconds, on the packing of a seed."""
        strategy = VARIANTS[variant]
        both = traced(strategy, strategy.laboratory(self.lab), self.space, self.points)
        each = eqx.filter_jit(lambda packing, time_step: both(packing, time_step).slopes)

        def on(seed: int) -> dict:
            return self.kept(f"{self._hash(variant)}-{seed}", each, seed)

        return on

    def run_seconds(self, seed: int) -> float:
        """Processor seconds of one run of both tests at the base soil."""

        @eqx.filter_jit
        def forward(packing: Packing, time_step):
            return self.points.traced(self.lab.run(packing, self.space.base, time_step))

        return float(self.kept(f"{self._hash()}-run-{seed}", forward, seed)["seconds"])

    def kept(self, name: str, program, seed: int) -> dict:
        """What a program gives for the packing of a seed, from disk if it is there."""
        path = self.folder / "virtual_power" / f"{name}.npz"
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            result, seconds = self.timed(program, self.work.packings([seed])[0])
            np.savez(path, result=np.asarray(result), seconds=seconds)
        return dict(np.load(path))

    def timed(self, program, packing: Packing):
        """What a compiled program gives for a packing, and its processor seconds."""
        step = self.lab.time_step(packing, self.space.base)
        compiled = program.lower(packing, step).compile()
        begun = time.process_time()
        result = jax.block_until_ready(compiled(packing, step))
        return result, time.process_time() - begun

    def _hash(self, variant: str | None = None) -> str:
        strategy = VARIANTS[variant] if variant else None
        kind = f"{strategy.first} {strategy.carried}" if strategy else "run"
        content = [engine_hash(self.lab), kind, repr(self.lab.numerics)]
        content.append(repr(self.work.specimen))
        return hashlib.sha256("".join(content).encode()).hexdigest()[:16]


def committed(seed: str) -> tuple[Sensitivity, Sensitivity, int]:
    """The audit's reference and ensemble (slopes and standard errors), and its packings."""
    content = json.loads(reporting.file_of("audit").read_text(encoding="utf-8"))
    found = content["audits"][seed]
    rows = {(r["observable"], r["parameter"]): r for r in found["rows"]}
    keys = [[(observable, name) for name in NAMES] for observable in OBSERVABLES]

    def part(name: str) -> Sensitivity:
        slopes, errors = (
            jnp.asarray([[rows[key][kind] for key in line] for line in keys])
            for kind in (name, f"{name}_se")
        )
        return Sensitivity(jnp.zeros((1, len(keys))), slopes, errors)

    return part("reference"), part("estimate"), found["packings"]


def curve_means(seed: str, found: list[dict]) -> list[dict]:
    """Slopes (N) of the force averaged over the whole crushing curve: audit's and these."""
    content = json.loads(reporting.file_of("audit").read_text(encoding="utf-8"))
    curves = content["audits"][seed]["curves"][UnconfinedTest.type_name]["slopes"]
    each = np.array([one["result"][-POINTS:].mean(axis=0) for one in found])
    return [
        {
            "parameter": name,
            "reference": float(np.mean(curves[name]["reference"]["slope"])),
            "each": each[:, p].tolist(),
        }
        for p, name in enumerate(NAMES)
    ]


def rows(reference: Sensitivity, estimate: Sensitivity) -> list[dict]:
    """The audit's rows, judged by the audit's rules."""
    return [
        judged(
            {
                "parameter": name,
                "observable": observable,
                "estimate": float(estimate.slopes[m, p]),
                "estimate_se": _finite(estimate.standard_error[m, p]),
                "reference": float(reference.slopes[m, p]),
                "reference_se": float(reference.standard_error[m, p]),
            }
        )
        for m, observable in enumerate(OBSERVABLES)
        for p, name in enumerate(NAMES)
    ]


def _finite(value: Array) -> float | None:
    """A standard error; None where there is one packing only."""
    return float(value) if jnp.isfinite(value) else None


def together(found: list[dict]) -> Sensitivity:
    """Slopes of both observables on several packings."""
    count = len(OBSERVABLES)
    slopes = jnp.asarray([each["result"][:count] for each in found])
    return averaged(jnp.zeros(slopes.shape[:2]), slopes)


def content_of(found: dict[str, list[dict]], run_seconds: float, seed: str) -> dict:
    """Everything that is reported."""
    reference, ensemble, packings = committed(seed)
    estimates = {name: together(each) for name, each in found.items() if each}
    blends = {
        f"{name}, blended": blended(each, ensemble)
        for name, each in estimates.items()
        if len(found[name]) > 1
    }
    seconds = {name: [float(one["seconds"]) for one in each] for name, each in found.items()}
    return {
        "reference_packings": packings,
        "packings": {name: len(each) for name, each in found.items()},
        "rows": {name: rows(reference, each) for name, each in (estimates | blends).items()},
        "each": {
            name: [one["result"][: len(OBSERVABLES)].tolist() for one in each]
            for name, each in found.items()
        },
        "curve_means": {name: curve_means(seed, found[name]) for name in estimates},
        "run_seconds": run_seconds,
        "seconds": seconds,
        "forward_runs": {
            name: float(np.median(each)) / run_seconds for name, each in seconds.items()
        },
    }


def markdown(content: dict, chosen: argparse.Namespace, origin: dict) -> str:
    counts, runs = content["packings"], content["forward_runs"]
    first = VARIANTS["carried"].first
    text = (
        f"# Virtual power\n\nBundled soil, {chosen.spheres} spheres, "
        f"{'float32' if chosen.float32 else 'float64'}. References: the audit's, on "
        f"{content['reference_packings']} packings (`audit.md`, seed {chosen.seed}; an earlier "
        f"engine). Virtual power (pathwise until {first}), packing by packing on "
        f"the first of them: what the tests before did to the bed carried ({counts['carried']} "
        f"packings) or dropped ({counts.get('dropped', 0)}); blends of their means with the "
        "ensemble. Slopes per unit of ln p, mm (H) and N (F); means judged as in the audit.\n\n"
    )
    cost = ", ".join(f"{value:.1f} ({name})" for name, value in runs.items())
    cost = f"\nCost of all slopes on one packing, in forward runs: {cost}.\n"
    curve = "\nThe same for the force averaged over 20 points of the crushing curve (N):\n\n"
    curve += reporting.table(*mean_table(content["curve_means"]))
    return text + reporting.table(*slope_table(content)) + curve + cost + reporting.footer(origin)


Lines = tuple[list[str], list[list[str]]]


def mean_table(found: dict[str, list[dict]]) -> Lines:
    """Header and rows: slopes of the mean force while crushing."""
    lines = [
        [row["parameter"], f"{row['reference']:.3g}"]
        + [" / ".join(f"{x:.3g}" for x in each[p]["each"]) for each in found.values()]
        for p, row in enumerate(found["carried"])
    ]
    return ["parameter", "reference", *found], lines


def slope_table(content: dict) -> Lines:
    """Header and one row for each slope; those that can be judged come first."""
    lines = []
    for number, row in enumerate(content["rows"]["carried"]):
        m, p = divmod(number, len(NAMES))
        line = [
            row["parameter"],
            "HF"[m],
            f"{row['reference']:.3g} ± {row['reference_se']:.2g}",
        ]
        for name, judged_rows in content["rows"].items():
            each = content["each"].get(name)
            shown = [one[m][p] for one in each] if each else [judged_rows[number]["estimate"]]
            values = " / ".join(f"{value:.3g}" for value in shown)
            line.append(f"{values} {_word(judged_rows[number])}".strip())
        lines.append((not row["judged"], line))
    header = ["parameter", "of", "reference", *content["rows"]]
    return header, [line for _, line in sorted(lines, key=lambda pair: pair[0])]


def _word(row: dict) -> str:
    return {None: "", True: "passed", False: "FAILED"}[row["passed"]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--spheres", type=int, default=300)
    parser.add_argument("--packings", type=int, default=8)
    parser.add_argument("--dropped", type=int, default=3, help="packings with nothing carried")
    parser.add_argument("--seed", default="2", help="one of the seeds of the committed audit")
    parser.add_argument("--float32", action="store_true")
    parser.add_argument("--folder", type=Path, default=reporting.CACHE, help="what is kept")
    chosen = parser.parse_args()
    reporting.configure()
    bench = Bench.of(chosen.spheres, "float32" if chosen.float32 else "float64", chosen.folder)
    first = 100 * int(chosen.seed)
    found: dict[str, list[dict]] = {"carried": []}
    run_seconds = bench.run_seconds(first)
    for variant, count in (("carried", chosen.packings), ("dropped", chosen.dropped)):
        found[variant] = []
        slopes = bench.slopes(variant)
        for seed in range(first, first + count):
            found[variant].append(slopes(seed))
            if len(found["carried"]) > 1:
                origin = reporting.provenance()
                content = content_of(found, run_seconds, chosen.seed)
                report = markdown(content, chosen, origin)
                reporting.write("virtual_power", {**origin, **content}, report)


if __name__ == "__main__":
    main()
